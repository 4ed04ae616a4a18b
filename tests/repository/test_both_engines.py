"""The study of both engines: its page has what its tables say, and no difference is without a reason."""

import sys
from pathlib import Path

import pandas as pd
import pytest

FOLDER = Path(__file__).parents[2] / "studies"


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


def test_the_page_is_what_the_tables_say(study):
    for name, block in study.blocks().items():
        assert f"<!-- {name} -->\n\n{block}\n\n<!-- end of {name} -->" in study.PAGE.read_text(
            encoding="utf-8"
        )


def test_each_median_that_is_apart_has_a_reason_and_all_places_are_there(study):
    both = pd.read_csv(study.DATA / "comparison.csv", keep_default_na=False)
    assert set(both["scenario"]) <= {*study.CELLS}
    assert set(both["law"]) == {*study.LAWS}
    for _, row in both.iterrows():
        assert bool(row["reason"]) == study.is_apart(row)
        assert row["finished"] == row["finished_mujoco"]
    paper = pd.read_csv(study.DATA / "paper.csv", keep_default_na=False)
    assert set(paper["law"]) == {*study.PAPER}
    assert "as published" in set(paper["trial"])
    assert not any(study.is_apart(row) for _, row in paper.iterrows())
