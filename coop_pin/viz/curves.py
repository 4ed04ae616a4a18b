"""Time plots of a run: which curves they show, and their values, recorded or of a run under way."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np

from coop_pin.base.arrays import Array
from coop_pin.description.cell.cell import Cell
from coop_pin.figures import palette
from coop_pin.results.friction import SHOWN, friction_use
from coop_pin.results.quantity import Samples

_MOST_SAMPLES = 2400
"""Approximate largest number of samples of a plot."""


class Plot(NamedTuple):
    """Time plot.

    Attributes:
        key: name in the page.
        title: heading of the plot.
        unit: unit of the values.
        tile: heading of the tile with the present value; "" for none.
    """

    key: str
    title: str
    unit: str
    tile: str = ""


class Curve(NamedTuple):
    """Curve of a plot.

    Attributes:
        plot: key of the plot.
        label: beside its present value.
        colour: "#rrggbb".
        role: "actual", "desired" or "measured".
        values: function of a run's samples, which returns one value for each, shape (n,).
        limit: largest amount allowed; None where there is none, or none is recorded.
    """

    plot: str
    label: str
    colour: str
    role: str
    values: Callable[[Samples], Array]
    limit: float | None = None


PLOTS = (
    Plot("axial", "internal force along: + pulls apart, − squeezes", "N", "along"),
    Plot("shear", "internal force across it", "N", "across"),
    Plot("moment", "internal moment", "N m", "moment"),
    Plot("tracking", "payload off its path", "mm", "off path"),
    Plot("torque", "drive torques", "N m"),
    Plot("share", "drive torques: share of each drive's limit", "%"),
    Plot("friction", "friction used: slip from 100 on, cut at 200", "%"),
    Plot("V_rate_3", "sum of V̇₃, which the convergence proof needs ≤ 0", "W"),
)

_LIGHTEST = 0.6
"""Share of white in the colour of an arm's last drive."""

_ROLES = {"actual": "", "desired": "desired_", "measured": "measured_"}


def cell_curves(samples: Samples, cell: Cell) -> tuple[Curve, ...]:
    """Return the curves that samples have values for.

    Internal forces of two arms mirror each other: the first arm's are shown. What the sensors of the two
    measure differs, and is shown of both. No moment is desired where no controlled row has one. Torques are
    shares of the drives' limits where every drive has one.

    Args:
        samples: quantities by name, as of ``run_samples``.
        cell: the cell.
    """
    curves, arms = list[Curve](), list(cell.arms)
    for part in ("axial", "shear", "moment"):
        for role, prefix in _ROLES.items():
            name = f"{prefix}internal_{part}"
            is_free = part == "moment" and role == "desired" and not cell.task_rows.has_moments
            is_known = name in samples and not (is_free or np.isnan(samples[name]).all())
            shown = is_known * (1 if len(arms) == 2 and role != "measured" else len(arms))
            for arm in range(shown):
                colour = {"desired": palette.DESIRED, "measured": palette.MEASURED}.get(
                    role, palette.INTERNAL if shown == 1 else palette.arm(arm)
                )
                label = role if shown == 1 else f"{arms[arm]} {role}".removesuffix(" actual")
                curves.append(Curve(part, label, colour, role, _column(name, arm)))
    curves += [
        Curve("tracking", "distance", palette.ACTUAL, "actual", _error(slice(0, 3))),
        Curve("tracking", "mrad turned", palette.EXTERNAL, "actual", _error(slice(3, 6))),
    ]
    joints, torque = samples["torque"].shape[2], samples["torque"].reshape(len(samples["time"]), -1)
    drives = np.flatnonzero(np.isfinite(torque).any(axis=0)).tolist()
    limits = samples.get("torque_limit", np.full(torque.shape[1:], np.nan)).ravel()
    is_share = bool(np.isfinite(limits[drives]).all())
    for drive in drives:
        arm, joint = divmod(drive, joints)
        colour = palette.arm(arm, _LIGHTEST * joint / joints)
        plot, limit, scale = ("share", 100.0, 100.0 / limits[drive]) if is_share else ("torque", None, 1.0)
        values = _column("torque", drive, scale)
        curves.append(Curve(plot, f"{arms[arm]} {joint + 1}", colour, "actual", values, limit))
    curves += [
        Curve("friction", name, palette.arm(arms.index(name)), "actual", _friction(cell, number), 100.0)
        for number, name in enumerate(cell.padded)
    ]
    if "V_rate_3_sum" in samples:
        curves.append(Curve("V_rate_3", "sum", palette.INTERNAL, "actual", lambda s: s["V_rate_3_sum"]))
    return tuple(curves)


def curve_rows(curves: Sequence[Curve], samples: Samples) -> Array:
    """Return time and values of curves, shape (n, 1 + curves)."""
    return np.column_stack((samples["time"], *(curve.values(samples) for curve in curves)))


def thinned_rows(rows: Array, always: Iterable[int] = ()) -> Array:
    """Return rows thinned for a plot: evenly, and with the extremes of every column in every interval.

    Args:
        rows: values, shape (n, columns).
        always: indices of rows that are kept, for example those of the frames.
    """
    n, columns = rows.shape
    if n <= _MOST_SAMPLES:
        return rows
    kept = {*range(0, n, math.ceil(2 * n / _MOST_SAMPLES)), n - 1, *always}
    for interval in np.array_split(np.arange(n), max(_MOST_SAMPLES // (4 * columns), 1)):
        part = np.nan_to_num(rows[interval])
        kept.update(interval[part.argmin(axis=0)].tolist(), interval[part.argmax(axis=0)].tolist())
    return rows[sorted(kept)]


def plot_table(curves: Sequence[Curve]) -> list[dict[str, Any]]:
    """Return the plots that have curves, as the page reads them.

    A curve has its column in the run's table, where the time is column 0.

    Args:
        curves: the curves of a run.
    """
    table = [{**plot._asdict(), "curves": []} for plot in PLOTS]
    for column, curve in enumerate(curves, start=1):
        (plot,) = (plot for plot in table if plot["key"] == curve.plot)
        entry = {"column": column} | curve._asdict()
        plot["curves"].append({name: value for name, value in entry.items() if name != "values"})
    return [plot for plot in table if plot["curves"]]


def _column(name: str, number: int, scale: float = 1.0) -> Callable[[Samples], Array]:
    return lambda samples: scale * samples[name].reshape(len(samples[name]), -1)[:, number]


def _friction(cell: Cell, number: int) -> Callable[[Samples], Array]:
    return lambda samples: 100.0 * np.minimum(friction_use(samples, cell).used[:, number], SHOWN)


def _error(axes: slice) -> Callable[[Samples], Array]:
    return lambda samples: 1e3 * np.linalg.norm(samples["pose_error"][:, axes], axis=1)
