"""Planned carry: a line of the payload in least time, or with least effort, and the torques of it."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from coop_pin.base.arrays import Array, as_fitting_count, as_number, require_path, require_type
from coop_pin.base.errors import ArgumentError, FileReadError, InfeasibleMotionError, OutOfRangeError
from coop_pin.base.schema.base import Description, Matrix, NotNegative, Positive
from coop_pin.base.schema.pose import Pose
from coop_pin.base.user_files import read_user_file
from coop_pin.control.laws.feed_forward import FeedForward, FeedForwardController, FeedForwardState
from coop_pin.description.actuators import Actuators
from coop_pin.description.cell.cell import Cell
from coop_pin.description.cell.miscalibration import Miscalibration
from coop_pin.description.scenario import Scenario
from coop_pin.description.sensors import Sensors, WristSensor
from coop_pin.design.carried_path import CarriedLine
from coop_pin.design.carry_limits import KNOTS, CarryLimits, CarryTiming, slower
from coop_pin.reference.lines import TimedLineMotion
from coop_pin.reference.squeeze import ConstantSqueeze, Squeeze, SqueezeReference
from coop_pin.simulation.build_controller import build_controller
from coop_pin.simulation.simulation import Simulation

_PLACE = 8192.0
"""Memory of a place of the path, bytes."""
_MOST_BYTES = 50_000_000
_LATER = 0.5
"""Part of a tick by which torques held over it are later than the tick."""
_SAME = 1e-6
"""Part of a tick within which a time is that of the tick."""


Method: TypeAlias = Literal["least time", "least effort", "quintic"]


class CarryPlan(Description):
    """A carry along a line: its motion, and the drive torques that give it and the desired squeeze.

    Attributes:
        cell: the cell.
        squeeze: desired internal wrenches.
        motion: motion of the payload, from t = 0 on.
        method: "least time", "least effort", or "quintic" where that is as good.
        quintic_duration: least duration of the quintic from rest to rest at the same limits, s.
        effort: integral of the sum of the squared drive torques, N^2 m^2 s.
        quintic_effort: the same of the quintic of least duration; for "least effort" of the quintic of the
            same duration.
        torques: torques of the drives of every arm at the times of the motion, friction included, N m.
    """

    cell: Cell
    squeeze: Squeeze
    motion: TimedLineMotion
    method: Method
    quintic_duration: Positive
    effort: NotNegative
    quintic_effort: NotNegative
    torques: dict[str, Matrix]

    @property
    def duration(self) -> float:
        """Time from start to goal, s."""
        return self.motion.times[-1]

    def summary(self) -> str:
        """Return durations and efforts in one line."""
        less = 100.0 * (1.0 - self.duration / self.quintic_duration)
        return (
            f"{self.method}: {self.duration:.3g} s, {less:.0f} % less than the quintic's"
            f" {self.quintic_duration:.3g} s at the same limits; effort {self.effort:.4g} N^2 m^2 s, of the"
            f" quintic {self.quintic_effort:.4g}"
        )

    def save(self, path: str | Path) -> None:
        """Write the plan as JSON."""
        require_path("path", path)
        Path(path).write_text(self.model_dump_json(), encoding="utf-8")

    @classmethod
    def load(cls, path: str | Path) -> CarryPlan:
        """Return the plan of a JSON file.

        Raises:
            FileReadError: the file cannot be read, or is no JSON.
            ScenarioError: it holds no plan.
        """
        require_path("path", path)
        try:
            fields = json.loads(read_user_file(str(path), limit=_MOST_BYTES, kind="a plan"))
        except ValueError as error:
            raise FileReadError(f"is no JSON: {error}", str(path)) from None
        if not isinstance(fields, dict):
            raise FileReadError("holds no table of fields", str(path))
        return cls(**fields)

    def torques_at(self, times: ArrayLike) -> list[Array]:
        """Return the torques of every arm at n times since the start, N m, shape (n, k) each."""
        from scipy.interpolate import CubicSpline  # slow to load

        held = np.clip(times, 0.0, self.duration)
        tables = map(np.array, self.torques.values())
        return [CubicSpline(self.motion.times, table)(held) for table in tables]

    def played_by(self, scenario: Scenario, *, start_time: float = 1.0, rest: float = 1.0) -> Scenario:
        """Return a scenario that plays the plan: its motion, squeeze and feed-forward torques, with its law.

        The law first holds the payload at rest, and brings the squeeze up if it starts without. Then it gets
        what the plan's torques have beyond its own commands: a simulation along the plan asks the law for
        these, with measurements and drives without errors. So the commands on the plan are those of the plan,
        for any law that commands torques.

        Args:
            scenario: Law, clock, sensors and plant; its cell must be that of the plan.
            start_time: Time at which the payload leaves, s.
            rest: Time after it arrives, s.

        Raises:
            ArgumentError: the cell is another one, or arms take no torques or add their own.
        """
        require_type("scenario", scenario, Scenario)
        self._require_plays(scenario)
        start_time, rest = as_number("start_time", start_time), as_number("rest", rest)
        times = tuple(start_time + time for time in self.motion.times)
        still: dict[str, Any] = {"feed_forward": None, "events": (), "start_angles": {}}
        ticks = np.ceil((times[-1] + rest) * scenario.clock.rate_hz - _SAME)
        duration = float(ticks) / scenario.clock.rate_hz
        still |= {"start": self.motion.start, "squeeze": self.squeeze, "duration": duration}
        moved = scenario.replace(motion=self.motion.replace(times=times), **still)
        return moved.replace(feed_forward=_beyond_the_law(self, _without_errors(moved), start_time))

    def _require_plays(self, scenario: Scenario) -> None:
        if scenario.cell != self.cell:
            raise ArgumentError("the scenario's cell is not that of the plan; plan with scenario.cell")
        for name in self.cell.arms:
            actuators = scenario.actuators_of(name)
            if actuators.servo is not None or actuators.gravity_compensation is not None:
                detail = f"arm {name!r} takes no torques, or adds its own weight to them"
                raise ArgumentError(f"{detail}; a plan states whole torques")


def plan_carry(
    cell: Cell,
    start: Pose,
    goal: Pose,
    *,
    squeeze: Squeeze | None = None,
    duration: float | None = None,
    reserve: float = 0.05,
    smoothing: float = 0.05,
    places: int = 201,
) -> CarryPlan:
    """Return the carry of least time along a line, or of least effort in a stated duration.

    The payload moves straight and turns on the geodesic. Drive torques with the desired internal wrenches,
    and the friction that pads need, are affine in s'' and s'^2; ``fastest`` solves that. A moving average in
    time makes accelerations continuous, and a stretch of time brings back what it exceeds.

    Args:
        cell: Cell with rigid grasps; its torque, speed and joint limits and pads are the limits.
        start: Pose of the payload at the start; the arms are nearest to their postures.
        goal: Pose at the end, less than half a turn away.
        squeeze: Desired internal wrenches, constant; none when omitted.
        duration: Duration of a carry of least effort, s; least time when omitted.
        reserve: Part of torque, speed and friction that is left for feedback.
        smoothing: Width of the moving average, s.
        places: Number of places of the path at which limits are looked at.

    Raises:
        UnreachablePoseError: an arm cannot hold the start.
        InfeasibleMotionError: cause "reach": an arm cannot follow; "limits": a joint limit, no limit at all,
            or a duration that is too short; "torque": a limit exceeded at rest.
        ArgumentError: a grasp is not rigid.
        NotEnoughMemoryError: so many places, or so narrow a moving average, do not fit.
    """
    require_type("cell", cell, Cell)
    if not 0.0 <= (reserve := as_number("reserve", reserve)) < 1.0:
        raise OutOfRangeError("reserve", reserve, "from 0 up to, but not, 1")
    if not (smoothing := as_number("smoothing", smoothing)) > 0.0:
        raise OutOfRangeError("smoothing", smoothing)
    places = as_fitting_count("places", places, 21, _PLACE)
    line = TimedLineMotion(start=start, goal=goal, times=(0.0, 1.0), fractions=(0.0, 1.0))
    squeeze = ConstantSqueeze() if squeeze is None else squeeze
    require_type("squeeze", squeeze, SqueezeReference)
    squeeze.check_arms(cell.grasps)
    chain = CarriedLine(cell, line)
    path = chain.dynamics(np.linspace(0.0, 1.0, places), squeeze.at(0.0, cell.grasps))
    limits = CarryLimits.of(cell, path, reserve)
    limits.require_rest(cell)
    best, quintic = limits.least_time(line, smoothing), limits.stretched(line)
    method: Method = "least time" if best.times[-1] < quintic.times[-1] else "quintic"
    best, rival = min(best, quintic, key=lambda motion: motion.times[-1]), quintic
    if duration is not None:
        if not as_number("duration", duration) >= best.times[-1]:
            detail = f"{duration:.4g} s are too short; the least time is {best.times[-1]:.4g} s"
            raise InfeasibleMotionError("limits", detail)
        seeds = [slower(each, max(duration / each.times[-1], 1.0)) for each in (best, quintic)]
        seeds = [seed for seed in seeds if seed.times[-1] <= duration]
        best, rival = min(map(limits.least_effort, seeds), key=limits.effort), slower(line, duration)
        method = "least effort"
    timing = CarryTiming.of(best, max(KNOTS, len(best.times)))
    table = path.at(timing.s).torques(timing.v, timing.a)
    return CarryPlan(
        cell=cell,
        squeeze=squeeze,
        motion=best.replace(times=timing.times, fractions=timing.s),
        method=method,
        quintic_duration=quintic.times[-1],
        effort=limits.effort(best),
        quintic_effort=limits.effort(rival),
        torques=dict(zip(cell.arms, np.split(table, chain.edges, axis=1), strict=True)),
    )


def _without_errors(scenario: Scenario) -> Scenario:
    """Return a scenario with exact sensors, drives and kinematics of the arms."""
    wrists = WristSensor() if scenario.wrists else None
    exact = {
        name: arm.replace(calibration_error=Miscalibration()) for name, arm in scenario.cell.arms.items()
    }
    return scenario.replace(
        cell=scenario.cell.replace(arms=exact),
        sensors=Sensors(wrist=wrists),
        arm_sensors={},
        actuators=Actuators(),
        arm_actuators={},
        beyond_bound=True,
    )


def _beyond_the_law(plan: CarryPlan, scenario: Scenario, start_time: float) -> FeedForward:
    """Return the torques that a plan has beyond the commands of the law of a scenario, tick by tick.

    The run is simulated until the start. Then the plant is put on the plan at every tick, with its torques,
    and the law steps.
    """
    line, motion, period = (
        CarriedLine(plan.cell, plan.motion, scenario.plant),
        plan.motion,
        scenario.clock.period,
    )
    simulation = Simulation(scenario, build_controller(scenario))
    while simulation.time < start_time - _SAME * period:
        simulation.tick()
    plant, nothing = simulation.plant, [np.zeros(len(slot.drive)) for slot in simulation.slots]

    def missing(time: float, commanded: Sequence[Array]) -> Sequence[Array]:
        planned = plan.torques_at(time - start_time + _LATER * period)
        return [torque - command for torque, command in zip(planned, commanded, strict=True)]

    simulation.controller = FeedForwardController(simulation.controller, missing)
    simulation.controller_state = FeedForwardState(simulation.controller_state, nothing)
    times, added = list[float](), list[Sequence[Array]]()
    while not times or times[-1] < start_time + plan.duration:
        times.append(simulation.time)
        s = motion.scaling(times[-1] - start_time)
        q, rate, _ = line.derivatives(s.value)
        plant.restore(plant.state()._replace(q=q, v=rate * s.rate))
        plant.drive(plan.torques_at(times[-1] - start_time))
        simulation.tick()
        added.append(simulation.controller_state.added)
    tables = (np.array(rows) for rows in zip(*added, strict=True))
    return FeedForward(times=times, torques=dict(zip(plan.cell.arms, tables, strict=True)))
