"""Cases of a parametrised test that are run by default; the others by the gate, or by ``-m slow``."""

import pytest


def by_default(cases, *kept, others=pytest.mark.gate):
    """Mark the cases that are neither kept nor marked; a case of several arguments is a tuple."""
    return [
        case
        if case in kept or hasattr(case, "marks")
        else pytest.param(*(case if isinstance(case, tuple) else (case,)), marks=others)
        for case in cases
    ]
