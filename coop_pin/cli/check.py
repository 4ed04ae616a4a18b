"""Commands ``check`` and ``root-locus``: what is known of a scenario and of its loop before it runs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import tyro

from coop_pin import figures
from coop_pin.cli.exit_codes import FAILED, OK
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


def check(
    scenario: ScenarioName,
    poses: int = 401,
    bias: float = 1e-3,
    bias_turn: float = 0.0,
    load: float = 10.0,
    table_error: float = 2e-3,
    json: bool = False,
    code: Code = ANY_CODE,
    fields: TypedFields = NO_FIELDS,
) -> int:
    """List what is known of a scenario before it runs: errors first, then warnings, then margins.

    Nothing is simulated. Errors are a motion that an arm cannot follow, drives too weak for weight and
    squeeze, closures that lose rank, a payload that would slip, a table that is pressed too hard, and motion
    that grows from tick to tick. Warnings are numbers in a likely wrong unit, and starts, postures and
    grasps that do not fit. Margins are those of reach, torques and stability, and what a kinematic bias, an
    unknown load and a lost arm leave. An error has the fields that cure it, where some were found.
    Every field of the scenario can be changed as in 'coop-pin run'.

    Args:
        scenario: a name listed by 'coop-pin list', or a TOML file.
        poses: number of poses checked along the motion.
        bias: kinematic bias of one arm's tip, m.
        bias_turn: angle by which the base of one arm is off, rad.
        load: constant force on the payload that the law does not know, N.
        table_error: height by which a table on which the payload is put down may be higher than planned, m.
        json: print the findings as JSON.
        code: code that the scenario may name.
        fields: fields of the scenario, as typed.
    """
    from coop_pin.running import check as checking

    chosen = load_scenario(scenario, fields, code, quiet=json)
    with Working("checking the cell along its motion", quiet=json):
        findings = checking.check(
            chosen, poses=poses, bias=bias, bias_turn=bias_turn, load=load, table_error=table_error
        )
    if json:
        print(findings.to_json())
    else:
        print_wrapped(findings.summary())
    return OK if findings.ok else FAILED


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
