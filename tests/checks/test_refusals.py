"""What identify would refuse, check calls an error, and both quote the same share of the torque."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from small_runs import small_run

from sdp_vs_penalty import InputError, Measurements, check, compare, identify, load_problem

PROBLEM, RUN = load_problem("two_link"), small_run(load_problem("two_link"), seconds=4.0)

#: Begin and end of the rows, as shares of the run: often all of them.
ROWS = st.one_of(st.just([0.0, 1.0]), st.tuples(st.floats(0.0, 1.0), st.floats(0.0, 1.0)).map(sorted))
NUMBER = st.one_of(
    st.sampled_from([0.0, -1.0, np.pi / 180.0, 180.0 / np.pi, 1e3, 1e-3, 1e160, 1e300, np.nan, np.inf]),
    st.floats(-100.0, 100.0),
)
CHANNEL = st.tuples(st.sampled_from(["q", "tau", "dq"]), st.integers(0, 1))


def changed(
    run: Measurements, rows: slice, channel: tuple[str, int], how: str, x: float
) -> Measurements:
    """One channel over some rows: scaled, moved, held, or of another joint."""
    name, j = channel
    if getattr(run, name) is None:
        return run
    values = getattr(run, name).copy()
    part = values[rows, j]
    if not len(part):
        return run
    with np.errstate(all="ignore"):
        values[rows, j] = {
            "scaled": part * x,
            "moved": part + x,
            "held": np.full_like(part, part[0]),
            "other": values[rows, 1 - j],
            "backwards": part[::-1],
        }[how]
    return replace(run, **{name: values})


def without(run: Measurements, rows: slice, stride: int) -> Measurements:
    keep = np.ones(len(run.t), bool)
    keep[rows] = np.arange(len(run.t))[rows] % stride == 0
    return run.rows(keep)


def clocked(run: Measurements, rows: slice, x: float) -> Measurements:
    t = run.t.copy()
    with np.errstate(all="ignore"):
        t[rows] = t[rows] * x
    return replace(run, t=t)


HOW = st.sampled_from(["scaled", "moved", "held", "other", "backwards"])
DEED = st.one_of(
    st.tuples(st.just(changed), ROWS, st.tuples(CHANNEL, HOW, NUMBER)),
    st.tuples(st.just(without), ROWS, st.tuples(st.integers(2, 1000))),
    st.tuples(st.just(clocked), ROWS, st.tuples(NUMBER)),
)


@settings(
    max_examples=30, deadline=None, derandomize=True, database=None,
    suppress_health_check=list(HealthCheck),
)  # fmt: skip
@given(st.lists(DEED, min_size=1, max_size=3))
def test_what_identify_refuses_check_calls_an_error(deeds):
    run = RUN
    for do, (begin, end), given_ in deeds:
        rows = slice(int(begin * len(run.t)), int(end * len(run.t)) + 1)
        run = do(run, rows, *given_)
    if not len(run.t):
        return
    try:
        identify(PROBLEM, {"t": run.t, "q": run.q, "tau": run.tau, "dq": run.dq}, check=False)
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


def test_a_warning_that_is_mended_hides_no_refusal():
    """A gap in the numbers is cut out for the checks behind it; the file as it is, is refused."""
    tau = RUN.tau.copy()
    tau[100, 1] = np.nan
    (report,) = check(PROBLEM, replace(RUN, tau=tau))
    assert report.meaningless
