"""Sweeps: many runs of a plan: workers, a store of finished runs, their table, and tuning.

Open first: ``plan`` (scenarios and what varies), ``session`` (computes the missing runs), ``store`` (finished
runs on disk: checksummed lines, one writer).

- Plan: ``dimensions``, ``template`` (scenarios validated once), ``run_key`` (digest of a run),
  ``feasibility`` and ``engine`` (decided before the first run, with an estimate of the duration).
- ``workers``: jobs, processes, dask. ``progress_bar``.
- Results: ``analysis`` (best, boundaries), ``result`` (files), ``table``, ``heat_map`` (an HTML page).
- ``optimisation``: search of fields for the smallest metric (``cp.tune``).

Names are loaded on first use: the host process of local workers lies in this package and needs none.

Imports ``base``, ``compiled``, ``control``, ``description``, ``feasibility``, ``results``, ``running``,
``simulation`` and ``stability``.
"""

from coop_pin import lazy_names

__all__, __getattr__, __dir__ = lazy_names(
    __name__,
    {
        "Estimate": "sweeps.engine",
        "PointResult": "sweeps.table",
        "Sample": "sweeps.dimensions",
        "Span": "sweeps.dimensions",
        "TuneResult": "sweeps.optimisation",
        "estimate": "sweeps.engine",
        "linspace": "sweeps.dimensions",
        "logspace": "sweeps.dimensions",
    },
)
