"""What identify would refuse, check calls an error, and both quote the same share of the torque."""

from dataclasses import replace

import numpy as np
import pytest
from small_runs import hostile_log, small_run

from sdp_vs_penalty import InputError, check, compare, identify, load_problem

PROBLEM = load_problem("two_link")


@pytest.mark.parametrize("seed", [*range(30), 76, 105, 140, 258])
def test_what_identify_refuses_check_calls_an_error(seed):
    """The last ones are what the check fell over once: no row to ask, squares of 1e300."""
    run = hostile_log(seed)
    try:
        identify(PROBLEM, run, check=False)
    except InputError:
        try:
            (report,) = check(PROBLEM, run)
        except InputError:
            return
        assert report.meaningless


def test_check_and_identify_quote_the_same_share():
    for problem, noise in ((PROBLEM, 0.0), (load_problem("ur10e"), 0.02)):
        run = small_run(problem, seconds=8.0)
        rng = np.random.default_rng(1)
        run = replace(run, tau=run.tau + noise * run.tau.std(axis=0) * rng.normal(size=run.tau.shape))
        (report,) = check(problem, run)
        assert report.unexplained is not None
        (found,) = compare(identify(problem, run, check=False), run)
        assert 100.0 * report.unexplained**0.5 == pytest.approx(found.relative_error_percent, rel=0.15)
