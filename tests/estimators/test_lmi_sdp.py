"""The convex estimators: against CVXPY with two solvers, known robots, and their own
laws."""

from dataclasses import replace

import numpy as np
import pytest
import random_robots
from arms import random_arm, random_run
from cvxpy_model import cvxpy_optimum
from drawn import given, seeds, settings
from random_robots import (
    bare,
    link_parameters,
    open_problem,
    posed_task,
    simulated,
    sines,
    tree,
)

from sdp_vs_penalty import Measurements, identify, load_problem
from sdp_vs_penalty.errors import Infeasible, InputError
from sdp_vs_penalty.estimation import certify
from sdp_vs_penalty.estimation.build_problem import build_problem
from sdp_vs_penalty.estimators import (
    LmiSdp,
    LmiSdpThickness,
    LmiSdpTwoStep,
    PosedSdp,
    interior_point,
    lmi_sdp,
    make_estimator,
)
from sdp_vs_penalty.problem import published_links
from sdp_vs_penalty.robot import ConstraintSet, inertia
from sdp_vs_penalty.shootout import Instance, in_units
from sdp_vs_penalty.solvers import Clarabel
from sdp_vs_penalty.solvers.fit import with_best_dual

METHODS = ("lmi-sdp", "lmi-sdp-plain", "lmi-sdp-thickness", "lmi-sdp-entropic")


def with_friction(problem, links, level=0.3):
    theta = np.full(len(problem.model().parameters), level)
    theta[: len(links)] = links
    return theta


def run_of_2r(two_link, noise):
    """Of the paper's links."""
    truth = with_friction(two_link, published_links(two_link, "p_real").ravel())
    return simulated(two_link.model(), truth, noise=noise, seconds=6.0)


@pytest.fixture(scope="module")
def toy_task(two_link):
    """The 2R with noise of a few percent: constraints bind."""
    return posed_task(two_link, run_of_2r(two_link, 5.0))


def test_a_body_that_an_effect_adds_is_not_pulled_to_a_link(two_link):
    """It crashed: the prior knows the robot's links alone. A load moves with the last
    link: their sum is told, and the pull is that link's."""
    run = run_of_2r(two_link, 0.1)
    plain = identify(two_link, run, check=False)
    own = [effect.name for effect in two_link.model().effects]
    carried = identify(two_link, run, effects=[*own, "payload"], check=False)
    assert carried.certificate.worst == 0.0
    assert carried.certificate.gap < 1e-6
    assert abs(carried.certificate.loss / plain.certificate.loss - 1.0) < 0.01


@pytest.mark.parametrize("method", METHODS)
def test_the_readable_model_has_the_same_optimum(method, toy_task, two_link):
    """To 1e-7 of the loss, its violations below 1e-7."""
    estimator = make_estimator(method)
    fit = estimator.fit(toy_task)
    row = toy_task.data.loss(toy_task.ols) / toy_task.data.rows
    weight = 0.0 if fit.problem.entropy is None else fit.problem.entropy.weight
    assert weight == pytest.approx(estimator.entropy * row)
    assert (weight > 0.0) == (method in ("lmi-sdp", "lmi-sdp-entropic"))
    theta, certificate = certify(toy_task, fit)
    found, value = cvxpy_optimum(two_link, toy_task, fit.problem, estimator)
    loss = fit.problem.least_squares.loss(theta)
    assert value == pytest.approx(certificate.upper, abs=1e-7 * loss)
    assert fit.problem.value(found) == pytest.approx(certificate.upper, abs=1e-7 * loss)
    assert fit.problem.constraints.margin(found) > -1e-7
    assert certificate.gap < 1e-8


