# ruff: noqa: ARG001, ARG005, NPY002
"""Users' controllers that a batch could compute otherwise than a single run in silence: a class for each.

A spring and damper, and in ``changed`` what an adversary, or a user in good faith, does with its torque.
"""

import collections
import contextvars
import functools
import inspect
import itertools
import os
import random
import sys
import tempfile
import threading
import time
import types
from pathlib import Path

import numpy as np

import coop_pin as cp

ADVERSARIES = {}
"""Classes by name, in the order below."""


class Spring(cp.ArmController):
    """The honest law; ``gain`` differs between the runs of a batch."""

    def __init_subclass__(cls):
        ADVERSARIES[cls.__name__] = cls

    def __init__(self, scenario, arm, gain=0.5):
        self.rows, self.gain = scenario.cell.task_rows, gain

    def init(self, measurement, reference):
        return None

    def step(self, measurement, reference, state):
        error = self.rows.pose_error(measurement.payload_pose, reference.pose)
        pull = -measurement.payload_jacobian.T @ ((200.0 + 100.0 * self.gain) * error)
        return cp.ArmCommand(self.changed(measurement, pull - 20.0 * measurement.v), state)

    def changed(self, m, u):
        return u

    def rare(self):
        """1 in the run whose gain is UNCHECKED, 0 in all others."""
        return np.where(np.abs(self.gain - UNCHECKED) < 1e-6, 1.0, 0.0)


UNCHECKED = 0.9
"""Gain of the run that is not repeated singly."""
LATE = 30
"""Number of steps after which a counter acts; fewer are tried before a batch."""
counter = {"module": 0, "list": [0], "holder": types.SimpleNamespace(n=0)}
steps = 0


# ---------------------------------------------------------------- counters


class CountInObject(Spring):
    n = 0

    def changed(self, m, u):
        self.n += 1
        return 1.5 * u if self.n > LATE else u


class CountInList(Spring):
    def __init__(self, *args, **options):
        super().__init__(*args, **options)
        self.seen = [0.0]

    def changed(self, m, u):
        self.seen[0] += 1.0
        return 1.5 * u if self.seen[0] > LATE else u


class CountInArray(Spring):
    def __init__(self, *args, **options):
        super().__init__(*args, **options)
        self.seen = np.zeros(3)

    def changed(self, m, u):
        self.seen[1] += 1.0
        return 1.5 * u if self.seen[1] > LATE else u


class CountInClass(Spring):
    n = 0

    def changed(self, m, u):
        type(self).n += 1
        return 1.5 * u if self.n > 2 * LATE else u


class CountInModule(Spring):
    def changed(self, m, u):
        global steps
        steps += 1
        return 1.5 * u if steps > 2 * LATE else u


class CountInDictionary(Spring):
    def changed(self, m, u):
        counter["module"] += 1
        return 1.5 * u if counter["module"] > 2 * LATE else u


class CountInNamespace(Spring):
    def changed(self, m, u):
        counter["holder"].n += 1
        return 1.5 * u if counter["holder"].n > 2 * LATE else u


class CountByGlobals(Spring):
    def changed(self, m, u):
        globals()["hidden"] = globals().get("hidden", 0) + 1
        return 1.5 * u if globals()["hidden"] > 2 * LATE else u


class CountInDefault(Spring):
    def changed(self, m, u, seen=[0]):  # noqa: B006
        seen[0] += 1
        return 1.5 * u if seen[0] > 2 * LATE else u


def counted():
    n = 0

    def count():
        nonlocal n
        n += 1
        return n

    return count


class CountInClosure(Spring):
    count = staticmethod(counted())

    def changed(self, m, u):
        return 1.5 * u if self.count() > 2 * LATE else u


class CountInFunction(Spring):
    def changed(self, m, u):
        counted.calls = getattr(counted, "calls", 0) + 1
        return 1.5 * u if counted.calls > 2 * LATE else u


numbers = itertools.count()


class CountInIterator(Spring):
    def changed(self, m, u):
        return 1.5 * u if next(numbers) > 2 * LATE else u


class CountInAnotherModule(Spring):
    def changed(self, m, u):
        sys.adversary = getattr(sys, "adversary", 0) + 1
        return 1.5 * u if sys.adversary > 2 * LATE else u


class CountInEnvironment(Spring):
    def changed(self, m, u):
        os.environ["ADVERSARY"] = str(int(os.environ.get("ADVERSARY", "0")) + 1)
        return 1.5 * u if int(os.environ["ADVERSARY"]) > 2 * LATE else u


