"""Motions, payload sources and a ramped squeeze, shown on the cell of the paper."""

from pathlib import Path

import numpy as np
import trimesh

import coop_pin as cp

START = cp.Pose(xyz=(0.5, 0.05, 0.0), rpy=(0.0, 0.0, np.pi / 3))
UP = (0.0, 0.0, 1.0)
TABLE = "time,x,y,z,roll,pitch,yaw\n0,0.5,0.05,0,0,0,1.0472\n4,0.53,0.05,0,0,0,1.1\n8,0.5,0.09,0,0,0,1.0472\n"
URDF = """<robot name="bar"><link name="bar"><inertial><mass value="8.0"/>
<inertia ixx="0.002" iyy="0.04" izz="0.04" ixy="0" ixz="0" iyz="0"/></inertial>
<visual><geometry><box size="0.28 0.03 0.03"/></geometry></visual></link></robot>"""


def motions(folder):
    """A CSV table is a file; the others are given in numbers."""
    (folder / "table.csv").write_text(TABLE)
    way = [(0.0, (0.5, 0.05, 0.0), 1.0472), (4.0, (0.54, 0.05, 0.0), 1.2), (8.0, (0.5, 0.1, 0.0), 1.0472)]
    return [
        cp.motions.CircleMotion(pose=START, radius=0.04, angular_rate=1.5),
        cp.motions.TurnMotion(pose=START, axis=UP, angle=0.4, duration=6.0),
        cp.motions.SwingMotion(pose=START, axis=UP, amplitude=0.15, period=2.0),
        cp.motions.WaypointsMotion(
            points=[cp.motions.Waypoint(time=t, xyz=p, rpy=(0.0, 0.0, yaw)) for t, p, yaw in way]
        ),
        cp.motions.CsvMotion(path=str(folder / "table.csv")),
    ]


def payloads(folder):
    """As in a scenario's file, for example ``payload = { kind = "bar", mass = 11.2, length = 0.24 }``."""
    trimesh.creation.box((280.0, 30.0, 30.0)).export(folder / "bar.stl")
    (folder / "bar.urdf").write_text(URDF)
    return [
        {"kind": "bar", "mass": 11.2, "length": 0.28},
        {"kind": "box", "mass": 9.0, "size": [0.28, 0.05, 0.05]},
        {"kind": "cylinder", "mass": 9.0, "radius": 0.14, "length": 0.03},
        {"kind": "mesh", "path": str(folder / "bar.stl"), "density": 7850.0, "scale": 0.001},
        {"kind": "urdf", "path": str(folder / "bar.urdf")},
    ]


if __name__ == "__main__":
    out = Path("out/motions")
    out.mkdir(parents=True, exist_ok=True)
    wrenches = {"left": (-20.0, 0.0, 0.0, 0.0, 0.0, 0.0), "right": (20.0, 0.0, 0.0, 0.0, 0.0, 0.0)}
    squeeze = cp.squeezes.RampSqueeze(goal=wrenches, duration=2.0)
    changes = {
        "start": START,
        "squeeze": squeeze,
        "controller.gains.sign_gain": 0.05,
        "duration": 8.0,
        "events": [],
    }
    print("motion     payload   mass, kg  position error, mm rms  squeeze at the end, N")
    for motion, payload in zip(motions(out), payloads(out), strict=True):
        result = cp.run("adept-paper", {**changes, "motion": motion, "cell.payload": payload})
        force = np.linalg.norm(result.data["internal_wrench"].sel(arm="left", axis=["x", "y"]).values[-1])
        mass, error = result.scenario.cell.payload.mass, 1e3 * result.position_rms(window=(4.0, 8.0))
        print(f"{motion.kind:10} {payload['kind']:9} {mass:8.2f} {error:23.3f} {force:22.2f}")
