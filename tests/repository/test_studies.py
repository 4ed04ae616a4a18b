"""The studies: their plans, and that their figures and numbers are those of their sweeps."""

import re
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose
from page_texts import require_numbers
from tiers import by_default

import coop_pin as cp
from coop_pin.comparison import Comparison, controller_names, tick_costs
from coop_pin.control import force_gain_bound
from coop_pin.stability.loop_stability import LEAST_DAMPING

FOLDER = Path(__file__).parents[2] / "studies"
CONCEPTS = FOLDER.parent / "docs" / "concepts"
BENCHMARK, TABLES, FRONT = (
    (FOLDER.parent / "docs" / "studies" / name).read_text(encoding="utf-8")
    for name in ("benchmark.md", "benchmark-tables.md", "front.md")
)
ERROR, ALPHA = "settled_axial_rms_error_N", "controller.gains.sign_gain"
COUNTS = {
    "force_gain": {"force_gain": 114},
    "payload": {"with_sign": 36, "without_sign": 36},
    "bias": {"law": 30, "sign": 8},
    "one_millimetre": {"one_millimetre": 4},
}


@pytest.fixture(scope="module")
def draw():
    """studies/draw.py, as its command loads it."""
    before = set(sys.modules)
    sys.path.insert(0, str(FOLDER))
    import draw

    yield draw
    sys.path.remove(str(FOLDER))
    for name in set(sys.modules) - before:
        if str(FOLDER) in str(getattr(sys.modules[name], "__file__", "")):
            del sys.modules[name]


def shortened(plan):
    """The first two values of each field, in runs just long enough to have a steady window."""
    short = {"duration": 4.2}
    axes = {
        field: (4.1, 4.2) if field == "duration" else (values[0], values[-1])
        for field, values in plan.axes.items()
    }
    zipped = tuple({field: values[:2] for field, values in group.items()} for group in plan.zipped)
    return plan.replace(
        axes=axes, zipped=zipped, changes=plan.changes if "duration" in plan.axes else plan.changes | short
    )


@pytest.fixture(scope="module")
def tiny(draw, tmp_path_factory):
    """The sweeps of a study with few and short runs, made when asked for."""
    known = {}

    def results(name):
        if name not in known:
            folder = tmp_path_factory.mktemp(name)
            known[name] = {
                part: cp.sweep(
                    shortened(plan), out=folder / part, execution=cp.Execution(workers=0, quiet=True)
                )
                for part, plan in draw.plans(name).items()
            }
        return known[name]

    return results


def test_every_file_is_a_plan_of_a_study_and_counts_what_the_readme_says(draw):
    assert {
        name: {part: len(plan) for part, plan in draw.plans(name).items()} for name in draw.STUDIES
    } == COUNTS
    assert len(list(FOLDER.rglob("*.toml"))) == sum(map(len, COUNTS.values()))
    readme = (FOLDER / "README.md").read_text()
    assert "114 runs" in readme
    assert set(re.findall(r"python studies/draw.py (\w+)", readme)) == set(COUNTS)


def test_every_point_of_every_plan_is_a_scenario(draw):
    for name in COUNTS:
        for plan in draw.plans(name).values():
            for number in range(len(plan)):
                assert plan.scenario(number).events == ()


@pytest.mark.parametrize(
    "name",
    by_default(COUNTS, "force_gain", others=pytest.mark.slow),
)
def test_the_command_runs_says_and_draws_a_study(draw, tiny, tmp_path, monkeypatch, capsys, name):
    results = tiny(name)
    assert all(result.counts()["missing"] == 0 for result in results.values())
    monkeypatch.setattr(draw, "run", lambda *_: results)
    monkeypatch.setattr(draw, "IMAGES", tmp_path)
    monkeypatch.setattr(sys, "argv", ["draw.py", name])
    draw.main()
    assert capsys.readouterr().out.endswith(draw.STUDIES[name].numbers(results) + "\n")
    image = draw.STUDIES[name].image
    assert (FOLDER.parent / "docs" / "images" / f"{image}.png").is_file()
    assert sorted(path.name for path in tmp_path.iterdir()) == [f"{image}.png"]


def test_another_name_is_answered_with_those_there_are(draw, monkeypatch):
    monkeypatch.setattr(sys, "argv", ["draw.py", "nothing"])
    with pytest.raises(SystemExit, match=r"force_gain \| payload \| bias \| one_millimetre"):
        draw.main()


def test_finished_runs_of_a_study_are_kept_by_sweep(draw, tmp_path, monkeypatch):
    monkeypatch.setattr(
        draw,
        "plans",
        lambda _: {"a": cp.SweepPlan(base="adept-paper", changes={"duration": 0.1, "events": []})},
    )
    (result,) = draw.run("name", tmp_path).values()
    assert result.counts()["ok"] == 1
    assert cp.SweepResult.load(tmp_path / "a").counts() == result.counts()


