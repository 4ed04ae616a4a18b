"""Comparison of controllers: three controllers in two cells under four trials, resumed, and a stranger's."""

import dataclasses
import functools
import io
import json
import re
import shutil
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from cells import ANCHORED, SCENARIOS
from faulty import law
from numpy.testing import assert_allclose

import coop_pin as cp
from coop_pin.base.errors import (
    FieldError,
    FileReadError,
    InvalidStateError,
    NameNotFoundError,
    OutOfRangeError,
)
from coop_pin.cli import main
from coop_pin.comparison import (
    Trial,
    benchmark_scenario,
    controller_names,
    controllers_for,
    standard_trials,
    tick_costs,
    tune_controllers,
)
from coop_pin.comparison.controllers import stored_gains, t_lambda, tuned_ranges
from coop_pin.comparison.measures import measures
from coop_pin.comparison.table import COLUMNS
from coop_pin.comparison.trials import changes_of
from coop_pin.comparison.tuned_gains import tuned_trials
from coop_pin.compiled import engine_choice
from coop_pin.compiled.engine_choice import choose_engines
from coop_pin.figures import comparison_figure
from coop_pin.model_based import ArmDynamics
from coop_pin.sweeps.store import SweepStore
from coop_pin.sweeps.workers.job import Outcome

CONTROLLERS = ("printed", "anchored", "computed-torque")
TRIALS = ("nominal", "mass x2", "bias 1 mm", "noise")
SHORT = 0.3


@pytest.fixture(scope="module")
def scenarios():
    found = [SCENARIOS[name]().replace(controller=ANCHORED[name], name=name) for name in SCENARIOS]
    return [scenario.override({"clock.steps_per_tick": 1, "events": []}) for scenario in found]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("compare")


def page_data(page):
    """What a heat map shows."""
    return json.loads(re.search(r'id="data">(.*?)</script>', page)[1])


def run(scenarios, folder, **options):
    execution = cp.Execution(workers=0, quiet=True, **options)
    return cp.compare(
        scenarios, CONTROLLERS, TRIALS, out=folder, seeds=2, duration=SHORT, execution=execution
    )


@pytest.fixture(scope="module")
def table(scenarios, folder):
    return run(scenarios, folder)


@pytest.mark.gate
def test_a_run_that_failed_for_lack_of_time_is_repeated_on_request(scenarios, tmp_path):
    options = {"out": tmp_path, "duration": 0.05, "execution": cp.Execution(workers=0, quiet=True)}
    compared = functools.partial(cp.compare, scenarios[0], ["anchored"], ["nominal"], **options)
    first = compared().table
    store = SweepStore(next((tmp_path / scenarios[0].name).iterdir()))
    (record,) = store.records()
    late = dataclasses.replace(record, metrics={}, failure="RunTimeoutError", message="600 s")
    store.append([Outcome(late, None, b"", ())])
    assert compared().table["finished"].tolist() == [0]
    pd.testing.assert_frame_equal(compared(retry_failed=True).table, first)


def test_every_cell_says_how_many_runs_how_many_sound_and_kept_and_its_interval(table):
    data = table.data
    assert dict(data.sizes) == {"scenario": 2, "controller": 3, "trial": 4}
    assert data.trial.values.tolist() == list(TRIALS)
    random = np.array([name == "noise" for name in TRIALS])
    assert_allclose(data.runs.values, np.broadcast_to(np.where(random, 2, 1), data.runs.shape))
    assert (data.finished <= data.runs).all()
    assert (data.sound <= data.finished).all()
    assert (data.kept <= data.finished).all()
    low, middle, high = (data[f"tracking_rms_mm{end}"] for end in ("_low", "", "_high"))
    assert ((low <= middle) & (middle <= high)).all()
    assert (high > low).sel(trial="noise").any()
    assert_allclose((high - low).sel(trial="nominal"), 0.0)


