"""Cell summary: masses, locked joints and limits of a robot whose numbers are stated here."""

import math

import pytest
from close import assert_close
from linkages import bar, link, robot

from coop_pin.base.schema.pose import Pose
from coop_pin.description.cell.arm import Arm
from coop_pin.description.cell.cell import Cell
from coop_pin.description.cell.payload import Payload
from coop_pin.feasibility import cell_summary


@pytest.fixture
def cell(tmp_path):
    """Three bars of 4, 2 and 1 kg, of which the second hinge can be locked, on a foot of 9 kg."""
    text = robot(
        bar("one", "ground", (0, 0, 0), length=0.5, mass=4.0),
        bar("two", "one", (0.5, 0, 0), length=0.4, mass=2.0),
        bar("three", "two", (0.4, 0, 0), length=0.3, mass=1.0),
    ).replace('<link name="ground"/>', link("ground", mass=9.0))
    path = tmp_path / "bars.urdf"
    path.write_text(text)
    arm = Arm(urdf=str(path), tip="three", posture=(0.2, 0.7))
    return Cell(
        arms={"only": arm.replace(locked={"two_pin": 0.5})},
        payload=Payload.box(1.0, (0.1, 0.1, 0.1)),
        grasps={"only": Pose()},
        rows="planar",
    )


@pytest.mark.filterwarnings("ignore::coop_pin.base.errors.UrdfWarning")
def test_what_moves_counts_and_what_is_locked_is_named(cell):
    reach = math.hypot(0.5 + 0.4 * math.cos(0.5), 0.4 * math.sin(0.5))
    angle = math.atan2(0.4 * math.sin(0.5), 0.5 + 0.4 * math.cos(0.5))
    start = Pose(xyz=(reach * math.cos(0.2 + angle), reach * math.sin(0.2 + angle), 0), rpy=(0, 0, 1.4))
    summary = cell_summary(cell, start.matrix)
    (arm,) = summary.arms
    assert_close(arm.mass, 7.0, atol=1e-12)
    assert_close(arm.maximum_reach, reach, atol=1e-9)
    assert arm.locked == ("two_pin",)
    assert "two_pin" in summary.summary()
    assert [joint.name for joint in arm.joints] == ["one_pin", "three_pin"]
    assert_close([joint.angle for joint in arm.joints], [0.2, 0.7], atol=1e-6)
    assert (summary.closure_rows, summary.rank, summary.freedom) == (6, 6, 2)
