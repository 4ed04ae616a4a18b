"""Devices of a run: sensors, drives, servos and network, as frozen numbers and pure functions of a tick.

Open first: ``sensors`` (what each arm measures), ``drives`` (from commanded torques to those that act: lag,
limits, friction, gravity compensation), ``network`` (messages: delayed, lost, rounded).

- Of drives: ``torque_response`` (lag, rate limit). Of sensors: ``encoder``, ``wrist``; ``signals``
  draws their noise, and all that depends on time and chance only.
- ``servo``: inner loop of arms that take velocities or positions. ``shared_drive``: shared joints.
- On Pinocchio's state: ``sensing`` (inputs of the sensors), ``actuation`` (inputs of the drives).

Every effect is written once: compiled code calls the same functions. Their fields are in ``description``.

Imports what ``simulation`` imports.
"""
