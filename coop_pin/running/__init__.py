"""Running: ``cp.check`` and ``cp.run`` of one scenario: findings, engine, result.

Open first: ``run_scenario`` (``cp.run``), ``check`` (``cp.check``: all findings of a scenario, and the quick
ones of a run; their class is in ``results.finding``). ``cell_findings`` has each subject, lifts and rolling
bases in ``carrier_findings``, ``plausibility`` numbers in a likely wrong unit, ``recorded_distances`` the
least distances of a finished run, and ``engine_choice`` of ``compiled`` which engine runs.

Imports ``base``, ``compiled``, ``control``, ``description``, ``feasibility``, ``model``, ``results``,
``simulation`` and ``stability``.
"""

import coop_pin.model  # noqa: F401  first: raises a helpful error if Pinocchio is missing
