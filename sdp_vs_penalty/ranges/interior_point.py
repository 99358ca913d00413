"""The least value of a linear function over small cones and one ball of the data, by an
interior-point method.

    minimise g^T theta   subject to   F_b(theta) >= 0 (blocks, rows),   |A theta - a|^2 <= r^2

The ball's slack s = r^2 - |A theta - a|^2 is a constraint like the rows, with a multiplier
l > 0 and the perturbed complementarity l s = mu. A Newton step has the matrix

    H = 2 l A^T A + sum F_b^* (S_b^-1 . Z_b) F_b + (l / s) v v^T,     v = 2 A^T (A theta - a)

(HKM direction, Mehrotra's predictor and corrector, as :mod:`solvers.primal_dual`). All
functions share cones and ball, so that one analytic centre serves as the start of all: from
it the central path of g begins at the tangent theta_0 - Hb^-1 g / mu. A search goes on from a
point of its path where the ball's radius changes, and takes a ratio h^T theta / m^T theta as
g = h - v m, v the ratio at the present point (Dinkelbach, Management Science 1967). Many
functions are one array with k rows: what NumPy's calls cost is shared.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, fields

import numpy as np
import scipy

from sdp_vs_penalty.robot.arrays import Array, Indices, Mask
from sdp_vs_penalty.solvers.small_cones import ORDER, SmallCones

#: Share of the way to the boundary that a step goes if its predictor gets nowhere; one
#: whose predictor goes all the way takes the second share.
_LOWEST_SHARE, _HIGHEST_SHARE = 0.95, 0.999
#: Relative changes of H's diagonal: the first that outweighs what rounding costs H of its
#: positive definiteness is taken.
_RIDGES = (1e-14, 1e-12, 1e-10, 1e-8)
#: Steps at most: twice what the slowest end of five arms takes.
_STEPS = 60
#: Newton's decrement below which a point counts as the analytic centre.
_CENTRAL = 0.1
#: A shorter step cannot be told from rounding.
_SHORTEST = 1e-8


@dataclass(frozen=True)
class Ball:
    """The data's ball |A theta - a|^2 <= r^2; each function has its own radius r."""

    #: (r, p) rows of the visible directions, orthonormal in them.
    A: Array
    #: (r,) the rows at least squares.
    a: Array


@dataclass(frozen=True)
class Points:
    """Strictly feasible points with multipliers of cones and ball, k functions a row
    each."""

    #: (k, p) coefficients of what is minimised.
    g: Array
    #: (k,) squared radius of the ball.
    squared_radius: Array
    #: (k, p) parameters, strictly inside of cones and ball.
    theta: Array
    #: (k, rows + 16 blocks) multipliers of the slacks.
    multipliers: Array
    #: (k,) multiplier of the ball [function per squared residual].
    ball: Array
    #: (k,) what a certificate by these multipliers loses at most, in units of the
    #: function: complementarity, and leftover slope times the parameters' bounds.
    error: Array

    def __getitem__(self, chosen: object) -> Points:
        """Return some points; one by an integer, whose arrays have no first axis."""
        return Points(*(getattr(self, f.name)[chosen] for f in fields(self)))

    def put(self, places: Indices, points: Points) -> None:
        """Replace the points at some places."""
        for f in fields(self):
            getattr(self, f.name)[places] = getattr(points, f.name)


