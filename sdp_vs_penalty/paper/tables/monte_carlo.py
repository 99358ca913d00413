"""Table "monte_carlo": methods by Monte Carlo, as BIRDy does (Leboutet et al., Applied
Sciences 2021): a known arm moves as commanded, its sensors are drawn anew, every method
identifies each draw.

    tau = RNEA(q, dq, ddq; links) + friction(dq) + noise

The rigid-body torque is Pinocchio's recursive Newton-Euler, friction is stated here: nothing of the
columns that methods use. The truth is the problem's (the published p_hat on the Panda). Errors are
of the torque without noise, along motions that no draw has seen.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from typing import Any

import numpy as np

from sdp_vs_penalty.data.measurements import Measurements, concatenate
from sdp_vs_penalty.effects.effect import Motion
from sdp_vs_penalty.effects.model import Model
from sdp_vs_penalty.estimation.constants import ROUNDING
from sdp_vs_penalty.estimators.estimator import (
    Estimator,
    Task,
    joint_weights,
    make_task,
)
from sdp_vs_penalty.estimators.lmi_sdp import LmiSdp, LmiSdpPlain
from sdp_vs_penalty.estimators.ols import Ols, standard_deviations
from sdp_vs_penalty.estimators.penalty import Penalty, PenaltyTwoStep
from sdp_vs_penalty.estimators.penalty_paper import PenaltyPaper, PenaltyPaperTwoStep
from sdp_vs_penalty.paper.classical import Geodesic, Ridge, TotalLeastSquares
from sdp_vs_penalty.paper.closed_loop import STEP, Loop, simulated_rows
from sdp_vs_penalty.paper.memo import load_or_compute, source_version, timed
from sdp_vs_penalty.paper.tables.folds import interval_of
from sdp_vs_penalty.paper.tables.study import Study, refitted
from sdp_vs_penalty.paper.tables.table import Row, StudyTable, notes, register_table
from sdp_vs_penalty.problem.load import load_problem
from sdp_vs_penalty.regression.evidence import relative_error
from sdp_vs_penalty.regression.regression import LeastSquares, Regression, compress
from sdp_vs_penalty.robot import inertia
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.trajectory import FourierTrajectory, random_trajectory
from sdp_vs_penalty.signals.filtered import FilteredRuns
from sdp_vs_penalty.simulation.experiments import (
    Sensor,
    experiment,
    sigmoid_torque,
    simulate,
)
from sdp_vs_penalty.simulation.worlds.world import inverse_dynamics

#: To be raised where the simulation changes: kept draws are then drawn again.
VERSION = 2
#: Seeds and lengths [s] of the motions that judge.
UNSEEN = ((101, 10.0), (102, 10.0), (103, 10.0))
#: True friction as shares of each joint's RMS torque: Coulomb, viscous at 1 rad/s, offset.
FRICTION = (0.03, 0.04, 0.005)


@dataclass(frozen=True)
class Setting:
    """What the draws of one setting share."""

    #: Name of the setting, in words.
    name: str
    #: Whether torque noise is the real arm's coloured one, and positions are stepped.
    coloured: bool
    #: Encoder step [rad].
    step: float
    #: Whether friction is the published sigmoid, which no method models.
    sigmoid: bool
    #: Share of the exciting motion's amplitude [-].
    amplitude: float
    #: Length of the exciting motion [s].
    seconds: float


SETTINGS = (
    Setting("white noise", False, 0.0, False, 1.0, 14.0),
    Setting("coloured noise, encoder steps", True, 1e-4, False, 1.0, 14.0),
    Setting("friction of another law", True, 1e-4, True, 1.0, 14.0),
    Setting("poor excitation", True, 1e-4, False, 0.3, 7.0),
)


@dataclass(frozen=True)
class Method:
    """A method of the study."""

    #: Name of the method in the table.
    name: str
    #: What fits the task.
    estimator: Estimator
    #: Rows that it fits: with joint weights "none", "noise" (by a first fit) or "iterated"
    #: (to the end); "simulated": weights by noise, positions of the model under its loop.
    rows: str = "noise"


#: Those of a quick study, the default among them.
FAST = (
    Method("least squares", Ols(), "none"),
    Method("weighted least squares", Ols()),
    Method("iteratively reweighted", Ols(), "iterated"),
    Method("ridge", Ridge()),
    Method("SDP", LmiSdpPlain()),
    Method("SDP, entropic (default)", LmiSdp()),
)
FULL = (
    *FAST,
    Method("total least squares", TotalLeastSquares()),
    Method("geodesic prior", Geodesic()),
    Method("penalty, one-step", Penalty()),
    Method("penalty, two-step", PenaltyTwoStep()),
    Method("output error (DIDIM)", Ols(), "simulated"),
)
#: The authors' method in our implementation, a run as long as their program allows.
AS_PUBLISHED = (
    Method("penalty as published, one-step", PenaltyPaper(runs=1, evaluations=None)),
    Method(
        "penalty as published, two-step", PenaltyPaperTwoStep(runs=1, evaluations=None)
    ),
)
DEFAULT = "SDP, entropic (default)"
#: The row of the prior that the default pulls to.
PRIOR = "the prior alone"


@dataclass(frozen=True)
class Draw:
    """One draw of a setting, for some methods."""

    #: Name of the problem.
    problem: str
    #: The setting.
    setting: Setting
    #: Number of the draw.
    number: int
    #: Methods that are fitted to it.
    methods: tuple[Method, ...]


@dataclass(frozen=True)
class Truth:
    """What is the same in all draws of a setting."""

    #: Model that the methods fit.
    model: Model
    #: The exciting motion.
    trajectory: FourierTrajectory
    #: Function of a motion that returns its true torque (N, n) [N m, N].
    torque: Callable[[Motion], Array]
    #: Servo loop under which the arm makes the exciting motion.
    loop: Loop
    #: Noise and steps of the sensors.
    sensor: Sensor
    #: (n, 10) standard parameters of the true links [kg, kg m, kg m^2].
    links: Array
    #: Rows of the unseen motions, torque without noise.
    unseen: Regression


def results_of(draw: Draw) -> dict[str, dict[str, Any]]:
    """Return what every method makes of a draw, read from the disk if it is there.

    By method: theta (p,), seconds, and for each base parameter of the links whether the
    95 % interval about the estimate holds the truth.
    """
    content = (source_version(), VERSION, draw)
    results: dict[str, dict[str, Any]] = load_or_compute(
        "monte-carlo", content, partial(_identify_from, draw)
    )
    return results


def _identify_from(draw: Draw) -> dict[str, dict[str, Any]]:
    """Simulate a draw and identify from it by every method; return it as JSON."""
    truth = truth_of(draw.problem, draw.setting)
    run = simulate(truth.trajectory, truth.torque, truth.sensor, [draw.number, 7])
    problem = load_problem(draw.problem)
    settings = problem.preprocessing.resolve(run)

    def rows_of(measured: Measurements) -> Regression:
        return compress(FilteredRuns.filtering(measured, settings), truth.model)

    def task_of(rows: Regression, weighting: str = "noise") -> Task:
        return make_task(problem, truth.model, rows, weighting, seed=draw.number)

    regression = rows_of(run)
    by_noise = task_of(regression)
    make_rows: dict[str, Callable[[], Task]] = {
        "none": lambda: task_of(regression, "none"),
        "noise": lambda: by_noise,
        "iterated": lambda: _reweighted(by_noise, regression),
        "simulated": lambda: simulated_rows(
            run, truth.loop, by_noise, lambda moved: task_of(rows_of(moved))
        ),
    }
    results = {}
    for method in draw.methods:
        begin = time.process_time()
        task = make_rows[method.rows]()
        before = time.process_time() - begin
        fit, seconds = timed(method.estimator, task)
        is_prepared = method.rows in ("none", "noise")  # as everybody's rows are
        results[method.name] = {
            "theta": fit.theta,
            "seconds": seconds + (0.0 if is_prepared else before),
            "covered": _covered(task, regression, fit.theta, truth.links),
        }
    return results


def _reweighted(task: Task, regression: Regression) -> Task:
    """Return the task with joint weights of its own residuals, repeated to the end."""
    for _ in range(10):
        weights = joint_weights(regression, task.ols)
        data = regression.least_squares(weights)
        is_settled = np.allclose(weights, task.weights, rtol=1e-4)
        task = replace(task, data=data, weights=weights)
        if is_settled:
            break
    return task


def _covered(
    task: Task, regression: Regression, theta: Array, links: Array
) -> list[bool]:
    """Return for each base parameter of the links whether +-1.96 standard deviations of
    least squares about the estimate hold the truth."""
    _, deviations = standard_deviations(task, regression.oversampling)
    rigid = task.model.rigid_indices
    of_links = np.any(task.base.rows[:, rigid] != 0.0, axis=1)
    base = task.base.rows[of_links]
    apart = base @ theta - base[:, rigid] @ links.ravel()
    return [bool(x) for x in np.abs(apart) <= 1.96 * deviations[of_links]]


@lru_cache(maxsize=8)
def truth_of(problem_name: str, setting: Setting) -> Truth:
    """Return the true arm of a setting, its motion and sensor, and the rows that judge."""
    problem = load_problem(problem_name)
    known = experiment(problem)
    robot = problem.robot
    arm = robot.pinocchio_model(known.links)

    def rigid(motion: Motion) -> Array:
        """Return the torque of the links (N, n), by Pinocchio's Newton-Euler."""
        return inverse_dynamics(arm, motion.q, motion.dq, motion.ddq)

    exciting = known.trajectory
    t = np.linspace(0.0, exciting.duration, 400)
    usual = np.sqrt(np.mean(rigid(Motion(t, *exciting.states(t))) ** 2, axis=0))
    usual = np.maximum(usual, 0.05 * usual.max())
    coulomb, viscous, offset = (share * usual for share in FRICTION)

    def torque(motion: Motion) -> Array:
        """Return the true torque (N, n)."""
        if setting.sigmoid and known.friction is not None:
            return rigid(motion) + sigmoid_torque(known.friction, motion.dq)
        dry = coulomb * np.sign(motion.dq)
        return rigid(motion) + dry + viscous * motion.dq + offset

    trajectory = replace(
        exciting,
        a=setting.amplitude * exciting.a,
        b=setting.amplitude * exciting.b,
        duration=setting.seconds,
    )
    t = np.arange(0.0, setting.seconds + STEP, STEP)
    designed = Motion(t, *trajectory.states(t))
    masses = robot.mass_matrices(known.links.ravel(), designed.q[::100])
    sensor = replace(
        known.sensor,
        position_step=setting.step,
        torque_ar=known.sensor.torque_ar if setting.coloured else None,
        torque_step=known.sensor.torque_step if setting.coloured else 0.0,
        log_step=None,
    )
    model = problem.model(problem.default_effects)
    silent = Sensor(sensor.rate, np.zeros(robot.n))
    motions = [
        (seed, random_trajectory(robot, seed, length)) for seed, length in UNSEEN
    ]
    unseen = concatenate(
        [simulate(motion, torque, silent, name=str(seed)) for seed, motion in motions]
    )
    filtered = FilteredRuns.filtering(unseen, problem.preprocessing.resolve(unseen))
    return Truth(
        model,
        trajectory,
        torque,
        Loop.along(designed, torque(designed), masses.mean(axis=0).diagonal()),
        sensor,
        known.links,
        compress(filtered, model),
    )


