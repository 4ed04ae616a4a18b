"""Environment: a cell as an environment of Gymnasium (extra ``gym``), for agents.

Open first: ``task`` (actions, observations, reward), ``cell_env`` (one cell on Pinocchio),
``vector_cell_env`` (cells as lanes of compiled code).

``acted_law`` is the law to which an agent adds. Public names are in ``cp.gym``.

Imports ``base``, ``compiled``, ``control``, ``description``, ``results``, ``simulation`` and ``tracing``.
"""
