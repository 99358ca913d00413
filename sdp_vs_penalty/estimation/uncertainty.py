"""What the data determine, and how well: intervals for parameters and a band for
torques.

Intervals come from the runs that a model was identified from: the :class:`Sandwich`
holds what noise of any colour and the model's own errors do to least squares, the
columns of shapes.py what the shape constants' errors do. Standard deviations are
half-widths of 95 % intervals over 1.96. Where an estimate satisfies constraints its
intervals are cut to the physical range of the parameter and extended to the value where
constraints have moved it out.

In coordinates z of the visible directions, theta = V z with V' (R' W^2 R) V = 1, c'
theta errs by w' sum_b g_b, w = V' c, with the block scores g_b = V' R_b' W^2 (rho_b -
R_b theta_hat). Its variance is estimated by

    v = sum_ab K_ab (w' g_a) (w' g_b),     K_ab = max(0, 1 - |t_a - t_b| / window) within a run

(Newey, West, Econometrica 1987). theta_hat takes part of the error with it: were the
error white with variance s^2, then E v = s^2 tr(K G) with G_ab = [a = b] w' A_a w - w'
A_a A_b w, A_b the blocks' grams. v is divided by tr(K G), and counts for tr(K G)^2 /
tr(K G K G) degrees of freedom (Bell, McCaffrey, Survey Methodology 2002), so that
quantiles are Student's. The window is a multiple of the correlation time by which the
scores exceed white noise. What all directions say together counts for three degrees of
freedom more, which keeps short runs finite (a moderated t: Smyth 2004).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from sdp_vs_penalty.effects.model import JointColumns
from sdp_vs_penalty.estimation.constants import LEVEL, NORMAL_95, POOLED, WIDTHS, WINDOW
from sdp_vs_penalty.estimation.sensitivity import ON_A_GRID
from sdp_vs_penalty.estimators.estimator import Task, white_variance
from sdp_vs_penalty.files import JsonRecord
from sdp_vs_penalty.regression.base_parameters import BaseParameters
from sdp_vs_penalty.regression.linalg import column_space, min_norm_lstsq
from sdp_vs_penalty.regression.regression import Regression
from sdp_vs_penalty.robot.arrays import Array


class Sandwich:
    """The sandwich of weighted least squares on compressed data.

    prior_scale : (p,) standard deviations of parameters that are known beforehand to be
    zero, infinite for all others; taken_white : the blocks are not asked.

    directions V (p, r); grams (B, r, r) and scores (B, r) of the blocks in these
    coordinates; kernel (B, B): how far blocks' errors are one error; white: variance of
    white rows, and pooled: that all directions say together; prior (r, r): part of the
    information that is no data's; norms (p,): of the columns; solution (p,): the
    smallest least-squares theta.
    """

    def __init__(
        self,
        regression: Regression,
        weights: Array,
        prior_scale: Array,
        taken_white: bool = False,
    ) -> None:
        self.regression = regression
        self.weights = weights
        self.taken_white = taken_white
        data = regression.least_squares(weights)
        self.white = white_variance(data, regression.oversampling)
        # Where the torque is fitted to rounding, a prior weighs that much and no less.
        strength = max(self.white, 1e-24 * data.tau_squared / max(data.rows, 1))
        factor_rows = (
            data.with_prior(prior_scale, strength)
            if np.any(np.isfinite(prior_scale))
            else data
        )
        self.directions = V = column_space(factor_rows.R)[1]
        z = V.T @ (factor_rows.R.T @ factor_rows.rho)
        B = len(regression.blocks)
        r = V.shape[1]
        self.grams = np.zeros((B, r, r))
        self.scores = np.zeros((B, r))
        for joint, indices, blocks, rows in regression.by_joint():
            visible_rows = rows[..., :-1] @ (weights[joint] * V[indices])
            left = weights[joint] * rows[..., -1] - visible_rows @ z
            self.grams[blocks] += visible_rows.swapaxes(1, 2) @ visible_rows
            self.scores[blocks] += (left[:, None] @ visible_rows)[:, 0]
        traces = np.trace(self.grams, axis1=1, axis2=2)
        excess = float(np.sum(traces) - np.sum(self.grams**2))
        inflation = 1.0
        if excess > 1e-6 * r and self.white > 0.0:
            inflation = float(np.sum(self.scores**2)) / excess / self.white
        self.pooled = inflation * self.white
        self.kernel = _kernel(regression, inflation)
        self.prior = V.T * (strength / prior_scale**2) @ V
        self.norms = factor_rows.column_norms
        self.solution = V @ z
        # Of the visible directions, at unit norm.
        self._basis = np.linalg.qr(V * self.norms[:, None])[0]

    def sees(self, contrasts: Array) -> NDArray[np.bool_]:
        """Whether the data determine linear functions of theta.

        Parameters
        ----------
        contrasts : (k, p) array
            The functions.

        Returns
        -------
        (k,) array of bool
            One each.
        """
        norms = self.norms
        dark = self.norms <= 0.0
        scaled = contrasts / np.where(dark, 1.0, norms)
        total = np.sum(scaled**2, axis=1)
        hidden = np.any(np.abs(contrasts[:, dark]) > 0.0, axis=1)
        inside = np.sum((scaled @ self._basis) ** 2, axis=1)
        # A linear function of theta belongs to the visible ones up to this much of its
        # square.
        return np.asarray((inside > (1.0 - 1e-6) * total) & ~hidden & (total > 0.0))

    def half_widths(self, contrasts: Array) -> Array:
        """Half-widths of the intervals of linear functions of theta.

        Parameters
        ----------
        contrasts : (k, p) array
            The functions; with fewer columns, of the first parameters alone.

        Returns
        -------
        (k,) array
            At LEVEL; NaN where the data do not determine the function.
        """
        contrasts = np.pad(
            contrasts, ((0, 0), (0, len(self.norms) - contrasts.shape[1]))
        )
        half = np.full(len(contrasts), np.nan)
        is_determined = np.flatnonzero(self.sees(contrasts))
        # Numbers of the products of blocks that are held at once.
        for chunk in np.array_split(
            is_determined,
            1 + is_determined.size * self.directions.shape[1] ** 2 // (1 << 20),
        ):
            w = contrasts[chunk] @ self.directions
            variance, freedom = self._variances(w)
            known = self.white * np.sum((w @ self.prior) * w, axis=1)
            t = scipy.special.stdtrit(freedom, 0.5 + 0.5 * LEVEL)
            normal = scipy.special.stdtrit(np.inf, 0.5 + 0.5 * LEVEL)
            half[chunk] = np.sqrt(t**2 * variance + normal**2 * known)
        return half

    def _variances(self, w: Array) -> tuple[Array, Array]:
        """Of each w' z, w (c, r): variance from the data (c,), and degrees of freedom
        (c,)."""
        if self.taken_white:
            prior = np.sum((w @ self.prior) * w, axis=1)
            return self.white * (np.sum(w * w, axis=1) - prior), np.full(len(w), np.inf)
        K = self.kernel
        n_blocks, r = self.scores.shape
        AB = np.moveaxis(self.grams @ w.T, 2, 0)  # (c, B, r)
        h = w @ self.scores.T  # (c, B)
        variances = np.maximum(np.einsum("cbr,cr->cb", AB, w), 0.0)
        by_block = np.moveaxis(AB, 1, 0).reshape(n_blocks, -1)
        KAB = np.moveaxis(
            (K @ by_block).reshape(n_blocks, len(w), r),
            1,
            0,
        )
        # tr (K G)^2 of G's second part, by the smaller of (A B)'K A B and K A B (A B)'.
        transposed = np.swapaxes(AB, 1, 2)
        M = transposed @ KAB if r < n_blocks else KAB @ transposed
        information = variances.sum(axis=1)
        expected = information - np.trace(M, axis1=1, axis2=2)
        square = np.sum(variances * (K.power(2) @ variances.T).T, axis=1)
        square += np.sum(M * M.swapaxes(1, 2), axis=(1, 2))
        square -= 2.0 * np.sum(variances * np.sum(KAB**2, axis=2), axis=1)
        estimates = np.maximum(np.sum(h * (K @ h.T).T, axis=1), 0.0)
        is_shown = (expected > 1e-6 * information) & (square > 0.0)
        safe = np.where(is_shown, expected, 1.0)
        safe_square = np.where(is_shown, square, 1.0)
        freedom = np.where(is_shown, safe**2 / safe_square, 0.0)
        of_data = freedom * estimates / safe
        moderated = (POOLED * self.pooled + of_data) / (POOLED + freedom)
        return moderated * information, freedom + POOLED

    @cached_property
    def factor(self) -> Array:
        """(p, r) F with the covariance of everything visible F F'.

        The blocks' own products are few: they are shrunk to the pooled variance, by as
        much as there are more directions than independent windows.
        """
        B, r = self.scores.shape
        flat = self.grams.reshape(B, -1)
        lost = float(np.sum((self.kernel @ flat) * flat))
        data = r - float(np.trace(self.prior))
        windows = B**2 / max(float(self.kernel.sum()), 1.0)
        meat = self.pooled * np.eye(r)
        if data - lost > 1e-6 * data:
            products = (
                self.scores.T @ (self.kernel @ self.scores) * (data / (data - lost))
            )
            share = r / (r + windows)
            meat = share * meat + (1.0 - share) * products
        values, vectors = np.linalg.eigh(meat)
        return np.asarray(
            self.directions @ (vectors * np.sqrt(np.maximum(values, 0.0)))
        )

    def response(self, torques: Sequence[Array]) -> Array:
        """Change of the estimate with the torque.

        Parameters
        ----------
        torques : sequence of (r, e) arrays
            e changes of the torque, in the rows of each factor's triangle.

        Returns
        -------
        (p, e) array
            Changes of theta.
        """
        moved = np.zeros(
            (self.directions.shape[1], torques[0].shape[1] if torques else 0)
        )
        for f, torque in zip(self.regression.factors, torques, strict=True):
            weighted = (
                self.weights[f.joint] ** 2
                * f.triangle[:, :-1]
                @ self.directions[f.indices]
            )
            moved += weighted.T @ torque
        return np.asarray(self.directions @ moved)

    def gain_response(self, theta: Array) -> Array:
        """Change of the estimate with the torque channels' gains.

        Parameters
        ----------
        theta : (p,) array
            The estimate.

        Returns
        -------
        (p, n) array
            For a unit relative error of each gain.
        """
        theta = np.pad(theta, (0, len(self.norms) - len(theta)))
        torque_by_joint = (
            (f, f.triangle[:, :-1] @ theta[f.indices]) for f in self.regression.factors
        )
        identity = np.eye(self.regression.joints)
        return self.response(
            [np.outer(torque, identity[f.joint]) for f, torque in torque_by_joint]
        )


def stretched(factor: Array, std: Array) -> Array:
    """Rows of a factor as long as deviations; where these are NaN, longer by the median
    ratio.

    Parameters
    ----------
    factor : (p, r) array
        Of a covariance.
    std : (p,) array
        Standard deviations.

    Returns
    -------
    (p, r) array
        The new factor.
    """
    length = np.linalg.norm(factor, axis=1)
    known = np.isfinite(std) & (length > 0.0)
    ratio = np.where(known, std, 1.0) / np.where(known, length, 1.0)
    typical = float(np.median(ratio[known])) if known.any() else 1.0
    return np.asarray(factor * np.where(known, ratio, typical)[:, None])


def _kernel(regression: Regression, inflation: float) -> scipy.sparse.csr_array:
    """(B, B) the triangular window over the blocks of each run, at most half a run
    long."""
    runs, starts, stops = np.array(regression.blocks, float).reshape(-1, 3).T
    rows = max(int(regression.joint_rows().max(initial=0)), 1)
    # Scores of noise with the correlation time T have 2 T / interval times the variance
    # of white rows.
    interval = float(np.sum(stops - starts)) * regression.oversampling / rows
    window = WINDOW * 0.5 * max(inflation, 1.0) * interval
    parts = []
    for run in np.unique(runs):
        start = starts[runs == run]
        stop = stops[runs == run]
        middle = 0.5 * (start + stop)
        length = min(window, 0.5 * float(stop.max() - start.min()))
        apart = np.abs(np.subtract.outer(middle, middle))
        parts.append(
            np.maximum(1.0 - apart / length, 0.0)
            if length > 0.0
            else np.eye(len(middle))
        )
    return (
        scipy.sparse.csr_array(scipy.sparse.block_diag(parts))
        if parts
        else scipy.sparse.csr_array((0, 0))
    )


NOT_SEEN = "not seen"


@dataclass(frozen=True)
class Interval(JsonRecord):
    """One standard or base parameter: its estimate, what the data say of it, and a
    verdict.

    value : of the model; std : standard deviation, NaN where the data do not determine
    the parameter; lower, upper : ends of the 95 % interval, infinite there. verdict :
    "identifiable" (half-width up to a quarter of the value), "weakly" (up to the
    value), or "not seen"; half-widths up to 0.25 % and 10 % of the largest value that
    the problem's bounds or the measured torque allow count as well.
    """

    name: str
    unit: str
    value: float
    std: float = np.nan
    lower: float = -np.inf
    upper: float = np.inf
    verdict: str = NOT_SEEN


def counts(intervals: Sequence[Interval]) -> dict[str, int]:
    """How many of each verdict.

    Parameters
    ----------
    intervals : sequence of Interval
        Of parameters.

    Returns
    -------
    dict of str to int
        By verdict.
    """
    verdicts = [i.verdict for i in intervals]
    return {verdict: verdicts.count(verdict) for verdict in (*WIDTHS, NOT_SEEN)}


#: No parameter of an arm is as large in any unit.
_LARGEST = 1e100


@dataclass(frozen=True)
class Uncertainty(JsonRecord):
    """standard : all parameters of the model; base : the combinations that make torque.

    spread (p, r) : a factor of the covariance of everything that the data show;
    gain_response (p, n) : change of the parameters for a unit relative error of each
    torque channel's gain, and gain_errors (n, e), a factor of the covariance of these
    errors, which the covariance holds as well; torque_noise (n,) : standard deviation
    of the torque that the model leaves [N m, N]. Raises ValueError for arrays that do
    not belong together.
    """

    standard: tuple[Interval, ...]
    base: tuple[Interval, ...]
    spread: Array
    gain_response: Array
    torque_noise: Array
    gain_errors: Array

    def __post_init__(self) -> None:
        p = len(self.standard)
        n = len(self.torque_noise)
        shapes = (
            self.spread.shape[:1],
            self.gain_response.shape,
            self.gain_errors.shape[:1],
        )
        if shapes != ((p,), (p, n), (n,)):
            raise ValueError("uncertainty: arrays of other parameters or joints")
        for name in ("spread", "gain_response", "torque_noise", "gain_errors"):
            # Their squares are the covariance.
            if np.any(np.abs(getattr(self, name)) > _LARGEST):
                raise ValueError(f"uncertainty: {name} beyond {_LARGEST:g}")

    @cached_property
    def factor(self) -> Array:
        """(p, r + e) with the covariance factor factor': rows as long as the standard
        deviations, which Student's quantile has made larger."""
        return stretched(
            np.hstack([self.spread, self.gain_response @ self.gain_errors]), self.std
        )

    @cached_property
    def std(self) -> Array:
        """(p,) standard deviations; NaN where the data do not determine a parameter."""
        return np.array([i.std for i in self.standard])

    @cached_property
    def covariance(self) -> Array:
        """(p, p); NaN rows and columns for parameters that the data do not determine."""
        out = self.factor @ self.factor.T
        unseen = np.isnan(self.std)
        out[unseen] = out[:, unseen] = np.nan
        return out

    def with_gain_errors(self, errors: Array, base: Array) -> Uncertainty:
        """The intervals where the gains are known otherwise than they were.

        Parameters
        ----------
        errors : (n, e) array
            Factor of the covariance of the gains' relative errors.
        base : (b, p) array
            Rows of the base parameters.

        Returns
        -------
        Uncertainty
            With wider or narrower intervals; a lower end at zero is a bound and stays.
        """

        def widened(
            intervals: tuple[Interval, ...], response: Array
        ) -> tuple[Interval, ...]:
            known = np.sum((response @ self.gain_errors) ** 2, axis=1)
            new = np.sum((response @ errors) ** 2, axis=1)
            out = []
            for i, extra in zip(
                intervals,
                np.sqrt(np.maximum(new - known, 0.0)).tolist(),
                strict=True,
            ):
                std = float(np.hypot(i.std, extra))
                more = NORMAL_95 * (std - i.std)
                lower = i.lower if i.lower == 0.0 else i.lower - more
                out.append(
                    replace(
                        i,
                        std=std,
                        lower=lower,
                        upper=i.upper + more,
                    )
                )
            return tuple(out)

        combined = widened(self.base, base @ self.gain_response) if self.base else ()
        standard = widened(self.standard, self.gain_response)
        return replace(self, standard=standard, base=combined, gain_errors=errors)

    def band(
        self,
        theta: Array,
        columns: Sequence[JointColumns],
    ) -> tuple[Array, Array]:
        """Modelled torque and its standard deviation, without the noise.

        Parameters
        ----------
        theta : (p,) array
            The estimate.
        columns : sequence of n JointColumns
            Of N instants.

        Returns
        -------
        (N, n) array
            Torque [N m, N].
        (N, n) array
            Standard deviation.
        """
        count = len(columns[0].columns)
        torque, std = np.empty((2, count, len(columns)))
        for j, block in enumerate(columns):
            torque[:, j] = block.columns @ theta[block.indices]
            std[:, j] = np.linalg.norm(
                block.columns @ self.factor[block.indices], axis=1
            )
        return torque, std

    def to_dict(self) -> dict[str, Any]:
        """What model.json holds beside the parameters' own intervals."""
        return {"level": LEVEL} | {
            k: x for k, x in super().to_dict().items() if k != "standard"
        }