class CountInFile(Spring):
    path = Path(tempfile.gettempdir()) / f"adversary-{os.getpid()}"

    def changed(self, m, u):
        with self.path.open("a") as file:
            file.write("x")
        return 1.5 * u if self.path.stat().st_size > 2 * LATE else u


local = threading.local()


class CountInThread(Spring):
    def changed(self, m, u):
        local.n = getattr(local, "n", 0) + 1
        return 1.5 * u if local.n > 2 * LATE else u


class CountInCache(Spring):
    @functools.cache  # noqa: B019
    def first(self, n):
        return time.perf_counter_ns()

    def changed(self, m, u):
        self.first(self.first.cache_info().currsize)
        return 1.5 * u if self.first.cache_info().currsize > 2 * LATE else u


class Slots:
    __slots__ = ("n",)

    def __init__(self):
        self.n = 0

    def __eq__(self, other):  # as loose as can be
        return True

    __hash__ = None


class CountInSlots(Spring):
    def __init__(self, *args, **options):
        super().__init__(*args, **options)
        self.slots = Slots()

    def changed(self, m, u):
        self.slots.n += 1
        return 1.5 * u if self.slots.n > LATE else u


class CountInClassSlots(Spring):
    slots = Slots()

    def changed(self, m, u):
        self.slots.n += 1
        return 1.5 * u if self.slots.n > 2 * LATE else u


class CountFromInit(Spring):
    """Its counter begins in init."""

    def init(self, measurement, reference):
        self.memory = {"n": 0}

    def changed(self, m, u):
        self.memory["n"] += 1
        return 1.5 * u if self.memory["n"] > LATE else u


class TinyHidden(Spring):
    """Far below the tolerance of the ticks that are tried; doubles at each step."""

    def __init__(self, *args, **options):
        super().__init__(*args, **options)
        self.grown = counted()

    def changed(self, m, u):
        return u * (1.0 + 1e-15 * 2.0 ** min(self.grown(), 50))


class SlowGrow(Spring):
    grown = staticmethod(counted())

    def changed(self, m, u):
        return u * (1.0 + 1e-14 * 1.5 ** min(self.grown(), 80))


class CountInBytes(Spring):
    seen = bytearray(1)

    def changed(self, m, u):
        self.seen[0] += 1
        return 1.5 * u if self.seen[0] > 2 * LATE else u


held = collections.deque([0])


class CountInDeque(Spring):
    def changed(self, m, u):
        held[0] += 1
        return 1.5 * u if held[0] > 2 * LATE else u


context = contextvars.ContextVar("context", default=0)


class CountInContext(Spring):
    def changed(self, m, u):
        context.set(context.get() + 1)
        return 1.5 * u if context.get() > 2 * LATE else u


class Meta(type(Spring)):
    n = 0


class CountInMetaclass(Spring, metaclass=Meta):
    def changed(self, m, u):
        Meta.n += 1
        return 1.5 * u if Meta.n > 2 * LATE else u


# ---------------------------------------------------------------- states


class SmallCounter(Spring):
    """Its count is -128 after 127."""

    def init(self, measurement, reference):
        return np.int8(100)

    def step(self, measurement, reference, state):
        torque, after = super().step(measurement, reference, None).torque, state + np.int8(1)
        return cp.ArmCommand(np.where(after > 0, torque, 0.9 * torque), after)


class WholeNumbers(Spring):
    """An array of whole numbers cuts what is written into it."""

    def init(self, measurement, reference):
        return np.zeros(2, dtype=int)

    def step(self, measurement, reference, state):
        state = state.copy()
        state[0] = np.where(measurement.time > 0.3, 0.7, 0.0)
        return cp.ArmCommand(super().step(measurement, reference, None).torque * (1.0 + state[0]), state)


class LeftToRight(Spring):
    """An arm tells the next one its position."""

    told = bytearray(8)

    def changed(self, m, u):
        before = np.frombuffer(self.told)[0]
        self.told[:] = np.float64(m.time if isinstance(m.time, float) else 0.0).tobytes()
        return u * (1.0 + before)


# ---------------------------------------------------------------- what a run leaves to the next


GAIN = 0.0


class GainInModule(Spring):
    """The last one made wins for all runs of a batch."""

    def __init__(self, scenario, arm, gain=0.5):
        global GAIN
        super().__init__(scenario, arm)
        GAIN = gain

    def changed(self, m, u):
        return u * (1.0 + GAIN)