#: Draws of a quick study, of a whole one, and of the published annealing.
QUICK, WHOLE, LONG = 20, 100, 5
#: What every draw of a method gives: theta, seconds, covered.
Draws = list[dict[str, Any]]


@register_table("monte_carlo", "panda", slow=True)
def monte_carlo(study: Study) -> StudyTable:
    """Monte Carlo table: methods on simulated draws whose truth is known.

    Parameters
    ----------
    study : Study
        The robot, the budget, and workers.
    """
    is_quick = study.budget == "quick"
    count = QUICK if is_quick else WHOLE
    plan: list[tuple[tuple[Method, ...], int]] = [(FAST if is_quick else FULL, count)]
    if not is_quick:
        plan += [((method,), LONG) for method in AS_PUBLISHED]
    found = _all_draws(study, plan)
    rows = [
        row
        for setting in SETTINGS
        for row in _rows(study, setting, found[setting.name])
    ]
    as_published = {method.name for method in AS_PUBLISHED}
    draws = [row["draws"] for row in rows if row["method"] in as_published]
    published = "the published method is not drawn"
    if draws:
        published = f"{max(draws)} of the published method, in our implementation"
    true_masses = experiment(study.problem).links[:, 0]
    off = 100.0 * np.abs(study.problem.nominal_links[:, 0] / true_masses - 1.0)
    return StudyTable(
        f"Methods by Monte Carlo, {study.problem.title}",
        rows,
        notes(
            "monte_carlo",
            draws=count,
            published=published,
            default=DEFAULT,
            unseen=len(UNSEEN),
            prior=PRIOR,
            masses=f"{off.min():.0f} to {off.max():.0f} %",
        ),
        digits=3,
        caption=(
            f"Simulated: {count} draws of each of {len(SETTINGS)} settings; links as the"
            " published p_hat (erratum 1 corrected). Nothing is measured but the noise's"
            " size and colour."
        ),
    )


