"""The open shape constants of a model, estimated from measurements by variable projection.

For every constant u (the velocity over which Coulomb friction turns round) the coefficients theta(u) are
those of least squares; what is left, |Y(u) theta(u) - tau|^2, is a function of the constants alone
(Golub, Pereyra, SIAM J. Numerical Analysis 1973), minimised with the Jacobian of Kaufman (BIT 1975).
Columns are computed on a grid of u once, and are cubic splines of ln u between its values
(:func:`estimate_shapes`). Where data tell a constant more finely, and where several take what is each
other's, :func:`settled` computes them at the value itself: a step is a pass over the data.

Every fold k of the motion is left out once, constants are found anew from the rest (one step of Gauss
and Newton), and the fold is predicted with a constant as found there and as the model has it. With r
what the former leaves and d the difference of the two, sum_k |d_k|^2 + 2 r_k'd_k is taken from the
squared error. A constant is confirmed where that exceeds Student's 95 % quantile times its deviation:
sqrt(sum_k (2 r_k'd_k)^2), for noise of any colour, at least that of white noise; else the model's own
value stays, the simpler model (Breiman et al., Classification and Regression Trees, 1984, 3.4.3).

To first order an error ds of a constant s of the columns Y(s) is one more linear parameter, whose column
is (dY/ds) theta (:class:`ShapeSensitivity`): with it in the regression the covariance of theta is no
longer conditional on s (Seber, Wild, Nonlinear Regression 1989, ch. 5). Before anything is measured a
constant lies in its range, uniformly in its own scale.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product
from typing import Any, Self

import numpy as np
import scipy.linalg
from numpy.typing import NDArray
from scipy.special import stdtrit

from sdp_vs_penalty.effects.effect import Block, Effect, Motion, Parameter
from sdp_vs_penalty.effects.model import Model, turning
from sdp_vs_penalty.estimation.constants import AT_END, DIFFERENCE, SHAPE_FOLDS
from sdp_vs_penalty.estimators.estimator import joint_weights, white_variance
from sdp_vs_penalty.files import Plain
from sdp_vs_penalty.parallel import ALONE, Workers
from sdp_vs_penalty.regression.partial import (
    UNSEEN,
    deviations,
    least_squares,
    partialled,
    smallest,
    span,
    visible,
)
from sdp_vs_penalty.regression.regression import LeastSquares, Regression, compress_cells, triangular
from sdp_vs_penalty.robot.arrays import Array, or_one
from sdp_vs_penalty.signals.filtered import FilteredRuns
from sdp_vs_penalty.signals.phases import PhaseFolds, motion_clocks, tracks_of

#: Which rows take part: of a run's number and instants (N,), (N,) true or false.
Chosen = Callable[[int, Array], NDArray[np.bool_]]


@dataclass(frozen=True)
class ShapeEstimate(Plain):
    """A shape constant as estimated: ``before`` is what the model had; std : its standard deviation,
    from the curvature of the squared error; gain : what the change takes from that error in motion left
    out, in units of its variance; at_end : it lies at an end of the range that was searched."""

    effect: str
    joint: int
    shape: str
    before: float
    after: float
    std: float = np.inf
    gain: float = 0.0
    at_end: bool = False

    def to_dict(self) -> dict[str, Any]:
        """joint counts from 1; std is null where the data do not bound the constant on both sides."""
        return {**super().to_dict(), "joint": self.joint + 1}

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Self:
        """What :meth:`to_dict` wrote."""
        return super().from_dict({**data, "joint": data["joint"] - 1})


def at_end(u: float, low: float, high: float) -> bool:
    """Whether a constant lies at an end of its range, all in its own scale."""
    near = AT_END * (high - low)
    return not low + near < u < high - near


def estimate_shapes(
    model: Model,
    runs: FilteredRuns,
    weighting: str,
    chosen: Chosen | None = None,
    workers: Workers = ALONE,
    widest: float = 0.0,
) -> list[ShapeEstimate]:
    """The open shape constants of a model, each at its best value if that explains significantly more
    than the one the model has, of motion left out as well, else at that.

    weighting : of the joints' rows, "noise" or "none"; chosen : the rows that take
    part, default all; workers : who compresses the runs; widest : up to which value the grids go on
    beyond their own, each twice the last one.
    """
    wanted = [  # of effects with one column a joint, of the kind that is estimated, and not given
        (effect, joint, key)
        for effect in model.effects
        for key in effect.estimated
        if key not in effect.given and len(effect.parameters) == len(effect.joints)
        for joint in effect.joints
    ]
    if not wanted:
        return []
    model = model.reference_free

    def compressed(part: Model, count: int = 1) -> Regression:
        """The chosen rows in the columns of a model, a block a fold of the motion that has some."""
        cells = _Cells(PhaseFolds(clocks if count > 1 else (), count), chosen)
        found = compress_cells(runs, part, cells, workers)
        return found.select(sorted({f.block for f in found.factors if f.block < count}))

    clocks = motion_clocks(tracks_of(runs.measurements))
    wide, base, banks = _with_banks(model, wanted, widest)
    folds = compressed(wide, SHAPE_FOLDS)
    weights = np.ones(model.robot.n)
    if weighting == "noise":
        whole = folds.least_squares()
        theta = scipy.linalg.lstsq(whole.R, whole.rho, 1e-10, lapack_driver="gelsy")[0]
        weights = joint_weights(folds, theta)
    profile = _Profile(folds, weights, base, banks)
    u, moves, refused = profile.from_grid(), np.ones(len(banks), bool), np.ones(1, bool)
    while refused.any():  # those that together explain most, and that folds that are left out confirm
        u = profile.best(np.where(moves, u, profile.now), np.flatnonzero(moves))
        found = profile.estimates(u)
        gains, needed = profile.held_out(found)
        refused = moves & ~(gains > needed)
        moves = moves & ~refused
    found = [replace(s, gain=gain) for s, gain in zip(found, gains.tolist(), strict=True)]
    fine = {  # for which interpolation in the grid, good to a per cent, is not enough
        (s.effect, s.joint, s.shape)
        for s in found
        if s.after != s.before and not s.at_end and s.std < 0.01 * s.after
    }
    if not fine:
        return found
    near = replace(model, effects=with_shapes(model.effects, found))
    best = settled(near, fine, compressed, weighting).model
    values = {(e.name, j, key): x for e in best.effects for j in e.joints for key, x in e.shape.items()}
    return [replace(s, after=values[s.effect, s.joint, s.shape]) for s in found]


@dataclass(frozen=True)
class _Cells:
    """Rows by folds of the motion; the last cell holds those that take no part."""

    folds: PhaseFolds
    chosen: Chosen | None

    @property
    def places(self) -> list[tuple[int, float, float]]:
        return [(0, 0.0, 0.0)] * (self.folds.count + 1)

    def cell(self, run: int, t: Array) -> NDArray[np.intp]:
        fold = self.folds.fold(run, t) if self.folds.count > 1 else np.zeros(len(t), np.intp)
        return fold if self.chosen is None else np.where(self.chosen(run, t), fold, self.folds.count)


@dataclass(frozen=True)
class _Bank:
    """One shape constant of one effect on one joint: the value that the model has, the spline through
    the unit vectors at ln u of the values (K,) whose columns are known (the first and the last are the
    range), where these (K,) stand among all others."""

    effect: Effect
    joint: int
    key: str
    now: float
    spline: Any
    columns: NDArray[np.intp]

    def weights(self, u: float) -> Array:
        """(2, K) of each value's columns in those at ln u, and in their derivatives."""
        k = int(np.searchsorted(self.spline.x[1:-1], u, "right"))
        d = u - self.spline.x[k]  # ten times as fast as asking the spline for one value
        powers = np.array([[d**3, d**2, d, 1.0], [3.0 * d**2, 2.0 * d, 1.0, 0.0]])
        return np.asarray(powers @ self.spline.c[:, k])


