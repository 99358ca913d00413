"""Intervals that hold the truth as often as they say, and verdicts that mean something."""

import pickle
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest
import scipy
from numpy.testing import assert_allclose
from random_robots import repeating_run
from small_runs import small_run
from unchecked import identify

from sdp_vs_penalty.estimation import (
    LEVEL,
    NORMAL_95,
    NOT_SEEN,
    Interval,
    Sandwich,
    Uncertainty,
    counts,
    regression_uncertainty,
)
from sdp_vs_penalty.estimation.uncertainty import LateUncertainty, unit_by
from sdp_vs_penalty.estimators import LmiSdp, make_task
from sdp_vs_penalty.regression import base_rows, compress
from sdp_vs_penalty.robot import inertia, random_trajectory
from sdp_vs_penalty.signals import FilteredRuns, filtered
from sdp_vs_penalty.simulation import Sensor
from sdp_vs_penalty.simulation.experiments import simulate

EFFECTS = "rigid_body,viscous_friction,coulomb_friction,torque_offset"


def test_normal_quantile():
    """The constant is written out: importing scipy.special for it takes too long."""
    assert scipy.special.ndtri((1 + LEVEL) / 2) == NORMAL_95


def truth_of(problem, model):
    theta = problem.nominal(model)
    links = len(model.rigid_indices)
    theta[links:] = np.linspace(0.4, 1.1, len(theta) - links)
    return theta


def measured(problem, model, seed, seconds):
    """A run of exactly this model with white torque noise."""
    theta = truth_of(problem, model)
    trajectory = random_trajectory(problem.robot, seed=3, duration=seconds)
    ideal = Sensor(200.0, np.zeros(problem.robot.n))
    clean = simulate(
        trajectory, lambda motion: model.torque(theta, motion), ideal, seed
    )
    noise = (
        np.random.default_rng(seed).normal(size=clean.tau.shape)
        * 0.05
        * clean.tau.std(axis=0)
    )
    return replace(clean, tau=clean.tau + noise)


def told(problem, model, run):
    data = compress(FilteredRuns.filtering(run, problem.preprocessing), model)
    return regression_uncertainty(
        make_task(problem, model, data), data, base_rows(model, problem.independent)
    )


def test_intervals_hold_the_truth(two_link):
    """Over many repetitions with fresh noise, 95 % intervals hold the true values in
    about 95 %."""
    model = two_link.model(EFFECTS)
    theta = truth_of(two_link, model)
    shares = []
    spreads = []
    for seed in range(15):
        run = measured(two_link, model, seed, 40.0)
        known = told(two_link, model, run)
        base = [i for i in known.base if np.isfinite(i.lower)]
        values = base_rows(model, two_link.independent).rows @ theta
        assert len(base) == len(values)
        shares.append(
            np.mean(
                [i.lower <= x <= i.upper for i, x in zip(base, values, strict=True)]
            )
        )
        drawn = np.sum(
            (base_rows(model, two_link.independent).rows @ known.spread) ** 2, axis=1
        )
        spreads.append(np.mean(drawn / np.square([i.std for i in base])))
    assert 0.90 <= np.mean(shares) <= 0.99
    # The joint covariance is that of the intervals, which Student's quantile makes a
    # little longer.
    assert 0.8 <= np.mean(spreads) <= 1.0


def test_white_intervals_are_those_of_a_gaussian_posterior(two_link):
    """Of white noise and of friction that is known beforehand to 0.02, each in its
    unit."""
    model = two_link.model(EFFECTS)
    run = measured(two_link, model, 1, 20.0)
    data = compress(FilteredRuns.filtering(run, two_link.preprocessing), model)
    weights = make_task(two_link, model, data).weights
    scale = np.where(
        np.isin(np.arange(len(model.parameters)), model.rigid_indices), np.inf, 0.02
    )
    found = Sandwich(data, weights, scale, is_white=True)
    R = data.least_squares(weights).R
    rows = base_rows(model, two_link.independent).rows
    unit = 1.0 / np.maximum(np.linalg.norm(R, axis=0), 1e-9)
    information = (R * unit).T @ (R * unit) + found.white_variance * np.diag(
        (unit / scale) ** 2
    )
    expected = (
        found.white_variance
        * (rows * unit)
        @ np.linalg.pinv(information, 1e-9, hermitian=True)
    )
    expected = NORMAL_95 * np.sqrt(np.sum(expected * (rows * unit), axis=1))
    assert_allclose(found.half_widths(rows), expected, rtol=1e-5)


