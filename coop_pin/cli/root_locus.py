"""Command ``coop-pin root-locus``: eigenvalues of the sampled closed loop over a gain, and a figure."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Annotated

import tyro

from coop_pin.cli.exit_codes import OK
from coop_pin.cli.overrides import ScenarioCommand, field_path


@dataclasses.dataclass(frozen=True, kw_only=True)
class Locus(ScenarioCommand):
    """Draw the eigenvalues of the sampled closed loop over a gain, and print where it is stable.

    Every field of the scenario can be changed as in 'coop-pin run'. A
    law with sgn needs a boundary layer: --controller.switching.kind tanh --controller.switching.width 0.1.

    Attributes:
        gain: field to multiply, a number or a row: controller.gains.sliding-gain, actuators.lag.
        low: smallest factor of its value.
        high: largest factor.
        count: number of factors, evenly spaced in ratio.
        time: time of the state, s.
        out: figure to write, PNG or SVG; none when omitted.
    """

    gain: Annotated[str, tyro.conf.arg(metavar="FIELD")]
    low: float = 0.1
    high: float = 10.0
    count: int = 21
    time: float = 0.0
    out: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None

    def execute(self) -> int:
        """Print the stable factors and the loop at the scenario's own value, and write the figure.

        Raises:
            FieldError: the field is no number or row of numbers other than 0.
            ArgumentError: the law has no linear model, or a factor is out of range.
        """
        import numpy as np  # slow to load

        from coop_pin.analysis import eigenvalues, root_locus
        from coop_pin.arrays import as_count, as_positive

        scenario = self.loaded()
        ends = as_positive("low", self.low), as_positive("high", self.high)
        factors = np.geomspace(*ends, as_count("count", self.count, 1))
        print(eigenvalues(scenario, time=self.time).summary())
        locus = root_locus(scenario, field_path(self.gain, scenario.cell.arms), factors, time=self.time)
        print(locus.summary())
        if self.out is not None:
            from coop_pin import figures  # slow to load

            figure = figures.root_locus_figure(locus)
            print("written to " + " and ".join(map(str, figures.save_figure(figure, self.out))))
        return OK
