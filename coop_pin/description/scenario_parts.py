"""Parts of a scenario: its fields, and what they say of an arm, of the wrists, or at a time."""

from __future__ import annotations

from collections.abc import Sequence

from pydantic import Field

from coop_pin.base.arrays import Array
from coop_pin.base.schema.base import (
    Description,
    Name,
    Positive,
    Text,
    Vector,
)
from coop_pin.base.schema.pose import Pose
from coop_pin.control import CellTiming
from coop_pin.control.bounds import SampledWrist
from coop_pin.control.laws.feed_forward import FeedForward
from coop_pin.description.actuators import Actuators
from coop_pin.description.cell.cell import Cell
from coop_pin.description.cell.grasp_plan import GraspPlan, grasp_plan
from coop_pin.description.controller import Controller
from coop_pin.description.events import Partner, Surroundings, of_kind
from coop_pin.description.grasp_events import Event, GraspEvent, PutDown
from coop_pin.description.network import ArmClock, Network
from coop_pin.description.plant import Clock, PlantOptions
from coop_pin.description.sensors import Sensors
from coop_pin.description.trust import TrustThresholds
from coop_pin.reference.motions import Motion
from coop_pin.reference.squeeze import ConstantSqueeze, Squeeze


class ScenarioParts(Description):
    """Fields of a scenario, and what follows from them.

    Attributes:
        name: 1 to 100 characters without slashes, colons and control characters, and no dot in front;
            ``coop-pin run`` writes into out/ and this name.
        summary: description in one line.
        duration: simulated time, s.
        beyond_bound: accept gains outside the bounds of the theory or of the sampling.
        cell: arms, payload, grasps.
        controller: control law and gains, or a user's own controller.
        motion: desired motion of the payload.
        squeeze: desired internal wrench f_d of each arm about P in *payload* axes, N and N m: a table by arm,
            a ramp, or a function; zero when omitted.
        start: payload pose at t = 0, at rest.
        start_angles: joint angles of every arm at t = 0, instead of the inverse kinematics of ``start``; they
            must close the chain at ``start``.
        project_start: project open starting angles onto the closed chain instead of refusing them; the
            payload then starts at the projected pose.
        events: changes of the payload, wrenches on it, failures of arms, and openings and closings of grasps.
        clock: control rate and integration steps.
        plant: formulation and integration of the plant.
        actuators: actuators of every arm: what its drives make of their commands.
        arm_actuators: actuators of single arms, in place of ``actuators``.
        trust: thresholds beyond which the run is not trustworthy.
        sensors: sensors of every arm.
        arm_sensors: sensors of single arms, in place of ``sensors``.
        seed: seed of the random sources; every source draws from a generator of its own.
        network: messages between the arms; without one, none cross.
        feed_forward: torques that are added to those of the law.
    """

    name: Name
    summary: Text = ""
    duration: Positive = Field(default=20.0, le=1e8)
    beyond_bound: bool = False
    cell: Cell
    controller: Controller
    motion: Motion
    squeeze: Squeeze = ConstantSqueeze()
    start: Pose
    start_angles: dict[str, Vector] = Field(default_factory=dict)
    project_start: bool = False
    events: tuple[Event, ...] = ()
    clock: Clock = Clock()
    plant: PlantOptions = PlantOptions()
    actuators: Actuators = Actuators()
    arm_actuators: dict[str, Actuators] = Field(default_factory=dict)
    trust: TrustThresholds = TrustThresholds()
    sensors: Sensors = Sensors()
    arm_sensors: dict[str, Sensors] = Field(default_factory=dict)
    seed: int = Field(default=0, ge=0, lt=2**63)
    network: Network | None = None
    feed_forward: FeedForward | None = None

    def actuators_of(self, arm: str) -> Actuators:
        """Return the actuators of one arm, with its failure."""
        actuators = self.arm_actuators.get(arm, self.actuators)
        for event in self.events:
            actuators = event.actuated(arm, actuators)
        return actuators

    def actuators_path(self, arm: str) -> str:
        """Return the path of the actuators of one arm."""
        return f"arm_actuators.{arm}" if arm in self.arm_actuators else "actuators"

    @property
    def has_servos(self) -> bool:
        """Whether an arm takes velocities or positions."""
        return any(self.actuators_of(arm).servo is not None for arm in self.cell.arms)

    @property
    def wrists(self) -> list[SampledWrist]:
        """Delay and sampling of the wrist sensors that the arms have, in ticks, with that of messages."""
        sensors = [wrist for arm in self.cell.arms if (wrist := self.sensors_of(arm).wrist) is not None]
        path, network, late, every = self.controller.force_path, self.network, 0, 1
        if path.hears_all and network is not None:
            late = network.slowest_of(list(self.cell.arms))
            every = self.clock.ticks_between(network.rate_hz)
        return [
            SampledWrist(wrist.delay + late, max(every, self.clock.ticks_between(wrist.rate_hz)))
            for wrist in sensors
        ]

    @property
    def oldest_wrench(self) -> int:
        """Age of the oldest wrench that a law is given, ticks."""
        sampled = (wrist.delay + wrist.every - 1 for wrist in self.wrists)
        return self.controller.force_path.delay + max(sampled, default=0)

    @property
    def timing(self) -> CellTiming:
        """Arms, wrists and drives, against which the controller is checked."""
        rows, period = self.cell.task_rows.size, self.clock.period
        return CellTiming(list(self.cell.arms), rows, period, self.wrists, self.actuator_lag)

    @property
    def actuator_lag(self) -> float:
        """Largest lag of the arms' drives, ticks."""
        return max(self.actuators_of(arm).lag for arm in self.cell.arms) / self.clock.period

    def sensors_of(self, arm: str) -> Sensors:
        """Return the sensors of one arm."""
        return self.arm_sensors.get(arm, self.sensors)

    @property
    def clocks(self) -> dict[int, ArmClock]:
        """Clocks that are not exact, by the arm's number."""
        clocks = {} if self.network is None else self.network.clocks
        return {index: clocks[name] for index, name in enumerate(self.cell.arms) if name in clocks}

    def surroundings_at(self, time: float) -> Surroundings:
        """Return the payload, and what acts on it from outside, from a time on, s."""
        surroundings = self.cell.surroundings
        for event in sorted(self.events, key=lambda event: event.time):
            if event.time <= time:
                surroundings = event.apply(surroundings, time)
        return surroundings

    @property
    def grasp_events(self) -> tuple[GraspEvent, ...]:
        """Events at grasps."""
        return of_kind(self.events, GraspEvent)

    @property
    def put_downs(self) -> tuple[PutDown, ...]:
        """Events that hand the load to a table."""
        return of_kind(self.events, PutDown)

    @property
    def partners(self) -> tuple[Partner, ...]:
        """Persons or machines at handles."""
        return of_kind(self.events, Partner)

    def grasp_plan_at(self, time: float, missed: Sequence[GraspEvent] = ()) -> GraspPlan:
        """Return the plan of the grasps from a time on, s, without the events that did not happen."""
        return grasp_plan(self.cell, self.events, time, missed, self.controller.force_path.split)

    @property
    def has_grasp_plan(self) -> bool:
        """Whether grasps open or close, or a table takes the load."""
        return bool(self.grasp_events or self.put_downs)

    @property
    def squeeze_wrenches(self) -> Array:
        """f_d at t = 0 in payload axes in the order of the arms, shape (m, 6)."""
        return self.squeeze.at(0.0, self.cell.grasps)