def _sandwich_of(
    task: Task,
    regression: Regression,
    white: bool = False,
) -> Sandwich:
    """Of a task's data, in its columns and maybe those of shape constants behind them:
    without constants on a grid that the data do not contradict, since such a value is
    taken for the true one."""
    # A shape constant has a standard normal prior.
    scale = np.append(task.model.plausible, np.ones(regression.p - len(task.bound)))
    known = Sandwich(regression, task.weights, scale, white)
    agrees = np.array([q.effect == ON_A_GRID for q in regression.parameters])
    if agrees.any():
        half = known.half_widths(np.eye(regression.p)[agrees])
        agrees[agrees] = np.abs(known.solution[agrees]) <= half
    if agrees.any():
        return Sandwich(
            regression.keeping(~agrees),
            task.weights,
            scale[~agrees],
            white,
        )
    return known


def of_regression(
    task: Task,
    own_regression: Regression,
    base: BaseParameters,
    theta: Array | None = None,
    *,
    wide: Regression | None = None,
    constrained: bool = False,
    gain_errors: Array | None = None,
    white: bool = False,
    known: Sandwich | None = None,
    gains: Array | None = None,
    extra: Array | None = None,
) -> Uncertainty:
    """Intervals from compressed data.

    Parameters
    ----------
    task : Task
        What was solved.
    own_regression : Regression
        From which data.
    base : BaseParameters
        Combinations that make torque.
    theta : (p,) array, optional
        The estimate; default: least squares next to the nominal robot.
    wide : Regression, optional
        The data in the columns of the model with :func:`with_sensitivities`.
    constrained : bool
        Whether theta satisfies the problem's constraints, and intervals are to.
    gain_errors : (n, e) array, optional
        A factor of the covariance of the relative errors of the torque channels' gains.
    white : bool
        Take the residual for white noise: what the motion alone would show.
    known : Sandwich, optional
        Of these data, where it has been worked out.
    gains : (p, n) array, optional
        Its response to the gains.
    extra : (p, e) array, optional
        A factor of the covariance of an error that is known beside.

    Returns
    -------
    Uncertainty
        Intervals and covariance.
    """
    p = len(task.bound)
    n = own_regression.joints
    value = task.ols if theta is None else np.asarray(theta, float)
    known = known or _sandwich_of(task, wide or own_regression, white)
    if gain_errors is None:
        gain_errors = np.zeros((n, 0))
    if gains is None:
        gains = known.gain_response(value)[:p]
    if extra is None:
        extra = np.zeros((p, 0))
    intervals = _Intervals(
        task=task,
        value=value,
        known=known,
        ends=_allowed(task) if constrained else np.outer([-np.inf, np.inf], np.ones(p)),
        extra=extra,
        gains=gains,
        gain_errors=gain_errors,
    )
    names = [q.name for q in task.model.parameters]
    standard = BaseParameters(
        np.eye(p),
        names,
        list(range(p)),
    )
    mean_squares = own_regression.joint_losses(value) / np.maximum(
        own_regression.joint_rows(), 1
    )
    return Uncertainty(
        standard=intervals.of(standard),
        base=intervals.of(base),
        spread=np.hstack([known.factor[:p], extra]),
        gain_response=gains,
        torque_noise=np.sqrt(mean_squares),
        gain_errors=gain_errors,
    )


