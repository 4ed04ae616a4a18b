"""Control laws as a scenario states them: fields, checks and properties of every law, with defaults."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Generic, NamedTuple, TypeVar

from pydantic import Field

from coop_pin.base.arrays import Array
from coop_pin.base.errors import FieldError
from coop_pin.base.schema.base import Description, unknown_arms
from coop_pin.base.schema.parts import fields_of
from coop_pin.base.spatial.grasp_rows import GraspRows
from coop_pin.base.spatial.task_rows import TaskRows, joint_shortage
from coop_pin.control.bounds import (
    CellTiming,
    ForcePath,
    SampledLoop,
    anchor_gain_problems,
    force_gain_problems,
    sampled_loop,
)
from coop_pin.control.controller import ArmController, CellController, DecentralisedController
from coop_pin.control.force_paths.force_path import INSIST, NoForcePath
from coop_pin.control.gains import Gains
from coop_pin.control.grasp_space import GraspSpaceController, gains_in_grasp
from coop_pin.control.law_wrapper import ZeroedController
from coop_pin.control.measurement import ControlledArm
from coop_pin.control.steady_state import NearRest, SteadyDirection


class LoadTransfer(NamedTuple):
    """Response of a law to a load that goes from arm to arm, or to a table.

    Attributes:
        follows_plan: Whether its arms read their load share from the plan of the grasps, as one that holds
            nothing must.
        releases: Whether measured wrenches take the load out of its integral when a table gets it.
    """

    follows_plan: bool = False
    releases: bool = False


class Law(Description):
    """A controller as a scenario states it.

    A law overrides ``build`` and what differs from these defaults: needs (``uses``) and commands
    (``command_kind``), the model near rest (``near_rest``, ``steady_directions``, ``joint_spring``), the
    response to a load that changes hands (``load_transfer``), and mistakes in a cell (``problems``).

    Attributes:
        force_path: Path by which the internal wrench reaches the law.
    """

    uses: ClassVar[tuple[str, ...]] = ()
    """Quantities that the law uses where they are measured, in addition to kinematics."""
    controls_grasps: ClassVar[bool] = False
    """Whether each arm controls the rows of its own grasp, where that is a joint."""
    controls_part: ClassVar[bool] = False
    """Whether arms may have fewer joints than a grasp that is a joint holds rows."""
    works_apart: ClassVar[bool] = False
    """Whether its arms may hold different things."""
    spare_spring: ClassVar[str] = ""
    """Path of the field with the spring of spare joints; empty if the law has none."""

    kind: str
    force_path: ForcePath = NoForcePath()

    @property
    def command_kind(self) -> str:
        """Kind of its commands: "torque", "velocity" or "position"; empty if only its controller knows."""
        return "torque"

    @property
    def near_rest(self) -> NearRest:
        """Model of the law near rest."""
        return NearRest()

    @property
    def beyond_dead_zone(self) -> Law:
        """The law as it acts on errors beyond a dead zone of its integral; itself without one."""
        return self

    @property
    def load_transfer(self) -> LoadTransfer:
        """Response to a load that changes hands."""
        return LoadTransfer()

    @property
    def user_code(self) -> tuple[str, ...]:
        """Names of the user's classes that the law runs, "module:name"."""
        return ()

    @property
    def needs(self) -> tuple[str, ...]:
        """Quantities that the law uses in its scenario, in the words of ``ArmController.needs``."""
        return self.measured(self.uses)

    def measured(self, needs: Iterable[str]) -> tuple[str, ...]:
        """Return needs with what the force path makes of "internal wrench": nothing if none is measured."""
        path = self.force_path
        wrench = ("internal wrench",) if path.exchanges_wrenches else ("own wrench", "learned mass")
        replaced = {"internal wrench": wrench if path.measures else ()}
        return tuple(name for need in needs for name in replaced.get(need, (need,)))

    @property
    def active_gains(self) -> dict[str, Any]:
        """Gains that have an effect, by name."""
        return {}

    @abstractmethod
    def build(self, scenario: Any, arms: Iterable[ControlledArm]) -> CellController:
        """Return the controller.

        Args:
            scenario: Scenario to run; only laws that build a model, and users' classes, look at it.
            arms: Arms of the cell; made one by one.

        Raises:
            FieldError: the law does not fit an arm's number of joints; a gain does not fit its arm.
            CoopPinError: a model cannot be built, or a user's class does not exist.
        """

    def problems(self, cell: CellTiming) -> list[FieldError]:
        """Return what is wrong with the law for a cell."""
        return []

    def steady_directions(self, rows: TaskRows, loop: SampledLoop, period: float) -> list[SteadyDirection]:
        """Return the law at rest in each linear task row; none where that takes more than its gains.

        Args:
            rows: The task rows.
            loop: Feedback of measured wrenches.
            period: T, s.
        """
        return []

    def joint_spring(self, arm: str, J_inverse: Array) -> Array | None:
        """Return B of the wrench B x by which an arm holds an error x at rest; None if not known.

        Args:
            arm: Name of the arm.
            J_inverse: Inverse of its payload Jacobian, shape (k, k_0).
        """
        return None