def test_a_cell_is_the_run_that_it_names(table, scenarios):
    """The same run by itself, judged by the definition of the measure."""
    scenario = benchmark_scenario(scenarios[0], SHORT)
    changes = standard_trials(scenario)["bias 1 mm"].changes
    controller = controllers_for(scenarios[0], ["anchored"])["anchored"]
    result = cp.run(scenario, {"controller": controller} | changes, warn=False)
    late = result.data.time.values >= 0.4 * SHORT - 1e-9
    position = 1e3 * np.linalg.norm(result.data.pose_error.values[late, :3], axis=1)
    cell = table.data.sel(scenario=scenarios[0].name, controller="anchored", trial="bias 1 mm")
    assert_allclose(cell.tracking_rms_mm, np.sqrt(np.mean(position**2)), rtol=1e-12)


@pytest.mark.usefixtures("table")
def test_a_second_call_repeats_no_run_and_writes_the_same_bytes(scenarios, folder, runs_here):
    before = (folder / "comparison.csv").read_bytes()
    run(scenarios, folder)
    assert runs_here.jobs == []
    assert (folder / "comparison.csv").read_bytes() == before


def test_a_comparison_is_read_back_from_its_folder_and_opens_the_runs_of_its_cells(table, folder, tmp_path):
    found = cp.comparison.Comparison.load(folder)
    assert found.table.index.equals(table.table.index)
    assert_allclose(found.table[[*COLUMNS]], table.table[[*COLUMNS]], rtol=1e-8)
    found.write_csv(tmp_path / "again.csv")
    assert (tmp_path / "again.csv").read_bytes() == (folder / "comparison.csv").read_bytes()
    for scenario in ("planar", "spatial"):
        cell = found.data.sel(scenario=scenario, controller="anchored", trial="noise")
        runs = [measures(found.open(scenario, "anchored", "noise", seed=seed)) for seed in (0, 1)]
        for name in runs[0]:
            assert_allclose(np.median([run[name] for run in runs]), cell[name], rtol=1e-7)
    for wrong in (
        ("plana", "anchored", "noise"),
        ("planar", "anchred", "noise"),
        ("planar", "anchored", "nois"),
    ):
        with pytest.raises(NameNotFoundError):
            found.open(*wrong)
    with pytest.raises(OutOfRangeError):
        found.open("planar", "anchored", "noise", seed=2)
    with pytest.raises(InvalidStateError):
        cp.comparison.Comparison.load(tmp_path / "again.csv").open("planar", "anchored", "noise")


@pytest.mark.parametrize("content", [b"", b"a,b\n1,2\n", b"\xff\xfe", None, "twice", "word"])
def test_what_is_no_table_of_a_comparison_is_refused(content, table, tmp_path):
    path = tmp_path / "comparison.csv"
    if content is not None:
        table.write_csv(path)
        head, first, *_ = path.read_bytes().splitlines(keepends=True)
        odd = {"twice": head + first + first, "word": head + first.replace(b",1,1,", b",1,one,")}
        path.write_bytes(odd.get(content, content))
    with pytest.raises(FileReadError) as caught:
        cp.comparison.Comparison.load(tmp_path)
    assert caught.value.path == str(path)


@pytest.mark.usefixtures("table")
def test_the_command_writes_the_replay_of_a_cell_or_of_two_and_the_page_links_them(folder, capsys):
    cells = ["spatial | anchored | bias 1 mm", "planar | printed | noise | 1"]
    assert main(["compare", "--out", str(folder), "--replay", *cells]) == 0
    names = page_data((folder / "comparison.html").read_text())["replays"]
    assert names == ["spatial-anchored-bias-1-mm--planar-printed-noise-1.html"]
    assert str(folder / "replays" / names[0]) in capsys.readouterr().out
    for wrong in ("spatial | anchored", "spatial | anchored | noise | first", "spatial | anchred | noise"):
        assert main(["compare", "--out", str(folder), "--replay", wrong]) == 2