def _with_banks(
    model: Model, wanted: Sequence[tuple[Effect, int, str]], widest: float
) -> tuple[Model, NDArray[np.intp], list[_Bank]]:
    """The model with the columns of each open constant at all values of its grid; where all other
    columns stand; the grids."""
    from scipy.interpolate import CubicSpline

    own = [effect for effect, _, _ in wanted]
    fixed = [e for e in model.effects if not any(e is effect for effect in own)]
    first = sum(len(e.parameters) for e in fixed)
    base, banks, parts = np.arange(first), list[_Bank](), list[_Grid]()
    splines = dict[tuple[float, ...], Any]()
    for effect, joint, key in wanted:
        grid = effect.shapes[key].on(effect.robot.joints[joint].kind).grid
        while grid[-1] < widest:
            grid = (*grid, 2.0 * grid[-1])
        ends, now = (grid[0], grid[-1]), effect.shape[key]
        if ends[0] <= now <= ends[-1]:  # in place of those within a tenth of it: exact there as well
            grid = tuple(sorted({now, *(g for g in grid if g in ends or abs(np.log(g / now)) > 0.1)}))
        parts.append(_Grid([effect.with_shape([joint], **{key: value}) for value in grid]))
        columns = first + np.arange(len(grid))
        first += len(grid)
        if grid not in splines:
            splines[grid] = CubicSpline(np.log(grid), np.eye(len(grid)))
        banks.append(_Bank(effect.with_shape([joint]), joint, key, now, splines[grid], columns))
    return Model(model.robot, (*fixed, *parts), gains=model.gains, known=model.known), base, banks


