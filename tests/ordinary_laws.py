# ruff: noqa: ARG001, B006, B905, NPY002, PTH123, PTH202, RET501, RUF012, SIM115, UP033
"""A hundred laws as ordinary people write them; the docstring of each names its kind of memory.

The last option of a law varies over ``GRIDS``, the first value is neutral. Written without a look at how the
package notices what a law keeps.
"""

import abc
import array
import collections
import contextvars
import copy
import csv
import ctypes
import dataclasses
import datetime
import decimal
import enum
import functools
import heapq
import io
import itertools
import json
import logging
import math
import os
import pickle
import queue
import random
import secrets
import shelve
import sqlite3
import string
import struct
import tempfile
import threading
import time
import types
import typing
import uuid
import weakref
from copy import deepcopy
from pathlib import Path
from time import perf_counter

import numpy as np
import ordinary_helper
import pandas as pd
import scipy.signal
from numpy.random import default_rng
from ordinary_helper import LowPass, Pid, running_mean

import coop_pin as cp
from coop_pin import ArmCommand, ArmController

GRIDS = {
    "gain": (0.0, 0.4, 0.8),
    "ki": (0.0, 20.0, 40.0),
    "ratio": (1.0, 0.9, 0.5),
    "alpha": (1.0, 0.5, 0.1),
    "window": (1, 5, 20),
    "delay": (0, 3, 10),
    "decay": (1.0, 0.99, 0.9),
    "threshold": (1e9, 1e-3, 1e-5),
    "enabled": (False, True),
    "order": (0, 1, 2),
    "limit": (1e6, 0.05, 0.01),
    "after": (1000.0, 1.0, 0.5),
}
DT = 0.0125
FOLDER = Path(tempfile.gettempdir()) / f"ordinary-laws-{os.getuid()}"
FOLDER.mkdir(exist_ok=True)


class Pd(ArmController):
    """no memory"""

    def __init__(self, scenario, arm, gain=0.0):
        self.rows, self.arm, self.gain = scenario.cell.task_rows, arm, gain
        self.setup()

    def setup(self):
        pass

    def init(self, m, r):
        return None

    def step(self, m, r, state):
        e = self.rows.pose_error(m.payload_pose, r.pose)
        return ArmCommand(-m.payload_jacobian.T @ (20 * e) - 2 * m.v + self.extra(m, r, e), state)

    def extra(self, m, r, e):
        return self.gain * m.v


# ------------------------------------------------------------------ numbers in attributes


class Integral(Pd):
    """float attribute"""

    def setup(self):
        self.total = 0.0

    def extra(self, m, r, e):
        self.total += self.gain * e[0]
        return self.total


class Ticks(Pd):
    """int attribute"""

    def setup(self):
        self.k = 0

    def extra(self, m, r, e):
        self.k += 1
        return self.gain * m.v if self.k > 100 else 0 * m.v


class Latched(Pd):
    """bool attribute"""

    def setup(self):
        self.moving = False

    def extra(self, m, r, e):
        self.moving = self.moving or m.time > 1.5
        return self.gain if self.moving else 0.0


class LastAngles(Pd):
    """None, then an array"""

    def setup(self):
        self.last = None

    def extra(self, m, r, e):
        dq = np.zeros(len(m.q)) if self.last is None else (m.q - self.last) / DT
        self.last = m.q
        return -self.gain * dq


class NumpyFloat(Pd):
    """numpy scalar attribute"""

    def setup(self):
        self.total = np.float64(0)

    def extra(self, m, r, e):
        self.total = self.total + self.gain * e[1]
        return self.total * np.ones(len(m.q))


class PidObject(ArmController):
    """helper object of another module"""

    def __init__(self, scenario, arm, ki=0.0):
        self.rows = scenario.cell.task_rows
        self.pids = [Pid(20.0, ki, 1.0) for _ in range(self.rows.size)]

    def init(self, m, r):
        return 0

    def step(self, m, r, state):
        e = self.rows.pose_error(m.payload_pose, r.pose)
        force = np.array([pid.update(x, DT) for pid, x in zip(self.pids, e)])
        return ArmCommand(-m.payload_jacobian.T @ force - 2 * m.v, state)


class Stacked(Pd):
    """array attribute, rebound"""

    def setup(self):
        self.sum = np.zeros(2)

    def extra(self, m, r, e):
        self.sum = self.sum + self.gain * e[:2]
        return self.sum[0] - self.sum[1]


class Added(Pd):
    """array attribute, += in place"""

    def setup(self):
        self.sum = np.zeros(self.rows.size)

    def extra(self, m, r, e):
        self.sum += self.gain * e
        return m.payload_jacobian.T @ self.sum


class Assigned(Pd):
    """array attribute, an entry assigned"""

    def setup(self):
        self.memory = np.zeros((20, 2))
        self.at = 0

    def extra(self, m, r, e):
        self.memory[self.at % 20] = e[:2]
        self.at += 1
        return self.gain * self.memory[:, 0].mean()


