"""Compression: exact, additive, in the order of time; base parameters; memory; black
boxes."""

from dataclasses import replace
from functools import cache, partial

import numpy as np
import pytest
from arms import Axis, scara, write_urdf
from drawn import given, seeds, settings, st
from numpy.testing import assert_allclose
from random_robots import driven, tree
from recorded import refusal

from sdp_vs_penalty import Measurements, identify, load_problem
from sdp_vs_penalty.effects import Model, Motion, parse_effects
from sdp_vs_penalty.estimators import condition_number, make_task
from sdp_vs_penalty.regression import (
    BlackBox,
    Factor,
    LeastSquares,
    ProductRegression,
    Regression,
    base_rows,
    compress,
    compress_black_box,
    load_answers,
)
from sdp_vs_penalty.regression.base_parameters import base_parameters
from sdp_vs_penalty.signals import FilteredRun, FilteredRuns, Preprocessing
from sdp_vs_penalty.simulation import experiment
from sdp_vs_penalty.testing.robots import sines

FILTERS = Preprocessing(5.0, 8.0)


@cache
def noisy_run(seed):
    """The model of a random tree, a run of it with noise, and its compressed data."""
    effects = "rigid_body,viscous_friction,torque_offset"
    model, _, run = driven(seed, seconds=12.0, dt=4e-3, effects=effects, noise=0.1)
    return model, run, compress(FilteredRuns.filtering(run, FILTERS), model)


def as_products(regression):
    """Compressed data as the products of its columns."""
    rows = [np.zeros((len(f.triangle), regression.p + 1)) for f in regression.per_joint]
    for wide, factor in zip(rows, regression.per_joint, strict=True):
        wide[:, np.append(factor.indices, regression.p)] = factor.triangle
    return ProductRegression.from_rows(regression.parameters, rows)


#: Arms and runs that several tests share.
FEW = pytest.mark.parametrize("seed", range(6))


@FEW
def test_products_of_columns_fit_some_of_them_as_their_rows_do(seed):
    model, _, regression = noisy_run(seed)
    rng = np.random.default_rng(seed)
    kept = rng.uniform(size=len(model.parameters)) < 0.8
    weights = rng.uniform(0.1, 3.0, model.robot.n)
    scale = rng.uniform(0.5, 2.0, kept.sum())
    of_rows = regression.keeping(kept)
    of_products = as_products(regression).keeping(kept)
    thetas = []
    for data in (of_rows, of_products):
        squares = data.least_squares(weights).with_prior(scale, weight=0.3)
        thetas.append(squares.nearest(scale))
        expected = of_rows.joint_losses(thetas[0])
        assert_allclose(data.joint_losses(thetas[-1]), expected, rtol=1e-6)
        assert squares.loss(scale) == pytest.approx(
            of_rows.least_squares(weights).with_prior(scale, weight=0.3).loss(scale),
            rel=1e-9,
        )
    assert_allclose(*thetas, rtol=1e-4, atol=1e-6)


@FEW
def test_a_known_parameter_stays_and_so_does_one_that_makes_no_torque(seed):
    """By products as by rows; the others are fitted to what is left."""
    _, _, regression = noisy_run(seed)
    unseen = int(np.argmin(regression.least_squares().column_norms))
    last = regression.p - 1  # an offset
    near = np.full(regression.p, 0.3)
    near[last] = 2.0
    thetas = []
    for data in (regression, as_products(regression)):
        theta = data.least_squares().given({last: 2.0}).nearest(near)
        assert theta[[unseen, last]] == pytest.approx([0.3, 2.0])
        thetas.append(theta)
    losses = [regression.joint_losses(theta) for theta in thetas]
    assert_allclose(*losses, rtol=1e-6)
    free = regression.joint_losses(regression.least_squares().nearest(near))
    assert losses[0].sum() > free.sum()


@FEW
def test_a_parameter_of_infinite_size_is_not_pulled(seed):
    _, _, regression = noisy_run(seed)
    rng = np.random.default_rng(seed)
    p = regression.p
    scale = np.where(rng.uniform(size=p) < 0.5, np.inf, rng.uniform(0.5, 2.0, p))
    theta = rng.normal(size=p)
    for data in (regression, as_products(regression)):
        squares = data.least_squares()
        rise = squares.with_prior(scale, weight=30.0).loss(theta) - squares.loss(theta)
        assert rise == pytest.approx(
            30.0 * np.sum((theta / scale) ** 2), abs=1e-7 * squares.loss(theta)
        )


