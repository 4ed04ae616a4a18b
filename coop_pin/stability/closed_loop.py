"""Eigenvalues of the sampled closed loop, from tick to tick, and their root locus over a gain."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterable
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coop_pin.base.arrays import Array, as_number, as_positive, typed
from coop_pin.base.errors import ArgumentError, FieldError, OutOfRangeError
from coop_pin.description.scenario import Scenario
from coop_pin.description.sensors import Sensors
from coop_pin.simulation.build_controller import build_controller
from coop_pin.simulation.simulation import Simulation
from coop_pin.stability.modes import NEUTRAL, Mode
from coop_pin.stability.tick_map import MEMORY, TickMap

_ONE = 1e-5
"""Distance from 1 within which an eigenvalue is 1: errors of the differences are 1e-7."""
_GONE = 1e-6
"""``|z|`` below which a mode is gone after a tick."""


class ClosedLoop(NamedTuple):
    """Sampled closed loop, linear about a state: ``x[k + N] = A x[k]``.

    x holds the n motions that the closures leave, their speeds, the forces of the drives, and the memories of
    drives, servos, sensors, network, force path and law. Closure errors are not in it, and so no modes of
    Baumgarte's. What no tick changes (starting values that a law keeps) is left out and counted.

    Attributes:
        matrix: A, shape (x, x).
        modes: modes that move or change, the slowest or fastest growing first.
        structural: names of the modes with z = 1: what nothing controls, for example internal directions
            without anchor or leak, or spare joints without a spring.
        constants: number of memories that never change.
        ticks: N, the period of the slowest sensor or message.
        time: time of the state, s.
    """

    matrix: Array
    modes: tuple[Mode, ...]
    structural: tuple[str, ...]
    constants: int
    ticks: int
    time: float

    @property
    def z(self) -> NDArray[np.complex128]:
        """Eigenvalues of the modes, from tick to tick, shape (modes,)."""
        return np.array([mode.z for mode in self.modes])

    @property
    def radius(self) -> float:
        """Largest ``|z|`` besides the structural modes at 1."""
        return max((abs(mode.z) for mode in self.modes), default=0.0)

    @property
    def ok(self) -> bool:
        """Whether no mode grows."""
        return self.radius < 1.0 + NEUTRAL

    @property
    def slowest(self) -> Mode:
        """Mode of motion or internal wrenches that decays slowest, or grows."""
        return self._moving()[0]

    @property
    def least_damped(self) -> Mode:
        """Mode of motion or internal wrenches with the smallest damping ratio."""
        return min(self._moving(), key=lambda mode: mode.damping)

    def _moving(self) -> list[Mode]:
        return [mode for mode in self.modes if mode.name != MEMORY] or [*self.modes]

    def summary(self) -> str:
        """Return the slowest and the least damped mode as text, in one line."""
        slow, swinging = self.slowest, self.least_damped
        rate = f"decays with {slow.rate:.3g} /s" if self.ok else f"grows with {-slow.rate:.3g} /s"
        text = (
            f"closed loop: slowest mode {slow.name} {rate} (|z| = {abs(slow.z):.5f}); least damped"
            f" {swinging.name}, damping ratio {swinging.damping:.2f}"
        )
        counted = {name: self.structural.count(name) for name in self.structural}
        held = ", ".join(f"{count} {name}" for name, count in counted.items())
        return text + (f"; nothing controls {held} (z = 1)" if held else "")


@typed
def eigenvalues(scenario: Scenario, *, time: float = 0.0) -> ClosedLoop:
    """Return the sampled closed loop of a scenario at a state, and its modes, by central differences.

    With F the whole of N ticks of a run, as ``Simulation`` makes them, A = dF/dx at the state that the run,
    without its events and quantisation, has at a time, once every wrench sensor has given a sample. Where
    the run is at rest this is its linear model; while it moves it is that of the moment. No message is lost
    or rounded.

    At time 0 a payload with joints is held: the joint of a hanging link runs away from a motion that starts.

    ``sampled_motion`` is the motion's part of it alone, in closed form, without friction, force path and
    memories: much faster, for many poses and lags.

    Args:
        scenario: Scenario whose law is smooth near rest.
        time: Time of the state, s.

    Raises:
        ArgumentError: the law switches by sgn without a boundary layer, or a torque limit, rate limit or the
            edge of a layer is within 1e-5 of the state.
        OutOfRangeError: the time is negative or not finite.
        UnreachablePoseError: the start is out of an arm's reach.
        SingularJacobianError: an arm is singular.
        DivergedError: the run grows before that time.
    """
    _require_smooth(scenario)
    if not 0.0 <= as_number("time", time) < np.inf:
        raise OutOfRangeError("time", time, "at least 0 and finite")
    period = scenario.clock.period
    smooth, arms = _smooth(scenario), list(scenario.cell.arms)
    if time == 0.0 and scenario.cell.payload.links is not None:
        smooth = smooth.override({"motion": {"kind": "hold", "pose": scenario.start.model_dump()}})
    age = smooth.oldest_wrench
    cycles = [wrist.every for wrist in smooth.wrists]
    if (network := smooth.network) is not None:
        age += network.oldest_of(arms, smooth.clock)
        cycles += [smooth.clock.ticks_between(network.channel(edge).rate_hz) for edge in network.edges(arms)]
    N, before = int(np.lcm.reduce(cycles or [1])), int(np.ceil(time / period - NEUTRAL)) + age + 2
    smooth = smooth.replace(duration=(before + N + 1) * period)  # the whole run would take its memory
    simulation = Simulation(smooth, build_controller(smooth))
    for _ in range(before):
        simulation.tick()
    tick = TickMap(simulation, N)
    A, outputs, constants = tick.jacobian()
    z, vectors = np.linalg.eig(A)
    is_one = np.abs(z - 1.0) < _ONE
    # Memories that stay have errors of the differences in what nothing returns.
    of_ones = np.ix_(np.arange(len(A)) < tick.moving, is_one)
    vectors[of_ones] *= np.abs(vectors[of_ones]) > _ONE
    names = [
        tick.mode_name(vector, output)
        for vector, output in zip(vectors.T, (outputs @ vectors).T, strict=True)
    ]
    order = [k for k in np.argsort(-np.abs(z)) if abs(z[k]) > _GONE]
    modes = [Mode(complex(z[k] ** (1.0 / N)), names[k], period) for k in order if not is_one[k]]
    ones = [names[k] for k in order if is_one[k]]
    structural = tuple(sorted(name for name in ones if name != MEMORY))
    return ClosedLoop(A, tuple(modes), structural, constants + ones.count(MEMORY), N, before * period)


_COME_IN = 4.0
"""Time constants after which a squeeze that comes in is as good as wanted."""


def pressed_loop(scenario: Scenario) -> ClosedLoop:
    """Return the closed loop at the start, beside hinges once the squeeze is on where that tick is smooth.

    Arms see nothing of the turn of a hinge: what they press turns the payload away under enough of it.

    Args:
        scenario: Scenario, as of ``eigenvalues``, which tells what is raised.
    """
    rate = getattr(getattr(scenario.controller, "gains", None), "transient_rate", math.inf)
    if scenario.cell.jointed and scenario.cell.payload.links is None:
        with contextlib.suppress(ArgumentError):  # drives at their limits, which statics tell
            return eigenvalues(scenario, time=min(_COME_IN / rate, scenario.duration))
    return eigenvalues(scenario)


def _require_smooth(scenario: Scenario) -> None:
    """Raise ArgumentError if the law has no linear model near rest."""
    network = scenario.network
    if network is not None and any(
        network.channel(edge).jitter for edge in network.edges([*scenario.cell.arms])
    ):
        raise ArgumentError("messages that are late by chance have no map of a tick; state network.jitter 0")
    if scenario.controller.near_rest.integral == "sign":
        raise ArgumentError(
            "controller.switching is 'sign': sgn has no eigenvalues; state a boundary layer"
            " (switching.kind 'saturation' or 'tanh' with a width), or sign_gain 0"
        )


def _smooth(scenario: Scenario) -> Scenario:
    """Return a scenario without events, failures, quantisation, losses, dead zones and bounds of gains."""
    sound = {"missed_ticks": 0.0, "torque_lost_at": None, "commands_lost_at": None}

    def continuous(sensors: Sensors) -> Sensors:
        return sensors.replace(encoder=sensors.encoder.replace(resolution=0.0))

    return scenario.replace(
        events=(),
        beyond_bound=True,
        controller=scenario.controller.beyond_dead_zone,
        network=None if scenario.network is None else scenario.network.exact,
        sensors=continuous(scenario.sensors),
        arm_sensors={name: continuous(sensors) for name, sensors in scenario.arm_sensors.items()},
        actuators=scenario.actuators.replace(**sound),
        arm_actuators={name: drives.replace(**sound) for name, drives in scenario.arm_actuators.items()},
    )


_ACCURACY = 1e-4
"""Of a factor at which an eigenvalue crosses the unit circle."""


class RootLocus(NamedTuple):
    """Eigenvalues of the sampled closed loop over factors of a field.

    Attributes:
        field: dotted path of the field.
        value: the field in the scenario, shape () or that of a row of gains.
        factors: factors by which it is multiplied, rising, shape (n,).
        loops: closed loop at each of them.
        bounds: factors between them at which the loop becomes stable or unstable, rising.
    """

    field: str
    value: Array
    factors: Array
    loops: tuple[ClosedLoop, ...]
    bounds: tuple[float, ...]

    def summary(self) -> str:
        """Return the stable ranges as text, in one line."""
        ends = [*self.bounds]
        if self.loops[0].ok:
            ends.insert(0, float(self.factors[0]))
        if self.loops[-1].ok:
            ends.append(float(self.factors[-1]))
        ranges = [f"{low:.4g} to {high:.4g}" for low, high in zip(ends[::2], ends[1::2], strict=True)]
        stable = f"stable at {' and '.join(ranges)} times" if ranges else "unstable at all factors of"
        growing = dict.fromkeys(loop.slowest.name for loop in self.loops if not loop.ok)
        text = f"{self.field}: {stable} its value {np.array2string(self.value, separator=', ')}"
        return f"{text}; elsewhere {' and '.join([*growing][:2])} grows" if growing else text


@typed
def root_locus(scenario: Scenario, field: str, factors: Iterable[float], *, time: float = 0.0) -> RootLocus:
    """Return the eigenvalues of the sampled closed loop over factors of a gain, and where it is stable.

    Bounds are searched between factors of which one is stable, by Brent's method.

    Args:
        scenario: Scenario, as of ``eigenvalues``.
        field: Dotted path of a number or a row of numbers, for example "controller.gains.sliding_gain" or
            "actuators.lag".
        factors: Factors of its value, positive.
        time: Time of the state, s.

    Raises:
        FieldError: the field is no number or row of numbers other than 0, or does not allow a value.
        ArgumentError: there are no factors; or as ``eigenvalues``.
        CoopPinError: as ``eigenvalues``.
    """
    ordered = np.unique([as_positive("factors", factor) for factor in factors])
    if not ordered.size:
        raise ArgumentError("factors is empty; give at least one")
    value, free = _value(scenario, field), scenario.replace(beyond_bound=True)

    def loop(factor: float) -> ClosedLoop:
        return eigenvalues(free.override({field: (factor * value).tolist()}), time=time)

    from scipy.optimize import brentq  # slow to load

    loops = {factor: loop(factor) for factor in ordered.tolist()}

    def growth(factor: float) -> float:
        return (loops.get(factor) or loop(factor)).radius - 1.0 - NEUTRAL

    bounds = tuple(
        float(brentq(growth, low, high, xtol=_ACCURACY * low))
        for low, high in pairwise(loops)
        if loops[low].ok != loops[high].ok
    )
    return RootLocus(field, value, ordered, tuple(loops.values()), bounds)


def _value(scenario: Scenario, field: str) -> Array:
    """Return the number or numbers of a field."""
    node: Any = scenario.model_dump()
    for key in field.split("."):
        node = node.get(key) if isinstance(node, dict) else None
    try:
        value = np.array(node, dtype=np.float64)
    except (TypeError, ValueError):
        value = np.array(np.nan)
    if not np.isfinite(value).all() or not value.any() or value.ndim > 1:
        raise FieldError(
            f"is {node!r}; a root locus needs a number or a row of numbers other than 0 to multiply", field
        )
    return value
