"""Symmetric formulation: rates of the absolute and the relative error, and the force of a bias."""

from pathlib import Path
from typing import Any

import numpy as np

import coop_pin as cp
from coop_pin.base.arrays import Array
from coop_pin.zoo.reproduction import Measured, Trace

SPACE = cp.Scenario.load(Path(__file__).with_name("space.toml"))
APART = "absolute and relative errors converge apart"
BIASED = "a bias goes into the relative error"
GAMMA, LAMBDA, STEP = 2.0, 0.5 * 12.24 / 1.02, 0.02
"""gamma and lambda = c K / L of the robots on wheels, 1/s; time between the samples of a fit, s."""
HELD = {"planar": "adept-anchored", "spatial": "two-pandas-box"}


def designed(rate: float) -> float:
    """Return the slower rate of e'' + lambda e' + lambda gamma e = 0, 1/s."""
    return float(np.roots([1.0, -rate, rate * GAMMA]).real.min())


def pushed(cell: cp.Scenario, rho: float, axis: int, since: float) -> list[tuple[str, Array, Array, float]]:
    """Return label, times, error, m, and the slower rate of the second-order recursion nearest to it, 1/s."""
    data, errors = cp.run(cell.override({"controller.relative_gain": rho}), warn=False).data, []
    tips = data.tip_position.values[..., axis]
    time, (left, right) = data.time.values, (tips - tips[0]).T
    for label, e in (("absolute", (left + right) / 2), ("relative", right - left)):
        x = e[time > since][:: round(STEP / cell.clock.period)]
        (a, b), *_ = np.linalg.lstsq(np.stack([x[1:-1], x[:-2]], axis=1), x[2:], rcond=None)
        errors.append((label, time, e, -np.log(np.abs(np.roots([1.0, -a, -b])).max()) / STEP))
    return errors


def biased(name: str, rho: float | None) -> tuple[float, float]:
    """Return the force of 1 mm of bias at rest, N, and c K gamma b; without rho by the anchored law."""
    base = cp.Scenario.load(name)
    hold = {"kind": "hold", "pose": base.start.model_dump()}
    changes: dict[str, Any] = {"motion": hold, "duration": 3.0, "events": [], "clock.steps_per_tick": 1}
    changes["cell.arms.left.calibration_error.tip.xyz"] = [1e-3, 0.0, 0.0]
    gains = base.controller.gains
    if rho is not None:
        pd = gains.replace(sign_gain=0.0, leak=0.0, anchor_gain=0.0).model_dump()
        changes["controller"] = {"kind": "symmetric", "relative_gain": rho, "gains": pd}
    data = cp.run(base.override(changes), warn=False).data
    off = np.nan_to_num((data.internal_wrench - data.desired_internal_wrench).values[-1, 0, :3])
    return float(np.linalg.norm(off)), 0.5 * gains.sliding_gain[0] * gains.pose_gain * 0.5e-3


def reproduce(cell: cp.Scenario, *, short: bool) -> tuple[list[Measured], list[Trace]]:
    """Push one of two robots at different things with three relative gains; hold one thing with a bias."""
    numbers, curves = [], []
    for rho in (0.25,) if short else (0.25, 1.0, 4.0):
        for label, time, error, rate in pushed(cell, rho, 0, 0.1):
            ratio = rate / designed(LAMBDA * (rho if label == "relative" else 1.0))
            numbers.append(Measured(APART, f"rho {rho:g}: {label} rate over designed", ratio, "", 0.95, 1.05))
            if label == "relative" or rho == 1.0:
                curves.append(Trace(f"{label}, rho {rho:g}", time, 1e3 * error))
    for rho in () if short else (0.25, 1.0):
        for label, *_, rate in pushed(SPACE, rho, 1, 1.0):
            ratio = rate / SPACE.controller.gains.pose_gain
            limits = () if label == "absolute" and rho < 1.0 else (0.95, 1.05)
            numbers.append(Measured(APART, f"space, rho {rho:g}: {label} over gamma", ratio, "", *limits))
    for label, name in list(HELD.items())[: 1 if short else 2]:
        anchored, (whole, form), (tenth, _) = biased(name, None)[0], biased(name, 1.0), biased(name, 0.1)
        numbers += [
            Measured(BIASED, f"{label}, rho 1: force of 1 mm", whole, "N"),
            Measured(BIASED, f"{label}, rho 1: over c K gamma b", whole / form, "", 0.95, 1.05),
            Measured(BIASED, f"{label}, rho 0.1: over that of 1", tenth / whole, "", 0.095, 0.105),
            Measured(BIASED, f"{label}: force by the anchored law", anchored, "N"),
        ]
    return numbers, curves
