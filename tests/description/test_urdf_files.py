"""Finding URDF files: by path, among the robots of coop_pin, and in example-robot-data."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pinocchio as pin
import pytest
from malformed_urdf import arm

import coop_pin
from coop_pin.base.errors import UrdfError
from coop_pin.description.urdf import bundled_urdf_folder, check_urdf, find_urdf
from coop_pin.description.urdf.find import example_urdfs


def test_a_path_is_found_absolute_and_relative_to_the_working_directory(tmp_path, monkeypatch):
    (tmp_path / "arm.urdf").write_text(arm())
    monkeypatch.chdir(tmp_path)
    for path in ("arm.urdf", tmp_path / "arm.urdf"):
        assert (find_urdf(path).path, find_urdf(path).origin) == (tmp_path / "arm.urdf", "user")


def test_the_packages_of_a_users_file_are_looked_for_above_it(tmp_path):
    folder = tmp_path / "my_robot" / "urdf"
    folder.mkdir(parents=True)
    (folder / "arm.urdf").write_text(arm())
    assert tmp_path in find_urdf(folder / "arm.urdf").package_dirs


def test_bundled_robots_are_found_by_name_and_sound():
    for path in bundled_urdf_folder().glob("*.urdf"):
        file = find_urdf(path.stem)
        assert (file.path, file.origin) == (path, "bundled")
        assert check_urdf(path.read_bytes()).errors(strict=True) == ()


def test_example_names_are_those_that_users_know():
    files = {
        "ur3": "ur3_robot",
        "ur5": "ur5_robot",
        "panda": "panda",
        "solo8": "solo",
        "talos": "talos_reduced",
    }
    assert {name: find_urdf(name).path.stem for name in files} == files
    assert all(path.is_file() for path in example_urdfs().values())


@pytest.mark.parametrize(
    "name",
    ["panda.urdf", "nowhere/arm.urdf", "x" * 5000 + ".urdf", "a\0b/c", "../panda", "/nowhere/arm.urdf"],
)
def test_a_path_that_leads_nowhere_is_called_a_missing_file(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(UrdfError, match="there is no file") as caught:
        find_urdf(name)
    assert os.path.normpath(tmp_path / name) in str(caught.value)


def test_a_misspelt_path_names_the_closest_file_beside_it_or_the_closest_robot(tmp_path):
    (tmp_path / "stork.urdf").touch()
    with pytest.raises(UrdfError, match=r"did you mean 'stork\.urdf'"):
        find_urdf(tmp_path / "strok.urdf")
    with pytest.raises(UrdfError, match="did you mean 'panda'"):
        find_urdf("panda.urdf")


def test_a_folder_is_called_one(tmp_path):
    with pytest.raises(UrdfError, match="is a folder"):
        find_urdf(tmp_path)


@pytest.mark.parametrize("name", ["pandaa", "", "x" * 5000, "a\0b"])
def test_a_missing_name_lists_the_places_searched(name):
    with pytest.raises(UrdfError) as caught:
        find_urdf(name)
    for place in (str(Path.cwd()), "robots of coop_pin", "example-robot-data"):
        assert place in str(caught.value)
    assert name != "pandaa" or "'panda'" in str(caught.value)


def test_files_are_found_and_checked_without_importing_pinocchio():
    code = "import sys; from coop_pin.description.urdf import *; load_checked(find_urdf('panda'))"
    code += "; print('pinocchio' in sys.modules)"
    assert (
        subprocess.run(
            [sys.executable, "-c", code], capture_output=True, check=True, text=True
        ).stdout.strip()
        == "False"
    )


def test_bundled_robots_are_found_in_the_layout_of_a_wheel(tmp_path):
    shutil.copytree(
        Path(coop_pin.__file__).parent, tmp_path / "coop_pin", ignore=shutil.ignore_patterns("__pycache__")
    )
    shutil.copytree(bundled_urdf_folder(), tmp_path / "coop_pin" / "urdf", dirs_exist_ok=True)
    code = "from coop_pin.description.urdf import *; print(bundled_urdf_folder())"
    code += "; print(find_urdf('adept_3dof').path)"
    environment = os.environ | {"PYTHONPATH": str(tmp_path)}
    run = subprocess.run(
        [sys.executable, "-c", code],
        cwd=tmp_path,
        env=environment,
        capture_output=True,
        check=True,
        text=True,
    )
    folder = tmp_path / "coop_pin" / "urdf"
    assert run.stdout.splitlines() == [str(folder), str(folder / "adept_3dof.urdf")]


@pytest.mark.parametrize(
    "name",
    [
        *("panda", "ur5", "so100"),
        *(
            pytest.param(name, marks=pytest.mark.gate)
            for name in ("ur3", "ur10", "kinova", "xarm7", "z1", "baxter")
        ),
    ],
)
def test_all_meshes_of_the_example_arms_are_found(name):
    file = find_urdf(name)
    model = pin.buildModelFromUrdf(str(file.path))
    folders = [str(folder) for folder in file.package_dirs]
    geometry = pin.buildGeomFromUrdf(model, str(file.path), pin.GeometryType.VISUAL, package_dirs=folders)
    assert geometry.ngeoms > 5
