"""Consistent models from the likelihood times a stated prior.

    p(theta) ~ exp(-|A theta - a|^2 / (2 s^2)) prior(theta)   where every constraint holds,

s^2 the variance that an interval takes for a row (c at one standard deviation). The prior is
"flat" in the standard parameters within the constraints, or "entropic": exp(-k D(P || P0) / 2),
the divergence from the nominal links with the weight k of the default method's pull.

Hit-and-run (Smith, Operations Research 1984): along a random direction the density is a
Gaussian on an interval, whose ends are eigenvalues of small matrices. A direction in which all
parameters move at random soon meets a constraint. Directions are therefore of three kinds,
in turn: a column of the covariance, which moves one parameter and the others as they follow it,
with the precision A^T A / s^2 plus the barrier's Hessian at the chains' mean; a parameter that the
fewest others counter, so that no torque shows it; and a principal axis of the states that the
second half of the warm-up has met, along which the set is long. All are fixed after the warm-up.
An entropic prior enters by slice sampling. Many chains run as one array, from starts near the
set's boundary. All their states are judged, one a sweep, by the split R^ of Gelman and Rubin
(Bayesian Data Analysis, 3rd ed., 11.4) and the effective sample size of Geyer's initial positive
sequence: R^ of the few states that are returned would be above 1 by chance.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import scipy

from sdp_vs_penalty.data.files import Source
from sdp_vs_penalty.errors import InputError, require_known
from sdp_vs_penalty.estimation.estimate import Estimate, as_estimate
from sdp_vs_penalty.estimators.estimator import Task
from sdp_vs_penalty.estimators.lmi_sdp import LmiSdp
from sdp_vs_penalty.formatting import words
from sdp_vs_penalty.ranges.allowed import AllowedSet, allowed_set
from sdp_vs_penalty.ranges.interior_point import barrier_hessian, split
from sdp_vs_penalty.ranges.table import training_of
from sdp_vs_penalty.robot import inertia
from sdp_vs_penalty.robot.arrays import Array, Indices, nonzero_or_one
from sdp_vs_penalty.solvers.small_cones import ORDER, SmallCones

PRIORS = ("flat", "entropic")
#: Chains that run as one array.
_CHAINS = 8
#: Sweeps of the warm-up, and between two samples of a chain; a sweep has as many steps as
#: there are parameters.
_WARM_UP, _BETWEEN = 20, 2
#: Largest R^ of chains that have forgotten where they began.
STATIONARY = 1.1
#: Samples pile up at a bound if their mean distance from it is below so many of the
#: distance's standard deviations.
_PILED_UP = 2.0
#: Share of the way from the centre to the boundary at which chains start.
_DISPERSION = 0.9
#: Draws of a move, at most, until one lies within the prior's slice.
_DRAWS = 30
#: Eigenvalues of the metric below this share of the largest are rounding.
_THIN = 1e-14

#: The longest chains that a sentence advises, in multiples of the default length.
_LONGEST = 16

#: -2 log of a prior (chains,) at theta (chains, p).
Penalty = Callable[[Array], Array]


@dataclass(frozen=True)
class Samples:
    """Consistent models, and how far they are independent."""

    #: (n, p) parameters, one model a row.
    theta: Array
    #: The stated prior, of PRIORS.
    prior: str
    #: (p,) effective number of independent samples for each parameter's mean.
    effective: Array
    #: (p,) split R^ of each parameter; near 1 for stationary chains.
    r_hat: Array
    #: Seed of all random numbers.
    seed: int
    #: Steps of each chain, those of the warm-up included.
    steps: int = 0
    #: Masses that pile up at their bound, which decides them: "m1 (below 100 kg)".
    bounded: tuple[str, ...] = ()
    #: Chains ran so many times as long as by default.
    longer: int = 1

    @property
    def is_stationary(self) -> bool:
        """Whether all chains have forgotten where they began."""
        return bool(np.all(self.r_hat < STATIONARY))

    @property
    def sentence(self) -> str:
        """What the samples are, and how good."""
        word = "stationary"
        if not self.is_stationary:
            word = (
                "not yet stationary: the slowest parameters' spread may be off;"
                f" {self._advice}"
            )
        least, most = (f"{x:.0f}" for x in (self.effective.min(), self.effective.max()))
        number = least if least == most else f"{least} to {most} by parameter"
        text = (
            f"{len(self.theta)} consistent models from likelihood and {self.prior} prior;"
            f" effective number {number}, split R^ at most"
            f" {self.r_hat.max():.3f} ({word})"
        )
        if self.bounded:
            text += (
                f". Bounds decide {words(self.bounded)}, not the data: only bounds that"
                " you believe (--bounds) make these fit to randomise with"
            )
        return text

    @property
    def _advice(self) -> str:
        """What would make the chains stationary."""
        more = 4 * self.longer
        if more <= _LONGEST:
            return f"longer chains mend it (longer={more}; --longer {more})"
        return (
            "narrower bounds of what the data leave open (`ranges`, --bounds) mend it"
            " sooner than even longer chains"
        )

    def __str__(self) -> str:
        """Return the sentence."""
        return self.sentence


def find_samples(
    model: Estimate | str | Path,
    n: int,
    data: Source | None = None,
    *,
    seed: int = 0,
    prior: str = "flat",
    longer: int = 1,
) -> Samples:
    """Draw consistent models that fit, from a model and data.

    Parameters
    ----------
    model : Estimate, str or Path
        A model, or its file: effects, filters and constraints.
    n : int
        Number of models that are drawn.
    data : path, arrays, Measurements, optional
        Default: those that the model was identified from, where their files are still
        there or the program holds them.
    prior : {"flat", "entropic"}
        "flat" in the standard parameters, or the pull of the default method.
    longer : int
        Chains run so many times as long, where the samples are not yet stationary.

    Returns
    -------
    Samples
        ``theta`` (n, p), effective numbers and R^.

    Raises
    ------
    InputError
        For the same input as :func:`~sdp_vs_penalty.ranges.table.find_ranges`.
    """
    estimate = as_estimate(model, "find_samples(model=...)")
    posed, floor = training_of(estimate, data)
    allowed = allowed_set(posed, estimate.theta, floor)
    return sample_models(allowed, n, seed, prior, longer)


def sample_models(
    allowed: AllowedSet, n: int, seed: int = 0, prior: str = "flat", longer: int = 1
) -> Samples:
    """Draw consistent models that fit.

    Parameters
    ----------
    n : int
        Number of models that are drawn.
    seed : int
        Seed of all random numbers.
    prior : str
        "flat" in the standard parameters, or "entropic".
    longer : int
        Chains run so many times as long as by default.

    Returns
    -------
    Samples
        Models, each within all constraints.

    Raises
    ------
    InputError
        For an unknown prior, or no models.
    """
    require_known("prior", prior, PRIORS)
    if n < 1:
        raise InputError(f"{n} samples", "ask for one at least")
    if longer < 1:
        raise InputError(f"chains {longer} times as long", "ask for one time at least")
    rng = np.random.default_rng(seed)
    # s: the rise of the loss at z standard deviations is (z s)^2.
    row_std = np.sqrt(allowed.first_rise) / allowed.z
    chains = Chains(
        allowed.cones,
        A=allowed.ball.A / row_std,
        a=allowed.ball.a / row_std,
        start=dispersed_starts(allowed, rng),
        rng=rng,
        penalty=_entropic_penalty(allowed.task) if prior == "entropic" else None,
        unseen=allowed.unseen[:, allowed.unseen.any(axis=0)],
    )
    # One state of each chain in so many sweeps is a sample. Chains run at least as long
    # as the warm-up, so that R^ has states to judge.
    sweeps_per_sample = longer * _BETWEEN
    n_of_chain = -(-n // _CHAINS)  # rounded up
    n_sweeps = max(sweeps_per_sample * n_of_chain, longer * _WARM_UP)
    states = chains.draw(n_sweeps, longer)
    samples = states[sweeps_per_sample - 1 :: sweeps_per_sample]
    theta = samples.reshape(-1, states.shape[2])
    chosen = chains.rng.permutation(len(theta))[:n]
    r_hat, effective = diagnose_chains(states)
    return Samples(
        theta=theta[chosen],
        prior=prior,
        effective=np.minimum(effective, n),
        r_hat=r_hat,
        seed=seed,
        steps=chains.n_steps,
        bounded=masses_by_bounds(theta, allowed.task),
        longer=longer,
    )


def masses_by_bounds(theta: Array, task: Task) -> tuple[str, ...]:
    """Return the masses whose samples, in theta (n, p), pile up at an upper bound, as
    "m1 (below 100 kg)".

    Their mean distance from it is then less than two of its standard deviations: it is
    1.7 for a uniform and 1 for an exponential distribution that ends at the bound. A
    normal distribution well below the bound has more.
    """
    names = []
    for k, place in enumerate(task.links[:, 0].tolist(), start=1):
        upper = float(task.box[k - 1, 0, 1])
        distance = upper - theta[:, place]
        if np.isfinite(upper) and distance.mean() < _PILED_UP * distance.std():
            names.append(f"m{k} (below {upper:g} kg)")
    return tuple(names)


def dispersed_starts(allowed: AllowedSet, rng: np.random.Generator) -> Array:
    """Return starts (chains, p) near the boundary of the set: from its centre in random
    directions, _DISPERSION of the way to the boundary.

    Directions are random in the local metric H of data and constraints, in which the set
    is about round.
    """
    cones = allowed.cones
    ball = allowed.ball
    centre = allowed.optimiser(allowed.first_rise).centre
    residual = ball.A @ centre - ball.a
    room = allowed.limit(allowed.first_rise) - residual @ residual
    hessian = ball.A.T @ ball.A / room + barrier_hessian(cones, centre)
    directions = _random_directions(hessian, rng)
    slacks = np.tile(cones.constant + cones.slack_map @ centre, (_CHAINS, 1))
    changes = (cones.slack_map @ directions.T).T
    _, to_cones = _multiples_inside(*split(cones, slacks), *split(cones, changes))
    # |residual + t A d|^2 = limit, solved for t without cancellation.
    torque = directions @ ball.A.T
    slope, square = torque @ residual, np.sum(torque**2, axis=1)
    to_ball = room / np.maximum(slope + np.sqrt(slope**2 + square * room), 1e-300)
    multiple = _DISPERSION * np.minimum(to_cones, to_ball)
    return centre + multiple[:, None] * directions


def _random_directions(hessian: Array, rng: np.random.Generator) -> Array:
    """Return a direction of each chain (chains, p): normal, with the covariance H^-1 of a
    Hessian H (p, p), whose thinnest axes are cut to what rounding leaves."""
    unit = np.sqrt(np.diagonal(hessian))
    eigenvalues, axes = np.linalg.eigh(hessian / np.outer(unit, unit))
    root = axes / np.sqrt(np.maximum(eigenvalues, _THIN * eigenvalues[-1]))
    return rng.standard_normal((_CHAINS, len(hessian))) @ root.T / unit


def _entropic_penalty(task: Task) -> Penalty:
    """Return the function that computes -2 log of the entropic prior (chains,) at theta
    (chains, p): k sum over links of tr(P0^-1 P) - log det P, P0 the nominal
    pseudo-inertia."""
    inverse_nominal = np.linalg.inv(task.prior_inertias)

    def penalty(theta: Array) -> Array:
        P = inertia.pseudo_inertia(theta[:, task.links])
        trace = np.sum(inverse_nominal * P, axis=(1, 2, 3))
        return LmiSdp.entropy * (trace - np.linalg.slogdet(P)[1].sum(axis=1))

    return penalty


class Chains:
    """Hit-and-run of many chains at once, for |A theta - a|^2 / 2 in small cones."""

    def __init__(
        self,
        cones: SmallCones,
        A: Array,
        a: Array,
        start: Array,
        rng: np.random.Generator,
        penalty: Penalty | None = None,
        unseen: Array | None = None,
    ) -> None:
        """Begin chains at starts (chains, p), or all at one (p,), strictly inside of the
        cones.

        Parameters
        ----------
        A : (r, p) array
            Rows in units of their standard deviation; a : (r,) what they observe.
        penalty : callable, optional
            -2 log of a prior that is not flat.
        unseen : (p, u) array, optional
            Directions that no torque shows.
        """
        self.cones = cones
        self.A = A
        self.a = a
        self.rng = rng
        self.penalty = penalty
        self.unseen = np.zeros((start.shape[-1], 0)) if unseen is None else unseen
        self.theta = np.broadcast_to(start, (_CHAINS, start.shape[-1])).copy()
        #: Steps that each chain has made.
        self.n_steps = 0
        self._evaluate_state()
        self._set_directions()

    def draw(self, sweeps: int, longer: int = 1) -> Array:
        """Return the states (sweeps, chains, p) after each sweep that follows a warm-up.

        The warm-up is ``longer`` times as long as by default, and at least half as long
        as what follows: principal axes are known only as well as the states they are
        computed from."""
        quarter = max(longer * _WARM_UP, sweeps // 2) // 4
        self._run(quarter)
        self._set_directions()
        self._run(quarter)
        self._set_directions()
        states = self._run(quarter)
        self._set_directions(states)
        self._set_directions(np.concatenate([states, self._run(quarter)]))
        return self._run(sweeps)

    def _set_directions(self, states: Array | None = None) -> None:
        """Set the three kinds of directions of the moves.

        They are columns of the covariance by data and barrier at the chains' mean; those
        that no torque shows; and, where there are states (sweeps, chains, p), the
        principal axes of these.
        """
        barrier = barrier_hessian(self.cones, self.theta.mean(axis=0))
        precision = self.A.T @ self.A + barrier
        # Scaled to a unit diagonal: parameters differ by orders of magnitude.
        unit = np.sqrt(np.diagonal(precision))
        covariance = np.linalg.pinv(precision / np.outer(unit, unit), hermitian=True)
        directions = [covariance / unit[:, None], self.unseen]
        if states is not None:
            theta = states.reshape(-1, states.shape[2])
            std = nonzero_or_one(theta.std(axis=0))
            _, axes = np.linalg.eigh(np.cov((theta / std).T))
            directions.append(std[:, None] * axes)
        self.moves = [_Move.along(d, self.cones, self.A) for d in directions if d.size]

    def _evaluate_state(self) -> None:
        """Compute slacks and residuals from theta, so that rounding of the steps does not
        add up: rows (chains, rows), blocks (chains, blocks, 4, 4), residual (chains,
        r)."""
        slacks = self.cones.constant + (self.cones.slack_map @ self.theta.T).T
        self.rows, self.blocks = split(self.cones, slacks)
        self.residual = self.theta @ self.A.T - self.a

    def _run(self, sweeps: int) -> Array:
        """Make sweeps of p steps each; return the states (sweeps, chains, p) after each
        sweep."""
        states = np.empty((sweeps, *self.theta.shape))
        p = self.theta.shape[1]
        for sweep in range(sweeps):
            for _ in range(p):
                self._step(self.moves[self.n_steps % len(self.moves)])
                self.n_steps += 1
            self._evaluate_state()
            states[sweep] = self.theta
        return states

    def _step(self, move: _Move) -> None:
        """Move each chain to theta + t d, d a random direction of the move for each chain.

        Along d the data make t normal, the cones cut it to [lowest, highest], and a prior
        that is not flat weighs it.
        """
        chosen = self.rng.integers(move.directions.shape[0], size=_CHAINS)
        d = move.directions[chosen]
        slacks = move.slacks[chosen]
        row_changes = slacks[:, : len(move.rows)]
        block_changes = slacks[:, len(move.rows) :].reshape(_CHAINS, -1, ORDER, ORDER)
        torque = move.torques[chosen]
        lowest, highest = _multiples_inside(
            self.rows[:, move.rows],
            self.blocks[:, move.blocks],
            row_changes,
            block_changes,
        )
        # |residual + t A d|^2 / 2 is a normal distribution's exponent in t.
        square = np.maximum(np.sum(torque**2, axis=1), 1e-300)
        mean = -np.sum(torque * self.residual, axis=1) / square
        std = 1.0 / np.sqrt(square)
        if self.penalty is None:
            t = _draw_truncated_normal(mean, std, lowest, highest, self.rng)
        else:
            t = self._within_slice(self.penalty, d, mean, std, lowest, highest)
        self.theta += t[:, None] * d
        self.rows[:, move.rows] += t[:, None] * row_changes
        self.blocks[:, move.blocks] += t[:, None, None, None] * block_changes
        self.residual += t[:, None] * torque

    def _within_slice(
        self,
        penalty: Penalty,
        d: Array,
        mean: Array,
        std: Array,
        low: Array,
        high: Array,
    ) -> Array:
        """Return moves (chains,) along directions d (chains, p) that leave the normal
        distributions on [low, high] times the prior as they are.

        The slice (Neal, Annals of Statistics 2003) is where the prior's density exceeds a
        random share of the present one: an interval, since the prior is log-concave. We
        draw from the normal distribution until a draw lies in the slice; a draw outside
        of it is the interval's next end. A chain without such a draw stays.
        """
        highest = penalty(self.theta) - 2.0 * np.log(self.rng.random(len(d)))
        t = np.zeros(len(d))
        is_open = np.ones(len(d), bool)
        for _ in range(_DRAWS):
            drawn = _draw_truncated_normal(
                mean, std, low, high, self.rng, reflects=False
            )
            inside = penalty(self.theta + drawn[:, None] * d) <= highest
            t = np.where(is_open & inside, drawn, t)
            is_open &= ~inside
            if not is_open.any():
                break
            high = np.where(is_open & (drawn > 0.0), drawn, high)
            low = np.where(is_open & (drawn < 0.0), drawn, low)
        return t


@dataclass(frozen=True)
class _Move:
    """k directions, and what each changes."""

    #: (k, p) directions of theta.
    directions: Array
    #: Rows of the cones that any of the directions changes.
    rows: Indices
    #: Blocks of the cones that any of the directions changes.
    blocks: Indices
    #: (k, rows + 16 blocks) changes of these rows' and blocks' slacks.
    slacks: Array
    #: (k, r) changes of the data's rows.
    torques: Array

    @classmethod
    def along(cls, directions: Array, cones: SmallCones, A: Array) -> _Move:
        """Return the move along directions, columns (p, k); A (r, p) maps theta to the
        data's rows."""
        row_changes, block_changes = split(cones, (cones.slack_map @ directions).T)
        rows = np.flatnonzero(row_changes.any(axis=0))
        blocks = np.flatnonzero(block_changes.any(axis=(0, 2, 3)))
        flat_blocks = block_changes[:, blocks].reshape(directions.shape[1], -1)
        slacks = np.hstack([row_changes[:, rows], flat_blocks])
        return cls(directions.T.copy(), rows, blocks, slacks, (A @ directions).T.copy())


