"""Constrained dynamics of a cell as scalar code: its arms, the payload welded to the first, and the closures.

The constraint is that of coop_pin.chain.closure: e = -log6(X_i^-1 X_0) of the payload frames that arm i and
the first arm hold, here in world axes about the world's origin, which takes it to V_i - V_0 = e'.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from coop_pin.batch.arm_dynamics import (
    ArmInput,
    ArmNumbers,
    ArmResponse,
    arm_terms,
    factor,
    solve_lower,
    solve_transposed,
)
from coop_pin.batch.serial_arm import (
    Numbers,
    RigidInertia,
    SerialArm,
    cross,
    force_cross,
    frames,
    join,
    motion_cross,
)
from coop_pin.chain.cell_chain import CellChain
from coop_pin.description.events import Surroundings
from coop_pin.model.transmission import Friction, friction
from coop_pin.tracing.kernel import Kernel
from coop_pin.tracing.tape import Number, Traced
from coop_pin.tracing.traced_array import parts, plain, traced
from coop_pin.tracing.tree import SharedFunctions

_ROTATION = (15.0 / 336.0, 3.0 / 40.0, 1.0 / 6.0, 1.0)
_TRANSLATION = (1.0 / 30240.0, 1.0 / 720.0, 1.0 / 12.0)
"""Series of asin(s) / s in s^2, and of (1 - x / 2 cot(x / 2)) / x^2 in x^2: exact for closed grasps."""


class CellNumbers(NamedTuple):
    """Constants of a cell's dynamics, most of which fold into its code.

    Attributes:
        arms: serial arms of the plant; the payload is not part of the first one's last body.
        tips: position of each tip in the payload frame, m, shape (m, 3).
        position_gain: omega^2 of Baumgarte's stabilisation, 1/s^2.
        velocity_gain: 2 zeta omega, 1/s.
        friction: friction of each arm.
        surroundings: payload, and what acts on it from outside.
    """

    arms: tuple[SerialArm, ...]
    tips: Numbers
    position_gain: Number
    velocity_gain: Number
    friction: tuple[Friction, ...]
    surroundings: Surroundings

    @classmethod
    def from_chain(cls, chain: CellChain) -> CellNumbers:
        """Return the constants of a chain whose payload is welded to the first arm.

        Raises:
            TracingError: an arm is no serial chain.
        """
        tree, cell, model, arms = chain.model, chain.cell, chain.mechanism.model, []
        for slot in tree.arms:
            columns = range(slot.v_slice.start, slot.v_slice.stop)
            joints = [joint for joint in range(1, model.njoints) if model.idx_vs[joint] in columns]
            X_JP = model.frames[slot.tip].placement * pin.SE3(cell.grasps[slot.name].matrix).inverse()
            is_welded = slot.name in tree.closed_by_tree
            last = tree.carrier_inertia if is_welded else model.inertias[joints[-1]]
            arms.append(SerialArm.from_model(model, joints, X_JP, last))
        gains = chain.mechanism.stabilisation
        return cls(
            arms=tuple(arms),
            tips=np.array([cell.grasps[arm].matrix[:3, 3] for arm in cell.arms]),
            position_gain=gains.position_gain,
            velocity_gain=gains.velocity_gain,
            friction=tuple(friction(arm, name) for name, arm in cell.arms.items()),
            surroundings=cell.surroundings,
        )

    def by_arm(self, values: Numbers) -> list[Numbers]:
        """Return the part of each arm of values of all joints or drives."""
        return parts(values, [len(arm.bodies) for arm in self.arms])

    def moving_rows(self, q: Sequence[Numbers]) -> list[int]:
        """Return the rows of world six-vectors that are not zero by structure for every motion of the cell.

        Args:
            q: Joint positions of each arm, traced, shape (n,) each.
        """
        S = np.hstack([frames(arm, positions).S for arm, positions in zip(self.arms, q, strict=True)])
        return [row for row in range(6) if any(isinstance(x, Traced) or x != 0.0 for x in S[row])]


class CellMotion(NamedTuple):
    """Accelerations and forces of a cell at a state, and what is observed of it.

    Attributes:
        rates: accelerations of all joints, then powers in the order of WORK, whose last is done at instants
            only, shape (N + 4,).
        wrenches: F_i on each arm by the payload about P in world axes, shape (m, 6); only the moving rows
            are determined.
        R_WP: orientation of the payload, shape (3, 3).
        p_WP: position of P, shape (3,).
        V_WP: twist of the payload about P, shape (6,).
        payload_wrench: whole wrench on the payload about P in world axes, besides gravity, shape (6,).
        tips: positions of the tips, shape (m, 3).
        closure_errors: distance and angle between tip and grasp, shape (m, 2).
        kinetic: energy, J.
        potential: energy, J.
        moment: first moment of arms and payload about the world's origin, kg m, shape (3,).
    """

    rates: Numbers
    wrenches: Numbers
    R_WP: Numbers
    p_WP: Numbers
    V_WP: Numbers
    payload_wrench: Numbers
    tips: Numbers
    closure_errors: Numbers
    kinetic: Number
    potential: Number
    moment: Numbers


class CellState(NamedTuple):
    """State of a cell, and the forces that its drives hold.

    Attributes:
        q: joint positions of all arms, shape (N,).
        v: joint rates of all arms, shape (N,).
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
    """Return the constrained motion of a cell under drives, friction and surroundings.

    With G_i and b_i of ArmResponse, and about the world's origin the payload wrench W and f_i on arm i by the
    payload::

        G_i f_i + b_i + d_i = b_0 + G_0 (W - sum_j f_j),   i = 1, ..., m - 1
        d_i = (V_i - V_0) x V_i + 2 zeta omega (V_i - V_0) + omega^2 e_i

    f_0 follows from the balance of the payload.

    Args:
        functions: Shared functions of the arms.
        cell: Constants of the cell.
        state: traced.
    """
    acting, (q, v, force) = cell.surroundings, map(cell.by_arm, state)
    payload, gravity, F_P = (
        RigidInertia(acting.mass, np.zeros(3), acting.inertia),
        acting.gravity,
        acting.push,
    )
    resistance = [friction.force(rates) for friction, rates in zip(cell.friction, v, strict=True)]
    tau = [drives + losses for drives, losses in zip(force, resistance, strict=True)]
    rows = cell.moving_rows(q)
    terms = [
        _terms(functions, ArmNumbers(arm, gravity, "".join(map(str, rows))), arm_state)
        for arm, arm_state in zip(cell.arms, _arm_inputs(cell, payload, q, v, tau), strict=True)
    ]
    first = terms[0]
    R, p = first.R_WP, first.p_WP
    V_WP = join(first.V[:3] + cross(first.V[3:], p), first.V[3:])
    # F_P is the whole wrench about the payload's centre of mass besides gravity, as Plant.payload_wrench: one
    # that depends on R, p and V_WP is added here. Its power and its record are those of F_P, below.
    W = join(F_P[:3], F_P[3:] + cross(p, F_P[:3]))
    errors = [closure_error(R, p, arm.R_WP, arm.p_WP) for arm in terms[1:]]
    forces = _closure_forces(cell, terms, W, errors, rows)
    total = W[rows] - sum(forces, np.zeros(len(rows)))
    accelerations = [arm.acceleration(force) for arm, force in zip(terms, [total, *forces], strict=True)]
    moved, A = payload.moved(R, p), first.A + first.S @ accelerations[0]
    on_first = total - (moved.times(A) + force_cross(first.V, moved.times(first.V)))[rows]
    powers = [state.force @ state.v, traced(np.concatenate(resistance)) @ state.v, F_P @ V_WP, 0.0]
    tips = np.stack([arm.p_WP + arm.R_WP @ tip for arm, tip in zip(terms, cell.tips, strict=True)])
    sizes = [_size(error, tip) for error, tip in zip(errors, tips[1:], strict=True)]
    return CellMotion(
        rates=np.concatenate((*accelerations, powers)),
        wrenches=np.stack([_about(p, force, rows) for force in (on_first, *forces)]),
        R_WP=R,
        p_WP=p,
        V_WP=V_WP,
        payload_wrench=F_P,
        tips=tips,
        closure_errors=np.array([[0.0, 0.0], *sizes], dtype=object),
        kinetic=sum((arm.kinetic for arm in terms), 0.0),
        potential=sum((-1.0 * (arm.moment @ plain(gravity)) for arm in terms), 0.0),
        moment=sum((arm.moment for arm in terms), np.zeros(3)),
    )


