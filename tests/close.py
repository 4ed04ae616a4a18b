"""Comparisons: numbers with an absolute tolerance only, printed texts without their line breaks."""

from typing import Any

import numpy as np


def assert_close(actual: Any, desired: Any, atol: float) -> None:
    """Require |actual - desired| <= atol in every entry, in the unit compared; NaN equals NaN.

    numpy's own default adds 1e-7 of the desired value, which swamps a stated tolerance of large numbers.
    """
    np.testing.assert_allclose(actual, desired, rtol=0.0, atol=atol)


def unwrapped(text: str) -> str:
    """A printed text on one line: a terminal's line breaks are where its width puts them."""
    return " ".join(text.split())
