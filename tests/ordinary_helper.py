"""What the laws of ``ordinary_laws`` import of their own."""

import numpy as np

TICKS = 0
_tick = [0]


def next_tick():
    """The number of calls."""
    _tick[0] += 1
    return _tick[0]


def running_mean(memory, value):
    """The mean of all values, kept in an array of a count and a sum."""
    memory += [1.0, value]
    return memory[1] / memory[0]


class LowPass:
    """A filter of first order."""

    def __init__(self, alpha):
        self.alpha, self.y = alpha, 0.0

    def __call__(self, x):
        self.y = self.y + self.alpha * (x - self.y)
        return self.y


class Pid:
    """A controller of one number."""

    def __init__(self, kp, ki, kd):
        self.kp, self.ki, self.kd = kp, ki, kd
        self.i = 0.0
        self.last = None

    def update(self, error, dt):
        """Return the force."""
        self.i = self.i + self.ki * error * dt
        rate = 0.0 if self.last is None else (error - self.last) / dt
        self.last = error
        return self.kp * error + self.i + self.kd * rate


class Shared:
    """A peak value."""

    peak = np.zeros(1)

    def __call__(self, x):
        self.peak[0] = max(self.peak[0], x)
        return self.peak[0]


SHARED = Shared()
