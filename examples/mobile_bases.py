"""Arms on omnidirectional platforms carry a plate away: the platforms follow their arms.

``mobile_base`` puts three driven joints (x, y, yaw) under any arm. The spring of the posture acts on the
arm's own joints only, so that the arm stays as it is and the platform moves.
"""

import numpy as np

import coop_pin as cp

goal = {"xyz": [0.3, 0.0, 0.78], "rpy": [0.0, 0.0, 0.0]}
scenario = cp.Scenario.load(
    "three-driven-ur5",
    {
        "motion.goal": goal,
        "motion.duration": 2.0,
        "motion.start_time": 0.2,
        "duration": 3.0,
        "task.force": 2.5,  # N: platforms and arms accelerate one another
        "task.moment": 2.0,  # N m
    },
)
result = cp.run(scenario)
q = result.data.configuration.values
moved = [float(np.hypot(*(q[-1, first : first + 2] - q[0, first : first + 2]))) for first in (0, 9, 18)]
print(f"{result.verdict()}; the platforms moved {', '.join(f'{way:.2f}' for way in moved)} m")
