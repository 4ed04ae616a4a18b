"""The study of both engines: its page has what its tables say, and no difference is without a reason."""

import sys
from pathlib import Path

import pandas as pd
import pytest
from numpy.testing import assert_allclose

import coop_pin as cp
from coop_pin.comparison import Comparison, benchmark_scenario, standard_trials

FOLDER = Path(__file__).parents[2] / "studies"
SEEDS = 5
"""Number of seeds of each random trial."""


@pytest.fixture(scope="module")
def study():
    """studies/both_engines.py, as its command loads it."""
    before = set(sys.modules)
    sys.path.insert(0, str(FOLDER))
    import both_engines

    yield both_engines
    sys.path.remove(str(FOLDER))
    for name in set(sys.modules) - before:
        if str(FOLDER) in str(getattr(sys.modules[name], "__file__", "")):
            del sys.modules[name]


@pytest.fixture(scope="module", params=["comparison", "paper"])
def table(request, study):
    """A table of the study."""
    return pd.read_csv(study.DATA / f"{request.param}.csv", keep_default_na=False)


def test_the_page_is_what_the_tables_say(study):
    for name, block in study.blocks().items():
        assert f"<!-- {name} -->\n\n{block}\n\n<!-- end of {name} -->" in study.PAGE.read_text(
            encoding="utf-8"
        )


def test_each_law_ran_in_all_cells_under_all_trials_that_mujoco_has(study):
    both = pd.read_csv(study.DATA / "comparison.csv", keep_default_na=False)
    places = {
        (cell, law, trial)
        for cell in study.CELLS
        for trial in standard_trials(benchmark_scenario(cp.Scenario.load(cell)))
        for law in study.LAWS
        if trial != study.PATCHED
    }
    assert {*both[study.KEY].itertuples(index=False, name=None)} == places
    assert len(both) == len(places)
    assert set(both["duration_s"]) == {""}  # their scenarios' own
    assert set(both.query("trial == 'noise'")["runs"]) == {SEEDS}


def test_the_papers_experiment_ran_with_four_laws_under_its_seven_trials(study):
    paper = pd.read_csv(study.DATA / "paper.csv", keep_default_na=False)
    trials = {name.split(" | ")[1] for name in study.plans()["laws"].cases["run"]}
    assert len(trials) == 7
    ran = {*paper[["law", "trial"]].itertuples(index=False, name=None)}
    assert ran == {(law, trial) for law in study.PAPER for trial in trials}
    assert len(paper) == len(ran)


def test_each_median_that_is_apart_has_a_reason_that_was_measured(study, table):
    for _, row in table.iterrows():
        assert bool(row["reason"]) == study.is_apart(row)
        if row["reason"]:
            names = {*row["reason"].split(" (")[0].split(" and ")}
            assert names <= {"sensitivity", "divergence", *study.CAUSES}
            if "divergence" in names:
                assert min(row["tracking"], row["tracking_mujoco"]) > study.FAR_MM
                assert row["kept"] == 0


def test_runs_end_with_the_same_verdict_on_both_engines(table):
    for count in ("runs", "finished", "kept"):
        assert list(table[count]) == list(table[f"{count}_mujoco"])


def test_the_order_of_the_laws_is_the_same_except_where_digits_of_one_say_nothing(study, table):
    for _, part in table.groupby(["scenario", "trial"]):
        if not part["reason"].str.match("sensitivity|divergence").any():
            assert all(study.same_order(part).values())


def test_the_explorer_has_the_medians_of_both_engines(study):
    both = pd.read_csv(study.DATA / "comparison.csv", keep_default_na=False).set_index(study.KEY)
    cells = Comparison.load(study.DATA / "explorer.csv").table
    assert len(cells) == 2 * len(both)
    assert set(cells.query("controller.str.endswith(', MuJoCo')")["engine"]) == {"mujoco"}
    for (scenario, law, trial), row in both.iterrows():
        for suffix, engine in (("", ""), ("_mujoco", ", MuJoCo")):
            cell = cells.loc[scenario, f"{law}{engine}", trial]
            for name, measure in study.MEASURES.items():
                assert_allclose(cell[name], row[f"{measure}{suffix}"], rtol=1e-5)
