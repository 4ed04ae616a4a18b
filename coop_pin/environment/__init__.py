"""Environment: a cell as an environment of Gymnasium (extra ``gym``), for agents.

Open first: ``task`` (actions, observations, reward), ``cell_env`` (one cell on Pinocchio),
``vector_cell_env`` (cells as lanes of compiled code).

The law to which an agent adds is in ``acted_law``. Public names are in ``cp.gym``.
An import registers ``coop_pin/Cell-v0``; ``coop_pin.environment:coop_pin/Cell-v0`` imports it, too.

Imports ``base``, ``compiled``, ``control``, ``description``, ``results``, ``simulation`` and ``tracing``.
"""

import contextlib

with contextlib.suppress(ImportError):  # of the extra, which the environments ask for
    import gymnasium

    if "coop_pin/Cell-v0" not in gymnasium.registry:  # it warns of a package that is loaded again
        gymnasium.register(
            "coop_pin/Cell-v0",
            f"{__name__}.cell_env:CellEnv",
            vector_entry_point=f"{__name__}.vector_cell_env:VectorCellEnv",
        )
