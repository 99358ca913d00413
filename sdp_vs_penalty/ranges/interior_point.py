"""The least value of a linear function over small cones and one ball of the data, by an
interior-point method.

    minimise g^T theta   subject to   F_b(theta) >= 0 (blocks, rows),   |A theta - a|^2 <= r^2

The ball's slack s = r^2 - |A theta - a|^2 is a constraint like the rows, with a multiplier
l > 0 and the perturbed complementarity l s = mu. A Newton step has the matrix

    H = 2 l A^T A + sum F_b^* (S_b^-1 . Z_b) F_b + (l / s) v v^T,     v = 2 A^T (A theta - a)

(HKM direction, Mehrotra's predictor and corrector, as :mod:`solvers.primal_dual`). All
functions share the cones and the ball, so that one analytic centre serves as the start of
all: from it the central path of g begins at the tangent theta_0 - Hb^-1 g / mu.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import scipy

from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.solvers.small_cones import ORDER, SmallCones

#: Share of the way to the boundary that a step goes at most.
_SHARE = 0.95
#: Relative change of H's diagonal: what rounding in H may cost its positive
#: definiteness.
_RIDGE = 1e-14
#: Steps at most: twice what the slowest end of five arms takes.
_STEPS = 60
#: Newton's decrement below which a point counts as the analytic centre.
_CENTRAL = 0.1
#: A shorter step cannot be told from rounding.
_SHORTEST = 1e-8


@dataclass(frozen=True)
class Ball:
    """The data's ball |A theta - a|^2 <= squared_radius."""

    #: (r, p) rows of the visible directions, orthonormal in them.
    A: Array
    #: (r,) the rows at least squares.
    a: Array
    #: Squared radius r^2, positive.
    squared_radius: float

    def slack(self, theta: Array) -> float:
        """Return r^2 - |A theta - a|^2, positive inside."""
        residual = self.A @ theta - self.a
        return self.squared_radius - float(residual @ residual)


@dataclass(frozen=True)
class Point:
    """A strictly feasible point with multipliers of cones and ball."""

    #: (p,) parameters, strictly inside of cones and ball.
    theta: Array
    #: (rows + 16 blocks,) multipliers of the slacks.
    multipliers: Array
    #: Multiplier of the ball [function per squared residual].
    ball: float
    #: Complementarity and leftover slope, in units of the function.
    error: float = math.inf
    #: Newton steps that led here.
    steps: int = 0


class _State:
    """Slacks at a point, their inverses and derivatives."""

    def __init__(self, cones: SmallCones, ball: Ball, theta: Array) -> None:
        """Evaluate cones and ball at theta (p,); LinAlgError unless strictly inside."""
        self.cones = cones
        self.theta = theta
        self.slacks = cones.constant + cones.slack_map @ theta
        self.rows, self.mats = split(cones, self.slacks)
        self.ball_gradient = 2.0 * (ball.A @ theta - ball.a) @ ball.A
        self.ball_slack = ball.slack(theta)
        if not (np.all(self.rows > 0.0) and self.ball_slack > 0.0):
            raise np.linalg.LinAlgError
        self.root = np.linalg.inv(np.linalg.cholesky(self.mats))
        self.inverse = np.swapaxes(self.root, 1, 2) @ self.root

    def barrier_multipliers(self, mu: float) -> Array:
        """Return mu / s and mu S^-1 (rows + 16 blocks,), flat."""
        return np.concatenate([mu / self.rows, (mu * self.inverse).ravel()])

    def scaled(self, change: Array, multipliers: Array) -> Array:
        """Return ds z / s of rows and the symmetric part of S^-1 dS Z of blocks, flat.

        change and multipliers (rows + 16 blocks,) hold ds, dS and z, Z.
        """
        rows, mats = split(self.cones, change)
        z, Z = split(self.cones, multipliers)
        product = self.inverse @ mats @ Z
        half = 0.5 * (product + np.swapaxes(product, 1, 2))
        return np.concatenate([rows * z / self.rows, half.ravel()])

    def hessian(self, curvature: Array, multipliers: Array, ball: float) -> Array:
        """Return the lower Cholesky factor of H (p, p), in LAPACK's order.

        curvature (p, p) is 2 A^T A; the multipliers are those of cones and ball.
        """
        cones = self.cones
        z, Z = split(cones, multipliers)
        products = np.empty(cones.curvature.shape[1])
        products[: cones.rows] = z / self.rows
        kronecker = self.inverse[:, :, :, None, None] * Z[:, None, None]
        products[cones.rows :] = kronecker.ravel()
        H = ball * curvature
        H.ravel()[cones.places] += cones.curvature @ products
        v = self.ball_gradient
        H += (ball / self.ball_slack) * np.multiply.outer(v, v)
        H.ravel()[:: len(H) + 1] *= 1.0 + _RIDGE
        factor, failed = scipy.linalg.lapack.dpotrf(
            H.T, lower=1, overwrite_a=1, clean=0
        )
        if failed:
            raise np.linalg.LinAlgError
        return np.asarray(factor)