class Copied(Pd):
    """array attribute, np.copyto and out="""

    def setup(self):
        self.buffer = np.zeros(self.rows.size)

    def extra(self, m, r, e):
        np.multiply(self.buffer, 0.95, out=self.buffer)
        np.add(self.buffer, e, out=self.buffer)
        return self.gain * self.buffer[0]


class Filled(Pd):
    """array attribute, fill"""

    def setup(self):
        self.peak = np.zeros(1)

    def extra(self, m, r, e):
        self.peak.fill(max(float(self.peak[0]), abs(float(e[0]))))
        return self.gain * self.peak[0]


class Rolled(Pd):
    """array attribute, np.roll"""

    def __init__(self, scenario, arm, delay=0):
        super().__init__(scenario, arm)
        self.line = np.zeros(delay + 1)

    def extra(self, m, r, e):
        self.line = np.roll(self.line, 1)
        self.line[0] = m.v[0]
        return -5.0 * self.line[-1]


class Exponential(ArmController):
    """filter whose coefficient starts at 1"""

    def __init__(self, scenario, arm, alpha=1.0):
        self.alpha = alpha
        self.v_f = 0.0

    def init(self, m, r):
        return ()

    def step(self, m, r, state):
        self.v_f = (1 - self.alpha) * self.v_f + self.alpha * m.v
        return ArmCommand(-2 * self.v_f, state)


class Forgetting(ArmController):
    """sum whose forgetting factor starts at 1"""

    def __init__(self, scenario, arm, decay=1.0):
        self.decay, self.weight = decay, 1.0

    def init(self, m, r):
        return None

    def step(self, m, r, state):
        self.weight *= self.decay
        return ArmCommand(-(1 + self.weight) * m.v, state)


class Scheduled(ArmController):
    """gain that grows by a factor that starts at 1"""

    def __init__(self, scenario, arm, ratio=1.0):
        self.kd, self.ratio = 2.0, ratio

    def init(self, m, r):
        return None

    def step(self, m, r, state):
        u = -self.kd * m.v
        self.kd = max(0.2, self.kd * self.ratio)
        return ArmCommand(u, state)


class AntiWindup(Pd):
    """integral behind a limit"""

    def __init__(self, scenario, arm, limit=1e6):
        super().__init__(scenario, arm)
        self.i, self.limit = np.zeros(self.rows.size), limit

    def extra(self, m, r, e):
        self.i = np.clip(self.i + 0.5 * e, -self.limit, self.limit)
        return -m.payload_jacobian.T @ self.i


class DeadZone(Pd):
    """integral behind a threshold that is never met"""

    def __init__(self, scenario, arm, threshold=1e9):
        super().__init__(scenario, arm)
        self.i, self.threshold = 0.0, threshold

    def extra(self, m, r, e):
        self.i = self.i + np.where(np.abs(e[0]) > self.threshold, e[0], 0.0)
        return 0.3 * self.i


class Switched(Pd):
    """mode in a text"""

    def __init__(self, scenario, arm, after=1000.0):
        super().__init__(scenario, arm)
        self.mode, self.after = "approach", after

    def extra(self, m, r, e):
        if m.time > self.after:
            self.mode = "hold"
        return -2.0 * m.v if self.mode == "hold" else 0.0 * m.v


class Phase(enum.Enum):
    WAIT = 0
    PUSH = 1


class Machine(Pd):
    """mode in an enum"""

    phase = Phase.WAIT

    def extra(self, m, r, e):
        if self.phase is Phase.WAIT and m.time >= 1:
            self.phase = Phase.PUSH
        return self.gain if self.phase is Phase.PUSH else 0.0


class FirstAngles(Pd):
    """attribute set in init"""

    def init(self, m, r):
        self.q0 = m.q.copy()
        return None

    def extra(self, m, r, e):
        return -5 * self.gain * (m.q - self.q0)


class TriedAttribute(Pd):
    """attribute made by except AttributeError"""

    def extra(self, m, r, e):
        try:
            self.count += 1
        except AttributeError:
            self.count = 1
        return self.gain * 0.01 * self.count


class FirstCall(Pd):
    """cached_property of the first measurement"""

    @functools.cached_property
    def start(self):
        return self._now

    def extra(self, m, r, e):
        self._now = m.q
        return -5 * self.gain * (m.q - self.start)


class WithSlots:
    __slots__ = ("old", "rate")

    def __init__(self):
        self.old = self.rate = 0.0


class Slotted(Pd):
    """object with __slots__"""

    def setup(self):
        self.d = WithSlots()

    def extra(self, m, r, e):
        self.d.rate = 0.9 * self.d.rate + (e[0] - self.d.old)
        self.d.old = e[0]
        return self.gain * self.d.rate


class Named(Pd):
    """SimpleNamespace"""

    def setup(self):
        self.s = types.SimpleNamespace(i=0.0)

    def extra(self, m, r, e):
        self.s.i += e[0]
        return self.gain * self.s.i


@dataclasses.dataclass
class Memory:
    integral: float = 0.0
    past: list = dataclasses.field(default_factory=list)


class Data(Pd):
    """dataclass attribute"""

    def setup(self):
        self.memory = Memory()

    def extra(self, m, r, e):
        self.memory.integral += e[0]
        return self.gain * self.memory.integral


