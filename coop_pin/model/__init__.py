"""Model: Pinocchio trees of arms, cells and mechanisms, and the inverse kinematics of an arm.

Open first: ``arm_model`` (mass matrix, dynamics, Jacobians of one arm), ``cell_model`` (the tree of all arms
and the payload), ``inverse_kinematics`` (solution nearest to a posture, branches; ``ik_solver`` iterates).

- ``pinocchio_model`` and ``mechanism_model``: trees from URDF, safe access to frames and joints.
- ``cell_arm``: an arm of a cell with grasp and load share. ``transmission``: drives, joints and friction.
- ``joint_limits``, ``joint_angles`` (continuous joints).
- ``visuals``, ``geometry``, ``meshes`` (files of several colours), ``shapes``: what is drawn.

Importing this package imports Pinocchio and checks its version. Packages that use Pinocchio import it first,
so that a missing or unsuitable Pinocchio raises a helpful error.

Imports ``base`` and ``description``.
"""

import importlib
import re
from types import ModuleType

from coop_pin import lazy_names
from coop_pin.base import errors

OLDEST, TOO_NEW = (4, 1), (5,)
"""Supported versions of Pinocchio: from the first up to, but not including, the second."""


def import_pinocchio() -> ModuleType:
    """Return the module pinocchio.

    Raises:
        MissingPinocchioError: it is not installed, does not load, has an unsupported version, or another
            package has its name.
    """
    try:
        module = importlib.import_module("pinocchio")
    except ImportError as error:
        missing = isinstance(error, ModuleNotFoundError) and error.name == "pinocchio"
        raise errors.MissingPinocchioError(
            "Pinocchio is not installed" if missing else f"Pinocchio does not load: {error}"
        ) from error
    if not hasattr(module, "buildModelFromXML"):
        raise errors.MissingPinocchioError(
            f"{module!r} is not Pinocchio; rename or remove it"
            " (on PyPI a plugin for nose has that name: pip uninstall pinocchio)"
        )
    major, minor, *_ = [*map(int, re.findall(r"\d+", module.__version__)), 0, 0]
    if not OLDEST <= (major, minor) < TOO_NEW:
        raise errors.MissingPinocchioError(
            f"Pinocchio {module.__version__} is installed; coop_pin needs 4.1 or later, before 5"
        )
    return module


import_pinocchio()

__all__, __getattr__, __dir__ = lazy_names(
    __name__,
    {
        "ArmModel": "model.arm_model",
        "CellArm": "model.cell_arm",
        "ik_branches": "model.inverse_kinematics",
    },
)
