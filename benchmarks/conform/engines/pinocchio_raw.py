"""Pinocchio: constraintDynamics with 6-D constraints as welds, RK4 written here."""

import importlib.metadata

import numpy as np
import pinocchio as pin
from cases import Case
from engine import cell_urdf, in_payload_axes, joints, spring, start

H, KP, KD = 1e-3, 400.0, 40.0


class Pinocchio:
    """Hands and payload in one tree; two points on the axis are a hinge."""

    name = f"Pinocchio {importlib.metadata.version('pin')}"
    settings = f"RK4, {H:g} s; Baumgarte Kp {KP:g}, Kd {KD:g}; ProximalSettings(1e-14, 1e-8, 50)"
    reading = (
        "`contact_force` of a constraint's data: on the body of its first joint, in the frame there (LOCAL)"
    )

    def wrenches(self, case: Case) -> np.ndarray:
        model = pin.buildModelFromXML(cell_urdf(case))
        model.gravity.linear = np.array(case.gravity)
        data, P, held, rows = model.createData(), model.getJointId("payload_rz"), [], []
        hands = list(enumerate(case.hands))
        tips = [model.getFrameId(f"hand{k}_tip") for k, _ in hands]
        at = [
            [model.idx_vs[model.getJointId(name)] for name in joints(hand, f"hand{k}")] for k, hand in hands
        ]
        for k, hand in hands:
            tip, is_weld = model.frames[tips[k]], hand.grasp == "rigid"
            kind = pin.ContactType.CONTACT_6D if is_weld else pin.ContactType.CONTACT_3D
            for z in {"rigid": (0.0,), "hinge": (-0.1, 0.1), "spring": ()}[hand.grasp]:
                C = pin.SE3(np.eye(3), np.array((0.0, 0.0, z)))
                X_PC, X_EC = pin.SE3(hand.pose) * C, tip.placement * C
                each = pin.RigidConstraintModel(kind, model, P, X_PC, tip.parentJoint, X_EC, pin.LOCAL)
                each.setBaumgarteCorrectorParameters(pin.BaumgarteCorrectorParameters(KP, KD))
                held.append(each)
                rows.append((k, X_PC))
        models, states = pin.StdVec_RigidConstraintModel(), pin.StdVec_RigidConstraintData()
        for each in held:
            models.append(each)
            states.append(each.createData())
        pin.initConstraintDynamics(model, data, models, states)
        proximal, sprung = pin.ProximalSettings(1e-14, 1e-8, 50), np.zeros((len(hands), 6))

        def moving(frame: int, v: np.ndarray) -> tuple:
            """Position, rotation and twist of a frame, and its Jacobian."""
            J = pin.getFrameJacobian(model, data, frame, pin.LOCAL_WORLD_ALIGNED)
            return data.oMf[frame].translation, data.oMf[frame].rotation, J @ v, J

        def rate(q: np.ndarray, v: np.ndarray) -> np.ndarray:
            tau = np.zeros(model.nv)
            for k, hand in hands:
                tau[at[k]] += hand.force(q[at[k]], v[at[k]])
                if hand.grasp == "spring":
                    pin.computeJointJacobians(model, data, q)
                    pin.updateFramePlacements(model, data)
                    tip, payload = (moving(frame, v) for frame in (tips[k], model.getFrameId("payload")))
                    F = spring(hand, tip[:3], payload[:3])
                    tau += tip[3].T @ F.on_tip + payload[3].T @ F.on_payload
                    sprung[k] = in_payload_axes(F.on_payload, payload[1])
            return pin.constraintDynamics(model, data, q, v, tau, models, states, proximal).copy()

        q, v = np.zeros(model.nq), np.zeros(model.nv)
        for name, value in start(case).items():
            v[model.idx_vs[model.getJointId(name)]] = value
        for _ in range(round(case.time / H)):
            v1, a1 = v, rate(q, v)
            v2, a2 = v + H / 2 * a1, rate(q + H / 2 * v1, v + H / 2 * a1)
            v3, a3 = v + H / 2 * a2, rate(q + H / 2 * v2, v + H / 2 * a2)
            v4, a4 = v + H * a3, rate(q + H * v3, v + H * a3)
            q, v = q + H / 6 * (v1 + 2 * v2 + 2 * v3 + v4), v + H / 6 * (a1 + 2 * a2 + 2 * a3 + a4)
        rate(q, v)
        for (k, X_PC), each in zip(rows, states, strict=True):
            sprung[k] += X_PC.act(each.contact_force).vector
        return sprung
