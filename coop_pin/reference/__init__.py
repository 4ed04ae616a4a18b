"""Reference: desired motion and squeeze of the payload as functions of time.

Open first: ``motions`` (closed forms, and the union of all kinds), ``pose_reference`` (what a motion answers:
``at(time)``), ``squeeze`` (desired internal wrenches).

Each is a frozen, validated value: what a scenario holds is what runs. A motion returns from ``at(time)`` a
``PoseTarget``: the desired pose, twist and acceleration of the payload frame P, world axes, linear first. A
squeeze returns from ``at(time, arms)`` the desired internal wrench of each arm, payload axes, about P.

- ``lines`` (straight, rest to rest; ``quintic`` timing), ``splines`` (waypoints), ``csv_motion`` (a table of
  poses), ``joint_motion`` (a table of joint angles, which a cell makes poses: ``on(cell)``).
- ``check_consistency`` compares any motion with central differences.

Public names are in ``cp.motions`` and ``cp.squeezes``.

Imports ``base``.
"""
