"""Environment: a cell as an environment of Gymnasium (extra ``gym``), for agents.

Open first: ``task`` (actions, observations, reward), ``cell_env`` (one cell on Pinocchio),
``vector_cell_env`` (cells as lanes of compiled code).

The law to which an agent adds is in ``task``. Public names are in ``cp.gym``.

Imports ``base``, ``compiled``, ``control``, ``description``, ``results``, ``simulation`` and ``tracing``.
"""