def barrier_hessian(cones: SmallCones, theta: Array) -> Array:
    """Return the Hessian (p, p) of -sum log s - sum log det S at theta (p,), strictly
    inside."""
    rows, mats = split(cones, cones.constant + cones.slack_map @ theta)
    inverse = np.linalg.inv(mats)
    kronecker = inverse[:, :, :, None, None] * inverse[:, None, None]
    products = np.concatenate([1.0 / rows**2, kronecker.ravel()])
    lower = np.zeros((len(theta), len(theta)))
    lower.ravel()[cones.places] = cones.curvature @ products
    return lower + np.tril(lower, -1).T + np.triu(lower, 1).T


def split(cones: SmallCones, flat: Array) -> tuple[Array, Array]:
    """Return the rows (rows,) and the blocks (blocks, 4, 4) of flat slacks or
    multipliers, as views."""
    return flat[: cones.rows], flat[cones.rows :].reshape(-1, ORDER, ORDER)


def _solve(factor: Array, right: Array) -> Array:
    """Return H^-1 right, by the Cholesky factor of H."""
    return np.asarray(scipy.linalg.lapack.dpotrs(factor, right, lower=1)[0])


@dataclass(frozen=True)
class _Direction:
    """Changes of everything along a Newton step."""

    #: (p,) of theta.
    step: Array
    #: (rows + 16 blocks,) of the slacks.
    slacks: Array
    #: (rows + 16 blocks,) of the multipliers.
    multipliers: Array
    #: First-order change of the ball's slack, and the negative of its second-order one,
    #: |A step|^2.
    ball_slack: float
    ball_bend: float
    #: Of the ball's multiplier.
    ball: float


class _Newton:
    """The Newton system of g at a point with multipliers."""

    def __init__(self, method: InteriorPoint, g: Array, point: Point) -> None:
        """Factorise the system; LinAlgError unless the point is strictly inside."""
        self.cones = method.cones
        self.A = method.ball.A
        self.g = g
        self.point = point
        self.state = state = _State(method.cones, method.ball, point.theta)
        self.factor = state.hessian(method.curvature, point.multipliers, point.ball)
        z, Z = split(self.cones, point.multipliers)
        self.rows = np.concatenate([state.rows, z])
        self.roots = np.concatenate([state.root, np.linalg.inv(np.linalg.cholesky(Z))])

    def times(self, step: Array) -> Array:
        """Return H step by slacks and torque: without rounding where no torque shows
        the step."""
        state = self.state
        ball = self.point.ball
        moved = state.scaled(self.cones.slack_map @ step, self.point.multipliers)
        along = ball / state.ball_slack * float(state.ball_gradient @ step)
        by_ball = 2.0 * ball * (self.A @ step) @ self.A + along * state.ball_gradient
        return np.asarray(self.cones.adjoint @ moved + by_ball)

    def direction(
        self,
        mu: float,
        bent: Array | float = 0.0,
        bent_ball: float = 0.0,
        refined: bool = False,
    ) -> _Direction:
        """Return the changes that aim at a complementarity mu, by one solution of the
        Newton system, or by a second one of what the first leaves.

        bent and bent_ball are second-order terms of an earlier direction, of the
        multipliers of cones and ball.
        """
        state = self.state
        point = self.point
        target = state.barrier_multipliers(mu) - bent
        target_ball = mu / state.ball_slack - bent_ball
        slope = self.g + target_ball * state.ball_gradient
        right = self.cones.adjoint @ target - slope
        step = _solve(self.factor, right)
        if refined:
            step = step + _solve(self.factor, right - self.times(step))
        slacks = self.cones.slack_map @ step
        ball_slack = -float(state.ball_gradient @ step)
        torque = self.A @ step
        return _Direction(
            step,
            slacks,
            target - point.multipliers - state.scaled(slacks, point.multipliers),
            ball_slack,
            float(torque @ torque),
            target_ball - point.ball - point.ball * ball_slack / state.ball_slack,
        )

    def complementarity(self, d: _Direction | None = None, share: float = 0.0) -> float:
        """Return the sum of all products of slacks and multipliers, after a share of a
        direction."""
        state = self.state
        slacks, z = state.slacks, self.point.multipliers
        ball_slack, ball = state.ball_slack, self.point.ball
        if d is not None:
            slacks = slacks + share * d.slacks
            z = z + share * d.multipliers
            ball_slack = ball_slack + share * d.ball_slack - share**2 * d.ball_bend
            ball = ball + share * d.ball
        return float(slacks @ z) + ball_slack * ball

    def longest(self, d: _Direction) -> float:
        """Return the longest multiple of a direction that stays inside."""
        rows, mats = split(self.cones, d.slacks)
        z, Z = split(self.cones, d.multipliers)
        relative = np.concatenate([rows, z]) / self.rows
        smallest = min(float(relative.min(initial=-1e-12)), d.ball / self.point.ball)
        if len(self.roots):
            changes = np.concatenate([mats, Z])
            turned = self.roots @ changes @ np.swapaxes(self.roots, 1, 2)
            smallest = min(smallest, float(np.linalg.eigvalsh(turned)[:, 0].min()))
        # The ball: slack + t change - t^2 bend > 0.
        slack = self.state.ball_slack
        root = math.sqrt(d.ball_slack**2 + 4.0 * d.ball_bend * slack)
        to_ball = 2.0 * slack / max(root - d.ball_slack, 1e-300)
        return min(-1.0 / smallest, to_ball)

    def corrected(self, degree: int) -> tuple[_Direction, float]:
        """Return Mehrotra's direction, and which multiple of it to go.

        The predictor shows how far one can go and what complementarity that leaves; the
        corrector aims at that share of it, with the predictor's second-order terms.
        """
        first = self.direction(0.0)
        reach = min(1.0, 0.999 * self.longest(first))
        before = self.complementarity()
        remaining = max(self.complementarity(first, reach) / before, 0.0)
        centring = min(max(remaining ** max(1.0, 3.0 * reach**2), 1e-7), 1.0)
        bent = self.state.scaled(first.slacks, first.multipliers)
        bent_ball = first.ball_slack * first.ball - self.point.ball * first.ball_bend
        bent_ball /= self.state.ball_slack
        d = self.direction(centring * before / degree, bent, bent_ball, refined=True)
        share = _SHARE + (0.999 - _SHARE) * reach**2
        return d, min(1.0, share * self.longest(d))