@pytest.mark.usefixtures("table")
def test_the_runs_of_others_are_taken_over_by_their_keys(scenarios, folder, tmp_path, runs_here):
    """Nothing is run again but what a damaged line held, and the table has the same bytes."""
    before = (folder / "comparison.csv").read_bytes()
    others = [tmp_path / name for name in ("first", "second")]
    for other in others:  # each has done one scenario
        shutil.copytree(folder, other)
        shutil.rmtree(other / {"first": "spatial", "second": "planar"}[other.name])
    assert "#" in run(scenarios, tmp_path / "merged", merge=others).summary()
    assert runs_here.jobs == []
    merged = pd.read_csv(tmp_path / "merged" / "comparison.csv")
    assert (merged["merged"] == merged["runs"]).all()
    assert merged.assign(merged=0).to_csv() == pd.read_csv(io.BytesIO(before)).to_csv()

    segment = next((others[0] / "planar" / "fixed" / "runs").iterdir())
    content = bytearray(segment.read_bytes())
    content[content.index(b"tracking_rms_mm") + 20] ^= 1
    segment.write_bytes(content)
    run(scenarios, tmp_path / "repaired", merge=others)
    assert len(runs_here.jobs) == 1
    repaired = pd.read_csv(tmp_path / "repaired" / "comparison.csv")
    assert (repaired["runs"] - repaired["merged"]).sum() == 1
    assert repaired.assign(merged=0).to_csv() == pd.read_csv(io.BytesIO(before)).to_csv()


@pytest.mark.usefixtures("table")
def test_runs_of_another_plan_are_not_taken_and_other_folders_are_refused(scenarios, folder, tmp_path):
    names = ["anchored"], ["nominal"]
    here = cp.Execution(workers=0, quiet=True)
    merging = dataclasses.replace(here, merge=[folder])
    found = cp.compare(scenarios[0], *names, out=tmp_path, duration=0.1, execution=merging)
    alone = cp.compare(scenarios[0], *names, out=tmp_path / "alone", duration=0.1, execution=here)
    assert found.data.identical(alone.data)
    assert "#" not in found.summary()
    assert repr(found) == found.summary()
    merging = dataclasses.replace(here, merge=[folder, tmp_path / "nothing"])
    with pytest.raises(FileReadError) as caught:
        cp.compare(scenarios, *names, out=tmp_path, execution=merging)
    assert caught.value.path == str(tmp_path / "nothing")


@pytest.mark.gate
def test_what_can_be_runs_in_batches_and_gives_the_same_table(scenarios, tmp_path, monkeypatch):
    """A law that can be traced, with noise and without; one that calls Pinocchio runs singly beside it."""
    monkeypatch.setattr(engine_choice, "_TICKS_PER_JOINT", 1)  # else too few ticks for a batch
    names, trials = ["computed-torque", "anchored"], ["noise", "nominal"]
    quick, execution = {"duration": 0.1, "seeds": 2}, functools.partial(cp.Execution, 0, None, quiet=True)
    single, auto = (
        cp.compare(scenarios[0], names, trials, out=tmp_path / engine, execution=execution(engine), **quick)
        for engine in ("pinocchio", "auto")
    )
    for name in COLUMNS:
        assert_allclose(auto.data[name], single.data[name], rtol=1e-9, atol=1e-12)
    assert auto.table.index.tolist() == single.table.index.tolist()
    kept = {part.name: SweepStore(part) for part in (tmp_path / "auto" / "planar").iterdir()}
    assert set(kept) == {"fixed", "fixed-lanes", "random", "random-lanes"}
    for name, store in kept.items():
        engine = "compiled" if name.endswith("lanes") else "pinocchio"
        assert store.read_plan().engine == engine
        assert {record.engine for record in store.records()} == {engine}
    with pytest.raises(FieldError):
        cp.compare(scenarios[0], names, trials, out=tmp_path, execution=cp.Execution(engine="both"), **quick)
    again = cp.compare(
        scenarios[0], names, trials, out=tmp_path / "pinocchio", execution=execution(None), **quick
    )
    assert again.data.identical(single.data)
    assert {part.name for part in (tmp_path / "pinocchio" / "planar").iterdir()} == {"fixed", "random"}


@pytest.fixture(scope="module")
def searched(scenarios, tmp_path_factory):
    """Scenarios, planar and in space, with the folder and the rows of one search for gains in both."""
    softer = scenarios[1].override({"controller.gains.sliding_gain": [300.0] * 3 + [8.0] * 3})
    folder = tmp_path_factory.mktemp("search")
    rows = tune_controllers(
        [scenarios[0], softer],
        ["payload-pd"],
        out=folder,
        generations=0,
        duration=0.05,
        execution=cp.Execution(workers=0, quiet=True),
    )
    return [scenarios[0], softer], folder, rows


