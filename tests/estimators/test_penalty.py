"""The penalty estimators: gradients, agreement with the SDP, feasibility by independent
eigenvalues."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from random_robots import link_parameters, open_problem, posed_task, sines, tree
from small_runs import thinned

from sdp_vs_penalty import Measurements, identify, simulate
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.estimation import certify
from sdp_vs_penalty.estimators import (
    LmiSdp,
    LmiSdpThickness,
    PenalisedLoss,
    Penalty,
    PenaltyTwoStep,
    make_estimator,
    penalty,
)
from sdp_vs_penalty.estimators.estimator import Fit
from sdp_vs_penalty.estimators.penalty import PROVEN_GAP
from sdp_vs_penalty.robot import inertia


def run_of(problem, links, seed=0, noise=0.1):
    """Inverse dynamics of given links with viscous and Coulomb friction and white
    noise."""
    rng = np.random.default_rng(seed)
    n = problem.robot.n
    motion = sines(rng, n, np.arange(0.0, 8.0, 0.01))
    tau = problem.robot.inverse_dynamics(links, motion.q, motion.dq, motion.ddq)
    tau += 0.3 * motion.dq + 0.2 * np.tanh(motion.dq / 0.01)
    tau += noise * rng.normal(size=tau.shape) * np.std(tau, axis=0)
    return Measurements(motion.t, motion.q, tau, motion.dq)


def random_problem(seed, n):
    """An open box, as of a URDF; the robot whose links are returned obeys what the box
    implies."""
    rng = np.random.default_rng(seed)
    robot = tree(rng, n, link_frames=bool(seed % 2))
    nominal = np.array([link_parameters(rng, r) for r in robot.link_reach()])
    links = np.array([link_parameters(rng, r) for r in robot.link_reach()])
    return open_problem(robot, nominal), links


def task_named(name, request):
    if name in ("panda", "two_link"):
        problem = request.getfixturevalue(name)
        return posed_task(problem, run_of(problem, problem.nominal_links))
    n, seed, *side = name.split(", ")
    problem, links = random_problem(int(seed[-1]), int(n[0]))
    return posed_task(
        replace(problem, torque_side=(*side, "link")[0]), run_of(problem, links)
    )


#: The SDP that gets the arrays that `penalty` gets, and no more.
SAME = LmiSdp(entropy=0.0, thickness=LmiSdpThickness.thickness)


@pytest.mark.parametrize(
    "name",
    [
        *("two_link", "panda", "1 joint, seed 0", "3 joints, seed 3"),
        pytest.param("6 joints, seed 4", marks=pytest.mark.long),
        pytest.param(
            "3 joints, seed 3, unknown", marks=pytest.mark.long
        ),  # rotors beside the links
    ],
)
def test_penalty_reaches_the_sdp_and_is_feasible(name, request):
    task = task_named(name, request)
    _, sdp = certify(task, SAME.fit(task))
    fit = Penalty(starts=3).fit(task)
    theta, certificate = certify(task, fit)
    assert abs(certificate.loss / sdp.loss - 1.0) < 1e-6
    # Every start, not only the best one.
    assert max(run["loss"] for run in fit.details["runs"]) < sdp.loss * (1.0 + 1e-5)
    assert certificate.worst <= 1e-9
    assert (
        inertia.thickness(theta[task.links]).min() >= LmiSdpThickness.thickness - 1e-9
    )
    # Its own multipliers prove it.
    assert -1e-9 <= certificate.gap < 1e-3


def little_motion(seed, n=4):
    """The task of a robot whose joints hardly move: most of its links stay open."""
    problem, links = random_problem(seed, n)
    rng = np.random.default_rng(seed)
    motion = sines(rng, n, np.arange(0.0, 4.0, 0.01))
    centre = motion.q.mean(axis=0)
    q, dq, ddq = (
        centre + 0.02 * (motion.q - centre),
        0.02 * motion.dq,
        0.02 * motion.ddq,
    )
    tau = problem.robot.inverse_dynamics(links, q, dq, ddq) + 0.3 * dq
    tau += 0.05 * rng.normal(size=tau.shape)
    return posed_task(problem, Measurements(motion.t, q, tau, dq))


def least_loss_by_cvxpy(task, constraints):
    """The least loss under convex constraints, stated anew for CVXPY: parameters in
    units of what makes the torque, no scaling or certificate of ours."""
    cp = pytest.importorskip("cvxpy")
    data = task.data
    norms = np.linalg.norm(data.R, axis=0)
    size = np.sqrt(data.tau_squared)
    unit = np.minimum(np.divide(size, norms, where=norms > 0, out=norms + np.inf), 1.0)
    x = cp.Variable(len(unit))
    theta = cp.multiply(unit, x)
    demands = []
    for c in constraints.convex:
        terms = [
            theta[int(k)] * F for k, F in zip(c.indices, c.coefficients, strict=True)
        ]
        F = c.constant + sum(terms)
        if c.cone == "psd":
            demands.append(F >> 0)
        elif c.cone == "soc":
            demands.append(cp.SOC(F[0], F[1:]))
        else:
            demands.append(F >= 0)
    root = np.sqrt(data.loss(task.ols))
    residual = (data.R @ theta - data.rho) / root
    problem = cp.Problem(cp.Minimize(cp.sum_squares(residual)), demands)
    problem.solve(solver="CLARABEL")
    return problem.value * root**2 + data.residual_norm**2


@pytest.mark.parametrize(
    "seed", [0, *(pytest.param(k, marks=pytest.mark.long) for k in (1, 2))]
)
def test_penalty_is_proved_where_little_motion_leaves_links_open(seed):
    """There its own stages do not settle; the convex relaxation ends the search."""
    task = little_motion(seed)
    fit = Penalty(joint_prior=0.0).fit(task)
    _, certificate = certify(task, fit)
    least = least_loss_by_cvxpy(task, Penalty().demands(task))
    assert certificate.worst == 0.0
    assert certificate.loss == pytest.approx(least, rel=1e-5)
    assert -1e-9 <= certificate.gap <= PROVEN_GAP
    assert len(fit.details["runs"]) == 2


def test_a_loose_relaxation_of_a_convex_problem_is_the_last_start(monkeypatch):
    monkeypatch.setattr(penalty, "PROVEN_GAP", 0.0)
    task = little_motion(0)
    fit = Penalty(joint_prior=0.0).fit(task)
    assert len(fit.details["runs"]) == 2
    assert fit.gap <= 1e-8


@pytest.mark.parametrize("gap", [1.0, 1.5, np.nan])
@pytest.mark.parametrize("method", ["penalty", "lmi-sdp", "lmi-sdp-two-step"])
def test_identify_refuses_an_answer_of_which_nothing_is_proved(
    gap, method, monkeypatch
):
    """A table of methods shows it with its gap; least squares has nothing to prove."""
    run = thinned(simulate("two_link", seed=3)).train
    monkeypatch.setattr(Fit, "gap", gap)
    identify("two_link", run, method="ols", check=False)
    with pytest.raises(InputError, match=r"not found: .* lengths in mm .*--fix"):
        identify("two_link", run, method=method, check=False)


@pytest.mark.long
def test_penalty_obeys_bounds_that_no_sdp_can_take(panda):
    box = panda.box.copy()
    box[:, [4, 6, 9], 1], box[:, [5, 7, 8], 0], box[:, [5, 7, 8], 1] = 0.02, -1e-3, 1e-3
    tight = replace(panda, box=box)
    task = posed_task(tight, run_of(panda, panda.nominal_links, noise=0.02))
    _, sdp = certify(task, SAME.fit(task))
    assert sdp.violations["barycentric inertia"] > 1e-3
    theta, certificate = certify(task, Penalty(starts=1).fit(task))
    moments = inertia.barycentric_from_standard(theta[task.links])[:, 4:]
    assert np.all(moments >= box[:, 4:, 0] - 1e-9)
    assert np.all(moments <= box[:, 4:, 1] + 1e-9)
    assert certificate.worst <= 1e-9
    assert certificate.loss >= (sdp.lower or 0.0) * (1.0 - 1e-9)


def test_penalty_two_step_minimises_the_distance_to_the_base_parameters(panda):
    task = posed_task(panda, run_of(panda, panda.nominal_links, noise=0.3))
    theta, certificate = certify(task, PenaltyTwoStep(starts=1).fit(task))
    assert certificate.worst <= 1e-9
    assert certificate.gap < 1e-3  # of its own objective
    one_step, other = certify(task, Penalty(starts=1).fit(task))
    assert task.base_distance.loss(theta) < task.base_distance.loss(one_step)
    assert other.loss < certificate.loss


@pytest.mark.parametrize(
    "method",
    ["penalty-paper", pytest.param("penalty-paper-two-step", marks=pytest.mark.long)],
)
def test_paper_stays_in_its_box_and_reports_runs(method, two_link):
    said = []
    task = replace(
        posed_task(two_link, run_of(two_link, two_link.nominal_links, noise=0.3)),
        progress=said.append,
    )
    loss = PenalisedLoss(task, task.data, np.arange(len(task.bound)))
    box = loss.box
    rng = np.random.default_rng(0)
    u = rng.uniform(0.2, 0.8, len(task.bound))
    step = 1e-6 * rng.normal(size=len(task.bound))
    after = loss.value(u + 1.0 * step, 40.0)
    before = loss.value(u + -1.0 * step, 40.0)
    assert after - before == pytest.approx(
        2.0 * step @ loss.gradient(u, 40.0), rel=1e-4
    )
    assert loss.penalty(loss.p(u)) > 0.0
    p = loss.p(u)
    family = "centre of mass cone"
    theta = box.theta(p)
    step = 1e-7 * rng.normal(size=len(p))
    for demand in loss.demands:
        after = demand.margins(p + step)
        before = demand.margins(p - step)
        _, rows = demand.margins_and_slopes(p)
        slope = rows @ step[: rows.shape[1]]
        assert_allclose(after - before, 2.0 * slope, rtol=1e-3, atol=1e-12)
    of_family = [d.margins(p) for d in loss.demands if d.family == family]
    cones = [c for c in task.constraints.convex if c.family == family]
    margins = [
        c.margin(theta) / theta[c.indices[0]] for c in cones
    ]  # of the centre, not of m c
    assert_allclose(np.sort(np.concatenate(of_family)), np.sort(margins), rtol=1e-9)
    worst = loss.violations(p)
    assert worst[family] == pytest.approx(max(0.0, -np.min(margins)))
    moments = np.linalg.eigvalsh(inertia.inertia_matrix(p[box.links[:, 4:]]))
    assert worst["triangle inequality"] == pytest.approx(
        max(0.0, *moments @ [-1.0, -1.0, 1.0])
    )
    estimator = replace(make_estimator(method), runs=3, evaluations=1000)
    fit = estimator.fit(task)
    p = box.p(fit.theta)
    assert_allclose(
        box.theta(p), fit.theta, rtol=1e-9, atol=1e-9
    )  # nothing was clipped
    assert np.all(np.isfinite(box.lower))
    assert np.all(np.isfinite(box.upper))
    runs = fit.details["runs"]
    assert len(runs) == 3 == len(said)
    assert all("violation" in text for text in said)
    best = min(runs, key=lambda run: run["penalised"])
    assert task.data.loss(fit.theta) == pytest.approx(best["loss"], rel=1e-12)
    free = replace(estimator, runs=1, evaluations=300, weights=(40.0, 40.0, 0.0)).fit(
        task
    )
    (run,) = free.details["runs"]  # judged by the last weight
    assert run["penalised"] == pytest.approx(run["objective"], rel=1e-9)
    assert all(0 < run["evaluations"] < 2000 for run in runs)