def energy_gain(before: Surroundings, after: Surroundings, motion: CellMotion) -> Number:
    """Return the energy that other surroundings add, J: of the payload, and of the arms in another gravity.

    Args:
        before: Surroundings until now.
        after: Surroundings from now on.
        motion: Motion in those until now.
    """
    arms = motion.moment - before.mass * motion.p_WP
    gain = _payload_energy(after, motion) - _payload_energy(before, motion)
    return gain - arms @ plain(after.gravity - before.gravity)


def _payload_energy(surroundings: Surroundings, motion: CellMotion) -> Number:
    """Return kinetic and potential energy of the payload, J."""
    v, w_P, mass = motion.V_WP[:3], motion.R_WP.T @ motion.V_WP[3:], surroundings.mass
    kinetic = 0.5 * (mass * (v @ v) + w_P @ (surroundings.inertia @ w_P))
    return kinetic - mass * (surroundings.gravity @ motion.p_WP)


def closure_error(R_0: Numbers, p_0: Numbers, R_i: Numbers, p_i: Numbers) -> Numbers:
    """Return e = -log6(X_0 X_i^-1) = -[p - w x p / 2 + beta w x (w x p), w] in the world, shape (6,)."""
    R = R_0 @ R_i.T
    p = p_0 - R @ p_i
    sine = 0.5 * np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]], dtype=object)
    w = _series(sine @ sine, _ROTATION) * sine
    wp = cross(w, p)
    return -join(p - 0.5 * wp + _series(w @ w, _TRANSLATION) * cross(w, wp), w)


