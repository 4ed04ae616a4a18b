"""Compiled: plant, tick and laws of a run as compiled code: one run, runs as lanes of a program, laws as C99.

Open first: ``engine_choice`` (Pinocchio or compiled code, and in which way), ``kind`` (what runs of one code
share, and what cannot be compiled), ``simulate`` (batches of runs).

Laws are those of ``control``, sensors and drives those of ``simulation/devices``, run on traced numbers. The
plant alone is written anew, as scalar code with the numbers of the cell's Pinocchio tree, but for springs,
which are those of ``grasps``; tests hold the two together. Runs of one
``Kind`` share their code: a ``Cover`` (events, delays, lost torques) is what it provides, numbers that all of
them have *fold* into it, others are *inputs* in the *slots* of a *block* of runs.

- Numbers of runs: ``prepared_plant``, ``preparation``, ``constants``, ``signals``.
- Code: ``plant`` (physics), ``laws``, ``tick``, ``block``, ``schedule`` (code on disk, order of the kernels).
- Runs: ``lane`` (one run, interruptible), ``samples`` and ``batch_result`` (what was recorded).

The public names of C99 are in ``cp.export``.

Imports ``base``, ``chain``, ``control``, ``description``, ``grasps``, ``model``, ``reference``, ``results``,
``simulation`` and ``tracing``.
"""

from coop_pin import lazy_names

__all__, __getattr__, __dir__ = lazy_names(
    __name__,
    {
        "BatchResult": "compiled.batch_result",
        "BatchSimulator": "compiled.simulate",
        "Lane": "compiled.lane",
        "law_reason": "compiled.kind",
        "plant_of": "compiled.engine_choice",
        "plant_reason": "compiled.kind",
        "simulate_batch": "compiled.simulate",
        "support": "compiled.laws.support",
    },
)
