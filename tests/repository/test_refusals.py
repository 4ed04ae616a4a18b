"""Arguments that used to end in a bare exception from deep inside are refused by name."""

import io
import math
import subprocess
import sys

import numpy as np
import pytest
import trimesh
from cells import SCENARIOS
from numpy.testing import assert_allclose

import coop_pin as cp
from coop_pin.base import errors, spatial
from coop_pin.base.arrays import require_type
from coop_pin.simulation.build_controller import build_controller

SHORT = {"duration": 0.05, "events": ()}
CELLS = pytest.mark.parametrize("cell", SCENARIOS)


@pytest.fixture(scope="module")
def chains():
    return {name: cp.grasps.CellChain(SCENARIOS[name]().cell) for name in SCENARIOS}


def test_the_wrong_type_error_has_name_and_types():
    with pytest.raises(errors.WrongTypeError) as caught:
        require_type("cell", 3, cp.Cell, str)
    assert (caught.value.name, caught.value.actual, caught.value.expected) == ("cell", "int", "Cell or str")
    assert isinstance(caught.value, TypeError)


@pytest.mark.parametrize(
    ("call", "name"),
    [
        (lambda: cp.grasps.CellChain("adept-paper"), "cell"),
        (lambda: cp.model.ArmModel("panda"), "arm"),
        (lambda: cp.model.CellArm("panda", "left"), "cell"),
        (lambda: cp.ClosedChain("panda", ()), "model"),
        (lambda: cp.solve_ik("panda", np.eye(4)), "arm"),
        (lambda: cp.simulate("adept-paper", None), "scenario"),
        (lambda: cp.run(3), "name_or_path"),
        (lambda: cp.run("adept-paper", {**SHORT, 3: 4}), "a path of changes"),
        (lambda: cp.feasibility.reachability("adept-paper"), "scenario"),
        (lambda: cp.stability.sampled_stability("adept-paper"), "scenario"),
        (lambda: cp.stability.fewest_steps("adept-paper"), "scenario"),
        (lambda: cp.open_view(3), "source"),
        (lambda: cp.RunResult.load(3), "path"),
        (lambda: cp.SweepResult.load(3), "folder"),
        (lambda: cp.sweep("adept-paper", out=3), "out"),
        (lambda: cp.grasps.grasps_from_configuration([], {}, np.eye(4)), "arms"),
        (lambda: spatial.task_rows([]), "name"),
    ],
)
def test_objects_of_a_wrong_class_are_refused_by_name(call, name):
    with pytest.raises(errors.WrongTypeError) as caught:
        call()
    assert caught.value.name == name


@CELLS
def test_a_simulation_refuses_objects_of_a_wrong_class(cell):
    scenario = SCENARIOS[cell]().override(SHORT)
    run = cp.Simulation(scenario, build_controller(scenario))
    for call, name in (
        (lambda: run.add_event(3), "event"),
        (lambda: run.replace_controller(scenario.controller), "controller"),
        (lambda: run.chain.surround(3.0), "surroundings"),
    ):
        with pytest.raises(errors.WrongTypeError) as caught:
            call()
        assert caught.value.name == name
    with pytest.raises(errors.ArgumentError):
        run.references({})


@CELLS
def test_a_time_at_which_the_motion_is_not_finite_is_refused(cell):
    growing = {"kind": "exponentials", "constant": (0.6, 0.1, 0.0), "amplitudes": [(0.1, 0.0, 0.0)]}
    scenario = SCENARIOS[cell]().override(SHORT | {"motion": growing | {"time_constants": [6.6]}})
    run = cp.Simulation(SCENARIOS[cell](), build_controller(SCENARIOS[cell]()))
    run.motion = scenario.motion
    with pytest.raises(errors.OutOfRangeError) as caught:
        run.references(-1e300)
    assert (caught.value.name, caught.value.value) == ("time", -1e300)
    assert np.isfinite(run.references(0.0)[0].pose).all()


@CELLS
@pytest.mark.parametrize("q", [None, [0.0], "x", np.zeros((2, 3))], ids=repr)
def test_closure_errors_and_the_like_refuse_a_configuration_of_a_wrong_shape(chains, cell, q):
    chain = chains[cell]
    for call in (chain.closure_errors, chain.mechanism.closure_errors):
        with pytest.raises(errors.ArgumentError):
            call(q)
    with pytest.raises(errors.ArgumentError):
        chain.mechanism.require_closed(q, 1e-6)
    with pytest.raises(errors.ArgumentError):
        chain.require_held(q, np.eye(4), 1e-6)


@CELLS
@np.errstate(all="ignore")
def test_overflow_in_the_dynamics_is_refused(chains, cell):
    scenario, chain = SCENARIOS[cell](), chains[cell]
    q, nv = chain.configuration(scenario.start.matrix), chain.mechanism.model.nv
    fast, still = np.full(nv, 1e300), np.zeros(nv)
    arm = cp.model.CellArm(scenario.cell, "left")
    with pytest.raises(errors.CoopPinError):
        chain.observe(q[None], fast[None], still[None], np.zeros((1, 6)))
    with pytest.raises(errors.CoopPinError):
        chain.mechanism.forward_dynamics(q, fast, still)
    with pytest.raises(errors.OutOfRangeError):
        arm.nonlinear_effects(np.full(arm.nq, 0.5), np.full(arm.nv, 1e300))
    with pytest.raises(errors.OutOfRangeError):
        arm.forward_dynamics(np.full(arm.nq, 0.5), np.full(arm.nv, 1e300), np.zeros(arm.nv))


