"""Constrained dynamics of a cell as scalar code: its arms, the payload, closures and compliant grasps.

The payload is welded to the first arm with a rigid grasp, or free where no grasp is rigid.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from coop_pin.chain.free_flyer import rotation
from coop_pin.compiled.plant.arm_dynamics import (
    ArmNumbers,
    ArmResponse,
    factor,
    shared_terms,
    solve_lower,
    solve_transposed,
)
from coop_pin.compiled.plant.cell_numbers import CellNumbers
from coop_pin.compiled.plant.closures import closure_error, closure_forces, error_sizes
from coop_pin.compiled.plant.serial_arm import (
    Numbers,
    RigidInertia,
    cross,
    force_cross,
    join,
)
from coop_pin.description.events import Surroundings
from coop_pin.grasps.observation import Observation, PayloadState, payload_quantities
from coop_pin.grasps.spring_damper import MovingFrame, SpringState, spring_state
from coop_pin.model.joint_stops import stop_quantities
from coop_pin.tracing.kernel import Kernel
from coop_pin.tracing.tape import Number
from coop_pin.tracing.traced_array import plain, traced
from coop_pin.tracing.tree import SharedFunctions


class CellMotion(NamedTuple):
    """Accelerations and forces of a cell at a state, and what is observed of it.

    Attributes:
        rates: accelerations of all joints and of a free payload, then powers in the order of the works; those
            of changes are done at instants only, shape (nv + works,).
        closure_errors: distance and angle between tip and grasp, shape (m, 2).
        moment: first moment of arms and payload about the world's origin, kg m, shape (3,).
        observation: quantities of the cell. Poses are without their last row, shape (3, 4); the deflections
            of the n compliant grasps are poses of their tips, shape (n, 3, 4), their wrenches those of these
            grasps alone, shape (n, 6). Of wrenches by closures only the moving rows are determined.
    """

    rates: Numbers
    closure_errors: Numbers
    moment: Numbers
    observation: Observation


class CellState(NamedTuple):
    """State of a cell, and the forces that its drives hold.

    Attributes:
        q: joint positions of all arms, then position and quaternion of a free payload, shape (N,) or
            (N + 7,).
        v: joint rates of all arms, then twist of a free payload in its own axes, shape (N,) or (N + 6,).
        force: generalised force of the drives, N m, shape (N,).
    """

    q: Numbers
    v: Numbers
    force: Numbers

    @classmethod
    def of(cls, kernel: Kernel) -> CellState:
        """Return the state in a kernel's slots."""
        return cls(*map(kernel.read, cls._fields))