class _State:
    """Slacks at points, their inverses and derivatives; NaN for points outside."""

    def __init__(
        self, cones: SmallCones, ball: Ball, squared_radius: Array, theta: Array
    ) -> None:
        """Evaluate cones and balls of squared radii (k,) at theta (k, p)."""
        self.cones = cones
        self.theta = theta
        self.slacks = cones.constant + (cones.slack_map @ theta.T).T
        self.rows, self.mats = split(cones, self.slacks)
        residual = theta @ ball.A.T - ball.a
        self.ball_gradient = 2.0 * residual @ ball.A
        self.ball_slack = squared_radius - np.sum(residual**2, axis=1)
        self.root = _inverse_roots(self.mats)
        self.inverse = np.swapaxes(self.root, 2, 3) @ self.root

    @property
    def is_inside(self) -> Mask:
        """(k,) whether each point is strictly inside of cones and ball."""
        return (
            np.all(self.rows > 0.0, axis=1)
            & (self.ball_slack > 0.0)
            & np.isfinite(self.root).all(axis=(1, 2, 3))
        )

    def barrier_multipliers(self, mu: Array) -> Array:
        """Return mu / s and mu S^-1 (k, rows + 16 blocks), flat, for mu (k,)."""
        flat = self.inverse.reshape(len(mu), -1)
        return mu[:, None] * np.hstack([1.0 / self.rows, flat])

    def scaled(self, change: Array, multipliers: Array) -> Array:
        """Return ds z / s of rows and the symmetric part of S^-1 dS Z of blocks, flat.

        change and multipliers (k, rows + 16 blocks) hold ds, dS and z, Z.
        """
        rows, mats = split(self.cones, change)
        z, Z = split(self.cones, multipliers)
        product = self.inverse @ mats @ Z
        half = 0.5 * (product + np.swapaxes(product, 2, 3))
        return np.hstack([rows * z / self.rows, half.reshape(len(z), -1)])

    def hessians(
        self, curvature: Array, multipliers: Array, ball: Array
    ) -> list[Array | None]:
        """Return the lower Cholesky factors of H (p, p), in LAPACK's order; None for a
        point at which there is none.

        curvature (p, p) is 2 A^T A; the multipliers are those of cones and balls.
        """
        cones = self.cones
        z, Z = split(cones, multipliers)
        kronecker = self.inverse[:, :, :, :, None, None] * Z[:, :, None, None]
        products = np.hstack([z / self.rows, kronecker.reshape(len(z), -1)])
        by_cones = np.ascontiguousarray((cones.curvature @ products.T).T)
        share = ball / self.ball_slack
        factors: list[Array | None] = [None] * len(z)
        for k in np.flatnonzero(self.is_inside):
            factors[k] = _factor(
                curvature,
                ball=ball[k],
                by_cones=by_cones[k],
                share=share[k],
                gradient=self.ball_gradient[k],
                places=cones.places,
            )
        return factors


def _factor(
    curvature: Array,
    ball: float,
    by_cones: Array,
    share: float,
    gradient: Array,
    places: Indices,
) -> Array | None:
    """Return the lower Cholesky factor (p, p) of the Newton step's matrix at one point,
    None if rounding leaves none.

    H = ``ball`` ``curvature`` + the cones' part + ``share`` v v^T, with ``ball`` the
    ball's multiplier, ``curvature`` 2 A^T A, ``share`` the multiplier over the ball's
    slack, and v the ball's ``gradient`` (p,). ``by_cones`` are the entries of the cones'
    part at ``places`` of H, flat; the others are zero.
    """
    for ridge in _RIDGES:
        H = ball * curvature
        H.ravel()[places] += by_cones
        H = scipy.linalg.blas.dsyr(share, gradient, lower=1, a=H.T, overwrite_a=1)
        H.T.ravel()[:: len(H) + 1] *= 1.0 + ridge
        factor, failed = scipy.linalg.lapack.dpotrf(H, lower=1, overwrite_a=1, clean=0)
        if not failed:
            return factor
    return None


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
    """Return the rows (..., rows) and the blocks (..., blocks, 4, 4) of flat slacks or
    multipliers, as views."""
    blocks = flat[..., cones.rows :]
    shape = (*flat.shape[:-1], len(cones.weight), ORDER, ORDER)
    return flat[..., : cones.rows], blocks.reshape(*shape)


def _inverse_roots(mats: Array) -> Array:
    """Return L^-1 of S = L L^T (k, blocks, 4, 4). If one block of a point is not
    positive definite, all of its blocks are NaN."""
    try:
        return np.linalg.inv(np.linalg.cholesky(mats))
    except np.linalg.LinAlgError:
        out = np.full_like(mats, np.nan)
        for k, blocks in enumerate(mats):
            with suppress(np.linalg.LinAlgError):
                out[k] = np.linalg.inv(np.linalg.cholesky(blocks))
        return out


def _solve(factors: Sequence[Array | None], right: Array) -> Array:
    """Return H^-1 right (k, p), by the Cholesky factors of H; NaN without one."""
    out = np.full_like(right, np.nan)
    for x, factor, one in zip(out, factors, right, strict=True):
        if factor is not None:
            x[:] = scipy.linalg.lapack.dpotrs(factor, one, lower=1)[0]
    return out


def _dot(a: Array, b: Array) -> Array:
    """Return the products (k,) of rows (k, p)."""
    return np.einsum("kp,kp->k", a, b)


