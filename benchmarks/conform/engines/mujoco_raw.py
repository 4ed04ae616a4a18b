"""MuJoCo: welds between sites, two connects for a hinge."""

import mujoco
import numpy as np
from cases import Case
from engine import cell_urdf, in_payload_axes, joints, spring, start

H, SOLREF, SOLIMP, TORQUES = 1e-3, 2.0, 0.9999, 100.0


class Mujoco:
    """Hands and payload in one tree, with the dense Jacobian."""

    name = f"MuJoCo {mujoco.__version__}"
    settings = f"Euler, {H:g} s; solref {SOLREF:g} steps, solimp {SOLIMP:g}, torquescale {TORQUES:g}, dense"
    reading = "`efc_J`^T `efc_force` of a grasp's rows at the payload's joints, as a wrench by `mj_jacBody`"

    def wrenches(self, case: Case) -> np.ndarray:
        spec, rows, hands = mujoco.MjSpec.from_string(cell_urdf(case)), [], list(enumerate(case.hands))
        spec.compiler.boundmass = spec.compiler.boundinertia = 1e-12
        spec.compiler.fusestatic = False
        option = spec.option
        option.timestep, option.gravity, option.tolerance, option.iterations = H, case.gravity, 1e-15, 200
        option.integrator = mujoco.mjtIntegrator.mjINT_EULER
        option.jacobian = mujoco.mjtJacobian.mjJAC_DENSE
        option.disableflags |= mujoco.mjtDisableBit.mjDSBL_LIMIT
        for k, hand in hands:
            is_weld, quat, along = hand.grasp == "rigid", np.zeros(4), np.zeros(3)
            mujoco.mju_mat2Quat(quat, hand.rotation.ravel())
            for z in {"rigid": (0.0,), "hinge": (-0.1, 0.1), "spring": ()}[hand.grasp]:
                mujoco.mju_rotVecQuat(along, np.array((0.0, 0.0, z)), quat)
                spec.body("payload").add_site(name=f"grasp{k}{z}", pos=along + hand.tip, quat=quat)
                spec.body(f"hand{k}_tip").add_site(name=f"tip{k}{z}", pos=(0.0, 0.0, z))
                each = spec.add_equality(
                    objtype=mujoco.mjtObj.mjOBJ_SITE, name1=f"grasp{k}{z}", name2=f"tip{k}{z}"
                )
                each.type = mujoco.mjtEq.mjEQ_WELD if is_weld else mujoco.mjtEq.mjEQ_CONNECT
                each.solref, each.solimp = [SOLREF * H, 1.0], [SOLIMP, SOLIMP, 1e-3, 0.5, 2.0]
                each.data[10] = TORQUES
                rows += [k] * (6 if is_weld else 3)
        model = spec.compile()
        data, P = mujoco.MjData(model), model.body("payload").id
        for name, value in start(case).items():
            data.qvel[model.joint(name).dofadr] = value
        at = [[model.joint(name).dofadr[0] for name in joints(hand, f"hand{k}")] for k, hand in hands]
        sprung = np.zeros((len(hands), 6))

        def moving(body: int) -> tuple:
            """Position, rotation and twist of a body, and its Jacobian."""
            J = np.zeros((6, model.nv))
            mujoco.mj_jacBody(model, data, J[:3], J[3:], body)
            return data.xpos[body], data.xmat[body].reshape(3, 3), J @ data.qvel, J

        def drive(*_: object) -> None:
            """In every stage of the integrator."""
            data.qfrc_applied[:] = 0.0
            for k, hand in hands:
                data.qfrc_applied[at[k]] += hand.force(data.qpos[at[k]], data.qvel[at[k]])
                if hand.grasp == "spring":
                    tip, payload = moving(model.body(f"hand{k}_tip").id), moving(P)
                    F = spring(hand, tip[:3], payload[:3])
                    data.qfrc_applied += tip[3].T @ F.on_tip + payload[3].T @ F.on_payload
                    sprung[k] = F.on_payload

        mujoco.set_mjcb_control(drive)
        try:
            mujoco.mj_step(model, data, round(case.time / H))
            mujoco.mj_forward(model, data)
        finally:
            mujoco.set_mjcb_control(None)
        E, rows, own = data.efc_J.reshape(-1, model.nv), np.array(rows), model.jnt_bodyid >= P - 5
        _, R_P, _, J = moving(P)
        for k in set(rows.tolist()):
            f = E[rows == k].T @ data.efc_force[rows == k]
            sprung[k] += np.linalg.solve(J[:, own].T, f[own])
        return in_payload_axes(sprung, R_P)