# ---------------------------------------------------------------- the front


@pytest.fixture(scope="module")
def front(draw):
    """studies/front.py, from the folder that the fixture draw has put on the path."""
    assert draw.HERE == FOLDER
    import front

    return front


def test_the_front_judges_every_law_in_every_trial_after_tuning_with_one_budget(front):
    tables = {name: front.front_figures.read(front.DATA, name) for name in ("gains", "tuning", "judged")}
    for cell_name, cell in front.CELLS.items():
        gains, tuning, judged = (table[table["cell"] == cell_name] for table in tables.values())
        assert set(tuning.groupby("law").size()) == {front.SIZE * (front.GENERATIONS + 1)}
        trials = front.trials(cell, Path("heavy.urdf"))
        expected = {
            (law, trial)
            for law in set(judged["law"])
            for trial in trials
            if front.LAWS[law].senses or not trials[trial].wrist
        }
        assert sorted(zip(judged["law"], judged["trial"], strict=True)) == sorted(expected)
        random = [trials[trial].random for trial in judged["trial"]]
        assert_allclose(judged["runs"] > 1, random)
        assert sorted(zip(gains["law"], gains["field"], strict=True)) == sorted(
            (name, field) for name in set(judged["law"]) for field, *_ in front.LAWS[name].tuned
        )
        assert ((gains["low"] <= gains["value"]) & (gains["value"] <= gains["high"])).all()
        assert front.front_figures.table(judged, cell_name) in FRONT
    assert front.front_figures.gains_table(tables["gains"]) in FRONT


def test_every_trial_of_the_front_changes_the_scenario_of_every_law(front, tmp_path):
    for cell in front.CELLS.values():
        trials = front.trials(cell, front.doubled(cell.urdf, tmp_path))
        for law in front.LAWS.values():
            plain = cp.Scenario.load(cell.base, cell.changes | {"controller": law.controller(cell)})
            for name, trial in trials.items():
                assert (plain.override(trial.changes) == plain) == (name == "nominal")


@pytest.mark.gate
def test_the_front_is_drawn_from_its_tables(front, tmp_path):
    names = ("study-front", "study-front-adept", "study-front-panda")
    assert {path.name for path in front.front_figures.draw(front.DATA, tmp_path)} == {
        f"{name}.png" for name in names
    }
    assert_allclose(
        front.front_figures.pareto(np.array([[2.0, 1.0], [1.0, 3.0], [3.0, 2.0], [4.0, 0.5]])),
        [[1.0, 3.0], [2.0, 1.0], [4.0, 0.5]],
    )


@pytest.mark.slow
@pytest.mark.parametrize("law", ["printed, tuned, alpha 0", "printed, tuned", "anchored"])
def test_a_row_of_the_front_is_what_its_command_finds(front, tmp_path, law):
    gains, judged = (front.front_figures.read(front.DATA, name) for name in ("gains", "judged"))
    mine = gains[(gains["cell"] == "adept") & (gains["law"] == law)]
    trial = front.trials(front.CELLS["adept"], tmp_path)["bias 1 mm"]
    tuned = dict(zip(mine["field"], mine["value"], strict=True))
    row = front.medians(front.CELLS["adept"], front.LAWS[law], tuned, trial, 1, tmp_path)
    kept = judged[(judged["cell"] == "adept") & (judged["law"] == law) & (judged["trial"] == "bias 1 mm")]
    for measure in front.MEASURES:
        assert_allclose(row[measure], kept[measure].item(), rtol=1e-3)


# ---------------------------------------------------------------- what they say


def test_the_map_of_force_gains_has_the_bound_of_theory_and_says_the_boundary(draw, tiny):
    results = tiny("force_gain")
    panel = draw.STUDIES["force_gain"].figure(results).axes[0]
    (bound,) = [line for line in panel.lines if line.get_linestyle() == "--"]
    assert_allclose(bound.get_ydata(), [force_gain_bound(p) for p in bound.get_xdata()])
    assert [text.get_text() for text in panel.get_legend().get_texts()] == ["failed", bound.get_label()]
    _, *rows = draw.STUDIES["force_gain"].numbers(results).splitlines()
    edges = results["force_gain"].stability_boundary("controller.gains.force_gain")
    found = np.array([[float(word) for word in row.split()] for row in rows])
    assert_allclose(found[:, 0], [0.0, 0.9])
    assert_allclose(found[:, 1], [1.0, 19.0])
    assert_allclose(found[:, 2], edges["last_stable"].values)
    assert_allclose(found[:, 3], edges["first_unstable"].values)


