"""Internal-force error under unknown payload mass and joint friction, without and with the sign term."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.figure import Figure

import coop_pin as cp
from coop_pin.figures import sweep_figure

ERROR = "settled_axial_rms_error_N"
MASS, FRICTION = "cell.payload.mass", "cell.arms.left.friction.coulomb"


def figure(results: Mapping[str, cp.SweepResult]) -> Figure:
    """Return the map without the sign term."""
    return sweep_figure(results["without_sign"], ERROR)


def numbers(results: Mapping[str, cp.SweepResult]) -> str:
    """Return mean and range of the error over the masses for each friction, and how far neighbours differ."""
    lines = [f"{ERROR} over the masses, for each Coulomb friction"]
    for name in ("without_sign", "with_sign"):
        error = results[name].values(ERROR).transpose(FRICTION, MASS)
        lines.append(
            f"{name}: {error.min().item():.3f} .. {error.max().item():.3f} N, "
            f"neighbours differ by up to {_ratio(error.values):.1f}"
        )
        for friction, row in zip(error[FRICTION].values, error.values, strict=True):
            lines.append(f"  {friction:5g} N m: mean {row.mean():.3f} N, {row.min():.3f} .. {row.max():.3f}")
    return "\n".join(lines)


def _ratio(values: np.ndarray) -> float:
    """Return the largest ratio of neighbouring cells of the map."""
    logarithm = np.log(values)
    return float(np.exp(max(np.abs(np.diff(logarithm, axis=axis)).max(initial=0.0) for axis in (0, 1))))