def _all_draws(
    study: Study, plan: Sequence[tuple[tuple[Method, ...], int]]
) -> dict[str, dict[str, Draws]]:
    """Return the results of all draws, by setting and method.

    Each draw is cached on the disk, so that a study that was stopped continues.
    """
    draws = [
        Draw(study.problem.name, setting, number, methods)
        for methods, count in plan
        for number in range(count)
        for setting in SETTINGS
    ]
    # Annealing first: it is long. Draw by draw, so that what was stopped has whole draws.
    draws.sort(key=lambda draw: (len(draw.methods) > 1, draw.number))
    study.progress(f"{len(draws)} draws")
    by_setting: dict[str, dict[str, Draws]] = {x.name: {} for x in SETTINGS}
    for draw, results in zip(draws, study.workers.map(results_of, draws), strict=True):
        for name, result in results.items():
            by_setting[draw.setting.name].setdefault(name, []).append(result)
    return by_setting


def _beside_default(errors: Array, usual: Array | None) -> Row:
    """Compare a method's errors with the default's in the same draws; usual : None of the
    default itself."""
    names = "less_default_points", "less_default_interval", "worse_than_default"
    if usual is None:
        return dict.fromkeys(names)
    less = interval_of(errors - usual[: len(errors)])
    n_worse = int((errors > usual[: len(errors)]).sum())
    return dict(zip(names, (less.value, less.in_words, n_worse), strict=True))