def test_the_growth_at_the_last_stable_gain_is_said_where_there_are_two(draw, tmp_path):
    (plan,) = draw.plans("force_gain").values()
    axes = {"controller.force_path.pole": [0.0], "controller.gains.force_gain": [0.25, 0.5, 2.0]}
    result = cp.sweep(
        plan.replace(axes=axes, changes=plan.changes | {"duration": 4.2}),
        out=tmp_path,
        execution=cp.Execution(workers=0, quiet=True),
    )
    errors = result.values(ERROR).values.ravel()
    (row,) = draw.STUDIES["force_gain"].numbers({"force_gain": result}).splitlines()[1:]
    assert_allclose(
        [float(word) for word in row.split()], [0.0, 1.0, 0.5, 2.0, errors[1] / errors[0]], atol=0.05
    )


@pytest.mark.gate
def test_the_bias_tables_hold_every_line_of_the_figure_and_every_run_with_sgn(draw, tiny):
    results = tiny("bias")
    by_law, by_rate = (results[part].values(ERROR) for part in ("law", "sign"))
    head, *rows = draw.STUDIES["bias"].numbers(results).splitlines()
    assert [float(word) for word in head.split()[-2:]] == [4.1, 4.2]
    assert rows.pop(6) == head
    expected = np.vstack(
        [by_law.values.reshape(-1, 2), by_rate.transpose(..., "duration").values.reshape(-1, 2)]
    )
    for row, line in zip(rows, expected, strict=True):
        assert_allclose([float(word) for word in row.split()[-2:]], line, atol=5e-4)
    curves = [
        line
        for line in draw.STUDIES["bias"].figure(results).axes[0].lines
        if len(line.get_xdata()) == 2 and line.get_fillstyle() != "none"
    ]
    assert_allclose([line.get_ydata() for line in curves], by_law.values.reshape(-1, 2))


@pytest.mark.gate
def test_the_payload_numbers_are_means_and_spreads_over_the_masses(draw, tiny):
    results = tiny("payload")
    said = draw.STUDIES["payload"].numbers(results)
    for part in ("without_sign", "with_sign"):
        error = results[part].values(ERROR).values
        mean, low, high = error.mean(axis=0), error.min(axis=0), error.max(axis=0)
        for i, friction in enumerate((0.01, 0.03)):
            assert f"{friction:5g} N m: mean {mean[i]:.3f} N, {low[i]:.3f} .. {high[i]:.3f}" in said
        ratios = [error[0] / error[1], error[:, 0] / error[:, 1]]
        assert f"neighbours differ by up to {np.exp(np.abs(np.log(ratios)).max()):.1f}" in said
    mesh = draw.STUDIES["payload"].figure(results).axes[0].collections[0].get_array()
    assert_allclose(mesh.compressed(), results["without_sign"].values(ERROR).values.T.ravel())


# ---------------------------------------------------------------- costs, and the claims of the paper


@pytest.fixture(scope="module")
def claims(draw):
    """studies/paper_claims.py, and its tables as stored."""
    assert draw.HERE == FOLDER
    import paper_claims

    tables = {path.stem: pd.read_csv(path) for path in paper_claims.DATA.glob("*.csv")}
    return paper_claims, tables


def test_pages_hold_the_tables_of_stored_data(claims):
    study, tables = claims
    from pages import with_block

    for (page, name), block in study.blocks(tables).items():
        text = page.read_text(encoding="utf-8")
        assert with_block(text, name, block) == text
    import costs

    assert with_block(TABLES, "costs", costs.table(pd.read_csv(costs.DATA))) == TABLES
    with pytest.raises(ValueError, match="no such block"):
        with_block(TABLES, "no such block", "")


@pytest.mark.usefixtures("draw")
def test_operations_of_the_page_are_those_of_the_laws():
    import costs

    stored = pd.read_csv(costs.DATA).set_index(["joints", "controller"])
    names = ["printed", "anchored", "computed-torque"]
    counted = tick_costs(cp.Scenario.load(costs.CELLS[3]), names)["operations"]
    assert_allclose(counted, stored.loc[3].loc[names, "operations"])


@pytest.mark.usefixtures("draw")
def test_the_benchmark_has_every_controller_and_the_page_says_how_many_runs():
    import benchmark

    table = pd.read_csv(benchmark.DATA)
    cells = table.groupby(["scenario", "trial"])["controller"].agg(set)
    assert (cells == {*controller_names()}).all()
    assert (table["gains"] == "tuned").all()
    assert table["trial"].nunique() >= 12
    runs, finished = (table[name].sum() for name in ("runs", "finished"))
    counts = re.search(r"(\d+) runs of .*, (\d+) finished", BENCHMARK)
    assert [int(count) for count in counts.groups()] == [runs, finished]


(T_LAMBDA,) = re.findall(
    r"\(sampled damping holds below 2\):\n\n(.*?)\n\nSmallest damping ratio", TABLES, re.DOTALL
)
(DAMPING,) = re.findall(r"counts as no integral\):\n\n(.*?)\n\n<!-- end of tables", TABLES, re.DOTALL)
"""T lambda and damping ratio of every controller in every cell, as the page has them."""


