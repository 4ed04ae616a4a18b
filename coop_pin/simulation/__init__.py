"""Simulation: one run of a scenario, tick by tick: plant, sensors, law, drives, events, recorder.

Open first: ``timeline`` (the order of the stages of a tick, and when events happen), ``plant`` (what a run
asks of a simulator of the cell; ``pinocchio_plant`` is one, a second simulator would be another),
``devices`` (sensors, drives, servos, network).

- ``loop`` (runs the stages), ``simulation`` (changes of a run that goes on), ``simulate`` (a whole run).
- ``tick``: signals, inputs and references of a tick, for every engine.
- ``build_controller``: the law that a scenario names.
- ``recorder`` (what is kept of each tick), ``run_state`` (state from which a run goes on).

Public names are in ``cp``; metrics of what is recorded are in ``results``.

Imports ``base``, ``chain``, ``control``, ``description``, ``grasps``, ``model``, ``reference`` and
``results``.
"""

import coop_pin.model  # noqa: F401  first: raises a helpful error if Pinocchio is missing
