"""Finding a URDF: a path, a robot that comes with coop_pin, or one of example-robot-data."""

from __future__ import annotations

import functools
import importlib.util
import os
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import Literal

from coop_pin.errors import UrdfError, suggestion

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
"""Names that the loaders of earlier versions made known, where the file is called otherwise."""


@functools.cache
def example_folder() -> Path | None:
    """Return the folder of the robots, or None where example-robot-data is not installed; Pinocchio is not imported."""
    return next((folder for folder in _candidates() if folder.is_dir()), None)


def _candidates() -> Iterator[Path]:
    """Yield where the folder may be: under a prefix that holds pinocchio (pip's cmeel, conda, apt), or on the path by itself."""
    spec = importlib.util.find_spec("pinocchio")
    if spec is not None and spec.origin is not None:
        yield from (prefix / _SHARE for prefix in Path(spec.origin).resolve().parents)
    yield from (Path(entry, "cmeel.prefix") / _SHARE for entry in sys.path)


@functools.cache
def example_urdfs() -> MappingProxyType[str, Path]:
    """Return the path of every robot of example-robot-data by name: its known name and the name of its file."""
    folder = example_folder()
    if folder is None:
        return MappingProxyType({})
    # Sorted, so that of two files with one name the same one wins everywhere.
    by_file = {path.stem: path for path in sorted(folder.glob("*/*/*.urdf"), reverse=True)}
    known = {name: folder / path for name, path in _KNOWN_NAMES.items() if (folder / path).is_file()}
    return MappingProxyType(by_file | known)


def example_srdf(urdf: Path) -> Path | None:
    """Return the SRDF (postures) that belongs to an example robot, or None: the one of its name, else its folder's only one."""
    files = sorted((urdf.parent.parent / "srdf").glob("*.srdf"))
    names = (urdf.stem, urdf.stem.removesuffix("_robot"))
    named = [path for path in files if path.stem in names]
    if named:
        return named[0]
    return files[0] if len(files) == 1 else None


_PACKAGE_LEVELS = 4
"""Folders above a user's file in which package:// is looked for: a ROS package keeps its URDF one or two levels down."""


_SUFFIXES = (".urdf", ".xacro")


@dataclass(frozen=True)
class UrdfFile:
    """A URDF that exists.

    Attributes:
        path: the file, absolute.
        package_dirs: folders in which the packages of its package:// meshes are looked for, in this order.
        srdf: its SRDF (postures), where one is known.
        origin: "user" (found as a path), "bundled" (comes with coop_pin) or "example" (example-robot-data).
        xacro_args: name and value of the arguments that a xacro file is expanded with.
    """

    path: Path
    package_dirs: tuple[Path, ...]
    srdf: Path | None = None
    origin: Literal["user", "bundled", "example"] = "user"
    xacro_args: tuple[tuple[str, str], ...] = ()

    @property
    def is_xacro(self) -> bool:
        """Whether the file must be expanded before it is a URDF."""
        return self.path.suffix == ".xacro"

    def given(self, package_dirs: Iterable[str], xacro_args: Mapping[str, str]) -> UrdfFile:
        """Return the same file with folders to look in first, and with xacro arguments."""
        folders = (*(Path(folder).absolute() for folder in package_dirs), *self.package_dirs)
        return replace(self, package_dirs=folders, xacro_args=tuple(sorted(xacro_args.items())))


def bundled_urdf_folder() -> Path:
    """Return the folder of the robots that come with coop_pin: in the package of a wheel, at the top of a checkout."""
    package = Path(__file__).resolve().parents[2]
    installed = package / "urdf"
    return installed if installed.is_dir() else package.parent / "urdf"


def find_urdf(name_or_path: str | Path, relative_to: Path | None = None) -> UrdfFile:
    """Return the URDF of a path or name.

    A path is looked for beside ``relative_to``, then in the working directory; then a name among the bundled
    robots ("adept_3dof"), then among those of example-robot-data ("panda", "ur5").

    Args:
        name_or_path: path of a file, or name of a robot.
        relative_to: folder to which a path is relative, for example that of the scenario's file.

    Raises:
        UrdfError: there is none; the message says where it was looked for and which names are close.
    """
    folders = tuple(dict.fromkeys((relative_to or Path.cwd(), Path.cwd())))
    for folder in folders:
        path = folder / name_or_path  # an absolute path stays itself
        if _is(Path.is_file, path):
            return _described(path.resolve())
    name = str(name_or_path)
    bundled = {path.stem: path for path in sorted(bundled_urdf_folder().glob("*.urdf"))}
    found = bundled.get(name) or example_urdfs().get(name)
    if found is not None:
        return _described(found.resolve())
    robots = sorted({*bundled, *example_urdfs()})
    parts = Path(name).parts
    if len(parts) > 1 or Path(name).suffix in _SUFFIXES:
        raise UrdfError(
            _no_file(name, [folder / name for folder in folders], robots if len(parts) == 1 else [])
        )
    places = [*map(str, folders), f"the robots of coop_pin ({bundled_urdf_folder()})"]
    places.append(f"example-robot-data ({example_folder() or 'not installed'})")
    raise UrdfError(f"no URDF {name!r} in {', '.join(places)}; {suggestion(name, robots)}")


def _no_file(name: str, paths: Iterable[Path], robots: list[str]) -> str:
    """Say that a path leads to no file, and which robot files stand where it leads."""
    looked = list(dict.fromkeys(Path(os.path.normpath(path)) for path in paths))
    for path in looked:
        if _is(Path.is_dir, path):
            return f"{path} is a folder; name the URDF or xacro file in it"
    folders = [path.parent for path in looked if _is(Path.is_dir, path.parent)]
    beside = sorted(
        {file.name for folder in folders for suffix in _SUFFIXES for file in folder.glob(f"*{suffix}")}
    )
    hint = (
        suggestion(Path(name).name, [*beside, *robots])
        if beside or robots
        else "no URDF or xacro file stands there"
    )
    return f"there is no file {' or '.join(map(str, looked))}; {hint}"


def _described(path: Path) -> UrdfFile:
    """Return a file with what its place says about it."""
    examples = example_folder()
    if examples is not None and path.is_relative_to(examples.resolve()):
        # Meshes are named package://example-robot-data/robots/...; a few files name their own folder as the
        # package.
        return UrdfFile(path, (examples.parents[1], examples), example_srdf(path), "example")
    bundled = bundled_urdf_folder()
    if path.is_relative_to(bundled):
        return UrdfFile(path, (bundled,), origin="bundled")
    return UrdfFile(path, tuple(path.parents[:_PACKAGE_LEVELS]))


def _is(kind: Callable[[Path], bool], path: Path) -> bool:
    try:
        return kind(path)
    except OSError:  # a name too long for the file system is no file
        return False
