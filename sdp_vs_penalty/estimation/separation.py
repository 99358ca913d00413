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
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import scipy

from sdp_vs_penalty.effects import parse_effects
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


@dataclass(frozen=True)
class Separation:
    """trajectory : the best motion found; delta2, default_delta2 : squared distance of
    the hypotheses on it and on the default excitation of the same length; right,
    default_right : probability of the right decision then; seconds, default_seconds :
    of each motion, repeated, that are needed for LEVEL; sizes : of the effects, as they
    were taken; collisions : whether the arm's shapes are known."""

    trajectory: PointTrajectory
    delta2: float
    default_delta2: float
    right: float
    default_right: float
    seconds: float
    default_seconds: float
    sizes: tuple[float, ...]
    collisions: bool


class Hypotheses:
    """Two effects beside a model, or one and none, and how large the noise is.

    Of effects as they are written, each of ``level`` times the noise of its joint (root
    mean square) on the default excitation. Raises InputError for more than two effects,
    or one that the model has.
    """

    def __init__(
        self,
        estimate: Estimate,
        texts: str,
        level: float,
    ) -> None:
        self.estimate, self.effects = (
            estimate,
            tuple(parse_effects(texts, estimate.robot)),
        )
        self.noise, self.row_rate = noise_of_model(estimate), independent_rate(estimate)
        if not 1 <= len(self.effects) <= 2:
            what = f"--separate {texts!r} names {len(self.effects)} effects"
            raise InputError(
                what, 'name two, such as "torque_ripple:4@k=2,joint_spring:4", or one'
            )
        model_names = {p.name for p in estimate.model.parameters}
        for effect in self.effects:
            if twice := model_names & {p.name for p in effect.parameters}:
                what = f"the model has {effect.name} already ({min(twice)})"
                raise InputError(what, "separate effects that it lacks")
        motion = self.motion(default_excitation(estimate, 20.0, 0), 20.0)
        # Mean squares of unit parameters over the noise, of the joint that each effect
        # moves most.
        squares = (
            (self._white(e, motion) ** 2).mean(axis=1).sum(axis=1).max()
            for e in self.effects
        )
        self.scale = tuple(level / float(nonzero_or_one(np.sqrt(x))) for x in squares)

    def motion(self, states: States, duration: float) -> Motion:
        """A motion with the model's torque and links, sampled."""
        t = np.arange(0.0, duration, 1.0 / RATE)
        return self.estimate.model.seen_along(
            self.estimate.theta, Motion(t, *states(t))
        )

    def _white(self, effect: Effect, motion: Motion) -> Array:
        """(n, N, k)."""
        out = np.zeros((self.estimate.robot.n, len(motion.t), len(effect.parameters)))
        for block in effect.blocks(motion):
            out[block.joint][:, block.parameters] += (
                block.columns / self.noise[block.joint]
            )
        return out

    def distance(self, motion: Motion) -> float:
        """delta^2 of a motion, counted in independent rows."""
        wide = self.estimate.model.dense_columns(
            replace(motion, torque=None, current=None)
        )
        X = (wide / self.noise[:, None, None]).reshape(-1, wide.shape[2])
        parts = [
            self._white(effect, motion).reshape(len(X), -1) * scale
            for effect, scale in zip(self.effects, self.scale, strict=True)
        ]
        pairs = (
            [(parts[0], parts[1]), (parts[1], parts[0])]
            if parts[1:]
            else [(parts[0], X[:, :0])]
        )
        return (
            min(
                _apart(
                    X,
                    A,
                    B,
                )
                for A, B in pairs
            )
            * self.row_rate
            / RATE
        )

    def right(self, delta2: float, seconds: float) -> float:
        """Probability that the sum of squares decides rightly, whichever of the two is
        true."""
        counts = [len(e.parameters) for e in self.effects] + [0]
        price = abs(counts[0] - counts[1]) * np.log(max(self.row_rate * seconds, 2.0))
        return float(
            scipy.special.ndtr(
                (delta2 - price) / (2.0 * np.sqrt(at_least_tiny(delta2)))
            )
        )

    def needed(self, delta2: float, seconds: float) -> float:
        """Seconds of the motion, repeated, for LEVEL; infinity where it never tells."""

        def short(log: float) -> float:
            return self.right(delta2 * np.exp(log) / seconds, np.exp(log)) - LEVEL

        first, last = np.log([1e-3, 1e7])
        if short(last) < 0.0:
            return float("inf")
        lengths = (
            first
            if short(first) >= 0.0
            else scipy.optimize.brentq(short, first, last, xtol=1e-4)
        )
        return float(np.exp(lengths))


def _apart(X: Array, A: Array, B: Array) -> float:
    """delta^2 of A against everything that X and B make, in the direction of A that B
    makes best; A's directions have unit parameters."""
    chosen, k = (
        triangular([np.hstack([X, B, A])]),
        A.shape[1],
    )  # as many rows as columns tell as much
    left = partialled(chosen[:, :-k], chosen[:, -k:])
    return float(max(np.linalg.eigvalsh(left.T @ left)[0], 0.0))


