"""Results: the dataset has what its table declares; axial, shear and moment follow their definitions."""

import numpy as np
import pytest
from cells import SCENARIOS
from close import assert_close
from numpy.testing import assert_allclose

import coop_pin as cp
from coop_pin.errors import FileReadError, FileWriteError
from coop_pin.results.quantities import quantities

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
    return cp.run(SCENARIOS[request.param]().replace(duration=0.5, events=()))


def test_the_dataset_has_the_variables_of_the_table(result):
    stored = [quantity for quantity in quantities(result.scenario) if quantity.stored]
    assert set(result.data.data_vars) == {quantity.name for quantity in stored} | STATIC
    for name, dims, unit, text, *_ in stored:
        assert result.data[name].dims == ("time", *dims.split())
        assert result.data[name].attrs == {"units": unit, "long_name": text}


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
        turned[name] = 2.0 * np.pi * cp.ArmModel(arm).limits.joints.continuous
        assert turned[name].any()
    wound = scenario.cell.replace(
        arms={k: arm.replace(posture=tuple(np.array(arm.posture) + turned[k])) for k, arm in arms.items()}
    )
    first, second = cp.run(scenario).data, cp.run(scenario.replace(cell=wound)).data
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
