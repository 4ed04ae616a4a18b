"""Texts of a figure as matplotlib measures them when it draws them: which ones meet, and which leave it."""

import numpy as np
from matplotlib.text import Text


def shown_numbers(axis):
    """The labels at the ticks in view."""
    low, high = sorted(axis.get_view_interval())
    ticks = [tick for tick in axis.get_major_ticks() if low <= tick.get_loc() <= high]
    return [tick.label1 for tick in ticks if tick.label1.get_visible()]


def meeting_texts(figure, texts):
    """Pairs of texts that meet; none may leave a figure that is laid out."""
    texts = [text for text in texts if text.get_text()]
    boxes = [Text.get_window_extent(text) for text in texts]  # of annotations without their arrows
    edges = np.array([(*box.min, *box.max) for box in boxes])
    assert (edges[:, :2] >= 0.0).all()
    assert (edges[:, 2:] <= figure.bbox.max + 1e-9).all()
    meet = (edges[:, None, :2] < edges[None, :, 2:] - 1.0).all(axis=2)
    meet &= meet.T & ~np.eye(len(edges), dtype=bool)
    return [(texts[i].get_text(), texts[j].get_text()) for i, j in np.argwhere(meet)]
