"""Causes: parameters that a log cannot tell apart as one, ranked by the internal force that they make."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from coop_pin.base.arrays import Array
from coop_pin.identification.effects import Effects
from coop_pin.identification.estimate import Parameter

_SHARED = 0.25
"""Part of the variances of two forces that is common to both from which on their parameters are one cause."""
_ALONE = 0.9
"""Part of the square of a cause's force that one of its members makes alone."""
_SMALL = 0.04
"""Standard deviation of a force below which it is told apart, N."""
_SEEN = 0.9
"""Part of the variance by the priors from which on the log decides, however small the force is."""
_FLOOR = 0.02
"""Force below which a cause is not told, N."""
_DRAWS = 400
_LEVELS = (2.5, 97.5)
"""Percentiles of an interval."""
Newtons = tuple[float, float, float]
"""Force at the estimate and the ends of its interval, N."""


class Cause(NamedTuple):
    """Cause of internal force: one parameter, or several of which the log shows a combination alone.

    Attributes:
        members: parameters of the cause.
        newtons: norm of the force on an arm, mean over the record, at the estimate, N.
        low: 2.5 % of it, N.
        high: 97.5 % of it, N.
        sizes: value of each member that alone makes the force, in the units of the members; NaN where none
            does. Of load shares those of the law.
        seen: 1 - variance of the force / that by the priors: 0 where the log says nothing.
    """

    members: tuple[Parameter, ...]
    newtons: float
    low: float
    high: float
    sizes: tuple[float, ...]
    seen: float

    @property
    def arms(self) -> tuple[str, ...]:
        """Names of its arms."""
        return tuple(dict.fromkeys(one.arm for one in self.members))

    @property
    def is_known(self) -> bool:
        """Whether the interval is narrower than what it makes."""
        return self.high - self.low < max(self.newtons, _SMALL)

    @property
    def is_seen(self) -> bool:
        """Whether the log, and not what was known before, says how much it makes."""
        return self.is_known or self.seen > _SEEN

    @property
    def counts(self) -> bool:
        """Whether it makes a force, or may make one that counts."""
        return (self.low if self.is_seen else self.newtons) > _FLOOR or self.high > 10.0 * _FLOOR

    @property
    def is_none(self) -> bool:
        """Whether the force that the log shows of it is not different from zero."""
        return self.is_seen and self.low <= _FLOOR

    @property
    def name(self) -> str:
        """Its parts as text: "left tip or right tip"."""
        if self.members[0].part == "load share":
            return "load shares"
        parts: dict[tuple[str, str], list[str]] = {}
        for one in self.members:
            parts.setdefault((one.arm, one.part), []).append(one.axis)
        return " or ".join(f"{arm} {part}{_axes(axes)}" for (arm, part), axes in parts.items())

    @property
    def is_one(self) -> bool:
        """Whether it is one parameter, or the load shares, and not a combination."""
        return len(self.members) == 1 or self.members[0].part == "load share"

    @property
    def size(self) -> str:
        """Size of its only member, or those of each that alone makes the force, as text; empty without."""
        if self.members[0].part == "load share":
            return ", ".join(
                f"{one.arm} {size:.3f}" for one, size in zip(self.members, self.sizes, strict=True)
            )
        sizes = [
            (str(one), one.valued(size))
            for one, size in zip(self.members, self.sizes, strict=True)
            if one.unit and np.isfinite(size)
        ]
        return " or ".join(size if len(self.members) == 1 else f"{name} {size}" for name, size in sizes)

    def __str__(self) -> str:
        """Return the cause as text."""
        return f"{self.newtons:6.2f} N ({self.low:.2f} to {self.high:.2f})  {self.name}"


def _axes(axes: list[str]) -> str:
    named = [axis for axis in axes if axis]
    return f" {', '.join(named)}" if 0 < len(named) < 6 else ""


