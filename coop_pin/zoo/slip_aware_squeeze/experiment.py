"""Slip-aware squeeze: palms press harder as the crate slides, by a slip sensor that may be late."""

from typing import Any

import numpy as np

import coop_pin as cp
from coop_pin.zoo.reproduction import Measured, Trace

HALTS, KEPT = "slip is halted by more internal force", "the wrench on the object is preserved"
TENS = "some tens of milliseconds suffice"


class SlipAware(cp.ArmController):
    """A law of the package with the squeeze f_d (1 + slip / 4 mm)."""

    def __init__(self, law: Any) -> None:
        self.law = law

    def init(self, measurement: Any, reference: Any) -> Any:
        """Return the state of the law within."""
        return self.law.init(measurement, reference)

    def step(self, measurement: Any, reference: Any, state: Any) -> Any:
        """Return the command of the law within."""
        squeeze = reference.internal_wrench * (1.0 + (measurement.slip or 0.0) / 4e-3)
        return self.law.step(measurement, reference._replace(internal_wrench=squeeze), state)


def reproduce(cell: cp.Scenario, *, short: bool) -> tuple[list[Measured], list[Trace]]:
    """Push the crate down: the squeeze stays, follows the slip at once, or 40 ms late."""
    numbers, curves, seconds = [], [], 0.35 if short else 0.8
    for label in ("fixed squeeze", "at once") if short else ("fixed squeeze", "at once", "40 ms late"):
        delay = "40 ms" if "late" in label else 0
        pushed = cell.override(
            {"duration": seconds, "events.0.duration": seconds - 0.1, "sensors.slip.delay": delay}
        )
        laws = cp.laws.build_controller(pushed).controllers
        wrapped = {arm: law if "fixed" in label else SlipAware(law) for arm, law in laws.items()}
        run = cp.simulate(pushed, cp.laws.DecentralisedController(wrapped))
        time, slip, F = (run.data[name].values for name in ("time", "patch_slip", "interaction_wrench"))
        worst, dropped = 1e3 * slip.max(axis=1), run.metrics()["dropped_at_s"]
        curves.append(
            Trace(label, time, np.where(time < (dropped if dropped > 0 else np.inf), worst, np.nan))
        )
        if "fixed" in label:
            numbers.append(Measured(HALTS, "a fixed squeeze drops the crate at", dropped, "s", most=seconds))
            continue
        slides = worst[-1] - worst[np.searchsorted(time, seconds - 0.15)]
        claim = TENS if delay else HALTS
        rise = np.abs(F[:, 0, 0]).max() - np.abs(F[0, 0, 0])
        net = 100 * np.abs(F.sum(axis=1)[:, :2]).max() / rise
        numbers += [
            Measured(claim, f"{label}: slides in the last 0.15 s", slides, "mm", most=0.1),
            Measured(claim, f"{label}: slides in all, of 30 mm", worst[-1], "mm", most=30.0),
            Measured(KEPT, f"{label}: net push aside over the rise", net, "%", most=5.0),
        ]
    return numbers, curves
