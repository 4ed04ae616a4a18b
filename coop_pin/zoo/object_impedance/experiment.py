"""Object impedance: a step of force moves the held box as the stated mass, damper and spring."""

from typing import Any

import numpy as np

import coop_pin as cp
from coop_pin.base.arrays import Array
from coop_pin.zoo.reproduction import Measured, Trace

M, D, K, F, PUSH = 20.0, 200.0, 2000.0, 20.0, 0.5
WRONG: dict[str, dict[str, Any]] = {
    "masses told 1.5 times": {"controller.model.mass": 1.5},
    "unknown friction of 1 N m": {
        "controller.model.friction": 0.0,
        **{f"cell.arms.{arm}.friction": {"coulomb": 1.0, "viscous": 0.5} for arm in ("left", "right")},
    },
    "wrist noise of 0.5 N": {"sensors.wrist.noise": {"force": 0.5, "moment": 0.02}},
}
RESPONSE = "the object moves as the stated mass, damper and spring"
KEPT = "the internal force is kept meanwhile"
SURVIVED = "errors of the model are survived"


def closed_form(time: Array) -> Array:
    """Return the displacement of M x'' + D x' + K x = F from rest, m, over the time after the push, s."""
    decay, rate = D / (2 * M), np.sqrt(K / M - (D / (2 * M)) ** 2)
    s = np.maximum(time, 0.0)
    return F / K * (1 - np.exp(-decay * s) * (np.cos(rate * s) + decay / rate * np.sin(rate * s)))


def reproduce(cell: cp.Scenario, *, short: bool) -> tuple[list[Measured], list[Trace]]:
    """Push the box, with an exact model and with wrong ones."""
    numbers, curves = [], []
    for label, changes in {"exact model": {}, **({} if short else WRONG)}.items():
        duration = {"duration": 1.3, "events.0.duration": 0.8} if short else {}
        data = cp.run(cell, duration | changes, warn=False).data
        time = data.time.values - PUSH
        x = data.payload_position.values[:, 0] - data.payload_position.values[0, 0]
        off = 100 * np.abs(x - closed_form(time)).max() / (F / K)
        claim, most = (SURVIVED, np.inf) if label in WRONG else (RESPONSE, 5.0)
        numbers.append(Measured(claim, f"off the form, {label}", off, "%", most=most))
        if label == "exact model":
            force = np.abs(data.internal_axial_error.values).max()
            numbers.append(Measured(KEPT, "squeeze of 10 N off by at most", force, "N", most=1.0))
            curves = [Trace("closed form", time, 1e3 * closed_form(time), dashed=True)]
        curves.append(Trace(label, time, 1e3 * x))
    return numbers, curves