class FrozenData(Pd):
    """namedtuple attribute, replaced"""

    Kept = collections.namedtuple("Kept", "i n")

    def setup(self):
        self.kept = self.Kept(0.0, 0)

    def extra(self, m, r, e):
        self.kept = self.kept._replace(i=self.kept.i + e[0], n=self.kept.n + 1)
        return self.gain * self.kept.i


class Setter(Pd):
    """property with a setter"""

    _i = 0.0

    @property
    def i(self):
        return self._i

    @i.setter
    def i(self, value):
        self._i = value

    def extra(self, m, r, e):
        self.i = self.i + e[0]
        return self.gain * self.i


class Recorded:
    """A descriptor that keeps a value for each object."""

    def __init__(self):
        self.values = weakref.WeakKeyDictionary()

    def __get__(self, obj, kind=None):
        return self.values.get(obj, 0.0)

    def __set__(self, obj, value):
        self.values[obj] = value


class Described(Pd):
    """descriptor with a WeakKeyDictionary"""

    level = Recorded()

    def extra(self, m, r, e):
        self.level = self.level + 0.01
        return self.gain * self.level


class Numbered(Pd):
    """setattr by computed names"""

    def extra(self, m, r, e):
        for i in range(2):
            setattr(self, f"e{i}", getattr(self, f"e{i}", 0.0) + e[i])
        return self.gain * (self.e0 - self.e1)


class Nested(Pd):
    """filter of a helper module, in a list in a dict"""

    def __init__(self, scenario, arm, alpha=1.0):
        super().__init__(scenario, arm)
        self.filters = {"v": [LowPass(alpha)]}

    def extra(self, m, r, e):
        return -3 * self.filters["v"][0](m.v)


class Remembered(Pd):
    """the last measurement"""

    before = None

    def extra(self, m, r, e):
        last, self.before = self.before, m
        return 0 * m.v if last is None else -self.gain * (m.q - last.q) / DT


class LastCommand(ArmController):
    """the last command, for a limit of its rate"""

    def __init__(self, scenario, arm, limit=1e6):
        self.max_step, self.last = limit, None

    def init(self, measurement, reference):
        return None

    def step(self, measurement, reference, state):
        wanted = -2 * measurement.v
        if self.last is not None:
            wanted = self.last + np.clip(wanted - self.last, -self.max_step, self.max_step)
        self.last = wanted
        return ArmCommand(wanted, state)


# ------------------------------------------------------------------ containers


class ErrorList(Pd):
    """list, append"""

    def setup(self):
        self.errors = []

    def extra(self, m, r, e):
        self.errors.append(e[0])
        return self.gain * sum(self.errors)


class MovingAverage(Pd):
    """deque whose length starts at 1"""

    def __init__(self, scenario, arm, window=1):
        super().__init__(scenario, arm)
        self.values = collections.deque(maxlen=window)

    def extra(self, m, r, e):
        self.values.append(m.v)
        return -5 * sum(self.values) / len(self.values)


class Delayed(Pd):
    """list as a delay line, pop(0)"""

    def __init__(self, scenario, arm, delay=0):
        super().__init__(scenario, arm)
        self.line = [np.zeros(6)[: len(scenario.cell.arms[arm].posture)]] * delay

    def extra(self, m, r, e):
        self.line.append(m.v)
        return -5 * self.line.pop(0)


class Dict(Pd):
    """dict"""

    def setup(self):
        self.state = {"i": 0.0, "n": 0}

    def extra(self, m, r, e):
        self.state["i"] += e[0]
        self.state["n"] += 1
        return self.gain * self.state["i"]


class Default(Pd):
    """defaultdict"""

    def setup(self):
        self.sums = collections.defaultdict(float)

    def extra(self, m, r, e):
        for axis, value in zip("xyz", e):
            self.sums[axis] += value
        return self.gain * self.sums["x"]


class Tally(Pd):
    """Counter"""

    def setup(self):
        self.seen = collections.Counter()

    def extra(self, m, r, e):
        self.seen["ticks"] += 1
        return self.gain * (self.seen["ticks"] > 120)


class Visited(Pd):
    """set"""

    def setup(self):
        self.done = set()

    def extra(self, m, r, e):
        self.done.add(round(m.time, 1))
        return self.gain * 0.05 * len(self.done)


class Tupled(Pd):
    """tuple, rebound"""

    def setup(self):
        self.last3 = (0.0, 0.0, 0.0)

    def extra(self, m, r, e):
        self.last3 = (*self.last3[1:], e[0])
        return self.gain * (self.last3[2] - self.last3[0])


class Heap(Pd):
    """heapq"""

    def setup(self):
        self.heap = [0.0]

    def extra(self, m, r, e):
        heapq.heappush(self.heap, -m.time)
        return self.gain * 0.1 * self.heap[0]


class Queued(Pd):
    """queue.Queue"""

    def setup(self):
        self.q = queue.Queue()
        for _ in range(50):
            self.q.put(0.0)

    def extra(self, m, r, e):
        self.q.put(m.time)
        return self.gain * self.q.get()


