"""The run that would tell two hypotheses about a robot: on which they differ most
(T-optimality).

With X the model's columns, A and B those of the two effects, all white, the torque of A
by theta differs from everything that the model with B can make by

    delta^2 = theta' A' (1 - P_[X B]) A theta                     (Atkinson, Fedorov, Biometrika 1975)

and the wrong model is taken for the right one with probability Phi(-delta / 2), but for
what their parameters cost; delta^2 grows with the run. theta has the size that a user
names, in the direction of A's parameters that B can make best; the smaller of A against
B and B against A counts. Of one effect alone the other hypothesis is that it is not
there.

Motions go from point to point within the limits of position, velocity, acceleration,
jerk and torque, without touching the arm itself: random ones, the best of which is
changed at random as long as that helps (a (1 + 1) evolution strategy: Rechenberg 1973).
"""

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import scipy

from sdp_vs_penalty.effects import EXAMPLES, parse_effects
from sdp_vs_penalty.effects.effect import Effect, Motion
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.estimation.constants import LEVEL
from sdp_vs_penalty.estimation.estimate import Estimate
from sdp_vs_penalty.estimation.excitation import (
    RATE,
    Limits,
    independent_rate,
    noise_of_model,
    shrunk,
)
from sdp_vs_penalty.estimators.estimator import Progress, no_progress
from sdp_vs_penalty.regression.linalg import partialled
from sdp_vs_penalty.regression.regression import triangular
from sdp_vs_penalty.robot.arrays import Array, at_least_tiny, nonzero_or_one
from sdp_vs_penalty.robot.trajectory import (
    PointTrajectory,
    random_trajectory,
    shortest_moves,
)

#: Random motions to begin with; how slow a move may be over the fastest, and how long a
#: pause [s].
_DRAWN = 30
_SLOWEST = 10.0
_PAUSE = 0.8
#: Shares of the limits that a motion uses.
_SHARE = 0.95

States = Callable[[Array], tuple[Array, Array, Array]]


class Power(NamedTuple):
    """How well a motion tells two hypotheses apart: their squared distance on it, the
    probability of the right decision after it, and the time of the motion, repeated,
    that LEVEL needs [s]."""

    delta2: float
    right: float
    seconds: float


class Separation(NamedTuple):
    """The best motion found to tell two hypotheses apart, and its power beside that of
    the default excitation of the same length."""

    trajectory: PointTrajectory
    power: Power
    default: Power