def _multiples_inside(
    rows: Array, blocks: Array, row_changes: Array, block_changes: Array
) -> tuple[Array, Array]:
    """Return the lowest and the highest multiple t (chains,) of changes of slacks at which
    rows s + t ds and blocks S + t dS stay inside the cones.

    Rows and their changes are (chains, rows), blocks (chains, blocks, 4, 4). A row ends
    at t = -s / ds, a block S = L L^T at -1 over an eigenvalue of L^-1 dS L^-T.
    """
    root = np.linalg.inv(np.linalg.cholesky(blocks))
    relative_blocks = root @ block_changes @ np.swapaxes(root, 2, 3)
    eigenvalues = np.linalg.eigvalsh(relative_blocks).reshape(len(rows), -1)
    relative = np.hstack([row_changes / rows, eigenvalues])
    # A hair inside, so that rounding leaves no chain outside.
    inside = 1.0 - 1e-9
    return (
        -inside / np.maximum(relative.max(axis=1, initial=0.0), 1e-300),
        -inside / np.minimum(relative.min(axis=1, initial=0.0), -1e-300),
    )


def _draw_truncated_normal(
    mean: Array,
    std: Array,
    low: Array,
    high: Array,
    rng: np.random.Generator,
    reflects: bool = True,
) -> Array:
    """Return moves t (chains,) from t = 0 that leave normal distributions of ``mean`` and
    ``std``, cut to [low, high], as they are (all (chains,)).

    Half of the moves are samples; the others reflect the present quantile u to 1 - u
    (overrelaxation: Neal 1998), which keeps chains from wandering. Without ``reflects``
    all are samples.
    """
    # Ends and present point in standard deviations from the mean, mirrored to the lower
    # tail, where the distribution function has its digits.
    a, b, present = ((x - mean) / std for x in (low, high, np.zeros_like(mean)))
    sign = np.where(a > 0.0, -1.0, 1.0)
    lower, upper = np.minimum(sign * a, sign * b), np.maximum(sign * a, sign * b)
    log_lower, log_present, log_upper = scipy.special.log_ndtr(
        np.array([lower, np.clip(sign * present, lower, upper), upper])
    )
    # Quantile u of the present point in the cut distribution. On a short interval, where
    # the difference of distribution functions has no digits, the normal is flat.
    is_flat = b - a < 1e-5
    below = np.exp(log_lower - log_upper)  # what is cut off, over what lies below upper
    flat_u = -low / (high - low)
    with np.errstate(invalid="ignore", divide="ignore"):
        u = (np.exp(log_present - log_upper) - below) / (1.0 - below)
    u = np.where(is_flat, np.where(sign > 0.0, flat_u, 1.0 - flat_u), u)
    # The next quantile, and the t that has it.
    is_sample = rng.random(len(mean)) < (0.5 if reflects else 1.0)
    u = np.where(is_sample, rng.random(len(mean)), 1.0 - u)
    u = np.clip(u, 0.0, 1.0)
    quantile = below + u * (1.0 - below)
    x = scipy.special.ndtri_exp(log_upper + np.log(np.maximum(quantile, 1e-300)))
    t = mean + std * sign * np.clip(x, lower, upper)
    flat_t = low + np.where(sign > 0.0, u, 1.0 - u) * (high - low)
    return np.clip(np.where(is_flat, flat_t, t), low, high)


