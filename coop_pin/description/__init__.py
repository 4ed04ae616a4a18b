"""Description: a scenario as its user writes it, in Python or TOML: frozen, validated values, no physics.

Open first: ``scenario`` (all that determines a run), ``cell/cell`` (arms, payload, grasps), ``controller``
(the laws that a scenario can name, and a user's own).

- ``cell``: arm, payload, kinds of grasps, tables, closures. ``urdf``: robot files, found and validated.
- Devices: ``sensors``, ``actuators``, ``servo``, ``network`` (channels, delay, loss).
- ``events`` (disturbances of the payload), ``arm_events`` (failures), ``grasp_events`` (release,
  hand-over, put down).
- ``plant`` (clock, steps, formulation), ``thresholds`` (bounds on a run), ``model_laws``, ``log_table``
  (topics of a log).
- ``scenario_file`` (TOML), ``catalogue`` and ``scenarios`` (the cells that come with coop_pin).

What a device does in a run is in ``simulation/devices``. Public names are in ``cp``, ``cp.events``,
``cp.sensors``, ``cp.actuators``, ``cp.network``, ``cp.plant`` and ``cp.urdf``.

Imports ``base``, ``control`` and ``reference``.
"""
