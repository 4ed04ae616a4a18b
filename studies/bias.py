"""Growth of the internal force with time under a kinematic bias of one arm, by law."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from matplotlib.figure import Figure

import coop_pin as cp
from coop_pin.figures import sweep_figure

ERROR = "settled_axial_rms_error_N"
BIAS = "cell.arms.left.calibration_error.tip.xyz"
RATE = "clock.rate_hz"


def figure(results: Mapping[str, cp.SweepResult]) -> Figure:
    """Return the error over the length of the run, a line for each law."""
    return sweep_figure(results["law"], ERROR, over="duration")


def numbers(results: Mapping[str, cp.SweepResult]) -> str:
    """Return the errors that the figure shows, and those with sgn by rate and bias, as tables."""
    error = results["law"].values(ERROR)
    lines = [_header(error.duration.values)]
    lines += [_line(law, error.sel(law=law).values) for law in error.law.values]
    error = results["sign"].values(ERROR)
    lines.append(_header(error.duration.values))
    for shift in error[BIAS].values:
        for rate in error[RATE].values:
            lines.append(
                _line(
                    f"payload space, sgn, {shift} m, {rate:g} Hz", error.sel({BIAS: shift, RATE: rate}).values
                )
            )
    return "\n".join(lines)


def _header(lengths: Sequence[float]) -> str:
    return f"{ERROR + ' over the length of the run, s':54}" + "".join(f"{length:9g}" for length in lengths)


def _line(name: str, values: Sequence[float]) -> str:
    return f"{name:54}" + "".join(f"{value:9.3f}" for value in values)
