"""How the internal force grows with time when one arm's kinematics are off, by law and by alpha."""

from __future__ import annotations

from collections.abc import Mapping

from matplotlib.figure import Figure

import coop_pin as cp
from coop_pin.viz.figures import sweep_figure

ERROR = "internal_axial_rms_error_N"
SIGN_GAIN = "controller.gains.sign_gain"


def figure(results: Mapping[str, cp.SweepResult]) -> Figure:
    """Return the error over the length of the run, a line for each law and alpha."""
    return sweep_figure(results["bias"], ERROR, over="duration")


def numbers(results: Mapping[str, cp.SweepResult]) -> str:
    """Return the table of the figure."""
    error = results["bias"].values(ERROR)
    lines = [f"{ERROR} over the length of the run, s", f"{'':42}" + "".join(f"{length:9g}" for length in error.duration.values)]
    for law in error.law.values:
        for alpha in error[SIGN_GAIN].values:
            row = error.sel({"law": law, SIGN_GAIN: alpha}).values
            lines.append(f"{law:30} alpha {alpha:<5g}" + "".join(f"{value:9.3f}" for value in row))
    return "\n".join(lines)
