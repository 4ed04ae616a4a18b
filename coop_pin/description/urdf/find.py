"""Search for URDF files: by path, among the bundled robots, and in example-robot-data."""

from __future__ import annotations

import functools
import importlib.util
import os
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Literal, Protocol

from coop_pin.base.arrays import require_path, typed
from coop_pin.base.errors import UrdfError, WrongTypeError, suggestion

_SHARE = Path("share", "example-robot-data", "robots")

_KNOWN_NAMES = {
    "anymal": "anymal_b_simple_description/robots/anymal.urdf",
    "anymal_c": "anymal_c_simple_description/urdf/anymal.urdf",
    "anymal_kinova": "anymal_b_simple_description/robots/anymal-kinova.urdf",
    "asr_twodof": "asr_twodof_description/urdf/TwoDofs.urdf",
    "b1_z1": "b1_description/urdf/b1-z1.urdf",
    "hector": "hector_description/robots/quadrotor_base.urdf",
    "hyq": "hyq_description/robots/hyq_no_sensors.urdf",
    "iris": "iris_description/robots/iris_simple.urdf",
    "solo8": "solo_description/robots/solo.urdf",
    "talos": "talos_data/robots/talos_reduced.urdf",
    "talos_arm": "talos_data/robots/talos_left_arm.urdf",
    "talos_box": "talos_data/robots/talos_reduced_box.urdf",
    "talos_full": "talos_data/robots/talos_full_v2.urdf",
    "talos_full_box": "talos_data/robots/talos_full_v2_box.urdf",
    "ur3": "ur_description/urdf/ur3_robot.urdf",
    "ur3_limited": "ur_description/urdf/ur3_joint_limited_robot.urdf",
    "ur5": "ur_description/urdf/ur5_robot.urdf",
    "ur5_limited": "ur_description/urdf/ur5_joint_limited_robot.urdf",
    "ur10": "ur_description/urdf/ur10_robot.urdf",
    "ur10_limited": "ur_description/urdf/ur10_joint_limited_robot.urdf",
}
"""Names used by the loaders of earlier versions whose files have another name."""

_PACKAGE_LEVELS = 4
"""Parent folders of a user's file that are searched for package://; ROS packages nest URDFs 1 or 2 deep."""

_SUFFIXES = (".urdf", ".xacro")


@functools.cache
def example_folder() -> Path | None:
    """Return the folder of example-robot-data, or None if not installed; Pinocchio is not imported.

    It is below pinocchio's prefixes (pip, conda, apt), or on the Python path.
    """
    spec = importlib.util.find_spec("pinocchio")
    prefixes = () if spec is None or spec.origin is None else Path(spec.origin).resolve().parents
    places = (*prefixes, *(Path(entry, "cmeel.prefix") for entry in sys.path))
    return next((folder / _SHARE for folder in places if (folder / _SHARE).is_dir()), None)


@functools.cache
def example_urdfs() -> MappingProxyType[str, Path]:
    """Return the path of every robot of example-robot-data, by known name and by name of its file."""
    folder = example_folder()
    if folder is None:
        return MappingProxyType({})
    # Sorted, so that of two files with one name the same one is chosen on every machine.
    by_file = {path.stem: path for path in sorted(folder.glob("*/*/*.urdf"), reverse=True)}
    known = {name: folder / path for name, path in _KNOWN_NAMES.items() if (folder / path).is_file()}
    return MappingProxyType(by_file | known)


class Carrier(Protocol):
    """What a robot stands on."""

    def under(self, urdf: str) -> str:
        """Return the text of a URDF with the carrier's links and joints before its root link."""
        ...


@dataclass(frozen=True)
class UrdfFile:
    """A URDF or xacro file that exists.

    Attributes:
        path: the file, absolute.
        package_dirs: folders that are searched for the packages of package:// and $(find ...), in this order.
        origin: "user" (found by path), "bundled" (part of coop_pin) or "example" (example-robot-data).
        xacro_args: name and value of the arguments with which a xacro file is expanded.
        carrier: base that the robot stands on; it is added to the text of the file.
        locked: name and position (rad or m) of the joints that a cell locks.
        repairs: whether impossible inertias of moved links are repaired.
    """

    path: Path
    package_dirs: tuple[Path, ...]
    origin: Literal["user", "bundled", "example"] = "user"
    xacro_args: tuple[tuple[str, str], ...] = ()
    carrier: Carrier | None = None
    locked: tuple[tuple[str, float], ...] = ()
    repairs: bool = False


