"""Command ``export``: what leaves for other programs, as CSV, MCAP, LeRobot episodes, C99 or MJCF."""

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
    to: Literal["csv", "mcap", "lerobot", "c", "mjcf"],
    arm: str | None = None,
    out: Annotated[Path | None, tyro.conf.arg(metavar="PATH")] = None,
    ticks: int = 20,
    code: Code = ANY_CODE,
    fields: TypedFields = NO_FIELDS,
) -> None:
    """Export the samples of a run as CSV or MCAP, runs as LeRobot episodes, a law as C99, a cell as MJCF.

    A CSV has the time and a column for each arm, joint or axis, with its unit. MCAP has messages of ROS 2:
    joint states, the wrench of each wrist and the internal one, the desired pose, and TF; it takes the extra
    'logs'. LeRobot episodes, of one run or of the folder of a sweep, have internal wrench, load share and
    slip margin as features; they take the extra 'lerobot'. C99 is forward kinematics,
    Jacobian and law of one arm as straight-line code, with a self-test; it allocates nothing, and its state
    goes in and out. MJCF has arms, payload and grasps, these as soft welds, at the scenario's start. Every
    field of a scenario can be changed as in 'coop-pin run'.

    'coop-pin view' writes images and videos of a run, 'coop-pin report' its page, 'coop-pin sweep-show' the
    table of a sweep.

    Args:
        what: folder or result file of a run, for csv and mcap; for lerobot also a folder of runs; a scenario
            for c and mjcf, a name listed by 'coop-pin list' or a TOML file.
        to: form of what is written.
        arm: name of the arm whose law is written, for c.
        out: file of csv or mcap, samples.csv or .mcap beside the result when omitted; folder of lerobot,
            lerobot beside it; folder of c, out/, the scenario's name
            and -c when omitted; file of mjcf, out/, the scenario's name and .xml when omitted.
        ticks: number of ticks of the self-test of c, recorded from the start of the scenario.
        code: code that the scenario may name.
        fields: fields of the scenario, as typed.

    Raises:
        FieldError: c without an arm; others with one; a run with a field; MuJoCo does not have the cell.
        MissingExtraError: mcap or lerobot without its extra.
        FileReadError: the result is missing or damaged.
        CoopPinError: the law cannot be exported, or the scenario cannot start.
    """
    if to != "c" and arm is not None:
        raise FieldError(f"is an option of --to c; {to} has all arms", "--arm")
    if to in ("csv", "mcap", "lerobot"):
        refuse_fields(fields, what)
        print(_export_run(Path(what), to, out))
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


def _export_run(run: Path, to: str, out: Path | None) -> str:
    """Write a run, or the runs of a folder, and return what was written as text."""
    folder = run if run.is_dir() else run.parent
    if to == "lerobot":
        from coop_pin.logs.lerobot_export import write_episodes  # slow to load

        runs = [run] if run.is_file() else sorted(run.glob("**/*.nc"))
        with Working("writing the episodes"):
            frames = write_episodes(map(result_of, runs), out or folder / "lerobot")
        return f"{len(runs)} episodes, {frames} frames, written to {out or folder / 'lerobot'}"
    result, file = result_of(run), out or folder / f"samples.{to}"
    if to == "mcap":
        from coop_pin.logs.run_export import write_run  # slow to load

        write_run(result, file)
        return f"{result.data.time.size} times, written to {file}"
    table = result.to_dataframe()
    write_atomically(file, table.to_csv)
    return f"{len(table)} times, {table.shape[1]} columns, written to {file}"