@pytest.mark.usefixtures("draw")
def test_the_text_of_the_benchmark_is_that_of_its_table(monkeypatch):
    """But for T lambda and damping ratios, which the next test computes."""
    import benchmark
    from pages import with_block

    tables = {benchmark.t_lambda: T_LAMBDA, benchmark.payload_damping: DAMPING}
    monkeypatch.setattr(benchmark, "stability", lambda *arguments: tables[arguments[-1]])
    text = benchmark.text(Comparison.load(benchmark.DATA), None)
    assert with_block(BENCHMARK, "benchmark", text) == BENCHMARK
    assert with_block(TABLES, "tables", benchmark.tables(Comparison.load(benchmark.DATA))) == TABLES
    assert with_block(TABLES, "printed", benchmark.printed(benchmark.tuned_cells())) == TABLES


@pytest.mark.usefixtures("draw")
def test_verdicts_and_engines_are_stored_when_all_rows_have_them(monkeypatch, tmp_path):
    import benchmark

    kept = Comparison.load(benchmark.DATA)
    new = Comparison.of_cells(kept.table.head(1).assign(sound=1.0, kept=1.0, engine="compiled"))
    monkeypatch.setattr(benchmark, "DATA", tmp_path / "benchmark.csv")
    names = {"sound", "kept", "engine"}
    for table, stored in ((new, names), (benchmark.merged(kept, new), set())):
        benchmark.store(table)
        assert names & set(pd.read_csv(benchmark.DATA)) == stored


def numbers_of(table):
    """A table of stability: a row for each controller, a column for each cell."""
    head, _, *rows = ([word.strip("` ") for word in line.split("|")[1:-1]] for line in table.splitlines())
    return pd.DataFrame(rows, columns=head).set_index("controller").astype(float)


@pytest.mark.usefixtures("draw")
@pytest.mark.parametrize(
    ("names", "cells"),
    [
        (["printed", "anchored", "adaptive"], ["adept-anchored"]),
        (["anchored", "computed-torque"], ["two-pandas-box"]),
        pytest.param(None, None, marks=pytest.mark.slow),
    ],
    ids=["planar", "spatial", "all"],
)
def test_stability_on_the_page_of_the_benchmark_is_that_of_the_stored_gains(names, cells):
    """Eigenvalues at a tie of the last printed digit round up on one processor and down on another."""
    import benchmark

    names, cells = names or controller_names(), cells or benchmark.tuned_cells()
    for of, table in ((benchmark.t_lambda, T_LAMBDA), (benchmark.payload_damping, DAMPING)):
        solved, told = numbers_of(benchmark.stability(names, cells, of)), numbers_of(table)
        assert list(told.index) == list(controller_names())
        assert_allclose(solved, told.loc[names, cells], atol=0.0101)


def test_every_entrant_is_damped_but_those_whose_reason_is_told():
    """A wrong model by the gains of the exact one: T lambda 1.17, 0.51. The funnels: 0.01 to 0.16."""
    wrong, funnels = "computed-torque-wrong-model", "prescribed-performance"
    t_lambda, damping = numbers_of(T_LAMBDA), numbers_of(DAMPING)
    assert t_lambda.drop(index=wrong).max().max() <= 1.0
    assert damping.drop(index=[wrong, funnels]).min().min() >= LEAST_DAMPING
    assert (damping.loc[funnels].min(), damping.loc[funnels].max()) == (0.01, 0.16)
    assert (t_lambda.loc[wrong].max(), damping.loc[wrong].min()) == (1.17, 0.51)


@pytest.fixture(scope="module")
def damped(draw):
    """studies/damped_gains.py, from the folder that the fixture draw has put on the path."""
    assert draw.HERE == FOLDER
    import damped_gains

    return damped_gains


def test_what_was_lowered_is_in_its_table_and_on_the_page(damped):
    from pages import with_block

    rows, gains = pd.read_csv(damped.DATA), pd.read_csv(damped.GAINS)
    assert with_block(TABLES, "damped", damped.page_table(rows)) == TABLES
    lowered = gains[gains["value"] != gains["searched"]]
    assert (lowered["value"] < lowered["searched"]).all()
    assert (lowered["value"] >= lowered["low"]).all()
    assert set(zip(rows["scenario"], rows["controller"], strict=True)) == set(
        zip(lowered["scenario"], lowered["controller"], strict=True)
    )
    assert (rows["damping_before"] < LEAST_DAMPING).all()
    assert (rows["damping_after"] >= LEAST_DAMPING).all()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("cell", "name"),
    [("adept-anchored", "anchored"), ("kinova-pair", "mean-pose")],
)
def test_a_gain_is_lowered_by_as_little_as_the_bound_asks_for(damped, cell, name):
    gains = pd.read_csv(damped.GAINS)
    rows = gains[(gains["scenario"] == cell) & (gains["controller"] == name)]
    searched, low, used = (
        dict(zip(rows["field"], rows[column], strict=True)) for column in ("searched", "low", "value")
    )
    scenario = damped.with_law(cell, name)
    assert damped.damped(scenario, searched, low) == pytest.approx(used, rel=0.03)
    (field,) = [field for field in used if used[field] != searched[field]]
    assert damped.is_damped(scenario, used)
    assert not damped.is_damped(scenario, used | {field: 1.05 * used[field]})