class Hypotheses:
    """Two effects beside a model, or one and none, and how large the noise is.

    Of effects as they are written, each of ``level`` times the noise of its joint (root
    mean square) on the default excitation. Raises InputError for more than two effects,
    or one that the model has.
    """

    def __init__(self, estimate: Estimate, texts: str, level: float) -> None:
        """Read one or two effects from text, and scale them to ``level`` times the
        noise.

        An effect's level is the root mean square of its torque over the noise of the
        joint that it moves most, on a default excitation of 20 s. ``scale`` holds the
        size of the parameters that gives each effect this level.
        """
        self.estimate = estimate
        self.effects = tuple(parse_effects(texts, estimate.robot))
        self.noise = noise_of_model(estimate)  # (n,) [N m or N]
        self.row_rate = independent_rate(estimate)  # independent rows a second [Hz]
        if not 1 <= len(self.effects) <= 2:
            what = f"--separate {texts!r} names {len(self.effects)} effects"
            raise InputError(what, f'name two, such as "{",".join(EXAMPLES)}", or one')
        model_names = {p.name for p in estimate.model.parameters}
        for effect in self.effects:
            if twice := model_names & {p.name for p in effect.parameters}:
                what = f"the model has {effect.name} already ({min(twice)})"
                raise InputError(what, "separate effects that it lacks")
        motion = self.motion(default_excitation(estimate, 20.0, 0), 20.0)
        scales = []
        for effect in self.effects:
            # Mean square torque of unit parameters over the noise, of the joint that
            # the effect moves most.
            columns = self._columns_over_noise(effect, motion)
            mean_squares = (columns**2).mean(axis=1)  # (n, k)
            largest = mean_squares.sum(axis=1).max()
            scales.append(level / float(nonzero_or_one(np.sqrt(largest))))
        self.scale = tuple(scales)

    def motion(self, states: States, duration: float) -> Motion:
        """Return the motion of a trajectory, sampled at RATE, with the model's torque.

        ``states`` gives positions, velocities and accelerations (N, n) at instants
        (N,); ``duration`` is in seconds.
        """
        t = np.arange(0.0, duration, 1.0 / RATE)
        return self.estimate.model.seen_along(
            self.estimate.theta, Motion(t, *states(t))
        )

    def _columns_over_noise(self, effect: Effect, motion: Motion) -> Array:
        """Return the effect's regressor over the noise of each joint, (n, N, k).

        n joints, N samples of the motion, k parameters of the effect.
        """
        shape = (self.estimate.robot.n, len(motion.t), len(effect.parameters))
        columns = np.zeros(shape)
        for block in effect.blocks(motion):
            of_block = block.columns / self.noise[block.joint]
            columns[block.joint][:, block.parameters] += of_block
        return columns

    def distance(self, motion: Motion) -> float:
        """Return delta^2, the squared distance of the hypotheses on a motion, in noise
        variances.

        It counts independent rows. Either effect may be the true one; the smaller
        distance counts. One effect alone is compared with none.
        """
        of_model = self.estimate.model.dense_columns(
            replace(motion, torque=None, current=None)
        )
        X = (of_model / self.noise[:, None, None]).reshape(-1, of_model.shape[2])
        columns = [
            self._columns_over_noise(effect, motion).reshape(len(X), -1) * scale
            for effect, scale in zip(self.effects, self.scale, strict=True)
        ]
        if len(columns) == 1:
            no_effect = X[:, :0]
            smallest = _smallest_distance(X, columns[0], no_effect)
        else:
            first, second = columns
            smallest = min(
                _smallest_distance(X, first, second),
                _smallest_distance(X, second, first),
            )
        # RATE rows a second are computed, row_rate of them are independent.
        return smallest * self.row_rate / RATE

    def probability_right(self, delta2: float, seconds: float) -> float:
        """Return the probability that the sum of squares chooses the right hypothesis.

        delta2 is the squared distance of the hypotheses; an effect with more parameters
        pays ln(rows) for each further one (BIC), with the rows of ``seconds``. One
        effect alone is compared with none, which has no parameters.
        """
        n_first, n_second, *_ = [*(len(e.parameters) for e in self.effects), 0]
        n_rows = max(self.row_rate * seconds, 2.0)
        price = abs(n_first - n_second) * np.log(n_rows)
        # The difference of the sums of squares is normal: mean delta2, variance 4
        # delta2.
        std = 2.0 * np.sqrt(at_least_tiny(delta2))
        return float(scipy.special.ndtr((delta2 - price) / std))

    def seconds_to_decide(self, delta2: float, seconds: float) -> float:
        """Return how many seconds of the motion, repeated, decide rightly with
        probability LEVEL.

        ``delta2`` is the squared distance in ``seconds`` of it. Infinity if 1e7 s are
        too few.
        """

        def excess(log_seconds: float) -> float:
            """Return the probability above LEVEL after exp(log_seconds); negative if
            too short.
            """
            length = np.exp(log_seconds)
            return self.probability_right(delta2 * length / seconds, length) - LEVEL

        shortest, longest = np.log([1e-3, 1e7])
        if excess(longest) < 0.0:
            return float("inf")
        if excess(shortest) >= 0.0:
            return float(np.exp(shortest))
        root = scipy.optimize.brentq(excess, shortest, longest, xtol=1e-4)
        return float(np.exp(root))


def _smallest_distance(X: Array, A: Array, B: Array) -> float:
    """Return the smallest delta^2 of effect A over unit parameters.

    X (r, p), A (r, k) and B (r, l) are columns of the model and of the two effects,
    over the noise. The model and B explain as much of A as they can; of the k
    directions of A the one that they explain best counts.
    """
    k = A.shape[1]
    # The triangular factor has the same inner products in fewer rows.
    columns = triangular([np.hstack([X, B, A])])
    unexplained = partialled(columns[:, :-k], columns[:, -k:])
    smallest = np.linalg.eigvalsh(unexplained.T @ unexplained)[0]
    return float(max(smallest, 0.0))


def default_excitation(estimate: Estimate, duration: float, seed: int) -> States:
    """Return the states of the motion with which `excite` begins.

    It is a random Fourier series within the robot's limits, ``duration`` [s] long.
    """
    robot = estimate.robot
    return shrunk(
        random_trajectory(robot, seed, duration), Limits.from_robot(robot)
    ).states


