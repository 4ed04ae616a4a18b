"""Modes of a sampled closed loop, and the motions that the closures of a cell leave."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coop_pin.base.arrays import Array, Mask
from coop_pin.chain.closed_chain import ClosedChain
from coop_pin.grasps.cell_chain import CellChain
from coop_pin.simulation.simulation import Simulation

NEUTRAL = 1e-6
"""Growth in a tick, and part of a singular value, that count as none."""
_SPARE = 0.5
"""Part of a mode's square that must leave the task rows at rest for it to be one of spare joints."""
_SHARE_OF_MODE = 0.3


class Mode(NamedTuple):
    """A mode of a sampled closed loop.

    Attributes:
        z: factor from tick to tick.
        name: name of what moves: joints, or "payload along x", "payload's joint hinge", "posture of left",
            "internal force along x".
        period: T, s.
        joints: joints that move most, as arm/joint, the fastest first; of modes of the motion alone.
        is_spare: whether most of it leaves the task rows of the payload at rest; likewise.
    """

    z: complex
    name: str
    period: float
    joints: tuple[str, ...] = ()
    is_spare: bool = False

    @property
    def damping(self) -> float:
        """Damping ratio of the mode, -Re(ln z) / ``|ln z|``."""
        return damping_ratio(self.z)

    @property
    def rate(self) -> float:
        """Decay -ln ``|z|`` / T, 1/s; negative if the mode grows."""
        return -float(np.log(abs(self.z))) / self.period


def damping_ratio(z: complex) -> float:
    """Return -Re(ln z) / ``|ln z|``; 1 for a mode that is gone after a tick, or does not move in one."""
    if z == 0.0 or abs(log := np.log(complex(z))) < NEUTRAL:
        return 1.0
    return float(-log.real / abs(log))


class Motions(NamedTuple):
    """The n motions y that the closures leave at a pose.

    Attributes:
        basis: velocity of the chain by each motion, orthonormal, shape (nv, n).
        payload: velocity of the payload in its task rows by each, shape (k, n).
        at_rest: projection on those that leave the task rows at rest, shape (n, n).
    """

    basis: Array
    payload: Array
    at_rest: Array

    @classmethod
    def at(cls, chain: CellChain, q: Array) -> Motions:
        """Return the motions of a cell at a configuration."""
        N = motion_basis(chain.mechanism, q)
        J = chain.cell.task_rows.select(chain.payload_jacobian(q)) @ N
        return cls(N, J, np.eye(N.shape[1]) - np.linalg.pinv(J) @ J)

    def is_spare(self, y: NDArray[Any]) -> Mask:
        """Return of each motion, shape (n, ...), whether most of it leaves the task rows at rest."""
        still = np.linalg.norm(self.at_rest @ y, axis=0)
        return np.asarray(still**2 > _SPARE * np.linalg.norm(y, axis=0) ** 2)


def motion_basis(chain: ClosedChain, q: Array) -> Array:
    """Return an orthonormal basis of the velocities that the closures leave, shape (nv, n)."""
    unit = np.eye(chain.model.nv)
    basis, singular, _ = np.linalg.svd(np.column_stack([chain.project_velocity(q, row) for row in unit]))
    return np.asarray(basis[:, singular > NEUTRAL])


def fastest_joints(simulation: Simulation, mode: Array) -> tuple[str, ...]:
    """Return the joints that move fastest in a mode, the fastest first."""
    speeds = {
        name: float(speed)
        for slot in simulation.slots
        for name, speed in zip(slot.angles.names, mode[slot.v_slice], strict=True)
    }
    fastest = sorted(speeds, key=lambda name: -speeds[name])
    return tuple(name for name in fastest if speeds[name] >= _SHARE_OF_MODE * speeds[fastest[0]])[:4]


def damping_matrix(simulation: Simulation, q: Array, torque: Callable[[Array], Array]) -> Array:
    """Return D = -d(acceleration)/dv through a torque, with the closures closed."""
    chain, rest = simulation.chain.mechanism, np.zeros(len(simulation.plant.v))
    speeds = [chain.project_velocity(q, row) for row in np.eye(len(rest))]
    torques = [rest, *((torque(-v) - torque(v)) / 2.0 for v in speeds)]
    still, *damped = (chain.forward_dynamics(q, rest, tau).acceleration for tau in torques)
    return np.column_stack(damped) - still[:, None]