def ranked_causes(
    effects: Effects, x: Array, covariance: Array, prior: Array, error: float
) -> tuple[Cause, ...]:
    """Return causes by their force, the largest first.

    Two sets of parameters are one cause where their forces share more than a quarter of their variances. If
    these cancel, the log shows the sum, and not which of them it is; if they add up, it shows neither.

    Args:
        effects: forces of all parameters.
        x: estimates, shape (p,).
        covariance: covariance of the estimates, shape (p, p).
        prior: their standard deviations before, shape (p,).
        error: standard deviation of a forecast of newtons, as a part of them.
    """
    columns = effects.force.reshape(-1, len(x))
    gram = columns.T @ columns / (effects.force.shape[0] * effects.force.shape[1])
    shared = gram * covariance
    sets = [[k] for k in range(len(x))]
    V = shared.copy()  # variance of the force of each set, and what pairs add to it
    while len(sets) > 1:
        alone = np.diag(V)
        pairs = alone[:, None] + alone
        common = 2.0 * np.abs(V) / np.maximum(pairs, 1e-30)
        counts = np.minimum(alone[:, None], alone) > _SMALL**2
        np.fill_diagonal(counts, False)
        i, j = divmod(int(np.argmax(np.where(counts, common, -1.0))), len(sets))
        if not counts[i, j] or common[i, j] < _SHARED:
            break
        i, j = sorted((i, j))
        V[i] += V[j]
        V[:, i] += V[:, j]
        V = np.delete(np.delete(V, j, axis=0), j, axis=1)
        sets[i] += sets.pop(j)
    causes = [_cause(effects, gram, sorted(one), x, covariance, prior, error) for one in sets]
    return tuple(sorted(causes, key=lambda cause: -cause.newtons))


def force_interval(force: Array, x: Array, covariance: Array, error: float) -> Newtons:
    """Return the mean norm of a force at the estimate, and the ends of its interval, N.

    Percentiles by the covariance, widened by the error of the forecast.

    Args:
        force: force on each arm by parameter, shape (n, m, rows, p).
        x: estimates, shape (p,).
        covariance: covariance of the estimates, shape (p, p).
        error: standard deviation of the forecast, as a part of the force.
    """
    draws = np.random.default_rng(0).multivariate_normal(x, covariance, _DRAWS, "ignore", method="eigh")
    forces = np.tensordot(force, np.vstack((x, draws)).T, 1)
    norms = np.linalg.norm(forces, axis=2).max(axis=1).mean(axis=0)
    low, high = np.percentile(norms[1:], _LEVELS)
    return widened((float(norms[0]), float(low), float(high)), error)


def widened(newtons: Newtons, error: float) -> Newtons:
    """Return a force and its interval, with errors of the forecast and of the estimates.

    A norm is never negative: where most draws are larger than the estimate, the interval begins at zero.

    Args:
        newtons: force at the estimate and its interval, N.
        error: standard deviation as a part of the force.
    """
    force, low, high = newtons
    half = 1.96 * error * force
    least = 0.0 if low > force else max(force - float(np.hypot(force - low, half)), 0.0)
    return force, least, force + float(np.hypot(max(high - force, 0.0), half))


def _cause(
    effects: Effects,
    gram: Array,
    members: list[int],
    x: Array,
    covariance: Array,
    prior: Array,
    error: float,
) -> Cause:
    """Return the cause of some parameters, each alone with the size whose force is nearest to that of all."""
    x, covariance, gram = x[members], covariance[np.ix_(members, members)], gram[np.ix_(members, members)]
    along, squares = gram @ x, np.maximum(np.diag(gram), 1e-30)
    makes_it = along**2 >= _ALONE * squares * (x @ along)
    sizes = np.where(makes_it, along / squares, np.nan)
    seen = 1.0 - (gram * covariance).sum() / max(float(squares @ prior[members] ** 2), 1e-30)
    interval = force_interval(effects.force[..., members], x, covariance, error)
    return Cause(tuple(effects.parameters[k] for k in members), *interval, tuple(sizes.tolist()), float(seen))
