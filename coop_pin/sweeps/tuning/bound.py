"""A bound on a metric, as written: settling_time_s<2.5."""

from __future__ import annotations

import re
from typing import NamedTuple, Self

import numpy as np

from coop_pin.errors import FieldError

_FORM = re.compile(r"\s*(?P<metric>[^\s<>=]+)\s*(?P<sign>[<>])=?\s*(?P<bound>[^\s<>=]+)\s*")


class Bound(NamedTuple):
    """A bound on a metric; the bound itself is allowed, since no run meets a number exactly.

    Attributes:
        metric: name.
        sign: 1 where the metric must stay below, -1 where it must stay above.
        bound: the number.
    """

    metric: str
    sign: int
    bound: float

    @classmethod
    def parse(cls, text: str) -> Self:
        """Read "settling_time_s<2.5" or "internal_axial_mean_N > -11".

        Raises:
            FieldError: the text does not say that.
        """
        mistake = FieldError(f"is {text!r}; it must read METRIC<NUMBER or METRIC>NUMBER, with a finite number", "subject_to")
        form = _FORM.fullmatch(text)
        if form is None:
            raise mistake
        try:
            bound = float(form["bound"])
        except ValueError:
            raise mistake from None
        if not np.isfinite(bound):
            raise mistake
        return cls(form["metric"], 1 if form["sign"] == "<" else -1, bound)

    def excess(self, value: float) -> float:
        """Return by how much a value is outside, as a share of the bound where that is above 1; inf where it is not a number."""
        beyond = self.sign * (value - self.bound) / max(1.0, abs(self.bound))
        return max(beyond, 0.0) if np.isfinite(value) else np.inf
