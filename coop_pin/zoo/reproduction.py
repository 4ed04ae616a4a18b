"""Reproduction: numbers of an experiment with their limits, and the verdict that follows for each claim."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from coop_pin.base.arrays import Array


class Measured(NamedTuple):
    """Measured number of a claim, and the range in which the claim holds.

    Attributes:
        claim: name of the claim.
        text: quantity that was measured, a few words.
        value: the number.
        unit: unit of the value; "" without one.
        least: lower limit.
        most: upper limit; a number without limits is told, and decides nothing.
    """

    claim: str
    text: str
    value: float
    unit: str = ""
    least: float = -math.inf
    most: float = math.inf

    @property
    def holds(self) -> bool:
        """Whether it is within its limits; nan is not."""
        return bool(self.least <= self.value <= self.most)

    @property
    def decides(self) -> bool:
        """Whether it has a limit."""
        return not (math.isinf(self.least) and math.isinf(self.most))

    @property
    def limit(self) -> str:
        """Its limits, as text; "-" of a number that decides nothing."""
        if math.isinf(self.least):
            return f"<= {self.most:.3g}" if self.decides else "-"
        return f">= {self.least:.3g}" if math.isinf(self.most) else f"{self.least:.3g} to {self.most:.3g}"


class Trace(NamedTuple):
    """Curve of the picture.

    Attributes:
        label: text in the legend.
        x: abscissae.
        y: ordinates.
        dashed: whether it is the source's, or what follows from its equations.
    """

    label: str
    x: Array
    y: Array
    dashed: bool = False


def off_path(data: Any) -> Array:
    """Return the distance of the payload from its path at each tick of a record, m, shape (ticks,)."""
    return np.asarray(np.linalg.norm(data.pose_error.values[:, :3], axis=1))


def off_squeeze(data: Any) -> Array:
    """Return the largest error of an arm's internal force at each tick of a record, N, shape (ticks,)."""
    wrench = data.internal_wrench.values - data.desired_internal_wrench.values
    return np.asarray(np.linalg.norm(wrench[..., :3], axis=-1).max(axis=1))


class Reproduction(NamedTuple):
    """Numbers and curves of one run of an experiment.

    Attributes:
        name: name of the experiment.
        claims: names of its claims, each with the reason why it cannot be judged, or "".
        numbers: measured numbers, in the order of the page.
        curves: curves of its picture.
    """

    name: str
    claims: Mapping[str, str]
    numbers: tuple[Measured, ...]
    curves: tuple[Trace, ...]

    def verdict(self, claim: str) -> str:
        """Return "holds", "holds in part", "does not hold" or "cannot be judged".

        A claim holds if all its numbers are within their limits, and in part if some are.

        Args:
            claim: name of the claim.
        """
        held = [number.holds for number in self.numbers if number.claim == claim and number.decides]
        if not held or self.claims[claim]:
            return "cannot be judged"
        return "holds" if all(held) else "holds in part" if any(held) else "does not hold"

    def summary(self) -> str:
        """Return a table of at most 80 columns: claims with verdicts, below them their numbers."""
        lines = [self.name]
        for claim, unjudged in self.claims.items():
            lines += [f"{claim:<61.61} {self.verdict(claim):>17}", *([f"  {unjudged}"] if unjudged else [])]
            lines += [
                f"  {one.text:<44.44} {f'{one.value:.4g} {one.unit}':>14} {one.limit:>13}"
                + " no" * (not one.holds)
                for one in self.numbers
                if one.claim == claim
            ]
        return "\n".join(lines)

    def to_json(self) -> dict[str, Any]:
        """Return verdicts and numbers, for ``json.dumps``; numbers that are not finite are None."""
        verdicts = {claim: self.verdict(claim) for claim in self.claims}
        numbers = [
            {
                key: value if not isinstance(value, float) or math.isfinite(value) else None
                for key, value in row
            }
            for row in ([*number._asdict().items(), ("holds", number.holds)] for number in self.numbers)
        ]
        return {"name": self.name, "verdicts": verdicts, "numbers": numbers}