@FEW
def test_factors_answer_what_all_rows_would(seed):
    model, run, regression = noisy_run(seed)
    rows = FilteredRun(run, FILTERS).all_rows(model)
    wide = [c.dense_columns(len(model.parameters)) for c in rows.columns]
    torque = rows.torque
    rng = np.random.default_rng(seed)
    weights = rng.uniform(0.1, 3.0, model.robot.n)
    data = regression.least_squares(weights)
    stacked = np.vstack([w * y for w, y in zip(weights, wide, strict=True)])
    measured = np.concatenate(
        [w * tau for w, tau in zip(weights, torque.T, strict=True)]
    )
    theta = rng.normal(size=len(model.parameters))
    residual = stacked @ theta - measured
    assert data.loss(theta) == pytest.approx(residual @ residual, rel=1e-10)
    assert_allclose(
        data.gradient(theta), 2.0 * stacked.T @ residual, rtol=1e-7, atol=1e-6
    )
    assert data.rows == stacked.shape[0]
    assert data.tau_squared == pytest.approx(measured @ measured)
    assert_allclose(
        regression.joint_losses(theta),
        [np.sum((y @ theta - tau) ** 2) for y, tau in zip(wide, torque.T, strict=True)],
        rtol=1e-10,
    )
    assert regression.joint_rows().tolist() == [len(torque)] * model.robot.n
    seen = np.linalg.norm(stacked, axis=0)
    assert_allclose(data.column_norms, np.where(seen > 1e-10 * seen.max(), seen, 0.0))


@FEW
def test_merging_blocks_equals_one_pass(seed):
    model, run, _ = noisy_run(seed)
    whole = compress(FilteredRuns.filtering(run, FILTERS), model, blocks_per_run=1)
    many = compress(FilteredRuns.filtering(run, FILTERS), model, blocks_per_run=20)
    # Of 20 blocks of 0.6 s the first and the last lie in what the filters need.
    assert (len(whole.blocks), len(many.blocks)) == (1, 18)
    assert whole.blocks == ((0, run.t[0], run.t[-1]),)
    edges = np.linspace(run.t[0], run.t[-1], 21)
    assert_allclose([span for _, *span in many.blocks], np.c_[edges[1:-2], edges[2:-1]])
    a = whole.least_squares()
    b = many.least_squares()
    for theta in np.random.default_rng(seed).normal(size=(3, len(model.parameters))):
        assert a.loss(theta) == pytest.approx(b.loss(theta), rel=1e-10)
    assert a.rows == b.rows
    assert a.tau_squared == pytest.approx(b.tau_squared, rel=1e-12)


def test_columns_kept_from_one_model_are_those_that_the_next_would_make():
    """Signs of another width, other joints, other constants, an effect with a memory,
    and back again."""
    model, _, run = driven(0, 12.0, 4e-3, "rigid_body", 0.1)
    kept = FilteredRun(run, FILTERS)
    for text in (
        "coulomb_friction@v_s=0.01,stribeck_friction",
        "coulomb_friction@v_s=0.2,stribeck_friction",
        "coulomb_friction:1@v_s=0.2,stribeck_friction@vs=0.3,presliding_hysteresis",
        "rigid_body,coulomb_friction@v_s=0.01,stribeck_friction",
    ):
        other = Model(model.robot, parse_effects(text, model.robot))
        pair = (
            filtered.all_rows(other).columns
            for filtered in (kept, FilteredRun(run, FILTERS))
        )
        for old, new in zip(*pair, strict=True):
            assert_allclose(old.columns, new.columns, rtol=1e-9, atol=1e-12)


@given(seeds)
def test_base_parameters_make_the_same_torque(seed):
    """pi = B theta determines every torque: Y theta = Y B^+ B theta; and nothing less
    does."""
    rng = np.random.default_rng(seed)
    robot = tree(rng, int(rng.integers(1, 6)))
    model = Model(robot, parse_effects("rigid_body", robot))
    matrix, kept = base_parameters(model)
    assert_allclose(matrix[:, kept], np.eye(len(kept)), atol=1e-9)
    regressor = robot.regressor(*rng.normal(size=(3, 60, robot.n))).reshape(
        -1, 10 * robot.n
    )
    assert_allclose(
        regressor, regressor[:, kept] @ matrix, atol=1e-8 * np.abs(regressor).max()
    )
    scaled = regressor / np.maximum(np.linalg.norm(regressor, axis=0), 1e-300)
    assert np.linalg.matrix_rank(scaled, tol=1e-8) == len(kept)


