"""Users' laws that keep something besides the state of init and step: a class for each kind of memory."""

import functools
import itertools
import os
import random
import time

import numpy as np

import coop_pin as cp

COUNT = {"n": 0}
numbers = itertools.count()
buffer = bytearray(2)


class Clean(cp.ArmController):
    """A damper, whose ``more`` adds what a class remembers, N m."""

    def __init__(self, scenario, arm, ki=0.0):
        self.rows, self.ki = scenario.cell.task_rows, ki
        self.begin()

    def begin(self):
        """Make what is remembered."""

    def init(self, measurement, reference):
        return np.zeros(len(measurement.q))

    def step(self, measurement, reference, state):
        return cp.ArmCommand(-20.0 * measurement.v + self.more(measurement.q), state)

    def more(self, q):
        return 0.0


class BoundedPush(Clean):
    def step(self, measurement, reference, state):
        error = np.tanh(self.rows.pose_error(measurement.payload_pose, reference.pose))
        turned = np.tanh(self.rows.turn(measurement.payload_pose, reference.internal_wrench))
        return cp.ArmCommand(-measurement.payload_jacobian.T @ (error + turned) - 2.0 * measurement.v, state)


class Counter(Clean):
    def begin(self):
        self.n = 0

    def more(self, q):
        self.n += 1
        return 0.01 * self.n


class Integral(Clean):
    def begin(self):
        self.integral = np.float64(0.0)

    def more(self, q):
        self.integral = self.integral + 0.01 * self.ki * q[0]
        return self.integral


class InPlaceArray(Clean):
    def begin(self):
        self.sums = np.zeros(9)

    def more(self, q):
        self.sums[: len(q)] += 0.01 * q
        return self.sums[: len(q)]


class History(Clean):
    def begin(self):
        self.past = [0.0]

    def more(self, q):
        self.past.append(q.copy())
        return 0.01 * sum(self.past)


class InState(Clean):
    def step(self, measurement, reference, state):
        state += 0.01 * measurement.q
        return cp.ArmCommand(state - 20.0 * measurement.v, state)


class Later(Clean):
    def more(self, q):
        self.last = 0.01 + getattr(self, "last", 0.0)
        return self.last


class Drawn(Clean):
    def begin(self):
        self.generator = np.random.default_rng(3)

    def more(self, q):
        return 0.1 * self.generator.normal(size=len(q))


class Iterated(Clean):
    def begin(self):
        self.steps = (0.001 * n for n in itertools.count())

    def more(self, q):
        return next(self.steps)


class ClassList(Clean):
    past: list[float] = []  # noqa: RUF012

    def more(self, q):
        self.past.append(0.0)
        return 0.01 * len(self.past)


class InModule(Clean):
    def more(self, q):
        COUNT["n"] += 1
        return 0.01 * COUNT["n"]


class NumpyRandom(Clean):
    def more(self, q):
        return 0.1 * np.random.normal(size=len(q))  # noqa: NPY002


class PlainRandom(Clean):
    def more(self, q):
        return 0.1 * random.random()


class Counted(Clean):
    def more(self, q):
        return 0.01 * (next(numbers) > 500)


class InBytes(Clean):
    def more(self, q):
        buffer[0] = min(buffer[0] + 1, 255)
        return 0.01 * (buffer[0] > 250)


class InFile(Clean):
    def more(self, q):
        with open(os.devnull, "w") as file:  # noqa: PTH123
            return 0.0 * file.write("x")


class InEnvironment(Clean):
    def more(self, q):
        return float(os.environ.get("STATEFUL_LAWS", "0"))


@functools.lru_cache
def cached(_):
    return [0]


class InCache(Clean):
    def more(self, q):
        cached(0)[0] += 1
        return 0.01 * (cached(0)[0] > 500)


class Clocked(Clean):
    def more(self, q):
        return 1e-9 * time.perf_counter()


class Unseeded(Clean):
    def begin(self):
        self.rng = np.random.default_rng()

    def more(self, q):
        return 1e-3 * self.rng.normal()