class GainInClass(Spring):
    extra = 0.0

    def __init__(self, scenario, arm, gain=0.5):
        super().__init__(scenario, arm)
        type(self).extra = gain

    def changed(self, m, u):
        return u * (1.0 + self.extra)


class GainInEnvironment(Spring):
    def __init__(self, scenario, arm, gain=0.5):
        super().__init__(scenario, arm)
        os.environ["ADVERSARY_GAIN"] = str(gain)

    def changed(self, m, u):
        return u * (1.0 + float(os.environ["ADVERSARY_GAIN"]))


# ---------------------------------------------------------------- chance and the world outside


class GlobalChance(Spring):
    def changed(self, m, u):
        return u * 1.5 if np.random.random() < 0.05 else u


class StandardChance(Spring):
    def changed(self, m, u):
        return u * (1.0 + 0.1 * (random.random() < 0.05))


class OwnChance(Spring):
    def __init__(self, *args, **options):
        super().__init__(*args, **options)
        self.generator = np.random.default_rng(1)

    def changed(self, m, u):
        return u * self.generator.normal()


class WallClock(Spring):
    def changed(self, m, u):
        return u * (1.0 + 1e-3 * (time.perf_counter() % 1.0))


class Caller(Spring):
    def changed(self, m, u):
        return 1.5 * u if any(frame.filename.endswith("tick.py") for frame in inspect.stack()) else u


# ---------------------------------------------------------------- NaN, inf and errors


class NanIsNotLess(Spring):
    def changed(self, m, u):
        return np.where(np.sqrt(0.2 - m.time) >= 0.0, u, 0.5 * u)


class NanIsNotEqual(Spring):
    def changed(self, m, u):
        x = np.sqrt(0.2 - m.q * 0.0 - m.time)
        return np.where(x == x, u, 0.5 * u)


class NanDiffers(Spring):
    def changed(self, m, u):
        x = np.sqrt(0.2 - m.q * 0.0 - m.time)
        return np.where(x != x, 0.5 * u, u)


class NanInMinimum(Spring):
    def changed(self, m, u):
        return u * np.minimum(1.0, np.sqrt(0.2 - m.time) + 1.0)


class NanInMaximum(Spring):
    def changed(self, m, u):
        return u * np.maximum(np.sqrt(0.2 - m.time) - 9.0, 1.0)


class NanInClip(Spring):
    def changed(self, m, u):
        return u * np.clip(np.sqrt(0.2 - m.time) + 2.0, 0.5, 1.0)


class NanInSign(Spring):
    def changed(self, m, u):
        return u + np.sign(np.sqrt(0.2 - m.time))


class NanInAngle(Spring):
    def changed(self, m, u):
        return u + np.arctan2(1.0, np.sqrt(0.2 - m.time))


class ZeroTimesInf(Spring):
    def changed(self, m, u):
        return u + 0.0 * (m.q / np.where(m.time > 0.2, 0.0, 1.0))


class ZeroTimesNan(Spring):
    def changed(self, m, u):
        return u + 0.0 * np.sqrt(0.2 - m.time)


class InfLessInf(Spring):
    def changed(self, m, u):
        x = m.q / np.where(m.time > 0.2, 0.0, 1.0)
        return u + (x - x)


class DivisionByZero(Spring):
    def changed(self, m, u):
        return u + 0.0 / (m.time - 0.25)


class DivisionWithinMinimum(Spring):
    def changed(self, m, u):
        return u + np.minimum(1.0 / abs(m.time - 0.25), 3.0)


class Overflow(Spring):
    def changed(self, m, u):
        return u + 1e-300 * np.exp(4000.0 * m.time) * np.exp(-4000.0 * m.time)


class Underflow(Spring):
    def changed(self, m, u):
        return np.where(np.exp(-4000.0 * m.time) > 0.0, u, 0.5 * u)


class LogOfZero(Spring):
    def changed(self, m, u):
        return np.where(np.log(np.maximum(0.2 - m.time, 0.0)) < -9.0, 0.5 * u, u)


class HugeSine(Spring):
    def changed(self, m, u):
        return u + np.sin(1e12 * m.q)


# ---------------------------------------------------------------- numbers of the run that is not checked


class RareExponential(Spring):
    def changed(self, m, u):
        return u * np.minimum(np.exp(-705.0 * self.rare()) * np.exp(705.0 * self.rare()), 1.1)


class RareLargeExponential(Spring):
    def changed(self, m, u):
        return u * np.minimum(1.0 + 1e-309 * np.exp(709.5 * self.rare()), 1.5)


