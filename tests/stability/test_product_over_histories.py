"""P3: over all histories of a load, laws with memory keep no smaller product of sag and internal force.

F_h(t) is what a law applies to a constant error h; that load holds the payload there. Between 0 and the
first h at which abs(F_h) comes to D two views at most b apart have outputs that differ by D b / (h + b) at
least. The tests build that history for laws of very different kinds, run it on a mass that is not held by
anything else, and compare.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import pytest
from numpy.testing import assert_allclose

PERIOD, MASS, BIAS, LOAD = 0.0125, 67.0, 1e-3, 100.0
SHARES = np.array([0.4, 0.6])
TICKS = 1600
GRID = 801


class MemoryLaw(NamedTuple):
    """A law as a causal function of its view: output and next memory of (time, view, speed, memory)."""

    step: Callable[..., tuple[np.ndarray, np.ndarray]]
    memory: Callable[[int], np.ndarray]


def beyond(x, delta):
    return x - np.clip(x, -delta, delta)


def integral(rate, *, leak=0.0, spring=1600.0):
    """A spring and an integral with a rate and a leak."""

    def step(_, x, v, z):
        return spring * x + 800.0 * v + z, z + PERIOD * (rate(x) - leak * z)

    return MemoryLaw(step, np.zeros)


def record_and_hold():
    """A spring until 2 s; then the pose that it sees is its reference, with an integral."""

    def step(t, x, v, z):
        z = np.atleast_2d(z)
        home, wound = z[..., 0], z[..., 1]
        if t < 2.0:
            return 1600.0 * x + 800.0 * v, np.stack((x, 0.0 * x), -1)
        return 1600.0 * home + wound + 1600.0 * (x - home) + 800.0 * v, np.stack(
            (home, wound + PERIOD * 8000.0 * (x - home)), -1
        )

    return MemoryLaw(step, lambda n: np.zeros((n, 2)))


def network(seed, *, bias=0.0):
    """A random recurrent network beside a spring: tanh units, time-varying, odd only without the bias."""
    rng = np.random.default_rng(seed)
    n = 6
    W = rng.normal(size=(n, n))
    W *= rng.uniform(0.7, 1.02) / np.abs(np.linalg.eigvals(W)).max()
    u, out, spring = rng.normal(size=n) * 200.0, rng.normal(size=n) * 150.0, rng.uniform(2e3, 4e4)
    offset, turn = bias * rng.normal(size=n), rng.uniform(0.0, 2.0)

    def step(t, x, v, z):
        z = np.tanh(z @ W.T + (x + 0.0 * v)[..., None] * u + offset) - np.tanh(offset)
        return spring * x + 800.0 * v + (1.0 + 0.5 * np.sin(turn * t)) * (z @ out), z

    return MemoryLaw(step, lambda m: np.zeros((m, n)))


LAWS = {
    "spring": integral(lambda x: 0.0 * x, spring=2e4),
    "integral": integral(lambda x: 8000.0 * x),
    "leaky integral": integral(lambda x: 8000.0 * x, leak=0.5),
    "dead zone": integral(lambda x: 8000.0 * beyond(x, 1.2e-3)),
    "dead zone and leak": integral(lambda x: 8000.0 * beyond(x, 1.2e-3), leak=0.05),
    "sign of the error, layer": integral(lambda x: 40.0 * np.clip(x / 1e-4, -1.0, 1.0)),
    "cubic integral": integral(lambda x: 4e10 * x**3),
    "record and hold": record_and_hold(),
    **{f"network {seed}": network(seed) for seed in range(4)},
    **{f"network without symmetry {seed}": network(seed, bias=0.3) for seed in range(12, 15)},
}


def held(law, errors):
    """F_h(t) of errors h, shape (TICKS, n)."""
    z, rows = law.memory(len(errors)), []
    for k in range(TICKS):
        w, z = law.step(k * PERIOD, errors, 0.0 * errors, z)
        rows.append(w)
    return np.array(rows)


def first_reach(law, farthest):
    """First tick at which a held error needs a load of D, and the least such error of either sign."""
    errors = np.linspace(0.0, farthest, GRID)
    F = np.abs(held(law, errors))
    beyond_load = (F >= LOAD).any(axis=1)
    if not beyond_load.any():
        return None
    tick = int(np.argmax(beyond_load))
    return tick, float(errors[np.argmax(F[tick] >= LOAD)])


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize("name", LAWS)
def test_some_history_leaves_the_product_whatever_the_memory(name, side):
    law = LAWS[name]
    assert_allclose(held(law, np.zeros(1)), 0.0, atol=1e-12)  # at rest on the reference it does nothing
    farthest = 0.1
    tick, h = first_reach(law, side * farthest)
    n = int(np.ceil(abs(h) / BIAS))
    chain = np.linspace(0.0, h, n + 1)
    F = held(law, chain)[: tick + 1]
    step = int(np.argmax(np.abs(np.diff(F[-1]))))
    x, off = chain[step], chain[step + 1] - chain[step]
    load = F[:, step + 1] * SHARES[0] + F[:, step] * SHARES[1]
    tolerance = 1.0 + 10.0 * farthest / GRID / abs(h)
    assert np.abs(load).max() <= LOAD * tolerance
    assert abs(off) <= BIAS * (1.0 + 1e-12)
    # The history on a free mass that both arms push, the first with a view that is off.
    z, position, speed, force = law.memory(2), x, 0.0, np.nan
    for k in range(tick + 1):
        views = np.array([position + off, position])
        w, z = law.step(k * PERIOD, views, np.full(2, speed), z)
        force = SHARES.prod() * (w[0] - w[1])
        acceleration = (load[k] - SHARES @ w) / MASS
        position += PERIOD * speed + 0.5 * PERIOD**2 * acceleration
        speed += PERIOD * acceleration
    assert_allclose(position, x, atol=1e-9)
    assert abs(force) * (abs(h) + BIAS) >= SHARES.prod() * BIAS * LOAD / tolerance


def test_a_linear_law_needs_no_more():
    """c_1 c_2 b D / e for every history: no load enters the internal force of a linear law."""
    law = LAWS["leaky integral"]
    e = LOAD / (1600.0 + 8000.0 / 0.5)
    settled = held(law, np.array([BIAS]))[-1, 0]
    assert_allclose(settled * e, BIAS * LOAD, rtol=1e-3)
