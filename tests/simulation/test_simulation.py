"""Simulated measurements, each part by itself; models run forward along measured runs."""

import pickle
from dataclasses import replace

import numpy as np
import pytest
from arms import SCARA, write_urdf
from numpy.testing import assert_allclose, assert_array_equal
from recorded import refusal
from scipy import signal
from small_runs import small_run
from unchecked import identify

from sdp_vs_penalty import InputError, Measurements, compare, follow, load_problem
from sdp_vs_penalty.robot import random_trajectory
from sdp_vs_penalty.robot._pinocchio import pin
from sdp_vs_penalty.simulation import (
    Sensor,
    TrueMotion,
    experiment,
    innovation_share,
    misplaced,
    sigmoid_torque,
    torques,
    true_world,
)
from sdp_vs_penalty.simulation.experiments import simulate
from sdp_vs_penalty.simulation.hidden_runs import hidden_runs, planned


def test_an_ideal_sensor_shows_the_truth(panda):
    x = experiment(panda)
    model = panda.model(["rigid_body"])
    m = simulate(
        x.trajectory,
        lambda motion: model.torque(x.links.ravel(), motion),
        Sensor(1e3, np.zeros(7)),
    )
    q, dq, ddq = x.trajectory.states(m.t)
    assert_array_equal(m.q, q)
    assert np.ptp(np.diff(m.t)) < 1e-12
    # The regressor's torque against Newton-Euler's: two routes to the same number.
    expected = panda.robot.inverse_dynamics(x.links, q, dq, ddq)
    assert_allclose(m.tau, expected, atol=1e-10)


def test_sigmoid_friction_is_the_papers_formula(panda):
    phi = experiment(panda).friction
    dq = np.random.default_rng(0).uniform(-2.0, 2.0, (50, 7))
    got = sigmoid_torque(phi, dq)
    p1, p2, p3 = phi.T
    expected = p1 / (1 + np.exp(-p2 * (dq + p3))) - p1 / (1 + np.exp(-p2 * p3))
    assert_allclose(got, expected, atol=1e-13)
    assert_allclose(sigmoid_torque(phi, np.zeros((1, 7))), 0.0, atol=1e-15)


def test_noise_has_the_spectrum_it_is_given(panda):
    sensor = experiment(panda).sensor
    e = sensor.noise(200_000, np.random.default_rng(1))
    assert_allclose(e.std(axis=0), sensor.torque_std, rtol=0.02)
    for j in range(7):
        whitened = signal.lfilter(sensor.poles[j], [1.0], e[:, j])
        share = whitened.var() / e[:, j].var()
        assert share == pytest.approx(innovation_share(sensor.poles[j]), rel=0.02)
        lagged = [np.corrcoef(whitened[k:], whitened[:-k])[0, 1] for k in range(1, 9)]
        assert np.abs(lagged).max() < 0.01


def test_an_unstable_noise_process_is_refused():
    refusal(lambda: Sensor(1000.0, np.ones(1), torque_ar=[[1.01]]), "no stable process")


def test_the_log_is_jittered_held_and_quantised_as_the_real_one(panda):
    m = experiment(panda).training_run()
    steps = np.diff(m.t)
    assert steps.min() > 0.0
    assert steps.mean() == pytest.approx(1.0222e-3, rel=0.01)
    repeated = np.mean(np.all(np.diff(m.q, axis=0) == 0.0, axis=1))
    assert 0.04 < repeated < 0.09  # 6.1 % in the real log
    for j, step in enumerate(experiment(panda).sensor.torque_step):
        assert_allclose(m.tau[:, j] / step, np.round(m.tau[:, j] / step), atol=1e-6)
    assert np.diff(np.unique(np.round(m.q[:, 0], 7))).min() == pytest.approx(1e-5)


def test_misplaced_joints_are_off_by_errors_of_the_size_told(panda):
    """About and along every axis, normal and independent of each other."""
    model = true_world(panda, experiment(panda), 0).arm.model
    rng = np.random.default_rng(0)
    metres = 2e-4
    degrees = 0.03
    off = []
    for _ in range(300):
        built = misplaced(model, metres, degrees, rng)
        pairs = zip(model.jointPlacements[1:], built.jointPlacements[1:], strict=True)
        off += [pin.log(a.inverse() * b).vector for a, b in pairs]
    expected = np.diag([metres] * 3 + [np.deg2rad(degrees)] * 3) ** 2
    scale = np.sqrt(np.diag(expected))
    assert_allclose(
        np.cov(np.transpose(off)) / np.outer(scale, scale), np.eye(6), atol=0.1
    )


