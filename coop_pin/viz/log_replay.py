"""Record of a log as a run, with what its arms saw and their wrists read, for the replay of a run."""

from __future__ import annotations

import numpy as np

from coop_pin.base.arrays import Array
from coop_pin.description.scenario import Scenario
from coop_pin.identification.answer import Blame
from coop_pin.identification.filtering import filtered
from coop_pin.identification.payload import hand_weight
from coop_pin.model.cell_arm import CellArm
from coop_pin.model.cell_model import CellModel
from coop_pin.model.joint_limits import JointLimits, limit_table
from coop_pin.results.dataset import dataset
from coop_pin.results.energies import work_names
from coop_pin.results.quantities import quantities
from coop_pin.results.quantity import Samples, allocate
from coop_pin.results.run_result import RunResult

_SPACING = 0.15
"""Distance of the frames, in windows of the filter: 30 ms."""


def logged_run(answer: Blame) -> RunResult:
    """Return the record of an answer as a run, from the time on at which the arms hold the payload.

    The payload is where the first arm sees it. Wrenches are filtered, at the clocks and without the zeros
    that were found. What is not logged is zero; the desired pose is then that which is seen.

    Args:
        answer: answer with estimates of the wrists, of a cell without shared joints.
    """
    closure, kinematics = answer.fitted
    filtered_arms = filtered(answer.record, kinematics.late, _SPACING)
    arms = [CellArm(answer.scenario.cell, name) for name in filtered_arms]
    time = next(iter(filtered_arms.values())).time
    changes = {"events": (), "network": None, "duration": float(time[-1] - time[0])}
    scenario = answer.scenario.replace(**changes).with_ideal_sensors
    model, joints = CellModel(scenario.cell, scenario.plant.payload), max(arm.nv for arm in arms)
    sizes = dict.fromkeys(("shared", "base", "payload_joint"), 0)
    sizes["patch"] = len(scenario.cell.patches) + len(scenario.cell.tables)
    sizes |= {"arm": len(arms), "joint": joints, "q": model.model.nq, "v": model.model.nv}
    samples = allocate(quantities(scenario), len(time), sizes)
    samples["configuration"][:] = np.eye(model.model.nq)[-1]  # a free payload, which is last, does not turn
    limits, jacobians = [JointLimits(scenario.cell.arms[arm.name], arm.name) for arm in arms], []
    for k, (arm, slot) in enumerate(zip(arms, model.arms, strict=True)):
        one = filtered_arms[arm.name]
        entries = np.array([arm.configuration(angles) for angles in one.q])
        samples["configuration"][:, slot.q_slice] = entries
        if k == 0:
            _fill(samples, answer, scenario, time, closure.view(arm.name, time).pose)
        samples["tip_position"][:, k] = [arm.tip_pose(q)[:3, 3] for q in entries]
        samples["torque"][:, k, : arm.nv] = one.tau @ arm.from_drive
        wrench = (
            one.wrench - _zero(answer, arm.name) - hand_weight(answer.scenario, arm, one.q, answer.payload)
        )
        X_PE = closure.tip(arm.name, time + kinematics.late.get(arm.name, 0.0))
        X_WP = samples["payload_pose"]
        samples["interaction_wrench"][:, k] = _about_payload(wrench, X_WP @ X_PE, X_WP)
        jacobians.append(np.array([arm.task_jacobian(q) for q in entries]))
    each = filtered_arms.values()
    samples |= {"angles": [one.q for one in each], "rates": [one.v for one in each]}
    samples |= {"drive": [arm.drive for arm in arms], "jacobian": jacobians}
    data = dataset(scenario, samples, [slot.joint_names for slot in model.arms], limit_table(limits, joints))
    return RunResult(scenario, data.assign_attrs({RunResult.ENGINE: RunResult.LOGGED}))


def _fill(samples: Samples, answer: Blame, scenario: Scenario, time: Array, X_WP: Array) -> None:
    """Fill in what is of no single arm: payload, reference and squeeze; zeros for energies and closures."""
    record = answer.record
    samples["time"][:], samples["payload_pose"][:], samples["desired_pose"][:] = time - time[0], X_WP, X_WP
    if last := len(record.desired_time):
        nearest = np.minimum(np.searchsorted(record.desired_time, time), last - 1)
        samples["desired_pose"][:] = record.desired[nearest]
    for name in ("payload", "desired"):
        samples[f"{name}_twist"][:] = 0.0
        samples[f"{name}_twist"][:, :3] = np.gradient(samples[f"{name}_pose"][:, :3, 3], time, axis=0)
    grasps = scenario.cell.grasps
    samples["desired_squeeze"][:] = [scenario.squeeze.at(t, grasps) for t in samples["time"].tolist()]
    if "load_share" in samples:  # of grasps that give
        samples["load_share"][:] = scenario.cell.shares
    samples |= {name: np.zeros(len(time)) for name in work_names(False, False)}
    for name in (
        "external_wrench",
        "closure_distance",
        "closure_angle",
        "kinetic_energy",
        "potential_energy",
    ):
        samples[name][:] = 0.0


def _zero(answer: Blame, name: str) -> Array:
    """Return the estimate of the zero of an arm's wrist, shape (6,)."""
    fit = answer.payload
    return np.zeros(6) if fit is None else np.asarray(fit.x[fit.of(name, "wrist")])


def _about_payload(wrench: Array, X_WE: Array, X_WP: Array) -> Array:
    """Return wrenches in axes of a tip as wrenches about P in world axes, shape (n, 6)."""
    force, moment = (np.einsum("nij,nj->ni", X_WE[:, :3, :3], part) for part in np.hsplit(wrench, 2))
    return np.hstack((force, moment + np.cross(X_WE[:, :3, 3] - X_WP[:, :3, 3], force)))
