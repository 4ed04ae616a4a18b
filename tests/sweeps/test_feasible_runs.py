"""What every run of a sweep, search or comparison would fail by is refused before the first run."""

import pytest
from cells import ANCHORED, SCENARIOS

import coop_pin as cp
from coop_pin.base.errors import FieldError, InfeasibleMotionError, NameNotFoundError, ScenarioError
from coop_pin.cli import main
from coop_pin.comparison import tune_controllers
from coop_pin.sweeps.feasibility import require_feasible

NO_RUNS = pytest.mark.usefixtures("no_runs")
CELLS = pytest.mark.parametrize("cell", SCENARIOS)
HERE = cp.Execution(workers=0, quiet=True)
NOMINAL = {"nominal": {}}
AWAY = {"motion": {"kind": "hold", "pose": {"xyz": [9.0, 0.0, 0.0]}}}
"""A path that leaves the reach of both cells."""
BAD = {"cell.payload.mass": -1.0}
"""A trial that no scenario can have."""
SLIDING = {
    "kind": "sliding-mode",
    "gains": {"pose_gain": 1.0, "sign_gain": 0.0, "damping_gain": 1.0, "transient_rate": 1.0},
}
"""A law for as many joints as task rows."""


def scenario(cell, changes=None):
    base = SCENARIOS[cell]().replace(controller=ANCHORED[cell], name=cell)
    return base.override({"events": [], "duration": 0.05} | (changes or {}))


def refused(kind, call):
    """The error of a call that is refused."""
    with pytest.raises(kind) as caught:
        call()
    return caught.value


@pytest.fixture
def no_runs(runs_here):
    """No run is started."""
    yield
    assert runs_here.jobs == []


@NO_RUNS
@pytest.mark.parametrize(
    ("cell", "asked"),
    [
        ("planar", slice(1)),
        pytest.param("spatial", slice(2, 3), marks=pytest.mark.slow),
        pytest.param("planar", slice(1, None), marks=pytest.mark.gate),
    ],
)
def test_a_path_out_of_reach_is_refused_with_arm_and_distance(cell, asked, tmp_path):
    """By sweep, tune, compare and the search for gains."""
    base, gain = scenario(cell, AWAY), "controller.gains.sliding_gain"
    out = tmp_path / "out"
    calls = (
        lambda: cp.sweep(base, {gain: [1.0, 2.0]}, out=out, execution=HERE),
        lambda: cp.tune(base, {gain: (1.0, 2.0)}, minimize="moving_position_rms_m", out=out, execution=HERE),
        lambda: cp.compare(base, ["anchored"], NOMINAL, out=out, execution=HERE),
        lambda: tune_controllers(base, ["anchored"], out=out, execution=HERE),
    )
    for call in calls[asked]:
        error = refused(InfeasibleMotionError, call)
        assert error.cause == "reach"
        assert "left" in error.detail
    assert not out.exists()


@NO_RUNS
@pytest.mark.parametrize("cell", ["planar", pytest.param("spatial", marks=pytest.mark.slow)])
def test_a_trial_and_a_case_that_no_scenario_can_have_are_refused_by_name(cell, tmp_path):
    base, gain = scenario(cell), "controller.gains.sliding_gain"
    for trial, cause in ((BAD, ScenarioError), (AWAY, InfeasibleMotionError)):
        trials = {"nominal": {}, "bad": trial}
        compare = refused(
            FieldError, lambda t=trials: cp.compare(base, ["anchored"], t, out=tmp_path, execution=HERE)
        )
        tune = refused(
            FieldError,
            lambda t=trials: cp.tune(
                base,
                {gain: (1.0, 2.0)},
                minimize="moving_position_rms_m",
                cases=t,
                out=tmp_path,
                execution=HERE,
            ),
        )
        assert (compare.path, tune.path) == (f"{cell}: trials.bad", "cases.bad")
        assert isinstance(compare.__cause__, cause)
        assert isinstance(tune.__cause__, cause)


@NO_RUNS
def test_a_law_that_the_cell_cannot_have_is_refused_by_all(tmp_path):
    """Arms of seven joints on six rows; in planar and spatial cells with equal numbers the law is allowed."""
    redundant = cp.Scenario.load("two-pandas-box", {"duration": 0.05})
    laws = {"printed": SLIDING, "anchored": redundant.controller}
    error = refused(FieldError, lambda: cp.compare(redundant, laws, NOMINAL, out=tmp_path, execution=HERE))
    assert error.path == "two-pandas-box: controllers.printed"
    assert error.__cause__.path == "controller.kind"
    base, mass = redundant.override({"controller": SLIDING}), "cell.payload.mass"
    for call in (
        lambda: cp.sweep(base, {mass: [1.0, 2.0]}, out=tmp_path, execution=HERE),
        lambda: cp.tune(
            base, {mass: (1.0, 2.0)}, minimize="moving_position_rms_m", out=tmp_path, execution=HERE
        ),
    ):
        assert refused(FieldError, call).path == "controller.kind"
    for cell in SCENARIOS:
        require_feasible([scenario(cell, {"controller": SLIDING})])


@pytest.mark.parametrize("cell", ["planar", pytest.param("spatial", marks=pytest.mark.slow)])
def test_runs_of_which_one_can_succeed_are_not_refused(cell):
    sound, lost = scenario(cell), scenario(cell, AWAY)
    require_feasible([lost, sound])
    require_feasible([sound, lost])
    assert refused(InfeasibleMotionError, lambda: require_feasible([lost, lost])).cause == "reach"
    user = cp.UserController(target="nowhere:Law")
    require_feasible([scenario(cell).replace(controller=user)])  # its run reports it


def test_a_cell_of_a_comparison_that_must_fail_is_a_row_where_others_can_succeed(tmp_path):
    """A law with a trial that it alone refuses: its cell fails and the others run."""
    base = scenario("planar", {"sensors.wrist": {}, "controller.gains.anchor_gain": 0.6})
    laws = {"own": base.controller, "mine": cp.UserController(target="faulty:Faulty")}
    trials = {"nominal": {}, "late": {"sensors.wrist.delay": 3}}  # the anchor is unstable then
    table = cp.compare(base, laws, trials, out=tmp_path, execution=HERE).data
    assert table.finished.values.ravel().tolist() == [1, 0, 1, 1]


@NO_RUNS
@pytest.mark.parametrize("command", ["compare", pytest.param("tune", marks=pytest.mark.gate)])
def test_the_commands_refuse_in_one_line(command, tmp_path, capsys):
    file, words = tmp_path / "away.toml", {"compare": ["--controllers", "payload-pd", "--trials", "nominal"]}
    scenario("planar", AWAY).save(file)
    words["tune"] = ["--minimize", "moving_position_rms_m", "--vary", "cell.payload.mass", "1", "2"]
    assert main([command, str(file), *words[command], "--out", str(tmp_path / "out"), "--workers", "0"]) == 1
    assert "left" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
    with pytest.raises(NameNotFoundError):
        cp.compare("nope", ["payload-pd"], out=tmp_path / "out", execution=HERE)
