"""What tests of batches share: their samples against those of single runs."""

import numpy as np
from numpy.testing import assert_allclose, assert_array_equal


def require_same_samples(found, wanted):
    """Require the variables of a single run, to 1e-9."""
    assert set(found.variables) == set(wanted.variables)
    for variable, array in wanted.variables.items():
        values = found[variable].values
        assert (values.shape, values.dtype) == (array.shape, array.dtype)
        if values.dtype.kind != "f":
            assert_array_equal(values, array.values, err_msg=variable)
            continue
        scale = max(1.0, np.abs(array.values[np.isfinite(array.values)]).max(initial=0.0))
        assert_allclose(values, array.values, rtol=0, atol=1e-9 * scale, err_msg=variable)