@dataclass(frozen=True)
class _Direction:
    """Changes of everything along a Newton step."""

    #: (k, p) of theta.
    step: Array
    #: (k, rows + 16 blocks) of the slacks.
    slacks: Array
    #: (k, rows + 16 blocks) of the multipliers.
    multipliers: Array
    #: (k,) first-order change of the ball's slack.
    ball_slack: Array
    #: (k,) the negative of its second-order change, |A step|^2.
    ball_bend: Array
    #: (k,) of the ball's multiplier.
    ball: Array


class _Newton:
    """The Newton systems at points with multipliers."""

    def __init__(self, method: InteriorPoint, points: Points) -> None:
        """Factorise the systems."""
        self.cones = method.cones
        self.A = method.ball.A
        self.points = points
        self.state = state = _State(
            method.cones, method.ball, points.squared_radius, points.theta
        )
        self.factors = state.hessians(method.curvature, points.multipliers, points.ball)
        z, Z = split(self.cones, points.multipliers)
        self.rows = np.hstack([state.rows, z])
        self.roots = np.hstack([state.root, _inverse_roots(Z)])

    def times(self, step: Array) -> Array:
        """Return H step (k, p), computed from slacks and torque: the data's part has no
        rounding error where no torque shows the step."""
        state = self.state
        ball = self.points.ball
        slacks = (self.cones.slack_map @ step.T).T
        moved = state.scaled(slacks, self.points.multipliers)
        along = ball / state.ball_slack * _dot(state.ball_gradient, step)
        by_ball = (2.0 * ball)[:, None] * ((step @ self.A.T) @ self.A)
        by_ball += along[:, None] * state.ball_gradient
        return (self.cones.adjoint @ moved.T).T + by_ball

    def direction(
        self,
        mu: Array,
        bent: Array | float = 0.0,
        bent_ball: Array | float = 0.0,
        refined: bool = False,
    ) -> _Direction:
        """Return the changes that aim at complementarities mu (k,).

        bent and bent_ball are second-order terms of an earlier direction, for the
        multipliers of cones and of the ball. ``refined`` solves the Newton system once
        more, for what rounding has left of the first solution.
        """
        state = self.state
        points = self.points
        target = state.barrier_multipliers(mu) - bent
        target_ball = mu / state.ball_slack - bent_ball
        slope = points.g + target_ball[:, None] * state.ball_gradient
        right = (self.cones.adjoint @ target.T).T - slope
        step = _solve(self.factors, right)
        if refined:
            step = step + _solve(self.factors, right - self.times(step))
        slacks = (self.cones.slack_map @ step.T).T
        ball_slack = -_dot(state.ball_gradient, step)
        torque = step @ self.A.T
        return _Direction(
            step,
            slacks,
            target - points.multipliers - state.scaled(slacks, points.multipliers),
            ball_slack,
            _dot(torque, torque),
            target_ball - points.ball - points.ball * ball_slack / state.ball_slack,
        )

    def complementarity(
        self, d: _Direction | None = None, share: Array | float = 0.0
    ) -> Array:
        """Return the sums (k,) of all products of slacks and multipliers, after shares
        (k,) of a direction."""
        state = self.state
        slacks, z = state.slacks, self.points.multipliers
        ball_slack, ball = state.ball_slack, self.points.ball
        if d is not None:
            t = np.asarray(share)[:, None]
            slacks = slacks + t * d.slacks
            z = z + t * d.multipliers
            ball_slack = ball_slack + share * d.ball_slack - share**2 * d.ball_bend
            ball = ball + share * d.ball
        return _dot(slacks, z) + ball_slack * ball

    def longest(self, d: _Direction) -> Array:
        """Return the longest multiples (k,) of a direction that keep slacks and
        multipliers of cones and ball positive.

        A row reaches zero at the multiple -1 / (change / value); a block where the
        smallest eigenvalue of the change, in units of the block, is -1 over it.
        """
        rows, mats = split(self.cones, d.slacks)
        z, Z = split(self.cones, d.multipliers)
        relative = np.hstack([rows, z]) / self.rows
        smallest = np.minimum(
            relative.min(axis=1, initial=-1e-12), d.ball / self.points.ball
        )
        turned = self.roots @ np.hstack([mats, Z]) @ np.swapaxes(self.roots, 2, 3)
        turned[~np.isfinite(turned).all(axis=(1, 2, 3))] = -np.eye(ORDER)
        eigenvalues = np.linalg.eigvalsh(turned)[:, :, 0]
        smallest = np.minimum(smallest, eigenvalues.min(axis=1, initial=-1e-12))
        # The ball: slack + t change - t^2 bend > 0.
        slack = self.state.ball_slack
        root = np.sqrt(d.ball_slack**2 + 4.0 * d.ball_bend * slack)
        to_ball = 2.0 * slack / np.maximum(root - d.ball_slack, 1e-300)
        return np.minimum(-1.0 / smallest, to_ball)

    def corrected(self, degree: int) -> tuple[_Direction, Array]:
        """Return Mehrotra's directions, and which multiples (k,) of them to go.

        The predictor shows how far one can go and what complementarity that leaves; the
        corrector aims at that share of it, with the predictor's second-order terms.
        """
        ball, state = self.points.ball, self.state
        before = self.complementarity()
        first = self.direction(np.zeros_like(before))
        reach = np.minimum(1.0, _HIGHEST_SHARE * self.longest(first))
        remaining = np.maximum(self.complementarity(first, reach) / before, 0.0)
        power = np.maximum(1.0, 3.0 * reach**2)
        centring = np.clip(remaining**power, 1e-7, 1.0)
        bent = state.scaled(first.slacks, first.multipliers)
        bent_ball = first.ball_slack * first.ball - ball * first.ball_bend
        bent_ball /= state.ball_slack
        d = self.direction(centring * before / degree, bent, bent_ball, refined=True)
        share = _LOWEST_SHARE + (_HIGHEST_SHARE - _LOWEST_SHARE) * reach**2
        return d, np.minimum(1.0, share * self.longest(d))


