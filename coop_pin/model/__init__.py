"""Pinocchio models of arms, cells and mechanisms.

Importing this package imports Pinocchio and checks its version. Packages that use Pinocchio import it first,
so that a missing or unsuitable Pinocchio raises a helpful error.
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

from coop_pin.model.arm_model import ArmModel  # noqa: E402  after the check
from coop_pin.model.cell_arm import CellArm  # noqa: E402
from coop_pin.model.inverse_kinematics import ik_branches  # noqa: E402

__all__ = ["ArmModel", "CellArm", "ik_branches"]
__getattr__, __dir__ = lazy_names(__name__)
