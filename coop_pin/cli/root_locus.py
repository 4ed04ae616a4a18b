"""Command ``root-locus``: eigenvalues of a law over a gain."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import tyro

from coop_pin import figures
from coop_pin.cli.overrides import (
    ANY_CODE,
    NO_FIELDS,
    Code,
    ScenarioName,
    TypedFields,
    field_path,
    load_scenario,
)
from coop_pin.cli.terminal import Working, print_wrapped


def root_locus(
    scenario: ScenarioName,
    gain: Annotated[str, tyro.conf.arg(metavar="FIELD")],
    low: float = 0.1,
    high: float = 10.0,
    count: int = 21,
    time: float = 0.0,
    out: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None,
    code: Code = ANY_CODE,
    fields: TypedFields = NO_FIELDS,
) -> None:
    """Draw the eigenvalues of the sampled closed loop over a gain, and print where it is stable.

    Every field of the scenario can be changed as in 'coop-pin run'. A
    law with sgn needs a boundary layer: --controller.switching.kind tanh --controller.switching.width 0.1.

    Args:
        scenario: a name listed by 'coop-pin list', or a TOML file.
        gain: field to multiply, a number or a row: controller.gains.sliding-gain, actuators.lag.
        low: smallest factor of its value.
        high: largest factor.
        count: number of factors, evenly spaced in ratio.
        time: time of the state, s.
        out: figure to write, PNG or SVG; none when omitted.
        code: code that the scenario may name.
        fields: fields of the scenario, as typed.

    Raises:
        FieldError: the field is no number or row of numbers other than 0.
        ArgumentError: the law has no linear model, or a factor is out of range.
    """
    import numpy as np  # slow to load

    from coop_pin import stability
    from coop_pin.base.arrays import as_fitting_count, as_positive

    base = load_scenario(scenario, fields, code)
    ends = as_positive("low", low), as_positive("high", high)
    factors = np.geomspace(*ends, as_fitting_count("count", count, 1, 1024.0))
    with Working("linearising the closed loop"):
        here = stability.eigenvalues(base, time=time).summary()
        locus = stability.root_locus(base, field_path(gain, base.cell.arms), factors, time=time)
    print_wrapped(here, locus.summary(), sep="\n")
    if out is not None:
        figure = figures.root_locus_figure(locus)
        print("written to " + " and ".join(map(str, figures.save_figure(figure, out))))
