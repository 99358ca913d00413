"""Contracts that every estimator in the registry keeps, whoever writes it."""

import dataclasses
import json
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from numpy.testing import assert_allclose
from random_robots import repeating_run, sines
from unchecked import identify

from sdp_vs_penalty.effects.effect import Parameter
from sdp_vs_penalty.estimation import certify
from sdp_vs_penalty.estimators import estimator_types, joint_weights, make_estimator
from sdp_vs_penalty.regression import Factor, Regression
from sdp_vs_penalty.robot import inertia
from sdp_vs_penalty.testing.methods import ESTIMATOR_CONTRACTS, first_fit, small_task

NAMES = list(estimator_types())
MEASURED = [name for name in NAMES if not estimator_types()[name].needs_black_box]
EVERY = pytest.mark.parametrize("method", NAMES)
#: Methods that promise an answer inside the convex constraints.
CONSTRAINED = [
    n
    for n in MEASURED
    if n.startswith("lmi-sdp") or n in ("penalty", "penalty-two-step")
]


def quick(method):
    """The method with settings that make it fast: fewer runs, the same steps."""
    estimator = make_estimator(method)
    names = {f.name for f in dataclasses.fields(estimator)}
    small = {"runs": 2, "evaluations": 300, "starts": 2}
    return replace(estimator, **{k: v for k, v in small.items() if k in names})


toy_run = partial(repeating_run, seed=0, motion_seed=5, seconds=10.0)


@EVERY
def test_every_estimator_keeps_every_contract(method):
    for contract in ESTIMATOR_CONTRACTS:
        contract(quick(method))


@pytest.mark.parametrize("method", CONSTRAINED)
def test_promised_constraints_hold_by_an_independent_check(method):
    task = small_task()
    theta, certificate = certify(task, first_fit(quick(method)))
    links = theta[task.links]
    assert np.all(np.linalg.eigvalsh(inertia.pseudo_inertia(links)) >= -1e-10)
    masses = links[:, 0]
    assert np.all(
        (masses >= task.box[:, 0, 0] - 1e-9) & (masses <= task.box[:, 0, 1] + 1e-9)
    )
    h = links[:, 1:4]
    low = task.box[:, 1:4, 0]
    high = task.box[:, 1:4, 1]
    with np.errstate(invalid="ignore"):
        assert not np.any(h < low * masses[:, None] - 1e-8)
        assert not np.any(h > high * masses[:, None] + 1e-8)
    assert certificate.violations["pseudo-inertia"] <= 1e-10


@pytest.mark.parametrize("method", MEASURED)
def test_noise_free_torque_is_reproduced_by_all_that_can(method, two_link):
    """penalty-paper excepted: two runs of annealing need not arrive."""
    if method.startswith("penalty-paper"):
        pytest.skip("a stochastic search with a budget promises nothing")
    run = toy_run(two_link, noise=0.0)
    said = []
    estimate = identify(two_link, run, quick(method), progress=said.append)
    assert said
    assert all(said)
    assert estimate.method == method
    json.dumps(estimate.to_dict(), allow_nan=False)
    motion = sines(np.random.default_rng(8), 2, np.arange(0.0, 5.0, 0.01), 0.13, 5)
    truth = two_link.nominal(two_link.model())
    truth[20:] = 0.4
    torque = two_link.model().torque(truth, motion)
    error = np.linalg.norm(estimate.torque(motion) - torque) / np.linalg.norm(torque)
    assert error < (1e-6 if method.startswith(("ols", "lmi")) else 1e-4)


def test_weights_make_the_residuals_of_all_joints_equal():
    """Each measures 3 theta with residuals of another size."""
    sigmas = [0.1, 1.0, 5.0]
    factors = []
    rows = 50
    for joint, sigma in enumerate(sigmas):
        triangle = np.sqrt(rows) * np.array([[3.0, 3.0], [0.0, sigma]])
        factors.append(Factor(joint, 0, np.array([0]), triangle, rows))
    regression = Regression(
        (Parameter("x", "-", "e", 0),), len(sigmas), (), tuple(factors)
    )
    weights = joint_weights(regression, np.array([1.0]))
    assert_allclose(weights * sigmas, (weights * sigmas)[0], rtol=1e-9)
    # Their scale keeps the meaning of the loss: the sum of squares over all joints
    # stays.
    assert np.sum((weights * sigmas) ** 2) == pytest.approx(np.sum(np.square(sigmas)))


def test_ols_is_the_minimiser_nearest_to_the_nominal_robot():
    task = small_task()
    gradient = task.data.gradient(task.ols)
    scale = np.where(task.data.column_norms > 0.0, task.data.column_norms, 1.0)
    assert np.abs(gradient / scale).max() < 1e-6 * np.sqrt(task.data.tau_squared)
    unseen = task.data.column_norms == 0.0
    assert unseen.any()
    assert_allclose(task.ols[unseen], task.nominal[unseen], atol=1e-9)