def test_a_temperature_is_logged_where_friction_follows_it(two_link):
    for name, logged in (("warming_friction", True), ("joint_spring", False)):
        (run,) = hidden_runs(two_link, [(name, [0])], "weak", seed=0, count=1).runs
        assert (run.temperature is not None) is logged


def test_a_torque_channel_carries_what_is_hidden_besides(two_link):
    runs = hidden_runs(
        two_link, [("torque_gain", [0]), ("joint_spring", [0])], seed=2, count=1
    )
    t = np.arange(0.0, 1.0, 1e-3)
    motion = TrueMotion(
        t, *(np.outer(np.sin(3.0 * t + k), [1.0, 0.5]) for k in range(3))
    )
    gain, spring = torques(runs.world, motion, runs.hidden)
    whole = runs.world.torque(motion) + spring
    assert_allclose(gain[:, 0], runs.truth["effects"][0]["size"] * whole[:, 0])
    assert not gain[:, 1].any()
    assert_array_equal(spring[:, 0], runs.hidden[1].size * motion.q[:, 0])


@pytest.mark.parametrize(
    ("written", "given", "law"),
    [
        (
            "stribeck_friction:2@vs=0.2",
            {"vs": 0.2},
            lambda q, dq: np.exp(-25.0 * dq**2),
        ),
        ("power_law_friction:2@alpha=3", {"alpha": 3.0}, lambda q, dq: dq**3),
        ("end_stop:2@q0=0.1", {"q0": 0.1}, None),
        ("presliding_hysteresis:2@d=0.02", {"d": 0.02}, None),
    ],
)
def test_a_constant_that_is_given_is_hidden(written, given, law, two_link):
    truth, _ = planned(two_link, written, seed=3)
    (entry,) = truth["effects"]
    assert entry["shape"].items() >= given.items()
    name = written.partition(":")[0]
    drawn = planned(two_link, f"{name}:2", seed=3)[0]["effects"][0]
    others = drawn["shape"].keys() - given
    assert all(entry["shape"][key] == drawn["shape"][key] for key in others)
    if law is None:
        return
    runs = planned(two_link, written, seed=3)[1]()
    t = np.arange(0.0, 0.1, 1e-2)
    q, dq = np.outer(t, [1.0, 1.0]), np.outer(0.2 + t, [1.0, 1.0])
    (torque,) = torques(runs.world, TrueMotion(t, q, dq, 0.0 * q), runs.hidden)
    expected = entry["size"] * law(q[:, 1], dq[:, 1])
    assert_allclose(torque[:, 1], expected, rtol=1e-6)


@pytest.mark.parametrize(
    ("written", "said"),
    [
        ("torque_delay:2@T=0.01", "T cannot be chosen.*leave it out"),
        ("stribeck_friction:2@law=2", "law cannot be chosen.*choose vs and delta"),
        ("transmission_friction:1+2@c1=2", "c1 cannot be chosen"),
    ],
)
def test_a_constant_that_no_world_takes_is_refused(written, said, two_link):
    with pytest.raises(InputError, match=said):
        planned(two_link, written)


def test_simulated_runs_can_be_pickled(two_link):
    runs = hidden_runs(two_link, [("joint_spring", [0])], seed=2, count=1)
    again = pickle.loads(pickle.dumps(runs))
    assert again.truth == runs.truth
    assert_array_equal(again.test.tau, runs.test.tau)


def test_any_robot_has_an_experiment(tmp_path):
    urdf = write_urdf(tmp_path / "arm.urdf", "arm", SCARA[1:3])
    problem = load_problem(urdf)
    x = experiment(problem)
    estimate = identify(problem, x.training_run(), effects=x.effects)
    judged = compare(estimate, x.validation_runs()[0])[0]
    assert judged.relative_error_percent < 3.0


EFFECTS = "rigid_body,viscous_friction,coulomb_friction@v_s=0.01,torque_offset"