def _series(x: Any, coefficients: Sequence[float]) -> Number:
    value: Number = coefficients[0]
    for coefficient in coefficients[1:]:
        value = value * x + coefficient
    return value


def _arm_inputs(cell: CellNumbers, payload: RigidInertia, *states: Sequence[Numbers]) -> list[ArmInput]:
    """Return the input of each arm, given q, v and tau of each; the first one carries the payload."""
    arm_inputs = []
    for index, (arm, q, v, tau) in enumerate(zip(cell.arms, *states, strict=True)):
        first, last, held = arm.bodies[0], arm.bodies[-1].inertia, (arm.R_JP, arm.p_JP)
        carried = last if index else last.plus(payload.moved(*held))
        arm_inputs.append(ArmInput(q, v, tau, (first.R, first.p), carried, held))
    return arm_inputs


def _terms(functions: SharedFunctions, model: ArmNumbers, state: ArmInput) -> ArmResponse:
    """Return the terms of an arm: by a call of its model's code; in a plane, where it is short, in place."""
    if len(model.rows) < 6:
        return arm_terms(model, state)
    blank, bodies = (np.zeros((3, 3)), np.zeros(3)), [*model.arm.bodies]
    bodies[0] = bodies[0]._replace(R=blank[0], p=blank[1])
    bodies[-1] = bodies[-1]._replace(inertia=RigidInertia(0.0, blank[1], blank[0]))
    shared = SerialArm(tuple(bodies), model.arm.is_revolute, *blank)
    return functions.call(state.v[0].tape, arm_terms, model._replace(arm=shared), state)


def _closure_forces(
    cell: CellNumbers,
    terms: Sequence[ArmResponse],
    W: Numbers,
    errors: Sequence[Numbers],
    rows: Sequence[int],
) -> list[Numbers]:
    """Return f_i on arms 1 to m - 1 by the payload, about the world's origin, in the moving rows."""
    first, others, k = terms[0], terms[1:], len(rows)
    if not others:
        return []
    offset = first.b + first.G @ W[rows]
    right, G = [], np.empty((k * len(others), k * len(others)), dtype=object)
    for i, (arm, error) in enumerate(zip(others, errors, strict=True)):
        drift = arm.V - first.V
        closing = motion_cross(drift, arm.V) + cell.velocity_gain * drift + cell.position_gain * error
        right += [*(offset - arm.b - closing[rows])]
        for j in range(len(others)):
            G[k * i : k * (i + 1), k * j : k * (j + 1)] = first.G + arm.G if i == j else first.G
    L, D_inverse = factor(G)
    f = solve_transposed(L, D_inverse * solve_lower(L, np.array(right, dtype=object)))
    return [f[k * i : k * (i + 1)] for i in range(len(others))]


def _about(p: Numbers, force: Numbers, rows: Sequence[int]) -> Numbers:
    """Return a force about the world's origin, in the moving rows, as a wrench about p, shape (6,)."""
    full = np.zeros(6).astype(object)
    full[list(rows)] = force
    return join(full[:3], full[3:] - cross(p, full[:3]))


def _size(error: Numbers, tip: Numbers) -> list[Any]:
    """Return distance and angle of a closure error, at the tip."""
    linear = error[:3] + cross(error[3:], tip)
    return [(linear @ linear) ** 0.5, (error[3:] @ error[3:]) ** 0.5]
