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
    ball_multiplier: Array
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
        #: (k, rows + 16 blocks) slacks of the cones; their rows s (k, rows) and
        #: matrices S (k, blocks, 4, 4).
        self.slacks = cones.constant + (cones.slack_map @ theta.T).T
        self.rows, self.blocks = split(cones, self.slacks)
        residual = theta @ ball.A.T - ball.a
        #: (k, p) v = 2 A^T (A theta - a), and (k,) s = r^2 - |A theta - a|^2.
        self.ball_gradient = 2.0 * residual @ ball.A
        self.ball_slack = squared_radius - np.sum(residual**2, axis=1)
        #: (k, blocks, 4, 4) L^-1 with S = L L^T, and S^-1.
        self.inverse_roots = _inverse_roots(self.blocks)
        self.inverses = np.swapaxes(self.inverse_roots, 2, 3) @ self.inverse_roots

    @property
    def is_inside(self) -> Mask:
        """(k,) whether each point is strictly inside of cones and ball."""
        return (
            np.all(self.rows > 0.0, axis=1)
            & (self.ball_slack > 0.0)
            & np.isfinite(self.inverse_roots).all(axis=(1, 2, 3))
        )

    def barrier_multipliers(self, mu: Array) -> Array:
        """Return mu / s and mu S^-1 (k, rows + 16 blocks), flat, for mu (k,)."""
        flat = self.inverses.reshape(len(mu), -1)
        return mu[:, None] * np.hstack([1.0 / self.rows, flat])

    def multiplier_response(self, change: Array, multipliers: Array) -> Array:
        """Return by how much multipliers fall, at fixed complementarity, as slacks rise:
        z ds / s of rows and the symmetric part of S^-1 dS Z of blocks.

        ``change`` holds ds and dS, ``multipliers`` z and Z; they and the result are flat,
        (k, rows + 16 blocks).
        """
        ds, dS = split(self.cones, change)
        z, Z = split(self.cones, multipliers)
        product = self.inverses @ dS @ Z
        symmetric = 0.5 * (product + np.swapaxes(product, 2, 3))
        return np.hstack([ds * z / self.rows, symmetric.reshape(len(z), -1)])

    def hessian_factors(
        self, data_curvature: Array, multipliers: Array, ball_multiplier: Array
    ) -> list[Array | None]:
        """Return the lower Cholesky factor (p, p) of the Newton matrix H of each of k
        points, in LAPACK's order; None outside of the cones or the ball, or where
        rounding leaves none.

        Parameters
        ----------
        data_curvature : (p, p) array
            2 A^T A.
        multipliers : (k, rows + 16 blocks) array
            z and Z of the cones.
        ball_multiplier : (k,) array
            l of the ball.
        """
        cones = self.cones
        z, Z = split(cones, multipliers)
        # The blocks' part of H is linear in the entries of S^-1 (x) Z, a 4x4x4x4 array
        # of each block.
        kronecker = self.inverses[:, :, :, :, None, None] * Z[:, :, None, None]
        products = np.hstack([z / self.rows, kronecker.reshape(len(z), -1)])
        cone_entries = np.ascontiguousarray((cones.curvature @ products.T).T)
        factors: list[Array | None] = [None] * len(z)
        for k in np.flatnonzero(self.is_inside):
            factors[k] = _newton_matrix_factor(
                ball_multiplier[k] * data_curvature,
                cone_entries=cone_entries[k],
                places=cones.places,
                v=self.ball_gradient[k],
                v_weight=ball_multiplier[k] / self.ball_slack[k],
            )
        return factors