@pytest.mark.slow
def test_a_search_covers_several_scenarios_and_its_table_is_used_and_marked(searched, tmp_path):
    (_, scenario), folder, rows = searched
    names = ["payload-pd", "printed"]
    assert [row["scenario"] for row in rows] == ["planar", "spatial"]
    assert all(row["runs"] == 24 and row["duration_s"] == 0.05 for row in rows)
    gains = tmp_path / "gains.csv"
    shutil.copy(folder / "gains.csv", gains)
    chosen = controllers_for(scenario, names, gains=gains)
    assert chosen["payload-pd"]["gains"]["pose_gain"] == float(rows[1]["value"])
    quick = {"duration": 0.02, "execution": cp.Execution(workers=0, quiet=True)}
    found = cp.compare(scenario, names, ["nominal"], out=tmp_path / "out", gains=gains, **quick)
    assert found.table["gains"].tolist() == ["tuned", "untuned"]
    assert "printed (untuned)" in found.summary()
    gains.write_text(gains.read_text().replace("pose_gain", "pose_gian"))
    with pytest.raises(FileReadError):
        controllers_for(scenario, names, gains=gains)


@pytest.mark.slow
def test_gains_beyond_the_sampled_bound_are_not_taken(scenarios, tmp_path):
    """K of the spatial cell has T lambda over 1 along the motion, whatever the pose gain."""
    execution = cp.Execution(workers=0, quiet=True)
    none = tune_controllers(
        scenarios[1], ["payload-pd"], out=tmp_path, generations=0, size=2, duration=0.02, execution=execution
    )
    assert none == []
    law = controllers_for(scenarios[1], ["payload-pd"], tuned=False)["payload-pd"]
    assert t_lambda(scenarios[1].override({"controller": law})) > 1.0


def test_ranks_are_those_of_the_table_and_lie_in_their_intervals(table):
    ranks = table.ranks("tracking_rms_mm")
    values = table.data.tracking_rms_mm.transpose("controller", "scenario", "trial").values.reshape(3, -1)
    rank_of = [[np.sum(column < x) + (np.sum(column == x) + 1) / 2 for x in column] for column in values.T]
    expected = np.array(rank_of)
    assert_allclose(ranks.loc[list(CONTROLLERS), "rank"], expected.mean(axis=0))
    assert ((ranks["low"] <= ranks["rank"]) & (ranks["rank"] <= ranks["high"])).all()
    with pytest.raises(NameNotFoundError):
        table.ranks("speed")


def test_the_page_and_the_figures_show_every_cell_and_load_nothing(table, folder):
    page = (folder / "comparison.html").read_text()
    cells = page_data(page)
    assert len(cells["unsound"]) == table.table.shape[0]
    by_text = {measure["text"]: measure for measure in cells["measures"]}
    assert [measure["force"] for measure in cells["measures"]] == [True] * 2 + [False] * (len(COLUMNS) - 2)
    assert np.array(cells["wanted"], float) == pytest.approx(10.0, rel=0.5)  # every cell's squeeze is known
    for name, text in COLUMNS.items():
        measure = by_text[text]
        values = table.table[name].to_numpy()
        assert_allclose(np.array(measure["values"], float), np.where(np.isinf(values), np.nan, values), 1e-4)
    assert "http" not in page
    figure = comparison_figure(table, "planar")
    front, ranks, tracking, force = figure.axes[:4]
    assert front.lines[0].get_xdata().size == len(CONTROLLERS)
    classes = zip(table.labels("planar"), table.information("planar"), strict=True)
    assert {text.get_text() for text in front.texts} == {f"{name}: {seen}" for name, seen in classes}
    assert {"blind", "internal wrench", "model, internal wrench"} == set(table.information("planar"))
    order = table.ranks().index.tolist()
    assert [text.get_text() for text in ranks.get_yticklabels()] == order
    assert len(tracking.texts) == len(force.texts) == len(CONTROLLERS) * len(TRIALS)
    values = (
        table.data.tracking_rms_mm.sel(scenario="planar", controller=order).transpose(..., "trial").values
    )
    shown = [float(text.get_text().rstrip("*†")) for text in tracking.texts]
    assert_allclose(shown, values.ravel(), rtol=0.06)
    with pytest.raises(FieldError):
        comparison_figure(table, "nowhere")