G = TypeVar("G", bound=Gains)


class ParametricLaw(Law, Generic[G]):
    """A law of the package with its gains.

    Attributes:
        gains: Gains of every arm.
    """

    gains: G

    def gains_of(self, arm: str) -> G:
        """Return the gains of one arm."""
        return self.gains

    @property
    def measures(self) -> bool:
        """Whether the law measures a wrench."""
        return self.force_path.measures

    @property
    def active_gains(self) -> dict[str, Any]:
        """Stated gains that have an effect, by name: feedback gains where a wrench is measured."""
        idle = {"force_gain": not self.force_path.measures, "anchor_gain": not self.measures}
        return {name: gain for name, gain in self.gains if gain is not None and not idle.get(name)}

    def loop(self, cell: CellTiming) -> SampledLoop:
        """Return the feedback of measured wrenches with its largest gains."""
        gains = [fields_of(self.gains_of(name)) for name in cell.arms]
        force_gain, anchor_gain = (
            max(gain.get(name, 0.0) for gain in gains) for name in ("force_gain", "anchor_gain")
        )
        loop = sampled_loop(self.force_path, cell.wrists, cell.lag)
        return loop._replace(force_gain=force_gain, anchor_gain=anchor_gain)

    def problems(self, cell: CellTiming) -> list[FieldError]:
        """Return what is wrong with the law for a cell."""
        return self.feedback_problems(cell)

    def feedback_problems(self, cell: CellTiming) -> list[FieldError]:
        """Return gains with which sampled force feedback is unstable, or that need what is not measured."""
        loop = self.loop(cell)
        force = force_gain_problems(self.force_path, cell.wrists, cell.lag, loop.force_gain)
        return force or anchor_gain_problems(self.force_path, loop)


@dataclass(frozen=True, eq=False)
class LawController(ArmController, Generic[G]):
    """Controller of one arm by a law with gains.

    Attributes:
        arm: Numbers of arm and cell that the law knows.
        gains: Gains, those of rows and drives as arrays.
    """

    arm: ControlledArm
    gains: G