@pytest.mark.slow
def test_costs_before_and_after_are_those_of_runs(damped, tmp_path):
    """Before they were lowered the cost is that of the search."""
    gains, stored = pd.read_csv(damped.GAINS), pd.read_csv(damped.DATA)
    mine = gains[(gains["scenario"] == "adept-anchored") & (gains["controller"] == "anchored")]
    (row,) = damped.measured(mine, tmp_path).to_dict("records")
    kept = stored[(stored["scenario"] == "adept-anchored") & (stored["controller"] == "anchored")].iloc[0]
    for name in ("cost_before", "cost_after", "damping_before", "damping_after"):
        assert_allclose(row[name], kept[name], rtol=1e-3)
    assert_allclose(row["cost_before"], mine["cost"].iloc[0], rtol=1e-3)


AGAIN = re.findall(
    r"^\| `([^`]+)` \| `([^`]+)` \| (.*) \|$",
    TABLES.split("## Searched again with the bound")[1].split("```sh")[0],
    re.MULTILINE,
)
"""Cell, controller, and three times gains and cost: searched, lowered, searched with the bound."""


def test_the_better_of_lowered_gains_and_those_of_a_bounded_search_are_used(damped):
    """Both are made where lowering costs printed law or twin more than a fifth; eight rows have one."""
    gains, lowered = pd.read_csv(damped.GAINS), pd.read_csv(damped.DATA)
    costly = lowered[lowered["cost_after"] > 1.2 * lowered["cost_before"]]
    for cell, name, row in AGAIN:
        _, before, *pairs = row.split(" | ")
        assert float(pairs[1]) > 1.2 * float(before)
        chosen = min(zip(pairs[::2], pairs[1::2], strict=True), key=lambda pair: float(pair[1]))[0]
        stored = gains[(gains["scenario"] == cell) & (gains["controller"] == name)]["value"]
        assert_allclose(stored, list(map(float, chosen.split(", "))), rtol=5e-3)
    again = {(cell, name) for cell, name, _ in AGAIN}
    twins = {*zip(costly["scenario"], costly["controller"], strict=True)} - again
    assert not {name for _, name in twins} & {"printed", "sliding-pid"}
    assert len(again) == 4
    assert len(twins) == 8


@pytest.mark.slow
@pytest.mark.parametrize(("cell", "name", "row"), AGAIN, ids=[f"{cell}-{name}" for cell, name, _ in AGAIN])
def test_costs_of_searches_with_and_without_the_bound_are_those_of_runs(damped, tmp_path, cell, name, row):
    """Gains have three digits on the page; sgn makes of them up to 5 % of the cost."""
    stored = pd.read_csv(damped.GAINS)
    mine = stored[(stored["scenario"] == cell) & (stored["controller"] == name)]
    texts = row.split(" | ")
    told = dict(zip(texts[::2], texts[1::2], strict=True))
    searched, *others = ([float(gain) for gain in gains.split(", ")] for gains in told)
    for number, other in enumerate(others):
        table = mine.assign(searched=searched, value=other)
        (measured,) = damped.measured(table, tmp_path / str(number)).to_dict("records")
        costs = [measured["cost_before"], measured["cost_after"]]
        assert_allclose(costs, [float(told[text]) for text in (texts[0], texts[2 + 2 * number])], rtol=0.05)
        assert measured["damping_before"] < LEAST_DAMPING <= measured["damping_after"]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("cell", "name", "other", "cost"),
    [("panda-ur5-bar", "printed", "sliding-pid", 8.84), ("two-pandas-box", "sliding-pid", "printed", 10.1)],
)
def test_what_the_gains_of_its_twin_cost(damped, tmp_path, cell, name, other, cost):
    """Told on both pages of the benchmark."""
    stored = pd.read_csv(damped.GAINS)
    mine, twin = (
        stored[(stored["scenario"] == cell) & (stored["controller"] == law)] for law in (name, other)
    )
    swapped = mine.assign(value=twin["value"].to_numpy())
    (measured,) = damped.measured(swapped, tmp_path).to_dict("records")
    assert_allclose(measured["cost_after"], cost, rtol=0.01)


