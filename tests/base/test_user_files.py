"""User files are read bounded and without waiting; damaged results are refused; xacro stays inside."""

import os
import random
import resource
import sys
import zipfile

import h5py
import numpy as np
import pytest
from cells import SCENARIOS, planar_scenario

import coop_pin as cp
from coop_pin.base.errors import CoopPinError, FieldError, FileReadError, UrdfError
from coop_pin.base.user_files import parse_toml, read_user_file
from coop_pin.description.urdf.meshes import read_mesh
from coop_pin.reference.csv_motion import CsvMotion
from coop_pin.sweeps.plan import SweepPlan

POSIX = pytest.mark.skipif(sys.platform == "win32", reason="pipes and devices of POSIX")


def test_a_file_is_read_up_to_its_limit(tmp_path):
    path = tmp_path / "data"
    path.write_bytes(b"12345")
    assert read_user_file(path, limit=5, kind="data") == b"12345"
    with pytest.raises(FileReadError) as caught:
        read_user_file(path, limit=4, kind="data")
    assert caught.value.path == str(path)


@POSIX
@pytest.mark.parametrize(
    "read",
    [
        lambda path: read_user_file(path, limit=10**6, kind="data"),
        lambda path: CsvMotion(path=str(path)).at(0.0),
        lambda path: read_mesh(path),
        lambda path: cp.Payload.mesh(path, mass=1.0),
        lambda path: cp.Scenario.load(path),
        lambda path: SweepPlan.load(path),
        lambda path: cp.RunResult.load(path),
        lambda path: cp.Arm.from_urdf(path),
    ],
    ids=["reader", "csv", "mesh", "payload", "scenario", "plan", "result", "urdf"],
)
@pytest.mark.parametrize("kind", ["fifo", "/dev/zero", "folder", "missing", "nul", "surrogate"])
def test_what_is_no_regular_file_is_refused_at_once(read, kind, tmp_path):
    path = tmp_path / "pipe.stl"
    if kind == "fifo":
        os.mkfifo(path)
    elif kind == "folder":
        path.mkdir()
    elif kind != "missing":
        path = type(path)({"/dev/zero": kind, "nul": "a\0b.stl", "surrogate": "a\udc80.stl"}[kind])
    with pytest.raises(CoopPinError):
        read(path)


