"""The cubic spline against SciPy's."""

import numpy as np
import pytest
from scipy import interpolate

from sdp_vs_penalty.signals.spline import CubicSpline


@pytest.mark.parametrize("count", [2, 3, 4, 5, 40])
@pytest.mark.parametrize("shape", [(), (3,)])
def test_values_inside_and_outside(count: int, shape: tuple[int, ...]) -> None:
    rng = np.random.default_rng(count)
    x = np.cumsum(rng.uniform(0.1, 2.0, count))
    y = rng.normal(size=(count, *shape))
    at = np.concatenate([rng.uniform(x[0] - 0.5, x[-1] + 0.5, 200), x])
    spline, expected = CubicSpline(x, y), interpolate.CubicSpline(x, y)
    np.testing.assert_allclose(spline(at), expected(at), rtol=1e-9, atol=1e-11 * np.abs(y).max())
    np.testing.assert_allclose(spline(float(at[0])), expected(at[0]), rtol=1e-9, atol=1e-11)
