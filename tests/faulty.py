"""Controllers and metrics that misbehave on purpose, for the tests of sweeps; workers import them by name."""

import ctypes
import os
import signal
import time
from pathlib import Path

import numpy as np

import coop_pin as cp

PUSH = """
import numpy as np
import coop_pin as cp

class Push(cp.CellController):
    def __init__(self, scenario):
        pass

    def init(self, measurements, references):
        return None

    def step(self, measurements, references, state):
        return cp.CellCommand([np.array([TORQUE, 0.0, 0.0]) for _ in measurements], state)
"""
"""Source of a controller that a user edits: it gives the first drive the constant TORQUE."""


class Faulty(cp.CellController):
    """Does nothing until it misbehaves at the first tick."""

    def __init__(self, scenario, mode="none", marker=""):
        self.mode, self.marker = mode, Path(marker)
        self.shapes = [3 for _ in scenario.cell.arms]

    def init(self, measurements, references):
        return None

    def step(self, measurements, references, state):
        match self.mode:
            case "raise":
                if self.marker.is_file():
                    self.marker.write_text(self.marker.read_text() + "step\n")
                raise ValueError("this law has a mistake")
            case "exit":
                os._exit(3)
            case "crash":
                ctypes.string_at(0)
            case "hang":
                time.sleep(3600.0)
            case "slow":
                time.sleep(0.05)
            case "SystemExit":
                raise SystemExit(4)
            case "KeyboardInterrupt":
                raise KeyboardInterrupt
            case "ctrl-c":
                os.kill(os.getpid(), signal.SIGINT)
            case "stop once":
                if not self.marker.exists():
                    self.marker.touch()
                    os.kill(os.getpid(), signal.SIGSTOP)
            case "memory":
                self.eaten = np.ones(1 << 34)
        return cp.CellCommand([np.zeros(size) for size in self.shapes], state)


class Forgetful(Faulty):
    """Takes its torque from its options, and changes them."""

    def __init__(self, scenario, torques):
        super().__init__(scenario)
        self.torque = torques.pop()

    def step(self, measurements, references, state):
        return cp.CellCommand([np.full(size, self.torque) for size in self.shapes], state)


def answer(result):
    return {"answer": 42.0, "ticks": float(result.data.sizes["time"])}


def number(_result):
    return {"number": 1.0}


def wall_s(_result):
    return {"wall_s": 1.0}


def stiffness(result):
    return {"stiffness": abs(result.scenario.controller.gains.pose_gain - 3.0)}


def loud(_result):
    print("printed by a metric")
    return {"loud": 1.0}


def law(mode, **options):
    return {"controller": {"kind": "user", "target": "faulty:Faulty", "options": {"mode": mode} | options}}