def test_trials_with_a_force_gain_keep_their_masses(claims):
    """They are changed by events, which the trials of the force gain alone do not have."""
    curve = claims[0].curve()
    for mass in ("half the mass", "twice the mass"):
        changed, calm = (curve[f"{trial}K_f 9", "force_N"] for trial in (f"{mass}, ", ""))
        assert (changed != calm).all()


def test_verdicts_follow_from_the_curve(claims):
    study, _ = claims
    rules, curve = study.claims_tables, study.curve()

    def changed(values):
        frame = curve.copy()
        for column, value in values.items():
            frame[column] = value
        return frame

    quick = changed({("event", "settled_s"): 1.0, ("event", "settled_again_s"): 1.0})
    assert rules.tracking(quick).rules[0].verdict == "holds"
    slow = changed({("event", "settled_again_s"): 9.0})
    assert rules.tracking(slow).rules[0].verdict == VERDICTS[0][1]
    gamma = cp.Scenario.load("adept-paper").controller.gains.pose_gain
    assert_allclose(gamma, rules.GAMMA, rtol=0)
    forces = {("quiet", "force_N"): 0.01, ("quiet", "end_force_N"): 0.005, ("event", "end_force_N"): 0.005}
    fed = {("K_f 9", "force_N"): 0.01, ("K_f 9", "end_force_N"): 0.01}
    assert [rule.verdict for rule in rules.force(changed(forces | fed)).rules] == ["holds"] * 3
    judged = rules.claims(curve, pd.read_csv(study.HERE / "costs.csv"))
    assert [[rule.verdict for rule in claim.rules] for claim in judged] == VERDICTS


VERDICTS = [
    ["holds", "does not hold with our $\\gamma$ = 2"],
    ["holds in part", "holds in part", "holds in part"],
    ["holds in part", "does not hold"],
    [
        "holds",
        "does not hold",
        "holds in part",
        "holds for α large enough",
        "not a claim; holds for α large enough",
        "not a claim; does not hold",
    ],
    ["holds", "holds"],
]
"""Of the five claims, by rule."""


def test_the_anchored_law_loses_where_another_is_less(claims):
    study, _ = claims
    kept = pd.read_csv(study.LOSSES)
    assert_allclose(study.losses()["least"], kept["least"], rtol=0.01)
    front = pd.read_csv(study.HERE / "front" / "adept-judged.csv")
    listed = kept[(kept["cell"] == "adept") & (kept["measure"] == "force_N")]
    anchored = front[front["law"] == "anchored"].set_index("trial")["force_N"]
    least = front.groupby("trial")["force_N"].min()
    assert set(listed["trial"]) == {trial for trial in anchored.index if anchored[trial] > 1.1 * least[trial]}
    counts = re.search(r"(\d+) pairs of trial and measure. In (\d+) of them it is position", claims_page())
    assert [int(count) for count in counts.groups()] == [len(kept), (kept["measure"] == "position_mm").sum()]


def claims_page():
    return (CONCEPTS.parent / "studies" / "paper-claims.md").read_text(encoding="utf-8")


@pytest.mark.usefixtures("draw")
def test_the_page_of_the_benchmark_says_what_each_controller_measures():
    import benchmark

    rows = re.findall(r"^\| `([\w-]+)` \| ([^|]+) \| [\d.]+ \(", BENCHMARK, re.MULTILINE)
    table = pd.read_csv(benchmark.DATA).groupby("controller")["information"].unique()
    assert dict(rows) == {name: seen for name, (seen,) in table.items()}


def test_the_claims_are_drawn_from_their_tables(claims):
    study, tables = claims
    figure = study.claims_figure.figure(tables | {"curve": study.curve()}, study.FORCE_GAIN)
    assert [len(panel.lines) for panel in figure.axes] == [6, 6, 2, 6, 6, 3]


@pytest.fixture(scope="module")
def alpha(draw):
    """studies/alpha.py, from the folder that the fixture draw has put on the path."""
    assert draw.HERE == FOLDER
    import alpha

    return alpha


def test_the_page_over_alpha_is_that_of_its_table(alpha):
    from pages import with_block

    table = pd.read_csv(alpha.DATA)
    page = alpha.PAGE.read_text(encoding="utf-8")
    assert with_block(page, "alpha", alpha.page_table(table)) == page
    assert [len(panel.lines) for panel in alpha.figure(table).axes] == [6, 6, 5, 6]
    sizes = table.groupby(["rate_hz", "trial"])["alpha"].nunique()
    assert (sizes == len(alpha.ALPHAS)).all()
    assert {name for _, name in sizes.index} == set(alpha.SHOWN)


