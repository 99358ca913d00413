"""Cross-validation by phase blocks: each row judged once, by a model that has not seen
its motion."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from random_robots import repeating_run

from sdp_vs_penalty import InputError, cross_validate
from sdp_vs_penalty.signals import Preprocessing


def run_of(problem, seconds=24.0):
    """Period 10 s; the friction is not what the model has: it errs on motion that it
    has not seen."""
    effects = "rigid_body,viscous_friction"
    run = repeating_run(problem, 1, 0.02, seconds=seconds, effects=effects)
    return replace(run, tau=run.tau + 0.3 * np.sin(3.0 * run.q))


def test_errors_are_of_unseen_motion(two_link):
    result = cross_validate(two_link, run_of(two_link), "ols", folds=4)
    assert result.periodic
    assert len(result.folds) == 4
    worst = max(f.relative_error_percent for f in result.folds)
    assert result.folds[result.worst_fold - 1].relative_error_percent == worst
    assert f"worst fold {result.worst_fold}: {worst:.3g} %" in result.verdict
    rows = sum(f.rows for f in result.folds)
    assert_allclose(
        result.rmse**2, sum(f.losses for f in result.folds) / rows, rtol=1e-12
    )
    assert [f.start for f in result.folds] == pytest.approx(
        [0.0, 2.5, 5.0, 7.5], abs=0.02
    )
    frame = result.to_frame()
    assert list(frame.index) == [(k, j) for k in (1, 2, 3, 4) for j in (1, 2)]
    for number, fold in enumerate(result.folds, start=1):
        of_fold = frame.loc[number]
        assert_array_equal(of_fold["error [N m or N]"], fold.rmse)
        assert set(of_fold["start [s]"]) == {fold.start}
        assert set(of_fold["relative error [%]"]) == {fold.relative_error_percent}


def test_a_torque_of_the_judged_phase_does_not_reach_its_model(two_link):
    """Another torque in one phase, in every period, changes no parameter of the fold
    that tests it."""
    run = run_of(two_link)
    tau = run.tau.copy()
    tau[(run.t % 10.0 > 2.6) & (run.t % 10.0 < 4.9)] += 5.0
    changed = replace(run, tau=tau)
    effects = ["rigid_body", "viscous_friction", "torque_gain"]
    for names in (None, effects):
        options = {"effects": names, "folds": 4, "weighting": "none"}
        before, after = (
            cross_validate(two_link, x, "ols", **options) for x in (run, changed)
        )
        assert_allclose(
            after.folds[1].theta, before.folds[1].theta, rtol=1e-7, atol=1e-9
        )
        assert np.abs(after.folds[0].theta - before.folds[0].theta).max() > 1e-3


def test_shape_constants_are_each_folds_own(two_link):
    """Friction that turns round over another velocity than declared is predicted as by
    one who knows it, and what the judged phase says of that velocity is not heard."""
    run = run_of(two_link, seconds=40.0)
    tau = (
        run.tau
        - 0.3 * np.sin(3.0 * run.q)
        + np.tanh(np.gradient(run.q, run.t, axis=0) / 0.025)
    )
    effects = "rigid_body,viscous_friction,torque_offset,coulomb_friction"
    run = replace(run, tau=tau)
    found, told, declared = (
        cross_validate(two_link, run, "ols", effects=effects + width, folds=4).rmse
        for width in ("", "@v_s=0.025", "@v_s=0.01")
    )
    assert np.all(found < 1.05 * told)
    assert np.all(declared > 1.1 * told)


def test_what_cannot_be_split_is_refused(two_link):
    with pytest.raises(InputError, match="fewer folds"):
        cross_validate(
            two_link,
            run_of(two_link),
            "ols",
            folds=2,
            preprocessing=Preprocessing(2.0, 3.0),
        )
    with pytest.raises(InputError, match="2 or more"):
        cross_validate(two_link, run_of(two_link), "ols", folds=1)