#: Of links, rotors, viscous friction and offsets: how many parameters make torques of
#: their own.
SEEN = {"scara": 8 + 3 + 4 + 3, "panda": 43 + 5 + 7 + 7}


@pytest.mark.parametrize("which", SEEN)
def test_base_parameters_of_a_whole_model_are_independent(which, tmp_path):
    """As many as random motion can tell apart: beside an upright slide's weight, its
    offset is none."""
    problem = load_problem(scara(tmp_path) if which == "scara" else which)
    model = problem.model("rigid_body,rotor_inertia,viscous_friction,torque_offset")
    rates = np.random.default_rng(1).normal(size=(2, 200, problem.robot.n))
    motion = Motion(np.zeros(200), problem.robot.random_configurations(200, 1), *rates)
    columns = np.concatenate(model.dense_columns(motion))
    base = base_rows(model, problem.independent)
    seen = np.linalg.norm(columns, axis=0)
    rank = np.linalg.matrix_rank(columns[:, seen > 1e-9] / seen[seen > 1e-9], tol=1e-8)
    assert len(base.rows) == rank == SEEN[which]
    # The torque follows from them: their leading columns make every other one.
    assert_allclose(
        columns[:, base.leading] @ base.rows, columns, atol=1e-8 * seen.max()
    )


@pytest.mark.parametrize("which", ["ur10e", "tx40"])
def test_the_condition_number_is_that_of_what_makes_torque(which):
    """Rotors that act like their links add no base parameter; what does not move has
    none."""
    problem = load_problem(which)
    model = problem.model()
    motion = sines(np.random.default_rng(2), problem.robot.n, np.arange(0, 9, 5e-3))
    run = Measurements(motion.t, motion.q, tau=np.zeros_like(motion.q))
    data = compress(FilteredRuns.filtering(run, FILTERS), model)
    task = make_task(problem, model, data, "none")
    assert condition_number(task) < 1e5
    still = replace(task, data=replace(task.data, R=0.0 * task.data.R))
    assert condition_number(still) == np.inf


@pytest.mark.parametrize("right_angle", ["1.5707963267948966", "1.5707963", "1.5708"])
def test_right_angles_in_few_digits_make_no_base_parameters(right_angle, tmp_path):
    """Three level, parallel axes: of each link Izz, mx and my make torque."""
    turns = (f"{right_angle} 0 0", f"-{right_angle} 0 0", f"{right_angle} 0 0")
    axes = [
        Axis("revolute", axis, "0.3 0 0", 2.0, "0.1 0.02 0.01", turn=turn)
        for axis, turn in zip(("0 0 1", "0 -1 0", "0 0 1"), turns, strict=True)
    ]
    problem = load_problem(write_urdf(tmp_path / "planar.urdf", "planar", axes))
    matrix, _ = base_parameters(problem.model("rigid_body"))
    assert len(matrix) == 9


def test_independent_parameters_must_be_independent(panda):
    model = panda.model(["rigid_body"])
    names = list(panda.independent or ())
    refusal(
        lambda: base_parameters(model, [*names[:-1], "mx7"]),
        "not the robot's 43 independent",
    )
    refusal(lambda: base_parameters(model, [*names[:-1], "bogus"]), "bogus")


def answers(problem, count, seed=0):
    links = experiment(problem).links
    return BlackBox.from_links(
        problem.robot, links, problem.robot.random_configurations(count, seed)
    )


@settings(max_examples=3, derandomize=False)
@given(name=st.sampled_from(["panda", "two_link"]), seed=st.integers(0, 1000))
def test_base_parameters_come_back(name, seed):
    problem = load_problem(name)
    estimate = identify(
        problem, answers(problem, 60, seed), "reverse-engineering", check=False
    )
    base, _ = base_parameters(problem.model("rigid_body"), problem.independent)
    truth = base @ experiment(problem).links.ravel()
    assert_allclose(base @ estimate.theta, truth, atol=1e-8)
    assert estimate.details["relative_error_percent"] < 1e-8
    assert estimate.details["condition_number"] > 1.0


