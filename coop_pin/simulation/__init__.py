"""Simulation: one run of a scenario, tick by tick: plant, sensors, law, drives, events, recorder.

Open first: ``simulation`` (the loop, and the order of the stages of a tick), ``plant`` (what happens between
two ticks: held torques, friction, forces on the payload), ``devices`` (sensors, drives, servos, network).

- ``simulate``: a whole run. ``tick``: inputs of a tick, for every engine. ``timeline``: ticks, steps, events.
- ``build_controller``: the law that a scenario names.
- ``recorder`` (what is kept of each tick), ``run_state`` (state from which a run goes on).
- ``realtime``: pacing by the clock on the wall.

Public names are in ``cp``; metrics of what is recorded are in ``results``.

Imports ``base``, ``chain``, ``control``, ``description``, ``grasps``, ``model``, ``reference`` and
``results``.
"""

import coop_pin.model  # noqa: F401  first: raises a helpful error if Pinocchio is missing
