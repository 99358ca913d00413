"""Splines without a slow import: the same as SciPy's."""

import numpy as np
import pytest
import scipy.interpolate
from numpy.testing import assert_allclose

from sdp_vs_penalty.signals.splines import CubicSpline


@pytest.mark.parametrize("order", [0, 1])
@pytest.mark.parametrize("n_knots", [2, 3, 4, 5, 60])
def test_a_spline_is_that_of_scipy(n_knots, order):
    rng = np.random.default_rng(n_knots)
    x = np.cumsum(rng.uniform(0.1, 2.0, n_knots))
    values = rng.normal(size=(n_knots, 3))
    at = np.concatenate([x, np.linspace(x[0] - 0.5, x[-1] + 0.5, 50)])
    right = scipy.interpolate.CubicSpline(x, values)(at, order)
    ours = CubicSpline(x, values)
    assert_allclose(ours(at, order), right, rtol=1e-9, atol=1e-9 * abs(right).max())
    assert_allclose(ours(at[-1], order), right[-1], rtol=1e-9)
