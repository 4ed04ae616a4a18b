"""Samples of a run as a table of pandas and as CSV; what a result shows of itself."""

import html
import io

import numpy as np
import pandas as pd
import pytest
from cells import SCENARIOS

import coop_pin as cp
from coop_pin.cli import main


@pytest.fixture(scope="module", params=SCENARIOS)
def result(request):
    return cp.run(SCENARIOS[request.param]().replace(duration=0.1, events=()), warn=False)


def test_a_table_has_a_row_for_each_time_and_a_column_for_each_arm_joint_and_axis(result):
    table, data = result.to_dataframe(), result.data
    assert table.index.name == "time [s]"
    assert np.array_equal(table.index, data["time"])
    arms = {
        arm: [str(name) for name in data["joint_name"].sel(arm=arm).values if name]
        for arm in data["arm"].values
    }
    torques = [f"torque.{arm}.{joint} [N m]" for arm, joints in arms.items() for joint in joints]
    assert [name for name in table if name.startswith("torque.")] == torques
    for arm, joints in arms.items():
        for number, joint in enumerate(joints, 1):
            column = data["torque"].sel(arm=arm, joint=number)
            assert np.array_equal(table[f"torque.{arm}.{joint} [N m]"], column, equal_nan=True)
    errors = [f"pose_error.{axis} [m]" for axis in "xyz"] + [f"pose_error.r{axis} [rad]" for axis in "xyz"]
    assert [name for name in table if name.startswith("pose_error.")] == errors
    assert np.array_equal(table[errors], data["pose_error"])
    assert np.array_equal(table["kinetic_energy [J]"], data["kinetic_energy"])


def test_every_sample_is_in_the_table_once(result):
    table, data = result.to_dataframe(), result.data
    names = {name for name, variable in data.data_vars.items() if "time" in variable.dims}
    assert {column.split(" [")[0].split(".")[0] for column in table} == names
    assert table.columns.is_unique
    assert len(table) == data.sizes["time"]


@pytest.mark.parametrize("name", ["two-pandas-palms", "three-ur5-plate"])
def test_patches_and_any_number_of_arms_have_columns(name):
    result = cp.run(name, {"duration": 0.02, "events": []}, warn=False)
    table = result.to_dataframe()
    assert len(table) == result.data.sizes["time"]
    for arm in result.scenario.cell.arms:
        assert f"closure_distance.{arm} [m]" in table
    for patch in result.scenario.cell.patches:
        assert f"patch_wrench.{patch}.rx [N m]" in table


def test_the_command_writes_the_table_of_a_run(result, tmp_path, capsys):
    result.save(tmp_path / "result.nc")
    assert main(["export", str(tmp_path), "--to", "csv"]) == 0
    assert (
        main(["export", str(tmp_path / "result.nc"), "--to", "csv", "--out", str(tmp_path / "a" / "b.csv")])
        == 0
    )
    assert str(tmp_path / "a" / "b.csv") in capsys.readouterr().out
    text = (tmp_path / "samples.csv").read_text()
    assert text == (tmp_path / "a" / "b.csv").read_text()
    read = pd.read_csv(io.StringIO(text), index_col=0)
    pd.testing.assert_frame_equal(read, result.to_dataframe(), rtol=1e-12, check_dtype=False)


@pytest.mark.parametrize(
    "words",
    [
        ["export", "RUN", "--to", "csv", "--arm", "left"],
        ["export", "RUN", "--to", "csv", "--duration", "2"],
        ["export", "adept-paper", "--to", "csv"],
        ["export", "adept-paper", "--to", "c"],
        ["export-c", "adept-paper", "--arm", "left"],
    ],
)
def test_an_export_that_has_no_meaning_and_the_former_command_are_refused(result, tmp_path, words, capsys):
    result.save(tmp_path / "result.nc")
    assert main([str(tmp_path) if word == "RUN" else word for word in words]) == 2
    if words[0] == "export-c":
        assert "coop-pin export" in capsys.readouterr().err


def test_a_result_shows_its_summary(result):
    assert repr(result) == result.summary()
    assert html.escape(result.summary()) in result._repr_html_()
