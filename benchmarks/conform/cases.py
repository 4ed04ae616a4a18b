"""Twelve cases whose internal force and moment have a closed form, each in a plane and in space.

Hands are rigid bodies on guides: axes x, y, z, rx, ry, rz of the world, in this order, with the tip at their
origin, which is their centre of mass. Drive i gives the forces along its axes

    tau = u - K (q - q_0) - D v

and q = 0 at the start. The payload starts at the origin, its axes those of the world; in a plane that is x-y,
with gravity along -y, in space gravity is along -z. What is asked for is the wrench of each hand on the
payload about P, its centre of mass, in payload axes. In all cases it is the same at all times, but for those
that must come to rest.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

AXES = ("x", "y", "z", "rx", "ry", "rz")
PLANAR = (0, 1, 5)
G = 9.81
_A = 0.25
"""Distance of the tips from P, m."""
_MASS, _INERTIA = 5.0, (0.05, 0.12, 0.15)
_HAND, _HAND_INERTIA = 2.0, (0.02, 0.03, 0.04)
_NONE = (0.0,) * 6


@dataclass(frozen=True, kw_only=True)
class Hand:
    """A hand on guides, and its grasp.

    Attributes:
        tip: position of the tip in payload axes, m.
        rpy: roll, pitch, yaw of the grasp frame in payload axes, rad.
        drive: u, along the guides, N and N m.
        mass: mass, kg.
        inertia: principal moments about the tip along world axes at the start, kg m^2.
        guides: numbers of the axes along which it moves, of AXES.
        grasp: "rigid", "hinge" about the z axis of the grasp frame, or "spring".
        anchor: q_0, m and rad.
        stiffness: diagonal of K.
        damping: diagonal of D.
        spring: stiffness of the grasp, along axes of the grasp frame, N/m and N m/rad.
        damper: damping of the grasp.
    """

    tip: Any
    rpy: Any = (0.0, 0.0, 0.0)
    drive: Any = _NONE
    mass: float = _HAND
    inertia: Any = _HAND_INERTIA
    guides: tuple[int, ...] = (0, 1, 2, 3, 4, 5)
    grasp: str = "rigid"
    anchor: Any = _NONE
    stiffness: Any = _NONE
    damping: Any = _NONE
    spring: Any = _NONE
    damper: Any = _NONE

    def force(self, q: Any, v: Any) -> np.ndarray:
        """Return the forces along the guides at their positions and rates, shape (n,)."""
        u, q_0, K, D = (
            np.array(each)[[*self.guides]] for each in (self.drive, self.anchor, self.stiffness, self.damping)
        )
        return u - K * (np.asarray(q) - q_0) - D * np.asarray(v)

    @property
    def rotation(self) -> np.ndarray:
        """Axes of the grasp frame in payload axes, shape (3, 3)."""
        return Rotation.from_euler("xyz", self.rpy).as_matrix()

    @property
    def pose(self) -> np.ndarray:
        """X_PE, shape (4, 4)."""
        X = np.eye(4)
        X[:3, :3], X[:3, 3] = self.rotation, self.tip
        return X


@dataclass(frozen=True, kw_only=True)
class Case:
    """A case.

    Attributes:
        name: name, the same in a plane and in space.
        hands: the hands.
        wrenches: wrench of each hand on the payload by the closed form, shape (m, 6).
        mass: mass of the payload, kg.
        inertia: its principal moments along its axes, kg m^2.
        gravity: gravitational acceleration, m/s^2.
        spin: rate about z at the start, rad/s.
        time: time at which wrenches are read, s.
        compared: numbers of the rows that the closure determines.
        is_planar: whether all moves in the x-y plane.
    """

    name: str
    hands: tuple[Hand, ...]
    wrenches: np.ndarray
    mass: float = _MASS
    inertia: Any = _INERTIA
    gravity: Any = (0.0, 0.0, 0.0)
    spin: float = 0.0
    time: float = 0.1
    compared: tuple[int, ...]
    is_planar: bool

    @property
    def label(self) -> str:
        """Name with the space."""
        return f"{self.name}, {'planar' if self.is_planar else 'spatial'}"

    def start_rates(self, hand: Hand) -> np.ndarray:
        """Return the rates along the guides of a hand at the start, shape (n,)."""
        twist = np.zeros(6)
        twist[:3], twist[5] = np.cross((0.0, 0.0, self.spin), hand.tip), self.spin
        return twist[[*hand.guides]]

    def errors(self, wrenches: Any) -> tuple[float, float]:
        """Return the errors of internal force and moment, as parts of the largest force and moment.

        The internal wrench is f_i = F_i - sum_j F_j / m. Where no moment is expected, the scale is that of a
        force at the distance of the tips.
        """
        inner = [each - each.mean(axis=0) for each in (np.asarray(wrenches, float), self.wrenches)]
        apart, parts = np.abs(inner[0] - inner[1]), []
        force = max(np.abs(self.wrenches[:, :3]).max(), np.abs([h.drive for h in self.hands])[:, :3].max())
        moment = np.abs(inner[1][:, 3:]).max()
        for rows, scale in ((range(3), force), (range(3, 6), moment if moment > 1e-9 else _A * force)):
            parts.append(apart[:, [row for row in rows if row in self.compared]].max(initial=0.0) / scale)
        return parts[0], parts[1]


@dataclass(frozen=True)
class _Space:
    """A plane or space: what differs in the cases."""

    is_planar: bool

    @property
    def up(self) -> np.ndarray:
        return np.array((0.0, 1.0, 0.0) if self.is_planar else (0.0, 0.0, 1.0))

    @property
    def rows(self) -> tuple[int, ...]:
        return PLANAR if self.is_planar else tuple(range(6))

    def moment(self, x: float, y: float, z: float) -> np.ndarray:
        """A moment, in a plane its part about z."""
        return np.array((0.0, 0.0, z) if self.is_planar else (x, y, z))

    def turned(self, number: int) -> tuple[float, float, float]:
        """Roll, pitch, yaw of a grasp frame."""
        yaw = (0.3, 2.9)[number]
        return (0.0, 0.0, yaw) if self.is_planar else ((0.4, -0.7)[number], (-0.5, 0.6)[number], yaw)

    def hand(self, number: int, **fields: Any) -> Hand:
        """A hand of this space."""
        tip = fields.pop("tip", ((-_A, 0.0, 0.0), (_A, 0.0, 0.0))[number])
        return Hand(**{"tip": tip, "rpy": self.turned(number), "guides": self.rows} | fields)

    def case(self, name: str, hands: Any, wrenches: Any, **fields: Any) -> Case:
        """A case of this space."""
        rows = {"compared": self.rows, "is_planar": self.is_planar} | fields
        return Case(name=name, hands=tuple(hands), wrenches=np.array(wrenches, float), **rows)

    @property
    def gravity(self) -> np.ndarray:
        return -G * self.up


def _about_P(tip: Any, f: Any, m: Any = (0.0, 0.0, 0.0)) -> np.ndarray:
    """A force f and a moment m at a tip, as a wrench about P."""
    return np.concatenate((f, np.add(m, np.cross(tip, f))))


def static_squeeze(space: _Space) -> Case:
    """At rest, without gravity: F_1 = -F_2 = u_1."""
    u = np.concatenate(((10.0, 0.0, 0.0), space.moment(0.5, -0.3, 0.2)))
    return space.case("static squeeze", [space.hand(0, drive=u), space.hand(1, drive=-u)], [u, -u])


def weight_shares(space: _Space) -> Case:
    """At rest: f_i = s_i m g upwards; the first hand bears the moment of both."""
    hands, forces, tips = [], [], np.array(((-_A, 0.0, 0.0), (_A, 0.0, 0.0)))
    for share in (0.7, 0.3):
        forces.append(share * _MASS * G * space.up)
    m = -sum(np.cross(tip, f) for tip, f in zip(tips, forces, strict=True))
    for number, moment in enumerate((m, np.zeros(3))):
        u = np.concatenate((forces[number] + _HAND * G * space.up, moment))
        hands.append(space.hand(number, drive=u))
    wrenches = [_about_P(tips[0], forces[0], m), _about_P(tips[1], forces[1])]
    return space.case("weight shares", hands, wrenches, gravity=space.gravity)


_K = np.array((2e3, 2e3, 2e3, 50.0, 50.0, 50.0))
_D = np.array((190.0, 190.0, 190.0, 3.0, 3.0, 3.0))
_BIAS, _TURN = 1e-3, 2e-3


def bias_spring(space: _Space) -> Case:
    """At rest between two springs, one anchored d apart: f = d / (1/k_1 + 1/k_2)."""
    u = np.array((0.0, 0.0, 0.0, 0.0, 0.0, 0.3)) * space.is_planar
    anchor = (-_BIAS, 0.0, 0.0, 0.0 if space.is_planar else _TURN, 0.0, 0.0)
    hands = [
        space.hand(0, drive=u, anchor=anchor, stiffness=_K, damping=_D),
        space.hand(1, drive=-u, stiffness=3.0 * _K, damping=_D),
    ]
    series = 1.0 / (1.0 / _K + 1.0 / (3.0 * _K))
    w = u + series * np.array(anchor)
    return space.case("bias spring", hands, [w, -w], time=3.0)


def spinning_payload(space: _Space) -> Case:
    """Free spin at rate omega about z: the payload pulls on each hand with m_i omega^2 r_i."""
    omega, height = 3.0, 0.0 if space.is_planar else 0.1
    tips = np.array(((-_A, 0.0, height), (_A, 0.0, height)))
    u = np.array((0.0, 0.0, 0.0, 0.0, 0.0, 0.3))
    hands, wrenches = [], []
    for number, sign in enumerate((1.0, -1.0)):
        f = _HAND * omega**2 * tips[number] * (1.0, 1.0, 0.0)
        hands.append(space.hand(number, tip=tuple(tips[number]), drive=sign * u))
        wrenches.append(_about_P(tips[number], f, sign * u[3:]))
    return space.case("spinning payload", hands, wrenches, spin=omega)


def unequal_arms(space: _Space) -> Case:
    """One hand drives, in space it turns as well: a = u / sum m, F_i = u_i - m_i a."""
    M = 0.0 if space.is_planar else 0.6
    u, twist = np.array((12.0, 0.0, 0.0, M, 0.0, 0.0)), np.array((0.0, 0.0, 0.0, 0.0, 0.0, 0.3))
    twist *= space.is_planar
    heavy = {"mass": 2.0 * _HAND, "inertia": tuple(4.0 * np.array(_HAND_INERTIA))}
    a = 12.0 / (3.0 * _HAND + _MASS)
    alpha = M / (5.0 * _HAND_INERTIA[0] + _INERTIA[0])
    w_1 = np.array((12.0 - _HAND * a, 0.0, 0.0, M - _HAND_INERTIA[0] * alpha, 0.0, 0.0)) + twist
    w_2 = np.array((-2.0 * _HAND * a, 0.0, 0.0, -4.0 * _HAND_INERTIA[0] * alpha, 0.0, 0.0)) - twist
    hands = [space.hand(0, drive=u + twist), space.hand(1, drive=-twist, **heavy)]
    return space.case("unequal arms", hands, [w_1, w_2])


def redundant_rows(space: _Space) -> Case:
    """Hands that only slide along x, in space turn about it too: welds with more rows than rank, gravity.

    Of what the welds bear, only force and moment along the line are determined: F_1 = u_1 - m_1 a.
    """
    guides, M = ((0,), 0.0) if space.is_planar else ((0, 3), 0.5)
    u_1, u_2 = np.array((16.0, 0.0, 0.0, M, 0.0, 0.0)), np.array((-8.0, 0.0, 0.0, -M, 0.0, 0.0))
    inertia = np.array((_HAND, 0.0, 0.0, 0.0, 0.0, 0.0)) * 8.0 / (2.0 * _HAND + _MASS)
    hands = [space.hand(number, drive=u, guides=guides) for number, u in enumerate((u_1, u_2))]
    fields = {"compared": guides, "gravity": space.gravity}
    return space.case("redundant rows", hands, [u_1 - inertia, u_2 - inertia], **fields)


def off_centre_grasps(space: _Space) -> Case:
    """At rest, tips off the centre of mass: a squeeze along their line, weight 0.6 to 0.4."""
    flat = (1.0, 1.0, 0.0 if space.is_planar else 1.0)
    tips = np.array(((-0.3, 0.1, 0.05), (0.25, -0.08, 0.12))) * flat
    line = (tips[1] - tips[0]) / np.linalg.norm(tips[1] - tips[0])
    f = [10.0 * sign * line + share * _MASS * G * space.up for sign, share in ((1.0, 0.6), (-1.0, 0.4))]
    m = -(np.cross(tips[0], f[0]) + np.cross(tips[1], f[1]))
    hands = [
        space.hand(i, tip=tuple(tips[i]), drive=np.concatenate((f[i] + _HAND * G * space.up, moment)))
        for i, moment in enumerate((m, np.zeros(3)))
    ]
    wrenches = [_about_P(tips[0], f[0], m), _about_P(tips[1], f[1])]
    return space.case("off-centre grasps", hands, wrenches, gravity=space.gravity)


_SPRING = (8e3, 8e3, 8e3, 800.0, 800.0, 800.0)
_DAMPER = (120.0, 120.0, 120.0, 4.0, 4.0, 4.0)


def compliant_grasp(space: _Space) -> Case:
    """At rest between two springs, a third one in the second grasp: f = d / (1/k_1 + 1/k_g + 1/k_2).

    The second hand is turned against its own spring and that of the grasp, m_2 = u_2 k_g / (k_g + k_2), and
    the first one is driven with as much, so that the payload does not turn.
    """
    u = np.concatenate((np.zeros(3), space.moment(0.2, 0.0, 0.3) * (1.0, 1.0, float(space.is_planar))))
    anchor = (-_BIAS, 0.0, 0.0, 0.0, 0.0, 0.0)
    held = u * np.array(_SPRING) / (np.array(_SPRING) + _K)
    springs = {"stiffness": _K, "damping": _D}
    hands = [
        space.hand(0, drive=held, anchor=anchor, **springs),
        space.hand(1, drive=-u, grasp="spring", spring=_SPRING, damper=_DAMPER, **springs),
    ]
    w = held + np.array(anchor) / (2.0 / _K + 1.0 / np.array(_SPRING))
    return space.case("compliant grasp", hands, [w, -w], time=3.0)


def hinge_rows(space: _Space) -> Case:
    """A hinge about z bears no moment about itself: that of the drive only spins the hand."""
    tips = np.array(((-_A, 0.1, 0.0), (_A, 0.1, 0.0)))
    f, m = np.array((10.0, 0.0, 0.0)), space.moment(0.3, -0.2, 0.0)
    spun = np.array((0.0, 0.0, 0.0, 0.0, 0.0, 0.05))
    u = np.concatenate((f, m))
    hands = [
        space.hand(0, tip=tuple(tips[0]), drive=u),
        space.hand(1, tip=tuple(tips[1]), rpy=(0.0, 0.0, 0.8), drive=spun - u, grasp="hinge"),
    ]
    return space.case("hinge rows", hands, [_about_P(tips[0], f, m), _about_P(tips[1], -f, -m)])


def hanging_load(space: _Space) -> Case:
    """At rest below two hinges, each with half of the weight, one pulled towards the other."""
    tips = np.array((-_A, 0.0, 0.0)) + 0.2 * space.up, np.array((_A, 0.0, 0.0)) + 0.2 * space.up
    axis = np.cross((1.0, 0.0, 0.0), space.up)  # z in a plane, -y in space
    rpy = (0.0, 0.0, 0.5) if space.is_planar else (0.5 * np.pi, 0.0, 0.0)
    hands, wrenches = [], []
    for number, sign in enumerate((1.0, -1.0)):
        f = np.array((6.0 * sign, 0.0, 0.0)) + 0.5 * _MASS * G * space.up
        u = np.concatenate((f + _HAND * G * space.up, 0.02 * sign * axis))
        hands.append(space.hand(number, tip=tuple(tips[number]), rpy=rpy, drive=u, grasp="hinge"))
        wrenches.append(_about_P(tips[number], f))
    return space.case("hanging load at two hinges", hands, wrenches, gravity=space.gravity)


def free_fall(space: _Space) -> Case:
    """All falls, squeezed: no weight is in any grasp."""
    u = np.concatenate(((10.0, 0.0, 0.0), space.moment(0.4, 0.1, -0.2)))
    hands = [space.hand(0, drive=u), space.hand(1, drive=-u)]
    return space.case("free fall", hands, [u, -u], gravity=space.gravity)


def half_mass(space: _Space) -> Case:
    """Drives carry twice the payload's mass m: a = g m / (m + sum m_i) upwards, f_i = m (g + a) / 2."""
    m, tips = 0.5 * _MASS, np.array(((-_A, 0.0, 0.0), (_A, 0.0, 0.0)))
    a = G * m / (m + 2.0 * _HAND)
    hands, wrenches = [], []
    for number, sign in enumerate((1.0, -1.0)):
        squeeze = np.array((10.0 * sign, 0.0, 0.0))
        u = np.concatenate((squeeze + (m + _HAND) * G * space.up, np.zeros(3)))
        hands.append(space.hand(number, drive=u))
        wrenches.append(_about_P(tips[number], squeeze + 0.5 * m * (G + a) * space.up))
    fields = {"mass": m, "inertia": tuple(0.5 * np.array(_INERTIA)), "gravity": space.gravity}
    return space.case("payload of half mass", hands, wrenches, **fields)


CASES: tuple[Callable[[_Space], Case], ...] = (
    static_squeeze,
    weight_shares,
    bias_spring,
    spinning_payload,
    unequal_arms,
    redundant_rows,
    off_centre_grasps,
    compliant_grasp,
    hinge_rows,
    hanging_load,
    free_fall,
    half_mass,
)
"""The twelve, as functions of the space."""


def all_cases() -> list[Case]:
    """Return every case in a plane and in space."""
    return [case(_Space(is_planar)) for case in CASES for is_planar in (True, False)]
