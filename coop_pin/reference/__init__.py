"""Desired motion and squeeze of the payload as functions of time.

Each is a frozen, validated value: what a scenario holds is what runs.

A motion (``PoseReference``) returns from ``at(time)`` a ``PoseTarget``: the desired pose, twist and
acceleration of the payload frame P, world axes, linear first. The kinds:

- ``HoldMotion``: stands still.
- ``ExponentialMotion``: decaying exponentials, the reference experiment of Gueaieb et al. (2007).
- ``LineMotion``: straight from one pose to another, from rest to rest; ``TimedLineMotion`` with a table of
  time.
- ``CircleMotion``: round a circle, from rest.
- ``TurnMotion``: about an axis through P or another point; ``SwingMotion``: through P, to and fro.
- ``WaypointsMotion``, ``CsvMotion``: a spline through poses, given in the scenario or in a file.
- ``FunctionMotion``: a user-written function of time.

A squeeze (``SqueezeReference``) returns from ``at(time, arms)`` the desired internal wrench of each arm,
payload axes, about P: ``ConstantSqueeze``, ``TipForceSqueeze``,
``TipWrenchSqueeze``, ``RampSqueeze``, ``FunctionSqueeze``.

``check_consistency`` compares any motion with central differences.
"""
