"""Slip-aware squeeze: palms press harder as the crate slides, by a slip sensor that may be late."""

from typing import Any

import numpy as np

import coop_pin as cp
from coop_pin.zoo.reproduction import Measured, Trace

HALTS, KEPT = "slip is halted by more internal force", "the wrench on the object is preserved"
LATE = "a delay as theirs is borne"
BOTH = ("left", "right")
RUNS: dict[str, tuple[Any, tuple[str, ...]]] = {
    "fixed squeeze": (0, ()),
    "at once": (0, BOTH),
    "40 ms late": ("40 ms", BOTH),
    "130 ms late": ("130 ms", BOTH),
    "130 ms, one step": ("130 ms", BOTH),
    "left arm alone": (0, ("left",)),
}
"""Delay of the slip sensor, and arms whose squeeze follows the slip, of each run."""


class SlipAware(cp.ArmController):
    """A law of the package with the squeeze f_d (1 + slip / 4 mm), or 2 f_d beyond 0.1 mm."""

    def __init__(self, law: Any, once: bool) -> None:
        self.law, self.once = law, once

    def init(self, measurement: Any, reference: Any) -> Any:
        """Return the state of the law within."""
        return self.law.init(measurement, reference)

    def step(self, measurement: Any, reference: Any, state: Any) -> Any:
        """Return the command of the law within."""
        slip = measurement.slip or 0.0
        squeeze = reference.internal_wrench * (1.0 + (slip > 1e-4 if self.once else slip / 4e-3))
        return self.law.step(measurement, reference._replace(internal_wrench=squeeze), state)


def reproduce(cell: cp.Scenario, *, short: bool) -> tuple[list[Measured], list[Trace]]:
    """Push the crate down: the squeeze stays, or follows the slip, at once, late, by one step or one arm."""
    numbers, curves, seconds = [], [], 0.43 if short else 0.8
    for label, (delay, follow) in list(RUNS.items())[: 2 if short else None]:
        changes = {"duration": seconds, "events.0.duration": seconds - 0.1, "sensors.slip.delay": delay}
        laws = cp.laws.build_controller(pushed := cell.override(changes)).controllers
        once = "one step" in label
        wrapped = {arm: SlipAware(law, once) if arm in follow else law for arm, law in laws.items()}
        run = cp.simulate(pushed, cp.laws.DecentralisedController(wrapped))
        dropped = run.metrics()["dropped_at_s"]
        data = run.data.sel(time=slice(0.0, dropped if dropped > 0 else None))
        time, worst = data.time.values, 1e3 * data.patch_slip.values.max(axis=1)
        F, P = data.interaction_wrench.values, data.payload_position.values
        curves.append(Trace(label, time, worst))
        if not follow:
            numbers.append(Measured(HALTS, "a fixed squeeze drops the crate at", dropped, "s", most=seconds))
            continue
        slides = worst[-1] - worst[np.searchsorted(time, time[-1] - 0.15)]
        part = 100 * (np.abs(data.commanded_torque) / data.torque_limit).max().item()
        claim, most = (LATE, np.inf) if delay == "130 ms" else (HALTS, 0.1)
        if follow == BOTH:
            numbers += [
                Measured(claim, f"{label}: slides in its last 0.15 s", slides, "mm", most=most),
                Measured(claim, f"{label}: slides in all", worst[-1], "mm"),
                Measured(claim, f"{label}: most of a drive's limit", part, "%"),
            ]
        if claim == LATE:
            continue
        rise = np.abs(F[:, :, 0]).max() - np.abs(F[0, 0, 0])
        net = 100 * np.abs(F.sum(axis=1)[:, :2]).max() / rise
        aside = 1e3 * np.abs(P[:, :2] - P[0, :2]).max()
        limits = {"most": 5.0} if follow == BOTH else {"least": 5.0}
        numbers += [
            Measured(KEPT, f"{label}: net push aside over the rise", net, "%", **limits),
            Measured(KEPT, f"{label}: crate moved aside by", aside, "mm"),
        ]
    return numbers, curves
