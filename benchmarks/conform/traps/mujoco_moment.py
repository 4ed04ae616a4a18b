"""MuJoCo, weld: `efc_force` has twice the moment, with the other sign; J^T f is right."""

import mujoco

BODY = '<body name="a"><joint axis="0 0 1"/><geom size=".1"/></body>'
WELD = '<weld body1="a" solimp=".9999 .9999"/>'
text = f"<mujoco><worldbody>{BODY}</worldbody><equality>{WELD}</equality></mujoco>"
data = mujoco.MjData(model := mujoco.MjModel.from_xml_string(text))
data.qfrc_applied[:] = 1.0  # N m, which the weld bears
mujoco.mj_step(model, data, 1000)
print("comes:", data.efc_force[5].round(4), "N m")
print("right:", (data.efc_J.reshape(6, -1)[:, 0] @ data.efc_force).round(4), "N m")
