"""Splines that need no slow imports: the same as SciPy's."""

import subprocess
import sys

import numpy as np
import pytest
import scipy.interpolate
from numpy.testing import assert_allclose
from small_runs import write_run

from sdp_vs_penalty import load_problem
from sdp_vs_penalty.signals import CubicSpline


@pytest.mark.parametrize("order", [0, 1])
@pytest.mark.parametrize("n_knots", [2, 3, 4, 5, 60])
def test_a_spline_is_that_of_scipy(n_knots, order):
    rng = np.random.default_rng(n_knots)
    x = np.cumsum(rng.uniform(0.1, 2.0, n_knots))
    values = rng.normal(size=(n_knots, 3))
    at = np.concatenate([x, np.linspace(x[0] - 0.5, x[-1] + 0.5, 50)])
    right = scipy.interpolate.CubicSpline(x, values)(at, order)
    ours = CubicSpline(x, values)(at, order)
    assert_allclose(ours, right, rtol=1e-9, atol=1e-9 * abs(right).max())


def test_coefficients_of_a_spline_are_those_of_scipy():
    x = np.log([0.01, 0.02, 0.05, 0.1, 0.3])
    right = scipy.interpolate.CubicSpline(x, np.eye(5))
    assert_allclose(CubicSpline(x, np.eye(5)).c, right.c, atol=1e-12)


@pytest.mark.parametrize("x", [[0.0, 0.0, 1.0], [0.0, np.nan, 1.0], [1.0, 0.0]])
def test_knots_that_do_not_ascend_are_refused(x):
    with pytest.raises(ValueError, match="ascend"):
        CubicSpline(x, np.zeros((len(x), 1)))


SLOW = ["scipy.interpolate", "scipy.ndimage", "scipy.optimize"]


def test_slow_parts_of_scipy_are_imported_where_they_are_used(tmp_path):
    """In one process, which imports everything once: the check needs none of them, and
    identification after it only the optimiser."""
    run = tmp_path / "run.csv"
    write_run(run, load_problem("two_link"), seconds=8.0)
    program = (
        f"import sys; import sdp_vs_penalty as sdp; run = {str(run)!r}; "
        "sdp.check('two_link', run); "
        f"print([name for name in {SLOW} if name in sys.modules]); "
        "sdp.identify('two_link', run); "
        f"print([name for name in {SLOW[:2]} if name in sys.modules])"
    )
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", program], capture_output=True, text=True
    )
    assert done.stdout.split() == ["[]", "[]"], done.stderr
