"""Laws of one arm: one controller for every arm of the cell."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, ClassVar, Generic, TypeVar

from pydantic import Field

from coop_pin.base.errors import FieldError
from coop_pin.base.schema.base import unknown_arms
from coop_pin.base.schema.parts import fields_of
from coop_pin.base.spatial.task_rows import joint_shortage
from coop_pin.control.bounds import CellTiming
from coop_pin.control.calibration import ZeroedController
from coop_pin.control.controller import ArmController, CellController, DecentralisedController
from coop_pin.control.force_paths.force_path import INSIST
from coop_pin.control.gains import Gains
from coop_pin.control.law import NearRest, ParametricLaw
from coop_pin.control.measurement import ControlledArm

G = TypeVar("G", bound=Gains)


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

    def build(self, scenario: Any, arms: Iterable[ControlledArm]) -> CellController:
        """Return the controller; see Law."""
        return DecentralisedController(self.controllers(scenario, arms))

    def controllers(self, scenario: Any, arms: Iterable[ControlledArm]) -> dict[str, ArmController]:
        """Return the controllers of all arms by name; arguments and errors as of ``build``."""
        laws, sized = dict[str, ArmController](), dict[tuple[int, ...], G]()
        for arm in arms:
            self._require_joints(arm)
            path = f"controller.arm_gains.{arm.name}" if arm.name in self.arm_gains else "controller.gains"
            gains, size = self.gains_of(arm.name), (arm.rows.size, arm.drives)
            if (key := (id(gains), *size)) not in sized:  # equal arms share them
                sized[key] = gains.sized(*size, path)
            law = self.controller_of(arm, sized[key], scenario)
            law = self.force_path.wrapped(law, arm, scenario)
            laws[arm.name] = ZeroedController(law, arm.rows, arm.start_pose) if self.zero_at_grasp else law
        return laws

    def _require_joints(self, arm: ControlledArm) -> None:
        """Refuse an arm with too few joints for the task rows, or too many for the printed law."""
        k, k_0 = arm.drives, arm.rows.size
        if k < k_0:
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
        return [*self._unequal(cell.arms), *self.feedback_problems(cell)]

    def _unequal(self, arms: Sequence[str]) -> list[FieldError]:
        """Return the gains that differ between arms although the theory needs one value for all."""
        problems: list[FieldError] = []
        for field, reason in self.equal_gains.items() if self.arm_gains else ():
            values = {name: fields_of(self.gains_of(name))[field] for name in arms}
            if len(set(values.values())) > 1:
                detail = f"differs between arms: {values}; {reason} for all arms"
                problems.append(FieldError(f"{detail}. Make them equal, {INSIST}", f"arm_gains.*.{field}"))
        return problems