def _allowed(task: Task) -> Array:
    """(2, p) what physics and bounds allow of each parameter: masses and moments of
    inertia are not negative, nor is friction."""
    low = np.maximum(-task.bound, [q.lower for q in task.model.parameters])
    low[task.links[:, 0]] = task.box[: len(task.links), 0, 0]
    for body in task.constraints.convex:
        if body.family == "pseudo-inertia":
            diagonal = body.indices[[0, 4, 6, 9]]
            low[diagonal] = np.maximum(low[diagonal], 0.0)
    return np.stack([low, task.bound])


@dataclass(frozen=True)
class _Intervals:
    """What intervals of linear functions of theta are made of.

    value (p,) : the estimate; ends (2, p) : what is allowed of each parameter; extra
    (p, e), gains (p, n) and gain_errors (n, e) : errors that are no noise, as of
    :func:`of_regression`.
    """

    task: Task
    value: Array
    known: Sandwich
    ends: Array
    extra: Array
    gains: Array
    gain_errors: Array

    @cached_property
    def _offset(self) -> Array:
        """(p,) what one step to the least loss changes: constants that stay on a grid,
        or were given, are not there."""
        p = len(self.task.bound)
        if self.known.regression.p <= p:
            return np.zeros(p)
        data = self.task.data
        return self.known.solution[:p] - min_norm_lstsq(data.R, data.rho)

    @cached_property
    def _largest(self) -> Array:
        """(p,) the largest value that bounds or the measured torque allow."""
        data = self.task.data
        norms = np.where(
            data.column_norms > 0.0,
            data.column_norms,
            np.nan,
        )
        return np.fmin(self.task.bound, np.sqrt(data.tau_squared) / norms)

    def _ends_of(self, rows: Array) -> Array:
        """(2, b) the smallest and the largest value of linear functions (b, p)."""
        low, high = self.ends
        below = np.where(rows > 0.0, low, high)
        above = np.where(rows > 0.0, high, low)
        ends = np.stack([below, above])
        return np.asarray(np.sum(rows * np.where(rows == 0.0, 0.0, ends), axis=2))

    def of(self, base: BaseParameters) -> tuple[Interval, ...]:
        """An interval for each of some linear functions of theta."""
        rows = base.rows
        lowest, highest = self._ends_of(rows)
        noise = self.known.half_widths(rows) / NORMAL_95
        noise = np.hypot(noise, rows @ self._offset)
        of_gains = rows @ self.gains @ self.gain_errors
        other = np.hstack([rows @ self.extra, of_gains])
        std = np.hypot(noise, np.linalg.norm(other, axis=1))
        sizes = np.fmin(np.abs(rows) @ self.task.bound, self._largest[base.leading])
        values = rows @ self.value
        least_squares = rows @ self.task.ols
        parameters = self.task.model.parameters
        return tuple(
            _interval(
                name=name,
                unit=parameters[base.leading[k]].unit,
                value=float(values[k]),
                centre=float(least_squares[k]),
                std=float(std[k]),
                ends=(float(lowest[k]), float(highest[k])),
                size=float(sizes[k]),
            )
            for k, name in enumerate(base.names)
        )


