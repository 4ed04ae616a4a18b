"""MuJoCo, RK4: with a short `solref` the force of a weld that turns reads low, however short the step."""

import mujoco

INERTIAL = '<inertial pos="0 0 0" mass="2" diaginertia=".1 .1 .1"/>'
BODY = '<body pos="{0} 0 0">{1}{4}<site name="{2}" pos="{3} 0 0"/></body>'
HAND = BODY.format(0.25, "<freejoint/>", "b", 0, INERTIAL)
LOAD = BODY.format(0, '<joint axis="0 0 1"/>', "a", 0.25, INERTIAL)
for steps in (2, 8):  # of the time constant; the hand turns at 3 rad/s: 2 kg 0.25 m (3/s)^2 = 4.5 N
    weld = f'<weld site1="a" site2="b" solref="{steps * 1e-4} 1" solimp=".9999 .9999"/>'
    option = '<option timestep="1e-4" integrator="RK4" gravity="0 0 0" jacobian="dense"/>'
    text = f"<mujoco>{option}<worldbody>{LOAD}{HAND}</worldbody><equality>{weld}</equality></mujoco>"
    data = mujoco.MjData(model := mujoco.MjModel.from_xml_string(text))
    data.qvel[:] = 3.0, 0.0, 0.75, 0.0, 0.0, 0.0, 3.0
    mujoco.mj_step(model, data, 1000)
    mujoco.mj_forward(model, data)
    force = sum(data.efc_force[:3] ** 2) ** 0.5
    print("comes:" if steps == 2 else "right:", force.round(3), "N")
