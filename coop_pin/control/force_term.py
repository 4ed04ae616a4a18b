"""The force part that the laws share: f_d - K_f ftilde."""

from __future__ import annotations

from coop_pin.arrays import Array
from coop_pin.control.contract import ArmReference
from coop_pin.control.measurement import ArmMeasurement
from coop_pin.spatial.task_rows import TaskRows


def force_term(rows: TaskRows, force_gain: float, measurement: ArmMeasurement, reference: ArmReference) -> Array:
    """Return f_d - K_f ftilde in world axes, or f_d where no internal wrench is measured, shape (k_0,).

    f_d turns with the payload pose that this arm sees. Gueaieb et al. (2007), eq. (23).
    """
    f_d = rows.turn(measurement.payload_pose, reference.internal_wrench)
    if measurement.internal_wrench is None:
        return f_d
    return f_d - force_gain * (measurement.internal_wrench - f_d)