def _newton_matrix_factor(
    by_data: Array, cone_entries: Array, places: Indices, v: Array, v_weight: float
) -> Array | None:
    """Return the lower Cholesky factor (p, p) of H at one point, None if rounding leaves
    none: H = ``by_data`` + the cones' part + ``v_weight`` v v^T.

    Parameters
    ----------
    by_data : (p, p) array
        2 l A^T A.
    cone_entries, places : arrays
        Entries of the cones' part, and their places in flat H; the others are zero.
    v, v_weight : (p,) array, float
        Gradient of the squared residual, and l / s, the multiplier over the ball's slack.
    """
    for ridge in _RIDGES:
        H = by_data.copy()
        H.ravel()[places] += cone_entries
        # BLAS adds v v^T to the lower triangle in Fortran's order, the transpose of ours.
        H = scipy.linalg.blas.dsyr(v_weight, v, lower=1, a=H.T, overwrite_a=1)
        H.T.ravel()[:: len(H) + 1] *= 1.0 + ridge
        factor, failed = scipy.linalg.lapack.dpotrf(H, lower=1, overwrite_a=1, clean=0)
        if not failed:
            return factor
    return None


def barrier_hessian(cones: SmallCones, theta: Array) -> Array:
    """Return the Hessian (p, p) of -sum log s - sum log det S at theta (p,), strictly
    inside; s and S are the slacks of the cones' rows and blocks."""
    rows, blocks = split(cones, cones.constant + cones.slack_map @ theta)
    inverse = np.linalg.inv(blocks)
    kronecker = inverse[:, :, :, None, None] * inverse[:, None, None]
    products = np.concatenate([1.0 / rows**2, kronecker.ravel()])
    lower = np.zeros((len(theta), len(theta)))
    lower.ravel()[cones.places] = cones.curvature @ products
    return lower + np.tril(lower, -1).T + np.triu(lower, 1).T


def split(cones: SmallCones, flat: Array) -> tuple[Array, Array]:
    """Return the rows (..., rows) and the blocks (..., blocks, 4, 4) of flat slacks or
    multipliers (..., rows + 16 blocks), as views."""
    blocks = flat[..., cones.rows :]
    shape = (*flat.shape[:-1], len(cones.weight), ORDER, ORDER)
    return flat[..., : cones.rows], blocks.reshape(*shape)


def _inverse_roots(blocks: Array) -> Array:
    """Return L^-1 of S = L L^T for matrices S (k, blocks, 4, 4) of k points. If one block
    of a point is not positive definite, all of its blocks are NaN."""
    try:
        return np.linalg.inv(np.linalg.cholesky(blocks))
    except np.linalg.LinAlgError:
        inverse_roots = np.full_like(blocks, np.nan)
        for k, of_point in enumerate(blocks):
            with suppress(np.linalg.LinAlgError):
                inverse_roots[k] = np.linalg.inv(np.linalg.cholesky(of_point))
        return inverse_roots


def _solve(factors: Sequence[Array | None], right_sides: Array) -> Array:
    """Solve H x = b for k right sides b (k, p), by the Cholesky factor of each H; NaN
    where there is none."""
    solutions = np.full_like(right_sides, np.nan)
    for k, factor in enumerate(factors):
        if factor is not None:
            b = right_sides[k]
            solutions[k] = scipy.linalg.lapack.dpotrs(factor, b, lower=1)[0]
    return solutions


def _dot(a: Array, b: Array) -> Array:
    """Return the scalar product (k,) of each row of a with that of b, both (k, p)."""
    return np.einsum("kp,kp->k", a, b)


@dataclass(frozen=True)
class _Direction:
    """Changes of everything along a Newton step, for k functions."""

    #: (k, p) change of theta.
    step: Array
    #: (k, rows + 16 blocks) change of the slacks.
    slacks: Array
    #: (k, rows + 16 blocks) change of the multipliers.
    multipliers: Array
    #: (k,) first-order change of the ball's slack, -v^T step.
    ball_slack: Array
    #: (k,) the negative of its second-order change, |A step|^2.
    ball_slack_bend: Array
    #: (k,) change of the ball's multiplier.
    ball_multiplier: Array