def _rows(study: Study, setting: Setting, draws: dict[str, Draws]) -> list[Row]:
    """Return the row of each method in a setting; ``draws`` are by the method's name.

    Errors are those of the torque on unseen motion, in per cent of it. Their bias is the
    error of the mean parameters, their spread that of the draws about the mean.
    """
    truth = truth_of(study.problem.name, setting)
    unseen = truth.unseen.least_squares()
    link_places = truth.model.rigid_indices
    errors_of_default = _errors(unseen, draws[DEFAULT])
    rows = []
    for method in (*FULL, *AS_PUBLISHED):
        if method.name not in draws:
            continue
        of_method = draws[method.name]
        errors = _errors(unseen, of_method)
        is_default = method.name == DEFAULT
        thetas = np.array([draw["theta"] for draw in of_method])  # (draws, p)
        mean = thetas.mean(axis=0)
        # |Y (theta - mean)| of each draw, by the triangular factor R of the columns Y.
        distances = np.linalg.norm((thetas - mean) @ unseen.R.T, axis=1)
        links = thetas[:, link_places].reshape(len(thetas), -1, 10)
        can_exist = inertia.consistency_margin(links).min(axis=1) >= -ROUNDING
        rows.append(
            {
                "setting": setting.name,
                "method": method.name,
                "draws": len(errors),
                "error_percent": float(errors.mean()),
                "interval_percent": interval_of(errors).in_words,
                **_beside_default(errors, None if is_default else errors_of_default),
                "bias_percent": _error(unseen, mean),
                "spread_percent": float(
                    relative_error(np.mean(distances**2), unseen.tau_squared)
                ),
                "coverage_percent": 100.0
                * float(np.mean([draw["covered"] for draw in of_method])),
                "exist_percent": 100.0 * float(np.mean(can_exist)),
                "seconds": float(np.median([draw["seconds"] for draw in of_method])),
                "data": "simulated",
            }
        )
    return [*rows, _prior_alone(study, setting)]


def _prior_alone(study: Study, setting: Setting) -> Row:
    """Return the row of the default method's prior without data: the nominal links, with
    the friction that fits the unseen motion best."""
    truth = truth_of(study.problem.name, setting)
    unseen = truth.unseen.least_squares()
    prior = np.full(unseen.R.shape[1], np.nan)
    prior[truth.model.rigid_indices] = study.problem.nominal_links.ravel()
    return {
        "setting": setting.name,
        "method": PRIOR,
        "error_percent": _error(unseen, refitted(unseen, prior)),
        "data": "simulated",
    }


def _errors(unseen: LeastSquares, draws: Draws) -> Array:
    """Return each draw's torque error on unseen motion (draws,) [%]."""
    return np.array([_error(unseen, np.array(draw["theta"])) for draw in draws])


def _error(unseen: LeastSquares, theta: Array) -> float:
    """Return 100 |tau - Y theta| / |tau| on the unseen motion, tau without noise."""
    return float(relative_error(unseen.loss(theta), unseen.tau_squared))
