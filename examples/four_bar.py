"""N coupled four-bar linkages: closed loops without arms, through singular poses, against the closed form.

N + 1 upright rods on ground pivots one metre apart are linked at their tips by N level rods; all are uniform,
1 m and 1 kg. The loops remain parallelograms with one degree of freedom theta: theta'' = -k cos theta with
k = g ((N+1)/2 + N) / ((N+1)/3 + N). When all rods are horizontal (theta = 0 or pi) the closures lose rank.
This is a benchmark of the IFToMM for multibody solvers.
"""

import numpy as np
from scipy.integrate import solve_ivp

import coop_pin as cp

GRAVITY = 9.81


def rod(name, parent, x):
    """A rod along x, hinged about z to its parent, as URDF."""
    return f"""
  <link name="{name}"><inertial><origin xyz="0.5 0 0"/><mass value="1"/>
    <inertia ixx="0.0001" iyy="{1 / 12}" izz="{1 / 12}" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="{name}_pin" type="revolute"><parent link="{parent}"/><child link="{name}"/>
    <origin xyz="{x} 0 0"/><axis xyz="0 0 1"/>
    <limit lower="-1e6" upper="1e6" effort="0" velocity="0"/></joint>"""


def four_bars(loops, **options):
    """Return N four-bars: a level rod is pinned to the upright on its left and closed to the next one."""
    uprights = [rod(f"upright{i}", "ground", i) for i in range(loops + 1)]
    levels = [rod(f"level{i}", f"upright{i}", 1.0) for i in range(loops)]
    urdf = "".join(('<robot name="four_bars"><link name="ground"/>', *uprights, *levels, "\n</robot>"))
    end = np.eye(4)
    end[0, 3] = 1.0
    closures = [cp.Closure(f"level{i}", f"upright{i + 1}", "point", X_AC=end, X_BC=end) for i in range(loops)]
    return cp.ClosedChain.from_urdf(urdf, closures, gravity=(0.0, -GRAVITY, 0.0), **options)


def start(chain, loops, angle=np.pi / 2, rate=-1.0):
    """All uprights at an angle and turning at a rate, the level rods level."""
    turns = {f"upright{i}_pin": 1.0 for i in range(loops + 1)} | {f"level{i}_pin": -1.0 for i in range(loops)}
    return (
        chain.configuration({name: sign * angle for name, sign in turns.items()}),
        chain.velocity({name: sign * rate for name, sign in turns.items()}),
    )


def first_tip(chain, motion):
    """Position of the end of the first upright rod, m, shape (n, 2)."""
    tip = np.array((1.0, 0.0, 0.0, 1.0))
    return np.array([(chain.frame_pose(q, "upright0") @ tip)[:2] for q in motion.q])


def closed_form(loops, time):
    """The same position from the closed form, theta(0) = pi/2 and theta'(0) = -1."""
    k = GRAVITY * ((loops + 1) / 2 + loops) / ((loops + 1) / 3 + loops)
    state = (np.pi / 2, -1.0)
    theta = solve_ivp(
        lambda _, y: (y[1], -k * np.cos(y[0])), time[[0, -1]], state, "DOP853", time, rtol=1e-13, atol=1e-13
    ).y[0]
    return np.column_stack((np.cos(theta), np.sin(theta)))


if __name__ == "__main__":
    for loops, step in ((1, 5e-3), (2, 5e-3), (2, 2e-3), (5, 5e-3)):
        chain = four_bars(loops)
        motion = chain.integrate(*start(chain, loops), duration=5.0, step=step)
        error = np.linalg.norm(first_tip(chain, motion) - closed_form(loops, motion.time), axis=1).max()
        lost = chain.energy(motion.q[-1], motion.v[-1]).total - chain.energy(motion.q[0], motion.v[0]).total
        print(
            f"{loops} loops, {step * 1e3:g} ms steps: tip within {error:.1e} m of the closed form,"
            f" energy within {abs(lost):.1e} J"
        )
