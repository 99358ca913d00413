"""Methods by Monte Carlo, as BIRDy does (Leboutet et al., Applied Sciences 2021): a known
arm moves as commanded, its sensors are drawn anew, every method identifies each draw.

    tau = RNEA(q, dq, ddq; links) + friction(dq) + noise

The rigid-body torque is Pinocchio's recursive Newton-Euler, friction is stated here: nothing of the
columns that methods use. The truth is the problem's (the published p_hat on the Panda). Errors are
of the torque without noise, along motions that no draw has seen.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from typing import Any

import numpy as np

from sdp_vs_penalty.data.measurements import Measurements, concatenate
from sdp_vs_penalty.effects.effect import Motion
from sdp_vs_penalty.effects.model import Model
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
from sdp_vs_penalty.paper.estimates import timed
from sdp_vs_penalty.paper.memo import remembered, source_version
from sdp_vs_penalty.problem.load import load_problem
from sdp_vs_penalty.regression.regression import Regression, compress
from sdp_vs_penalty.robot import inertia
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.trajectory import FourierTrajectory, random_trajectory
from sdp_vs_penalty.signals.filtered import FilteredRuns
from sdp_vs_penalty.simulation.experiments import Sensor, experiment, simulate
from sdp_vs_penalty.simulation.worlds.world import inverse_dynamics

#: To be raised where the simulation changes: kept draws are then drawn again.
VERSION = 1
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
    #: Weights of the joints: "none", "noise" (by a first fit), "iterated" (to the end).
    weighting: str = "noise"


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
)
#: The authors' method in our implementation, a run as long as their program allows.
AS_PUBLISHED = (
    Method("penalty as published, one-step", PenaltyPaper(runs=1, evaluations=None)),
    Method(
        "penalty as published, two-step", PenaltyPaperTwoStep(runs=1, evaluations=None)
    ),
)
DEFAULT = "SDP, entropic (default)"


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
    #: Noise and steps of the sensors.
    sensor: Sensor
    #: (n, 10) standard parameters of the true links [kg, kg m, kg m^2].
    links: Array
    #: Rows of the unseen motions, torque without noise.
    unseen: Regression


def drawn(draw: Draw) -> dict[str, dict[str, Any]]:
    """Return what every method makes of a draw, read from the disk if it is there.

    By method: theta (p,), seconds, and for each base parameter of the links whether the
    95 % interval about the estimate holds the truth.
    """
    content = (source_version(), VERSION, draw)
    found: dict[str, dict[str, Any]] = remembered(
        "monte-carlo", content, partial(_drawn, draw)
    )
    return found


def _drawn(draw: Draw) -> dict[str, dict[str, Any]]:
    """Simulate a draw and identify from it by every method; return it as JSON."""
    truth = truth_of(draw.problem, draw.setting)
    run = simulate(truth.trajectory, truth.torque, truth.sensor, [draw.number, 7])
    problem = load_problem(draw.problem)
    settings = problem.preprocessing.resolve(run)
    regression = compress(FilteredRuns.of(run, settings), truth.model)
    tasks = {
        weighting: make_task(
            problem, truth.model, regression, weighting, seed=draw.number
        )
        for weighting in ("none", "noise")
    }
    tasks["iterated"] = _reweighted(tasks["noise"], regression)
    results = {}
    for method in draw.methods:
        task = tasks[method.weighting]
        fit, seconds = timed(method.estimator, task)
        results[method.name] = {
            "theta": fit.theta.tolist(),
            "seconds": seconds,
            "covered": _covered(task, regression, fit.theta, truth.links),
        }
    return results


def _reweighted(task: Task, regression: Regression, rounds: int = 10) -> Task:
    """Return the task with joint weights of its own residuals, repeated to the end."""
    for _ in range(rounds):
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
    of_links = np.any(task.base[:, rigid] != 0.0, axis=1)
    base = task.base[of_links]
    apart = base @ theta - base[:, rigid] @ links.ravel()
    return [bool(x) for x in np.abs(apart) <= 1.96 * deviations[of_links]]


@lru_cache(maxsize=8)
def truth_of(problem_name: str, setting: Setting) -> Truth:
    """Return the true arm of a setting, its motion and sensor, and the rows that judge."""
    problem = load_problem(problem_name)
    known = experiment(problem)
    robot = problem.robot
    zeros = np.zeros(robot.n)
    arm = robot.pinocchio_model(known.links, zeros, zeros, zeros)

    def rigid(motion: Motion) -> Array:
        """Return the torque of the links (N, n), by Pinocchio's Newton-Euler."""
        return inverse_dynamics(arm, motion.q, motion.dq, motion.ddq)

    exciting = known.trajectory
    trajectory = replace(
        exciting,
        a=setting.amplitude * exciting.a,
        b=setting.amplitude * exciting.b,
        duration=setting.seconds,
    )
    t = np.linspace(0.0, exciting.duration, 400)
    usual = np.sqrt(np.mean(rigid(Motion(t, *exciting.states(t))) ** 2, axis=0))
    usual = np.maximum(usual, 0.05 * usual.max())
    coulomb, viscous, offset = (share * usual for share in FRICTION)

    def torque(motion: Motion) -> Array:
        """Return the true torque (N, n)."""
        if setting.sigmoid and known.friction is not None:
            amplitude, slope, shift = np.asarray(known.friction).T
            step = 1.0 / (1.0 + np.exp(-slope * (motion.dq + shift)))
            at_rest = 1.0 / (1.0 + np.exp(-slope * shift))
            return rigid(motion) + amplitude * (step - at_rest)
        dry = coulomb * np.sign(motion.dq)
        return rigid(motion) + dry + viscous * motion.dq + offset

    sensor = replace(
        known.sensor,
        position_step=setting.step,
        torque_ar=known.sensor.torque_ar if setting.coloured else None,
        torque_step=known.sensor.torque_step if setting.coloured else 0.0,
        log_step=None,
    )
    model = problem.model(problem.default_effects)
    silent = Sensor(sensor.rate, zeros)
    runs = concatenate(
        [
            simulate(
                random_trajectory(robot, seed, length), torque, silent, name=str(seed)
            )
            for seed, length in UNSEEN
        ]
    )
    return Truth(
        model,
        trajectory,
        torque,
        sensor,
        known.links,
        _compressed(problem, runs, model),
    )


def _compressed(problem: Any, runs: Measurements, model: Model) -> Regression:
    """Return runs behind the problem's filters, compressed."""
    settings = problem.preprocessing.resolve(runs)
    return compress(FilteredRuns.of(runs, settings), model)


def can_exist(links: Array, rounding: float = 1e-9) -> bool:
    """Tell whether bodies with these standard parameters (n, 10) exist, up to rounding."""
    return bool(np.linalg.eigvalsh(inertia.pseudo_inertia(links)).min() >= -rounding)