class TypedArray(Pd):
    """array.array"""

    def setup(self):
        self.kept = array.array("d", [0.0, 0.0])

    def extra(self, m, r, e):
        self.kept[0] += 0.01
        return self.gain * self.kept[0]


class Bytes(Pd):
    """bytearray and struct"""

    def setup(self):
        self.shared = bytearray(8)

    def extra(self, m, r, e):
        (n,) = struct.unpack_from("<q", self.shared)
        struct.pack_into("<q", self.shared, 0, n + 1)
        return self.gain * (n > 100)


class CDouble(Pd):
    """ctypes"""

    def setup(self):
        self.n = ctypes.c_double(0.0)

    def extra(self, m, r, e):
        self.n.value += 0.01
        return self.gain * self.n.value


class Structured(Pd):
    """structured array"""

    def setup(self):
        self.table = np.zeros(1, [("i", float), ("n", int)])

    def extra(self, m, r, e):
        self.table["n"] += 1
        return self.gain * (self.table["n"][0] > 100)


class Masked(Pd):
    """masked array"""

    def setup(self):
        self.past = np.ma.masked_all(1000)
        self.n = itertools.count().__next__

    def extra(self, m, r, e):
        self.past[self.n()] = m.time
        return self.gain * self.past.mean()


class Frame(Pd):
    """pandas data frame"""

    def setup(self):
        self.log = pd.DataFrame({"t": [0.0]})

    def extra(self, m, r, e):
        self.log.loc[len(self.log)] = [m.time]
        return self.gain * self.log["t"].mean()


class Series(Pd):
    """pandas series, rolling"""

    def setup(self):
        self.s = pd.Series(np.zeros(10))

    def extra(self, m, r, e):
        self.s = self.s.shift(1)
        self.s.iloc[0] = m.time
        return self.gain * self.s.fillna(0.0).iloc[9]


class ScipyFilter(Pd):
    """scipy filter's zi"""

    def setup(self):
        self.b, self.a = scipy.signal.butter(1, 0.1)
        self.zi = np.zeros(1)

    def extra(self, m, r, e):
        y, self.zi = scipy.signal.lfilter(self.b, self.a, [m.v[0]], zi=self.zi)
        return -self.gain * y[0]


class Polynomial(Pd):
    """samples for np.polyfit"""

    def setup(self):
        self.t, self.y = [], []

    def extra(self, m, r, e):
        self.t.append(m.time)
        self.y.append(m.q[0])
        if len(self.t) < 5:
            return 0.0
        return self.gain * np.polyfit(self.t[-5:], self.y[-5:], 1)[0]


class Kalman(ArmController):
    """matrices of an observer"""

    def __init__(self, scenario, arm, gain=0.0):
        self.gain, self.P, self.x = gain, np.eye(2), np.zeros(2)

    def init(self, m, r):
        return None

    def step(self, m, r, state):
        A = np.array([[1, DT], [0, 1]])
        self.P = A @ self.P @ A.T + 1e-3 * np.eye(2)
        K = self.P[:, 0] / (self.P[0, 0] + 1e-2)
        self.x = A @ self.x
        self.x = self.x + K * (m.q[0] - self.x[0])
        self.P = self.P - np.outer(K, self.P[0])
        return ArmCommand(-2 * m.v - self.gain * self.x[1], state)


class DecimalSum(Pd):
    """Decimal"""

    def setup(self):
        self.sum = decimal.Decimal(0)

    def extra(self, m, r, e):
        self.sum += decimal.Decimal("0.01")
        return self.gain * float(self.sum)


class WrittenText(Pd):
    """text that grows"""

    def setup(self):
        self.log = ""

    def extra(self, m, r, e):
        self.log += "x"
        return self.gain * 0.01 * len(self.log)


class TextBuffer(Pd):
    """io.StringIO"""

    def setup(self):
        self.out = io.StringIO()

    def extra(self, m, r, e):
        self.out.write("tick\n")
        return self.gain * 0.001 * self.out.tell()


# ------------------------------------------------------------------ generators and closures


def ramp():
    level = 0.0
    while True:
        yield level
        level += 0.01


class Generator(Pd):
    """generator"""

    def setup(self):
        self.ramp = ramp()

    def extra(self, m, r, e):
        return self.gain * next(self.ramp)


def averager():
    total = 0.0
    value = yield 0.0
    while True:
        total += value
        value = yield total


class Coroutine(Pd):
    """generator with send"""

    def setup(self):
        self.average = averager()
        next(self.average)

    def extra(self, m, r, e):
        return self.gain * self.average.send(e[0])


class Cycle(Pd):
    """itertools.cycle"""

    def setup(self):
        self.signs = itertools.cycle([1.0] * 60 + [-1.0] * 60)

    def extra(self, m, r, e):
        return self.gain * next(self.signs)


class Planned(Pd):
    """iterator of a list"""

    def setup(self):
        self.plan = iter(np.linspace(0, 1, 1000).tolist())

    def extra(self, m, r, e):
        return self.gain * next(self.plan)


def make_integrator(gain):
    total = 0.0

    def integrate(x):
        nonlocal total
        total += gain * x
        return total

    return integrate