class _Newton:
    """Newton's systems for k functions, each at its point with multipliers."""

    def __init__(self, method: InteriorPoint, points: Points) -> None:
        """Factorise the Newton matrix H of each function, and slacks and multipliers,
        which have to stay positive."""
        self.cones = method.cones
        self.A = method.ball.A
        self.points = points
        self.state = state = _State(
            method.cones, method.ball, points.squared_radius, points.theta
        )
        self.factors = state.hessian_factors(
            method.data_curvature, points.multipliers, points.ball_multiplier
        )
        z, Z = split(self.cones, points.multipliers)
        #: (k, 2 rows) slacks s and multipliers z of the rows.
        self.slacks_and_multipliers = np.hstack([state.rows, z])
        #: (k, 2 blocks, 4, 4) inverse Cholesky factors of slacks S and multipliers Z.
        self.inverse_roots = np.hstack([state.inverse_roots, _inverse_roots(Z)])

    def apply_hessian(self, step: Array) -> Array:
        """Return H step (k, p) for steps (k, p), computed from slacks and torque: the
        data's part has no rounding error where no torque shows the step."""
        state = self.state
        ball_multiplier = self.points.ball_multiplier
        slacks = (self.cones.slack_map @ step.T).T
        response = state.multiplier_response(slacks, self.points.multipliers)
        by_cones = (self.cones.adjoint @ response.T).T
        by_curvature = (2.0 * ball_multiplier)[:, None] * ((step @ self.A.T) @ self.A)
        along_v = _dot(state.ball_gradient, step)
        weight = ball_multiplier / state.ball_slack * along_v
        return by_cones + (by_curvature + weight[:, None] * state.ball_gradient)

    def direction(
        self,
        mu: Array,
        second_order: Array | float = 0.0,
        second_order_ball: Array | float = 0.0,
        refined: bool = False,
    ) -> _Direction:
        """Return the Newton step towards s z = mu, S Z = mu 1 and l s = mu.

        Parameters
        ----------
        mu : (k,) array
            Complementarity that each function's step aims at.
        second_order, second_order_ball : (k, rows + 16 blocks), (k,) arrays
            Second-order terms of the predictor, subtracted from the multipliers that
            cones and ball should have.
        refined : bool
            Solve once more for what rounding has left of the first solution.
        """
        state = self.state
        points = self.points
        target = state.barrier_multipliers(mu) - second_order
        target_of_ball = mu / state.ball_slack - second_order_ball
        slope = points.g + target_of_ball[:, None] * state.ball_gradient
        right_side = (self.cones.adjoint @ target.T).T - slope
        step = _solve(self.factors, right_side)
        if refined:
            step = step + _solve(self.factors, right_side - self.apply_hessian(step))
        slacks = (self.cones.slack_map @ step.T).T
        ball_slack = -_dot(state.ball_gradient, step)
        torque = step @ self.A.T
        response = state.multiplier_response(slacks, points.multipliers)
        response_of_ball = points.ball_multiplier * ball_slack / state.ball_slack
        return _Direction(
            step,
            slacks=slacks,
            multipliers=target - points.multipliers - response,
            ball_slack=ball_slack,
            ball_slack_bend=_dot(torque, torque),
            ball_multiplier=target_of_ball - points.ball_multiplier - response_of_ball,
        )

    def complementarity(
        self, direction: _Direction | None = None, share: Array | float = 0.0
    ) -> Array:
        """Return the sum (k,) of all products of slacks and multipliers, l s of the ball
        included: at the points, or after shares (k,) of a direction."""
        state = self.state
        slacks, z = state.slacks, self.points.multipliers
        ball_slack, ball_multiplier = state.ball_slack, self.points.ball_multiplier
        if direction is not None:
            t = np.asarray(share)[:, None]
            slacks = slacks + t * direction.slacks
            z = z + t * direction.multipliers
            bend = share**2 * direction.ball_slack_bend
            ball_slack = ball_slack + share * direction.ball_slack - bend
            ball_multiplier = ball_multiplier + share * direction.ball_multiplier
        return _dot(slacks, z) + ball_slack * ball_multiplier

    def longest_step(self, direction: _Direction) -> Array:
        """Return the largest multiple (k,) of a direction at which no slack or multiplier
        of cones and ball is negative.

        A number x > 0 with the change dx reaches zero at the multiple -1 / (dx / x), a
        block X = L L^T at -1 over the smallest eigenvalue of L^-1 dX L^-T.
        """
        ds, dS = split(self.cones, direction.slacks)
        dz, dZ = split(self.cones, direction.multipliers)
        # Where everything grows, -1e-12 stands for a multiple without limit.
        relative = np.hstack([ds, dz]) / self.slacks_and_multipliers
        lowest = relative.min(axis=1, initial=-1e-12)
        of_ball = direction.ball_multiplier / self.points.ball_multiplier
        roots = self.inverse_roots
        relative_blocks = roots @ np.hstack([dS, dZ]) @ np.swapaxes(roots, 2, 3)
        is_finite = np.isfinite(relative_blocks).all(axis=(1, 2, 3))
        relative_blocks[~is_finite] = -np.eye(ORDER)
        eigenvalues = np.linalg.eigvalsh(relative_blocks)[:, :, 0]
        lowest_of_blocks = eigenvalues.min(axis=1, initial=-1e-12)
        lowest = np.minimum(np.minimum(lowest, of_ball), lowest_of_blocks)
        # The ball: slack + t change - t^2 bend = 0, without cancellation.
        slack, change = self.state.ball_slack, direction.ball_slack
        root = np.sqrt(change**2 + 4.0 * direction.ball_slack_bend * slack)
        to_ball = 2.0 * slack / np.maximum(root - change, 1e-300)
        return np.minimum(-1.0 / lowest, to_ball)

    def corrected_direction(self, degree: int) -> tuple[_Direction, Array]:
        """Return Mehrotra's direction, and which multiple (k,) of it to go.

        The predictor (mu = 0) shows how far one can go, and what share of the
        complementarity remains there. The corrector aims at a power of this share, with
        the predictor's second-order terms. ``degree`` is the number of products in the
        complementarity.
        """
        ball_multiplier, state = self.points.ball_multiplier, self.state
        before = self.complementarity()
        predictor = self.direction(np.zeros_like(before))
        reach = np.minimum(1.0, _HIGHEST_SHARE * self.longest_step(predictor))
        remaining = np.maximum(self.complementarity(predictor, reach) / before, 0.0)
        # Up to Mehrotra's cube, where the predictor goes nearly all the way.
        power = np.maximum(1.0, 3.0 * reach**2)
        centring = np.clip(remaining**power, 1e-7, 1.0)
        second_order = state.multiplier_response(
            predictor.slacks, predictor.multipliers
        )
        second_order_ball = (
            predictor.ball_slack * predictor.ball_multiplier
            - ball_multiplier * predictor.ball_slack_bend
        ) / state.ball_slack
        mu = centring * before / degree
        direction = self.direction(mu, second_order, second_order_ball, refined=True)
        share = _LOWEST_SHARE + (_HIGHEST_SHARE - _LOWEST_SHARE) * reach**2
        return direction, np.minimum(1.0, share * self.longest_step(direction))


