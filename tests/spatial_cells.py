"""Four cells in space, with gravity: redundant, mixed, three-armed and with continuous joints. Each with a pose to start from.

Arms stand on a table (z = 0) around the payload and grip it from their side. At the start, and 0.1 m from it in any direction,
every payload Jacobian has sigma_min > 0.15 and every joint is more than 0.4 rad from its limits.
"""

import numpy as np

from coop_pin.description import Arm, Cell, Payload, Pose
from coop_pin.spatial import make_pose

FINGERS = {"panda_finger_joint1": 0.03}
TURN = 2.0 * np.pi


def around(angle, X):
    """A pose turned about the world's z axis through the origin."""
    return Pose.from_matrix(make_pose(rpy=(0.0, 0.0, angle)) @ X)


def grip(x, z, tilt=0.0, roll=0.0):
    """A tip in the payload frame at (x, 0, z) whose z axis points down, tilted towards +x, rolled about that axis."""
    return make_pose((x, 0.0, z), (np.pi, -tilt, 0.0)) @ make_pose(rpy=(0.0, 0.0, roll))


def ring(names, urdf, tip, distance, grasp, posture, **fields):
    """Equal arms around the payload, evenly turned, and their grasps."""
    turns = {name: TURN * index / len(names) for index, name in enumerate(names)}
    arms = {
        name: Arm.from_urdf(urdf, tip, base=around(turn, make_pose((-distance, 0.0, 0.0))), posture=posture, **fields)
        for name, turn in turns.items()
    }
    return arms, {name: around(turn, grasp) for name, turn in turns.items()}


def panda_box():
    """Two Pandas (7 joints each, fingers locked) hold a box from above."""
    posture = (-0.406, -0.537, 0.32, -2.256, 0.164, 1.739, 1.415)
    arms, grasps = ring(
        ["left", "right"], "panda", "panda_hand_tcp", 0.6, grip(-0.2, 0.05, roll=np.pi / 4), posture=posture, locked=FINGERS
    )
    return Cell(arms=arms, payload=Payload.box(3.0, (0.5, 0.2, 0.1)), grasps=grasps), make_pose((0.0, 0.0, 0.4))


def panda_ur5_bar():
    """A Panda and a UR5 hold a bar."""
    left = Arm.from_urdf(
        "panda", "panda_hand_tcp", base=(-0.7, 0.0, 0.0), posture=(0.542, -0.562, -0.453, -2.375, -0.245, 1.852, 1.792), locked=FINGERS
    )
    right = Arm.from_urdf(
        "ur5", "tool0", base=around(np.pi, make_pose((-0.95, 0.0, 0.0))), posture=(-2.939, -1.778, -1.656, -0.503, 1.428, -1.426)
    )
    grasps = {"left": Pose.from_matrix(grip(-0.3, 0.0, roll=np.pi / 4)), "right": around(np.pi, grip(-0.35, 0.0, tilt=np.pi / 4))}
    return Cell(arms={"left": left, "right": right}, payload=Payload.bar(3.0, 0.7), grasps=grasps), make_pose((0.0, 0.0, 0.4))


def three_ur5_plate():
    """Three UR5 hold a round plate by its rim."""
    posture = (-0.208, -1.211, 1.829, 3.056, -1.391, -1.676)
    arms, grasps = ring(["first", "second", "third"], "ur5", "tool0", 0.85, grip(-0.25, 0.0, tilt=np.pi / 3), posture=posture)
    return Cell(arms=arms, payload=Payload.cylinder(6.0, 0.25, 0.03), grasps=grasps), make_pose((0.0, 0.0, 0.3))


def kinova_pair():
    """Two Kinova Jaco (three continuous joints each: nq = 9, nv = 6) hold a small box."""
    posture = (-1.546, 3.459, 1.381, 0.0, 4.205, 0.025)
    arms, grasps = ring(
        ["left", "right"], "kinova", "j2s6s200_end_effector", 0.55, grip(-0.15, 0.0, tilt=np.pi / 2, roll=np.pi), posture=posture
    )
    return Cell(arms=arms, payload=Payload.box(1.0, (0.3, 0.1, 0.1)), grasps=grasps), make_pose((0.0, 0.0, 0.25))


SPATIAL_CELLS = {"panda-box": panda_box, "panda-ur5-bar": panda_ur5_bar, "three-ur5-plate": three_ur5_plate, "kinova-pair": kinova_pair}