def test_no_alpha_takes_a_load_up_fast_and_ramps_slowly(alpha):
    """Time to take 100 N up times the ramp under 1 mm: 44 to 47 N from 0.001 to 0.02 at 80 Hz, more above."""
    table = pd.read_csv(alpha.DATA)
    time = alpha.at(table, 80.0, "load", "settled_again_narrow_s")["median"]
    product = alpha.ramp(table, 80.0, "bias 1 mm") * time
    page = alpha.PAGE.read_text(encoding="utf-8")
    (low, high) = re.search(r"(\d+) to (\d+) N from α = 0.001 to 0.02", page).groups()
    shown = product[(product.index >= 0.001) & (product.index <= 0.02)]
    assert [round(shown.min()), round(shown.max())] == [int(low), int(high)]
    assert product[np.isfinite(product)].min() == shown.min()


def test_the_pages_have_the_curves_numbers(alpha):
    """Of the text of the page over alpha and of the table of laws on the paper's page."""
    table, page = pd.read_csv(alpha.DATA), alpha.PAGE.read_text(encoding="utf-8")

    def median(trial, measure, at):
        return alpha.at(table, 80.0, trial, measure).loc[at, "median"]

    force, taken = "end_force_N", "settled_again_narrow_s"
    for text, value in {
        r"after ([\d.]+) s. At 0.002 that": median("load", taken, 0.2),
        r"At 0.002 that takes (\d+) s": median("load", taken, 0.002),
        r"off by up to (\d+) mm": median("load", "event_peak_mm", 0.002),
        r"off by ([\d.]+) N at 0.002": median("bias 1 mm", force, 0.002),
        r"and by (\d+) N at 0.2": median("bias 1 mm", force, 0.2),
        r"10 s\*\*: ([\d.]+) N there": median("quiet", "force_N", 0.005),
        r"N there, (\d+) N at 1": median("quiet", "force_N", 1.0),
        r"stays between ([\d.]+) and": alpha.at(table, 80.0, "quiet", "force_N").loc[:0.002, "median"].min(),
        r"stays between [\d.]+ and ([\d.]+) N": alpha.at(table, 80.0, "quiet", "force_N")
        .loc[:0.002, "median"]
        .max(),
        r"leave ([\d.]+) N at α = 0": median("quiet", "force_N", 0.0),
    }.items():
        (shown,) = re.findall(text, page)
        assert float(f"{value:.{len(shown.partition('.')[2])}f}") == float(shown), text
    for at, shown in ((0.002, "7.7"), (0.2, "607")):
        assert f"ramps, {shown} N after 20 s at 1 mm" in PAPER_PAGE
        assert float(f"{median('bias 1 mm', force, at):.3g}") == pytest.approx(float(shown), rel=0.01)


def test_every_plan_over_alpha_is_a_scenario(alpha):
    for name, rate, by_start in alpha.plans():
        scenario = by_start["1"].scenario(1)
        assert (scenario.clock.rate_hz, scenario.controller.gains.sign_gain) == (rate, 1e-5), name


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "number"),
    [
        *(("quiet", 0), ("quiet", 8), ("quiet", 9), ("quiet", 16), ("event", 8), ("unknown load", 8)),
        *(("bias 1 mm", 8), ("bias 1 mm", 14), ("load", 8), ("load", 14)),
    ],
)
def test_a_row_over_alpha_is_what_its_command_finds(alpha, name, number):
    """Those that pages quote."""
    import claims_window

    plans = {trial: by_start for trial, rate, by_start in alpha.plans() if rate == 80.0}[name]
    engine = "compiled" if name == "load" else "pinocchio"  # of 300 s each
    runs = [
        claims_window.judged(cp.run(plan.scenario(number), engine=engine, warn=False))
        for plan in plans.values()
    ]
    table = pd.read_csv(alpha.DATA)
    for measure in alpha.SHOWN[name]:
        expected = alpha.at(table, 80.0, name, measure).loc[alpha.ALPHAS[number]]
        values = [run[measure] for run in runs]
        assert_allclose([np.median(values), min(values), max(values)], expected, rtol=2e-3)


PAPER_PAGE = (CONCEPTS / "paper.md").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def fit(draw):
    """studies/paper_fit.py, from the folder that the fixture draw has put on the path."""
    assert draw.HERE == FOLDER
    import paper_fit

    return paper_fit


@pytest.mark.gate
def test_the_ranges_beside_the_papers_axes_are_those_of_runs(fit):
    from pages import with_block

    assert with_block(PAPER_PAGE, "figures", fit.table()) == PAPER_PAGE
    ranges = [line.split("|")[3:5] for line in fit.table().splitlines()[2:12]]
    bold = [sum("**" in cell for cell in column) for column in zip(*ranges, strict=True)]
    assert (len(ranges), bold) == (10, [1, 4])  # one of ten, as the README says