class Closure(Pd):
    """closure with nonlocal"""

    def setup(self):
        self.integrate = make_integrator(self.gain)

    def extra(self, m, r, e):
        return self.integrate(e[0])


class ListClosure(Pd):
    """lambda over a list"""

    def setup(self):
        cell = [0.0]
        self.push = lambda x: cell.append(x) or sum(cell)

    def extra(self, m, r, e):
        return self.gain * self.push(e[0])


class Partial(Pd):
    """functools.partial over an array"""

    def setup(self):
        self.mean = functools.partial(running_mean, np.zeros(2))

    def extra(self, m, r, e):
        return self.gain * self.mean(m.time)


def ticked():
    ticked.count = getattr(ticked, "count", 0) + 1
    return ticked.count


class FunctionAttribute(Pd):
    """attribute of a function"""

    def extra(self, m, r, e):
        return self.gain * 0.01 * ticked()


def remember(x, past=[]):
    past.append(x)
    return past


class MutableDefault(Pd):
    """mutable default argument"""

    def extra(self, m, r, e):
        return self.gain * 0.01 * len(remember(m.time))


@functools.lru_cache(maxsize=None)
def start_of(arm):
    return {"n": 0}


class Cached(Pd):
    """lru_cache"""

    def extra(self, m, r, e):
        memo = start_of(self.arm)
        memo["n"] += 1
        return self.gain * 0.01 * memo["n"]


class Bound(Pd):
    """bound method of a list"""

    def setup(self):
        past = []
        self.note, self.size = past.append, past.__len__

    def extra(self, m, r, e):
        self.note(0)
        return self.gain * 0.01 * self.size()


# ------------------------------------------------------------------ classes and modules


class OfTheClass(Pd):
    """class attribute, a number"""

    ticks = 0

    def extra(self, m, r, e):
        type(self).ticks += 1
        return self.gain * 0.001 * self.ticks


class ClassArray(Pd):
    """class attribute, an array"""

    total = np.zeros(1)

    def extra(self, m, r, e):
        self.total += 0.001
        return self.gain * self.total[0]


class ClassDict(Pd):
    """class attribute, a dict of arms"""

    arms = {}

    def extra(self, m, r, e):
        ClassDict.arms[self.arm] = m.time
        return self.gain * sum(ClassDict.arms.values()) / len(ClassDict.arms)


class Singleton(Pd):
    """one board for all arms"""

    board = None

    def setup(self):
        if Singleton.board is None:
            Singleton.board = collections.defaultdict(int)

    def extra(self, m, r, e):
        Singleton.board["n"] += 1
        return self.gain * 0.001 * Singleton.board["n"]


class Counting(type(ArmController)):
    made = 0

    def __call__(cls, *args, **kwargs):
        Counting.made += 1
        return super().__call__(*args, **kwargs)


class Constructed(Pd, metaclass=Counting):
    """count of objects by a metaclass"""

    def extra(self, m, r, e):
        return self.gain * 0.01 * Counting.made


COUNTER = 0


class Global(Pd):
    """global number"""

    def extra(self, m, r, e):
        global COUNTER
        COUNTER += 1
        return self.gain * 0.001 * COUNTER


TABLE = np.zeros(3)


class GlobalArray(Pd):
    """global array"""

    def extra(self, m, r, e):
        TABLE[0] += 0.001
        return self.gain * TABLE[0]


LOG = []


class GlobalList(Pd):
    """global list"""

    def extra(self, m, r, e):
        LOG.append(m.time)
        return self.gain * 0.001 * len(LOG)


class OtherModule(Pd):
    """global number of another module"""

    def extra(self, m, r, e):
        ordinary_helper.TICKS += 1
        return self.gain * 0.001 * ordinary_helper.TICKS


class OtherModuleFunction(Pd):
    """function of another module that counts"""

    def extra(self, m, r, e):
        return self.gain * 0.001 * ordinary_helper.next_tick()


class Context(Pd):
    """contextvars"""

    n = contextvars.ContextVar("n", default=0)

    def extra(self, m, r, e):
        self.n.set(self.n.get() + 1)
        return self.gain * 0.001 * self.n.get()


class Local(Pd):
    """threading.local"""

    def setup(self):
        self.local = threading.local()
        self.local.n = 0

    def extra(self, m, r, e):
        self.local.n += 1
        return self.gain * 0.01 * self.local.n


class Handler(logging.Handler):
    n = 0

    def emit(self, record):
        self.n += 1


class Logged(Pd):
    """counter in a logging handler"""

    def setup(self):
        self.log = logging.Logger("law")
        self.log.addHandler(Handler())

    def extra(self, m, r, e):
        self.log.warning("tick")
        return self.gain * 0.01 * self.log.handlers[0].n


# ------------------------------------------------------------------ files and the surroundings


class Appended(Pd):
    """file, appended and read"""

    def setup(self):
        self.path = FOLDER / f"{self.arm}.log"
        self.path.write_text("")

    def extra(self, m, r, e):
        with open(self.path, "a") as f:
            f.write("x")
        return self.gain * 0.01 * os.path.getsize(self.path)


class OpenFile(Pd):
    """open file in an attribute"""

    def setup(self):
        self.file = tempfile.TemporaryFile("w+")

    def extra(self, m, r, e):
        self.file.write("x")
        return self.gain * 0.01 * self.file.tell()


