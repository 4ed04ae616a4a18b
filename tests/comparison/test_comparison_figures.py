"""Figure of a comparison: texts that do not meet, marks, names and words for tables of any size."""

import itertools

import matplotlib as mpl
import numpy as np
import pytest
from figure_texts import meeting_texts, shown_numbers
from made_up import made_up

from coop_pin.figures import comparison_figure


@pytest.mark.parametrize(
    ("sizes", "largest"), [((2, 14, 17), 1.001), ((1, 9, 7), 1e6), ((1, 3, 2), 1.0), ((1, 2, 1), np.inf)]
)
def test_no_text_meets_another_or_the_edge(sizes, largest):
    """With values that are close, far apart, equal, and with nothing that did not fail."""
    table = made_up(*sizes, largest)
    scenario = table.data["scenario"].values[-1]
    figure = comparison_figure(table, scenario)
    figure.draw_without_rendering()
    front, ranks, *maps = figure.axes
    texts = [figure._suptitle, *front.texts, *ranks.get_legend().get_texts()]
    for panel in figure.axes:
        texts += [panel._left_title, panel.xaxis.label, panel.yaxis.label]
        texts += [panel.xaxis.offsetText, panel.yaxis.offsetText, *(panel.texts if panel in maps else [])]
        texts += [text for axis in (panel.xaxis, panel.yaxis) for text in shown_numbers(axis)]
    upright = [text for text in texts if not text.get_rotation() % 90.0]
    assert meeting_texts(figure, upright) == []
    leaning = [text for text in maps[-1].get_xticklabels() if text.get_visible()]
    assert len(leaning) == table.data.sel(scenario=scenario).runs.notnull().any("controller").sum()
    for one, other in itertools.pairwise(leaning):
        apart = other.get_window_extent().x1 - one.get_window_extent().x1
        assert apart * np.sin(np.radians(one.get_rotation())) > one.get_size() * figure.dpi / 72.0


def test_every_controller_is_named_in_words_with_or_without_a_mark():
    table = made_up(2, 14, 17, 1e3)
    front, ranks, *maps = comparison_figure(table, "scenario-1").axes
    medians = table.data.sel(scenario="scenario-1")["tracking_rms_mm"].median("trial").values
    classes = table.information("scenario-1")
    labels = [f"{name}: {seen}" for name, seen in zip(table.labels("scenario-1"), classes, strict=True)]
    failed = [f"{name}: failed" for name, value in zip(labels, medians, strict=True) if np.isinf(value)]
    assert 0 < len(failed) < 14
    marked = [name for name, value in zip(labels, medians, strict=True) if np.isfinite(value)]
    assert sorted(text.get_text() for text in front.texts) == sorted(failed + marked)
    assert any("(untuned)" in name for name in labels)
    assert front.lines[0].get_xdata().size == len(marked)
    for text in (text for text in front.texts if text.get_text() in marked):
        assert text.xy[0] == pytest.approx(medians[labels.index(text.get_text())])
    for panel in maps:
        assert len(panel.texts) == 14 * 16
        assert any(text.get_text().endswith("*") for text in panel.texts)
    written = [text.get_text() for panel in (front, ranks, *maps) for text in panel.findobj(mpl.text.Text)]
    assert not [text for text in written if "_rms" in text]
