"""What an engine is to the cases, and the URDF of their hands."""

from __future__ import annotations

import importlib
import importlib.util
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import numpy as np
from cases import AXES, Case, Hand
from scipy.spatial.transform import Rotation

HERE = Path(__file__).parent / "engines"


class Engine(Protocol):
    """An engine: one file of at most 80 lines, with one class, made without arguments.

    An import that fails as it is made says that the engine is not installed.

    Attributes:
        name: head of its column, with the version.
        settings: step, integrator, solver and stabilisation.
        reading: how the wrench of a grasp is read.
    """

    name: str
    settings: str
    reading: str

    def wrenches(self, case: Case) -> Any:
        """Return the wrench of each hand on the payload about P in payload axes at ``case.time``, (m, 6).

        Raises:
            RefusedError: the engine cannot have the case.
        """


class RefusedError(Exception):
    """The engine cannot have a case; the text says why."""


def load_engines(text: str) -> list[type[Engine]]:
    """Return the class named "module:Class", or those of a file that have ``reading``."""
    if not text.endswith(".py"):
        module, _, name = text.partition(":")
        return [getattr(importlib.import_module(module), name)]
    specification = importlib.util.spec_from_file_location(f"engine_{Path(text).stem}", text)
    loaded = importlib.util.module_from_spec(specification)
    sys.modules[specification.name] = loaded  # classes are found again by their modules
    specification.loader.exec_module(loaded)
    return [
        each
        for each in vars(loaded).values()
        if isinstance(each, type) and each.__module__ == loaded.__name__ and hasattr(each, "reading")
    ]


def engine_files(folder: Path = HERE) -> list[str]:
    """Return the files of a folder."""
    return [str(file) for file in sorted(folder.glob("*.py"))]


def numbers(values: Any) -> str:
    """Return numbers as text."""
    return " ".join(repr(float(value)) for value in np.ravel(values))


def body(name: str, mass: float, inertia: Sequence[float]) -> str:
    """Return a link with its centre of mass at its origin."""
    moments = " ".join(
        f'i{axis}{axis}="{float(value)!r}"' for axis, value in zip("xyz", inertia, strict=True)
    )
    return (
        f'<link name="{name}"><inertial><mass value="{float(mass)!r}"/>'
        f'<inertia {moments} ixy="0" ixz="0" iyz="0"/></inertial></link>'
    )


def guided(name: str, mass: float, inertia: Any, guides: Sequence[int], origin: Any) -> str:
    """Return links and joints of a body on guides, from link "ground"; joint NAME_x for axis x, and so on."""
    text, parent = "", "ground"
    for place, axis in enumerate(guides):
        is_last = place == len(guides) - 1
        link = name if is_last else f"{name}_{AXES[axis]}_link"
        text += body(name, mass, inertia) if is_last else f'<link name="{link}"/>'
        along = numbers(np.eye(3)[axis % 3])
        kind = "prismatic" if axis < 3 else "revolute"
        text += (
            f'<joint name="{name}_{AXES[axis]}" type="{kind}"><parent link="{parent}"/><child link="{link}"/>'
            f'<origin xyz="{numbers(np.zeros(3) if place else origin)}"/><axis xyz="{along}"/>'
            '<limit lower="-9" upper="9" effort="1e4" velocity="1e3"/></joint>'
        )
        parent = link
    return text


def hand_urdf(hand: Hand, name: str, origin: Any = (0.0, 0.0, 0.0)) -> str:
    """Return a hand on its guides with its tip, link NAME_tip, in the axes of the grasp frame."""
    rpy = f'<origin rpy="{numbers(hand.rpy)}"/>'
    tip = f'<link name="{name}_tip"/><joint name="{name}_end" type="fixed"><parent link="{name}"/>'
    tip += f'<child link="{name}_tip"/>{rpy}</joint>'
    return guided(name, hand.mass, hand.inertia, hand.guides, origin) + tip