class Json(Pd):
    """JSON file, rewritten"""

    def setup(self):
        self.path = FOLDER / f"{self.arm}.json"
        self.path.write_text(json.dumps({"n": 0}))

    def extra(self, m, r, e):
        data = json.loads(self.path.read_text())
        data["n"] += 1
        self.path.write_text(json.dumps(data))
        return self.gain * 0.01 * data["n"]


class Saved(Pd):
    """numpy file, rewritten"""

    def setup(self):
        self.path = FOLDER / f"{self.arm}.npy"
        np.save(self.path, 0.0)

    def extra(self, m, r, e):
        n = float(np.load(self.path)) + 0.01
        np.save(self.path, n)
        return self.gain * n


class Pickled(Pd):
    """pickle in memory"""

    def setup(self):
        self.blob = pickle.dumps(0)

    def extra(self, m, r, e):
        n = pickle.loads(self.blob) + 1
        self.blob = pickle.dumps(n)
        return self.gain * 0.01 * n


class CsvLog(Pd):
    """csv writer"""

    def setup(self):
        self.buffer = io.StringIO()
        self.writer = csv.writer(self.buffer)

    def extra(self, m, r, e):
        self.writer.writerow([m.time])
        return self.gain * 0.001 * len(self.buffer.getvalue())


class Database(Pd):
    """sqlite3"""

    def setup(self):
        self.db = sqlite3.connect(":memory:")
        self.db.execute("create table t (x real)")

    def extra(self, m, r, e):
        self.db.execute("insert into t values (?)", (m.time,))
        return self.gain * 0.01 * self.db.execute("select count(*) from t").fetchone()[0]


class Shelf(Pd):
    """shelve"""

    def setup(self):
        self.name = str(FOLDER / f"shelf-{self.arm}")
        with shelve.open(self.name, "n") as shelf:
            shelf["n"] = 0

    def extra(self, m, r, e):
        with shelve.open(self.name) as shelf:
            shelf["n"] += 1
            return self.gain * 0.01 * shelf["n"]


class Mapped(Pd):
    """np.memmap"""

    def setup(self):
        self.map = np.memmap(FOLDER / f"{self.arm}.map", float, "w+", shape=1)

    def extra(self, m, r, e):
        self.map[0] += 0.01
        return self.gain * self.map[0]


class Environ(Pd):
    """os.environ"""

    def setup(self):
        os.environ["ORDINARY_TICKS"] = "0"

    def extra(self, m, r, e):
        n = int(os.environ["ORDINARY_TICKS"]) + 1
        os.environ["ORDINARY_TICKS"] = str(n)
        return self.gain * 0.005 * n


# ------------------------------------------------------------------ random numbers and clocks


class Seeded(Pd):
    """default_rng with a seed"""

    def setup(self):
        self.rng = default_rng(1)

    def extra(self, m, r, e):
        return self.gain * self.rng.normal()


class SeededState(Pd):
    """RandomState with a seed"""

    def setup(self):
        self.rng = np.random.RandomState(1)

    def extra(self, m, r, e):
        return self.gain * self.rng.randn(len(m.q))


class SeededGlobal(Pd):
    """np.random.seed"""

    def setup(self):
        np.random.seed(0)

    def extra(self, m, r, e):
        return self.gain * np.random.rand()


class SeededPlain(Pd):
    """random.Random with a seed"""

    def setup(self):
        self.dice = random.Random(0)

    def extra(self, m, r, e):
        return self.gain * self.dice.random()


class Unseeded(Pd):
    """default_rng without a seed"""

    def setup(self):
        self.rng = np.random.default_rng()

    def extra(self, m, r, e):
        return self.gain * self.rng.normal()


class UnseededGlobal(Pd):
    """np.random.normal"""

    def extra(self, m, r, e):
        return self.gain * np.random.normal()


class UnseededPlain(Pd):
    """random.gauss"""

    def extra(self, m, r, e):
        return self.gain * random.gauss(0, 1)


class Secret(Pd):
    """secrets"""

    def extra(self, m, r, e):
        return self.gain * 0.01 * secrets.randbelow(100)


class Uuid(Pd):
    """uuid4"""

    def extra(self, m, r, e):
        return self.gain * (uuid.uuid4().int % 100) / 100


class Urandom(Pd):
    """os.urandom"""

    def extra(self, m, r, e):
        return self.gain * os.urandom(1)[0] / 256


class Wall(Pd):
    """time.time"""

    def setup(self):
        self.t0 = time.time()

    def extra(self, m, r, e):
        return self.gain * (time.time() - self.t0)


class Performance(Pd):
    """perf_counter, imported by name"""

    def setup(self):
        self.t0 = perf_counter()

    def extra(self, m, r, e):
        return self.gain * (perf_counter() - self.t0)


class Dated(Pd):
    """datetime.now"""

    def extra(self, m, r, e):
        return self.gain * datetime.datetime.now().microsecond * 1e-6


