"""Linkages in URDF for the tests of mechanisms, and what is known of their motion."""

import importlib.util
from pathlib import Path

import numpy as np
from scipy.special import ellipj, ellipk

import coop_pin as cp
from coop_pin.base.spatial import inverse_pose, make_pose, rpy_from_rotation

_EXAMPLE = importlib.util.spec_from_file_location(
    "four_bar", Path(__file__).parent.parent / "examples" / "four_bar.py"
)
four_bar = importlib.util.module_from_spec(_EXAMPLE)
_EXAMPLE.loader.exec_module(four_bar)

WIDE = '<limit lower="-1e6" upper="1e6" effort="0" velocity="0"/>'


def pendulum_angle(k, time):
    """Exact solution of theta'' = -k cos theta, theta(0) = pi/2, theta'(0) = -1, by elliptic functions."""
    m, rate = 4 * k / (1 + 4 * k), np.sqrt(1 + 4 * k) / 2
    return -2 * ellipj(rate * time - ellipk(m), m)[3] - np.pi / 2


def four_bar_tip(loops, time):
    theta = pendulum_angle(four_bar.GRAVITY * ((loops + 1) / 2 + loops) / ((loops + 1) / 3 + loops), time)
    return np.column_stack((np.cos(theta), np.sin(theta)))


def four_bar_error(loops, step, duration, **options):
    """How far the first tip ever is from the closed form, m."""
    chain = four_bar.four_bars(loops, **options)
    motion = chain.integrate(*four_bar.start(chain, loops), duration=duration, step=step)
    return np.linalg.norm(four_bar.first_tip(chain, motion) - four_bar_tip(loops, motion.time), axis=1).max()


def link(name, length=1.0, mass=1.0):
    """A slender bar along x, its inertia about x that of a rod 1 cm thick or so."""
    side = mass * length**2 / 12
    return f"""<link name="{name}"><inertial><origin xyz="{length / 2} 0 0"/><mass value="{mass}"/>
    <inertia ixx="{mass * 1e-4}" iyy="{side}" izz="{side}" ixy="0" ixz="0" iyz="0"/></inertial></link>"""


def joint(child, parent, xyz, rpy=(0, 0, 0), axis="0 0 1", kind="revolute", extra=""):
    xyz, rpy = (" ".join(repr(float(x)) for x in values) for values in (xyz, rpy))
    return f"""<joint name="{child}_pin" type="{kind}"><parent link="{parent}"/><child link="{child}"/>
    <origin xyz="{xyz}" rpy="{rpy}"/><axis xyz="{axis}"/>{WIDE}{extra}</joint>"""


def bar(name, parent, xyz, rpy=(0, 0, 0), axis="0 0 1", length=1.0, mass=1.0):
    return link(name, length, mass) + joint(name, parent, xyz, rpy, axis)


def robot(*parts):
    return '<robot name="linkage"><link name="ground"/>' + "".join(parts) + "</robot>"


A, ALPHA, BETA = 0.8, 0.5, 1.1
B = A * np.sin(BETA) / np.sin(ALPHA)


def bennett(rows, **options):
    """Bennett linkage: four skew hinges; it moves only because sin(alpha) / a = sin(beta) / b.

    With "full" rows the fourth hinge is a joint of the tree and a stub beyond it is welded to the world.
    """
    bars, closure = bennett_parts(rows)
    chain = cp.ClosedChain.from_urdf(robot(*bars), [closure], **options)
    return chain, bennett_start(chain)


def bennett_start(chain):
    return chain.assemble(np.array((1.0, 1.0, -1.0, 0.0))[: chain.model.nq], chain.velocity({"one_pin": 1.0}))


def bennett_parts(rows):
    """The bars of a Bennett linkage and the closure of its loop."""
    bars = [bar("one", "ground", (0, 0, 0), length=A), bar("two", "one", (A, 0, 0), (ALPHA, 0, 0), length=B)]
    bars.append(bar("three", "two", (B, 0, 0), (BETA, 0, 0), length=A))
    pivot, last, X_a = (
        inverse_pose(make_pose((B, 0, 0), (BETA, 0, 0))),
        "three",
        make_pose((A, 0, 0), (ALPHA, 0, 0)),
    )
    if rows == "full":
        bars.append(bar("stub", "three", (A, 0, 0), (ALPHA, 0, 0), length=0.1))
        last, X_a = "stub", None
    return bars, cp.Closure(last, "world", rows, X_a, pivot)


SARRUS_LEAN = 0.9


def sarrus(turn=1.9, **options):
    """Sarrus linkage: two folding legs in planes turned against each other; their plate moves straight.

    One leg carries the plate; the other hangs on it and its foot is hinged to the world.
    """
    y = "0 -1 0"
    bars = [bar("lower", "ground", (1, 0, 0), axis=y), bar("upper", "lower", (1, 0, 0), axis=y)]
    bars.append(bar("plate", "upper", (1, 0, 0), axis=y, length=-1.0, mass=2.0))
    hip = make_pose((-1, 0, 0), (0, 0, turn)) @ make_pose((1, 0, 0))
    bars += [
        bar("down", "plate", hip[:3, 3], rpy_from_rotation(hip[:3, :3]), axis=y),
        bar("foot", "down", (1, 0, 0), axis=y),
    ]
    hinge = make_pose((1, 0, 0), (np.pi / 2, 0, 0))  # z along the hinge
    closure = cp.Closure("foot", "world", "axis", X_AC=hinge, X_BC=make_pose((0, 0, 0), (0, 0, turn)) @ hinge)
    chain = cp.ClosedChain.from_urdf(robot(*bars), [closure], **options)
    lean = SARRUS_LEAN
    angles = {
        "lower_pin": lean,
        "upper_pin": np.pi - 2 * lean,
        "plate_pin": lean - np.pi,
        "down_pin": -lean,
        "foot_pin": 2 * lean - np.pi,
    }
    return chain, chain.configuration(angles)


def bead(rows, X_b, kind="prismatic", **options):
    """A bead that three slides let move anywhere, held to a frame in the world; it starts in the origin."""
    frames = ['<link name="a"/>', '<link name="b"/>', link("bead")]
    slides = [
        joint("a", "ground", (0, 0, 0), axis="1 0 0", kind=kind),
        joint("b", "a", (0, 0, 0), axis="0 1 0", kind=kind),
    ]
    slides.append(joint("bead", "b", (0, 0, 0), axis="0 0 1", kind=kind))
    return cp.ClosedChain.from_urdf(
        robot(*frames, *slides), [cp.Closure("universe", "bead", rows, X_AC=X_b)], **options
    )