def about_P(hand: Hand, f: np.ndarray, m: np.ndarray) -> np.ndarray:
    """Return force and moment at a tip, in axes of the grasp frame, as a wrench about P, shape (6,)."""
    f, m = hand.rotation @ f, hand.rotation @ m
    return np.concatenate((f, m + np.cross(hand.tip, f)))


def load(case: Case, R_P: np.ndarray, twist: np.ndarray, acceleration: np.ndarray) -> np.ndarray:
    """Return the wrench that moves the payload against gravity, about P in its axes, shape (6,).

    Args:
        case: case.
        R_P: axes of the payload, shape (3, 3).
        twist: twist at P in world axes, shape (6,).
        acceleration: its time derivative, shape (6,).
    """
    w, inertia = R_P.T @ twist[3:], np.diag(case.inertia)
    moment = inertia @ (R_P.T @ acceleration[3:]) + np.cross(w, inertia @ w)
    return np.concatenate((case.mass * (R_P.T @ (acceleration[:3] - np.array(case.gravity))), moment))


def robot(*parts: str) -> str:
    """Return the URDF of parts on link "ground"."""
    return f'<robot name="case"><link name="ground"/>{"".join(parts)}</robot>'


def hands_urdf(case: Case) -> str:
    """Return all hands, hand0, hand1, ... with their tips at their grasps."""
    return robot(*(hand_urdf(hand, f"hand{k}", hand.tip) for k, hand in enumerate(case.hands)))


def cell_urdf(case: Case) -> str:
    """Return all hands, and the payload on six guides."""
    payload = guided("payload", case.mass, case.inertia, range(6), (0.0, 0.0, 0.0))
    return hands_urdf(case).replace("</robot>", f"{payload}</robot>")


def joints(hand: Hand, name: str) -> list[str]:
    """Return the names of the joints of a hand."""
    return [f"{name}_{AXES[axis]}" for axis in hand.guides]


def start(case: Case) -> dict[str, float]:
    """Return the rate of every joint of ``cell_urdf`` at the start; all positions are zero."""
    rates = {"payload_rz": case.spin}
    for k, hand in enumerate(case.hands):
        rates |= zip(joints(hand, f"hand{k}"), case.start_rates(hand), strict=True)
    return rates


class Sprung(NamedTuple):
    """Wrenches of a compliant grasp, in world axes.

    Attributes:
        on_tip: on the hand about its tip, shape (6,).
        on_payload: on the payload about P, shape (6,).
    """

    on_tip: np.ndarray
    on_payload: np.ndarray


def spring(hand: Hand, tip: Sequence[Any], payload: Sequence[Any]) -> Sprung:
    """Return the wrenches of a compliant grasp, for engines without springs of six rows.

    With the displacement p of the tip from the grasp frame, its rotation vector r and its relative twist V,
    in axes of the grasp frame, the wrench on the hand is -K [p, r] - D V.

    Args:
        hand: hand of the grasp.
        tip: position, rotation and twist of the tip in world axes: shapes (3,), (3, 3), (6,).
        payload: the same of the payload at P.
    """
    (p_E, R_E, V_E), (p_P, R_P, V_P) = tip, payload
    R_G, arm = R_P @ hand.rotation, p_E - p_P
    turned = Rotation.from_matrix(R_G.T @ R_E).as_rotvec()
    gap = np.concatenate((R_G.T @ (arm - R_P @ hand.tip), turned))
    V = V_E - V_P
    V[:3] -= np.cross(V_P[3:], arm)
    to_grasp = np.kron(np.eye(2), R_G.T)
    F = -to_grasp.T @ (np.array(hand.spring) * gap + np.array(hand.damper) * (to_grasp @ V))
    return Sprung(F, -np.concatenate((F[:3], F[3:] + np.cross(arm, F[:3]))))


def in_payload_axes(F: np.ndarray, R_P: np.ndarray) -> np.ndarray:
    """Return wrenches in world axes in payload axes, shape (..., 6)."""
    return F @ np.kron(np.eye(2), R_P)