def default_excitation(estimate: Estimate, duration: float, seed: int) -> States:
    """What `excite` begins with: a random Fourier series within the limits."""
    robot = estimate.robot
    return shrunk(
        random_trajectory(robot, seed, duration), Limits.of_robot(robot)
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
    """The motion on which two effects differ most.

    Parameters
    ----------
    estimate : Estimate
        Of the arm.
    effects : str
        Two, as they are written, or one, to be told from nothing.
    duration : float
        Of the motion [s].
    level : float
        Root mean square of each effect over the noise of its joint on the default
        excitation.
    iterations : int
        Changes that are tried.
    seed : int
        Of the changes.
    limits : Limits, optional
        Default: the robot's own.
    free : callable, optional
        Whether the arm touches itself at none of poses (N, n)
        (:func:`~sdp_vs_penalty.robot.geometry.self_collision`).
    progress : callable
        Hears where the search stands.

    Returns
    -------
    Separation
        The motion, and how well it separates them.

    Raises
    ------
    InputError
        For hypotheses that cannot be separated.
    """
    hypotheses = Hypotheses(estimate, effects, level)
    limits = Limits.of_robot(estimate.robot) if limits is None else limits
    effort = np.array([j.effort for j in estimate.robot.joints])
    search = _MotionSearch(hypotheses, limits, effort, duration, free)
    rng = np.random.default_rng(seed)
    search.start(rng)
    reach = 0.3
    for k in range(iterations if search.trajectory is not None else 0):
        is_better = search.improve(
            _changed(
                rng,
                search.plan,
                *search.range,
                reach,
            )
        )
        reach = min(0.5, reach * 1.3) if is_better else max(0.02, reach * 0.93)
        distance = search.value**0.5
        progress(f"separating: {k + 1} of {iterations} changes, delta {distance:.2f}")
    if search.trajectory is None:
        remedy = (
            "widen the limits of position or torque, or lengthen the motion with"
            " --duration"
        )
        raise InputError("no motion from point to point keeps the limits", remedy)
    usual = (
        default_excitation(
            estimate,
            duration,
            s,
        )
        for s in range(seed, seed + 3)
    )
    distances = [hypotheses.distance(hypotheses.motion(s, duration)) for s in usual]
    default = float(np.median(distances))
    return Separation(
        search.trajectory,
        delta2=search.value,
        default_delta2=default,
        right=hypotheses.right(search.value, duration),
        default_right=hypotheses.right(default, duration),
        seconds=hypotheses.needed(search.value, duration),
        default_seconds=hypotheses.needed(default, duration),
        sizes=hypotheses.scale,
        collisions=free is not None,
    )


class _Plan(NamedTuple):
    """points (W, n); slowness (W - 1,) of each move over the fastest; pauses (W,) [s]."""

    points: Array
    slowness: Array
    pauses: Array


class _MotionSearch:
    """The best motion from point to point so far.

    range : lowest and highest positions (n,); value : its distance, -1 before there is
    one; n_judged : motions within the limits that were looked at.
    """

    def __init__(
        self,
        hypotheses: Hypotheses,
        limits: Limits,
        effort: Array,
        duration: float,
        free: Callable[[Array], bool] | None,
    ) -> None:
        self.hypotheses = hypotheses
        self.effort = effort
        self.duration = duration
        self.free = free
        low = limits.middle + -1.0 * _SHARE * limits.half
        high = limits.middle + 1.0 * _SHARE * limits.half
        self.range = (low, high)
        # Where nothing states a limit of jerk: acceleration within .1 s of its limit.
        jerk = limits.acceleration / 0.1
        self.velocity = _SHARE * limits.velocity
        self.acceleration = _SHARE * limits.acceleration
        self.jerk = _SHARE * jerk
        self.value = -1.0
        self.trajectory: PointTrajectory | None = None
        self.plan = _Plan(low[None], low, low)
        self.n_judged = 0

    def start(self, rng: np.random.Generator) -> None:
        """The best of motions that are drawn."""
        for _ in range(20 * _DRAWN):
            self.improve(_drawn(rng, *self.range))
            if self.trajectory is not None and self.n_judged >= _DRAWN:
                break

    def improve(self, plan: _Plan) -> bool:
        """Whether a motion is allowed and better than the best, which it then is."""
        trajectory = self._trajectory(plan)
        if trajectory is None:
            return False
        motion = self.hypotheses.motion(trajectory.states, self.duration)
        if np.any(np.abs(motion.modelled) > _SHARE * self.effort):
            return False
        self.n_judged += 1
        value = self.hypotheses.distance(motion)
        if value <= self.value or not self._is_free(trajectory):
            return False
        self.value = value
        self.trajectory = trajectory
        self.plan = plan
        return True

    def _trajectory(self, plan: _Plan) -> PointTrajectory | None:
        """As many points as fit; the time that is left goes into the moves."""
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
        """Whether the arm touches itself nowhere along it."""
        if self.free is None:
            return True
        poses = trajectory.states(np.arange(0.0, self.duration, 0.1))[0]
        return self.free(poses)


def _drawn(
    rng: np.random.Generator,
    low: Array,
    high: Array,
) -> _Plan:
    count = int(rng.integers(6, 40))
    n = len(low)
    points = rng.uniform(low, high, (count, n))
    still = rng.random(n) < rng.choice([0.0, 0.3, 0.7])
    points[:, still] = points[0, still]
    slow = np.exp(rng.uniform(0.0, np.log(_SLOWEST), count - 1) * rng.random())
    pauses = rng.uniform(0.0, _PAUSE, count) * rng.random()
    return _Plan(points, slow, pauses)


def _changed(
    rng: np.random.Generator,
    now: _Plan,
    low: Array,
    high: Array,
    reach: float,
) -> _Plan:
    points, slow, pauses = now
    share = rng.choice([0.1, 0.3, 1.0])
    step = reach * (high - low) * rng.normal(size=points.shape)
    points = np.clip(
        points + step * (rng.random(points.shape) < share),
        low,
        high,
    )
    which = rng.random(len(slow)) < share
    factors = np.exp(which * reach * 2.0 * rng.normal(size=len(slow)))
    slow = np.clip(slow * factors, 1.0, _SLOWEST)
    shift = reach * _PAUSE * rng.normal(size=len(pauses))
    return _Plan(
        points,
        slow,
        np.clip(pauses + shift, 0.0, _PAUSE),
    )
