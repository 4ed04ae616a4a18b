"""The scenario of a run in a few lines: what a reader wants to know before looking at curves."""

from __future__ import annotations

from collections.abc import Iterable

from coop_pin.results import RunResult


def scenario_facts(result: RunResult) -> list[tuple[str, str]]:
    """Return labels and texts: arms, payload, controller, clock, motion, events, plant."""
    scenario = result.scenario
    cell, clock, plant = scenario.cell, scenario.clock, scenario.plant
    facts = [(f"arm {name}", _arm(result, index)) for index, name in enumerate(cell.arms)]
    facts += [
        ("payload", f"{cell.payload.mass:g} kg"),
        ("task", f"{cell.rows} ({cell.task_rows.size} rows), gravity ({_row(cell.gravity)}) m/s²"),
        ("controller", _controller(result)),
        ("motion", scenario.motion.kind),
        ("clock", f"{clock.rate_hz:g} Hz, {clock.steps_per_tick} plant steps in a tick, {result.end:g} s"),
        ("plant", f"payload {plant.payload}, {plant.integrator}"),
    ]
    facts += [("event", _value(event.model_dump())) for event in scenario.events]
    return facts


def _arm(result: RunResult, index: int) -> str:
    cell = result.scenario.cell
    arm = list(cell.arms.values())[index]
    squeeze = result.scenario.squeeze_wrenches[index]
    return (
        f"{arm.urdf}, tip {arm.tip}, base at ({_row(arm.base.xyz)}) m, carries {cell.shares[index]:.3g} of the load; "
        f"desired internal wrench ({_row(squeeze)}) N, N m about P in payload axes"
    )


def _controller(result: RunResult) -> str:
    fields = result.scenario.controller.model_dump(exclude_none=True)
    kind, gains = fields.pop("kind"), fields.pop("gains", {})
    return f"{kind}: {_fields(gains | fields)}"


def _fields(table: dict[str, object]) -> str:
    """Return a table as words; empty entries say nothing."""
    return ", ".join(f"{name.replace('_', ' ')} {_value(value)}" for name, value in table.items() if value not in ({}, (), None))


def _value(value: object) -> str:
    if isinstance(value, dict):
        kind = value.get("kind")
        rest = {name: entry for name, entry in value.items() if name != "kind"}
        return " ".join(part for part in (str(kind) if kind else "", f"({_fields(rest)})" if rest else "") if part)
    if isinstance(value, list | tuple):
        return f"({', '.join(_value(entry) for entry in value)})"
    return f"{value:g}" if isinstance(value, float) else str(value)


def _row(values: Iterable[float]) -> str:
    return ", ".join(f"{value:.4g}" for value in values)
