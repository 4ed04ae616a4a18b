"""Planar cell on MuJoCo, with the numbers, controller, clock and events of a scenario of coop_pin.

Tuned for closed chains: RK4, payload merged into the first arm's tree, one weld, solimp 0.9999, solref a few
steps (without refsafe, which would keep it at two or more). Torques act through motors on fixed tendons whose
coefficients are the rows of the drive matrix T; viscous friction is the damping of these tendons, so both act
in drive coordinates. Coulomb friction is zero (MuJoCo models it as a constraint).
"""

from __future__ import annotations

from typing import NamedTuple

import mujoco
import numpy as np

import coop_pin as cp
from coop_pin import CellController, Simulation
from coop_pin.base.spatial import inverse_pose
from coop_pin.description.cell.arm import Arm
from coop_pin.model import ArmModel

SOLIMP = "0.9999 0.9999 0.001 0.5 2"


class Recorded(NamedTuple):
    """Recorded quantities of a run, one row for each tick.

    Attributes:
        position: of the payload, m.
        angle: of the payload about z, rad.
        internal_wrench: of the second arm (x, y, about z), N and N m.
        gap_m: closure error, m.
        gap_rad: closure error, rad.
    """

    position: np.ndarray
    angle: np.ndarray
    internal_wrench: np.ndarray
    gap_m: np.ndarray
    gap_rad: np.ndarray


def numbers(values) -> str:
    return " ".join(repr(float(value)) for value in np.ravel(values))


def arm_xml(name: str, arm: Arm, held: str) -> str:
    """Return the bodies of an arm, from the joint frames and inertias of its Pinocchio model."""
    model = ArmModel(arm).model
    inner = held
    for joint in range(model.njoints - 1, 0, -1):
        place, inertia = model.jointPlacements[joint], model.inertias[joint]
        assert np.allclose(place.rotation, np.eye(3)), "the planar arms' joint frames are parallel"
        assert model.joints[joint].shortname() == "JointModelRZ"
        (xx, xy, xz), (_, yy, yz), (_, _, zz) = inertia.inertia
        inner = f"""<body name="{name}{joint}" pos="{numbers(place.translation)}">
            <joint name="{name}{joint}" axis="0 0 1"/>
            <inertial pos="{numbers(inertia.lever)}" mass="{inertia.mass}"
                fullinertia="{numbers((xx, yy, zz, xy, xz, yz))}"/>{inner}</body>"""
    return inner


def drives_xml(name: str, arm: Arm) -> tuple[str, str]:
    """Return tendons and motors of an arm's drives."""
    T = arm.drive_matrix(len(arm.drive))
    tendons, motors = "", ""
    for row, damping in enumerate(np.broadcast_to(arm.friction.viscous, len(T))):
        joints = "".join(f'<joint joint="{name}{k + 1}" coef="{c}"/>' for k, c in enumerate(T[row]) if c)
        tendons += f'<fixed name="{name}_drive{row}" damping="{damping}">{joints}</fixed>'
        motors += f'<motor tendon="{name}_drive{row}"/>'
    return tendons, motors


def mjcf(scenario: cp.Scenario, step: float, solref_steps: float) -> str:
    """Return the model of a planar cell of two arms."""
    cell, payload = scenario.cell, scenario.cell.payload
    (first, left), (second, right) = cell.arms.items()

    def tip_translation(arm: Arm) -> np.ndarray:
        model = ArmModel(arm).model
        return model.frames[model.getFrameId(f"arm/{arm.tip}")].placement.translation

    X_EP = inverse_pose(cell.grasps[first].matrix)
    bar = f"""<body name="payload" pos="{numbers(tip_translation(left) + X_EP[:3, 3])}">
        <inertial pos="0 0 0" mass="{payload.mass}" diaginertia="{numbers(payload.inertia[:3])}"/>
        <site name="grasp" pos="{numbers(cell.grasps[second].matrix[:3, 3])}"/></body>"""
    tip = f'<site name="tip" pos="{numbers(tip_translation(right))}"/>'
    (tendons_1, motors_1), (tendons_2, motors_2) = drives_xml(first, left), drives_xml(second, right)
    return f"""<mujoco>
        <option integrator="RK4" timestep="{step!r}" gravity="{numbers(cell.gravity)}" tolerance="1e-15">
        <flag contact="disable" limit="disable" frictionloss="disable" clampctrl="disable" refsafe="disable"/>
        </option>
        <worldbody>{arm_xml(first, left, bar)}{arm_xml(second, right, tip)}</worldbody>
        <tendon>{tendons_1}{tendons_2}</tendon><actuator>{motors_1}{motors_2}</actuator>
        <equality>
        <weld site1="grasp" site2="tip" solref="{solref_steps * step!r} 1" solimp="{SOLIMP}"/></equality>
        </mujoco>"""