@pytest.fixture(scope="module")
def known(two_link):
    """A run of known truth at 250 Hz, and the model that is this truth."""
    model = two_link.model(EFFECTS)
    sizes = {"viscous_friction": 0.3, "coulomb_friction": 0.4, "torque_offset": 0.1}
    theta = np.array([sizes.get(p.effect, 0.0) for p in model.parameters])
    theta[model.rigid_indices] = two_link.nominal_links.ravel()
    trajectory = random_trajectory(two_link.robot, 1, 6.0)
    run = simulate(
        trajectory,
        lambda motion: model.torque(theta, motion),
        Sensor(250.0, np.zeros(2)),
    )
    return replace(identify(two_link, run, effects=EFFECTS), theta=theta), run


@pytest.mark.long
def test_the_truth_follows_itself(known):
    estimate, run = known
    made = follow(estimate, run)
    assert np.all(made.share < 0.02)
    assert not made.free[0].left
    assert made.free[0].seconds > 5.5
    assert np.all(made.free[0].rms < 2e-3)
    loop = follow(estimate, run, drive="pd")
    assert np.all(loop.share < 0.02)
    assert loop.to_dict()["free_run"][0]["loop"] is not None
    assert "follow" not in made.verdict
    assert made.verdict.startswith("Simulated 0.1 s, joint ")


def test_the_band_of_a_free_run_is_that_of_the_covariance(known):
    """Not of the factor at hand, whose signs are rounding's."""
    estimate, run = known
    u = estimate.uncertainty
    turned = np.linalg.qr(
        np.random.default_rng(0).normal(size=(u.spread.shape[1],) * 2)
    )[0]
    same = replace(estimate, uncertainty=replace(u, spread=u.spread @ turned))
    made = [follow(e, run, steps=400, windows=9) for e in (estimate, same)]
    bands = [x.free[0].spread for x in made]
    assert np.all(bands[0] > 0.0)
    assert_allclose(*bands, rtol=1e-6)
    # The truth is right a step and a window ahead.
    for x in (made[0].one_step, made[0].ahead):
        assert np.all(x.rms < 0.01 * x.naive)


@pytest.mark.long
def test_a_loop_adds_the_torque_that_a_model_lacks(known):
    """Nothing to the truth; to links that weigh a tenth more than they do a tenth of
    what moves them.
    From where the robot begins to move."""
    estimate, moved = known
    rows = np.r_[np.zeros(250, int), 0 : len(moved.t)]
    run = Measurements(np.arange(len(rows)) / 250.0, moved.q[rows], moved.tau[rows])
    links = estimate.model.rigid_indices
    theta = estimate.theta.copy()
    theta[links] *= 1.1
    heavy = replace(estimate, theta=theta)
    true = follow(estimate, run, drive="pd", steps=800, windows=1).free[0]
    more = follow(heavy, run, drive="pd", steps=800, windows=1).free[0]
    assert more.simulated.t[0] == pytest.approx(1.0, abs=0.25)
    states = random_trajectory(estimate.robot, 1, 6.0).states(more.simulated.t - 1.0)
    lacks = estimate.robot.inverse_dynamics(0.1 * estimate.theta[links], *states)
    assert_allclose(more.loop, np.sqrt(np.mean(lacks**2, axis=0)), rtol=0.04)
    assert np.all(true.loop < 0.05 * more.loop)
    still = follow(
        estimate, run.window(0.0, 0.7), steps=50, windows=3
    )  # in which nothing moves
    assert still.free[0].simulated.t[0] < 0.5
    assert np.all(still.ahead.rms < 1e-3)


def test_what_cannot_move_is_refused(known):
    estimate, run = known
    theta = estimate.theta.copy()
    theta[estimate.model.rigid_indices] *= -1.0
    refusal(
        lambda: follow(replace(estimate, theta=theta), run), "not positive definite"
    )
    refusal(lambda: follow(estimate, run, drive="wind"), "drive")
    refusal(lambda: follow(estimate, run.window(0.0, 0.2)), "s")


def test_windows_of_a_long_recording_are_followed_where_steps_are_few(two_link):
    recording = small_run(two_link, seconds=500.0)
    part = recording.window(0.0, 30.0)
    estimate = identify(two_link, part, "ols")
    made = follow(estimate, recording, steps=40, windows=3)
    starts = [float(run.simulated.t[0]) for run in made.free]
    assert len(starts) > 1
    assert starts[-1] > 450.0
    assert all("s to" in run.simulated.names[0] for run in made.free)