class InteriorPoint:
    """The least values of linear functions over the same cones and balls about the same
    torque."""

    def __init__(
        self, cones: SmallCones, ball: Ball, start: Array, fit: Array, bound: Array
    ) -> None:
        """Find the analytic centre of the cones and the ball of radius 1, from which all
        functions start. Raises LinAlgError unless ``start`` is strictly inside of both.

        Parameters
        ----------
        start : (p,) array
            Point from which the centre is sought.
        fit : (p,) array
            Point inside of the cones and of every ball that will be asked for.
        bound : (p,) array
            Bounds |theta_k| <= bound_k that hold in the cones.
        """
        self.cones = cones
        self.ball = ball
        self.fit = fit
        self.bound = bound
        #: (p, p) 2 A^T A.
        self.data_curvature = 2.0 * ball.A.T @ ball.A
        #: Number of products of slacks and multipliers: rows, eigenvalues, the ball.
        self.degree = cones.rows + ORDER * len(cones.weight) + 1
        #: (p,) point of the largest product of all slacks, nearly; and the lower Cholesky
        #: factor (p, p) of the barrier's Hessian there.
        self.centre, self._barrier_factor = self._find_centre(start)

    def _find_centre(self, start: Array) -> tuple[Array, Array]:
        """Return the analytic centre (p,) by damped Newton steps, and the lower Cholesky
        factor (p, p) of the barrier's Hessian there."""
        mu = squared_radius = np.ones(1)
        theta = start[None]
        for _ in range(_STEPS):
            state = _State(self.cones, self.ball, squared_radius, theta)
            multipliers = state.barrier_multipliers(mu)
            ball_multiplier = mu / state.ball_slack
            (factor,) = state.hessian_factors(
                self.data_curvature, multipliers, ball_multiplier
            )
            if factor is None:
                raise np.linalg.LinAlgError
            descent = (self.cones.adjoint @ multipliers.T).T
            descent -= ball_multiplier[:, None] * state.ball_gradient
            step = _solve([factor], descent)
            decrement = np.sqrt(max(_dot(step, descent)[0], 0.0))
            if decrement < _CENTRAL:
                break
            theta = theta + step / (1.0 + decrement)
        assert factor is not None
        return state.theta[0], factor

    def minimise(
        self,
        h: Array,
        accuracy: float,
        *,
        m: Array | None = None,
        start: Points | None = None,
        squared_radius: Array | float = 1.0,
        first_step: float = 0.7,
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
        first_step : float
            Local length of the first step away from the analytic centre.
        """
        m = np.zeros_like(h) if m is None else m
        g = _without_ratio(h, m, np.tile(self.centre, (len(h), 1)))
        tangent = _solve([self._barrier_factor] * len(h), g)
        size = np.sqrt(np.maximum(_dot(g, tangent), 0.0))  # in the barrier's metric
        if start is None:
            start = self._start_along(g, tangent, mu=size / first_step)
        points = self._moved_into_balls(
            start, np.broadcast_to(squared_radius, size.shape)
        )
        best = points
        best.error[size == 0.0] = 0.0
        active = np.flatnonzero(size > 0.0)
        points = points[active]
        # Values that are not finite end the search for their function alone.
        with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
            for _ in range(_STEPS):
                if not len(active):
                    break
                points.g[:] = _without_ratio(h[active], m[active], points.theta)
                newton = _Newton(self, points)
                direction, share = newton.corrected_direction(self.degree)
                points = _advanced(points, direction, share)
                local_error, points.error[:] = self._errors(points, newton.factors)
                is_better = points.error < best.error[active]
                best.put(active[is_better], points[is_better])
                is_done = local_error <= accuracy * size[active]
                goes_on = (share > _SHORTEST) & ~is_done
                active, points = active[goes_on], points[goes_on]
        return best

    def _start_along(self, g: Array, tangent: Array, mu: Array) -> Points:
        """Return points at the start of the central paths, with multipliers mu / s.

        They are centre - tangent / mu, or the centre where that is outside of the cones
        or of the ball of radius 1. g and tangent = H^-1 g are (k, p), mu is (k,).
        """
        step = np.divide(
            tangent, mu[:, None], out=np.zeros_like(g), where=mu[:, None] > 0.0
        )
        theta = self.centre - step
        squared_radius = np.ones(len(theta))
        state = _State(self.cones, self.ball, squared_radius, theta)
        is_outside = ~state.is_inside
        if is_outside.any():
            theta = np.where(is_outside[:, None], self.centre, theta)
            state = _State(self.cones, self.ball, squared_radius, theta)
        return Points(
            g,
            squared_radius,
            theta,
            multipliers=state.barrier_multipliers(mu),
            ball_multiplier=mu / state.ball_slack,
            error=np.full_like(mu, np.inf),
        )

    def _moved_into_balls(self, points: Points, squared_radius: Array) -> Points:
        """Return copies of points for balls of other radii, (k,) squared.

        Where a ball shrinks, its point moves on the line to the best fit, which is inside
        of every ball. It gets the slack that it had in the old ball, or half of the best
        fit's slack in the new one if that is less. Other points stay.
        """
        ball = self.ball
        # On the line theta = fit + t (point - fit): residual = at_fit + t away.
        at_fit = ball.A @ self.fit - ball.a
        away = (points.theta - self.fit) @ ball.A.T
        old_slack = points.squared_radius - np.sum((away + at_fit) ** 2, axis=1)
        room = squared_radius - at_fit @ at_fit
        # |at_fit + t away|^2 = squared_radius - slack, solved for t without cancellation.
        c = room - np.minimum(old_slack, 0.5 * room)
        b, a = away @ at_fit, _dot(away, away)
        t = c / np.maximum(b + np.sqrt(b**2 + a * c), 1e-300)
        shrinks = squared_radius < points.squared_radius
        t = np.where(shrinks, np.minimum(t, 1.0), 1.0)
        return Points(
            points.g.copy(),
            squared_radius.copy(),
            theta=self.fit + t[:, None] * (points.theta - self.fit),
            multipliers=points.multipliers.copy(),
            ball_multiplier=points.ball_multiplier.copy(),
            error=np.full_like(t, np.inf),
        )

    def _errors(
        self, points: Points, factors: Sequence[Array | None]
    ) -> tuple[Array, Array]:
        """Return by how much (k,) the value at each point may exceed the least one: to
        second order about the point, and certainly.

        Both are the sum of slacks times multipliers, plus what the leftover slope d (the
        gradient of the Lagrangian, zero at an optimum) can gain: d^T H^-1 d by a Newton
        step, with the ``factors`` of H; |d|^T bound anywhere in the cones. Infinite for a
        point outside of cones or ball.
        """
        cones, ball = self.cones, self.ball
        slacks = cones.constant + (cones.slack_map @ points.theta.T).T
        residual = points.theta @ ball.A.T - ball.a
        ball_slack = points.squared_radius - np.sum(residual**2, axis=1)
        leftover = points.g + (2.0 * points.ball_multiplier)[:, None] * (
            residual @ ball.A
        )
        leftover -= (cones.adjoint @ points.multipliers.T).T
        sums = _dot(slacks, points.multipliers) + points.ball_multiplier * ball_slack
        local = sums + np.abs(_dot(leftover, _solve(factors, leftover)))
        certain = sums + np.abs(leftover) @ self.bound
        is_inside = (slacks[:, : cones.rows] > 0.0).all(axis=1) & (ball_slack > 0.0)
        is_inside &= np.isfinite(local)
        return np.where(is_inside, local, np.inf), np.where(is_inside, certain, np.inf)


def _advanced(points: Points, direction: _Direction, share: Array) -> Points:
    """Return the points, with their multipliers, after shares (k,) of a direction."""
    t = share[:, None]
    return Points(
        points.g,
        points.squared_radius,
        theta=points.theta + t * direction.step,
        multipliers=points.multipliers + t * direction.multipliers,
        ball_multiplier=points.ball_multiplier + share * direction.ball_multiplier,
        error=points.error,
    )


def _without_ratio(h: Array, m: Array, theta: Array) -> Array:
    """Return g = h - v m (k, p) with the ratio v = h^T theta / m^T theta at each point
    theta (k, p); g = h where m = 0.

    Where g has a negative value the ratio is below v (Dinkelbach).
    """
    mass = _dot(m, theta)
    v = np.divide(_dot(h, theta), mass, out=np.zeros_like(mass), where=mass != 0.0)
    return h - v[:, None] * m