def separate(
    estimate: Estimate,
    effects: str,
    *,
    duration: float = 20.0,
    level: float = 1.0,
    iterations: int = 200,
    seed: int = 0,
    limits: Limits | None = None,
    free: Callable[[Array], bool] | None = None,
    progress: Progress = no_progress,
) -> Separation:
    """Plan the motion on which the torques of two effects differ most.

    A random search over motions from point to point within the limits.

    Parameters
    ----------
    effects : str
        Two effects, as they are written, or one that is to be told from no effect.
    duration : float
        Length of the motion [s].
    level : float
        Root mean square of each effect's torque over the noise of its joint, on the
        default excitation [-].
    iterations : int
        Number of random changes that are tried.
    free : callable, optional
        Whether the arm is free of self-collision in all poses (N, n)
        (:func:`~sdp_vs_penalty.robot.geometry.self_collision`); default: not checked.
    progress : callable
        Receives a line of text a change.

    Returns
    -------
    Separation
        The motion, and how well it separates the effects.

    Raises
    ------
    InputError
        For hypotheses that cannot be separated, or limits that no motion keeps.
    """
    hypotheses = Hypotheses(estimate, effects, level)
    limits = Limits.from_robot(estimate.robot) if limits is None else limits
    effort = np.array([j.effort for j in estimate.robot.joints])
    search = _MotionSearch(hypotheses, limits, effort, duration, free)
    rng = np.random.default_rng(seed)
    search.start(rng)
    search.change_at_random(rng, iterations, progress)
    if search.trajectory is None:
        what = "no motion from point to point keeps the limits"
        remedy = "widen the limits of position or torque, or lengthen the motion"
        raise InputError(what, remedy, command="--duration")
    # The default excitation is random: the median of three.
    distances = []
    for default_seed in range(seed, seed + 3):
        states = default_excitation(estimate, duration, default_seed)
        distances.append(hypotheses.distance(hypotheses.motion(states, duration)))
    powers = [
        Power(
            delta2,
            hypotheses.probability_right(delta2, duration),
            hypotheses.seconds_to_decide(delta2, duration),
        )
        for delta2 in (search.value, float(np.median(distances)))
    ]
    return Separation(search.trajectory, *powers)


class _Plan(NamedTuple):
    """points (W, n); slowness (W - 1,) of each move over the fastest; pauses (W,) [s]."""

    points: Array
    slowness: Array
    pauses: Array


