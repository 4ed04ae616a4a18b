"""Command ``export``: what leaves for other programs, as CSV, C99 or MJCF."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import tyro

from coop_pin.base.atomic_write import write_atomically
from coop_pin.base.errors import FieldError
from coop_pin.cli.overrides import ANY_CODE, NO_FIELDS, Code, TypedFields, load_scenario, refuse_fields
from coop_pin.cli.terminal import Working
from coop_pin.cli.view import result_of


def export(
    what: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="RUN_OR_SCENARIO")],
    to: Literal["csv", "c", "mjcf"],
    arm: str | None = None,
    out: Annotated[Path | None, tyro.conf.arg(metavar="PATH")] = None,
    ticks: int = 20,
    code: Code = ANY_CODE,
    fields: TypedFields = NO_FIELDS,
) -> None:
    """Export the samples of a run as CSV, the law of one arm as C99, or a cell as MJCF for MuJoCo.

    A CSV has the time and a column for each arm, joint or axis, with its unit. C99 is forward kinematics,
    Jacobian and law of one arm as straight-line code, with a self-test; it allocates nothing, and its state
    goes in and out. MJCF has arms, payload and grasps, these as soft welds, at the scenario's start. Every
    field of a scenario can be changed as in 'coop-pin run'.

    'coop-pin view' writes images and videos of a run, 'coop-pin report' its page, 'coop-pin sweep-show' the
    table of a sweep.

    Args:
        what: folder or result file of a run, for csv; a scenario for c and mjcf, a name listed by 'coop-pin
            list' or a TOML file.
        to: form of what is written.
        arm: name of the arm whose law is written, for c.
        out: file of csv, samples.csv beside the result when omitted; folder of c, out/, the scenario's name
            and -c when omitted; file of mjcf, out/, the scenario's name and .xml when omitted.
        ticks: number of ticks of the self-test of c, recorded from the start of the scenario.
        code: code that the scenario may name.
        fields: fields of the scenario, as typed.

    Raises:
        FieldError: c without an arm; csv or mjcf with one; csv with a field; MuJoCo does not have the cell.
        FileReadError: the result is missing or damaged.
        CoopPinError: the law cannot be exported, or the scenario cannot start.
    """
    if to != "c" and arm is not None:
        raise FieldError(f"is an option of --to c; {to} has all arms", "--arm")
    if to == "csv":
        refuse_fields(fields, what)
        table, run = result_of(Path(what)).to_dataframe(), Path(what)
        file = out or (run if run.is_dir() else run.parent) / "samples.csv"
        write_atomically(file, table.to_csv)
        print(f"{len(table)} times, {table.shape[1]} columns, written to {file}")
        return
    if to == "mjcf":
        from coop_pin.running.mjcf_file import write_mjcf  # slow to load

        chosen = load_scenario(what, fields, code)
        file = out or Path("out") / f"{chosen.name}.xml"
        write_mjcf(chosen, file)
        print(f"written to {file}")
        return
    from coop_pin.compiled.laws.c_export import export_c  # slow to load

    if arm is None:
        raise FieldError("is missing; --to c writes the law of one arm: --arm NAME", "--arm")
    chosen = load_scenario(what, fields, code)
    with Working(f"tracing the law of {arm}"):
        law = export_c(chosen, arm, out or Path("out") / f"{chosen.name}-c", ticks=ticks)
    print(law.summary())
    test = f"{law.source.with_suffix('')}_self_test"
    print(f"self-test: cc -std=c99 -O2 {law.source} {law.self_test} -lm -o {test} && {test}")