def diagnose_chains(drawn: Array) -> tuple[Array, Array]:
    """Return split R^ (p,) and the effective number of samples (p,) of chains.

    Split R^ compares the variance between half chains with that within them; it is near
    1 once both halves of all chains have the same distribution. The effective number is
    that of independent samples whose mean is as certain.

    Parameters
    ----------
    drawn : (T, chains, p) array
        T samples of each chain.
    """
    T, n_chains, p = drawn.shape
    half = T // 2
    halves = np.concatenate([drawn[:half], drawn[T - half :]], axis=1)
    within = halves.var(axis=0, ddof=1).mean(axis=0)
    between = half * halves.mean(axis=0).var(axis=0, ddof=1)
    within = np.where(within > 0.0, within, 1.0)
    r_hat = np.sqrt((half - 1) / half + between / (half * within))
    # Autocorrelation, averaged over the chains, against the pooled variance.
    pooled = (half - 1) / half * within + between / half
    centred = drawn - drawn.mean(axis=(0, 1))
    correlation_time = np.ones(p)  # 1 + 2 sum of autocorrelations, in samples
    # Geyer: sums of two neighbouring lags count until the first that is not positive.
    is_open = np.ones(p, bool)
    for lag in range(1, T - 1, 2):
        pair = sum(
            np.mean(centred[k:] * centred[: T - k], axis=(0, 1)) / pooled
            for k in (lag, lag + 1)
        )
        is_open &= pair > 0.0
        if not is_open.any():
            break
        correlation_time += np.where(is_open, 2.0 * pair, 0.0)
    n_drawn = float(T * n_chains)
    return r_hat, np.minimum(T * n_chains / correlation_time, n_drawn)
