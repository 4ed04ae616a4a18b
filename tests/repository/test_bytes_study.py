"""Study of bytes against newtons: its page says what its data say, and its data are those of its runs."""

import importlib
import sys
from pathlib import Path

import pandas as pd
import pytest
from numpy.testing import assert_allclose

REPOSITORY = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def study():
    """studies/bytes.py, as its command loads it."""
    folder, before = str(REPOSITORY / "studies"), set(sys.modules)
    sys.path.insert(0, folder)
    yield importlib.import_module("bytes")
    sys.path.remove(folder)
    for name in set(sys.modules) - before:
        if folder in str(getattr(sys.modules[name], "__file__", "")):
            del sys.modules[name]


@pytest.fixture(scope="module")
def data(study):
    return pd.read_csv(study.DATA)


def test_the_page_is_what_the_data_say(study, data):
    pages = importlib.import_module("pages")
    page = study.PAGE.read_text(encoding="utf-8")
    for law in study.LAWS:
        text = f"{study.least_bytes(data, law)}\n\n{study.table(data, law)}"
        assert pages.with_block(page, law, text) == page


def test_every_value_is_there_once_at_every_loss(study, data):
    assert study.SEEDS == 30
    wanted = {
        (law, way, value, loss)
        for law, (thresholds, *_) in study.LAWS.items()
        for way, values in (("rate", study.RATES), ("threshold", thresholds))
        for value in values
        for loss in study.LOSSES
    }
    found = list(zip(data.law, data.way, data.value, data.loss, strict=True))
    assert len(found) == len(wanted)
    assert set(found) == wanted


def test_what_the_page_says_in_words_is_in_the_data(study, data):
    views = data[(data.law == "views") & (data.way == "rate")]
    assert (views.diverged == study.SEEDS).tolist() == (views.value <= 20.0).tolist()
    wrenches = data[(data.law == "wrist wrenches") & (data.way == "threshold")]
    full = data[(data.law == "wrist wrenches") & (data.value == study.RATES[0])].bytes_per_s.max()
    assert wrenches[wrenches.value < 0.2].bytes_per_s.min() > 0.9 * full  # N of noise
    sparing = wrenches[wrenches.value == 1.0]
    assert sparing.bytes_per_s.max() < 0.1 * full
    assert sparing.force_N.max() < 1.5 * wrenches.force_N.min()


@pytest.mark.slow
def test_a_row_is_that_of_its_runs(study, data):
    for law, way, loss in (("wrist wrenches", "threshold", 0.05), ("views", "rate", 0.2)):
        stored = data[(data.law == law) & (data.way == way) & (data.loss == loss)]
        assert_allclose(study.rows(law, way, loss)[study.COLUMNS[4:]], stored[study.COLUMNS[4:]], rtol=1e-3)


def test_an_interrupted_study_goes_on_where_it_was(study, data, tmp_path):
    asked = []

    def rows(law, way, loss):
        asked.append((law, way, loss))
        return data[(data.law == law) & (data.way == way) & (data.loss == loss)]

    begun = data[(data.law == "wrist wrenches") & (data.way == "rate")]
    whole = study.simulate(begun, rows, tmp_path / "bytes.csv")
    assert_allclose(
        whole.force_N.replace(float("inf"), 0.0).sum(), data.force_N.replace(float("inf"), 0.0).sum()
    )
    assert asked == [
        ("wrist wrenches", "threshold", 0.0),
        ("wrist wrenches", "threshold", 0.05),
        ("wrist wrenches", "threshold", 0.2),
        *(("views", way, loss) for way in ("rate", "threshold") for loss in study.LOSSES),
    ]