@functools.cache
def bundled_urdf_folder() -> Path:
    """Return the folder of the bundled robots: inside the package of a wheel, at the top of a checkout."""
    package = Path(__file__).resolve().parents[2]
    installed = package / "urdf"
    return installed if installed.is_dir() else package.parent / "urdf"


@functools.cache
def robot_files() -> MappingProxyType[str, Path]:
    """Return the file of every bundled robot and every robot of example-robot-data, by name."""
    bundled = {path.stem: path for path in bundled_urdf_folder().glob("*.urdf")}
    return MappingProxyType(example_urdfs() | bundled)


@typed
def find_urdf(
    name_or_path: str | Path,
    *,
    package_dirs: Iterable[str] = (),
    xacro_args: Mapping[str, str] = MappingProxyType({}),
) -> UrdfFile:
    """Return the URDF with a path or name.

    A path relative to the working directory comes first, then a name among the bundled robots
    ("adept_3dof"), then a name among those of example-robot-data ("panda", "ur5").

    Args:
        name_or_path: path of a file, or name of a robot.
        package_dirs: folders that are searched first for packages.
        xacro_args: arguments of a xacro file.

    Raises:
        UrdfError: there is none; the message lists the places searched and the closest names.
        WrongTypeError: package_dirs is no list of folders.
    """
    if isinstance(package_dirs, str):
        raise WrongTypeError("package_dirs", "str", "list of folders")
    folders = tuple(package_dirs)
    for folder in folders:
        require_path("package_dirs", folder)
    cwd, name = Path.cwd(), str(name_or_path)
    file, robots = os.path.join(cwd, name), robot_files()  # noqa: PTH118
    path = file if os.path.isfile(file) else robots.get(name)  # noqa: PTH113 - Path takes ten times as long
    if path is None:
        raise UrdfError(_unknown_text(name, cwd / name, sorted(robots)))
    resolved = os.path.realpath(path) if path is file else path
    return _located(resolved, folders, tuple(sorted(xacro_args.items())), cwd)


@functools.lru_cache(maxsize=256)
def _located(
    file: str | Path, package_dirs: tuple[str, ...], xacro_args: tuple[tuple[str, str], ...], cwd: Path
) -> UrdfFile:
    """Return the file at a path; folders are relative to the working directory."""
    folders, path = [cwd / folder for folder in package_dirs], Path(file).resolve()
    origin: Literal["user", "bundled", "example"] = "user"
    examples, bundled = example_folder(), bundled_urdf_folder()
    if examples is not None and path.is_relative_to(examples.resolve()):
        # Meshes are named package://example-robot-data/robots/...; a few files use their own folder as the
        # package.
        origin, folders = "example", [*folders, examples.parents[1], examples]
    elif path.is_relative_to(bundled):
        origin, folders = "bundled", [*folders, bundled]
    else:
        folders += path.parents[:_PACKAGE_LEVELS]
    return UrdfFile(path, tuple(folders), origin, xacro_args)


def _unknown_text(name: str, file: Path, robots: Sequence[str]) -> str:
    """Return the message for a path or name without a URDF."""
    is_name = len(Path(name).parts) <= 1
    if is_name and Path(name).suffix not in _SUFFIXES:
        places = f"{Path.cwd()}, the robots of coop_pin ({bundled_urdf_folder()}) or example-robot-data"
        folder = example_folder() or "not installed"
        return f"no URDF {name!r} in {places} ({folder}); {suggestion(name, robots)}"
    path = Path(os.path.normpath(file))
    if os.path.isdir(path):  # noqa: PTH112 - Path.is_dir raises where a name is too long
        return f"{path} is a folder; name the URDF or xacro file in it"
    files = path.parent.iterdir() if os.path.isdir(path.parent) else ()  # noqa: PTH112
    known = [*sorted(file.name for file in files if file.suffix in _SUFFIXES), *(robots if is_name else ())]
    hint = suggestion(path.name, known) if known else "its folder has no URDF or xacro file"
    return f"there is no file {path}; {hint}"
