"""What the data determine, and how well: intervals for parameters and a band for torques.

Intervals come from the runs that a model was identified from: the sandwich of sandwich.py holds what
noise of any colour and the model's own errors do to least squares, the columns of shape_constants.py
what the shape constants' errors do. Standard deviations are half-widths of 95 % intervals over 1.96.

Where an estimate satisfies constraints its intervals are cut to the physical range of the parameter and
extended to the value where constraints have moved it out.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Self

import numpy as np

from sdp_vs_penalty.effects.model import JointColumns
from sdp_vs_penalty.estimation.constants import LEVEL, NORMAL_95, WIDTHS
from sdp_vs_penalty.estimation.sandwich import Sandwich, stretched
from sdp_vs_penalty.estimation.shape_constants import ON_A_GRID
from sdp_vs_penalty.estimators.estimator import Task
from sdp_vs_penalty.files import Plain
from sdp_vs_penalty.regression.base_parameters import BaseParameters
from sdp_vs_penalty.regression.partial import smallest
from sdp_vs_penalty.regression.regression import Regression
from sdp_vs_penalty.robot.arrays import Array

NOT_SEEN = "not seen"


@dataclass(frozen=True)
class Interval(Plain):
    """One standard or base parameter: its estimate, what the data say of it, and a verdict.

    value : of the model; std : standard deviation, NaN where the data do not determine the parameter;
    lower, upper : ends of the 95 % interval, infinite there. verdict : "identifiable" (half-width up to
    a quarter of the value), "weakly" (up to the value), or "not seen"; half-widths up to 0.25 % and 10 %
    of the largest value that the problem's bounds or the measured torque allow count as well.
    """

    name: str
    unit: str
    value: float
    std: float = np.nan
    lower: float = -np.inf
    upper: float = np.inf
    verdict: str = NOT_SEEN

    def widened(self, extra: float) -> Interval:
        """With an independent error of the standard deviation ``extra`` more; a lower end at zero is a
        bound and stays."""
        std = float(np.hypot(self.std, extra))
        more = NORMAL_95 * (std - self.std)
        lower = self.lower if self.lower == 0.0 else self.lower - more
        return replace(self, std=std, lower=lower, upper=self.upper + more)


def intervals_of(
    names: Sequence[str], units: Sequence[str], figures: Array, limits: Array, sizes: Array
) -> tuple[Interval, ...]:
    """figures (3, k) : values, least squares and standard deviations."""
    out = []
    rows = zip(names, units, figures.T.tolist(), limits.tolist(), sizes.tolist(), strict=True)
    for name, unit, (value, least, std), (lowest, highest), size in rows:
        half, told = NORMAL_95 * std, tuple[Any, ...]()
        if not np.isnan(std):
            low, high = min(max(least - half, lowest), value), max(min(least + half, highest), value)
            rough = size if np.isfinite(size) else 0.0
            enough = (
                verdict
                for verdict, (own, absolute) in WIDTHS.items()
                if half <= max(own * min(abs(least), size), absolute * rough)
            )
            told = std, low, high, next(enough, NOT_SEEN)
        out.append(Interval(name, unit, value, *told))
    return tuple(out)


def physical_limits(task: Task) -> Array:
    """(p, 2) smallest and largest value that a parameter can have by the problem's bounds: masses and
    moments of inertia are not negative, nor is friction."""
    low = np.maximum(-task.bound, [p.lower for p in task.model.parameters])
    low[task.links[:, 0]] = task.box[: len(task.links), 0, 0]
    for body in task.constraints.convex:
        if body.family == "pseudo-inertia":
            own = body.indices[[0, 4, 6, 9]]
            low[own] = np.maximum(low[own], 0.0)
    return np.column_stack([low, task.bound])


def counts(intervals: Sequence[Interval]) -> dict[str, int]:
    """How many of each verdict."""
    every = [i.verdict for i in intervals]
    return {verdict: every.count(verdict) for verdict in (*WIDTHS, NOT_SEEN)}


@dataclass(frozen=True)
class Uncertainty(Plain):
    """standard : all parameters of the model; base : the combinations that make torque.

    spread (p, r) : a factor of the covariance of everything that the data show; gain_response (p, n) :
    change of the parameters for a unit relative error of each torque channel's gain, and gain_errors
    (n, e), a factor of the covariance of these errors, which the covariance holds as well; torque_noise
    (n,) : standard deviation of the torque that the model leaves [N m, N].
    """

    standard: tuple[Interval, ...]
    base: tuple[Interval, ...]
    spread: Array
    gain_response: Array
    torque_noise: Array
    gain_errors: Array

    @cached_property
    def factor(self) -> Array:
        """(p, r + e) with the covariance factor factor': rows as long as the standard deviations, which
        Student's quantile has made larger."""
        return stretched(np.hstack([self.spread, self.gain_response @ self.gain_errors]), self.std)

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
        """With gains known otherwise than they were; base (b, p) : the base parameters' rows."""

        def widened(intervals: tuple[Interval, ...], response: Array) -> tuple[Interval, ...]:
            known, new = (np.sum((response @ e) ** 2, axis=1) for e in (self.gain_errors, errors))
            more = np.sqrt(np.maximum(new - known, 0.0)).tolist()
            return tuple(i.widened(x) for i, x in zip(intervals, more, strict=True))

        combined = widened(self.base, base @ self.gain_response) if self.base else ()
        standard = widened(self.standard, self.gain_response)
        return replace(self, standard=standard, base=combined, gain_errors=errors)

    def band(self, theta: Array, columns: Sequence[JointColumns]) -> tuple[Array, Array]:
        """(N, n) modelled torque of columns and its standard deviation, without the noise."""
        count = len(columns[0].columns)
        torque, std = np.empty((2, count, len(columns)))
        for j, block in enumerate(columns):
            torque[:, j] = block.columns @ theta[block.indices]
            std[:, j] = np.linalg.norm(block.columns @ self.factor[block.indices], axis=1)
        return torque, std

    def to_dict(self) -> dict[str, Any]:
        """What model.json holds beside the parameters' own intervals."""
        return {"level": LEVEL} | {k: x for k, x in super().to_dict().items() if k != "standard"}

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Self:
        """What :meth:`to_dict` wrote, and the parameters' own intervals; ValueError for arrays that do
        not belong together."""
        found = super().from_dict(data)
        p, n = len(found.standard), len(found.torque_noise)
        shapes = found.spread.shape[:1], found.gain_response.shape, found.gain_errors.shape[:1]
        if shapes != ((p,), (p, n), (n,)):
            raise ValueError("uncertainty: arrays of other parameters or joints")
        return found