def test_the_default_objective_is_the_torque_and_three_priors(toy_task):
    """In units of a row's variance v: one of each joint's own parameters, three of the
    total mass within 20 % and of each link's divergence, of which the closed form is
    stated here."""
    task = replace(toy_task, total=30.0)
    x = task.nominal.copy()
    v = task.data.loss(task.ols) / task.data.rows
    x[20:] = 0.7
    x[task.links] *= [[1.3], [0.8]]
    own = np.sum((x[20:] / task.joint_scale[20:]) ** 2)
    mass = ((x[task.links[:, 0]].sum() / 30.0 - 1.0) / 0.2) ** 2
    ratio = [
        np.linalg.eigvals(np.linalg.solve(*map(inertia.pseudo_inertia, pair))).real
        for pair in zip(task.prior_links, x[task.links], strict=True)
    ]
    pull = np.sum(np.array(ratio) - np.log(ratio) - 1.0)
    problem = LmiSdp().posed(task)
    assert problem.value(x) == pytest.approx(
        task.data.loss(x) + v * (own + 3.0 * (mass + pull))
    )
    step = 1e-4 * x * np.random.default_rng(0).normal(size=len(x))
    rise = problem.value(x + step) - problem.value(x - step)
    assert rise == pytest.approx(2.0 * problem.gradient(x) @ step, rel=1e-5)
    assert sum(c.family == "body" for c in problem.constraints.convex) == 2


def relative_torque_error(problem, theta, truth):
    model = problem.model()
    motion = sines(
        np.random.default_rng(99), problem.robot.n, np.arange(0.0, 10.0, 0.01), 0.13, 5
    )
    torque = model.torque(truth, motion)
    return float(
        np.linalg.norm(model.torque(theta, motion) - torque) / np.linalg.norm(torque)
    )


@pytest.mark.long
@settings(max_examples=3)
@given(seeds)
def test_any_random_feasible_robot_round_trips(seed):
    """Simulate, identify, predict another motion: a tree of one to five joints of both
    kinds."""
    assert_round_trip(seed)


def test_a_random_feasible_robot_round_trips():
    assert_round_trip(3)


