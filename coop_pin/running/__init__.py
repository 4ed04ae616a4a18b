"""Running: ``cp.run``, one scenario with the controller that it names: warnings, engine, result.

Open first: ``run_scenario`` (the function), ``plausibility`` (implausible numbers and all other warnings
before a run), and ``engine_choice`` of ``compiled`` (which engine).

Imports ``base``, ``compiled``, ``description``, ``feasibility``, ``model``, ``results``,
``simulation`` and ``stability``.
"""

import coop_pin.model  # noqa: F401  first: raises a helpful error if Pinocchio is missing