class _Grid(Effect):
    """An effect on one joint with several values of one shape constant, as columns of a regression."""

    name = "shape_grid"
    equation = explanation = reference = ""

    def __init__(self, effects: Sequence[Effect]) -> None:
        super().__init__(effects[0].robot, effects[0].joints)
        self.effects = effects

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:  # type: ignore[override]
        (own,) = self.effects[0].parameters
        return tuple(replace(own, name=f"{own.name}_{m}") for m in range(len(self.effects)))

    def blocks(self, motion: Motion) -> list[Block]:
        own = ((m, b) for m, effect in enumerate(self.effects) for b in effect.blocks(motion))
        return [Block(b.joint, b.parameters + m, b.columns) for m, b in own]


class _Profile:
    """What least squares in all other columns leave of the banks' ``count`` and of the torque (r,).

    parts : of each bank its columns at all values (K, r); now, ends (B,), (B, 2) : ln u as the model has
    them, or the nearest that is known, and of their ranges; brakes (B,) : whose coefficients are not
    negative; shown (b, k) : what the data show of the other columns' coefficients, at unit norm of what
    they make; variance : of a row times how often rows repeat each other.
    """

    def __init__(
        self, folds: Regression, weights: Array, base: NDArray[np.intp], banks: list[_Bank]
    ) -> None:
        """Of all blocks; base : where the other columns stand, before the banks'."""
        self.folds, self.weights, self.banks = folds, weights, banks
        data = folds.least_squares(weights)
        both = np.column_stack([data.R[:, len(base) :], data.rho])
        shown, self.shown = visible(data.R[:, base])
        made = shown.T @ both
        left = triangular([both - shown @ made])
        self.torque, self.count = left[:, -1], left.shape[1] - 1
        U = span(left[:, :-1])
        error = float(np.sum((self.torque - U @ (U.T @ self.torque)) ** 2)) + data.residual_norm**2
        # Exact data have no variance; their constants still have a best value.
        error = max(error, 1e-12 * data.tau_squared) or 1.0
        free = max(data.rows - folds.oversampling * (U.shape[1] + shown.shape[1]), 1.0)
        self.variance = folds.oversampling * error / free
        self.parts = [np.ascontiguousarray(left.T[b.columns - len(base)]) for b in banks]
        self.ends = np.array([b.spline.x[[0, -1]] for b in banks])
        self.now = np.clip(np.log([b.now for b in banks]), *self.ends.T)
        self.brakes = np.array([b.effect.parameters[0].lower == 0.0 for b in banks])

    def _made(self, u: Array) -> tuple[Array, Array]:
        """The columns (r, B) at constants ln u (B,), and their derivatives."""
        pairs = zip(self.banks, self.parts, u.tolist(), strict=True)
        A, D = np.array([bank.weights(x) @ part for bank, part, x in pairs]).transpose(1, 2, 0)
        return A, D

    def at(self, u: Array) -> tuple[Array, Array]:
        """What is left of the torque (r,) at constants ln u (B,), and its slopes (r, B); a column that
        would push instead of brake is left out."""
        (A, D), theta = self._made(u), np.zeros(len(u))
        used = pushes = np.ones(len(u), bool)
        while pushes.any():
            U, V = visible(A[:, used])
            theta[used], theta[~used] = V @ (U.T @ self.torque), 0.0
            pushes = self.brakes & (theta < 0.0)
            used = used & ~pushes
        slopes = D * theta
        return self.torque - U @ (U.T @ self.torque), U @ (U.T @ slopes) - slopes

    @cached_property
    def _by_joint(self) -> tuple[Array, list[tuple[NDArray[np.intp], Array, Array, NDArray[np.intp]]]]:
        """(F, k, k) products, in each fold, of what the other columns make in the directions that data
        show. Of each joint the folds that show it, what the others make there (F, r, k), its banks'
        columns and its torque (F, r, c + 1), and their places."""
        (b, k), p, out = self.shown.shape, self.count, []
        seen = np.zeros((len(self.folds.blocks), k, k))
        for joint, indices, blocks, rows in self.folds.by_joint():
            others, weight = int(np.sum(indices < b)), self.weights[joint]  # they come first
            made = rows[..., :others] @ (weight * self.shown[indices[:others]])
            seen[blocks] += made.swapaxes(1, 2) @ made
            out.append((blocks, made, weight * rows[..., others:], np.append(indices[others:] - b, p)))
        return seen, out

    def _left_out(self, T: Array) -> tuple[Array, Array, Array, Array]:
        """Of combinations T (P + 1, d) of the banks' columns and the torque: (F, d, d) products in each
        fold and in all others, less what the other columns, fitted to these others, take of them; (d,)
        their squares in all, and the sums of what these are the sums of."""
        seen, by_joint = self._by_joint
        (count, k, _), d = seen.shape, T.shape[1]
        both, own, most = np.zeros((count, k, d)), np.zeros((count, d, d)), np.zeros(d)
        for blocks, made, rest, at in by_joint:
            combined = rest @ T[at]
            both[blocks] += made.swapaxes(1, 2) @ combined
            own[blocks] += combined.swapaxes(1, 2) @ combined
            every, part = np.abs(np.sum(rest.swapaxes(1, 2) @ rest, axis=0)), np.abs(T[at])
            most += np.einsum("cd,cd->d", part, every @ part)
        others = [x.sum(axis=0) - x for x in (seen, both, own)]
        fit = np.linalg.solve(others[0] + UNSEEN * np.eye(k), others[1])
        found = []
        for squares, mixed, mine in ((seen, both, own), others):
            crossed = fit.swapaxes(1, 2) @ (mixed - 0.5 * squares @ fit)
            found.append(mine - crossed - crossed.swapaxes(1, 2))
        return found[0], found[1], np.einsum("fdd->d", own), most

    def held_out(self, found: Sequence[ShapeEstimate]) -> tuple[Array, Array]:
        """(B,) what each constant alone takes from the squared error of the folds that are left out, in
        variances, and what noise would."""
        moved = [k for k, s in enumerate(found) if s.after != s.before]
        count = len(self.folds.blocks)
        taken, needed = np.zeros((2, len(found)))
        if not moved or count < 2:
            return taken, needed
        # Combinations T (P + 1, d + 1) of columns in which a fit near what was found is linear:
        # each bank's at the value that the model has, and, of a constant that moves, those at its new
        # value and, within its range, their derivative. Of these whose each is, and whether it is new.
        parts = list[tuple[Array, int, bool]]()
        for k, (bank, s) in enumerate(zip(self.banks, found, strict=True)):
            parts.append((bank.weights(self.now[k])[0], k, False))
            if s.after != s.before:
                several = bank.weights(float(np.log(s.after)))
                parts += [(x, k, True) for x in several[: 1 if s.at_end else 2]]
        of, new = (np.array([part[i] for part in parts]) for i in (1, 2))
        T = np.zeros((self.count + 1, len(parts) + 1))
        for out, (weights, k, _) in zip(T.T, parts, strict=False):
            out[self.banks[k].columns - len(self.shown)] = weights
        T[-1, -1] = 1.0  # the torque
        grams, rest, square, least = self._left_out(T)
        # Of a direction that hardly changes anything, rounding leaves as much as of none.
        size = or_one(np.sqrt(np.where(square > len(T) * np.finfo(float).eps * least, square, 0.0)))
        grams, rest = (x / (size * size[:, None]) for x in (grams, rest))
        rest += UNSEEN * np.eye(len(size))
        fits = np.zeros((len(moved) + 1, count, len(size)))
        for fit, k in zip(fits, (-1, *moved), strict=True):  # none of them, each alone
            used = np.flatnonzero(np.where(of == k, new, ~new))
            fit[:, used] = np.linalg.solve(rest[:, used[:, None], used], rest[:, used, -1:])[..., 0]
        fits[..., -1] = -1.0
        both = fits, fits[1:] - fits[0]
        loss, apart = (np.sum(np.squeeze(grams @ x[..., None], 3) * x, axis=2) for x in both)
        scale = size[-1] ** 2 / self.variance
        gains, changes = scale * (loss[0] - loss[1:]), scale * apart
        noise = np.maximum(np.sum((gains - changes) ** 2, axis=1), 4.0 * changes.sum(axis=1))
        taken[moved], needed[moved] = gains.sum(axis=1), stdtrit(count - 1, 0.975) * np.sqrt(noise)
        return taken, needed

    def from_grid(self) -> Array:
        """(B,) ln u, each in turn at the value of its grid that leaves least."""
        u, columns = self.now.copy(), self._made(self.now)[0]
        for k, (bank, part) in enumerate(zip(self.banks, self.parts, strict=True)):
            U = visible(np.delete(columns, k, axis=1))[0]
            left = part - (part @ U) @ U.T
            made = left @ self.torque
            made = np.maximum(made, 0.0) if self.brakes[k] else made
            best = int(np.argmax(made**2 / or_one(np.sum(left**2, axis=1))))
            u[k], columns[:, k] = bank.spline.x[best], part[best]
        return u

    def best(self, start: Array, free: NDArray[np.intp]) -> Array:
        """(B,) ln u with the least squared error, of which only those of the ``free`` banks move."""
        if not len(free):
            return start

        def at(x: Array) -> tuple[Array, Array]:
            u = start.copy()
            u[free] = x
            left, slopes = self.at(u)
            return left, slopes[:, free]

        out, (low, high) = start.copy(), self.ends[free].T
        ftol = 1e-3 * self.variance / float(np.sum(self.at(start)[0] ** 2))  # of what noise decides
        out[free] = least_squares(at, start[free], (low, high), 1e-4, ftol, steps=50)[0]
        return out

    def estimates(self, u: Array) -> list[ShapeEstimate]:
        """What constants ln u (B,) are."""
        stds, out = np.sqrt(self.variance) * deviations(self.at(u)[1]), []
        each = self.banks, u.tolist(), self.now, stds.tolist(), self.ends.tolist()
        for bank, x, now, std, (low, high) in zip(*each, strict=True):
            # As many digits as a written effect has; a spread wider than the range bounds nothing.
            after = bank.now if x == now else float(f"{np.exp(x):.6g}")
            std = after * std if std < (high - low) / np.sqrt(12.0) else np.inf
            end = x != now and at_end(x, low, high)
            one = bank.effect.name, bank.joint, bank.key
            out.append(ShapeEstimate(*one, bank.now, after, std, at_end=bool(end)))
        return out


