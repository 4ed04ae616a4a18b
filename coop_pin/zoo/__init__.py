"""Zoo: published experiments rebuilt in small, each with a number, a limit and a verdict for every claim.

Open first: ``object_impedance/experiment`` (a whole experiment), ``experiment`` (what a source states and
what it leaves open, as ``experiment.toml`` has it), ``reproduction`` (numbers of a run, verdicts, table).

- A folder is an experiment: ``experiment.toml``, ``cell.toml``, and a function in at most 60 lines.
- Experiments are written as a user writes them, with ``import coop_pin as cp``; nothing else imports them.
- ``tools/zoo.py`` runs them and writes the pages in ``docs/zoo``.

Imports ``base`` and ``description``.
"""

from coop_pin import lazy_names

__all__, __getattr__, __dir__ = lazy_names(
    __name__,
    {
        "Claim": "zoo.experiment",
        "Trace": "zoo.reproduction",
        "Experiment": "zoo.experiment",
        "Measured": "zoo.reproduction",
        "Picture": "zoo.experiment",
        "Reproduction": "zoo.reproduction",
        "experiment_names": "zoo.experiment",
        "load_experiment": "zoo.experiment",
    },
)
