"""Six definitions of internal force on the same wrenches: two cells at rest, squeezed by 10 N at the tips."""

import numpy as np

import coop_pin as cp
from coop_pin.spatial import shift_wrench

CHANGES = {"duration": 0.5, "clock.steps_per_tick": 1, "controller.gains.transient_rate": 20.0}
for name in ("two-pandas-box", "panda-ur5-bar"):
    result = cp.run(name, CHANGES, warn=False)  # the squeeze acts; the motion starts later
    now = result.data.isel(time=-1, arm=0)
    r = (now.tip_position - now.payload_position).values
    print(f"{name}, arm {now.arm.item()}: along the squeeze N, vertical N, moment at the wrist N m")
    measured = {"measured": now.interaction_wrench}
    for definition, wrench in {
        **measured,
        **result.internal_wrench_definitions().isel(time=-1, arm=0),
    }.items():
        f = shift_wrench(wrench.values, -r)
        numbers = np.round([f[0], f[2], np.linalg.norm(f[3:])], 2) + 0.0  # no minus zero
        print(f"{definition:<22} {numbers[0]:8.2f} {numbers[1]:8.2f} {numbers[2]:8.2f}")