def with_shapes(effects: Sequence[Effect], found: Sequence[ShapeEstimate]) -> tuple[Effect, ...]:
    """The effects with estimated constants: those that were estimated stand alone, a joint each, in
    the same order, so that the parameters keep their places."""
    values = {(s.effect, s.joint, s.shape): s.after for s in found}
    out: list[Effect] = []
    for effect in effects:
        keys = [(j, k) for j in effect.joints for k in effect.shapes if (effect.name, j, k) in values]
        if not keys:
            out.append(effect)
            continue
        for joint in effect.joints:
            own = {k: values[effect.name, j, k] for j, k in keys if j == joint}
            out.append(effect.with_shape([joint], **own))
    return tuple(out)


def asked_effects(effects: Sequence[Effect], shapes: Sequence[Mapping[str, Any]]) -> list[str]:
    """How effects are written so that `identify` estimates again what it has estimated: ``shapes`` as
    an estimate's details hold them."""
    estimated, asked = {(s["effect"], s["joint"] - 1) for s in shapes}, dict[str, list[str]]()
    for e in effects:
        open_ = all((e.name, j) in estimated for j in e.joints)
        asked.setdefault(e.name if open_ else e.text, []).extend(str(j + 1) for j in e.joints if open_)
    every = effects[0].robot.n if effects else 0
    return [f"{x}:{'+'.join(own)}" if 0 < len(own) < every else x for x, own in asked.items()]