def _sandwich_of(task: Task, regression: Regression, white: bool = False) -> Sandwich:
    """Of a task's data, in its columns and maybe those of shape constants behind them: without constants
    on a grid that the data do not contradict, since such a value is taken for the true one."""

    def of(regression: Regression) -> Sandwich:
        # A shape constant has a standard normal prior.
        scale = np.append(task.model.plausible, np.ones(regression.p - len(task.bound)))
        return Sandwich(regression, task.weights, scale, white)

    known, agrees = of(regression), np.array([q.effect == ON_A_GRID for q in regression.parameters])
    if agrees.any():
        half = known.half_widths(np.eye(regression.p)[agrees])
        agrees[agrees] = np.abs(known.solution[agrees]) <= half
    return of(regression.keeping(~agrees)) if agrees.any() else known


def _uncertainty(
    task: Task,
    own: Regression,
    known: Sandwich,
    value: Array,
    base: BaseParameters,
    constrained: bool,
    gain_errors: Array,
    gains: Array,
    extra: Array,
) -> Uncertainty:
    """own : the data in the task's columns; extra (p, e) : factor of the covariance of a known error."""
    parameters, p, data = task.model.parameters, len(task.bound), task.data
    limits = physical_limits(task) if constrained else np.tile([-np.inf, np.inf], (p, 1))
    norms = np.where(data.column_norms > 0.0, data.column_norms, np.nan)
    largest = np.fmin(task.bound, np.sqrt(data.tau_squared) / norms)

    apart = np.zeros(p)
    if known.regression.p > p:
        # Constants that stay on a grid, or were given, are one step from the least loss.
        apart = known.solution[:p] - smallest(data.R, data.rho)

    def told(base: BaseParameters) -> tuple[Interval, ...]:
        rows = base.rows
        ends = np.where(rows > 0.0, limits.T[:, None], limits.T[::-1, None])
        noise = np.hypot(known.half_widths(rows) / NORMAL_95, rows @ apart)
        other = np.hstack([rows @ extra, rows @ gains @ gain_errors])
        std = np.hypot(noise, np.linalg.norm(other, axis=1))
        return intervals_of(
            base.names,
            [parameters[k].unit for k in base.leading],
            np.stack([rows @ value, rows @ task.ols, std]),
            np.sum(rows * np.where(rows == 0.0, 0.0, ends), axis=2).T,
            np.fmin(np.abs(rows) @ task.bound, largest[base.leading]),
        )

    each = BaseParameters(np.eye(p), [q.name for q in parameters], list(range(p)))
    noise = np.sqrt(own.joint_losses(value) / np.maximum(own.joint_rows(), 1))
    spread = np.hstack([known.factor[:p], extra])
    return Uncertainty(told(each), told(base), spread, gains, noise, gain_errors)