def test_intervals_end_where_what_is_possible_does(two_link):
    """Of torque that is noise: masses within their bounds, no moment of inertia below
    zero, no brake that drives; whichever way a combination of them goes."""
    model = two_link.model(EFFECTS)
    run = measured(two_link, model, 0, 20.0)
    run = replace(
        run, tau=run.tau + 60.0 * np.random.default_rng(9).normal(size=run.tau.shape)
    )
    data = compress(FilteredRuns.filtering(run, two_link.preprocessing), model)
    base = base_rows(model, two_link.independent)
    task = make_task(two_link, model, data)
    theta = LmiSdp().fit(task).theta
    task.box[:, 0, 0] = 0.3
    known = regression_uncertainty(task, data, base, theta, constrained=True)
    low = -task.bound
    high = task.bound
    names = [p.name for p in model.parameters]
    positive = [
        k for k, n in enumerate(names) if n[:3] in ("Ixx", "Iyy", "Izz", "f_v", "f_c")
    ]
    low[positive], low[task.links[:, 0]] = 0.0, 0.3
    with np.errstate(invalid="ignore"):
        corners = np.nansum(
            np.sort([base.rows * low, base.rows * high], axis=0), axis=2
        )
    for i, row, *ends in zip(known.base, base.rows, *corners, strict=True):
        least = row @ task.ols
        half = NORMAL_95 * i.std
        value = row @ theta
        assert i.lower == pytest.approx(
            min(max(least - half, ends[0]), value), abs=1e-9
        )
        assert i.upper == pytest.approx(
            max(min(least + half, ends[1]), value), abs=1e-9
        )


def test_what_cannot_be_seen_is_said(two_link):
    """Link 1 of the 2R turns about a vertical axis: of its ten parameters one makes
    torque."""
    model = two_link.model(EFFECTS)
    known = told(two_link, model, measured(two_link, model, 0, 40.0))
    verdicts = {i.name: i for i in known.standard}
    for name in inertia.parameter_names(1):
        if name != "Iyy1":  # its link frame's y axis is the joint's
            assert verdicts[name].verdict == NOT_SEEN
            assert np.isinf(verdicts[name].lower)
    assert (
        verdicts["mx2"].verdict == NOT_SEEN
    )  # only mx2 + 0.8 m2: the frame is at the far end
    assert (
        verdicts["my2"].verdict == "weakly"
    )  # seen, but it is zero within its interval
    for name in ("f_c1", "f_c2", "f_v2"):
        assert verdicts[name].verdict == "identifiable", verdicts[name]
        assert verdicts[name].lower < verdicts[name].value < verdicts[name].upper
    assert sum(counts(known.base).values()) == len(known.base) == 8 + 6
    assert counts(known.base)[NOT_SEEN] == 0


def test_what_the_prior_determines_is_not_identifiable(two_link):
    """Ixz4 was "identifiable" and from the "prior"; counts of terminal and report
    differed by such parameters."""
    run = repeating_run(two_link, 0, seconds=2.0)
    estimate = identify(two_link, run)
    entries = estimate.details["base_parameters"]
    by_interval = [x.verdict != NOT_SEEN for x in estimate.uncertainty.base]
    assert by_interval == [entry["source"] == "data" for entry in entries]
    assert 0 < estimate.n_base_from_data < estimate.n_base
    words = counts(estimate.uncertainty.standard)
    assert words["identifiable"] + words["weakly"] == estimate.n_from_data


def test_intervals_are_worked_out_once_when_they_are_first_read(two_link):
    late = identify(two_link, small_run(two_link)).uncertainty
    assert type(late) is LateUncertainty
    copied = pickle.loads(pickle.dumps(late))
    assert type(copied) is type(late) is Uncertainty
    assert copied.to_dict() == late.to_dict()
    with pytest.raises(AttributeError, match="widths"):
        _ = late.widths
    again = replace(late, spread=2.0 * late.spread)
    assert np.array_equal(again.spread, 2.0 * late.spread)


def test_threads_read_intervals_that_one_of_them_works_out():
    """Every thread comes while the first one still works them out; none works them out
    again."""
    one = Interval("m1", "kg", 1.0, std=0.1)
    known = Uncertainty((), *map(np.ones, ((1, 2), (1, 1), 1, (1, 1))), standard=(one,))
    calls = []
    together = threading.Barrier(8)

    def make():
        calls.append(threading.get_ident())
        time.sleep(0.05)
        return known

    late = LateUncertainty(make)

    def read(_):
        together.wait()
        return float(late.spread.sum())

    with ThreadPoolExecutor(8) as threads:
        sums = list(threads.map(read, range(8)))
    assert sums == [float(known.spread.sum())] * 8
    assert len(calls) == 1


def test_intervals_of_long_runs_are_worked_out_at_once(two_link, monkeypatch):
    run = small_run(two_link)
    later = identify("two_link", run).uncertainty
    monkeypatch.setattr(filtered, "SAMPLES", run.q.size - 1)
    at_once = identify("two_link", run).uncertainty
    assert type(at_once) is Uncertainty
    assert np.allclose(at_once.std, later.std, equal_nan=True)


@pytest.mark.parametrize(
    ("unit", "in_amperes"),
    [
        ("N*m", "A"),
        ("N*m*s/rad", "A*s/rad"),
        ("kg", "kg*A/(N*m)"),
        ("kg*m^2", "kg*m^2*A/(N*m)"),
    ],
)
def test_units_of_parameters_follow_the_torque_s(unit, in_amperes):
    assert unit_by(unit, "A") == in_amperes


def test_no_parameter_of_a_log_of_currents_is_in_kilograms(two_link):
    run = small_run(two_link)
    columns = {"t": run.t}
    for k in (0, 1):
        columns |= {f"q_{k}": run.q[:, k], f"current_{k}": run.tau[:, k]}
    model = identify(two_link, columns, "ols")
    units = set(model.to_frame()["unit"])
    assert {"A", "A*s/rad", "kg*A/(N*m)"} <= units
    assert not units & {"kg", "N*m"}