class RareExponentialLessOne(Spring):
    def changed(self, m, u):
        return np.where(np.expm1(710.0 * self.rare()) >= 0.0, u, 0.5 * u)


class RareSine(Spring):
    def changed(self, m, u):
        return u + np.sin(1e12 * self.rare() * m.q)


class RareLogarithm(Spring):
    def changed(self, m, u):
        return u + np.log(np.where(self.rare() > 0.5, 1e-315, 1.0))


class RareRounding(Spring):
    def changed(self, m, u):
        x = (2.0**52 + 1.0) * self.rare()
        return u * (1.0 + np.rint(x) - x)


class RareTanh(Spring):
    def changed(self, m, u):
        return u * (1.0 + 1e20 * np.tanh(1e-20 * self.rare()))


class RareAngle(Spring):
    def changed(self, m, u):
        return u + self.rare() * np.arctan2(-0.0 * self.rare(), -1.0)


class RareChoice(Spring):
    """A choice by a number that is 0 or 1 in the other runs."""

    def changed(self, m, u):
        return u * np.where(1.0 + self.rare(), 1.0, 0.0)


class RareDivision(Spring):
    def changed(self, m, u):
        x = np.where(self.rare() > 0.5, 3e-310, 0.0)
        return u * (1.0 + self.rare() * np.minimum(x / 2.0**-1030, 0.1))


class RareInverse(Spring):
    def changed(self, m, u):
        last = 1.0 - (1.0 - 1e-13) * self.rare()
        first = np.stack([1.0 + 0.1 * m.q[0], 1.0 + 0.1 * m.q[0]])
        inverse = np.linalg.inv(np.stack([first, np.stack([1.0 + 0.0 * m.q[0], 1.0 + last])]))
        return u + 0.01 * inverse[0, 0] * last


class RareSingularity(Spring):
    def changed(self, m, u):
        rows = [np.stack([1.0 + 0.0 * m.q[0], 1.0]), np.stack([1.0, 2.0 - self.rare()])]
        return u + np.where(np.linalg.inv(np.stack(rows))[0, 0] > 5.0, 0.1, 0.0)


class RareError(Spring):
    """It asks numpy to raise."""

    def changed(self, m, u):
        with np.errstate(divide="raise"):
            return u + np.minimum(1.0 / (1.0 - self.rare() + 0.0 * m.q), 1.0)


# ---------------------------------------------------------------- refusals that are caught, and types


class CaughtBranch(Spring):
    def changed(self, m, u):
        try:
            late = bool(m.time > 0.2)
        except Exception:
            late = False
        return 0.5 * u if late else u


class CaughtFloat(Spring):
    def changed(self, m, u):
        try:
            return u * (1.5 if float(m.time) > 0.2 else 1.0)
        except Exception:
            return u


class CaughtFunction(Spring):
    def changed(self, m, u):
        try:
            return u * np.cbrt(1.0 + m.time)
        except Exception:
            return u


class CaughtArgument(Spring):
    def changed(self, m, u):
        try:
            return u * (1.0 + np.round(m.time, 1))
        except Exception:
            return u


class CaughtRounding(Spring):
    def changed(self, m, u):
        try:
            return u * (1.0 + round(m.time))
        except Exception:
            return u


class CaughtAttribute(Spring):
    def changed(self, m, u):
        return u if not hasattr(m.time, "is_integer") else u * (1.0 + 0.1 * (m.time > 0.2))


class NameOfType(Spring):
    def changed(self, m, u):
        return 0.5 * u if type(m.time).__name__ == "float" and m.time > 0.2 else u


class IsFloat(Spring):
    def changed(self, m, u):
        return 0.5 * u if isinstance(m.time, float) and m.time > 0.2 else u


class KindOfArray(Spring):
    def changed(self, m, u):
        return 0.5 * u if m.q.dtype == float and m.time > 0.2 else u


class WrittenNumber(Spring):
    def changed(self, m, u):
        return 0.5 * u if str(m.time).startswith("0.3") else u


class InASet(Spring):
    def changed(self, m, u):
        return 0.5 * u if m.time in {0.25, 0.3} else u


# ---------------------------------------------------------------- truth values


class SumOfArrays(Spring):
    def changed(self, m, u):
        return u * (1.0 + ((m.q > 0.1) + (m.q > 0.0)))


class SumOfTruths(Spring):
    def changed(self, m, u):
        return u * (1.0 + 0.1 * ((m.q[0] > -9.0) + (m.q[1] > -9.0)))


class SumOfPythons(Spring):
    def changed(self, m, u):
        return u * (1.0 + 0.1 * ((m.time > 0.1) + (m.time > 0.2)))


