"""Run of a scenario with the controller that it names."""

from __future__ import annotations

import itertools
import logging
import math
import time
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from coop_pin.base.errors import CoopPinError, RunInterruptedError, ScenarioWarning
from coop_pin.base.schema.user_code import code_of, require_allowed
from coop_pin.compiled.engine_choice import choose_engine, plant_of, saved_by_auto
from coop_pin.compiled.engines import Engine, engine_named
from coop_pin.control.hidden_state import leaks, of_all_runs, unrepeatable
from coop_pin.description.scenario import Scenario
from coop_pin.results.finding import Finding, Findings, sorted_findings
from coop_pin.results.run_result import RunResult
from coop_pin.results.snapshot import Observer
from coop_pin.running.cell_findings import code_findings
from coop_pin.running.check import quick_findings
from coop_pin.running.plausibility import implausible_numbers
from coop_pin.simulation.build_controller import build_controller
from coop_pin.simulation.simulate import Progress, run_to_end
from coop_pin.simulation.simulation import Simulation
from coop_pin.stability.step_size import with_changes

_LOG = logging.getLogger("coop_pin")
_WORTH_A_HINT = 5.0
"""Wall time that another engine must save to be named, s."""


def run(
    scenario: Scenario | str | Path,
    overrides: Mapping[str, Any] | None = None,
    *,
    progress: Progress | None = None,
    view: Observer | None = None,
    realtime_rate: float | None = None,
    stop_at_breach: bool = False,
    engine: Engine = "pinocchio",
    warn: bool = True,
) -> RunResult:
    """Return the result of a scenario with the controller that it names.

    Errors and warnings of ``quick_findings`` come before the run, each as a ScenarioWarning, and stay with
    the result as ``findings``; ``cp.check`` lists more, with remedies.

    Args:
        scenario: a Scenario, a name in the catalogue, or the path of a TOML file.
        overrides: fields to change, by dotted path, for example ``{"controller.gains.sign_gain": 0.0}``;
            ``{"clock.steps_per_tick": "auto"}`` is the fewest steps that keep 1e-8 m, see ``fewest_steps``.
        progress: function that is called with (ticks done, ticks in all): after every tick, of compiled
            runs after some hundred.
        view: function that is called with a snapshot after every tick, for example what
            coop_pin.open_view returns.
        realtime_rate: simulated seconds in one second of wall time; inf is as fast as possible. When omitted
            1 with a view, otherwise inf.
        stop_at_breach: end the run at its first breach of the scenario's trust thresholds.
        engine: engine of the run. "compiled" is faster, and equal to rounding: code of plant, sensors, law
            and drives where they can be compiled and nothing is to be done at every tick, otherwise of the
            plant alone; the log says which. A run of the first kind that breaks off is repeated as one of the
            second, which tells its error. "auto" takes the fastest for this length; see ``choose_engine``.
            "mujoco" has the accelerations and grasp forces of MuJoCo, whose welds are soft.
        warn: whether to look for what makes the run doubtful; that takes a part of a second. An edit of the
            user's code after it was loaded is always warned of.

    Raises:
        ScenarioError: the scenario has mistakes.
        CodeRefusedError: it names code of a module that is neither the user's nor listed.
        FieldError: the engine that is named does not have the scenario's plant or one of its events.
        MissingExtraError: engine "mujoco" without mujoco.
        CoopPinError: the run could not start, or broke off; ``error.result`` holds what was computed.
    """
    if not isinstance(scenario, Scenario):
        scenario = Scenario.load(scenario)
    if overrides is not None:
        scenario = with_changes(scenario, overrides)
    code = code_of(scenario)
    require_allowed(code)
    before, controller = of_all_runs(code if warn else ()), build_controller(scenario)
    findings = list[Finding]()
    known = implausible_numbers(scenario) if warn else ()
    for finding in itertools.chain(code_findings(scenario), known):  # also where it cannot start
        if finding.severity != "note":
            warnings.warn(str(finding), ScenarioWarning, stacklevel=2)
            findings.append(finding)
    is_live = view is not None or stop_at_breach or realtime_rate not in (None, math.inf)
    choice = choose_engine(scenario, engine_named(engine, "engine"), is_live=is_live)
    if engine != "pinocchio":  # else nothing was chosen
        _LOG.info(choice.summary())
    is_lane = choice.way == "lanes"  # which is prepared from the numbers of a Pinocchio tree
    plant = plant_of("pinocchio" if is_lane else choice.engine)
    simulation = Simulation(scenario, controller, plant=plant)
    for finding in quick_findings(simulation).of("error", "warning") if warn else ():
        warnings.warn(str(finding), ScenarioWarning, stacklevel=2)
        findings.append(finding)
    noted = Findings(scenario.name, sorted_findings(findings))
    started = time.perf_counter()
    result = _run_as_lane(simulation, progress) if is_lane else None
    if result is None:
        if is_lane:
            simulation = Simulation(scenario, controller, plant=plant_of(choice.engine))
        try:
            result = run_to_end(
                simulation,
                progress=progress,
                view=view,
                realtime_rate=realtime_rate,
                stop_at_breach=stop_at_breach,
            )
        except (CoopPinError, RunInterruptedError) as error:
            if error.result is not None:
                error.result.note(noted)
            raise
    for sentence in (*leaks(before, code), *unrepeatable(code if warn else ())):
        findings.append(Finding("user code", "controller", "warning", sentence))
        warnings.warn(sentence, ScenarioWarning, stacklevel=2)
    result.note(Findings(scenario.name, sorted_findings(findings)))
    if choice.engine == "pinocchio" and warn and not is_live:
        saved = saved_by_auto(scenario, time.perf_counter() - started)
        if saved > _WORTH_A_HINT:
            _LOG.warning("engine 'auto' would have saved about %.0f s of this run", saved)
    return result


def _run_as_lane(simulation: Simulation, progress: Progress | None) -> RunResult | None:
    """Return the result of a run by compiled code; None where it is repeated with an interpreted law.

    Args:
        simulation: the run before its first tick.
        progress: function that is called after chunks of ticks.
    """
    from coop_pin.compiled.lane import Lane  # a run by Pinocchio does without its compiler

    try:
        lane = Lane(simulation.scenario, simulation)
    except (Exception, SystemExit) as error:  # also of a user's motion, at a tick that the other run names
        _LOG.info("the law is interpreted: %s: %s", type(error).__name__, error)
        return None
    return lane.run(progress)