def of_regression(
    task: Task,
    own: Regression,
    base: BaseParameters,
    theta: Array | None = None,
    *,
    wide: Regression | None = None,
    constrained: bool = False,
    gain_errors: Array | None = None,
    white: bool = False,
) -> Uncertainty:
    """Intervals from compressed data.

    task, own : what was estimated from which data; wide : these in the columns of the model with
    :func:`with_sensitivities`. theta (p,) : the estimate; default: least squares next to the nominal
    robot. constrained : whether it satisfies the problem's constraints, and intervals are to;
    gain_errors (n, e) : a factor of the covariance of the relative errors of the torque channels' gains;
    white : take the residual for white noise: what the motion alone would show.
    """
    known = _sandwich_of(task, wide or own, white)
    value = task.ols if theta is None else np.asarray(theta, float)
    gains = known.gain_response(value)[: len(value)]
    errors = np.zeros((own.joints, 0)) if gain_errors is None else gain_errors
    nothing = np.zeros((len(value), 0))
    return _uncertainty(task, own, known, value, base, constrained, errors, gains, nothing)


def beside_held(
    task: Task,
    regression: Regression,
    held: tuple[Array, Uncertainty],
    held_base: BaseParameters,
    theta: Array,
    base: BaseParameters,
    gain_errors: Array | None = None,
) -> Uncertainty:
    """Of a model that is held fixed and effects that were fitted to what it leaves, under constraints.

    task, theta (k,), base : of the new effects alone; regression : of the held model's columns, theirs,
    and their shape constants'; held : the held model's parameters and what is known of them, whose error
    is an error of the torque that the new effects explain; held_base : its base parameters;
    gain_errors : as of :func:`of_regression`, by default those of the held model.
    """
    (fixed, old), k, wide = held, len(theta), regression.beside(held[0])
    known = _sandwich_of(task, wide)
    everything = np.zeros(regression.p)
    everything[: len(fixed) + k] = np.concatenate([fixed, theta])
    through, through_gains = [], []
    for f in regression.factors:
        rows, own = f.triangle[:, :-1], f.indices < len(fixed)
        through.append(-rows[:, own] @ old.spread[f.indices[own]])
        torque = -rows[:, own] @ old.gain_response[f.indices[own]]
        torque[:, f.joint] += rows @ everything[f.indices]
        through_gains.append(torque)
    extra, gains = known.response(through)[:k], known.response(through_gains)[:k]
    errors = old.gain_errors if gain_errors is None else gain_errors
    narrow = wide.keeping(np.arange(wide.p) < k)
    new = _uncertainty(task, narrow, known, theta, base, True, errors, gains, extra)
    old = old.with_gain_errors(errors, held_base.rows)
    # The last columns of the new spread are what the old one makes of it.
    own_spread, through_old = np.split(new.spread, [new.spread.shape[1] - extra.shape[1]], axis=1)
    above = np.hstack([old.spread, np.zeros((len(old.spread), own_spread.shape[1]))])
    return replace(
        new,
        standard=old.standard + new.standard,
        base=old.base + new.base,
        spread=np.vstack([above, np.hstack([through_old, own_spread])]),
        gain_response=np.vstack([old.gain_response, new.gain_response]),
    )