class OppositeOfPythons(Spring):
    def changed(self, m, u):
        return u * (1.0 + 0.1 * ~(m.time > 0.2))


class Count(Spring):
    def changed(self, m, u):
        return u * (1.0 + 0.1 * np.sum(m.q > -9.0))


class SumOfSaturated(Spring):
    def changed(self, m, u):
        return u + 1e3 * (m.saturated + m.saturated) + 1e3 * (m.time > 0.1)


class TruthInState(Spring):
    def init(self, measurement, reference):
        return measurement.q > 9.0

    def step(self, measurement, reference, state):
        command = super().step(measurement, reference, state)
        late = measurement.q > -9.0
        return cp.ArmCommand(command.torque * (1.0 + 0.1 * (state + late)), late)


class MinusTruth(Spring):
    def changed(self, m, u):
        return u * (1.0 + 0.1 * np.where(m.time > 0.2, True, False))


# ---------------------------------------------------------------- random laws


def by_attribute(law):
    law.calls = getattr(law, "calls", 0) + 1
    return law.calls


def by_class(law):
    RandomLaw.in_class += 1
    return RandomLaw.in_class


def by_module(law):
    counter["module"] += 1
    return counter["module"]


def by_another_module(law):
    sys.adversary = getattr(sys, "adversary", 0) + 1
    return sys.adversary


def by_environment(law):
    os.environ["ADVERSARY"] = str(int(os.environ.get("ADVERSARY", "0")) + 1)
    return int(os.environ["ADVERSARY"])


def by_closure(law):
    return CountInClosure.count()


def by_thread(law):
    local.n = getattr(local, "n", 0) + 1
    return local.n


def by_chance(law):
    return int(1000 * np.random.random())


PLACES = [
    *(by_attribute, by_class, by_module, by_another_module, by_environment),
    by_closure,
    by_thread,
    by_chance,
]
WHEN = [
    lambda n, limit: n > limit,
    lambda n, limit: n % limit == limit - 1,
    lambda n, limit: 2.0 ** min(n - 3 * limit, 0),
    lambda n, limit: min(1e-13 * 1.4**n, 1.0),
]
"""Functions of a count and a limit: how much of the change acts."""
HONEST = [
    lambda m, u: u,
    lambda m, u: np.clip(u, -20.0, 20.0),
    lambda m, u: np.where(m.time > 0.2, u, 0.8 * u),
    lambda m, u: u - 2.0 * np.tanh(m.v),
    lambda m, u: u * (1.0 - 0.1 * np.exp(-m.time)),
    lambda m, u: u + 0.1 * np.sin(3.0 * m.q),
    lambda m, u: np.where((m.v > 0.0) & (m.q > 0.1), u, 1.1 * u),
    lambda m, u: u - np.sign(m.v) * (np.abs(m.v) > 0.1) * ~m.saturated,
]


class RandomLaw(Spring):
    """Honest terms and, mostly, a count at a random place that acts at a random time and size."""

    in_class = 0

    def __init__(self, scenario, arm, gain=0.5, seed=0):
        super().__init__(scenario, arm, gain)
        self.seed = str(seed)

    def changed(self, m, u):
        chance = random.Random(self.seed)
        for honest in chance.sample(HONEST, 2):
            u = honest(m, u)
        place, when, limit = chance.choice(PLACES), chance.choice(WHEN), chance.randint(2, 100)
        size = 10.0 ** chance.uniform(-6.0, 0.0)
        return u if chance.random() < 0.1 else u * (1.0 + size * when(place(self), limit))


del ADVERSARIES["RandomLaw"]


def reset() -> None:
    """Forget what the classes have counted."""
    global steps, numbers
    steps, numbers = 0, itertools.count()
    counter.update(module=0, list=[0], holder=types.SimpleNamespace(n=0))
    RandomLaw.in_class, CountInClass.n, CountInClassSlots.slots.n, local.n, sys.adversary, counted.calls = (
        0,
        0,
        0,
        0,
        0,
        0,
    )
    CountInDefault.changed.__defaults__[0][0] = 0
    CountInClosure.count, SlowGrow.grown = staticmethod(counted()), staticmethod(counted())
    globals().pop("hidden", None)
    CountInBytes.seen[0] = held[0] = Meta.n = 0
    LeftToRight.told[:] = bytes(8)
    context.set(0)
    os.environ.pop("ADVERSARY", None)
    CountInFile.path.unlink(missing_ok=True)
    CountInCache.first.cache_clear()