def test_a_model_knows_nothing_of_the_trials(scenarios):
    """Masses change by an event, friction behind the model's back."""
    scenario = benchmark_scenario(scenarios[1], SHORT)
    trials = standard_trials(scenario)
    assert not any("payload.mass" in path for trial in trials.values() for path in trial.changes)
    arm = next(iter(scenario.cell.arms))
    controller = controllers_for(scenario, ["computed-torque"])["computed-torque"]
    nominal = ArmDynamics(scenario, arm).parameters()[0]
    for name in ("friction x0", "friction x3", "mass x2"):
        changed = scenario.override(changes_of(scenario, trials[name], controller))
        known = ArmDynamics(changed, arm, changed.controller.model).parameters()[0]
        assert_allclose(known, nominal, rtol=1e-9)
        truth = ArmDynamics(changed, arm).parameters()[0]
        assert (name == "mass x2") == np.allclose(truth, nominal)


def test_a_strangers_class_and_trial_join_and_a_run_that_fails_is_counted(scenarios, tmp_path, monkeypatch):
    (tmp_path / "strange_law.py").write_text(STRANGE)
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.chdir(tmp_path)
    stiff = {"kind": "user", "target": "strange_law:Spring", "options": {"k": 1e9}}
    own = {"mine": "strange_law:Spring", "stiff": stiff}
    found = cp.compare(
        scenarios[0],
        own,
        {"calm": {}, "tilted": Trial({"cell.gravity": [1.0, 0.0, 0.0]})},
        out=tmp_path / "out",
        duration=SHORT,
        execution=cp.Execution(workers=0, quiet=True),
    )
    assert found.data.finished.sel(controller="mine").values.tolist() == [[1, 1]]
    assert found.data.finished.sel(controller="stiff").values.tolist() == [[0, 0]]
    assert np.isinf(found.data.tracking_rms_mm.sel(controller="stiff")).all()
    assert found.table.shape[0] == 4
    assert found.table.loc[(scenarios[0].name, "stiff"), "failure"].str.startswith("DivergedError: ").all()
    assert "stiff failed in calm, tilted (2 of 2 runs): DivergedError" in found.summary()
    assert (found.table.loc[(scenarios[0].name, "mine"), "failure"] == "").all()


def test_a_class_that_fails_when_it_is_built_ends_its_own_run_and_not_the_comparison(scenarios):
    """The engine is chosen by building it; the run reports the error."""
    (choice,) = choose_engines([scenarios[0].override(law("none", marker=3))], "auto", [10**6])
    assert (choice.engine, choice.obstacle) == ("pinocchio", "scenario")


STRANGE = """
import numpy as np
import coop_pin as cp

class Spring(cp.ArmController):
    def __init__(self, scenario, arm, k=300.0):
        self.rows, self.k = scenario.cell.task_rows, k
    def init(self, measurement, reference):
        return None
    def step(self, measurement, reference, state):
        error = self.rows.pose_error(measurement.payload_pose, reference.pose)
        return cp.ArmCommand(-measurement.payload_jacobian.T @ (self.k * error), state)
"""


def test_the_command_writes_tables_and_figures_and_lists_names(tmp_path, capsys):
    words = ["compare", "adept-anchored", "--controllers", "payload-pd", "--trials", "nominal", "push"]
    words += ["--duration", "0.5", "--out", str(tmp_path), "--workers", "0"]
    assert main(words) == 0
    assert "payload-pd" in capsys.readouterr().out
    for name in ("comparison.csv", "comparison.html", "adept-anchored/comparison.png"):
        assert (tmp_path / name).stat().st_size > 300
    other = [*words[: words.index("--out")], "--out", str(tmp_path / "other"), "--merge", str(tmp_path)]
    assert main([*other, "--workers", "0", "--quiet"]) == 0
    tables = [pd.read_csv(place / "comparison.csv") for place in (tmp_path, tmp_path / "other")]
    assert [table.pop("merged").tolist() for table in tables] == [[0, 0], [1, 1]]
    assert tables[0].equals(tables[1])
    assert main([*words, "--list"]) == 0
    assert "push" in capsys.readouterr().out


