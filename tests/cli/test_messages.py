"""What new users typed wrong or looked for: the message names place, value and remedy, and help is short."""

import inspect
import pydoc
import re
import warnings

import pytest
from cells import SCENARIOS

import coop_pin as cp
from coop_pin.base.errors import FieldError, NameNotFoundError, UrdfError
from coop_pin.cli import main
from coop_pin.cli.overrides import changes
from coop_pin.description.urdf import check_file, find_urdf

CELLS = pytest.mark.parametrize("cell", SCENARIOS)

ROBOT = """<robot name="r">
  <link name="a"><visual><geometry><mesh filename="nowhere.stl"/></geometry></visual></link>
  <link name="b">
    <inertial><mass value="{mass}"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>
  </link>
  <joint name="j" type="{kind}"><parent link="a"/><child link="b"/><axis xyz="0 0 1"/>
    <limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
</robot>
"""


@pytest.mark.parametrize("kind", [cp.motions.CircleMotion, cp.Scenario, cp.Arm, cp.laws.PayloadSpace])
def test_help_of_a_configuration_class_has_its_own_names_only(kind):
    text = pydoc.plain(pydoc.render_doc(kind))
    assert "Attributes:" in text
    assert not {"model_dump", "model_config", "__pydantic_fields__", "parse_raw"} & {*dir(kind)}
    assert {"replace", "override"} <= {*dir(kind)}
    assert "model_dump" not in text
    assert len(text.splitlines()) < 190


def test_dir_of_the_package_lists_public_names_only():
    listed = {name for name in dir(cp) if not name.startswith("__")}
    namespaces = {name for name in listed if inspect.ismodule(getattr(cp, name))}
    assert listed == {*cp.__all__} | namespaces
    assert 25 < len(namespaces) < 35
    for name in namespaces:
        inside = getattr(cp, name)
        assert {one for one in dir(inside) if not one.startswith("__")} == {*inside.__all__}, name


@pytest.mark.parametrize(("wrong", "right"), [("Result", "RunResult"), ("Circle", "motions.CircleMotion")])
def test_a_misspelt_public_name_has_a_suggestion(wrong, right):
    with pytest.raises(AttributeError, match=re.escape(f"cp.{right}")):
        getattr(cp, wrong)
    assert not hasattr(cp, wrong)


@CELLS
def test_a_wrong_tip_is_told_with_the_arm_of_the_cell(cell):
    scenario = SCENARIOS[cell]().override({"cell.arms.right.tip": "nope"})
    with pytest.raises(NameNotFoundError, match="'right'"):
        cp.run(scenario)


def test_a_list_typed_as_json_is_refused_with_the_form_that_works():
    with pytest.raises(FieldError, match=r"a list in TOML, \[\{name = value\}\]") as caught:
        changes({"events": ['[{"time": 2.0}]']}, ["left"])
    assert caught.value.path == "events"
    assert changes({"events": ["[{time = 2.0}]"]}, ["left"]) == {"events": [{"time": 2.0}]}


def test_a_table_typed_as_json_is_refused_with_both_forms_that_work():
    path = "cell.arms.left.locked"
    with pytest.raises(FieldError, match=rf"--{path}\.NAME VALUE") as caught:
        changes({path: ['{"finger": 0.03}']}, ["left"])
    assert caught.value.path == path
    assert changes({path: ["{finger = 0.03}"]}, ["left"]) == {path: {"finger": 0.03}}
    assert changes({f"{path}.finger": ["0.03"]}, ["left"]) == {f"{path}.finger": 0.03}


def test_findings_of_a_xacro_name_no_line_of_its_expansion(tmp_path):
    file = tmp_path / "wrong.xacro"
    file.write_text(ROBOT.format(mass=1.0, kind="revolut"))
    (finding,) = check_file(find_urdf(str(file))).errors()
    assert (finding.code, finding.element, finding.line) == ("joint_type", "joint 'j'", 0)
    assert "line" not in str(finding)
    (tmp_path / "wrong.urdf").write_text(file.read_text())
    (finding,) = check_file(find_urdf(str(tmp_path / "wrong.urdf"))).errors()
    assert finding.line == 6


def test_a_refused_file_tells_its_missing_meshes_too_and_a_usable_one_is_silent(tmp_path):
    for mass in (-1.0, 1.0):
        (tmp_path / f"{mass}.urdf").write_text(ROBOT.format(mass=mass, kind="revolute"))
    with pytest.raises(UrdfError, match=r"mesh_missing[\s\S]*1 error, 1 warning"):
        cp.model.ArmModel(cp.Arm(urdf=str(tmp_path / "-1.0.urdf"), tip="b"))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert cp.model.ArmModel(cp.Arm(urdf=str(tmp_path / "1.0.urdf"), tip="b")).nv == 1


@CELLS
def test_metrics_that_do_not_apply_share_a_line(cell):
    result = cp.run(SCENARIOS[cell](), {"duration": 0.05, "events": []}, warn=False)
    summary = re.sub(r",\n +", ", ", result.summary())
    (line,) = [line for line in summary.splitlines() if "does not apply" in line]
    absent = line.partition(": ")[2].split(", ")
    assert {"after_event_position_rms_m", "resettling_time_s"} <= {*absent}
    assert len(absent) == sum(value != value for value in result.metrics().values())


def test_a_change_common_to_all_runs_that_fits_no_scenario_is_refused_by_its_field(tmp_path, capsys):
    """The event of the catalogue's scenario is at 10 s."""
    plan = tmp_path / "plan.toml"
    plan.write_text(
        'base = "adept-anchored"\n[changes]\nduration = 6.0\n[axes]\n"clock.rate_hz" = [80, 160]\n'
    )
    assert main(["sweep", str(plan), "--out", str(tmp_path / "out")]) == 2
    assert "events.0.time" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
