"""What a closed chain does at a state: accelerations, wrenches, energy."""

from __future__ import annotations

from typing import NamedTuple

from coop_pin.arrays import Array


class ChainDynamics(NamedTuple):
    """Forward dynamics of a closed chain.

    Attributes:
        acceleration: a, shape (nv,).
        closure_wrenches: on body a of each closure, at a, in axes a, N and N m, shape (closures, 6). Where
            rows are redundant, rigid bodies do not determine it; this is the one of least multipliers.
        rank: number of independent closure rows.
        residual: largest entry of J a + gamma + stabilisation, m/s^2 or rad/s^2.
    """

    acceleration: Array
    closure_wrenches: Array
    rank: int
    residual: float


class ChainState(NamedTuple):
    """A configuration and a velocity.

    Attributes:
        q: configuration, shape (nq,).
        v: velocity, shape (nv,).
    """

    q: Array
    v: Array


class Energy(NamedTuple):
    """Mechanical energy, J.

    Attributes:
        kinetic: J.
        potential: J.
    """

    kinetic: float
    potential: float

    @property
    def total(self) -> float:
        """Kinetic plus potential, J."""
        return self.kinetic + self.potential
