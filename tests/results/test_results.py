"""Results: the dataset has what its table declares; axial, shear and moment follow their definitions."""

import copy
import io
import os
import pickle

import numpy as np
import pytest
import xarray as xr
from cells import SCENARIOS
from close import assert_close
from numpy.testing import assert_allclose

import coop_pin as cp
from coop_pin.base import errors
from coop_pin.base.errors import ArgumentError, FileReadError, FileWriteError, NameNotFoundError
from coop_pin.base.spatial import make_pose
from coop_pin.results import netcdf
from coop_pin.results.quantities import quantities
from coop_pin.results.quantity import Quantity, allocate, bytes_per_sample, computed

STATIC = {
    "position_lower",
    "position_upper",
    "velocity_limit",
    "torque_limit",
    "joint_name",
    "wrench_is_determined",
}


@pytest.fixture(scope="module", params=SCENARIOS)
def result(request):
    return cp.run(SCENARIOS[request.param]().replace(duration=0.5, events=()), warn=False)


def test_the_dataset_has_the_variables_of_the_table(result):
    stored = [quantity for quantity in quantities(result.scenario) if quantity.stored]
    assert set(result.data.data_vars) == {quantity.name for quantity in stored} | STATIC
    for name, dims, unit, text, *_ in stored:
        assert result.data[name].dims == ("time", *dims.split())
        assert result.data[name].attrs == {"units": unit, "long_name": text}


# ---------------------------------------------------------------- the table


@pytest.mark.parametrize(
    ("dims", "count"),
    [
        ("", 1),
        ("axis", 6),
        ("position", 3),
        ("quaternion", 4),
        ("row", 4),
        ("column", 4),
        ("arm joint", 2 * 7),
        ("q v", 15 * 14),
    ],
)
def test_a_sample_takes_eight_bytes_for_each_number_and_as_much_for_the_file(dims, count):
    sizes = {"q": 15, "v": 14, "arm": 2, "joint": 7}
    stored, passing = (Quantity("x", dims, "1", "", stored=stored) for stored in (True, False))
    assert bytes_per_sample([stored], sizes) == 16 * count
    assert bytes_per_sample([passing], sizes) == 8 * count
    assert bytes_per_sample([stored, passing, passing], sizes) == 32 * count


def test_recorded_quantities_begin_as_nothing():
    scenario = SCENARIOS["planar"]()
    samples = allocate(quantities(scenario), 3, {"q": 6, "v": 6, "arm": 2, "joint": 3})
    saturated = samples.pop("saturated")
    assert saturated.dtype == bool
    assert saturated.shape == (3, 2, 3)
    assert not saturated.any()
    assert all(np.isnan(values).all() and len(values) == 3 for values in samples.values())


def test_only_the_quantities_that_are_asked_for_are_computed():
    table = [
        Quantity("a", "", "1", ""),
        Quantity("twice", "", "1", "", lambda s: 2.0 * s["a"]),
        Quantity("shared", "", "1", "", lambda s: s["a"] * s["load_share"][0]),
    ]
    samples, shares = {"a": np.array((1.0, 2.0))}, np.array((0.25, 0.75))
    some = computed(table, samples, shares, names=["twice", "a"])
    assert set(some) == {"a", "load_share", "twice"}
    assert some["twice"].tolist() == [2.0, 4.0]
    assert computed(table, samples, shares)["shared"].tolist() == [0.25, 0.5]
    assert set(samples) == {"a"}


NONE, LATE, FILTERED = {"kind": "none"}, {"kind": "late"}, {"kind": "low-pass", "pole": 0.5}
WRIST = {"wrist": {"rate_hz": 40.0}}