def assert_round_trip(seed):
    """The model of a random robot makes the torque of another motion."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, 6))
    robot = tree(rng, n)
    nominal = np.array([link_parameters(rng, 0.5, thickness=0.05) for _ in range(n)])
    problem = open_problem(robot, nominal)
    truth = np.concatenate([link_parameters(rng, 0.5) for _ in range(n)])
    theta = with_friction(problem, truth, 0.4)
    run = simulated(problem.model(), theta, seed % 1000, seconds=12.0)
    # A nominal robot drawn apart from the truth is no witness of the torque's unit.
    estimate = identify(problem, run, "lmi-sdp", check=False)
    free = identify(problem, run, "ols", check=False)
    # Constraints that the truth obeys cost nothing beside what the filters leave of dry
    # friction.
    error = relative_torque_error(problem, estimate.theta, theta)
    least = relative_torque_error(problem, free.theta, theta)
    assert error < max(1e-5, 1.01 * least)
    assert least < 1e-3
    assert estimate.certificate.worst == 0.0
    assert estimate.certificate.positive_definite_share == 1.0
    assert np.all(np.linalg.eigvalsh(inertia.pseudo_inertia(estimate.links)) >= 0.0)
    reach = [body.reach for body in problem.link_bodies]
    assert np.all(inertia.gyration(estimate.links) <= reach)


def test_a_solver_without_the_cone_of_the_prior_is_named(toy_task):
    pytest.importorskip("cvxopt")
    with pytest.raises(
        InputError, match=r"cvxopt.*no exp cone.*clarabel.*lmi-sdp-thickness"
    ):
        LmiSdp(solver="cvxopt").fit(toy_task)
    assert (
        certify(toy_task, LmiSdpThickness(solver="cvxopt").fit(toy_task))[1].worst
        == 0.0
    )


def test_the_two_step_chain_is_what_it_says(toy_task):
    fit = LmiSdpTwoStep().fit(toy_task)
    chain = {
        k: np.array(fit.details[k]) for k in ("beta_prime", "beta_star", "beta_star_e")
    }
    target = toy_task.base.rows @ toy_task.ols
    distance = {k: np.linalg.norm(beta - target) for k, beta in chain.items()}
    assert distance["beta_prime"] <= min(distance.values()) + 1e-9
    np.testing.assert_allclose(
        chain["beta_star_e"], toy_task.base.rows @ fit.theta, atol=1e-12
    )
    # The torque SDP over fewer demands cannot lose more.
    w = toy_task.data.R @ np.linalg.pinv(toy_task.base.rows)

    def loss(beta):
        return float(np.sum((w @ beta - toy_task.data.rho) ** 2))

    assert loss(chain["beta_star"]) <= loss(chain["beta_star_e"]) * (1 + 1e-6)
    assert loss(chain["beta_star"]) <= loss(chain["beta_prime"]) * (1 + 1e-6)
    assert fit.details["loss_beta_prime"] >= toy_task.data.loss(fit.theta) * (1 - 1e-6)
    assert fit.problem.constraints.margin(fit.theta) >= -1e-9


def test_a_joint_that_never_reverses_keeps_its_certificate(toy_task):
    """Its Coulomb and offset columns are one: their range is what bounds them."""
    names = [p.name for p in toy_task.model.parameters]
    R = toy_task.data.R.copy()
    R[:, names.index("f_c1")] = R[:, names.index("f_o1")]
    task = replace(toy_task, data=replace(toy_task.data, R=R))
    kept = [c.name for c in task.problem.essential if c.family == "range"]
    assert "coulomb_friction f_c1" in kept
    assert "coulomb_friction f_c2" not in kept
    _, certificate = certify(task, LmiSdp().fit(task))
    assert certificate.gap < 1e-6
    # The SDP does not receive what is not convex, and the data say nothing of it here.
    convex = {c.family for c in task.constraints.convex}
    assert (
        max(v for family, v in certificate.violations.items() if family in convex)
        == 0.0
    )


@pytest.mark.parametrize(
    "method",
    ["lmi-sdp", "penalty", pytest.param("penalty-paper", marks=pytest.mark.long)],
)
def test_a_model_without_links_is_a_bounded_least_squares_problem(method, two_link):
    rng = np.random.default_rng(0)
    t = np.arange(0.0, 10.0, 2e-3)
    motion = sines(rng, 2, t)
    tau = -0.5 * motion.dq + 2.0  # a negative viscous friction, which is not allowed
    run = Measurements(t, motion.q, tau)
    effects = "viscous_friction,torque_offset"
    # The check would say: rows in reverse order.
    estimate = identify(two_link, run, method, effects=effects, check=False)
    assert estimate.theta[:2] == pytest.approx([0.0, 0.0], abs=1e-6)
    assert estimate.certificate.worst == 0.0
    assert estimate.certificate.positive_definite_share is None


def without_answers(monkeypatch, failures):
    """The solver's first answers are not numbers."""
    real = Clarabel.run
    calls = iter(range(1000))

    def run(self, problem, told):
        answer = real(self, problem, told)
        if next(calls) >= failures:
            return answer
        return replace(answer, x=np.full_like(answer.x, np.nan), claims="failed")

    monkeypatch.setattr(Clarabel, "run", run)


def test_a_solver_without_an_answer_proves_nothing_of_the_constraints(
    panda, monkeypatch
):
    """The panda's nominal links are thinner than 7 cm: an interior point has to be
    searched."""
    task = random_robots.task_of(panda)
    demands = task.constraints.plus(task.minimum_thickness(0.07))
    assert demands.margin(task.nominal) < 0.0
    without_answers(monkeypatch, 1)
    assert demands.margin(interior_point(task, demands)) > 0.0
    without_answers(monkeypatch, 2)
    with pytest.raises(
        InputError, match=r"neither parameters that satisfy .* nor a proof"
    ) as error:
        interior_point(task, demands)
    assert not isinstance(error.value, Infeasible)