def test_names_that_do_not_exist_are_refused(scenarios, tmp_path):
    for controllers, trials in ((["printd"], None), (["printed"], ["nominel"])):
        with pytest.raises(NameNotFoundError):
            cp.compare(scenarios, controllers, trials, out=tmp_path, execution=cp.Execution(quiet=True))
    for wrong in ({"controllers": {"mine": 3}}, {"controllers": []}, {"trials": []}, {"scenarios": []}):
        given = {"scenarios": scenarios, "controllers": ["printed"], "trials": ["nominal"]} | wrong
        with pytest.raises(FieldError):
            cp.compare(**given, out=tmp_path, execution=cp.Execution(quiet=True))
    with pytest.raises(FieldError):
        cp.compare(
            [scenarios[0], scenarios[0]], ["printed"], out=tmp_path, execution=cp.Execution(quiet=True)
        )


SHARED = {"dead-zone": "payload-pi", "computed-torque-wrong-model": "computed-torque"}


def test_stored_gains_name_fields_of_known_controllers_within_their_ranges():
    names = set(controller_names())
    for scenario in cp.scenario_names():
        for controller, gains in stored_gains(scenario).items():
            ranges = tuned_ranges(SHARED.get(controller, controller))
            assert controller in names
            assert set(gains) == set(ranges)
            assert all(ranges[field][0] <= value <= ranges[field][1] for field, value in gains.items())


@pytest.mark.gate
def test_the_cost_of_gains_is_the_mean_of_the_runs_of_four_trials(scenarios, tmp_path):
    short = {"duration": 0.05, "execution": cp.Execution(workers=0, quiet=True)}
    (row,) = tune_controllers(scenarios[0], ["payload-pd"], out=tmp_path, generations=0, **short)
    scenario = benchmark_scenario(scenarios[0], 0.05)
    law = controllers_for(scenario, ["payload-pd"], gains=tmp_path / "gains.csv")["payload-pd"]
    trials = [standard_trials(scenario)[name].changes for name in tuned_trials(scenario)]
    fields = {"controller": law, "seed": row["seed"]}
    runs = [measures(cp.run(scenario, fields | changes, warn=False)) for changes in trials]
    wanted = sum(m["tracking_rms_mm"] + np.hypot(m["axial_rms_N"], m["shear_rms_N"]) for m in runs) / 4
    assert_allclose(float(row["cost"]), wanted, rtol=1e-4)  # gains are written with six digits


@pytest.mark.parametrize(
    ("name", "loss"),
    [
        ("adept-anchored", "torque of an arm lost"),
        ("kinova-pair", "torque of an arm lost"),
        ("two-pandas-box", "commands of an arm lost"),
        ("panda-ur5-bar", "commands of an arm lost"),
    ],
)
def test_a_search_loses_an_arm_that_the_others_can_replace(name, loss):
    """Two Pandas, or Panda and UR5, cannot hold the payload with a limp arm, but with one that stands."""
    trials = tuned_trials(benchmark_scenario(cp.Scenario.load(name)))
    assert trials == ["noise", "bias 1 mm", "mass x0.5", loss]


def test_costs_are_ratios_and_say_what_a_controller_needs(scenarios):
    names = ["payload-pd", "computed-torque", "leader-follower", "adaptive-verginis"]
    table = tick_costs(scenarios[0], names)
    assert table.loc["payload-pd", "ratio"] == 1.0
    assert table.loc["computed-torque", "ratio"] > 1.0
    assert (table["operations"] > 100).tolist() == [True, False, True, False]  # blind laws can be exported
    assert (table["not_counted"] == "").tolist() == [True, False, True, False]
    wanted = ["holding torque", "model, internal wrench", "own wrench, role", "regressor"]
    assert table["needs"].tolist() == wanted


@pytest.mark.slow
@pytest.mark.parametrize("name", ["adept-anchored", "two-pandas-box", "three-ur5-plate"])
def test_every_controller_runs_in_every_kind_of_cell(name, tmp_path):
    """Planar, redundant and with three arms: nominal, 1 s at rest and 1 s in motion."""
    names = controller_names()
    found = cp.compare(
        name, names, ["nominal"], out=tmp_path, duration=2.0, execution=cp.Execution(workers=0, quiet=True)
    )
    print(found.summary())
    assert (found.data.finished == 1).all()
    assert (found.data.tracking_rms_mm < 100.0).all()