class Elapsed(Pd):
    """time between ticks by monotonic"""

    last = None

    def extra(self, m, r, e):
        now = time.monotonic()
        dt = DT if self.last is None else now - self.last
        self.last = now
        return self.gain * dt * m.v


# ------------------------------------------------------------------ in the state that step returns


class InState(ArmController):
    """state, an array"""

    def __init__(self, scenario, arm, ki=0.0):
        self.ki, self.rows = ki, scenario.cell.task_rows

    def init(self, m, r):
        return np.zeros(self.rows.size)

    def step(self, m, r, state):
        e = self.rows.pose_error(m.payload_pose, r.pose)
        state = state + self.ki * DT * e
        return ArmCommand(-m.payload_jacobian.T @ (20 * e + state) - 2 * m.v, state)


class InStateInPlace(InState):
    """state, an array changed in place"""

    def step(self, m, r, state):
        e = self.rows.pose_error(m.payload_pose, r.pose)
        state += self.ki * DT * e
        return ArmCommand(-m.payload_jacobian.T @ state - 2 * m.v, state)


class InStateDict(InState):
    """state, a dict changed in place"""

    def init(self, m, r):
        return {"i": 0.0, "n": 0}

    def step(self, m, r, state):
        e = self.rows.pose_error(m.payload_pose, r.pose)
        state["i"] = state["i"] + self.ki * DT * e
        return ArmCommand(-m.payload_jacobian.T @ state["i"] - 2 * m.v, state)


class InStateObject(InState):
    """state, an object"""

    def init(self, m, r):
        return Memory()

    def step(self, m, r, state):
        e = self.rows.pose_error(m.payload_pose, r.pose)
        state.integral += self.ki * DT * e[0]
        state.past.append(e[0])
        return ArmCommand(-2 * m.v - state.integral, state)


class InStateDeque(InState):
    """state, a deque"""

    def init(self, m, r):
        return collections.deque([0.0] * 5, maxlen=5)

    def step(self, m, r, state):
        state.append(m.v)
        return ArmCommand(-2 * m.v - 0.1 * self.ki * state[0], state)


class InStateCopied(InState):
    """state, deep-copied"""

    def init(self, m, r):
        return {"past": [0.0]}

    def step(self, m, r, state):
        new = deepcopy(state)
        new["past"].append(m.time)
        return ArmCommand(-2 * m.v - 0.01 * self.ki * sum(new["past"][-3:]), new)


class NotReturned(InState):
    """state that is changed, but not returned"""

    def step(self, m, r, state):
        new = state + self.ki * m.v[0]
        return ArmCommand(-2 * m.v - 0.01 * new[0], state)


# ------------------------------------------------------------------ other shapes of laws


class Together(cp.CellController):
    """attribute of a law of all arms"""

    def __init__(self, scenario, ki=0.0):
        self.ki, self.total = ki, 0.0

    def init(self, measurements, references):
        return None

    def step(self, measurements, references, state):
        self.total = self.total + self.ki * 0.01 * measurements[0].v[0]
        return cp.CellCommand([-2 * m.v - self.total for m in measurements], state)


class Wrapped(ArmController):
    """wrapper of another law with a counter"""

    def __init__(self, scenario, arm, gain=0.0):
        self.law, self.n, self.gain = InState(scenario, arm, 10.0), 0, gain

    def init(self, m, r):
        return self.law.init(m, r)

    def step(self, m, r, state):
        self.n += 1
        command = self.law.step(m, r, state)
        return ArmCommand(command.torque * (1 + self.gain * 1e-4 * self.n), command.state)


class Mixin:
    def count(self):
        self.__dict__["n"] = self.__dict__.get("n", 0) + 1
        return self.n


class Mixed(Mixin, Pd):
    """counter of a mixin"""

    def extra(self, m, r, e):
        return self.gain * 0.01 * self.count()


def smoothed(step):
    past = {}

    @functools.wraps(step)
    def wrapper(self, m, r, state):
        command = step(self, m, r, state)
        past[self.arm] = 0.5 * past.get(self.arm, 0.0) + 0.5 * command.torque
        return ArmCommand((1 - self.gain) * command.torque + self.gain * past[self.arm], command.state)

    return wrapper


class Decorated(Pd):
    """decorator with a dict"""

    @smoothed
    def step(self, m, r, state):
        return ArmCommand(-2 * m.v, state)


class Callable:
    def __init__(self):
        self.n = 0

    def __call__(self):
        self.n += 1
        return self.n


class CallObject(Pd):
    """callable object"""

    def setup(self):
        self.tick = Callable()

    def extra(self, m, r, e):
        return self.gain * 0.01 * self.tick()


class SlotLaw(ArmController):
    """law with __slots__"""

    __slots__ = ("gain", "n")

    def __init__(self, scenario, arm, gain=0.0):
        self.gain, self.n = gain, 0

    def init(self, m, r):
        return None

    def step(self, m, r, state):
        self.n += 1
        return ArmCommand(-2 * m.v + self.gain * 0.01 * self.n, state)


class Events(Pd):
    """threading.Event by time"""

    def setup(self):
        self.go = threading.Event()

    def extra(self, m, r, e):
        if m.time > 1.0:
            self.go.set()
        return self.gain * self.go.is_set()