@pytest.mark.parametrize(
    ("path", "sensors", "groups"),
    [
        (NONE, {}, ()),
        (LATE, {}, ()),
        (FILTERED, {}, ()),
        (LATE | {"delay": 1}, {}, ("force path",)),
        (LATE, WRIST, ("force path", "wrist")),
        (FILTERED | {"delay": 2}, WRIST, ("force path", "wrist")),
        (NONE, WRIST, ("wrist",)),
        (NONE, {"encoder": {"noise": 1e-6}}, ("encoder", "kinematics")),
    ],
    ids=str,
)
def test_what_is_measured_is_recorded_only_where_it_is_not_ideal(path, sensors, groups):
    scenario = cp.Scenario.load(
        "adept-paper", {"controller.force_path": path, "sensors": sensors, "controller.gains.force_gain": 0.0}
    )
    assert {quantity.group for quantity in quantities(scenario)} == {"", *groups}


# ---------------------------------------------------------------- parts of wrenches


@pytest.mark.parametrize("name", SCENARIOS)
def test_the_pose_that_an_arm_sees_wrongly_is_recorded_as_its_error(name):
    """The pose as seen serves to compute the error, by hand here, and is not stored."""
    wrong = {
        "planar": {"cell.arms.left.calibration_error.tip.xyz": (1e-3, 0.0, 0.0)},
        "spatial": {"cell.arms.right.calibration_error.base.rpy": (0.0, 0.0, 1e-3)},
    }
    before, scenario = SCENARIOS[name](), SCENARIOS[name]().override(wrong[name])
    added = set(quantities(scenario)) - set(quantities(before))
    assert {(q.name, q.stored) for q in added} == {("seen_pose", False), ("seen_pose_error", True)}
    (error,) = (q.source for q in added if q.stored)
    X_WP = np.stack([make_pose((0.5, 0.0, height)) for height in (0.0, 0.2)])
    shifted = np.stack([make_pose((0.52, 0.0, height)) for height in (0.0, 0.2)])
    seen = np.stack([shifted, X_WP @ make_pose((0.0, 0.0, 0.1), (0.0, 0.0, 0.3))], axis=1)
    by_hand = np.tile([[0.02, 0.0, 0.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.1, 0.0, 0.0, 0.3]], (2, 1, 1))
    assert_close(error({"seen_pose": seen, "payload_pose": X_WP}), by_hand, 1e-15)


@pytest.mark.parametrize(("prefix", "suffix"), [("", ""), ("desired_", ""), ("", "_error")])
def test_axial_shear_and_moment_are_the_parts_of_the_internal_wrench(result, prefix, suffix):
    """Axial direction: from an arm's tip to the middle of the other tips; undetermined rows count zero."""
    data = result.data
    wrench = data[f"{prefix}internal_wrench"].values
    if suffix:
        wrench = wrench - data["desired_internal_wrench"].values
    wrench, tips = np.nan_to_num(wrench), data["tip_position"].values
    for arm in range(len(data.arm)):
        line = np.delete(tips, arm, axis=1).mean(axis=1) - tips[:, arm]
        axial = (wrench[:, arm, :3] * line).sum(axis=1) / np.linalg.norm(line, axis=1)
        shear = np.linalg.norm(np.cross(line, wrench[:, arm, :3]), axis=1) / np.linalg.norm(line, axis=1)
        moment = np.linalg.norm(wrench[:, arm, 3:], axis=1)
        for part, expected in (("axial", axial), ("shear", shear), ("moment", moment)):
            found = data[f"{prefix}internal_{part}{suffix}"].values[:, arm]
            assert_allclose(found, expected, rtol=1e-9, atol=1e-9)


def test_a_file_that_lacks_a_variable_is_refused_with_its_name(result, tmp_path):
    cp.RunResult(result.scenario, result.data.drop_vars("internal_axial")).save(tmp_path / "result.nc")
    with pytest.raises(FileReadError, match="internal_axial"):
        cp.RunResult.load(tmp_path / "result.nc")


def test_the_folder_of_a_run_is_read_as_its_result(result, tmp_path):
    with pytest.raises(FileReadError, match="no result file"):
        cp.RunResult.load(tmp_path)
    result.save(tmp_path / "result.nc")
    assert cp.RunResult.load(tmp_path).data.identical(cp.RunResult.load(tmp_path / "result.nc").data)


# ---------------------------------------------------------------- checksum and size of a file


