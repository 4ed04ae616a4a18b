"""Pinocchio, reader of MJCF: the first body of the world is kept, the others vanish in silence."""

import tempfile
from pathlib import Path

import pinocchio as pin

INERTIAL = '<inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>'
BODY = f'<body name="{{0}}"><joint name="{{0}}" axis="0 0 1"/>{INERTIAL}</body>'
BODIES = "".join(map(BODY.format, "abc"))
for name, world in (("comes:", BODIES), ("right:", f'<body name="all">{BODIES}</body>')):
    with tempfile.TemporaryDirectory() as folder:
        (file := Path(folder) / "model.xml").write_text(f"<mujoco><worldbody>{world}</worldbody></mujoco>")
        print(name, "nv", pin.buildModelFromMJCF(str(file)).nv)