def _interval(
    *,
    name: str,
    unit: str,
    value: float,
    centre: float,
    std: float,
    ends: tuple[float, float],
    size: float,
) -> Interval:
    """The interval around ``centre`` within its ends, with the verdict; size : the
    largest value that counts."""
    if np.isnan(std):
        return Interval(name, unit, value)
    half = NORMAL_95 * std
    rough = size if np.isfinite(size) else 0.0
    verdict = NOT_SEEN
    for word, (share, absolute) in WIDTHS.items():
        if half <= max(share * min(abs(centre), size), absolute * rough):
            verdict = word
            break
    lowest, highest = ends
    return Interval(
        name=name,
        unit=unit,
        value=value,
        std=std,
        lower=min(max(centre - half, lowest), value),
        upper=max(min(centre + half, highest), value),
        verdict=verdict,
    )


def beside_held(
    task: Task,
    regression: Regression,
    held: tuple[Array, Uncertainty],
    held_base: BaseParameters,
    theta: Array,
    base: BaseParameters,
    gain_errors: Array | None = None,
) -> Uncertainty:
    """Of a model that is held fixed and effects that were fitted to what it leaves,
    under constraints.

    Parameters
    ----------
    task : Task
        Of the new effects alone.
    regression : Regression
        Of the held model's columns, theirs, and their shape constants'.
    held : ((f,) array, Uncertainty)
        The held model's parameters and what is known of them; their error is an error
        of the torque that the new effects explain.
    held_base : BaseParameters
        Of the held model.
    theta : (k,) array
        Of the new effects.
    base : BaseParameters
        Of the new effects.
    gain_errors : (n, e) array, optional
        As of :func:`of_regression`; default: those of the held model.

    Returns
    -------
    Uncertainty
        Of all.
    """
    fixed, old = held
    k = len(theta)
    wide = regression.given_first(fixed)
    known = _sandwich_of(task, wide)
    everything = np.zeros(regression.p)
    everything[: len(fixed) + k] = np.concatenate(
        [
            fixed,
            theta,
        ]
    )
    through = []
    through_gains = []
    for f in regression.factors:
        rows = f.triangle[:, :-1]
        is_held = f.indices < len(fixed)
        through.append(-rows[:, is_held] @ old.spread[f.indices[is_held]])
        torque = -rows[:, is_held] @ old.gain_response[f.indices[is_held]]
        torque[:, f.joint] += rows @ everything[f.indices]
        through_gains.append(torque)
    extra = known.response(through)[:k]
    gains = known.response(through_gains)[:k]
    errors = old.gain_errors if gain_errors is None else gain_errors
    narrow = wide.keeping(np.arange(wide.p) < k)
    new = of_regression(
        task,
        narrow,
        base,
        theta,
        constrained=True,
        known=known,
        gains=gains,
        extra=extra,
        gain_errors=errors,
    )
    old = old.with_gain_errors(errors, held_base.rows)
    # The last columns of the new spread are what the old one makes of it.
    own_spread, through_old = np.split(
        new.spread,
        [new.spread.shape[1] - extra.shape[1]],
        axis=1,
    )
    above = np.hstack(
        [
            old.spread,
            np.zeros((len(old.spread), own_spread.shape[1])),
        ]
    )
    return replace(
        new,
        standard=old.standard + new.standard,
        base=old.base + new.base,
        spread=np.vstack([above, np.hstack([through_old, own_spread])]),
        gain_response=np.vstack([old.gain_response, new.gain_response]),
    )