def test_the_rows_are_gravity_and_the_upper_triangle(panda):
    box = answers(panda, 3)
    model = panda.model("rigid_body")
    data = compress_black_box(box, model).least_squares()
    assert data.rows == 3 * (7 + 28)
    upper = np.triu_indices(7)
    expected = np.sum(box.gravity**2) + sum(
        np.sum(m[upper] ** 2) for m in box.mass_matrix
    )
    assert data.tau_squared == pytest.approx(expected)
    assert data.loss(experiment(panda).links.ravel()) < 1e-16 * expected
    # A wrong entry of M shows in the loss with its own size, whichever side of the
    # factors it is on.
    wrong = box.mass_matrix.copy()
    wrong[1, 2, 5] = wrong[1, 5, 2] = wrong[1, 2, 5] + 0.1
    loss = compress_black_box(
        BlackBox(box.q, box.gravity, wrong), model
    ).least_squares()
    assert loss.loss(experiment(panda).links.ravel()) == pytest.approx(0.01)


def test_what_a_black_box_does_not_say_is_refused(panda, two_link):
    method = "reverse-engineering"
    more = partial(
        identify,
        panda,
        answers(panda, 20),
        method,
        effects="rigid_body,viscous_friction",
    )
    refusal(more, "rigid_body")
    refusal(
        lambda: identify(
            two_link, experiment(two_link).training_run(), method, check=False
        ),
        "mass_matrix",
    )
    refusal(
        lambda: identify(two_link, answers(two_link, 5), "output-error", check=False),
        "measured runs",
    )


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"gravity": None}, "array gravity is missing"),
        ({"gravity": np.zeros((5, 6))}, "shape (5, 6)"),
        ({"mass_matrix": np.zeros((5, 7))}, "array mass_matrix has shape"),
        ({"q": np.full((5, 7), np.nan)}, "configuration 1: not a finite number"),
        ({"mass_matrix": np.triu(np.ones((5, 7, 7)))}, "not symmetric"),
        ({"q": np.zeros(7)}, "one row a configuration"),
    ],
)
def test_bad_files_are_named(tmp_path, change, message):
    file = tmp_path / "box.npz"
    arrays = {
        "q": np.zeros((5, 7)),
        "gravity": np.zeros((5, 7)),
        "mass_matrix": np.zeros((5, 7, 7)),
    }
    np.savez(file, **{k: v for k, v in (arrays | change).items() if v is not None})
    refusal(lambda: load_answers(file), message)


def test_another_robots_file_and_several_files_are_refused(panda, tmp_path):
    box = answers(panda, 20)
    file = tmp_path / "box.npz"
    np.savez(file, q=box.q, gravity=box.gravity, mass_matrix=box.mass_matrix)
    refusal(lambda: load_answers(file, joints=2), "7 joint")
    refusal(lambda: load_answers([file, file]), "from one file")
    assert load_answers([tmp_path / "run.csv"]) is None
    (tmp_path / "torn.npz").write_bytes(file.read_bytes()[:100])
    assert load_answers(tmp_path / "torn.npz") is None


def test_a_block_that_several_runs_show_comes_once():
    rng = np.random.default_rng(0)
    parts = [rng.normal(size=(r, 3)) for r in (2, 3, 1)]
    own = np.arange(2)
    factors = [
        Factor(0, block, own, x, len(x))
        for block, x in zip((0, 1, 0), parts, strict=True)
    ]
    blocks = ((0, 0.0, 1.0), (0, 1.0, 2.0))
    ((joint, indices, found, rows),) = Regression(
        (), 1, blocks, tuple(factors)
    ).by_joint()
    assert (joint, indices.tolist(), found.tolist()) == (0, [0, 1], [0, 1])
    both = parts[0].T @ parts[0] + parts[2].T @ parts[2]
    assert_allclose(rows.swapaxes(1, 2) @ rows, [both, parts[1].T @ parts[1]])


def test_as_many_rows_as_parameters_leave_nothing():
    made = LeastSquares.stacked([np.array([[2.0, 1.0, 3.0], [0.0, 1.0, 1.0]])], 2)
    assert made.residual_norm == 0.0
    assert made.loss(np.array([1.0, 1.0])) == pytest.approx(0.0, abs=1e-24)
    assert made.tau_squared == pytest.approx(10.0)