@CELLS
@pytest.mark.parametrize("field", ["start.xyz", "cell.arms.left.base.xyz", "cell.grasps.left.xyz"])
def test_lengths_of_1e300_are_out_of_reach(cell, field):
    with pytest.raises(errors.UnreachablePoseError):
        cp.run(SCENARIOS[cell](), {**SHORT, field: [1e300, 0.0, 0.0]})


def test_a_redundant_arm_with_too_few_entries_in_its_posture():
    with pytest.raises(errors.ShapeError) as caught:
        cp.run("two-pandas-box", {**SHORT, "cell.arms.left.posture": [0.1, 0.2]})
    assert caught.value.shape == (2,)
    with pytest.raises(errors.FieldError) as caught:
        cp.run("two-pandas-box", {**SHORT, "controller.posture.stiffness": [1.0, 2.0]})
    assert caught.value.path == "controller.posture.stiffness"


@pytest.mark.parametrize("scale", [0, -1.0, 1e-300, 1e300, math.nan])
def test_a_mesh_scale_that_gives_no_body_is_refused(tmp_path, scale):
    path = tmp_path / "body.obj"
    path.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n")
    with pytest.raises(errors.FieldError) as caught:
        cp.Payload.mesh(path, mass=1.0, scale=scale)
    assert caught.value.path == "scale"


def test_an_integer_of_hundreds_of_digits_is_refused_by_its_field():
    with pytest.raises(errors.FieldError) as caught:
        cp.sweeps.Sample(fields={"duration": cp.sweeps.Span(low=0.01, high=0.1)}, count=2, seed=-(10**400))
    assert caught.value.path == "seed"


def test_a_gltf_with_buffers_in_other_files_is_refused_with_what_to_do(tmp_path):
    box = trimesh.creation.box((0.1, 0.2, 0.3))
    for name, content in trimesh.exchange.gltf.export_gltf(box).items():
        (tmp_path / name).write_bytes(content)
    with pytest.raises(errors.FieldError, match=r"\.glb"):
        cp.Payload.mesh(tmp_path / "model.gltf", mass=1.0)
    box.export(tmp_path / "model.glb")
    assert_allclose(cp.Payload.mesh(tmp_path / "model.glb", mass=1.0).size, (0.1, 0.2, 0.3), atol=1e-7)


def test_a_mesh_whose_triangles_have_no_corners_is_refused(tmp_path):
    corners = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 {}\n"
    (tmp_path / "nan.obj").write_text(corners.format("nan") + "f 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n")
    content = trimesh.creation.box((0.1, 0.2, 0.3)).export(file_type="glb")
    faces = trimesh.load(io.BytesIO(content), file_type="glb", force="mesh").faces
    indices = np.asarray(faces, dtype="<u4").tobytes()
    assert content.count(indices) == 1
    (tmp_path / "far.glb").write_bytes(content.replace(indices, b"\xff\xff\xff\xff" + indices[4:]))
    for name in ("nan.obj", "far.glb"):
        with pytest.raises(errors.FieldError, match=name):
            cp.Payload.mesh(tmp_path / name, mass=1.0)


@pytest.mark.parametrize("times", [(0.0, 5e-324, 1e-323), (0.0, 1e-310, 1.0), (0.0, 1e300, 2e300)])
def test_times_that_no_spline_can_lead_through_are_refused(tmp_path, times):
    rows = "".join(f"{time!r},{index / 10},0,0,0,0,0\n" for index, time in enumerate(times))
    (tmp_path / "motion.csv").write_text("time,x,y,z,roll,pitch,yaw\n" + rows)
    motion = cp.motions.CsvMotion(path=str(tmp_path / "motion.csv"))
    with pytest.raises(errors.CoopPinError):
        motion.at(0.5)
    points = tuple(
        cp.motions.Waypoint(time=time, xyz=(index / 10, 0.0, 0.0)) for index, time in enumerate(times)
    )
    with pytest.raises(errors.FieldError):
        cp.motions.WaypointsMotion(points=points)


@pytest.mark.parametrize(
    "read",
    [
        cp.Scenario.load,
        cp.RunResult.load,
        cp.SweepResult.load,
        cp.SweepPlan.load,
        cp.Arm.from_urdf,
        lambda path: cp.Payload.mesh(path, mass=1.0),
        lambda path: cp.motions.CsvMotion(path=path).at(0.0),
    ],
    ids=["scenario", "result", "sweep", "plan", "urdf", "mesh", "csv"],
)
def test_a_name_that_is_too_long_for_a_file_is_refused(read):
    with pytest.raises(errors.CoopPinError):
        read("x" * 5000)


@pytest.mark.parametrize("wrong", [None, "a", [1.0], np.zeros(3), np.zeros((3, 4))], ids=repr)
def test_functions_of_spatial_refuse_wrong_shapes(wrong):
    for call in (
        lambda: spatial.inverse_pose(wrong),
        lambda: spatial.pose_error(np.eye(4), wrong),
        lambda: spatial.shift_wrench(wrong, np.zeros(3)),
        lambda: spatial.rotate_vector6(np.eye(3), wrong),
        lambda: spatial.internal_wrenches(wrong, np.full(2, 0.5)),
    ):
        with pytest.raises(errors.ArgumentError):
            call()
    with pytest.raises(errors.NameNotFoundError):
        spatial.task_rows("diagonal")


def test_a_closed_output_prints_nothing():
    command = [sys.executable, "-m", "coop_pin", "list"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as child:
        child.stdout.close()
        assert child.stderr.read() == b""
        assert child.wait(60.0) == 141
