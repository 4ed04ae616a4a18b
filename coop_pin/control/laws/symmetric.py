"""Symmetric formulation: the payload-space law on the absolute and the relative pose of all arms."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import reduce
from operator import add
from typing import Any, Literal

from coop_pin.base.errors import FieldError
from coop_pin.base.schema.base import NotNegative
from coop_pin.base.spatial import TaskRows
from coop_pin.control.bounds import SampledLoop
from coop_pin.control.controller import CellController, DecentralisedController
from coop_pin.control.law_wrapper import CellLawWrapper
from coop_pin.control.laws.mean_pose import ExchangedPoses, placed_at, view_of
from coop_pin.control.measurement import ArmMeasurement, ArmReference, ControlledArm
from coop_pin.control.steady_state import SteadyDirection


@dataclass(frozen=True, eq=False)
class SymmetricController(CellLawWrapper):
    """Payload-space law of every arm on the absolute pose of all, and on a part rho of its relative pose.

    ::

        e_i = [p_i - p_d,i, log(R_i R_d,i^T)]
        e_a = sum_j c_j e_j,   V_a = sum_j c_j (V_j - V_d,j)            absolute
        e_i <- e_a + rho (e_i - e_a),   V_i likewise                    relative

    for the view of every arm. Arms with one gain K then pull on a payload that all hold with

    ::

        sum_i c_i K s_i = K s_a,    and besides each with rho c_i K (s_i - s_a), which sum to zero:

    rho changes the internal wrench alone, not the motion. 1 is each arm by itself, 0 the absolute pose only.
    Where the arms hold different things, both errors are motions. Without integral, with a scalar gamma and
    with task inertias L_i of the arms that hardly change::

        L_i e_i'' = -c_i K [s_a + rho (s_i - s_a)],   s = e' + gamma e
        |e|_G^2   = |e_a|_K^2 + rho sum_i c_i |e_i - e_a|_K^2
        V         = sum_i e_i'^T L_i e_i' / 2 + gamma |e|_G^2 / 2,    V' = -|e'|_G^2

    so that both errors vanish for all rho > 0. An eigenvalue lambda of L^-1 G has the rates z of
    z^2 - lambda z + lambda gamma = 0, the slow one close to gamma where lambda is much larger.

    Uchiyama and Dauchez (1988, 1993); Chiacchio, Chiaverini and Siciliano (1996). Here the absolute
    orientation is a mean of rotation vectors, equal to theirs to the first order in the errors, for any
    number of arms, and the relative pose of arms with one payload is what their views of it differ by.

    Attributes:
        shares: c_i, which sum to one.
        relative_gain: rho.
    """

    shares: tuple[float, ...]
    relative_gain: float

    def transformed(
        self, measurements: Sequence[ArmMeasurement], references: Sequence[ArmReference]
    ) -> tuple[Sequence[ArmMeasurement], Sequence[ArmReference]]:
        """Return the measurements with absolute and relative parts weighed, and the references."""
        pairs = list(zip(measurements, references, strict=True))
        views = [view_of(one._replace(payload_twist=one.payload_twist - r.twist), r.pose) for one, r in pairs]
        absolute = reduce(add, [c * view for c, view in zip(self.shares, views, strict=True)])
        moved = [absolute + self.relative_gain * (view - absolute) for view in views]
        placed = [placed_at(one, view, r.pose) for (one, r), view in zip(pairs, moved, strict=True)]
        twists = [
            one._replace(payload_twist=one.payload_twist + r.twist)
            for one, r in zip(placed, references, strict=True)
        ]
        return twists, references


class Symmetric(ExchangedPoses):
    """The payload-space law on the absolute and relative pose of all arms: SymmetricController.

    One controller of all arms, which exchange poses as those of ``mean-pose`` do, without messages.

    Attributes:
        relative_gain: rho, part of the relative pose in what an arm feeds back: 1 is each arm by itself, 0
            the absolute pose alone; above 1 stiffer in relative than in absolute motions.
    """

    kind: Literal["symmetric"] = "symmetric"  # type: ignore[assignment]  # names the class, not its base
    relative_gain: NotNegative = 1.0

    def build(self, scenario: Any, arms: Iterable[ControlledArm]) -> CellController:
        """Return the controller of the cell; see Law.

        Raises:
            FieldError: the scenario has a network, whose messages the law does not send.
        """
        if scenario.network is not None:
            detail = "is 'symmetric', which sends no messages; leave the network out, or choose 'mean-pose'"
            raise FieldError(detail, "controller.kind")
        seats = list(arms)
        laws = DecentralisedController(self.controllers(scenario, seats))
        return SymmetricController(laws, tuple(arm.load_share for arm in seats), self.relative_gain)

    def steady_directions(self, rows: TaskRows, loop: SampledLoop, period: float) -> list[SteadyDirection]:
        """Return those of the payload-space law, whose views differ by rho times the bias."""
        rho = self.relative_gain
        return [
            each._replace(
                apart=rho,
                free=each.free / rho if rho else each.free,
                most=each.most / rho if rho else each.most,
            )
            for each in super().steady_directions(rows, loop, period)
        ]