class InteriorPoint:
    """The least values of linear functions over the same cones and balls about the same
    torque."""

    def __init__(
        self, cones: SmallCones, ball: Ball, start: Array, fit: Array, bound: Array
    ) -> None:
        """Find the analytic centre of the cones and the ball of radius 1, from which all
        functions start.

        Raises LinAlgError unless ``start`` (p,) is strictly inside of cones and ball.
        ``fit`` (p,) is inside of the cones and of every ball that will be asked for;
        |theta_k| <= ``bound`` (p,) in the cones.
        """
        self.cones = cones
        self.ball = ball
        self.fit = fit
        self.bound = bound
        self.curvature = 2.0 * ball.A.T @ ball.A
        self.degree = cones.rows + ORDER * len(cones.weight) + 1
        one = np.ones(1)
        theta = start[None]
        for _ in range(_STEPS):
            state = _State(cones, ball, one, theta)
            multipliers = state.barrier_multipliers(one)
            weight = 1.0 / state.ball_slack
            (factor,) = state.hessians(self.curvature, multipliers, weight)
            if factor is None:
                raise np.linalg.LinAlgError
            #: Factor of the barrier's Hessian at the centre.
            self._barrier = factor
            slope = (cones.adjoint @ multipliers.T).T
            slope -= weight[:, None] * state.ball_gradient
            step = _solve([factor], slope)
            decrement = np.sqrt(max(_dot(step, slope)[0], 0.0))
            if decrement < _CENTRAL:
                break
            theta = theta + step / (1.0 + decrement)
        #: (p,) point of the largest product of all slacks, nearly.
        self.centre = state.theta[0]

    def minimise(
        self,
        h: Array,
        accuracy: float,
        *,
        m: Array | None = None,
        start: Points | None = None,
        squared_radius: Array | float = 1.0,
        first: float = 0.7,
    ) -> Points:
        """Return the points with the least h^T theta, or h^T theta / m^T theta, strictly
        inside.

        Parameters
        ----------
        h, m : (k, p) array
            Coefficients of the functions, and of what each is divided by; m = 0 for
            none.
        accuracy : float
            Largest error as a share of a function's local size at the centre.
        start : Points, optional
            Of the same functions, perhaps in other balls; default: the centre.
        squared_radius : (k,) array
            Squared radius of each function's ball.
        first : float
            Local length of the first step away from the analytic centre.
        """
        m = np.zeros_like(h) if m is None else m
        centre = np.tile(self.centre, (len(h), 1))
        g = _linear(h, m, centre)
        tangent = _solve([self._barrier] * len(h), g)
        size = np.sqrt(np.maximum(_dot(g, tangent), 0.0))
        if start is None:
            mu = size / first
            step = np.divide(tangent, mu[:, None], out=0.0 * g, where=mu[:, None] > 0.0)
            start = self._start(g, centre - step, mu)
        points = self._moved(start, np.broadcast_to(squared_radius, size.shape))
        best = points
        best.error[size == 0.0] = 0.0
        active = np.flatnonzero(size > 0.0)
        points = points[active]
        # Values that are not finite end the search for their function alone.
        with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
            for _ in range(_STEPS):
                if not len(active):
                    break
                points.g[:] = _linear(h[active], m[active], points.theta)
                newton = _Newton(self, points)
                d, share = newton.corrected(self.degree)
                t = share[:, None]
                points = Points(
                    points.g,
                    points.squared_radius,
                    points.theta + t * d.step,
                    points.multipliers + t * d.multipliers,
                    points.ball + share * d.ball,
                    points.error,
                )
                error, points.error[:] = self._errors(points, newton)
                is_better = points.error < best.error[active]
                best.put(active[is_better], points[is_better])
                goes_on = (share > _SHORTEST) & ~(error <= accuracy * size[active])
                active, points = active[goes_on], points[goes_on]
        return best

    def _start(self, g: Array, theta: Array, mu: Array) -> Points:
        """Return points with multipliers mu / s, at theta or at the centre."""
        one = np.ones(len(theta))
        state = _State(self.cones, self.ball, one, theta)
        is_outside = ~state.is_inside
        if is_outside.any():
            theta = np.where(is_outside[:, None], self.centre, theta)
            state = _State(self.cones, self.ball, one, theta)
        z = state.barrier_multipliers(mu)
        return Points(g, one, theta, z, mu / state.ball_slack, np.full_like(mu, np.inf))

    def _moved(self, points: Points, squared_radius: Array) -> Points:
        """Return points for balls of other radii, (k,) squared.

        Where a ball shrinks, its point moves towards the best fit, which is inside of every
        ball, until its slack is what it was in the old ball, or half of what there is room
        for. Others stay.
        """
        ball = self.ball
        at_fit = ball.A @ self.fit - ball.a
        away = (points.theta - self.fit) @ ball.A.T
        square = at_fit @ at_fit
        slack = points.squared_radius - np.sum((away + at_fit) ** 2, axis=1)
        # |at_fit + t away|^2 = squared_radius - slack.
        room = squared_radius - square
        room = room - np.minimum(slack, 0.5 * room)
        b, a = away @ at_fit, _dot(away, away)
        t = room / np.maximum(b + np.sqrt(b**2 + a * room), 1e-300)
        t = np.where(squared_radius < points.squared_radius, np.minimum(t, 1.0), 1.0)
        return Points(
            points.g.copy(),
            squared_radius.copy(),
            self.fit + t[:, None] * (points.theta - self.fit),
            points.multipliers.copy(),
            points.ball.copy(),
            np.full_like(t, np.inf),
        )

    def _errors(self, points: Points, newton: _Newton) -> tuple[Array, Array]:
        """Return by how much (k,) each point may miss its least value, twice.

        Both are the sum of slacks times multipliers, plus what the leftover slope (the
        gradient of the Lagrangian, zero at an optimum) can cost: near the point, by the
        Newton step, and anywhere within the parameters' bounds. Infinite outside of
        cones or ball.
        """
        cones, ball = self.cones, self.ball
        slacks = cones.constant + (cones.slack_map @ points.theta.T).T
        residual = points.theta @ ball.A.T - ball.a
        slack = points.squared_radius - np.sum(residual**2, axis=1)
        leftover = points.g + (2.0 * points.ball)[:, None] * (residual @ ball.A)
        leftover -= (cones.adjoint @ points.multipliers.T).T
        sums = _dot(slacks, points.multipliers) + points.ball * slack
        near = sums + np.abs(_dot(leftover, _solve(newton.factors, leftover)))
        is_inside = (slacks[:, : cones.rows] > 0.0).all(axis=1) & (slack > 0.0)
        is_inside &= np.isfinite(near)
        anywhere = sums + np.abs(leftover) @ self.bound
        return np.where(is_inside, near, np.inf), np.where(is_inside, anywhere, np.inf)


def _linear(h: Array, m: Array, theta: Array) -> Array:
    """Return h - v m (k, p) with the ratios v = h^T theta / m^T theta; h where m = 0."""
    mass = _dot(m, theta)
    v = np.divide(_dot(h, theta), mass, out=np.zeros_like(mass), where=mass != 0.0)
    return h - v[:, None] * m
