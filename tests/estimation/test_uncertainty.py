"""Intervals that hold the truth as often as they say, and verdicts that mean something."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from sdp_vs_penalty import Problem, identify, load_estimate, load_problem
from sdp_vs_penalty.data.measurements import Measurements, concatenate
from sdp_vs_penalty.effects.effect import Motion
from sdp_vs_penalty.effects.model import Model
from sdp_vs_penalty.estimation.intervals import (
    IDENTIFIABLE,
    NOT_SEEN,
    WEAKLY,
    counts,
    coverage,
)
from sdp_vs_penalty.estimation.sandwich import NORMAL_95
from sdp_vs_penalty.estimation.uncertainty import of_regression
from sdp_vs_penalty.regression.base_parameters import base_rows
from sdp_vs_penalty.regression.regression import compress
from sdp_vs_penalty.robot import inertia
from sdp_vs_penalty.robot.trajectory import random_trajectory
from sdp_vs_penalty.simulation.experiment import experiment
from sdp_vs_penalty.simulation.simulate import Sensor, simulate

EFFECTS = "rigid_body,viscous_friction,coulomb_friction,torque_offset"


def truth_of(problem: Problem, model: Model) -> np.ndarray:
    theta = problem.nominal(model)
    rest = [k for k in range(len(theta)) if k not in set(model.rigid_indices.tolist())]
    theta[rest] = np.linspace(0.4, 1.1, len(rest))
    return theta


def measured(
    problem: Problem, theta: np.ndarray, model: Model, seed: int, seconds: float
) -> Measurements:
    """A run of exactly this model with white torque noise."""
    trajectory = random_trajectory(problem.robot, seed=3, duration=seconds)
    ideal = Sensor.ideal(problem.robot.n, rate=200.0)
    clean = simulate(trajectory, [lambda motion: model.torque(theta, motion)], ideal, seed)
    noise = np.random.default_rng(seed).normal(size=clean.tau.shape) * 0.05 * clean.tau.std(axis=0)
    return replace(clean, tau=clean.tau + noise)


def test_intervals_hold_the_truth(two_link: Problem) -> None:
    """Over many repetitions with fresh noise, 95 % intervals hold the true values in about 95 %."""
    model = two_link.model(EFFECTS)
    theta = truth_of(two_link, model)
    shares = []
    for seed in range(15):
        run = measured(two_link, theta, model, seed, 40.0)
        known = of_regression(two_link, model, compress(run, model, two_link.preprocessing))
        base = [i for i in known.base if np.isfinite(i.low)]
        values = base_rows(two_link, model).rows @ theta
        assert len(base) == len(values)
        shares.append(coverage(values, base))
    assert 0.90 <= np.mean(shares) <= 0.99


def test_wider_with_more_noise_and_narrower_with_more_data(two_link: Problem) -> None:
    model = two_link.model(EFFECTS)
    theta = truth_of(two_link, model)

    def width(run: Measurements) -> float:
        known = of_regression(two_link, model, compress(run, model, two_link.preprocessing))
        return float(np.median([i.high - i.low for i in known.base]))

    short, long = (measured(two_link, theta, model, 0, seconds) for seconds in (20.0, 80.0))
    noisy = replace(short, tau=short.tau + 0.2 * np.random.default_rng(1).normal(size=short.tau.shape)
                    * short.tau.std(axis=0))  # fmt: skip
    assert width(noisy) > 1.5 * width(short)
    assert width(long) < 0.8 * width(short)


def test_what_cannot_be_seen_is_said(two_link: Problem) -> None:
    """Link 1 of the 2R turns about a vertical axis: of its ten parameters one makes torque."""
    model = two_link.model(EFFECTS)
    theta = truth_of(two_link, model)
    known = of_regression(
        two_link,
        model,
        compress(measured(two_link, theta, model, 0, 40.0), model, two_link.preprocessing),
    )
    verdicts = {i.name: i for i in known.standard}
    for name in inertia.parameter_names(1):
        if name != "Iyy1":  # its link frame's y axis is the joint's
            assert verdicts[name].verdict == NOT_SEEN
            assert np.isinf(verdicts[name].low)
    assert verdicts["mx2"].verdict == NOT_SEEN  # only mx2 + 0.8 m2: the frame is at the far end
    assert verdicts["my2"].verdict == WEAKLY  # seen, but it is zero within its interval
    for name in ("f_c1", "f_c2", "f_v2"):
        assert verdicts[name].verdict == IDENTIFIABLE, verdicts[name]
        assert verdicts[name].low < verdicts[name].value < verdicts[name].high
    assert sum(counts(known.base).values()) == len(known.base) == 8 + 6
    assert counts(known.base)[NOT_SEEN] == 0


def test_an_idle_joint_leaves_its_friction_in_the_dark(two_link: Problem) -> None:
    model = two_link.model(EFFECTS)
    run = measured(two_link, truth_of(two_link, model), model, 0, 40.0)
    q = run.q.copy()
    q[:, 0] = 0.3
    known = of_regression(two_link, model, compress(replace(run, q=q), model, two_link.preprocessing))
    verdicts = {i.name: i.verdict for i in known.standard}
    assert verdicts["f_v1"] == verdicts["f_c1"] == NOT_SEEN
    assert verdicts["f_v2"] != NOT_SEEN


def test_rotors_count_with_the_inertia_that_they_cannot_be_told_from() -> None:
    problem = load_problem("ur10e")
    run = experiment(problem).training_run(0)
    model = problem.model()
    known = of_regression(problem, model, compress(run, model, problem.preprocessing))
    # Six rotors and 60 link parameters: a rank of 40 by the robot's own structure.
    rng = np.random.default_rng(5)
    q, dq, ddq = rng.normal(size=(3, 200, 6))
    pair = Model(
        problem.robot, tuple(e for e in model.effects if e.name in ("rigid_body", "rotor_inertia"))
    )
    wide = np.zeros((6 * 200, len(pair.parameters)))
    for j, block in enumerate(pair.columns(Motion(np.zeros(200), q, dq, ddq))):
        wide[200 * j : 200 * (j + 1), block.indices] = block.columns
    rank = int(np.linalg.matrix_rank(wide, tol=1e-8 * np.linalg.norm(wide, 2)))
    assert len(known.base) == rank + 18
    assert counts(known.base)[NOT_SEEN] == 0


def test_the_band_holds_torques_of_another_motion(two_link: Problem) -> None:
    """Most true torques lie in the 95 % band; measured ones in the band with noise."""
    model = two_link.model(EFFECTS)
    theta = truth_of(two_link, model)
    run = measured(two_link, theta, model, 2, 40.0)
    known = of_regression(two_link, model, compress(run, model, two_link.preprocessing))
    value = np.array([i.value for i in known.standard])
    other = random_trajectory(two_link.robot, seed=11, duration=20.0)
    t = np.linspace(1.0, 19.0, 400)
    motion = Motion(t, *other.states(t))
    centre, std = known.band(value, model.columns(motion))
    low, high = centre - NORMAL_95 * std, centre + NORMAL_95 * std
    true = model.torque(theta, motion)
    inside = float(np.mean((low <= true) & (true <= high)))
    assert inside > 0.75
    np.testing.assert_allclose(centre, model.torque(value, motion))
    noisy = true + np.random.default_rng(0).normal(size=true.shape) * known.noise
    assert np.mean(np.abs(noisy - centre) <= NORMAL_95 * np.hypot(std, known.noise)) > 0.8


def test_an_estimate_keeps_its_intervals(two_link: Problem, tmp_path: Path) -> None:
    estimate = identify(two_link, experiment(two_link).training_run(0), "ols")
    known = estimate.uncertainty
    assert [i.name for i in known.standard] == [p.name for p in estimate.model.parameters]
    assert [i.value for i in known.standard] == estimate.theta.tolist()
    data = estimate.to_dict()
    assert data["parameters"][0]["lower"] is data["parameters"][0]["std"] is None
    assert {"lower", "upper", "std", "verdict"} <= set(data["uncertainty"]["base"][0])
    estimate.save(tmp_path / "model.json")
    again = load_estimate(tmp_path / "model.json").uncertainty
    assert again.standard == known.standard or np.isnan(known.standard[0].std)
    assert str(again.standard) == str(known.standard)
    assert str(again.base) == str(known.base)
    np.testing.assert_array_equal(again.spread, known.spread)


def test_runs_keep_their_share(two_link: Problem) -> None:
    """Two runs say more than one."""
    model = two_link.model(EFFECTS)
    theta = truth_of(two_link, model)
    parts = [measured(two_link, theta, model, k, 20.0) for k in range(2)]
    both = of_regression(two_link, model, compress(concatenate(parts), model, two_link.preprocessing))
    one = of_regression(two_link, model, compress(parts[0], model, two_link.preprocessing))
    widths = [np.median([i.high - i.low for i in u.base]) for u in (both, one)]
    assert widths[0] < widths[1]


@pytest.mark.real_data
def test_the_real_panda(panda: Problem, panda_run: Measurements) -> None:
    """What carries weight is identifiable, and nothing of the 43 + 21 stays in the dark."""
    model = panda.model()
    known = of_regression(panda, model, compress(panda_run, model, panda.preprocessing))
    found = counts(known.base)
    assert len(known.base) == 43 + 21
    assert found[NOT_SEEN] == 0
    assert found[IDENTIFIABLE] > found[WEAKLY] // 2
    verdicts = {i.name.split(" ")[0]: i for i in known.base}
    for name in ("my2", "mx4", "my4", "f_c7"):
        assert verdicts[name].verdict == IDENTIFIABLE