def cell_motion(functions: SharedFunctions, cell: CellNumbers, state: CellState) -> CellMotion:
    """Return the constrained motion of a cell under drives, friction, compliant grasps and surroundings.

    With G_i and b_i of ArmResponse, 0 the arm that carries the payload, and about the world's origin the
    payload wrench W and f_i on arm i by the payload, f_c on those with compliant grasps::

        G_i f_i + b_i + d_i = b_0 + G_0 (W - sum_c f_c - sum_j f_j),   i, j with closures
        d_i = (V_i - V_0) x V_i + 2 zeta omega (V_i - V_0) + omega^2 e_i

    f_0 follows from the balance of the payload. Where no grasp is rigid, W - sum_c f_c moves the payload.

    Args:
        functions: Shared functions of the arms.
        cell: Constants of the cell.
        state: traced.
    """
    acting, (q, v, force) = cell.surroundings, map(cell.by_arm, state)
    payload, gravity = RigidInertia(acting.mass, np.zeros(3), acting.inertia), acting.gravity
    resistance = [friction.force(rates) for friction, rates in zip(cell.friction, v, strict=True)]
    tau = [drives + losses for drives, losses in zip(force, resistance, strict=True)]
    stopped = [each and each.state(*arm) for each, *arm in zip(cell.stops, q, v, strict=True)]
    tau = [force if stop is None else force + stop.force for force, stop in zip(tau, stopped, strict=True)]
    rows = cell.moving_rows(q)
    terms = _responses(functions, cell, cell.arm_inputs(payload, q, v, tau), rows)
    R, p, V = body = _payload_frame(cell, terms, state)
    V_WP = join(V[:3] + cross(V[3:], p), V[3:])
    # F_P is the whole wrench on the payload besides gravity, about P in world axes. One that depends on R, p
    # and V_WP is added here and to PinocchioPlant.payload_wrench, and Surroundings.acts is true then.
    F_P = acting.push
    W = join(F_P[:3], F_P[3:] + cross(p, F_P[:3]))
    springs = _spring_states(cell, terms, body)
    errors = {i: closure_error(R, p, terms[i].R_WP, terms[i].p_WP) for i in cell.closed}
    F = {i: spring.on_body for i, spring in springs.items()}
    F |= closure_forces(cell, terms, W - sum(F.values(), np.zeros(6)), errors, rows)
    total = W - sum((F[i] for i in sorted(F)), np.zeros(6))
    accelerations = [
        arm.acceleration_under(F[i]) if i in springs else arm.acceleration(F.get(i, total)[rows])
        for i, arm in enumerate(terms)
    ]
    if cell.carrier is None:
        rates_P = state.v[cell.joints :]
        accelerations.append(_free_acceleration(acting, body, total, rates_P))
    else:
        moved, arm = payload.moved(R, p), terms[cell.carrier]
        A = arm.A + arm.S @ accelerations[cell.carrier]
        F[cell.carrier] = total - (moved.times(A) + force_cross(V, moved.times(V)))
    rates = state.v[: cell.joints]
    powers = {
        "work_actuation": state.force @ rates,
        "work_friction": traced(np.concatenate(resistance)) @ rates,
        "work_external": F_P @ V_WP,
        "work_payload_change": 0.0,
        "work_grasps": sum((spring.power for spring in springs.values()), 0.0),
        "work_stops": sum((stop.power for stop in stopped if stop is not None), 0.0),
    }
    tips = np.stack([arm.p_WP + arm.R_WP @ tip for arm, tip in zip(terms, cell.tips, strict=True)])
    energies: dict[str, Any] = {
        "kinetic_energy": sum((arm.kinetic for arm in terms), 0.0),
        "potential_energy": sum((-1.0 * (arm.moment @ plain(gravity)) for arm in terms), 0.0),
    }
    motion = CellMotion(
        rates=np.concatenate((*accelerations, [powers[name] for name in cell.works])),
        closure_errors=error_sizes(errors, tips),
        moment=sum((arm.moment for arm in terms), np.zeros(3)),
        observation=Observation(
            **payload_quantities(PayloadState(_pose_rows(R, p), V_WP, F_P, acting)),
            **energies,
            tip_position=tips,
            interaction_wrench=np.stack([join(F[i][:3], F[i][3:] - cross(p, F[i][:3])) for i in sorted(F)]),
            **(_spring_quantities(cell, springs) if springs else {}),
            **stop_quantities(stopped, [len(arm.bodies) for arm in cell.arms]),
        ),
    )
    return motion if cell.carrier is not None else _with_payload(motion, acting)


def _responses(
    functions: SharedFunctions, cell: CellNumbers, inputs: Sequence[Any], rows: Sequence[int]
) -> list[ArmResponse]:
    """Return G_i and b_i of every arm: in the rows of the task where its grasp is rigid, else in all."""
    kept, gravity = "".join(map(str, rows)), cell.surroundings.gravity
    return [
        shared_terms(
            functions, ArmNumbers(arm, gravity, kept if grasp is None else ""), one, in_place=len(rows) < 6
        )
        for arm, grasp, one in zip(cell.arms, cell.grasps, inputs, strict=True)
    ]


def _payload_frame(cell: CellNumbers, terms: Sequence[ArmResponse], state: CellState) -> MovingFrame:
    """Return the payload frame: by the arm that carries it, or of the free payload."""
    if cell.carrier is not None:
        arm = terms[cell.carrier]
        return MovingFrame(arm.R_WP, arm.p_WP, arm.V)
    (p, quaternion), V_P = np.split(state.q[cell.joints :], [3]), state.v[cell.joints :]
    R = rotation(quaternion)
    v, w = R @ V_P[:3], R @ V_P[3:]
    return MovingFrame(R, p, join(v + cross(p, w), w))


