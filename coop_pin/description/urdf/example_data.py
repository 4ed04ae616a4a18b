"""The robots of example-robot-data, by the names under which its users know them."""

from __future__ import annotations

import functools
import importlib.util
import sys
from collections.abc import Iterator
from pathlib import Path
from types import MappingProxyType

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