def test_an_archive_is_bounded_by_what_it_unpacks_to(tmp_path):
    with zipfile.ZipFile(tmp_path / "bomb.3mf", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("3D/3dmodel.model", b"\0" * 3_000_000)
    assert (tmp_path / "bomb.3mf").stat().st_size < 10_000
    with pytest.raises(FileReadError, match="3000000"):
        read_user_file(tmp_path / "bomb.3mf", limit=1_000_000, kind="a mesh")
    (tmp_path / "a.stl.gz").write_bytes(b"\x1f\x8b\x08 and so on")
    with pytest.raises(FileReadError):
        read_user_file(tmp_path / "a.stl.gz", limit=1_000_000, kind="a mesh")


@pytest.mark.parametrize(
    "text",
    [
        "a = " + "[" * 100_000,
        "a = " + "{a=" * 5_000,
        ".".join("a" * 50_000) + " = 1",
        "a = " + "9" * 5_000,
        "a = " + "9" * 400,
        "a = 9223372036854775808",
    ],
    ids=["list", "table", "key", "digits", "float", "65 bits"],
)
def test_toml_beyond_the_limits_is_a_typed_error(text, tmp_path):
    with pytest.raises(FileReadError):
        parse_toml(text.encode(), "the text", kind="a scenario")
    (tmp_path / "s.toml").write_text(text)
    for load in (cp.Scenario.load, SweepPlan.load):
        with pytest.raises(FileReadError):
            load(tmp_path / "s.toml")


def test_an_integer_beyond_a_float_is_a_typed_error():
    for field in ("controller.gains.sign_gain", "controller.gains.pose_gain", "duration"):
        with pytest.raises(FieldError, match=field):
            planar_scenario().override({field: 10**400})


# ---------------------------------------------------------------- results


@pytest.fixture(scope="module", params=SCENARIOS)
def saved(request, tmp_path_factory):
    scenario = SCENARIOS[request.param]().replace(duration=0.1, events=())
    result, path = cp.run(scenario), tmp_path_factory.mktemp("saved") / "result.nc"
    result.save(path)
    return result, path.read_bytes()


def refused(path, damaged, result):
    """Whether a damaged result is refused; otherwise it must be what was written."""
    path.write_bytes(damaged)
    try:
        loaded = cp.RunResult.load(path)
    except FileReadError as error:
        return "result.nc" in str(error)
    assert loaded.data.identical(result.data)
    assert loaded.scenario == result.scenario
    return False


def flipped(data, place, bit):
    return data[:place] + bytes([data[place] ^ 1 << bit]) + data[place + 1 :]


SEAL = b"coop_pin sha256 "
"""What stands before the checksum at the end of a file."""


@pytest.mark.parametrize("count", [300, pytest.param(10**9, marks=pytest.mark.slow)], ids=["some", "all"])
def test_a_flipped_bit_is_refused(saved, count, tmp_path):
    """One bit of every byte; those of the marker of the checksum alone make it a file without one."""
    result, whole = saved
    seeded, path = random.Random(7), tmp_path / "result.nc"
    places = seeded.sample(range(len(whole)), min(count, len(whole)))
    kept = [
        place for place in places if not refused(path, flipped(whole, place, seeded.randrange(8)), result)
    ]
    marker = whole.rindex(SEAL)
    assert all(marker <= place < marker + len(SEAL) for place in kept)


@pytest.mark.parametrize("count", [5, pytest.param(1000, marks=pytest.mark.slow)])
def test_a_flipped_bit_of_a_copy_is_refused_or_changes_nothing(saved, count, tmp_path):
    """Another program's copy has no checksum of its bytes: HDF5 reads what is damaged."""
    result, whole = saved
    copy, seeded, path = whole[: whole.rindex(SEAL)], random.Random(7), tmp_path / "result.nc"
    places = seeded.sample(range(len(copy)), count)
    found = [refused(path, flipped(copy, place, seeded.randrange(8)), result) for place in places]
    assert sum(found) > 0.2 * count


def test_a_copy_by_another_program_is_what_was_written(saved, tmp_path):
    import xarray as xr

    result, whole = saved
    (tmp_path / "whole.nc").write_bytes(whole)
    xr.load_dataset(tmp_path / "whole.nc", engine="h5netcdf").to_netcdf(
        tmp_path / "same.nc", engine="h5netcdf"
    )
    assert cp.RunResult.load(tmp_path / "same.nc").data.identical(result.data)


@pytest.mark.parametrize(
    "change",
    [
        lambda file: file["torque"].__setitem__((3, 0, 0), 1.0),
        lambda file: file.attrs.update(title="another"),
        lambda file: file["torque"].attrs.update(units="kN m"),
        lambda file: file.attrs.pop("coop_pin_sha256"),
        lambda file: file.attrs.update(
            coop_pin_scenario=file.attrs["coop_pin_scenario"].replace("duration = 0.1", "duration = 0.2")
        ),
    ],
    ids=["value", "title", "unit", "no checksum", "scenario"],
)
def test_a_changed_result_is_refused(saved, change, tmp_path):
    """Another program changes it, without the checksum of its bytes."""
    path, whole = tmp_path / "result.nc", saved[1]
    path.write_bytes(whole[: whole.rindex(SEAL)])
    with h5py.File(path, "r+") as file:
        change(file)
    with pytest.raises(FileReadError, match=r"result\.nc"):
        cp.RunResult.load(path)


def test_a_file_that_unpacks_to_more_than_it_holds_is_refused(tmp_path):
    import xarray as xr

    data = xr.Dataset({"a": ("x", np.zeros(20_000_000))}, attrs={"coop_pin_scenario": "x"})
    data.to_netcdf(tmp_path / "bomb.nc", engine="h5netcdf", encoding={"a": {"zlib": True, "complevel": 9}})
    assert (tmp_path / "bomb.nc").stat().st_size < 1_000_000
    with pytest.raises(FileReadError, match=r"bomb\.nc"):
        cp.RunResult.load(tmp_path / "bomb.nc")


# ---------------------------------------------------------------- xacro

HEAD = '<robot name="x" xmlns:xacro="http://www.ros.org/wiki/xacro">'
BODY = '<inertial><mass value="{}"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'
ARM = """<link name="base"/><link name="end">{}</link><joint name="j" type="continuous"><parent link="base"/>
    <child link="end"/></joint></robot>"""


def _xacro(folder, mass, before=""):
    folder.mkdir(exist_ok=True)
    (folder / "arm.xacro").write_text(HEAD + before + ARM.format(BODY.format(mass)))
    return cp.Arm.from_urdf(folder / "arm.xacro")


def test_xacro_reads_its_own_folder_and_no_other(tmp_path):
    pytest.importorskip("xacrodoc")
    (tmp_path / "secret.yaml").write_text("mass: 2")
    (tmp_path / "arm").mkdir()
    (tmp_path / "arm" / "own.yaml").write_text("mass: 2")
    assert _xacro(tmp_path / "arm", "${xacro.load_yaml('own.yaml')['mass']}").tip == "end"
    secret = str(tmp_path / "secret.yaml")
    for name in ("../secret.yaml", secret):
        with pytest.raises(UrdfError, match="secret"):
            _xacro(tmp_path / "arm", f"${{xacro.load_yaml('{name}')['mass']}}")
    (tmp_path / "other.xacro").write_text(HEAD + "</robot>")
    with pytest.raises(UrdfError, match="other"):
        _xacro(tmp_path / "arm", 1, '<xacro:include filename="../other.xacro"/>')
    (tmp_path / "arm" / "link.yaml").symlink_to(secret)
    with pytest.raises(UrdfError, match="secret"):
        _xacro(tmp_path / "arm", "${xacro.load_yaml('link.yaml')['mass']}")
    assert _xacro(tmp_path / "arm", 1, '<xacro:include optional="true" filename="none.xacro"/>').tip == "end"


def test_xacro_reads_its_package(tmp_path):
    pytest.importorskip("xacrodoc")
    (tmp_path / "package.xml").write_text("<package><name>mine</name></package>")
    (tmp_path / "mass.yaml").write_text("mass: 2")
    assert _xacro(tmp_path / "urdf", "${xacro.load_yaml('$(find mine)/mass.yaml')['mass']}").tip == "end"


def test_xacro_sees_no_environment(tmp_path, monkeypatch):
    pytest.importorskip("xacrodoc")
    monkeypatch.setenv("SECRET", "7")
    with pytest.raises(UrdfError, match="SECRET"):
        _xacro(tmp_path / "arm", "$(env SECRET)")
    (tmp_path / "arm" / "arm.xacro").unlink()
    arm = _xacro(tmp_path / "arm", "$(optenv SECRET 3)")
    assert cp.model.ArmModel(arm).model.inertias[1].mass == 3.0


DOUBLED = """<xacro:macro name="m0"/>{}<xacro:m40/>""".format(
    "".join(
        f'<xacro:macro name="m{i}"><xacro:m{i - 1}/><xacro:m{i - 1}/></xacro:macro>' for i in range(1, 41)
    )
)
"""2^40 calls of m0."""


@pytest.mark.parametrize(
    "before",
    [
        DOUBLED,
        pytest.param('<xacro:property name="p" value="${9**9**9}"/>${p}', marks=pytest.mark.slow),
        '<xacro:property name="p" value="${[0] * 10**11}"/>${p}',
        '<xacro:macro name="m"><link name="x"/><xacro:m/></xacro:macro><xacro:m/>',
        """<xacro:property name="p" value="${'x' * 3000000}"/><a b="${p}" c="${p}"/>""",
    ],
    ids=["doubled", "power", "list", "recursive", "large"],
)
def test_an_expansion_without_end_is_refused(before, tmp_path):
    pytest.importorskip("xacrodoc")
    earlier = resource.getrusage(resource.RUSAGE_CHILDREN)
    with pytest.raises(UrdfError, match=r"arm\.xacro"):
        _xacro(tmp_path / "arm", 1, before)
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    assert used.ru_utime + used.ru_stime - earlier.ru_utime - earlier.ru_stime < 5.0
    assert used.ru_maxrss < 2**21  # 2 GiB, in KiB
