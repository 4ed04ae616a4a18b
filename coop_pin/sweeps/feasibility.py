"""Feasibility of runs before the first: what every run of a sweep, a search or a comparison would fail by."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping

from coop_pin.base.errors import CoopPinError, FieldError, InfeasibleMotionError, ScenarioError
from coop_pin.description.scenario import Scenario
from coop_pin.feasibility.carried_motion import seen_by_arms
from coop_pin.feasibility.reachability import reachability
from coop_pin.simulation.build_controller import build_controller

_POSES = 41
"""Poses of a path that are looked at."""
_PATH_FIELDS = {"cell", "start", "motion", "duration"}
"""Fields of a scenario that decide whether its path is within reach, but for the cell's payload."""
_MOST_PATHS = 16
"""Paths out of reach after which the others are left to their runs: each takes a second."""


def require_feasible(
    runs: Iterable[Scenario | ScenarioError], obstacles: dict[str, CoopPinError | None] | None = None
) -> None:
    """Refuse runs of which none can succeed; one that can is enough, since a sweep may search for a limit.

    Mistakes in the scenario, a law of the package that the cell cannot have, and a path out of reach are
    looked at. Code of users is not called: their runs report its errors.

    Args:
        runs: scenario of each run, or the mistakes in it.
        obstacles: obstacles of the paths looked at before, by their fields as JSON; more are added.

    Raises:
        CoopPinError: why the first of them must fail: ScenarioError, FieldError, UrdfError, or
            InfeasibleMotionError with cause "reach".
    """
    first, obstacles = None, {} if obstacles is None else obstacles
    for run in runs:
        obstacle = run if isinstance(run, ScenarioError) else _obstacle(run, obstacles)
        if obstacle is None:
            return
        first = first or obstacle
    if first is not None:
        raise first


def require_feasible_groups(groups: Mapping[str, Iterable[Scenario | ScenarioError]]) -> None:
    """Refuse groups of runs (of a controller, a trial, a case) in which none can succeed.

    Args:
        groups: runs by the path of what they have in common, for example "trials.push".

    Raises:
        FieldError: the path, and why the first run must fail; its cause is that run's error.
    """
    obstacles = dict[str, CoopPinError | None]()
    for path, runs in groups.items():
        try:
            require_feasible(runs, obstacles)
        except CoopPinError as error:
            raise FieldError(f"must fail in every run: {error}", path) from error


def _obstacle(scenario: Scenario, obstacles: dict[str, CoopPinError | None]) -> CoopPinError | None:
    """Return why a run must fail; None if nothing is known against it."""
    path = scenario.model_dump_json(include=_PATH_FIELDS, exclude={"cell": {"payload"}})
    if path not in obstacles:
        if len([*filter(None, obstacles.values())]) >= _MOST_PATHS:
            return None
        obstacles[path] = _error_of(require_reach, scenario)
    if obstacles[path] is None and not scenario.controller.user_code:
        return _error_of(build_controller, scenario)
    return obstacles[path]


def _error_of(function: Callable[[Scenario], object], scenario: Scenario) -> CoopPinError | None:
    try:
        function(scenario)
    except CoopPinError as error:
        return error
    return None


def require_reach(scenario: Scenario) -> None:
    """Refuse a path that leaves an arm's reach; paths of users' functions are not looked at.

    Raises:
        InfeasibleMotionError: cause "reach", with arm, time and gap.
        UrdfError, NameNotFoundError, FileReadError: an arm or the motion cannot be built.
    """
    scenario = seen_by_arms(scenario)
    if scenario.motion.kind != "function":
        for name in scenario.cell.arms:
            (arm,) = reachability(scenario, poses=_POSES, arms=[name]).arms
            if arm.start_error is not None or arm.unreachable is not None:
                raise InfeasibleMotionError("reach", f"arm {arm.arm!r} {'; '.join(arm.problems())}")