def test_the_checksum_is_of_what_a_dataset_says_and_not_of_how_it_is_held():
    """Text as objects or in fixed width, and attributes in any order; every value and name counts."""
    fixed = xr.Dataset({"name": ("a", np.array(["one", "two"])), "x": ("a", [1.0, 2.0], {"p": 1, "q": 2})})
    held = xr.Dataset(
        {"x": ("a", [1.0, 2.0], {"q": 2, "p": 1}), "name": ("a", np.array(["one", "two"], dtype=object))}
    )
    digest = netcdf.content_digest(fixed)
    assert netcdf.content_digest(held) == digest
    assert netcdf.content_digest(held.copy(deep=True)) == digest
    for changed in (
        held.assign(x=("a", [1.0, 2.5], held.x.attrs)),
        held.assign(x=("a", np.array([1.0, 2.0], dtype=np.float32), held.x.attrs)),
        held.assign(name=("a", ["one", "tow"])),
        held.assign(x=("b", [1.0, 2.0], held.x.attrs)),
        held.assign(x=("a", [1.0, 2.0], {"p": 1, "q": 3})),
        held.rename(x="y"),
        held.assign_attrs(title="t"),
    ):
        assert netcdf.content_digest(changed) != digest


def copied(path, **sizes):
    """Write a dataset of noise and zeros of these sizes, bytes, compressed by another program."""
    rng = np.random.default_rng(1)
    noise, zeros = rng.normal(size=sizes.get("noise", 8) // 8), np.zeros(sizes["zeros"] // 8)
    data = xr.Dataset({"noise": ("n", noise), "zeros": ("z", zeros)}, attrs={"coop_pin_scenario": "text"})
    data.attrs["coop_pin_sha256"] = netcdf.content_digest(data)
    data.to_netcdf(path, engine="h5netcdf", encoding={"zeros": {"zlib": True}, "noise": {"zlib": False}})


MB = 1_000_000


def test_files_have_what_xarray_writes():
    """Also coordinates besides dimensions, texts, and dimensions without a variable."""
    names = {"case": ("run", ["a", "b", "\u00e4"]), "run": [3, 1, 2]}
    variables = {"x": (("run", "axis"), np.arange(6.0).reshape(3, 2), {"units": "m"}), "y": ((), True)}
    data = xr.Dataset(variables, names, {"title": "t"})
    ours, theirs = (
        xr.load_dataset(io.BytesIO(bytes(content)), engine="h5netcdf")
        for content in (netcdf.written_netcdf(data).getbuffer(), data.to_netcdf(engine="h5netcdf"))
    )
    assert ours.identical(theirs)


@pytest.mark.parametrize(
    ("sizes", "is_read"),
    [
        ({"zeros": MB}, True),
        ({"zeros": 8 * MB // 5}, False),
        ({"noise": MB, "zeros": 5 * MB // 2}, True),
        ({"noise": MB, "zeros": 9 * MB // 2}, False),
    ],
    ids=str,
)
def test_a_compressed_copy_is_read_up_to_four_times_its_size_and_a_mebibyte(sizes, is_read, tmp_path):
    copied(tmp_path / "copy.nc", **sizes)
    if not is_read:
        with pytest.raises(FileReadError):
            netcdf.read_dataset(tmp_path / "copy.nc")
        return
    data, text = netcdf.read_dataset(tmp_path / "copy.nc")
    assert (text, data.zeros.nbytes, dict(data.attrs)) == ("text", sizes["zeros"], {})


def test_results_are_read_up_to_four_gibibytes(tmp_path):
    (tmp_path / "result.nc").touch()
    os.truncate(tmp_path / "result.nc", 4 * 1024**3 + 1)
    with pytest.raises(FileReadError, match="4294967297"):
        netcdf.read_dataset(tmp_path / "result.nc")


def test_a_path_that_is_a_folder_is_refused_and_leaves_nothing(result, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for path in ("", ".", "/"):
        with pytest.raises(FileWriteError):
            result.save(path)
    assert list(tmp_path.iterdir()) == []


def test_continuous_joints_are_counted_from_the_posture_on():
    """A posture of a full turn more is the same pose, and the recorded angles have that turn too."""
    scenario = cp.Scenario.load("kinova-pair", {"duration": 0.01, "events": []})
    arms, turned = scenario.cell.arms, {}
    for name, arm in arms.items():
        turned[name] = 2.0 * np.pi * cp.model.ArmModel(arm).limits.joints.continuous
        assert turned[name].any()
    wound = scenario.cell.replace(
        arms={k: arm.replace(posture=tuple(np.array(arm.posture) + turned[k])) for k, arm in arms.items()}
    )
    first, second = cp.run(scenario, warn=False).data, cp.run(scenario.replace(cell=wound), warn=False).data
    for index, turns in enumerate(turned.values()):
        assert_close(
            second.joint_position[:, index] - first.joint_position[:, index],
            np.broadcast_to(turns, first.joint_position[:, index].shape),
            atol=1e-9,
        )
        assert (
            np.abs(first.joint_position[0, index] - np.array(list(arms.values())[index].posture)).max()
            < np.pi
        )


@pytest.mark.parametrize(
    ("former", "name"),
    [
        ("position_rms_m", "moving_position_rms_m"),
        ("internal_shear_rms_N", "rest_internal_shear_rms_N"),
        ("trustworthy", "simulation_sound"),
    ],
)
def test_former_names_of_metrics_are_answered_with_the_new_ones(result, former, name):
    metrics = result.metrics()
    with pytest.raises(NameNotFoundError) as caught:
        metrics[former]
    assert name in str(caught.value)
    assert name in metrics
    assert [*pickle.loads(pickle.dumps(metrics))] == [*metrics]


def test_a_wrong_name_in_a_result_is_told_with_the_names_there_are(result, tmp_path):
    """In a new result, in one that was read, and in a part of one; right names are found as always."""
    result.save(tmp_path / "result.nc")
    read = cp.RunResult.load(tmp_path / "result.nc")
    one, *_ = result.scenario.cell.arms
    for data in (result.data, read.data, result.data["torque"], read.data.isel(time=slice(1))):
        for wrong in (f"{one}t", 3):
            with pytest.raises(ArgumentError, match=one if wrong == f"{one}t" else "3"):
                data.sel(arm=wrong)
        assert str(data.sel(arm=one).arm.values) == one
        assert data.sel(arm=[one]).sizes["arm"] == 1
    shared = xr.DataArray([2.0] * result.data.sizes["arm"], {"arm": result.data.arm.values.tolist()}, "arm")
    assert_allclose((result.data.torque * shared).values, 2.0 * result.data.torque.values)


@pytest.mark.parametrize("copied", [copy.deepcopy, lambda it: pickle.loads(pickle.dumps(it))])
@pytest.mark.parametrize(
    ("cell", "engine"),
    [
        *(("planar", "compiled"), ("spatial", "pinocchio")),
        *(
            pytest.param(*case, marks=pytest.mark.slow)
            for case in (("planar", "pinocchio"), ("spatial", "compiled"))
        ),
    ],
)
def test_results_and_the_errors_that_carry_them_are_copied_and_pickled(cell, engine, copied):
    """As between processes of a pool: labelled and not."""
    scenario = SCENARIOS[cell]().override({"duration": 0.1, "events": []})
    result = cp.run(scenario, engine=engine, warn=False)
    for found in (copied(result), copied((result.data, result)[1])):
        assert found.scenario == result.scenario
        assert found.engine == result.engine
        assert found.data.identical(result.data)
        assert found.summary() == result.summary()
    user = scenario.override({"controller": {"kind": "user", "target": "mistaken_laws:ReturnsNan"}})
    with pytest.raises(errors.CommandError) as caught:
        cp.run(user, engine=engine, warn=False)
    error = copied(caught.value)
    assert vars(error).keys() == vars(caught.value).keys()
    assert (str(error), error.function, error.time) == (
        str(caught.value),
        "ReturnsNan.step",
        caught.value.time,
    )
    assert error.result.data.identical(caught.value.result.data)