def test_a_curve_fits_where_its_extremes_lie_in_the_outer_ticks_of_its_axis(fit):
    import paper_axes

    inside = np.stack([paper_axes.LOW, paper_axes.HIGH], axis=-1)
    within = inside + 0.5 * paper_axes.TICKS[:, None] * [1.0, -1.0]
    assert_allclose(fit.outside(np.array([inside, within])), 0.0)
    length = paper_axes.HIGH - paper_axes.LOW
    short = inside + 0.5 * length[:, None] * [1.0, 0.0]
    assert_allclose(fit.outside(short), 0.5 - paper_axes.TICKS / length)
    assert_allclose(fit.outside(np.add(inside, (0.0, 1.0))), 1.0 / length)


def test_the_page_says_what_the_search_found_and_what_it_did_not_reach(fit):
    best = pd.read_csv(fit.DATA / "best.csv").sort_values("sum")
    soft = best[best["grasps"] != "rigid"]
    assert best["elbows"].iloc[0] == "+1-1"
    nearest = best[best["elbows"] == "-1+1"].iloc[0]  # with the others the arms intersect
    gains = cp.Scenario.load("adept-paper-fit").controller.gains
    kilonewtons = 1e-3 * cp.Scenario.load("adept-compliant").cell.grasps["left"].stiffness[0]
    lengths = [search.push_s for search in fit.SEARCHES]
    (psi,) = [axis for axis in fit.AXES if "psi" in axis.curve]
    require_numbers(
        "paper",
        {
            r"nearest in a seeded search of (\d+) runs": best["runs"].sum(),
            r"where they do, the search has ([\d.]+), where its own sum here is ([\d.]+)\. It covers": [
                best["sum"].iloc[0],
                nearest["sum"],
            ],
            r"rigid grasps and the paper's (\d+) kN/m, \$K_f\$ from (\d) to (\d+),": [
                kilonewtons,
                *(fit.values(np.full(len(fit.NAMES), edge))["K_f"] for edge in (0.0, 1.0)),
            ],
            r"pushes of ([\d.]+), ([\d.]+) and, rigid, ([\d.]+) s, and rates at the start": sorted(
                set(lengths)
            ),
            r"pose that take longer than ([\d.]+) s count": fit.PROMPT_S,
            r"by its axis it would be (\d+) at least": psi.high - psi.low - 2.0 * psi.tick,
            r"in `adept-paper-fit` \$K_f\$ is (\d+), so that": gains.force_gain,
            r"\*\*At (\d+) kN/m\*\* the least sum is ([\d.]+), and ([\d.]+) where arms .*, of (\d+) runs": [
                kilonewtons,
                soft.loc[soft["elbows"] == "-1+1", "sum"].min(),
                soft["sum"].min(),
                soft["runs"].sum(),
            ],
        },
    )
    rounded = [gains.pose_gain, gains.sign_gain, *gains.damping_gain, gains.force_gain, gains.transient_rate]
    assert_allclose(
        rounded, nearest[["gamma", "alpha", "K_d1", "K_d2", "K_d3", "K_f", "kappa"]].tolist(), rtol=5e-3
    )
    pairs = pd.read_csv(fit.DATA / "pairs.csv", index_col=0)
    reached = {name: set(row.index[row == 0.0]) - {name} for name, row in pairs.iterrows()}
    assert (np.diag(pairs) == 0.0).all()
    assert reached["$\\psi$, deg"] == {"joint 1, arm 1, N m"}
    assert reached["joint 3, arm 1"] == {"$y$, m"}
    never = {"$\\psi$, deg", "joint 3, arm 1", "joint 3, arm 2"}
    assert set(pairs) - reached["$f$ along the bar, N"] - {"$f$ along the bar, N"} == never


@pytest.mark.slow
def test_the_best_run_of_the_search_is_what_its_command_finds(fit):
    best = pd.read_csv(fit.DATA / "best.csv").sort_values("sum").iloc[0]
    search = next(
        each for each in fit.SEARCHES if f"{each.elbows[0]:+d}{each.elbows[1]:+d}" == best["elbows"]
    )
    search = search._replace(grasps=best["grasps"], push_s=best["push_s"])
    result = cp.run(fit.base(search), fit.changes(search, best[list(fit.NAMES)].to_dict()), warn=False)
    samples = {name: result.data[name].values[None] for name in result.data.data_vars}
    found = np.concatenate([fit.extremes(samples).reshape(1, -1), fit.settled(samples)], axis=1)
    assert_allclose(fit.cost(found), best["sum"], rtol=0.01)


@pytest.mark.slow
def test_a_run_of_the_claims_is_what_its_command_finds(claims):
    study, tables = claims
    plan = study.plans()["laws"]
    labels = [f"{law} | {trial}" for law, trial in tables["laws"][["law", "trial"]].itertuples(index=False)]
    assert [point.parameters["run"] for point in plan.points()] == labels
    number = labels.index("anchored | unknown load")
    import claims_window

    found = claims_window.judged(cp.run(plan.scenario(number)))
    for name in study.claims_tables.MEASURES:
        assert_allclose(found[name], tables["laws"].loc[number, name], rtol=1e-3)
