"""Four arms carry one plate: as many arms as one likes, numbered arm1, arm2, ... by ``cp.new_cell``.

The internal wrench of each arm and the load share are those of any number of arms.
"""

import coop_pin as cp

result = cp.run("four-ur5-plate", {"duration": 2.0})
internal = result.data.internal_wrench.values[-1, :, :3]
total = abs(internal.sum(axis=0)).max()
print(f"{result.verdict()}; sum of the internal forces of {len(internal)} arms: {total:.1e} N")
