"""Run one of the studies and draw it: docs/images/study-NAME.png and .svg. Finished runs are kept in out/studies/NAME.

python studies/draw.py force_gain
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from coop_pin.sweeps import SweepPlan, SweepResult, sweep
from coop_pin.viz.figures import save_figure, sweep_figure

HERE = Path(__file__).parent
IMAGES = HERE.parent / "docs" / "images"
ERROR = "internal_axial_rms_error_N"


def force_gain(result: SweepResult) -> Figure:
    """Return the map of K_f against the filter's pole p, with K_f = (1 + p) / (1 - p)."""
    figure = sweep_figure(result, ERROR)
    panel = figure.axes[0]
    pole = np.linspace(0.0, 0.94, 200)
    (line,) = panel.plot(pole, (1.0 + pole) / (1.0 - pole), "k--", linewidth=1.2, label="$K_f = (1 + p) / (1 - p)$", scaley=False)
    patches = panel.get_legend().legend_handles
    panel.legend(handles=[*patches, line], loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=2, frameon=False)
    return figure


def payload(result: SweepResult) -> Figure:
    """Return the map of the internal-force error over mass and friction."""
    return sweep_figure(result, ERROR)


def bias(result: SweepResult) -> Figure:
    """Return the internal-force error over the length of the run, by law and sign gain."""
    return sweep_figure(result, ERROR, over="duration")


STUDIES = {study.__name__: study for study in (force_gain, payload, bias)}


def main() -> None:
    """Run and draw the study that the command names."""
    if len(sys.argv) != 2 or sys.argv[1] not in STUDIES:
        sys.exit(f"usage: python {sys.argv[0]} {{{' | '.join(STUDIES)}}}")
    name = sys.argv[1]
    result = sweep(SweepPlan.load(HERE / f"{name}.toml"), out=Path("out") / "studies" / name)
    print(result.summary())
    save_figure(STUDIES[name](result), IMAGES / f"study-{name.replace('_', '-')}")


if __name__ == "__main__":
    main()
