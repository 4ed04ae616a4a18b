"""MuJoCo, soft constraints: at the start a weld bears only its impedance's part of a load, then all of it."""

import mujoco

BODY = '<body name="a"><joint type="slide" axis="1 0 0"/><geom size=".1"/></body>'
text = f'<mujoco><worldbody>{BODY}</worldbody><equality><weld body1="a"/></equality></mujoco>'
data = mujoco.MjData(model := mujoco.MjModel.from_xml_string(text))
data.qfrc_applied[:] = 10.0  # N
mujoco.mj_forward(model, data)
print("comes:", data.qfrc_constraint[0].round(4), "N")
mujoco.mj_step(model, data, 1000)
print("right:", data.qfrc_constraint[0].round(4), "N")
