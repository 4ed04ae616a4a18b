"""Cell: arms, payload and what holds it, as a scenario states them.

Open first: ``cell`` (all parts), ``held_payload`` (what grasps hold), ``arm`` (URDF, base, tip, friction,
calibration error), ``grasp`` (rigid, joint, compliant, patch).

``contact`` has pads, patches and tables, ``grasp_plan`` who bears which part of the load when, ``closure`` a
loop closure, ``payload`` the body, ``mobile_base`` a driven platform under an arm, ``differential_base`` one
on two wheels, ``shared_joint`` a lift or torso under several arms, ``linkage`` a payload of several links.

Imports ``base``, ``control`` and ``reference``, as ``description`` does.
"""
