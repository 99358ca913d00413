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

import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
import scipy

from sdp_vs_penalty.data.measurements import UNNAMED_UNIT
from sdp_vs_penalty.effects.model import JointColumns
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.estimation.constants import LEVEL, NORMAL_95, POOLED, WIDTHS, WINDOW
from sdp_vs_penalty.estimation.sensitivity import ON_A_GRID
from sdp_vs_penalty.estimators.estimator import Task, white_variance
from sdp_vs_penalty.records import NOT_STORED, JsonRecord
from sdp_vs_penalty.regression.base_parameters import BaseParameters
from sdp_vs_penalty.regression.linalg import column_space, min_norm_lstsq
from sdp_vs_penalty.regression.regression import Regression
from sdp_vs_penalty.robot.arrays import Array, Mask, read_only


class Sandwich:
    """The sandwich covariance of weighted least squares on compressed data.

    - ``directions`` V (p, r): what the data determine of theta.
    - ``grams`` (B, r, r) and ``scores`` (B, r): A^T A and A^T residual of each of the B
      blocks of time, with columns A = Y V.
    - ``kernel`` (B, B): how far the errors of two blocks are one error.
    - ``white_variance``: of a row if the noise is white; ``pooled_variance``: the one that all
      directions together show.
    - ``prior`` (r, r): the part of the information that no data brought.
    - ``norms`` (p,): sizes of the columns.
    - ``solution`` (p,): the smallest theta that solves the least squares.
    """

    def __init__(
        self,
        regression: Regression,
        weights: Array,
        prior_scale: Array,
        is_white: bool = False,
    ) -> None:
        """Compute what the sandwich covariance of weighted least squares is made of.

        z (r,) are coordinates of theta in the directions V (p, r) that the data
        determine: theta = V z. Each block of time gives a Gram matrix A^T A (r, r) and
        a score A^T residual (r,); the scores' products estimate the covariance for
        noise of any colour.

        Parameters
        ----------
        regression : Regression
            Compressed rows, in B blocks of time.
        weights : (n,) array
            Weight of each joint's rows.
        prior_scale : (p,) array
            Prior standard deviation of each parameter about zero; infinite without a
            prior.
        is_white : bool
            Take the noise for white: use its variance instead of the blocks' scores.
        """
        self.regression = regression
        self.weights = weights
        self.is_white = is_white
        data = regression.least_squares(weights)
        self.white_variance = white_variance(data, regression.oversampling)
        # Where the torque is fitted to rounding, a prior weighs that much and no less.
        strength = max(
            self.white_variance, 1e-24 * data.tau_squared / max(data.rows, 1)
        )
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
        # A = Y V (rows, r) of each block b: grams A_b^T A_b, scores A_b^T residual_b.
        for joint, indices, blocks, rows in regression.by_joint():
            visible_rows = rows[..., :-1] @ (weights[joint] * V[indices])
            residual = weights[joint] * rows[..., -1] - visible_rows @ z
            self.grams[blocks] += visible_rows.swapaxes(1, 2) @ visible_rows
            self.scores[blocks] += (residual[:, None] @ visible_rows)[:, 0]
        # White noise of variance s^2 makes squared scores of s^2 times this sum; what
        # exceeds it is the inflation by correlated noise.
        traces = np.trace(self.grams, axis1=1, axis2=2)
        expected = float(np.sum(traces) - np.sum(self.grams**2))
        inflation = 1.0
        if expected > 1e-6 * r and self.white_variance > 0.0:
            inflation = float(np.sum(self.scores**2)) / expected / self.white_variance
        self.pooled_variance = inflation * self.white_variance
        self.kernel = _kernel(regression, inflation)
        self.prior = V.T * (strength / prior_scale**2) @ V
        self.norms = factor_rows.column_norms
        self.solution = V @ z
        # Orthonormal basis of the visible directions, with columns at unit norm.
        self._basis = np.linalg.qr(V * self.norms[:, None])[0]

    def sees(self, contrasts: Array) -> Mask:
        """Return whether the data determine linear functions of theta.

        Returns
        -------
        (k,) array of bool
            True where a function lies in the space of visible directions.
        """
        is_zero_column = self.norms <= 0.0
        scaled = contrasts / np.where(is_zero_column, 1.0, self.norms)
        total = np.sum(scaled**2, axis=1)
        is_hidden = np.any(np.abs(contrasts[:, is_zero_column]) > 0.0, axis=1)
        visible = np.sum((scaled @ self._basis) ** 2, axis=1)
        # Rounding may take a millionth of the squared length.
        is_visible = visible > (1.0 - 1e-6) * total
        return is_visible & ~is_hidden & (total > 0.0)

    def half_widths(self, contrasts: Array) -> Array:
        """Return half-widths of the 95 % intervals of linear functions of theta.

        half-width^2 = t^2 (variance by noise) + 1.96^2 (variance by the prior), t
        Student's quantile for the degrees of freedom of the first.

        Parameters
        ----------
        contrasts : (k, q) array
            Coefficients of the first q <= p parameters; those of all others are zero.

        Returns
        -------
        (k,) array
            Half-widths at LEVEL (95 %); NaN where the data do not determine the
            function.
        """
        contrasts = np.pad(
            contrasts, ((0, 0), (0, len(self.norms) - contrasts.shape[1]))
        )
        half_widths = np.full(len(contrasts), np.nan)
        determined = np.flatnonzero(self.sees(contrasts))
        # Chunks of the functions bound the memory of the blocks' products.
        largest_chunk = 1 << 20
        products = determined.size * self.directions.shape[1] ** 2
        for chunk in np.array_split(determined, 1 + products // largest_chunk):
            w = contrasts[chunk] @ self.directions
            variance, freedom = self._variances(w)
            prior_variance = self.white_variance * np.sum((w @ self.prior) * w, axis=1)
            t = scipy.special.stdtrit(freedom, 0.5 + 0.5 * LEVEL)
            normal = scipy.special.stdtrit(np.inf, 0.5 + 0.5 * LEVEL)
            squared = t**2 * variance + normal**2 * prior_variance
            half_widths[chunk] = np.sqrt(squared)
        return half_widths

    def _variances(self, w: Array) -> tuple[Array, Array]:
        """Return variance and degrees of freedom (c,) of the estimates of w' z.

        w (c, r) are functions of the coordinates z of the visible directions. The
        variance is v = h' K h / tr(K G), h the block scores of w and K their kernel;
        the degrees of freedom are tr(K G)^2 / tr(K G K G) (Bell, McCaffrey 2002).
        POOLED degrees of freedom of the variance that all directions share are added
        (moderated t).
        """
        if self.is_white:
            prior = np.sum((w @ self.prior) * w, axis=1)
            variance = self.white_variance * (np.sum(w * w, axis=1) - prior)
            return variance, np.full(len(w), np.inf)
        information, trace, trace_of_square = self._kernel_traces(w)
        h = w @ self.scores.T  # (c, B) scores of each function
        estimates = np.maximum(np.sum(h * (self.kernel @ h.T).T, axis=1), 0.0)
        # Where rounding leaves nothing of the traces the pooled variance stands alone.
        is_usable = (trace > 1e-6 * information) & (trace_of_square > 0.0)
        safe_trace = np.where(is_usable, trace, 1.0)
        safe_square = np.where(is_usable, trace_of_square, 1.0)
        freedom = np.where(is_usable, safe_trace**2 / safe_square, 0.0)
        of_data = freedom * estimates / safe_trace
        moderated = (POOLED * self.pooled_variance + of_data) / (POOLED + freedom)
        return moderated * information, freedom + POOLED

    def _kernel_traces(self, w: Array) -> tuple[Array, Array, Array]:
        """Return w' A w summed over the blocks, tr(K G) and tr(K G K G), each (c,), of
        functions w (c, r).

        A is a block's Gram matrix. G, the covariance of a function's block scores for
        white noise, has the block's information w' A w on its diagonal, less the (A w)'
        (A w) of the fit.
        """
        K = self.kernel
        n_blocks, r = self.scores.shape
        Aw = np.moveaxis(self.grams @ w.T, 2, 0)  # (c, B, r)
        information_of_block = np.maximum(np.einsum("cbr,cr->cb", Aw, w), 0.0)
        by_block = np.moveaxis(Aw, 1, 0).reshape(n_blocks, -1)
        KAw = (K @ by_block).reshape(n_blocks, len(w), r)
        KAw = np.moveaxis(KAw, 1, 0)  # (c, B, r)
        # M has the trace of K G's second part, and its square the trace of that part's
        # square: the smaller one of (A w)' (K A w) and (K A w) (A w)'.
        transposed = np.swapaxes(Aw, 1, 2)
        M = transposed @ KAw if r < n_blocks else KAw @ transposed
        information = information_of_block.sum(axis=1)
        trace = information - np.trace(M, axis1=1, axis2=2)
        squared_kernel = K.power(2) @ information_of_block.T
        trace_of_square = np.sum(information_of_block * squared_kernel.T, axis=1)
        trace_of_square += np.sum(M * M.swapaxes(1, 2), axis=(1, 2))
        mixed = information_of_block * np.sum(KAw**2, axis=2)
        trace_of_square -= 2.0 * np.sum(mixed, axis=1)
        return information, trace, trace_of_square

    @cached_property
    def factor(self) -> Array:
        """Factor F (p, r) of the covariance F F' of theta in the r visible directions.

        The covariance of the directions comes from products of block scores (one a
        block of time). They are few, so they are shrunk towards the pooled variance
        (white noise): the more, the more directions there are for each independent
        window of time.
        """
        n_blocks, r = self.scores.shape
        # Degrees of freedom that the data give the r directions, and those of them that
        # the estimate has taken out of the scores: free / (free - taken) restores these.
        free = r - float(np.trace(self.prior))
        flat = self.grams.reshape(n_blocks, -1)
        taken = float(np.sum((self.kernel @ flat) * flat))
        n_windows = n_blocks**2 / max(float(self.kernel.sum()), 1.0)
        covariance = self.pooled_variance * np.eye(r)  # of the scores
        if free - taken > 1e-6 * free:
            products = self.scores.T @ (self.kernel @ self.scores)
            products = products * (free / (free - taken))
            pooled_share = r / (r + n_windows)
            covariance = pooled_share * covariance + (1.0 - pooled_share) * products
        eigenvalues, vectors = np.linalg.eigh(covariance)
        root = vectors * np.sqrt(np.maximum(eigenvalues, 0.0))
        return self.directions @ root

    def response(self, torques: Sequence[Array]) -> Array:
        """Return the change of the estimate that changes of the torque cause.

        Parameters
        ----------
        torques : sequence of (r, e) arrays
            One for each factor of the regression: e changes of the torque in the r rows
            of its triangle.

        Returns
        -------
        (p, e) array
            Change of theta for each of the e changes.
        """
        n_changes = torques[0].shape[1] if torques else 0
        scores = np.zeros((self.directions.shape[1], n_changes))
        for factor, torque in zip(self.regression.factors, torques, strict=True):
            columns = factor.triangle[:, :-1]  # without the measured torque
            squared_weight = self.weights[factor.joint] ** 2
            visible = squared_weight * columns @ self.directions[factor.indices]
            scores += visible.T @ torque
        return self.directions @ scores

    def gain_response(self, theta: Array) -> Array:
        """Return the change of the estimate with the gains of the torque channels.

        An error e of a joint's gain adds e times the modelled torque to its channel.

        Parameters
        ----------
        theta : (q,) array
            The estimate; q <= p.

        Returns
        -------
        (p, n) array
            Change of theta for a unit relative error of each joint's gain.
        """
        # Columns beyond the estimate's are errors of shape constants, estimated as 0.
        all_values = np.pad(theta, (0, len(self.norms) - len(theta)))
        identity = np.eye(self.regression.joints)
        added_torques = []
        for factor in self.regression.factors:
            columns = factor.triangle[:, :-1]  # without the measured torque
            modelled = columns @ all_values[factor.indices]  # (r,)
            added_torques.append(np.outer(modelled, identity[factor.joint]))  # (r, n)
        return self.response(added_torques)


def stretched(factor: Array, std: Array) -> Array:
    """Scale the rows of a covariance factor to given standard deviations.

    Parameters
    ----------
    factor : (p, r) array
        F of a covariance F F'.
    std : (p,) array
        Standard deviations; NaN where unknown.

    Returns
    -------
    (p, r) array
        F with rows of length std; rows with unknown std are scaled by the median ratio.
    """
    length = np.linalg.norm(factor, axis=1)
    has_ratio = np.isfinite(std) & (length > 0.0)
    ratio = np.where(has_ratio, std, 1.0) / np.where(has_ratio, length, 1.0)
    typical = float(np.median(ratio[has_ratio])) if has_ratio.any() else 1.0
    return factor * np.where(has_ratio, ratio, typical)[:, None]


def _kernel(regression: Regression, inflation: float) -> scipy.sparse.csr_array:
    """Return the (B, B) triangular window K over the B blocks of time of all runs.

    K_ab falls from 1 to 0 as blocks a and b of one run are farther apart in time, up to
    WINDOW correlation times or half the run. Blocks of different runs are independent.
    ``inflation`` is the variance of the block scores over that of white noise.
    """
    # (B,) each, run by run, as the kernel's blocks stand along its diagonal.
    runs, starts, stops = np.array(regression.blocks, float).reshape(-1, 3).T
    length = _window_length(regression, float(np.sum(stops - starts)), inflation)
    kernels = []
    for run in np.unique(runs):
        is_of_run = runs == run
        start, stop = starts[is_of_run], stops[is_of_run]
        middle = 0.5 * (start + stop)
        reach = min(length, 0.5 * float(stop.max() - start.min()))
        distance = np.abs(np.subtract.outer(middle, middle))
        if reach > 0.0:
            kernels.append(np.maximum(1.0 - distance / reach, 0.0))
        else:
            kernels.append(np.eye(len(middle)))
    if not kernels:
        return scipy.sparse.csr_array((0, 0))
    return scipy.sparse.csr_array(scipy.sparse.block_diag(kernels))


def _window_length(regression: Regression, seconds: float, inflation: float) -> float:
    """Return the length [s] of the sandwich's window, WINDOW correlation times T, over
    data of some seconds.

    Scores of noise that is correlated over T have 2 T / interval times the variance of
    white noise, where ``interval`` is the time between two independent rows: this ratio
    is ``inflation``, and below 1 it is chance.
    """
    rows_of_joint = max(int(regression.joint_rows().max(initial=0)), 1)
    interval = seconds * regression.oversampling / rows_of_joint
    correlation_time = 0.5 * max(inflation, 1.0) * interval
    return WINDOW * correlation_time


NOT_SEEN = "not seen"


@dataclass(frozen=True)
class Interval(JsonRecord):
    """One standard or base parameter: its estimate, what the data say of it, and a
    verdict."""

    #: Name of the parameter, such as "m1", or the sum of a base parameter.
    name: str
    #: Unit of the value.
    unit: str
    #: Value of the model.
    value: float
    #: Standard deviation; NaN where the data do not determine the parameter.
    std: float = np.nan
    #: Lower end of the 95 % interval; infinite where the data do not determine it.
    lower: float = -np.inf
    #: Upper end of the 95 % interval; infinite where the data do not determine it.
    upper: float = np.inf
    #: "identifiable" (half-width up to a quarter of the value), "weakly" (up to the
    #: value), or "not seen"; half-widths up to 0.25 % and 10 % of the largest value
    #: that the problem's bounds or the measured torque allow count as well.
    verdict: str = NOT_SEEN


def unit_by(unit: str, torque: str) -> str:
    """Return the unit of a parameter where torques are in another unit, such as "A".

    N*m becomes A. The unit of a link's parameter does not hold N*m: kg becomes
    kg*A/(N*m), or unscaled where nobody has named the torques' unit.
    """
    if "N*m" in unit:
        return unit.replace("N*m", torque)
    if torque == UNNAMED_UNIT:
        return f"unscaled {unit}"
    return f"{unit}*{torque}/(N*m)"


def agreeing_with_source(interval: Interval, source: str) -> Interval:
    """Return an interval whose verdict agrees with what determines the value: its
    ``source`` "data", "given", "prior" or "bounds".

    A value by prior or bounds is "not seen", however narrow the data's interval; one by
    the data is "weakly" seen at least. Given values keep their verdict, as do parameters
    whose standard deviation is unknown.
    """
    if source == "given" or np.isnan(interval.std):
        return interval
    if source != "data":
        return replace(interval, verdict=NOT_SEEN)
    is_seen = interval.verdict != NOT_SEEN
    return interval if is_seen else replace(interval, verdict="weakly")


def counts(intervals: Sequence[Interval]) -> dict[str, int]:
    """Count the intervals of each verdict.

    Returns
    -------
    dict of str to int
        Number by verdict: "identifiable", "weakly", "not seen".
    """
    verdicts = [interval.verdict for interval in intervals]
    return {verdict: verdicts.count(verdict) for verdict in (*WIDTHS, NOT_SEEN)}


#: No parameter of an arm is as large in any unit.
_LARGEST = 1e100


@dataclass(frozen=True)
class Uncertainty(JsonRecord):
    """What the data say of a model's p parameters: intervals and covariance.

    Raises ValueError for arrays that do not belong together.
    """

    derived = ("level",)
    #: Probability of all intervals.
    level: ClassVar[float] = LEVEL
    #: Intervals of the combinations that make torque.
    base: tuple[Interval, ...]
    #: (p, r) factor of the covariance of everything that the data show.
    spread: Array
    #: (p, n) change of the parameters for a unit relative error of each torque
    #: channel's gain.
    gain_response: Array
    #: (n,) standard deviation of the torque that the model leaves [N m, N].
    torque_noise: Array
    #: (n, e) factor of the covariance of the gains' relative errors, which the
    #: covariance holds as well.
    gain_errors: Array
    #: Intervals of all parameters of the model; a file has them with its parameters.
    standard: tuple[Interval, ...] = field(default_factory=tuple, metadata=NOT_STORED)

    def __post_init__(self) -> None:
        """Raise ValueError for arrays whose shapes or sizes cannot belong to a model."""
        p = len(self.standard) or len(self.gain_response)
        n = len(self.torque_noise)
        # p parameters, n joints; spread (p, r) and gain_errors (n, e) have any width.
        shapes = (
            self.spread.shape[:1],
            self.gain_response.shape,
            self.gain_errors.shape[:1],
        )
        if shapes != ((p,), (p, n), (n,)):
            raise ValueError("uncertainty: arrays of other parameters or joints")
        for name in ("spread", "gain_response", "torque_noise", "gain_errors"):
            # The covariance holds their squares, which must not overflow.
            if np.any(np.abs(getattr(self, name)) > _LARGEST):
                raise ValueError(f"uncertainty: {name} beyond {_LARGEST:g}")
            object.__setattr__(self, name, read_only(getattr(self, name)))

    def in_unit(self, torque: str) -> Uncertainty:
        """Return the same, with the parameters' units of torques in another unit, such as
        "A"; "" leaves them as they are."""
        if not torque:
            return self
        standard, base = (
            tuple(replace(x, unit=unit_by(x.unit, torque)) for x in intervals)
            for intervals in (self.standard, self.base)
        )
        return replace(self, standard=standard, base=base)

    @cached_property
    def factor(self) -> Array:
        """Factor F (p, r + e) of the covariance F F' of theta: noise, then errors of
        the gains.

        Its rows are scaled to the standard deviations, which hold Student's quantile.
        """
        stacked = np.hstack([self.spread, self.gain_response @ self.gain_errors])
        return read_only(stretched(stacked, self.std))

    @cached_property
    def std(self) -> Array:
        """(p,) standard deviations; NaN where the data do not determine a parameter."""
        return read_only(np.array([i.std for i in self.standard]))

    @cached_property
    def covariance(self) -> Array:
        """(p, p) covariance of theta; NaN rows and columns where the data do not
        determine it.
        """
        covariance = self.factor @ self.factor.T
        is_undetermined = np.isnan(self.std)
        covariance[is_undetermined] = np.nan
        covariance[:, is_undetermined] = np.nan
        return read_only(covariance)

    def with_gain_errors(self, errors: Array, base: Array) -> Uncertainty:
        """Return the intervals for another uncertainty of the torque channels' gains.

        A gain is the channel's reading over the true torque. ``gain_response`` (p, n)
        is the change of theta by a relative error of each gain; the variance that it
        causes is replaced.

        Parameters
        ----------
        errors : (n, e) array
            Factor of the covariance of the gains' relative errors.
        base : (b, p) array
            Coefficients of the base parameters in theta.

        Returns
        -------
        Uncertainty
            With wider or narrower intervals. A lower end at zero is a physical bound
            and stays.
        """

        def with_new_gains(
            intervals: tuple[Interval, ...], response: Array
        ) -> tuple[Interval, ...]:
            """Replace the variance of the old gain errors by that of the new; response
            (k, n).
            """
            old_variance = np.sum((response @ self.gain_errors) ** 2, axis=1)
            new_variance = np.sum((response @ errors) ** 2, axis=1)
            extra_std = np.sqrt(np.maximum(new_variance - old_variance, 0.0))
            std = np.array([interval.std for interval in intervals])
            return _with_stds(intervals, np.hypot(std, extra_std))

        combined: tuple[Interval, ...] = ()
        if self.base:
            combined = with_new_gains(self.base, base @ self.gain_response)
        standard = with_new_gains(self.standard, self.gain_response)
        return replace(self, standard=standard, base=combined, gain_errors=errors)

    def agreeing_with_sources(
        self, undetermined: Mapping[str, str], base_parameters: Sequence[Any]
    ) -> Uncertainty:
        """Return the uncertainty with verdicts that agree with what determines each
        parameter (:func:`agreeing_with_source`), as an estimate's report says it."""
        base = {entry.name: entry.source for entry in base_parameters}

        def with_verdicts(
            intervals: Sequence[Interval], source_by_name: Mapping[str, str]
        ) -> tuple[Interval, ...]:
            """Return intervals with the verdicts of their sources; others are data."""
            return tuple(
                agreeing_with_source(x, source_by_name.get(x.name, "data"))
                for x in intervals
            )

        return replace(
            self,
            standard=with_verdicts(self.standard, undetermined),
            base=with_verdicts(self.base, base),
        )

    def widened(self, factors: Array, base: Array) -> Uncertainty:
        """Return the uncertainty with wider intervals of some parameters.

        Parameters
        ----------
        factors : (p,) array
            Factor of each parameter's standard deviation; at least 1.
        base : (b, p) array
            Coefficients of the base parameters in theta. A base parameter that is one
            parameter alone gets that one's factor; all others stay.

        Returns
        -------
        Uncertainty
            With wider intervals. A lower end at zero is a physical bound and stays.
        """
        is_one_alone = np.count_nonzero(base, axis=1) == 1
        of_leading = factors[np.argmax(base != 0.0, axis=1)]
        base_factors = np.where(is_one_alone, of_leading, 1.0)
        combined: tuple[Interval, ...] = ()
        if self.base:
            base_std = np.array([interval.std for interval in self.base])
            combined = _with_stds(self.base, base_std * base_factors)
        return replace(
            self, standard=_with_stds(self.standard, self.std * factors), base=combined
        )

    def band(
        self, theta: Array, columns: Sequence[JointColumns]
    ) -> tuple[Array, Array]:
        """Return the modelled torque and the standard deviation of its model error.

        Parameters
        ----------
        columns : sequence of n JointColumns
            Regressor of each joint at N instants.

        Returns
        -------
        (N, n) array
            Torque that the estimate makes [N m, N].
        (N, n) array
            Standard deviation that errors of theta cause, without measurement noise [N
            m, N].
        """
        count = len(columns[0].columns)
        torque, std = np.empty((2, count, len(columns)))
        for j, block in enumerate(columns):
            torque[:, j] = block.columns @ theta[block.indices]
            std[:, j] = np.linalg.norm(
                block.columns @ self.factor[block.indices], axis=1
            )
        return torque, std


def independent_gains(uncertainty: float | Array, joints: int) -> Array:
    """Return an (n, n) or (n, e) covariance factor of the relative errors of the torque
    channels' gains.

    Parameters
    ----------
    uncertainty : float or (n, e) array
        Relative standard deviation of each gain, independent of the others; or the
        factor.

    Raises
    ------
    InputError
        For a standard deviation outside of [0, 1).
    """
    if isinstance(uncertainty, np.ndarray):
        return uncertainty
    if not 0.0 <= uncertainty < 1.0:
        remedy = "give a relative standard deviation, such as 0.01"
        raise InputError(f"gain_uncertainty {uncertainty:g}", remedy)
    return uncertainty * np.eye(joints)


class LateUncertainty(Uncertainty):
    """An uncertainty that is worked out when something of it is first read.

    Until then it has no fields, and keeps what they are worked out from. Then it has
    them, and is an :class:`Uncertainty` like any other.
    """

    def __init__(self, make: Callable[[], Uncertainty]) -> None:
        """Keep ``make``, which works the uncertainty out; it is called once, whichever
        thread reads first."""
        vars(self).update(_make=make, _lock=threading.Lock())

    def __getattr__(self, name: str) -> Any:
        """Return a field, for which all fields are worked out first.

        Python asks here for attributes that the object does not have yet. The object
        then becomes an Uncertainty, which has no such method. The lock lets one of
        several threads do the work; the others wait for it.
        """
        lock = vars(self).get("_lock")
        if lock is None:  # another thread has worked them out meanwhile
            return object.__getattribute__(self, name)
        with lock:
            make = vars(self).get("_make")
            if make is not None:
                vars(self).update(vars(make()))
                object.__setattr__(self, "__class__", Uncertainty)
                del vars(self)["_make"], vars(self)["_lock"]
        return object.__getattribute__(self, name)

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle or copy it as what it stands for: another process cannot work it
        out."""
        return Uncertainty, tuple(getattr(self, f.name) for f in fields(Uncertainty))


def _with_stds(intervals: Sequence[Interval], std: Array) -> tuple[Interval, ...]:
    """Widen intervals to larger standard deviations std (k,); NaN leaves one as it is.

    A lower end at zero is a physical bound and stays.
    """
    widened = []
    for interval, new_std in zip(intervals, std.tolist(), strict=True):
        if np.isnan(new_std):
            widened.append(interval)
            continue
        added = NORMAL_95 * (new_std - interval.std)
        is_bound = interval.lower == 0.0
        lower = interval.lower if is_bound else interval.lower - added
        upper = interval.upper + added
        widened.append(replace(interval, std=new_std, lower=lower, upper=upper))
    return tuple(widened)


def _sandwich_of(
    task: Task, regression: Regression, is_white: bool = False
) -> Sandwich:
    """Return the sandwich of a task's data; errors of shape constants count as
    parameters.

    The first p columns of ``regression`` are the task's parameters. Further columns are
    errors of shape constants, with a standard normal prior. A constant that only takes
    values of a grid (ON_A_GRID) counts as exact where the 95 % interval of its error
    holds zero, and its column is left out. ``is_white``: take the noise for white.
    """
    n_constants = regression.p - len(task.bound)
    prior_std = np.append(task.model.plausible, np.ones(n_constants))
    sandwich = Sandwich(regression, task.weights, prior_std, is_white)
    on_a_grid = np.flatnonzero([q.effect == ON_A_GRID for q in regression.parameters])
    if not len(on_a_grid):
        return sandwich
    half_widths = sandwich.half_widths(np.eye(regression.p)[on_a_grid])
    errors = np.abs(sandwich.solution[on_a_grid])
    keep = np.ones(regression.p, bool)
    keep[on_a_grid[errors <= half_widths]] = False
    if keep.all():
        return sandwich
    return Sandwich(regression.keeping(keep), task.weights, prior_std[keep], is_white)


def linear_spread(
    task: Task,
    own_regression: Regression,
    theta: Array,
    wide: Regression | None = None,
    gain_errors: Array | None = None,
) -> Callable[[Array], Array]:
    """Return the function that gives linear functions rows (b, p) of theta the standard
    deviations (b,) of their intervals, NaN where the data do not determine one.

    The arguments are those of :func:`regression_uncertainty`.
    """
    sandwich = _sandwich_of(task, wide or own_regression)
    return _intervals(task, theta, sandwich, gain_errors).std


def regression_uncertainty(
    task: Task,
    own_regression: Regression,
    base: BaseParameters,
    theta: Array | None = None,
    *,
    wide: Regression | None = None,
    constrained: bool = False,
    gain_errors: Array | None = None,
    white: bool = False,
) -> Uncertainty:
    """Compute intervals and covariance of an estimate from compressed data.

    Parameters
    ----------
    own_regression : Regression
        The data in the columns of the task's model.
    base : BaseParameters
        The base parameters (identifiable combinations).
    theta : (p,) array, optional
        The estimate; default: least squares next to the nominal robot.
    wide : Regression, optional
        The data in the columns of the model with :func:`with_sensitivities`.
    constrained : bool
        Whether theta satisfies the problem's constraints; the intervals then do as
        well.
    gain_errors : (n, e) array, optional
        Factor of the covariance of the relative errors of the torque channels' gains.
    white : bool
        Take the residual for white noise, as for the prediction of a motion's
        information.
    """
    value = task.ols if theta is None else np.asarray(theta, float)
    sandwich = _sandwich_of(task, wide or own_regression, white)
    intervals = _intervals(task, value, sandwich, gain_errors, constrained)
    return intervals.uncertainty(own_regression, base)


def _intervals(
    task: Task,
    value: Array,
    sandwich: Sandwich,
    gain_errors: Array | None,
    constrained: bool = False,
) -> _Intervals:
    """Return what intervals are made of, as :func:`regression_uncertainty` takes it."""
    p = len(task.bound)
    gains = sandwich.gain_response(value)[:p]
    # A drive's known gain, from a load, scales with its channel.
    for k, gain in task.model.known_values.items():
        if task.model.drives[k]:
            gains[k, task.model.parameters[k].joint - 1] = gain
    # Without errors of the gains, and of another kind: factors of width zero.
    if gain_errors is None:
        gain_errors = np.zeros((sandwich.regression.joints, 0))
    ends = _allowed(task) if constrained else np.outer([-np.inf, np.inf], np.ones(p))
    return _Intervals(task, value, sandwich, ends, np.zeros((p, 0)), gains, gain_errors)


def _allowed(task: Task) -> Array:
    """Return (2, p) lower and upper bounds of each parameter from physics and the
    problem.

    Masses, moments of inertia and friction are not negative.
    """
    low = np.maximum(-task.bound, [q.lower for q in task.model.parameters])
    # A link's ten parameters: m, m c (3), Ixx, Ixy, Iyy, Ixz, Iyz, Izz.
    low[task.links[:, 0]] = task.box[: len(task.links), 0, 0]
    for constraint in task.constraints.convex:
        if constraint.family == "pseudo-inertia":
            mass_and_moments = constraint.indices[[0, 4, 6, 9]]
            low[mass_and_moments] = np.maximum(low[mass_and_moments], 0.0)
    return np.stack([low, task.bound])


@dataclass(frozen=True)
class _Intervals:
    """What intervals of linear functions of theta are made of. Errors of the gains and
    further errors are no noise, as in :func:`regression_uncertainty`."""

    #: The optimisation problem.
    task: Task
    #: (p,) the estimate.
    value: Array
    #: Sandwich covariance of what the data determine.
    sandwich: Sandwich
    #: (2, p) lower and upper end of what is allowed of each parameter.
    ends: Array
    #: (p, e) factor of the covariance of a further, independent error of theta.
    extra: Array
    #: (p, n) change of theta with the gains of the torque channels.
    gains: Array
    #: (n, e) factor of the covariance of the gains' relative errors.
    gain_errors: Array

    @cached_property
    def _offset(self) -> Array:
        """(p,) change of the least-squares theta when shape constants are estimated as
        well.

        Shape constants (such as a Stribeck velocity) have columns behind the p
        parameters'. Zero if the regression has none.
        """
        p = len(self.task.bound)
        if self.sandwich.regression.p <= p:
            return np.zeros(p)
        data = self.task.data
        return self.sandwich.solution[:p] - min_norm_lstsq(data.R, data.rho)

    @cached_property
    def _largest(self) -> Array:
        """(p,) largest possible value of each parameter: its bound, or |tau| /
        |column|.

        The latter is the value with which the parameter alone makes all the measured
        torque.
        """
        data = self.task.data
        norms = np.where(data.column_norms > 0.0, data.column_norms, np.nan)
        # fmin ignores NaN: a zero column leaves the bound.
        return np.fmin(self.task.bound, np.sqrt(data.tau_squared) / norms)

    def uncertainty(
        self, own_regression: Regression, base: BaseParameters
    ) -> Uncertainty:
        """Return the intervals of theta and of ``base``, and the covariance, as
        :func:`regression_uncertainty` takes them."""
        p = len(self.value)
        names = [q.name for q in self.task.model.parameters]
        mean_squares = own_regression.joint_losses(self.value) / np.maximum(
            own_regression.joint_rows(), 1
        )
        return Uncertainty(
            standard=self.intervals(BaseParameters(np.eye(p), names, list(range(p)))),
            base=self.intervals(base),
            spread=np.hstack([self.sandwich.factor[:p], self.extra]),
            gain_response=self.gains,
            torque_noise=np.sqrt(mean_squares),
            gain_errors=self.gain_errors,
        )

    def std(self, rows: Array) -> Array:
        """Return the standard deviations (b,) of linear functions rows (b, p) of theta,
        NaN where the data do not determine one.

        variance = noise^2 + offset^2 + gains^2 + extra^2, all independent: noise by the
        sandwich covariance; offset, the shift that open shape constants cause; the
        errors of the torque channels' gains; and ``extra``, a further error of theta.
        """
        # What is known has no noise: functions of it alone, and its part of others.
        free_rows = rows.copy()
        free_rows[:, list(self.task.model.known_values)] = 0.0
        is_known = rows.any(axis=1) & ~free_rows.any(axis=1)
        noise = self.sandwich.half_widths(free_rows) / NORMAL_95
        noise = np.where(is_known, 0.0, np.hypot(noise, free_rows @ self._offset))
        errors_of_gains = rows @ self.gains @ self.gain_errors
        other = np.hstack([rows @ self.extra, errors_of_gains])
        return np.hypot(noise, np.linalg.norm(other, axis=1))

    def intervals(self, base: BaseParameters) -> tuple[Interval, ...]:
        """Return the 95 % interval of each of ``base``'s linear functions of theta."""
        rows = base.rows
        # Interval arithmetic: a positive coefficient is smallest at the lower end.
        low, high = self.ends
        below = np.where(rows > 0.0, low, high)
        above = np.where(rows > 0.0, high, low)
        ends = np.stack([below, above])
        # Ends may be infinite: 0 times infinity shall count 0.
        lowest, highest = np.sum(rows * np.where(rows == 0.0, 0.0, ends), axis=2)
        std = self.std(rows)
        # Largest possible values, to which small ones are compared; fmin ignores NaN.
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
    """Return the 95 % interval centre +- 1.96 std within its ends, with the verdict.

    ``value`` is the estimate, which lies in the interval; ``centre`` is least squares;
    ``ends`` are the physical bounds; ``size`` is the largest possible value, to which
    small parameters are compared.
    """
    if np.isnan(std):
        return Interval(name, unit, value)
    half_width = NORMAL_95 * std
    # The first word, from the narrowest, whose width the interval does not exceed.
    finite_size = size if np.isfinite(size) else 0.0
    verdict = NOT_SEEN
    for word, (share_of_value, share_of_size) in WIDTHS.items():
        limit = share_of_value * min(abs(centre), size)
        if half_width <= max(limit, share_of_size * finite_size):
            verdict = word
            break
    lowest, highest = ends
    return Interval(
        name=name,
        unit=unit,
        value=value,
        std=std,
        lower=min(max(centre - half_width, lowest), value),
        upper=max(min(centre + half_width, highest), value),
        verdict=verdict,
    )


def beside_held(
    task: Task,
    regression: Regression,
    held: tuple[Array, Uncertainty],
    theta: Array,
    base: BaseParameters,
) -> Uncertainty:
    """Compute the uncertainty of new effects that were fitted beside a fixed model.

    The fixed model's parameters have errors, which act on the new effects as errors of
    the torque that is left for them.

    Parameters
    ----------
    task : Task
        Optimisation problem of the new effects alone.
    regression : Regression
        Data in the columns of the fixed model, of the new effects, and of their shape
        constants, in this order.
    held : ((f,) array, Uncertainty)
        Parameters of the fixed model and their uncertainty.
    theta : (k,) array
        Parameters of the new effects.
    base : BaseParameters
        Base parameters of the new effects.

    Returns
    -------
    Uncertainty
        Of the fixed model and the new effects together, f + k parameters.
    """
    fixed, held_uncertainty = held
    k = len(theta)
    wide = regression.given_first(fixed)
    sandwich = _sandwich_of(task, wide)
    all_values = np.zeros(regression.p)
    all_values[: len(fixed) + k] = np.concatenate([fixed, theta])
    by_spread, by_gains = _torque_left_by_errors(
        regression, len(fixed), held_uncertainty, all_values
    )
    extra = sandwich.response(by_spread)[:k]
    gains = sandwich.response(by_gains)[:k]
    regression_of_new = wide.keeping(np.arange(wide.p) < k)
    gain_errors = held_uncertainty.gain_errors
    intervals = _Intervals(
        task, theta, sandwich, _allowed(task), extra, gains, gain_errors
    )
    new_uncertainty = intervals.uncertainty(regression_of_new, base)
    return _joined(held_uncertainty, new_uncertainty, extra.shape[1])


def _torque_left_by_errors(
    regression: Regression, n_fixed: int, fixed: Uncertainty, all_values: Array
) -> tuple[list[Array], list[Array]]:
    """Return the torque that errors of a fixed model leave for new effects to explain, in
    the rows of each factor: (r, e) for each column of the model's spread, and (r, n) for
    a unit relative error of each torque channel's gain.

    The first ``n_fixed`` parameters are the fixed model's; ``all_values`` (p,) are the
    values of all.
    """
    by_spread = []
    by_gains = []
    for factor in regression.factors:
        columns = factor.triangle[:, :-1]
        is_fixed = factor.indices < n_fixed
        fixed_columns = columns[:, is_fixed]
        fixed_indices = factor.indices[is_fixed]
        by_spread.append(-fixed_columns @ fixed.spread[fixed_indices])
        # A gain's error scales the joint's torque, and has changed the fixed model.
        torque = -fixed_columns @ fixed.gain_response[fixed_indices]
        torque[:, factor.joint] += columns @ all_values[factor.indices]
        by_gains.append(torque)
    return by_spread, by_gains


def _joined(fixed: Uncertainty, new: Uncertainty, n_extra: int) -> Uncertainty:
    """Return the uncertainty of a fixed model's parameters and those of new effects.

    The last ``n_extra`` columns of the new spread are the errors that the fixed model's
    spread causes: [[fixed, 0], [new by fixed, new by noise]] is the common factor of the
    covariance.
    """
    new_by_noise, new_by_fixed = np.split(
        new.spread, [new.spread.shape[1] - n_extra], axis=1
    )
    zeros = np.zeros((len(fixed.spread), new_by_noise.shape[1]))
    return replace(
        new,
        standard=fixed.standard + new.standard,
        base=fixed.base + new.base,
        spread=np.block([[fixed.spread, zeros], [new_by_fixed, new_by_noise]]),
        gain_response=np.vstack([fixed.gain_response, new.gain_response]),
    )