class InteriorPoint:
    """The least values of linear functions over the same cones and ball."""

    def __init__(self, cones: SmallCones, ball: Ball, start: Array) -> None:
        """Find the analytic centre of the set, from which all functions start.

        Raises LinAlgError unless ``start`` (p,) is strictly inside of cones and ball.
        """
        self.cones = cones
        self.ball = ball
        self.curvature = 2.0 * ball.A.T @ ball.A
        self.degree = cones.rows + ORDER * len(cones.weight) + 1
        theta = start
        for _ in range(_STEPS):
            state = _State(cones, ball, theta)
            multipliers = state.barrier_multipliers(1.0)
            weight = 1.0 / state.ball_slack
            #: Factor of the barrier's Hessian at the centre.
            self._barrier = state.hessian(self.curvature, multipliers, weight)
            slope = cones.adjoint @ multipliers - weight * state.ball_gradient
            step = _solve(self._barrier, slope)
            decrement = math.sqrt(max(float(step @ slope), 0.0))
            if decrement < _CENTRAL:
                break
            theta = theta + step / (1.0 + decrement)
        #: (p,) point of the largest product of all slacks, nearly.
        self.centre = state.theta

    def minimise(self, g: Array, accuracy: float, first: float = 0.7) -> Point:
        """Return the point with the least g^T theta, strictly inside.

        Parameters
        ----------
        g : (p,) array
            Coefficients of the function.
        accuracy : float
            Largest error as a share of the function's local size at the centre.
        first : float
            Local length of the first step away from the analytic centre.
        """
        tangent = _solve(self._barrier, g)
        size = math.sqrt(max(float(g @ tangent), 0.0))
        if size <= 0.0:
            return Point(self.centre, np.zeros(len(self.cones.constant)), 0.0, 0.0)
        mu = size / first
        best = point = self._start(self.centre - tangent / mu, mu)
        for k in range(1, _STEPS + 1):
            try:
                newton = _Newton(self, g, point)
                d, share = newton.corrected(self.degree)
            except np.linalg.LinAlgError:
                break
            if not share > _SHORTEST:  # NaN, too, ends the iteration
                break
            point = Point(
                point.theta + share * d.step,
                point.multipliers + share * d.multipliers,
                point.ball + share * d.ball,
            )
            error = self._error(g, point, newton)
            if error < best.error:
                best = Point(point.theta, point.multipliers, point.ball, error, k)
            if error <= accuracy * size:
                break
        return best

    def _start(self, theta: Array, mu: float) -> Point:
        """Return the point with multipliers mu / s, at theta or at the centre."""
        try:
            state = _State(self.cones, self.ball, theta)
        except np.linalg.LinAlgError:
            state = _State(self.cones, self.ball, self.centre)
        return Point(state.theta, state.barrier_multipliers(mu), mu / state.ball_slack)

    def _error(self, g: Array, point: Point, newton: _Newton) -> float:
        """Return complementarity plus what the leftover slope can cost; infinite
        outside of cones or ball."""
        cones = self.cones
        ball = self.ball
        slacks = cones.constant + cones.slack_map @ point.theta
        slack = ball.slack(point.theta)
        if not (np.all(slacks[: cones.rows] > 0.0) and slack > 0.0):
            return math.inf
        by_ball = 2.0 * point.ball * (ball.A @ point.theta - ball.a) @ ball.A
        leftover = g + by_ball - cones.adjoint @ point.multipliers
        cost = abs(float(leftover @ _solve(newton.factor, leftover)))
        return float(slacks @ point.multipliers) + point.ball * slack + cost
