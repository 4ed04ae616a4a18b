"""coop_pin: a cell on its plant, by Pinocchio."""

import tempfile
from pathlib import Path

import numpy as np
from cases import Case
from engine import RefusedError, hand_urdf, in_payload_axes, robot

import coop_pin as cp
from coop_pin.simulation.pinocchio_plant import PinocchioPlant

RATE, STEPS = 1000.0, 2


class Drives(cp.CellController):
    """Drives of the hands."""

    def __init__(self, case: Case) -> None:
        self.hands = case.hands

    def init(self, *_: object) -> None:
        return None

    def step(self, measurements, references, state):
        seen = zip(self.hands, measurements, strict=True)
        return cp.CellCommand([hand.force(each.q, each.v) for hand, each in seen], None)


class CoopPin:
    """Plant of Pinocchio."""

    name = f"coop_pin {cp.__version__}"
    settings = f"RK4, {1 / RATE / STEPS:g} s, torques held over {1 / RATE:g} s; plant as shipped"
    reading = "`interaction_wrench`: on the arm by the payload, about P, in world axes"
    plant = PinocchioPlant

    def wrenches(self, case: Case) -> np.ndarray:
        with tempfile.TemporaryDirectory() as folder:
            return self.cell(case, Path(folder))

    def cell(self, case: Case, folder: Path) -> np.ndarray:
        arms, grasps = {}, {}
        for k, hand in enumerate(case.hands):
            file = folder / f"hand{k}.urdf"
            file.write_text(robot(hand_urdf(hand, "hand")))
            base, posture = cp.Pose(xyz=hand.tip), (0.0,) * len(hand.guides)
            free = {"friction": "none", "torque_limits": "none"}
            arms[f"hand{k}"] = cp.Arm(urdf=str(file), tip="hand_tip", base=base, posture=posture, **free)
            kinds = {"spring": {"kind": "compliant", "stiffness": hand.spring, "damping": hand.damper}}
            kinds |= {"hinge": {"kind": "hinge"}, "rigid": {}}
            grasps[f"hand{k}"] = {"xyz": hand.tip, "rpy": hand.rpy} | kinds[hand.grasp]
        payload = cp.Payload(mass=case.mass, inertia=(*case.inertia, 0.0, 0.0, 0.0))
        rows = {"rows": "planar"} if case.is_planar else {}
        cell = cp.Cell(arms=arms, payload=payload, grasps=grasps, gravity=tuple(case.gravity), **rows)
        scenario = cp.Scenario(
            name="case",
            cell=cell,
            start=cp.Pose(),
            start_angles={name: arm.posture for name, arm in arms.items()},
            motion=cp.motions.HoldMotion(pose=cp.Pose()),
            controller=cp.UserController(target=Drives),
            clock=cp.Clock(rate_hz=RATE, steps_per_tick=STEPS),
            duration=case.time,
        )
        try:
            run = cp.Simulation(scenario, Drives(case), plant=self.plant)
        except cp.CoopPinError as error:
            raise RefusedError(str(error)) from None
        rates = np.concatenate([case.start_rates(hand) for hand in case.hands])
        v = np.zeros_like(run.plant.v)
        v[: len(rates)] = rates
        run.plant.restore(run.plant.state()._replace(v=v))
        for _ in range(round(case.time * RATE)):
            run.tick()
        return in_payload_axes(-run.plant.interaction_wrenches(), run.plant.payload_pose()[:3, :3])
