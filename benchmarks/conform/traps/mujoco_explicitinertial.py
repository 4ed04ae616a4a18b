"""MuJoCo, MjSpec: without `ipos` the centre of mass is the body's `pos`, in axes of the body."""

import mujoco

for inertial in ({}, {"ipos": [0, 0, 0]}):
    spec = mujoco.MjSpec()
    body = spec.worldbody.add_body(pos=[0.0, 0.2, 0.3], mass=5.0, inertia=[0.1, 0.1, 0.1], **inertial)
    body.explicitinertial = True
    print("right:" if inertial else "comes:", spec.compile().body_ipos[1].tolist())