#: Kinds of parameters of :class:`ShapeSensitivity`: constants that are refined, and those that only have
#: the values of a grid.
REFINED, ON_A_GRID = "refined constant", "constant on a grid"


def free_constants(effect: Effect) -> tuple[str, ...]:
    """The shape constants that measurements can tell and that vary continuously in a range."""
    own = (key for key in effect.searched if not effect.shapes[key].choices)
    return tuple(key for key in own if prior_deviation(effect, key) > 0.0)


def prior_deviation(effect: Effect, key: str) -> float:
    """Standard deviation of a constant that lies anywhere in its range, in the scale in which it is
    spaced (natural logarithm or value): (high - low) / sqrt(12). Zero where it has no range."""
    shape = effect.shapes[key]
    low, high = shape.bounds or (min(shape.grid, default=1.0), max(shape.grid, default=1.0))
    return float((np.log(high / low) if shape.scale == "log" else high - low) / np.sqrt(12.0))


class ShapeSensitivity(Effect):
    """The torque of a unit error of each free shape constant of an effect with parameters theta (k,).

    The unit is the standard deviation of the prior, (range) / sqrt(12): a prior of these parameters is
    a standard normal. Columns are central differences (Y(s + h) - Y(s - h)) theta / 2h. ``finer`` :
    effects, with their parameters, that have the constant as well, or whose signs turn over it.
    """

    name = "shape_sensitivity"
    equation = "(dY/ds) theta"
    explanation = "What an error of an effect's shape constant makes of torque."
    reference = "Seber, Wild, Nonlinear Regression 1989, ch. 5"

    def __init__(self, effect: Effect, theta: Array, finer: Sequence[tuple[Effect, Array]] = ()) -> None:
        super().__init__(effect.robot)
        self.effect, self.theta = effect, np.asarray(theta, float)
        self.keys, self.finer = free_constants(effect), tuple(finer)
        every = (effect, *(e for e, _ in finer))
        #: For each constant the effect a step above and below, and the unit over their distance.
        self.varied = [
            (
                moved(effect, key, DIFFERENCE),
                moved(effect, key, -DIFFERENCE),
                0.5 * prior_deviation(effect, key) / DIFFERENCE,
            )
            for key in self.keys
        ]
        # Of what is varied, not of the class.
        self.has_memory = any(e.has_memory for e in every)  # type: ignore[misc]
        self.needs_torque = any(e.needs_torque for e in every)  # type: ignore[misc]
        self.needs_links = any(e.needs_links for e in every)  # type: ignore[misc]

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        e = self.effect
        kinds = {key: ON_A_GRID if e.shapes[key].bounds is None else REFINED for key in self.keys}
        return tuple(Parameter(f"{key} of {e.text}", "-", kind, 0) for key, kind in kinds.items())

    def blocks(self, motion: Motion) -> list[Block]:
        columns: dict[tuple[int, int], Array] = {}
        for k, (upper, lower, unit) in enumerate(self.varied):
            up, down = turning(motion, upper), turning(motion, lower)
            pairs = [(upper.blocks(up), lower.blocks(down), self.theta)]
            for e, theta in self.finer:
                if e.shape_of:
                    own = [e.with_shape(**{c: x.shape[c] for c in e.shape}) for x in (upper, lower)]
                    pairs.append((own[0].blocks(motion), own[1].blocks(motion), theta))
                elif up is not motion:
                    pairs.append((e.blocks(up), e.blocks(down), theta))
            for above_all, below_all, theta in pairs:
                for above, below in zip(above_all, below_all, strict=True):
                    change = unit * (above.columns - below.columns) @ theta[above.parameters]
                    where = above.joint, k
                    columns[where] = columns.get(where, 0.0) + change
        return [Block(j, np.array([k]), column[:, None]) for (j, k), column in columns.items()]