class DecentralisedLaw(ParametricLaw[G], Generic[G]):
    """A law of one arm, for every arm of the cell.

    Attributes:
        arm_gains: Gains of single arms, in place of ``gains``.
        zero_at_grasp: Whether each arm places its payload frame at the scenario's start pose, once: a
            kinematic bias fixed in its tip vanishes.
    """

    equal_gains: ClassVar[Mapping[str, str]] = {}
    """Gains that must be the same for all arms, and why."""
    needs_square: ClassVar[bool] = False
    """Whether an arm must have exactly as many joints as task rows."""

    arm_gains: dict[str, G] = Field(default_factory=dict)
    zero_at_grasp: bool = False

    @property
    def near_rest(self) -> NearRest:
        """Model of the law near rest."""
        return super().near_rest._replace(is_zeroed=self.zero_at_grasp)

    def gains_of(self, arm: str) -> G:
        """Return the gains of one arm."""
        return self.arm_gains.get(arm, self.gains)

    def measured(self, needs: Iterable[str]) -> tuple[str, ...]:
        """Return needs as of any law, and the start pose where the arms place themselves by it."""
        return super().measured([*needs, "start pose"] if self.zero_at_grasp else needs)

    @abstractmethod
    def controller_of(self, arm: ControlledArm, gains: G, scenario: Any) -> ArmController:
        """Return the controller of one arm.

        Args:
            arm: The arm.
            gains: Gains of the arm, those of rows and drives as arrays.
            scenario: Scenario to run, for laws that build a model.
        """

    def gains_in(self, grasp: GraspRows, gains: G) -> G:
        """Return sized gains on the rows of a grasp, from those on the task rows."""
        return gains_in_grasp(gains, grasp, in_payload=False)

    def build(self, scenario: Any, arms: Iterable[ControlledArm]) -> CellController:
        """Return the controller; see Law."""
        return DecentralisedController(self.controllers(scenario, arms))

    def controllers(self, scenario: Any, arms: Iterable[ControlledArm]) -> dict[str, ArmController]:
        """Return the controllers of all arms by name; arguments and errors as of ``build``."""
        laws, sized = dict[str, ArmController](), dict[tuple[int, ...], G]()
        for arm in arms:
            seat = arm if arm.grasp is None else arm._replace(rows=arm.grasp)
            self._require_joints(seat)
            path = f"controller.arm_gains.{arm.name}" if arm.name in self.arm_gains else "controller.gains"
            gains, size = self.gains_of(arm.name), (arm.rows.size, arm.drives)
            if (key := (id(gains), *size)) not in sized:  # equal arms share them
                sized[key] = gains.sized(*size, path)
            if arm.grasp is None:
                law = self.controller_of(arm, sized[key], scenario)
            else:
                law = GraspSpaceController(
                    self.controller_of(seat, self.gains_in(arm.grasp, sized[key]), scenario), arm.grasp
                )
            law = self.force_path.wrapped(law, arm, scenario)
            laws[arm.name] = ZeroedController(law, arm.rows, arm.start_pose) if self.zero_at_grasp else law
        return laws

    def _require_joints(self, arm: ControlledArm) -> None:
        """Refuse an arm with too few joints for the task rows, or too many for the printed law."""
        k, k_0 = arm.drives, arm.rows.size
        if k < k_0 and not (self.controls_part and arm.grasp is not None):
            count, joints = "at least", joint_shortage(k, k_0)
        elif self.needs_square and k > k_0:
            remedy = "choose 'sliding-mode-redundant' or 'payload-space'"
            count, joints = "exactly", f"{k} joints, {k_0} task rows: {remedy}"
        else:
            return
        expected = f"{count} as many joints as task rows; arm {arm.name!r} has {joints}"
        raise FieldError(f"is {self.kind!r}, which needs {expected}", "controller.kind")

    def problems(self, cell: CellTiming) -> list[FieldError]:
        """Return gains of arms that are not there, that must be equal, or with which feedback is unstable."""
        if strangers := unknown_arms(self.arm_gains, cell.arms):
            return [problem.below("arm_gains") for problem in strangers]
        problems: list[FieldError] = []
        for field, reason in self.equal_gains.items() if self.arm_gains else ():
            values = {name: fields_of(self.gains_of(name))[field] for name in cell.arms}
            if len(set(values.values())) > 1:
                detail = f"differs between arms: {values}; {reason} for all arms"
                problems.append(FieldError(f"{detail}. Make them equal, {INSIST}", f"arm_gains.*.{field}"))
        return problems + self.feedback_problems(cell)
