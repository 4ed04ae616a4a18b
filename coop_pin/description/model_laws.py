"""Laws that compute with a model of the cell, and their gains; their controllers are in model_based."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, ClassVar, Generic, Literal, TypeVar

from coop_pin.base.schema.base import Description, Interval, NotNegative, Positive
from coop_pin.base.schema.user_code import load_class
from coop_pin.control import ArmController, CellController, ControlledArm
from coop_pin.control.gains import Gains, PositiveRow
from coop_pin.control.law import DecentralisedLaw, ParametricLaw


class ModelFactors(Description):
    """Factors by which the model of a controller is off; 1 is exact.

    Attributes:
        mass: Factor of the masses of all links and of the payload; gravity and first moments scale with them.
        inertia: Factor of their rotational inertias about their centres of mass, and of those of rotors.
        friction: Factor of all friction coefficients.
    """

    mass: Positive = 1.0
    inertia: Positive = 1.0
    friction: NotNegative = 1.0


class AnchoredGains(Gains):
    """Gain common to the laws with an internal force integral.

    Attributes:
        anchor_gain: g of the internal force integral.
    """

    anchor_gain: NotNegative = 0.1


G = TypeVar("G", bound=AnchoredGains)


def _made(law: Any, gains: Gains, scenario: Any, seat: Any) -> Any:
    """Return the controller of a law with sized gains, for an arm or for all arms."""
    return load_class(law.controller)(law.model_copy(update={"gains": gains}), scenario, seat)


class ModelBasedLaw(DecentralisedLaw[G], Generic[G]):
    """A law of one arm with a model; its controller, in model_based above this package, loads when built."""

    controller: ClassVar[str]
    spare_spring: ClassVar[str] = "controller.gains.spare_gains"
    equal_gains: ClassVar[Mapping[str, str]] = {
        "anchor_gain": "else the anchors move the payload: it needs one g"
    }

    def controller_of(self, arm: ControlledArm, gains: G, scenario: Any) -> ArmController:
        """Return the controller of one arm."""
        return _made(self, gains, scenario, arm)


class CentralisedLaw(ParametricLaw[G], Generic[G]):
    """A law of all arms with a model; its controller, in model_based above this package, loads when built.

    Attributes:
        model: Factors by which the model is off.
    """

    controller: ClassVar[str]
    spare_spring: ClassVar[str] = "controller.gains.spare_gains"

    model: ModelFactors = ModelFactors()

    def build(self, scenario: Any, arms: Iterable[ControlledArm]) -> CellController:
        """Return the controller; see Law."""
        seats = list(arms)
        return _made(self, self.gains.sized(seats[0].rows.size, 0), scenario, seats)


class ComputedTorqueGains(AnchoredGains):
    """Gains of computed torque; one number for all task rows, or one for each.

    Attributes:
        position_gain: K_p, 1/s^2.
        velocity_gain: K_v, 1/s.
        spare_gains: k_p, 1/s^2, and k_v, 1/s, of the spare joints.
    """

    on_rows: ClassVar[tuple[str, ...]] = ("position_gain", "velocity_gain")

    position_gain: PositiveRow = 25.0
    velocity_gain: PositiveRow = 10.0
    spare_gains: Interval = (25.0, 10.0)


class ComputedTorque(ModelBasedLaw[ComputedTorqueGains]):
    """Computed torque of closed chains with an integral of the internal force: ComputedTorqueController.

    Attributes:
        model: Factors by which the model is off.
    """

    controller: ClassVar[str] = "coop_pin.model_based.computed_torque:ComputedTorqueController"
    uses: ClassVar[tuple[str, ...]] = ("model", "internal wrench")

    kind: Literal["computed-torque"] = "computed-torque"
    gains: ComputedTorqueGains = ComputedTorqueGains()
    model: ModelFactors = ModelFactors()


class AdaptiveGains(AnchoredGains):
    """Gains of adaptive control.

    Attributes:
        pose_gain: gamma, 1/s, one for all task rows or one for each.
        damping_gain: K_d, N m s/rad, one for all drives or one for each.
        adaptation: G of all parameters of the arm, in their SI units.
        payload_adaptation: G_0, likewise.
        disturbance_rate: G_d, N m/rad.
        spare_gain: k_p of spare joints, 1/s.
    """

    on_rows: ClassVar[tuple[str, ...]] = ("pose_gain",)
    on_drives: ClassVar[tuple[str, ...]] = ("damping_gain",)

    pose_gain: PositiveRow = 4.0
    damping_gain: PositiveRow = 20.0
    adaptation: NotNegative = 1.0
    payload_adaptation: NotNegative = 1.0
    disturbance_rate: NotNegative = 0.0
    spare_gain: NotNegative = 4.0


class Adaptive(ModelBasedLaw[AdaptiveGains]):
    """Adaptive control of closed chains with regressors of arms and payload: AdaptiveController.

    Attributes:
        model: Factors by which the first estimates are off; when omitted they are 0.
    """

    controller: ClassVar[str] = "coop_pin.model_based.adaptive:AdaptiveController"
    uses: ClassVar[tuple[str, ...]] = ("regressor", "internal wrench")

    spare_spring: ClassVar[str] = "controller.gains.spare_gain"

    kind: Literal["adaptive"] = "adaptive"
    gains: AdaptiveGains = AdaptiveGains()
    model: ModelFactors | None = None


class ObjectImpedanceGains(AnchoredGains):
    """Gains of object impedance; one number for all task rows, or one for each.

    Attributes:
        inertia: M_d, kg and kg m^2.
        damping: D, N s/m and N m s/rad.
        stiffness: K, N/m and N m/rad.
        spare_gains: k_p, 1/s^2, and k_v, 1/s, of the spare joints.
    """

    on_rows: ClassVar[tuple[str, ...]] = ("inertia", "damping", "stiffness")

    inertia: PositiveRow = 20.0
    damping: PositiveRow = 400.0
    stiffness: PositiveRow = 2000.0
    spare_gains: Interval = (25.0, 10.0)


class ObjectImpedance(CentralisedLaw[ObjectImpedanceGains]):
    """Object impedance: the payload responds to a wrench like a stated mass: ObjectImpedanceController."""

    controller: ClassVar[str] = "coop_pin.model_based.object_impedance:ObjectImpedanceController"
    uses: ClassVar[tuple[str, ...]] = ("model", "wrenches of all arms", "internal wrench")

    kind: Literal["object-impedance"] = "object-impedance"
    gains: ObjectImpedanceGains = ObjectImpedanceGains()


class TorqueQp(CentralisedLaw[ComputedTorqueGains]):
    """Torques by a quadratic program: TorqueQpController.

    Attributes:
        tracking_weight: w, N^2 s^4/m^2.
        friction_coefficient: mu of the grasps; no cones when omitted.
    """

    controller: ClassVar[str] = "coop_pin.model_based.torque_qp:TorqueQpController"
    uses: ClassVar[tuple[str, ...]] = ("model", "internal wrench", "states of all arms")

    kind: Literal["torque-qp"] = "torque-qp"
    gains: ComputedTorqueGains = ComputedTorqueGains()
    tracking_weight: Positive = 1e4
    friction_coefficient: Positive | None = None