@pytest.mark.parametrize("name", ["adept-anchored", "two-pandas-box"])
def test_the_template_of_the_page_runs_in_a_cell_of_any_kind(name, tmp_path, monkeypatch):
    """Its gains suit translations and rotations at 80 Hz and at 500 Hz."""
    page = (Path(__file__).parents[2] / "docs" / "howto" / "controller.md").read_text(encoding="utf-8")
    (code,) = (block for block in re.findall(r"```python\n(.*?)```", page, re.DOTALL) if "class Law" in block)
    assert len(code.strip().splitlines()) <= 25
    (tmp_path / "template_law.py").write_text(code)
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.chdir(tmp_path)
    quick = {"duration": 0.2, "execution": cp.Execution(workers=0, quiet=True)}
    found = cp.compare(name, {"mine": "template_law:Law"}, ["nominal"], out=tmp_path, **quick)
    assert found.data.sound.item() == 1
    assert found.table["gains"].item() == "given"


@pytest.mark.slow
def test_palms_hold_or_drop_the_payload_and_the_table_says_which(tmp_path):
    """Two planar arms, whose grasps are on faces of the bar: enough squeeze, and half of the least."""
    scenario = cp.Scenario.load("adept-anchored", {"duration": 0.35, "events": ()})
    scenario = scenario.replace(motion=cp.motions.HoldMotion(pose=scenario.start))
    palms = standard_trials(benchmark_scenario(scenario))["held by palms"].changes
    assert {grasp["kind"] for grasp in palms["cell.grasps"].values()} == {"patch"}
    least = 11.2 * 9.81 / (2.0 * 0.6)
    assert_allclose(palms["squeeze"]["wrenches"]["right"][0], 1.5 * least, rtol=2e-3)
    slack = {arm: (sign * least / 2.0, *5 * (0.0,)) for arm, sign in (("left", -1.0), ("right", 1.0))}
    trials = {"palms": palms, "slack": palms | {"squeeze": {"kind": "constant", "wrenches": slack}}}
    found = cp.compare(
        scenario, ["printed"], trials, out=tmp_path, execution=cp.Execution(workers=0, quiet=True)
    )
    assert found.data.dropped.values.ravel().tolist() == [0, 1]
    assert found.summary().count("dropped") == 1
    page = page_data((tmp_path / "comparison.html").read_text(encoding="utf-8"))
    assert page["notes"]["dropped"]["texts"] == ["0", "1"]
    assert "held by palms" not in standard_trials(benchmark_scenario(cp.Scenario.load("two-pandas-box")))


@pytest.mark.parametrize("name", ["adept-anchored", "two-pandas-box"])
def test_the_dead_zone_has_the_gains_of_the_law_from_which_it_differs_by_its_zone_alone(name, tmp_path):
    scenario = cp.Scenario.load(name)
    laws = controllers_for(scenario, ["payload-pi", "dead-zone"])
    law, without = (
        scenario.override({"controller": laws[name]}).controller for name in ("dead-zone", "payload-pi")
    )
    assert law.integral_dead_zone == (1.2e-3, 2.4e-3)
    assert law.beyond_dead_zone.gains == without.gains.replace(anchor_gain=law.gains.anchor_gain)
    assert law.beyond_dead_zone.replace(gains=without.gains) == without
    assert tuned_ranges("dead-zone") == {}
    header = "scenario,controller,field,value\n"
    (tmp_path / "gains.csv").write_text(f"{header}{name},payload-pi,gains.pose_gain,3.5\n")
    kept = controllers_for(scenario, ["dead-zone"], gains=tmp_path / "gains.csv")
    assert kept["dead-zone"]["gains"]["pose_gain"] == 3.5


@pytest.mark.parametrize("name", ["adept-anchored", "two-pandas-box"])
def test_the_wrong_model_differs_from_the_exact_one_by_its_model_alone(name):
    exact, wrong = controllers_for(
        cp.Scenario.load(name), ["computed-torque", "computed-torque-wrong-model"]
    ).values()
    assert exact["model"] == {}
    assert wrong["model"] == {"mass": 1.2, "inertia": 1.2, "friction": 0.5}
    assert wrong | {"model": {}} == exact
    assert tuned_ranges("computed-torque-wrong-model") == {}