def moved(effect: Effect, key: str, step: float) -> Effect:
    """The effect with a shape constant changed by a step in its own scale."""
    value = effect.shape[key]
    new = value * np.exp(step) if effect.shapes[key].scale == "log" else value + step
    return effect.with_shape(**{key: float(new)})


def sensitivities(effects: Sequence[Effect], thetas: Sequence[Array]) -> tuple[ShapeSensitivity, ...]:
    """One for each of the effects, with its parameters, that has a free shape constant."""
    both = list(zip(effects, thetas, strict=True))
    finer = [[b for b in both if e.name in (*b[0].refines, b[0].shape_of)] for e in effects]
    every = zip(both, finer, strict=True)
    return tuple(ShapeSensitivity(*own, fine) for own, fine in every if free_constants(own[0]))


def with_sensitivities(
    model: Model, theta: Array, wanted: Callable[[Effect], bool] = lambda effect: True
) -> Model:
    """The model with a parameter more for each free shape constant of the effects that are wanted;
    itself where there is none."""
    every = sensitivities(model.effects, [theta[k] for k in model.indices])
    extra = tuple(e for e in every if wanted(e.effect))
    if not extra:
        return model
    reference = model.reference
    if reference is not None:
        reference = np.concatenate([reference, np.zeros(sum(len(e.parameters) for e in extra))])
    return replace(model, effects=(*model.effects, *extra), reference=reference)