class _MotionSearch:
    """The best motion from point to point so far.

    - ``range``: lowest and highest positions (n,) [rad, m].
    - ``value``: its distance of the hypotheses, -1 before there is one.
    - ``n_judged``: number of motions within the limits that were looked at.
    """

    def __init__(
        self,
        hypotheses: Hypotheses,
        limits: Limits,
        effort: Array,
        duration: float,
        free: Callable[[Array], bool] | None,
    ) -> None:
        """Prepare a search within _SHARE (95 %) of the limits.

        - ``effort`` (n,): torque limits [N m, N].
        - ``duration``: length of the motion [s].
        - ``free``: says whether the arm is free of self-collision in all of some poses
          (N, n); None: not checked.
        """
        self.hypotheses = hypotheses
        self.effort = effort
        self.duration = duration
        self.free = free
        low = limits.middle - _SHARE * limits.half
        high = limits.middle + _SHARE * limits.half
        self.range = (low, high)
        # No robot file states a limit of jerk: acceleration reaches its limit in 0.1 s.
        seconds_to_acceleration = 0.1
        jerk = limits.acceleration / seconds_to_acceleration
        self.velocity = _SHARE * limits.velocity
        self.acceleration = _SHARE * limits.acceleration
        self.jerk = _SHARE * jerk
        # The best motion so far: none yet.
        self.value = -1.0
        self.trajectory: PointTrajectory | None = None
        self.plan = _Plan(low[None], low, low)
        self.n_judged = 0  # motions within the limits

    def start(self, rng: np.random.Generator) -> None:
        """Draw random motions until _DRAWN of them keep the limits; keep the best one."""
        for _ in range(20 * _DRAWN):
            self.improve(_random_plan(rng, *self.range))
            if self.trajectory is not None and self.n_judged >= _DRAWN:
                break

    def change_at_random(
        self, rng: np.random.Generator, iterations: int, progress: Progress
    ) -> None:
        """Change the best motion at random so many times; each change that improves it
        stays. Nothing is done without a motion to begin with."""
        # Size of a change as a share of the ranges: larger after a success, smaller after
        # a failure, so that about one change in five succeeds.
        reach = 0.3
        low, high = self.range
        for k in range(iterations if self.trajectory is not None else 0):
            plan = _changed(rng, self.plan, low, high, reach)
            is_better = self.improve(plan)
            reach = min(0.5, reach * 1.3) if is_better else max(0.02, reach * 0.93)
            distance = self.value**0.5
            progress(
                f"separating: {k + 1} of {iterations} changes, delta {distance:.2f}"
            )

    def improve(self, plan: _Plan) -> bool:
        """Judge the motion of a plan; keep it if it is allowed and the best so far.

        A plan holds points, slowness of moves, and pauses. "Best" is the largest
        squared distance between the hypotheses' torques over the noise. Returns True if
        it is kept.
        """
        trajectory = self._trajectory(plan)
        if trajectory is None:
            return False
        # 1. The modelled torque must keep its limit.
        motion = self.hypotheses.motion(trajectory.states, self.duration)
        if np.any(np.abs(motion.modelled) > _SHARE * self.effort):
            return False
        self.n_judged += 1
        # 2. It must separate the hypotheses better, and not collide (costly: last).
        value = self.hypotheses.distance(motion)
        if value <= self.value or not self._is_free(trajectory):
            return False
        self.value = value
        self.trajectory = trajectory
        self.plan = plan
        return True

    def _trajectory(self, plan: _Plan) -> PointTrajectory | None:
        """Return the plan's trajectory with as many points as fit into the duration.

        Its moves are stretched to fill the duration exactly. None if fewer than two
        moves fit.
        """
        points, slowness, pauses = plan
        fastest = shortest_moves(points, self.velocity, self.acceleration, self.jerk)
        moves = slowness * fastest
        ends = np.cumsum(moves + pauses[1:]) + pauses[0]
        fit = int(np.searchsorted(ends, self.duration))
        if fit < 2:
            return None
        moves = moves[:fit]
        rests = pauses[: fit + 1]
        moves = moves * (self.duration - rests.sum()) / moves.sum()
        return PointTrajectory(points[: fit + 1], moves, rests)

    def _is_free(self, trajectory: PointTrajectory) -> bool:
        """Return whether the arm is free of self-collision at ten poses a second."""
        if self.free is None:
            return True
        poses = trajectory.states(np.arange(0.0, self.duration, 0.1))[0]
        return self.free(poses)


def _random_plan(rng: np.random.Generator, low: Array, high: Array) -> _Plan:
    """Draw a random plan of 6 to 39 points between positions low and high (n,).

    Some joints may stand still; moves may be slow and pauses short, all by chance.
    """
    n_points = int(rng.integers(6, 40))
    n_joints = len(low)
    points = rng.uniform(low, high, (n_points, n_joints))
    is_still = rng.random(n_joints) < rng.choice([0.0, 0.3, 0.7])
    points[:, is_still] = points[0, is_still]
    log_slowness = rng.uniform(0.0, np.log(_SLOWEST), n_points - 1)
    slowness = np.exp(log_slowness * rng.random())
    pauses = rng.uniform(0.0, _PAUSE, n_points) * rng.random()
    return _Plan(points, slowness, pauses)


def _changed(
    rng: np.random.Generator, now: _Plan, low: Array, high: Array, reach: float
) -> _Plan:
    """Return a plan with random changes of a random share of its points, moves and
    pauses.

    ``reach`` is the size of a change, as a share of the ranges between low and high
    (n,).
    """
    points, slowness, pauses = now
    share = rng.choice([0.1, 0.3, 1.0])
    step = reach * (high - low) * rng.normal(size=points.shape)
    is_moved = rng.random(points.shape) < share
    points = np.clip(points + step * is_moved, low, high)
    is_changed = rng.random(len(slowness)) < share
    log_factors = is_changed * reach * 2.0 * rng.normal(size=len(slowness))
    slowness = np.clip(slowness * np.exp(log_factors), 1.0, _SLOWEST)
    shift = reach * _PAUSE * rng.normal(size=len(pauses))
    pauses = np.clip(pauses + shift, 0.0, _PAUSE)
    return _Plan(points, slowness, pauses)