class MujocoRun:
    """Run of a scenario on MuJoCo's plant, with coop_pin's clock, references, sensing and controller."""

    def __init__(self, scenario: cp.Scenario, controller: CellController, solref_steps: float = 2.0) -> None:
        self.loop, self.controller = Simulation(scenario, controller), controller
        self.steps = scenario.clock.steps_per_tick
        self.model = mujoco.MjModel.from_xml_string(
            mjcf(scenario, scenario.clock.period / self.steps, solref_steps)
        )
        self.data = mujoco.MjData(self.model)
        self.data.qpos[:] = self.loop.plant.q
        self.loop.plant.q, self.loop.plant.v = (
            self.data.qpos,
            self.data.qvel,
        )  # live: the sensors see MuJoCo's state
        self.bar = self.model.body("payload").id

    def run(self) -> Recorded:
        """Run and record poses and forces at every tick."""
        loop, model, data, state, samples = self.loop, self.model, self.data, None, []
        applied = None
        for tick, signals in zip(range(loop.timeline.ticks + 1), loop.signals(), strict=False):
            t = loop.timeline.time(tick)
            references = loop.references(t)
            measurements = (
                loop.sensing.measure(t, loop.plant, applied, signals.sensors)
                if applied
                else loop.sensing.start(loop.plant.q, loop.plant.v, references, signals.sensors)
            )
            self._happen(t)
            state = self.controller.init(measurements, references) if state is None else state
            command = self.controller.step(measurements, references, state)
            applied, state = loop.actuation.apply(t, command, signals.missed), command.state
            data.ctrl[:] = np.concatenate(applied.torques)
            samples.append(self._sample(measurements[1].payload_jacobian))
            mujoco.mj_step(model, data, self.steps)
        return self._recorded(*(np.array(column) for column in zip(*samples, strict=True)))

    def _sample(self, J: np.ndarray) -> tuple[np.ndarray, ...]:
        """Return the arguments of _recorded at the present state and forces."""
        model, data, bar, acceleration = self.model, self.data, self.bar, np.zeros(6)
        mujoco.mj_forward(model, data)
        mujoco.mj_rnePostConstraint(model, data)
        mujoco.mj_objectAcceleration(
            model, data, mujoco.mjtObj.mjOBJ_BODY, bar, acceleration, 0
        )  # angular first
        mass, inertia, push = model.body_mass[bar], model.body_inertia[bar, 2], data.xfrc_applied[bar]
        balance = np.array(
            (
                mass * acceleration[3] - push[0],
                mass * acceleration[4] - push[1],
                inertia * acceleration[2] - push[5],
            )
        )
        seen = data.qfrc_constraint[3:], data.xpos[bar], data.xmat[bar], data.site_xpos, data.site_xmat
        return J, balance, *(live.copy() for live in seen)

    def _recorded(self, J, balance, joint_forces, bar, bar_frame, sites, site_frames) -> Recorded:
        """Return the recorded quantities from the samples.

        Only the weld constrains the second arm: qfrc = (J T)^T F_2; and F_1 + F_2 = -balance.
        """
        cell = self.loop.scenario.cell
        J_joints = J @ list(cell.arms.values())[1].drive_matrix(3)
        F_2 = np.linalg.solve(np.swapaxes(J_joints, 1, 2), joint_forces[..., None])[..., 0]
        R_1, R_2 = np.moveaxis(site_frames.reshape(-1, 2, 3, 3), 1, 0)
        turn = np.swapaxes(R_1, 1, 2) @ R_2
        return Recorded(
            position=bar,
            angle=np.arctan2(bar_frame[:, 3], bar_frame[:, 0]),
            internal_wrench=F_2 + cell.shares[1] * balance,
            gap_m=np.linalg.norm(sites[:, 1] - sites[:, 0], axis=1),
            gap_rad=np.arcsin(np.linalg.norm(turn - np.swapaxes(turn, 1, 2), axis=(1, 2)) / np.sqrt(8.0)),
        )

    def _happen(self, t: float) -> None:
        """Apply payload changes and pushes; the events of this benchmark coincide with ticks."""
        timeline = self.loop.timeline
        if not timeline.happens_at(t):
            return
        surroundings = self.loop.scenario.surroundings_at(timeline.just_after(t))
        self.model.body_mass[self.bar] = surroundings.mass
        self.model.body_inertia[self.bar] = np.diag(surroundings.inertia)
        mujoco.mj_setConst(self.model, mujoco.MjData(self.model))
        self.data.xfrc_applied[self.bar] = surroundings.push