#: Effect, joint and name of a shape constant.
Key = tuple[str, int, str]


@dataclass(frozen=True)
class Settled:
    """model : with constants at their joint optimum; std : their standard deviations in their own
    scales; error : the squared error that is left."""

    model: Model
    std: dict[Key, float]
    error: float


def settled(
    model: Model,
    wanted: Collection[Key],
    compressed: Callable[[Model], Regression],
    weighting: str = "noise",
) -> Settled:
    """The model with its ``wanted`` constants where they together leave the least squared error, from
    where they are and, of those that only have the values of a grid, from each of these: Gauss-Newton
    steps of those that have a range, in their own scales.

    compressed : the measurements in the columns of a model; weighting : of the joints' rows, "noise" or
    "none". Effects with a wanted constant act on one joint each.
    """
    first, weights, p = compressed(model), np.ones(model.robot.n), len(model.parameters)
    data = first.least_squares()
    white = max(white_variance(data, first.oversampling), 1e-24 * data.tau_squared / max(data.rows, 1))

    def solved(wide: Regression) -> tuple[LeastSquares, Array]:
        """Least squares of all columns, and theta (p,) of the parameters, which come first, alone."""
        data = wide.least_squares(weights)
        if np.isfinite(model.plausible).any():
            data = data.with_prior(np.append(model.plausible, np.full(wide.p - p, np.inf)), white)
        return data, smallest(data.R[:, :p], data.rho)

    _, start = solved(first)
    if weighting == "noise":
        weights = joint_weights(first, start)

    def keys_of(effect: Effect) -> list[Key]:
        """All free constants of an effect of which one is wanted."""
        own = [(effect.name, effect.joints[0], key) for key in free_constants(effect)]
        return [] if set(own).isdisjoint(wanted) else own

    every = [(k, key) for k, effect in enumerate(model.effects) for key in keys_of(effect)]
    ranged = [model.effects[k].shapes[key[2]].bounds is not None for k, key in every]
    #: Which of the constants' columns behind the parameters' are of those that move.
    mine = np.array([key in wanted and has for (_, key), has in zip(every, ranged, strict=True)])
    free = [x for x, moving in zip(every, mine, strict=True) if moving]
    gridded = [x for x, has in zip(every, ranged, strict=True) if not has and x[1] in wanted]
    unit = np.array([prior_deviation(model.effects[k], key[2]) for k, key in free])

    def descended(begin: tuple[Effect, ...]) -> Settled:
        """Where no step (d,) lowers the squared error any more."""
        theta, variances = start, dict[bytes, float]()

        def at(steps: Array) -> Model:
            out = list(begin)
            for (k, key), step in zip(free, steps.tolist(), strict=True):
                out[k] = moved(out[k], key[2], step)
            return replace(model, effects=tuple(out))

        def left(steps: Array) -> tuple[Array, Array]:
            """What least squares leave (m,), and its slopes (m, d) with the parameters eliminated."""
            nonlocal theta
            wide = compressed(with_sensitivities(at(steps), theta, lambda e: bool(keys_of(e))))
            data, theta = solved(wide.keeping(np.append(np.ones(p, bool), mine)))
            variances[steps.tobytes()] = white_variance(data, wide.oversampling)
            columns = -partialled(data.R[:, :p], data.R[:, p:]) / unit
            rest = np.append(data.rho - data.R[:, :p] @ theta, data.residual_norm)
            return rest, np.vstack([columns, np.zeros((1, len(free)))])

        if not free:
            return Settled(at(unit), {}, float(np.sum(left(unit)[0] ** 2)))
        low, high = np.transpose([_room(begin[k], key[2]) for k, key in free])
        best, rest, slopes = least_squares(left, 0.0 * unit, (low, high), xtol=1e-6, ftol=1e-9, steps=15)
        spread = np.diagonal(np.linalg.pinv(slopes.T @ slopes, rcond=1e-12))
        std = np.sqrt(variances[best.tobytes()] * spread)
        # With as many digits of its constants as a written effect has.
        digits = [{key: float(f"{x:.6g}") for key, x in e.shape.items()} for e in at(best).effects]
        found = tuple(e.with_shape(**own) for e, own in zip(begin, digits, strict=True))
        deviations = dict(zip((key for _, key in free), std.tolist(), strict=True))
        return Settled(replace(model, effects=found), deviations, float(rest @ rest))

    found = []
    for values in product(*(model.effects[k].shapes[key[2]].grid for k, key in gridded)):
        effects = list(model.effects)
        for (k, key), value in zip(gridded, values, strict=True):
            effects[k] = effects[k].with_shape(**{key[2]: value})
        found.append(descended(tuple(effects)))
    return min(found, key=lambda s: s.error)


def _room(effect: Effect, key: str) -> tuple[float, float]:
    """How far a constant may move down and up, in its own scale: within its range; where it is outside
    of that, towards it."""
    shape, value = effect.shapes[key].on(effect.robot.joints[effect.joints[0]].kind), effect.shape[key]
    assert shape.bounds is not None
    ends = np.array([min(shape.bounds[0], value), max(shape.bounds[1], value)])
    low, high = (np.log(ends / value) if shape.scale == "log" else ends - value).tolist()
    return min(low, -1e-9), max(high, 1e-9)
