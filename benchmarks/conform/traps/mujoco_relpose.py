"""MuJoCo, weld of two bodies: with an anchor, `relpose` is the anchor in body 1, not the pose of body 2."""

import mujoco

BODY = '<body pos="{0} 0 0" name="{1}"><freejoint/><geom size=".1"/></body>'
BODIES = BODY.format(0, "a") + BODY.format(1, "b")
for x in (1.0, 0.8):  # of body 2, at rest as it stands; of the anchor, 0.2 m before it
    weld = f'<weld body1="a" body2="b" anchor="-0.2 0 0" relpose="{x} 0 0 1 0 0 0"/>'
    text = f"<mujoco><worldbody>{BODIES}</worldbody><equality>{weld}</equality></mujoco>"
    data = mujoco.MjData(model := mujoco.MjModel.from_xml_string(text))
    mujoco.mj_forward(model, data)
    print("comes:" if x == 1.0 else "right:", "gap", data.efc_pos[:3].round(9).tolist(), "m")