def test_of_all_answers_the_least_objective_and_the_largest_bound_count(
    toy_task, monkeypatch
):
    """Our own answer is beaten by no worse one of a solver; where nothing is proved of
    any, none is given."""
    own = LmiSdpThickness().fit(toy_task)
    inside, nothing = own.interior, np.zeros_like(own.multipliers)
    at_inside = replace(own, theta=inside)  # with our multipliers
    unproved = replace(own, multipliers=nothing)
    assert at_inside.upper > 2.0 * own.upper
    assert unproved.gap > 1e-3
    both = with_best_dual(unproved, [at_inside])
    assert np.array_equal(both.theta, own.theta)
    assert both.gap == pytest.approx(own.gap, abs=1e-8)

    monkeypatch.setattr(lmi_sdp, "TIGHT", 0.0)  # ours is never the only one
    monkeypatch.setattr(lmi_sdp, "repair", lambda constraints, theta, inside: inside)
    again = LmiSdpThickness().fit(toy_task)
    assert again.gap <= 1e-8
    without_answers(monkeypatch, 1000)
    assert LmiSdpThickness().fit(toy_task).gap <= 1e-8
    monkeypatch.setattr(lmi_sdp, "fit_by_small_cones", lambda *_: None)
    with pytest.raises(InputError, match="gave up on a problem that has an interior"):
        LmiSdpThickness().fit(toy_task)


@pytest.mark.real_data
@pytest.mark.parametrize("known", [True, False])
@pytest.mark.parametrize(
    ("name", "mass"),
    [
        ("panda", 18.0),
        ("ur10", 28.4),
        pytest.param("ur10e", 29.1, marks=pytest.mark.slow),
        pytest.param("tx40", 23.0, marks=pytest.mark.long),
    ],
)
def test_real_arms_weigh_about_what_their_makers_say(data_folder, name, mass, known):
    """Within 1.4 times; torque alone says it of no arm. Also where nothing but joints,
    their limits and the log are known.

    The mass [kg] is that of what moves, as far as it is published: the maker's
    description of the UR10 and UR10e, the TX40's URDF (27 kg with base); the Panda's
    holds its base.
    """
    from corruptions.arms import real

    one = real(name, data_folder)
    own = one.problem
    blank = replace(
        bare(own.robot), torque_side=own.torque_side, preprocessing=own.preprocessing
    )
    posed = build_problem(
        own if known else replace(blank, effects=own.effects), one.train
    )
    total = float(LmiSdp().fit(posed.task).theta[posed.task.links[:, 0]].sum())
    assert 1.0 / 1.4 < total / mass < 1.4


#: Mass in kg and length in metres of one unit: SI, grams and millimetres, tons and
#: kilometres.
UNITS = ((1.0, 1.0), (1e-3, 1e-3), (1e3, 1e3))
COMMON = ("viscous_friction", "coulomb_friction", "torque_offset")
RARE = ("asymmetric_viscous_friction", "rotor_inertia", "joint_spring", "torque_ripple")


def effects(rng, n):
    """The links, and effects on joints drawn at random: some of the usual ones are
    missing."""
    words = ["rigid_body"]
    for name in (*COMMON, *RARE):
        joints = [str(j + 1) for j in range(n) if rng.random() < 0.8]
        if joints and rng.random() < (0.9 if name in COMMON else 0.2):
            words.append(f"{name}:{'+'.join(joints)}")
    return ",".join(words)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(
    "seed",
    [
        0,
        pytest.param(1, marks=pytest.mark.long),
        pytest.param(2, marks=pytest.mark.slow),
    ],
)
def test_no_method_gives_up_on_a_random_arm(seed, method, tmp_path):
    problem = load_problem(random_arm(tmp_path, seed))
    chosen = effects(np.random.default_rng(seed), problem.robot.n)
    task = posed_task(problem, random_run(problem, seed), chosen)
    posed = make_estimator(method).posed(task)
    convex = ConstraintSet(posed.constraints.convex)
    task = replace(task, constraints=convex, data=posed.least_squares)
    made = in_units(Instance(task, posed.entropy), *UNITS[seed % 3])
    fit = PosedSdp(made.task, made.problem, "clarabel").fit()
    _, certificate = certify(made.task, fit)
    assert certificate.worst == 0.0
    assert certificate.gap < 1e-6