class Timed(Pd):
    """branch on time, no memory"""

    def __init__(self, scenario, arm, after=1000.0):
        super().__init__(scenario, arm)
        self.after = after

    def extra(self, m, r, e):
        return -3 * m.v if m.time > self.after else 0 * m.v


class Flag(Pd):
    """option that is a flag"""

    def __init__(self, scenario, arm, enabled=False):
        super().__init__(scenario, arm)
        self.enabled, self.i = enabled, 0.0

    def extra(self, m, r, e):
        if self.enabled:
            self.i = self.i + e[0]
        return self.i


class Orders(Pd):
    """differences of an order that starts at 0"""

    def __init__(self, scenario, arm, order=0):
        super().__init__(scenario, arm)
        self.past = [0.0] * order

    def extra(self, m, r, e):
        x = m.q[0]
        for i in range(len(self.past)):
            x, self.past[i] = x - self.past[i], x
        return -0.5 * x


class Mail(Pd):
    """messages to itself in a class list"""

    box: typing.ClassVar[list] = []

    def extra(self, m, r, e):
        self.box.append(m.time)
        return self.gain * 0.01 * len(self.box[-500:])


class Permuted(Pd):
    """shuffled list"""

    def setup(self):
        self.order = list(range(10))

    def extra(self, m, r, e):
        random.shuffle(self.order)
        return self.gain * 0.1 * self.order[0]


class Swapped(Pd):
    """two objects that change places"""

    def setup(self):
        self.a, self.b = [0.0], [1.0]

    def extra(self, m, r, e):
        self.a, self.b = self.b, self.a
        return self.gain * self.a[0]


class ReplacedMethod(Pd):
    """method replaced after a second"""

    def extra(self, m, r, e):
        if m.time > 1.0:
            self.extra = self.later
        return 0.0 * m.v

    def later(self, m, r, e):
        return -self.gain * m.v


class ModuleObject(Pd):
    """object made in another module"""

    def extra(self, m, r, e):
        return self.gain * ordinary_helper.SHARED(m.time)


class Letters(Pd):
    """iterator of a text"""

    def setup(self):
        self.letters = iter(string.ascii_letters * 20)

    def extra(self, m, r, e):
        return self.gain * 0.01 * (ord(next(self.letters)) - 65)


class Copies(Pd):
    """object replaced by its copy"""

    def setup(self):
        self.box = types.SimpleNamespace(n=0)

    def extra(self, m, r, e):
        self.box = copy.copy(self.box)
        self.box.n += 1
        return self.gain * 0.01 * self.box.n


class Sines(Pd):
    """phase of an oscillator"""

    phase = 0.0

    def extra(self, m, r, e):
        self.phase = math.fmod(self.phase + 0.1, 2 * math.pi)
        return self.gain * math.sin(self.phase)


class Excited(Pd):
    """excitation array read by an index"""

    def setup(self):
        self.signal = np.random.default_rng(0).normal(size=1000)
        self.k = -1

    def extra(self, m, r, e):
        self.k += 1
        return self.gain * self.signal[self.k]


class BaseLaw(ArmController, abc.ABC):
    @abc.abstractmethod
    def torque(self, m): ...

    def init(self, m, r):
        self.n = 0
        return None

    def step(self, m, r, state):
        self.n = self.n + 1
        return ArmCommand(self.torque(m), state)


class Derived(BaseLaw):
    """counter of an abstract base, set in init"""

    def __init__(self, scenario, arm, gain=0.0):
        self.gain = gain

    def torque(self, m):
        return -2 * m.v - self.gain * 0.01 * self.n


# ------------------------------------------------------------------ torch

try:
    import torch
except ModuleNotFoundError:
    torch = None
else:

    class Tensor(Pd):
        """torch tensor in place"""

        def setup(self):
            self.h = torch.zeros(1, dtype=torch.float64)

        def extra(self, m, r, e):
            self.h += 0.01
            return self.gain * self.h.item()

    class Buffered(Pd):
        """buffer of a torch module"""

        def setup(self):
            self.norm = torch.nn.BatchNorm1d(1).double()

        def extra(self, m, r, e):
            self.norm(torch.tensor([[float(m.time)], [0.0]], dtype=torch.float64))
            return self.gain * float(self.norm.running_mean[0])

    class Recurrent(Pd):
        """hidden state of a torch cell"""

        def setup(self):
            torch.manual_seed(0)
            self.cell, self.h = torch.nn.GRUCell(1, 4).double(), torch.zeros(1, 4, dtype=torch.float64)

        def extra(self, m, r, e):
            with torch.no_grad():
                self.h = self.cell(torch.tensor([[float(m.v[0])]], dtype=torch.float64), self.h)
            return self.gain * float(self.h.sum())

    class TorchRandom(Pd):
        """torch.randn"""

        def extra(self, m, r, e):
            return self.gain * torch.randn(1).item()


LAWS = {
    name: kind
    for name, kind in globals().items()
    if isinstance(kind, type) and issubclass(kind, ArmController | cp.CellController) and kind.__doc__
    if kind.__module__ == __name__ and name != "BaseLaw"
}
"""Classes by name."""
