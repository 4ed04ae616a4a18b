"""Wrist sensor of one arm, and the transport of the internal wrench to the controllers."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence

import numpy as np

from coop_pin.arrays import Array, frozen
from coop_pin.control.force_path import ForcePath as ForcePathOptions
from coop_pin.description.plant import Clock
from coop_pin.description.sensors import WristSensor
from coop_pin.spatial import rotate_vector6, shift_wrench


class Wrist:
    """Wrist sensor of one arm, with the samples on their way to the controller.

    Attributes:
        wrench: the newest sample that the controller has: F_i about P in world axes, as the arm's kinematics
            saw them when it was taken, shape (6,); zero before the first.
        taken: tick of that sample; -inf before the first.
    """

    def __init__(self, sensor: WristSensor, X_PE: Array, clock: Clock, rng: np.random.Generator) -> None:
        """Start without a sample.

        Args:
            sensor: what it is.
            X_PE: grasp of the arm, shape (4, 4).
            clock: of the run.
            rng: source of the noise.
        """
        self._noise, self._offset, self._drift = (
            part.vector6 for part in (sensor.noise, sensor.offset, sensor.drift)
        )
        self._X_PE, self._rng, self._lost = X_PE, rng, sensor.lost
        self._every, self._delay = sensor.ticks_per_sample(clock), sensor.delay
        self._early = 1e-9 * clock.period  # a tick this little before an instant is at the instant
        self.restart()

    def restart(self) -> None:
        """Forget all samples."""
        self.wrench, self.taken = np.zeros(6), -np.inf
        self._waiting: deque[tuple[int, Array]] = deque()

    def read(self, tick: int, time: float, F_P: Array, R_WP: Array) -> None:
        """Take a sample if one is due at this tick, and hand over what has arrived.

        Args:
            tick: index of the tick.
            time: t_k, s.
            F_P: true F_i about P in payload axes, shape (6,).
            R_WP: orientation of the payload as the arm's kinematics see it, shape (3, 3).
        """
        if tick % self._every == 0:
            noise = self._noise * self._rng.standard_normal(6)  # drawn while lost, too: then none shifts
            now = time + self._early
            if not any(start <= now < end for start, end in self._lost):
                error_E = rotate_vector6(self._X_PE[:3, :3], noise + self._offset + time * self._drift)
                error_P = shift_wrench(error_E, self._X_PE[:3, 3])
                self._waiting.append((tick, rotate_vector6(R_WP, F_P + error_P)))
        while self._waiting and self._waiting[0][0] + self._delay <= tick:
            self.taken, self.wrench = self._waiting.popleft()


class ForcePath:
    """Internal wrenches on their way to the controllers: f_m[k] = p f_m[k-1] + (1 - p) f(t_{k-D}^-).

    Each sample passes the filter once, when it arrives.

    Attributes:
        wrenches: f_m of each arm, task rows, shape (k_0,) each, read-only.
        taken: tick of the newest sample in it; -inf before the first.
    """

    def __init__(self, path: ForcePathOptions) -> None:
        """Start without wrenches."""
        self._pole = path.pole
        self._delay = path.delay
        self.start([])

    def start(self, wrenches: list[Array]) -> None:
        """Begin with f_m[0], before the first sample."""
        self.wrenches, self.taken = wrenches, -np.inf
        self._waiting: deque[tuple[int, float, Sequence[Array]]] = deque()
        self._newest: float = 0.0

    def is_new(self, taken: float) -> bool:
        """Return whether a sample taken at this tick, after the first tick, has not been sent yet."""
        return taken > self._newest

    def send(self, tick: int, taken: float, internal: Sequence[Array]) -> None:
        """Send the internal wrenches of a tick, task rows, shape (k_0,) each."""
        self._newest = taken
        self._waiting.append((tick + self._delay, taken, internal))

    def receive(self, tick: int) -> None:
        """Filter what has arrived by this tick."""
        p = self._pole
        while self._waiting and self._waiting[0][0] <= tick:
            _, self.taken, internal = self._waiting.popleft()
            self.wrenches = [
                frozen(p * old + (1.0 - p) * new) for old, new in zip(self.wrenches, internal, strict=True)
            ]
