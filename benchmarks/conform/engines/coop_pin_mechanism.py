"""coop_pin: hands and payload as one mechanism with closures."""

import numpy as np
from cases import Case
from engine import RefusedError, cell_urdf, joints, start

import coop_pin as cp

H = 5e-4
ROWS = {"rigid": "full", "hinge": "axis"}


class CoopPinMechanism:
    """Closed chain."""

    name = f"coop_pin {cp.__version__}, ClosedChain"
    settings = f"RK4, {H:g} s; projection onto the closures after each step"
    reading = (
        "`closure_wrenches` of `forward_dynamics`: on the first body of a closure, at its frame, in its axes"
    )

    def wrenches(self, case: Case) -> np.ndarray:
        if "spring" in [hand.grasp for hand in case.hands]:
            raise RefusedError("a mechanism has no compliant grasps")
        hands = [(f"hand{k}", hand) for k, hand in enumerate(case.hands)]
        closures = [
            cp.Closure(f"{name}_tip", "payload", ROWS[hand.grasp], X_BC=hand.pose) for name, hand in hands
        ]
        chain = cp.ClosedChain.from_urdf(cell_urdf(case), closures, gravity=case.gravity)
        number = {name: chain.model.idx_vs[k] for k, name in enumerate(chain.model.names)}
        at = [[number[each] for each in joints(hand, name)] for name, hand in hands]

        def torque(_: float, q: np.ndarray, v: np.ndarray) -> np.ndarray:
            tau = np.zeros(chain.model.nv)
            for index, (_, hand) in zip(at, hands, strict=True):
                tau[index] = hand.force(q[index], v[index])
            return tau

        q, v = chain.configuration({}), chain.velocity(start(case))
        motion = chain.integrate(q, v, duration=case.time, step=H, torque=torque)
        q, v, wrenches = motion.q[-1], motion.v[-1], []
        X_PW = np.linalg.inv(chain.frame_pose(q, "payload"))
        on_tips = chain.forward_dynamics(q, v, torque(case.time, q, v)).closure_wrenches
        for (name, _), w in zip(hands, on_tips, strict=True):
            X_PE = X_PW @ chain.frame_pose(q, f"{name}_tip")
            f, m = -X_PE[:3, :3] @ w[:3], -X_PE[:3, :3] @ w[3:]
            wrenches.append(np.concatenate((f, m + np.cross(X_PE[:3, 3], f))))
        return np.array(wrenches)