def _spring_states(
    cell: CellNumbers, terms: Sequence[ArmResponse], body: MovingFrame
) -> dict[int, SpringState]:
    """Return the states of the compliant grasps by their arms."""
    tips = {i: MovingFrame(terms[i].R_WP, terms[i].p_WP, terms[i].V) for i in cell.compliant}
    return {
        i: spring_state(grasp.spring, _fixed(tips[i], grasp.X_PE), _fixed(body, grasp.X_PG))
        for i, grasp in cell.compliant.items()
    }


def _fixed(body: MovingFrame, X: Numbers) -> MovingFrame:
    """Return the frame at a pose on a body, shape (4, 4)."""
    R, p, V = body
    return MovingFrame(R @ plain(X[:3, :3]), p + R @ plain(X[:3, 3]), V)


def _free_acceleration(acting: Surroundings, body: MovingFrame, W: Numbers, V_P: Numbers) -> Numbers:
    """Return the rate of a free payload's twist in its own axes, shape (6,).

    m (v' + w x v) = R^T (f + m g),  I w' + w x I w = R^T n

    Args:
        acting: Payload and gravity.
        body: Payload frame.
        W: Wrench on the payload about the world's origin without gravity, [f, n + p x f].
        V_P: Twist v, w in axes of the payload.
    """
    R, p, _ = body
    (v, w), inertia, f = (V_P[:3], V_P[3:]), plain(acting.inertia), W[:3]
    linear = R.T @ (f / acting.mass + plain(acting.gravity)) - cross(w, v)
    moment = R.T @ (W[3:] - cross(p, f)) - cross(w, inertia @ w)
    L, D_inverse = factor(inertia)
    return join(linear, solve_transposed(L, D_inverse * solve_lower(L, moment)))


def _pose_rows(R: Numbers, p: Numbers) -> Any:
    """Return the first three rows of a pose, shape (3, 4)."""
    return traced(np.concatenate((R, p[:, None]), axis=1))


def _spring_quantities(cell: CellNumbers, springs: Mapping[int, SpringState]) -> dict[str, Any]:
    """Return the quantities of the compliant grasps by name, see CellMotion."""
    states = {i: (spring.position[None], spring.rotation[None]) for i, spring in springs.items()}
    return {
        "elastic_energy": sum(
            (grasp.spring.energy(*states[i])[0] for i, grasp in cell.compliant.items()), 0.0
        ),
        "grasp_deflection": [_pose_rows(spring.rotation, spring.position) for spring in springs.values()],
        "grasp_wrench": [spring.wrench for spring in springs.values()],
    }


def _with_payload(motion: CellMotion, acting: Surroundings) -> CellMotion:
    """Return a motion with energies and first moment of the free payload."""
    arms = motion.observation
    kinetic, potential = _payload_energies(acting, arms)
    return motion._replace(
        moment=motion.moment + acting.mass * arms.payload_pose[:, 3],
        observation=arms._replace(
            kinetic_energy=arms.kinetic_energy + kinetic, potential_energy=arms.potential_energy + potential
        ),
    )


def energy_gain(before: Surroundings, after: Surroundings, motion: CellMotion) -> Number:
    """Return the energy that other surroundings add, J: of the payload, and of the arms in another gravity.

    Args:
        before: Surroundings until now.
        after: Surroundings from now on.
        motion: Motion in those until now.
    """
    arms = motion.moment - before.mass * motion.observation.payload_pose[:, 3]
    now, then = (sum(_payload_energies(each, motion.observation)) for each in (before, after))
    return then - now - arms @ plain(after.gravity - before.gravity)


def _payload_energies(surroundings: Surroundings, observation: Observation) -> tuple[Number, Number]:
    """Return kinetic and potential energy of the payload, J."""
    X_WP, V_WP, mass = observation.payload_pose, observation.payload_twist, surroundings.mass
    v, w_P = V_WP[:3], X_WP[:, :3].T @ V_WP[3:]
    kinetic: Any = 0.5 * (mass * (v @ v) + w_P @ (surroundings.inertia @ w_P))
    weight: Any = mass * (surroundings.gravity @ X_WP[:, 3])
    return kinetic, -weight
