"""The one evidence: how probable the torques of a log are as seen under a transform.

One arm is fitted to the torques of all joints. With E_j and S_j the squared torque of joint
j and what the arm leaves of it, N_j its independent rows less the columns of its own motion
(friction, rotor, offset and the laws that arms have and models lack, projected out), theta
(s,) the links' independent parameters and the sizes of extra columns, with their prior
N(m, P^-1), A_j their columns:

    log p = -1/2 sum_j N_j log(S_j / E_j) - 1/2 (theta - m)^T P (theta - m)
            - 1/2 log det(H P^-1) + sum_j log 2 Phi(z_j),    H = P + sum_j N_j / S_j A_j^T A_j,

z_j the mean power of joint j's friction over its standard deviation: friction takes power.
The evidence does not depend on units and gains of the channels.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import groupby
from typing import NamedTuple

import numpy as np
from scipy.special import log_ndtr

from sdp_vs_penalty.data.plausibility import far_outside
from sdp_vs_penalty.race import constants as c
from sdp_vs_penalty.race.arm_fit import RepairedRows, orthonormal
from sdp_vs_penalty.race.chain import LogTransform
from sdp_vs_penalty.race.likelihood import ROWS_AT_A_TIME, Likelihood, recent
from sdp_vs_penalty.race.records import Hypothesis, LogView, Number, Part
from sdp_vs_penalty.race.rows import OFFSET
from sdp_vs_penalty.regression.evidence import independent_rows, jackknifed
from sdp_vs_penalty.regression.normal_equations import NormalEquations
from sdp_vs_penalty.robot.arrays import Array, Indices, Mask, nonzero_or_one

#: Rounds of reweighting each joint by its own residual.
_ROUNDS = 4
#: Least share of the independent rows that counts, however many own columns there are [-].
_LEAST_SHARE = 0.1
#: Factor of the prior standard deviations of a link whose parameters are a guess [-].
_GUESSED = 3.0
#: Standard deviation of a URDF's centre of mass, over the joint's reach [-].
_CENTRE = 1.0 / 15.0
#: A logarithm's argument, a divisor: no smaller than this.
_TINY = 1e-280


class _Prior(NamedTuple):
    """What is known of s parameters beforehand: N(mean, inverse^-1)."""

    #: (s,) their expected values.
    mean: Array
    #: (s, s) inverse of their covariance.
    inverse: Array
    #: Natural logarithm of the inverse's determinant.
    log_determinant: float
    #: (s, s) their covariance that errors of a URDF's centres of mass make.
    of_centres: Array


@dataclass(frozen=True)
class _Columns:
    """What all fits to one motion share, of n joints, M rows and s parameters."""

    #: Columns of the links and extra ones, and a basis of each joint's own.
    rows: RepairedRows
    #: (n, M) the probe of friction's power: velocity without its part in proportion to the
    #: acceleration, of unit norm, so that an inertia has no part in the power.
    probe: Array
    #: (n, s) products of the probe with the columns.
    power: Array
    #: (n,) number of rows that count.
    count: Array


@dataclass(frozen=True)
class ViewFit:
    """One arm fitted to the rows of a view, with the evidence of the view."""

    #: How the rows are seen.
    view: LogView
    #: Columns of the motion.
    columns: _Columns
    #: (n, s) products of the projected columns with the torque.
    cross: Array
    #: (n,) squared torque with own columns projected out.
    energy: Array
    #: (n,) squared torque.
    total: Array
    #: (n,) product of the probe with the torque.
    probed: Array
    #: Number of correlated rows that are worth one independent row.
    rows_worth_one: float = 1.0
    #: (s,) parameters of the links, then sizes of extra columns.
    theta: Array = None  # type: ignore[assignment]
    #: Size of the arm beside the nominal one [-].
    scale: float = 1.0
    #: (n,) squared residual.
    energy_left: Array = None  # type: ignore[assignment]
    #: (n,) weights of the rows with which they were fitted.
    weights: Array = None  # type: ignore[assignment]
    #: (s, s) information on the parameters, prior included.
    information: Array = None  # type: ignore[assignment]
    #: Log evidence.
    log_evidence: float = 0.0
    #: Log evidence of friction's power, whether or not ``value`` holds it.
    friction_evidence: float = 0.0
    #: Log evidence that is lost since the links are not the nominal ones.
    cost_of_links: float = 0.0

    @property
    def transform(self) -> LogTransform:
        """What is done to all rows."""
        return self.view.transform

    @property
    def links(self) -> Array:
        """(s,) parameters of the links."""
        n_extra = sum(len(extra.sd) for extra in self.view.extra_torques)
        return self.theta[: len(self.theta) - n_extra]

    @property
    def shares_left(self) -> Array:
        """(n,) share of each torque's energy that is left."""
        return self.energy_left / self.total

    @property
    def is_poorly_explained(self) -> Mask:
        """(n,) whether the arm leaves more of a joint's torque than errors of friction laws
        and filters: its logged motion may be wrong."""
        return self.shares_left > c.POORLY

    @property
    def is_badly_explained(self) -> bool:
        """Whether much is left of a moving joint's torque: something is missing, or two
        mistakes were made."""
        return bool((self.shares_left[self.weights > 0.0] > c.BADLY).any())

    @property
    def may_be_rearranged(self) -> bool:
        """Whether several mistakes at once may hide in the fit: much is left of a torque,
        or links far from the nominal ones explain it."""
        is_far = self.cost_of_links > c.LOG_ODDS_OF_A_CLAIM
        return self.is_badly_explained or is_far


@dataclass(frozen=True)
class _Arms:
    """Arms that are fitted to K views, each to n moving joints, of s parameters."""

    #: (K, s) parameters.
    theta: Array
    #: (K,) size of the arm beside the nominal one [-].
    scale: Array
    #: (K, s) unit of each parameter: that size of links, 1 of extra columns.
    unit: Array
    #: (K, n) squared residuals.
    energy_left: Array
    #: (K, n) weights of the rows with which they were fitted.
    weights: Array
    #: (K, s, s) inverse covariance of the parameters beforehand, of links of that size.
    prior: Array
    #: (K, s, s) information on the parameters, prior included.
    information: Array
    #: (K, s) the nominal parameters times the information of the rows alone.
    nominal: Array
    #: (K,) product of the arm with the nominal one, by what the rows show.
    likeness: Array


@dataclass(frozen=True)
class _Products:
    """Products of columns and torques of K views, of n moving joints and s columns."""

    #: Places of the views of one motion, and their Gram matrix (n, s, s).
    grams: list[tuple[slice, Array]]
    #: (K, n, s) products of columns and torque.
    cross: Array
    #: (K, n) squared torque beside own columns.
    energy: Array
    #: (K, n) squared torque.
    total: Array
    #: (K, n, s) products of the probe of friction with the columns.
    probe_on_columns: Array
    #: (K, n) products of the probe with the torque.
    probe_on_torque: Array

    @classmethod
    def of_views(cls, views: Sequence[ViewFit], moving: Mask) -> _Products:
        """Stack the products of views; those of one motion follow each other."""
        grams: list[tuple[slice, Array]] = []
        first = 0
        for _, of_motion in groupby(views, lambda x: id(x.columns)):
            columns = [x.columns for x in of_motion]
            places = slice(first, first + len(columns))
            grams.append((places, columns[0].rows.gram[moving]))
            first = places.stop
        return cls(
            grams=grams,
            cross=np.stack([x.cross for x in views])[:, moving],
            energy=np.stack([x.energy for x in views])[:, moving],
            total=np.stack([x.total for x in views])[:, moving],
            probe_on_columns=np.stack([x.columns.power for x in views])[:, moving],
            probe_on_torque=np.stack([x.probed for x in views])[:, moving],
        )

    def _of_nominal_arm(self, mean: Array) -> Array:
        """Return the squared torques (K, n) of the nominal arm, of parameters ``mean``
        (s,)."""
        squares = np.empty_like(self.energy)
        for at, gram in self.grams:
            squares[at] = gram @ mean @ mean
        return squares

    def fit_arms(
        self, n_rows: Array, prior: _Prior, n_links: int, rounds: int
    ) -> _Arms:
        """Fit an arm to each view by iteratively reweighted least squares.

        Each round weights a joint's rows by its residual, and scales the prior of the
        links by the size of the arm relative to the nominal one. The first round takes the
        size of the torques, since a prior of a wrong size would pull the fit to that size.

        Parameters
        ----------
        n_rows : (K, n) array
            Numbers of independent rows.
        n_links : int
            How many of the first parameters are the links'.
        """
        mean, inverse = prior.mean, prior.inverse
        s, count = len(mean), len(n_rows)
        is_link = np.arange(s) < n_links
        energy_left = np.maximum(self.energy, c.FLOOR * self.total)
        of_nominal = self._of_nominal_arm(mean)
        scale = _sizes(self.energy, of_nominal)
        information_of_rows = np.empty((count, s, s))
        change = np.empty_like(energy_left)
        for _ in range(rounds):
            weights = n_rows / energy_left  # (K, n)
            for at, gram in self.grams:
                flat = weights[at] @ gram.reshape(-1, s * s)
                information_of_rows[at] = flat.reshape(-1, s, s)
            unit = np.where(is_link, scale[:, None], 1.0)  # (K, s)
            scaled_inverse = inverse / (unit[:, :, None] * unit[:, None, :])
            right = (weights[:, None] @ self.cross)[:, 0] + (inverse @ mean) / unit
            information = information_of_rows + scaled_inverse
            theta = np.linalg.solve(information, right[..., None])[..., 0]
            # Change of the squared residual: theta^T G theta - 2 theta^T c.
            for at, gram in self.grams:
                gram_theta = (theta[at] @ gram).swapaxes(0, 1)  # (k, n, s)
                factor = gram_theta - 2.0 * self.cross[at]
                change[at] = (factor @ theta[at, :, None])[..., 0]
            energy_left = np.maximum(self.energy + change, c.FLOOR * self.total)
            nominal = information_of_rows @ mean  # (K, s)
            likeness = np.sum(theta * nominal, axis=1)
            scale = _sizes(np.maximum(self.energy - energy_left, 0.0), of_nominal)
        return _Arms(
            theta=theta,
            scale=scale,
            unit=unit,
            energy_left=energy_left,
            weights=weights,
            prior=scaled_inverse,
            information=information,
            nominal=nominal,
            likeness=likeness,
        )


def _sizes(energy: Array, of_nominal: Array) -> Array:
    """Return the size (K,) of arms relative to the nominal one [-].

    It is the median over the joints of torque over nominal torque, from squared torques
    (K, n), so that no single joint sets it; 1 where the nominal arm has no torque.
    """
    sizes = np.sqrt(energy / nonzero_or_one(of_nominal))
    ranked = np.sort(np.where(of_nominal > 0.0, sizes, 1.0), axis=1)
    n = ranked.shape[1]
    # Faster than NumPy's median, of few joints.
    median = 0.5 * (ranked[:, (n - 1) // 2] + ranked[:, n // 2])
    return np.asarray(np.clip(nonzero_or_one(median), 1e-9, 1e9))


def _evidence_of_fit(arms: _Arms, total: Array, n_rows: Array, prior: _Prior) -> Array:
    """Return the log evidence (K,) of the fit and of the number of parameters.

    It is -1/2 sum N log(S / E) - 1/2 log det(H P^-1) of the module's equation, less the
    price of an arm whose size is not the nominal one.

    total, n_rows (K, n) : squared torques E, and numbers N of independent rows.
    """
    value = -0.5 * np.sum(n_rows * np.log(arms.energy_left / total), axis=1)
    value -= 0.5 * (np.linalg.slogdet(arms.information)[1] - prior.log_determinant)
    value -= np.sum(np.log(arms.unit), axis=1)
    cost_of_scale = 0.5 * (np.log(arms.unit[:, 0]) / c.MASSES_KNOWN) ** 2
    value -= np.minimum(cost_of_scale, c.LOG_ODDS_AGAINST_FAULT)
    return np.asarray(value)


class _Friction(NamedTuple):
    """Power that friction takes under K views, of n moving joints."""

    #: (K, n) product of the probe of unit norm with the torque that the links do not
    #: explain: positive where friction brakes.
    power: Array
    #: (K, n) its standard deviation.
    sd: Array

    def evidence_of_dissipation(self, directions: Array) -> Array:
        """Return the log evidence (K,) that friction takes power: sum_j log 2 Phi(z_j), z_j
        the power over its standard deviation.

        directions : (K,) -1 where time runs backwards, else 1.
        """
        z = directions[:, None] * self.power / self.sd
        log_odds = np.log(2.0) + log_ndtr(z)
        return np.sum(np.maximum(log_odds, -c.MAX_PHYSICS_LOG_ODDS), axis=1)

    def evidence_of_compensation(self, total: Array) -> Array:
        """Return the log evidence (K,) that a controller compensates friction, which leaves
        little of it, of either sign; total (K, n) : squared torques."""
        shares = self.power / np.sqrt(total)
        cost = np.minimum(0.5 * (shares / c.COMPENSATED) ** 2, c.MAX_PHYSICS_LOG_ODDS)
        return -np.sum(cost, axis=1)


def _friction(
    products: _Products, arms: _Arms, n_rows: Array, variance: Array
) -> _Friction:
    """Return the power of friction under each view.

    n_rows, variance (K, n) : numbers of independent rows; variance of the power by that of
    the arm's parameters, to which that of the noise is added.
    """
    of_arms = (products.probe_on_columns @ arms.theta[..., None])[..., 0]
    sd = np.sqrt(np.maximum(arms.energy_left / n_rows + variance, _TINY))
    return _Friction(products.probe_on_torque - of_arms, sd)


def _variances(arms: _Arms, columns: Array) -> Array:
    """Return the variances (K, r) of r linear functions of each arm's parameters, by their
    coefficients (K, s, r)."""
    return np.asarray(
        np.sum(columns * np.linalg.solve(arms.information, columns), axis=1)
    )


def _cost_of_links(arms: _Arms, prior: _Prior, variance: Array) -> Array:
    """Return the log evidence (K,) that arms lose because their links are not the nominal
    ones.

    The links must also resemble the nominal ones rather than their mirror image, unless
    their centres are so near the axes that they may lie on the other side.
    variance : (K,) of the likeness.
    """
    z = arms.likeness / np.sqrt(np.maximum(variance, _TINY))
    log_odds_of_mirror = np.log(2.0) + log_ndtr(z)
    prior_sd = np.sqrt(np.sum(arms.nominal * (arms.nominal @ prior.of_centres), axis=1))
    prior_z = arms.nominal @ prior.mean / np.maximum(prior_sd, _TINY)
    least = np.maximum(np.log(2.0) + log_ndtr(-prior_z), -c.MAX_PHYSICS_LOG_ODDS)
    difference = arms.theta - prior.mean * arms.unit
    squares = difference * (arms.prior @ difference[..., None])[..., 0]
    return np.asarray(
        0.5 * np.sum(squares, axis=1) - np.maximum(log_odds_of_mirror, least)
    )


class Evidence:
    """The evidence of views of one log, of M rows and n joints.

    log : the rows, with each joint's laws among its own columns.
    """

    def __init__(self, log: Likelihood) -> None:
        """Take the rows."""
        self.log = log
        self._prior = self._prior_of_links()

    def of_rows(self, rows: slice | Indices) -> Evidence:
        """Return the evidence of some of the rows."""
        return Evidence(self.log.select_rows(rows))

    def rows_of(self, part: Part) -> Mask:
        """Return which rows (M,) belong to a part."""
        return part.rows(self.log.data.run, self.log.data.motion.t)

    # -- what is known beforehand

    def _prior_of_links(self) -> _Prior:
        """Return the prior of the links' independent parameters.

        Standard deviations of a nominal link: half of its mass; a fifteenth of the joint's
        reach for its centre; the inertia of its mass at two fifths of the reach. They are
        three times as large for a link that is a guess, and for the centre of the last
        link, which may carry a tool.
        """
        data = self.log.data
        if data.shared is None:
            return _Prior(np.zeros(0), np.zeros((0, 0)), 0.0, np.zeros((0, 0)))
        dependence = data.dependence
        links = self.log.problem.prior_links
        sd_of_links, sd_of_centres = self._sd_of_links()
        p = len(data.shared.parameters)
        rigid = data.shared.rigid_indices
        # Couplings, and other parameters that joints share, may be as large as a link's.
        mean, sd = np.zeros(p), np.full(p, np.median(sd_of_links[:, 0], axis=0))
        mean[rigid] = links.ravel()[: len(rigid)]
        sd[rigid] = sd_of_links.ravel()[: len(rigid)]
        covariance = (dependence * sd**2) @ dependence.T
        sd = np.zeros(p)
        sd[rigid] = sd_of_centres.ravel()[: len(rigid)]
        of_centres = (dependence * sd**2) @ dependence.T
        variances = np.diag(covariance)
        # A little more, so that the covariance has an inverse.
        ridge = 1e-9 * variances + 1e-14 * variances.sum()
        covariance = covariance + np.diag(ridge)
        inverse = np.linalg.inv(covariance)
        inverse = 0.5 * (inverse + inverse.T)
        log_determinant = -float(np.linalg.slogdet(covariance)[1])
        return _Prior(dependence @ mean, inverse, log_determinant, of_centres)

    def _sd_of_links(self) -> tuple[Array, Array]:
        """Return the prior standard deviations (links, 10) of the links' standard
        parameters, and what errors of a URDF's centres of mass contribute (links, 10);
        see :meth:`_prior_of_links`."""
        problem = self.log.problem
        links = problem.prior_links
        distances = np.maximum(problem.robot.link_reach(), 0.05)
        distances = np.resize(distances, len(links))
        mass = links[:, 0] + 0.05 * np.median(links[:, 0]) + 1e-3
        mass = mass * np.where(problem.guessed_links, _GUESSED, 1.0)
        sd = np.empty((len(links), 10))
        sd[:, 0] = 0.5 * mass
        centres = np.zeros_like(sd)
        centres[:, 1:4] = _CENTRE * (mass * distances)[:, None]
        sd[:, 1:4] = 0.5 * np.abs(links[:, 1:4]) + centres[:, 1:4]
        sd[-1, 1:4] += (_GUESSED - 1.0) * centres[-1, 1:4]
        inertia = mass * (0.4 * distances) ** 2
        sd[:, 4:] = inertia[:, None] + np.abs(links[:, 4:])
        return sd, centres

    @property
    def covariance_of_links(self) -> Array:
        """(s, s) covariance of the links' independent parameters beforehand."""
        return np.asarray(np.linalg.inv(self._prior.inverse), float)

    def nominal_size(self, columns: Array) -> float:
        """Return the root of the expected sum of squares of the nominal links' torques
        [N m, N]: sqrt(tr(Y^T Y E[theta theta^T])), with the prior's error of the centres of
        mass.

        columns : (n, M, s) Y, of the links' independent parameters.
        """
        gram = np.tensordot(columns, columns, ((0, 1), (0, 1)))
        mean = self._prior.mean
        second_moment = np.outer(mean, mean) + self._prior.of_centres
        return float(np.sqrt(np.maximum(np.sum(gram * second_moment), _TINY)))

    def _prior_of(self, view: LogView) -> _Prior:
        """Return the prior of a view's parameters: those of the links, then the sizes of
        its extra columns about zero."""
        links = self._prior
        if not view.extra_torques:
            return links
        sd = np.concatenate([extra.sd for extra in view.extra_torques])
        s = len(links.mean)
        inverse = np.diag(np.concatenate([np.zeros(s), sd**-2.0]))
        inverse[:s, :s] = links.inverse
        log_determinant = links.log_determinant - 2.0 * float(np.sum(np.log(sd)))
        mean = np.concatenate([links.mean, np.zeros(len(sd))])
        of_centres = np.zeros_like(inverse)
        of_centres[:s, :s] = links.of_centres
        return _Prior(mean, inverse, log_determinant, of_centres)

    # -- rows as seen

    @recent(8)
    def _columns(self, motion: LogView) -> _Columns:
        """Make what all fits to one motion share: columns, and the probe of friction."""
        log, transform = self.log, motion.transform
        basis, raw = log.basis(transform), log.raw(transform)
        mask, states = log.torque_mask(transform), self._states(transform)
        if motion.parts:
            raw, states, mask = raw.copy(), states.copy(), mask.copy()
            for part, part_transform in motion.parts:
                rows, of_part = (
                    self.rows_of(part),
                    part_transform.followed_by(transform),
                )
                raw[:, rows] = log.raw(of_part)[:, rows]
                mask[:, rows] = log.torque_mask(of_part)[:, rows]
                states[:, :, rows] = self._states(of_part)[:, :, rows]
            own_columns = self._own_columns_with_parts(motion)
            # Else the cached basis of all rows is that of the view.
            if own_columns is not None:
                basis = orthonormal(own_columns * mask[:, :, None])
        if motion.extra_torques:
            extra = [x.columns * mask[:, :, None] for x in motion.extra_torques]
            raw = np.concatenate([raw, *extra], axis=2)
        states = states - states.mean(axis=2, keepdims=True)
        velocity = without_inertial_power(*(states * mask))
        norms = np.linalg.norm(velocity, axis=1, keepdims=True)
        probe = velocity / nonzero_or_one(norms)
        power = (probe[:, None] @ raw)[:, 0]
        repaired = RepairedRows.from_basis(basis, raw)
        return _Columns(repaired, probe, power, mask.sum(axis=1))

    def _own_columns_with_parts(self, motion: LogView) -> Array | None:
        """Return the joints' own columns (n, M, k) with those of each part on its rows, and
        a column for each of its events; None if no part changes them."""
        t = self.log.data.motion.t
        own_columns = self._own_columns(motion.transform, motion.transform)
        is_changed = False
        for part, part_transform in motion.parts:
            rows = self.rows_of(part)
            of_part = part_transform.followed_by(motion.transform)
            own_of_part = self._own_columns(of_part, motion.transform)[:, rows]
            is_changed |= not np.array_equal(own_columns[:, rows], own_of_part)
            own_columns[:, rows] = own_of_part
            for event in part_transform.events:
                column = np.zeros((*own_columns.shape[:2], 1))
                column[event.joint, rows] = event.shape(t[rows])
                own_columns = np.concatenate([own_columns, column], axis=2)
                is_changed = True
        return own_columns if is_changed else None

    def _own_columns(self, transform: LogTransform, of_all_rows: LogTransform) -> Array:
        """Return the joints' own columns (n, M, k) under a part's transform, for the
        parameters that belong to the transform of all rows.

        Friction changes its sign where the part's velocity does; the offset keeps it.
        """
        data = self.log.data
        columns = data.own_columns[list(transform.order)]
        sign = np.sign(np.array(transform.scale) / np.array(of_all_rows.scale))
        of_time = np.where(data.turns, -1.0 if transform.reversed else 1.0, 1.0)
        turned = columns * (sign[:, None] * of_time)[:, None, :]
        turned[:, :, OFFSET] = columns[:, :, OFFSET]
        return turned

    def _states(self, transform: LogTransform) -> Array:
        """Return velocity and acceleration (2, n, M) of the motors under a transform."""
        motion = self.log.motion(transform.with_defaults("carried"))
        velocity = -motion.dq.T if transform.reversed else motion.dq.T
        return np.stack([velocity, motion.ddq.T])

    def _torque(self, view: LogView) -> Array:
        """Return the torque (n, M) [N m, N] of a view, each part under its transform."""
        torque = self.log.channels(view.transform)
        for part, part_transform in view.parts:
            of_part = self.log.channels(part_transform.followed_by(view.transform))
            torque = np.where(self.rows_of(part), of_part, torque)
        return torque

    def _total(self, view: LogView, squares: Array) -> Array:
        """Return the squared torque (n,) [(N m)^2, N^2] that squared residuals are divided
        by, so that the evidence does not depend on gains.

        If parts have gains of their own, it is the squared torque without these gains,
        times each squared gain to the power of its part's share of the rows.
        squares (n,) : squared torque of the view.
        """
        if not view.parts:
            return np.maximum(squares, _TINY)
        total = np.sum(self.log.channels(view.transform) ** 2, axis=1)
        for part, part_transform in view.parts:
            share = np.mean(self.rows_of(part))
            total = total * np.abs(part_transform.torque_factors) ** (2.0 * share)
        return np.maximum(total, _TINY)

    # -- fits

    def _unfitted(self, columns: _Columns, views: Sequence[LogView]) -> list[ViewFit]:
        """Return K views of one motion with the products of their torque and its columns,
        but without parameters yet; see :meth:`fitted`."""
        torques = np.stack([self._torque(view) for view in views], axis=-1)  # (n, M, K)
        without_own = columns.rows.project_out_own(torques)  # (n, M, K)
        cross = columns.rows.products_with(without_own)  # (n, K, s)
        energy = np.sum(without_own**2, axis=1)  # (n, K)
        total = np.sum(torques**2, axis=1)  # (n, K)
        probed = (columns.probe[:, None, :] @ torques)[:, 0]  # (n, K)
        return [
            ViewFit(
                view=view,
                columns=columns,
                cross=cross[:, k],
                energy=energy[:, k],
                total=self._total(view, total[:, k]),
                probed=probed[:, k],
            )
            for k, view in enumerate(views)
        ]

    def fit(self, view: LogView, rows_worth_one: float) -> ViewFit:
        """Fit one arm to the rows of one view; so many correlated rows are worth one
        independent row."""
        unfitted = self._unfitted(self._columns(view.motion), [view])
        return self.fitted(unfitted, rows_worth_one)[0]

    def values(
        self, views: Sequence[LogView], rows_worth_one: float, rounds: int = _ROUNDS
    ) -> Array:
        """Return the log evidence (K,) of each of several views with the same number of
        extra columns.

        Parameters
        ----------
        rows_worth_one : float
            Rows that are worth one.
        rounds : int
            Of reweighting each joint by its own residual.
        """
        by_motion: dict[LogView, list[int]] = {}
        for k, view in enumerate(views):
            by_motion.setdefault(view.motion, []).append(k)
        values = np.empty(len(views))
        motions = [*by_motion]
        at_a_time = max(1, ROWS_AT_A_TIME // self.log.data.count)
        for first in range(0, len(motions), at_a_time):
            batch = motions[first : first + at_a_time]
            self.log.prepare_columns([x for motion in batch for x in motion.transforms])
            places = [k for motion in batch for k in by_motion[motion]]
            unfitted: list[ViewFit] = []
            for motion in batch:
                of_motion = [views[k] for k in by_motion[motion]]
                unfitted += self._unfitted(self._columns(motion), of_motion)
            values[places] = [
                x.log_evidence for x in self.fitted(unfitted, rows_worth_one, rounds)
            ]
        return values

    def fitted(
        self, products: Sequence[ViewFit], rows_worth_one: float, rounds: int = _ROUNDS
    ) -> list[ViewFit]:
        """Fit one arm to each of K views with known products, for so many rows that are
        worth one independent row; see :meth:`values`."""
        moving = self.log.moving
        stacked = _Products.of_views(products, moving)
        n_rows = np.stack([self._independent(x, rows_worth_one) for x in products])
        n_rows = n_rows[:, moving]
        prior = self._prior_of(products[0].view)
        arms = stacked.fit_arms(n_rows, prior, len(self._prior.mean), rounds)
        value = _evidence_of_fit(arms, stacked.total, n_rows, prior)
        value -= [self._price_of_events(x, rows_worth_one) for x in products]
        value += [
            self._velocity_evidence(x.view) + self.range_evidence(x.view)
            for x in products
        ]
        # Of friction's power at each joint, and of the likeness to the nominal links.
        nominal = arms.nominal[:, None]
        by_parameter = np.concatenate([stacked.probe_on_columns, nominal], axis=1)
        variances = _variances(arms, by_parameter.swapaxes(1, 2))  # (K, n + 1)
        friction = _friction(stacked, arms, n_rows, variances[:, :-1])
        directions = [-1.0 if x.transform.reversed else 1.0 for x in products]
        dissipation = friction.evidence_of_dissipation(np.array(directions))
        cost_of_links = _cost_of_links(arms, prior, variances[:, -1])
        value -= cost_of_links
        is_dissipative = np.array([x.view.is_friction_dissipative for x in products])
        compensation = friction.evidence_of_compensation(stacked.total)
        of_friction = np.where(is_dissipative, dissipation, compensation)
        fits = []
        for k, of_view in enumerate(products):
            energy_left = of_view.total.copy()
            energy_left[moving] = arms.energy_left[k]
            weights = np.zeros(len(energy_left))
            weights[moving] = arms.weights[k]
            fit = replace(
                of_view,
                rows_worth_one=rows_worth_one,
                theta=arms.theta[k],
                scale=float(arms.scale[k]),
                energy_left=energy_left,
                weights=weights,
                information=arms.information[k],
                log_evidence=float(value[k] + of_friction[k]),
                friction_evidence=float(dissipation[k]),
                cost_of_links=float(cost_of_links[k]),
            )
            fits.append(fit)
        return fits

    def with_rows_worth_one(self, fit: ViewFit, rows_worth_one: float) -> ViewFit:
        """Return a view fitted again with so many correlated rows worth one independent
        row; the fit itself if it has this number."""
        if fit.rows_worth_one == rows_worth_one:
            return fit
        return self.fitted([fit], rows_worth_one)[0]

    def _independent(self, fit: ViewFit, rows_worth_one: float) -> Array:
        """Return the number (n,) of independent rows of each joint, less its own columns."""
        count = fit.columns.count / rows_worth_one
        n_own = fit.columns.rows.basis.shape[2]
        return np.maximum(count - n_own, _LEAST_SHARE * count)

    def _velocity_evidence(self, view: LogView) -> float:
        """Return the log evidence of the logged velocities' signs: 0, or negative if a view
        contradicts them.

        A run whose velocities have the other sign than its positions' derivative has its
        rows in reverse order; with the same sign, they are in order.
        """
        of_parts = {
            part.run: part_transform.reversed for part, part_transform in view.parts
        }
        evidence = 0.0
        for run, sign in enumerate(self.log.data.velocity_signs):
            is_reversed = view.transform.reversed != of_parts.get(run, False)
            if sign < 0.0 and not is_reversed:
                evidence = min(evidence, c.VELOCITY_TURNED)
            elif sign > 0.0 and is_reversed:
                evidence = min(evidence, -c.MAX_PHYSICS_LOG_ODDS)
        return evidence

    @cached_property
    def _farthest(self) -> dict[int, Array]:
        """Smallest and largest position (2, n) [rad, m] of each channel, by run; only of
        runs whose angles lie far outside the joints' ranges."""
        q, runs = self.log.data.motion.q, self.log.data.run
        ends = {}
        for run in np.unique(runs).tolist():
            of_run = q[runs == run]
            ends[run] = np.array([of_run.min(axis=0), of_run.max(axis=0)])
        return {run: q for run, q in ends.items() if self._is_impossible(q)}

    def _is_impossible(self, q: Array) -> bool:
        """Whether positions (N, n) [rad, m] have angles far outside the joints' ranges."""
        far = far_outside(self.log.problem.robot, q)
        return any(j in self.log.revolute for j in far)

    def range_evidence(self, view: LogView) -> float:
        """Return the log evidence of the joints' ranges: -MAX_PHYSICS_LOG_ODDS if a view
        leaves angles far outside of them, else 0.

        Only runs whose angles are so as logged are looked at.
        """
        of_parts = {part.run: part_transform for part, part_transform in view.parts}
        for run, logged in self._farthest.items():
            before, transform = of_parts.get(run), view.transform
            transform = transform if before is None else before.followed_by(transform)
            if self._is_impossible(transform.positions(logged)):
                return -c.MAX_PHYSICS_LOG_ODDS
        return 0.0

    @staticmethod
    def _price_of_events(fit: ViewFit, rows_worth_one: float) -> float:
        """Return the log evidence that the sizes of a view's steps and drifts cost: half
        the logarithm of a joint's independent rows for each (Schwarz 1978)."""
        count = np.maximum(fit.columns.count / rows_worth_one, 1.0)
        events = [x for transform in fit.view.transforms for x in transform.events]
        return sum(0.5 * float(np.log(count[x.joint])) for x in events)

    def residual(self, fit: ViewFit) -> Array:
        """Return the torque (n, M) [N m, N] that the arm and each joint's own columns
        leave."""
        rows = fit.columns.rows
        beside_own = rows.project_out_own(self._torque(fit.view)[:, :, None])[:, :, 0]
        return beside_own - rows.projected @ fit.theta

    def estimate_rows_worth_one(self, fit: ViewFit) -> float:
        """Return how many correlated rows are worth one independent row: rows over
        independent rows by the autocorrelation of the residual, at least 1."""
        residual = self.residual(fit)[self.log.moving]
        return max(1.0, residual.shape[1] / independent_rows(residual))

    # -- numbers, to first order

    def slopes(
        self, fit: ViewFit, hypotheses: Sequence[Hypothesis], sizes: Sequence[float]
    ) -> Array:
        """Return the derivative (n, M, r) of the torque by the number of each of r
        hypotheses at a size; 0 on rows that the hypothesis is not about.

        By the logarithm of a gain it is minus the modelled torque, since the model's torque
        is divided by the gain; by other numbers it is a difference quotient.
        """
        modelled = self._torque(fit.view) - self.residual(fit)
        slopes = np.zeros((*modelled.shape, len(hypotheses)))
        # Hypotheses about one number of several parts share a slope: only their rows differ.
        places_by_number: dict[tuple[Number | None, float, bool], list[int]] = {}
        for k, (hypothesis, size) in enumerate(zip(hypotheses, sizes, strict=True)):
            key = hypothesis.number, size, hypothesis.part is None
            places_by_number.setdefault(key, []).append(k)
        # Columns, step of their number, and the transforms before and after the step.
        steps: list[tuple[list[int], float, LogTransform, LogTransform]] = []
        for (number, size, _), places in places_by_number.items():
            assert number is not None
            if number.field == "gain":
                for j in number.joints:
                    slopes[j][:, places] = -modelled[j][:, None]
            else:
                hypothesis = hypotheses[places[0]]
                before = hypothesis.at_size(fit.transform, size)
                after = hypothesis.at_size(fit.transform, size + number.step)
                steps.append((places, number.step, before, after))
        transforms = [*dict.fromkeys(x for _, _, *both in steps for x in both)]
        self.log.prepare_columns(transforms[: self.log.n_kept])
        unexplained = {x: self.log.unexplained(x, fit.links) for x in transforms}
        for places, step, before, after in steps:
            slope = (unexplained[before] - unexplained[after]) / step
            slopes[:, :, places] = slope[:, :, None]
        for k, hypothesis in enumerate(hypotheses):
            if hypothesis.part is not None:
                slopes[:, ~self.rows_of(hypothesis.part), k] = 0.0
        return slopes

    def score_test(
        self, fit: ViewFit, columns: Array, sd: Array
    ) -> tuple[Array, Array]:
        """Return for each extra column, added alone to a fit, its likeliest size (r,) and
        the information of the rows on that size (r,), to first order and with the noise as
        it is.

        Parameters
        ----------
        columns : (n, M, r) array
            Torque per unit of each size.
        sd : (r,) array
            Prior standard deviations of the sizes.
        """
        moving = self.log.moving
        rows = fit.columns.rows
        beside_own = rows.project_out_own(columns)[moving]
        weighted = fit.weights[moving][:, None, None] * beside_own
        with_arm = np.tensordot(rows.projected[moving], weighted, ((0, 1), (0, 1)))
        alone = np.einsum("jmr,jmr->r", beside_own, weighted)
        of_arm = np.sum(with_arm * np.linalg.solve(fit.information, with_arm), axis=0)
        # Where the arm's parameters span a column, rounding errors must not count as
        # information.
        information = np.maximum(alone - of_arm, 1e-9 * alone)
        score = np.einsum("jmr,jm->r", weighted, self.residual(fit)[moving])
        return score / np.maximum(information + sd**-2.0, _TINY), information

    def screen(
        self, fit: ViewFit, groups: Sequence[tuple[Array, Array]]
    ) -> tuple[Array, Array]:
        """Return for each of G groups of extra columns, added to a fit, the log-odds (G,)
        and the first size (G,), with arm and noise fitted again to first order.

        z are a group's columns, with those of the arm and of each joint alone projected
        out. With sizes x and the residual e, joint j's squared residual S_j becomes
        S_j - 2 x^T z_j^T e_j + x^T z_j^T z_j x.

        Parameters
        ----------
        groups : sequence of tuple
            Of each the columns (n, M, r), and the prior standard deviations (r,) of their
            sizes x.
        """
        columns = np.concatenate([group_columns for group_columns, _ in groups], axis=2)
        sd = np.concatenate([group_sd for _, group_sd in groups])
        n_columns = [len(group_sd) for _, group_sd in groups]
        moving = self.log.moving
        rows = fit.columns.rows
        arm = rows.projected[moving]
        used = columns * self.log.torque_mask(fit.transform)[:, :, None]
        z = rows.project_out_own(used)[moving]
        alone = np.einsum("jmr,jmr->r", z, z)
        weighted = fit.weights[moving][:, None, None] * z
        with_arm = np.tensordot(arm, weighted, ((0, 1), (0, 1)))
        z = z - arm @ np.linalg.solve(fit.information, with_arm)
        residual = self.residual(fit)[moving]
        score = (residual[:, None, :] @ z)[:, 0]
        log_odds, first_sizes = np.empty(len(groups)), np.empty(len(groups))
        begins = np.cumsum(n_columns) - n_columns
        # Groups of as many columns are solved at once.
        for count in {*n_columns}:
            same = np.flatnonzero(np.equal(n_columns, count))
            places = begins[same][:, None] + np.arange(count)  # (groups, count)
            log_odds[same], first_sizes[same] = self._fit_groups(
                fit, z[:, :, places], score[:, places], sd[places], alone[places]
            )
        return log_odds, first_sizes

    def _fit_groups(
        self, fit: ViewFit, z: Array, score: Array, sd: Array, squares: Array
    ) -> tuple[Array, Array]:
        """Return log-odds and first size (G,) of G groups of r columns each, by two rounds
        of reweighted ridge regression; see :meth:`screen`.

        Parameters
        ----------
        z : (n, M, G, r) array
            Columns of moving joints, with the arm's projected out.
        score : (n, G, r) array
            Their products with the residual.
        sd, squares : (G, r) array
            Prior standard deviations; squared norms before the arm's were projected out.
        """
        moving = self.log.moving
        energy_left, least = fit.energy_left[moving], c.FLOOR * fit.total[moving]
        n_rows = fit.weights[moving] * energy_left
        by_group = z.transpose(2, 0, 3, 1)  # (G, n, r, M)
        gram = by_group @ by_group.swapaxes(2, 3)  # (G, n, r, r)
        score = score.swapaxes(0, 1)  # (G, n, r)
        # Where the arm's parameters span a column, rounding errors must not count.
        ridge = (sd**-2.0 + 1e-9 * squares)[:, :, None] * np.eye(sd.shape[1])
        after = np.broadcast_to(energy_left, score.shape[:2])
        for _ in range(2):
            weights = n_rows / after  # (G, n)
            information = np.einsum("gj,gjab->gab", weights, gram)
            right = np.einsum("gj,gja->ga", weights, score)
            x = np.linalg.solve(information + ridge, right[..., None])  # (G, r, 1)
            change = (gram @ x[:, None])[..., 0] - 2.0 * score
            after = np.maximum(energy_left + (change @ x)[..., 0], least)
        scaled = np.eye(sd.shape[1]) + sd[:, :, None] * information * sd[:, None]
        x = x[..., 0]
        odds = np.log(after / energy_left) @ n_rows + np.sum((x / sd) ** 2, axis=1)
        return -0.5 * (odds + np.linalg.slogdet(scaled)[1]), x[:, 0]

    # -- the second witness

    def held_out(
        self, fit: ViewFit, extra: Array | None = None, span: Part | None = None
    ) -> tuple[Array, Array]:
        """Fit an arm to all of PARTS parts of the log but one, each in turn
        (cross-validation).

        Parameters
        ----------
        span : Part, optional
            Rows of which each part has its share.
        extra : (n, M, r) array, optional
            Columns beside those of the fit, of sizes that may be any.

        Returns
        -------
        errors : (PARTS, K) array
            Squared residual on the part that the arm was not fitted to, over the mean
            squared torque of a part, for each of K moving joints [-].
        arms : (PARTS, s + r) array
            The parameters of each arm.
        """
        moving = self.log.moving
        rows = fit.columns.rows
        extra_columns = [] if extra is None else [extra]
        torque = self._torque(fit.view)[:, :, None]
        columns = np.concatenate(
            [rows.basis, rows.raw, *extra_columns, torque], axis=2
        )[moving]
        grams = np.zeros((c.PARTS, len(columns), *2 * columns.shape[2:]))
        is_inside = np.ones(columns.shape[1], bool)
        if span is not None:
            is_inside = self.rows_of(span)
        # Each part has its share of the rows in the span, and of those outside of it.
        for of_part in (columns[:, is_inside], columns[:, ~is_inside]):
            for k, part in enumerate(np.array_split(of_part, c.PARTS, axis=1)):
                grams[k] += part.swapaxes(1, 2) @ part
        others = NormalEquations.eliminating(
            grams.sum(axis=0) - grams, rows.basis.shape[2]
        )
        # Of the sizes of ``extra``, which come last, nothing is known beforehand.
        prior = self._prior_of(fit.view)
        n_known, s = len(prior.mean), others.cross.shape[-1]
        mean, inverse = np.zeros(s), np.zeros((s, s))
        mean[:n_known] = prior.mean
        inverse[:n_known, :n_known] = prior.inverse
        weights = (fit.columns.count / fit.rows_worth_one / fit.energy_left)[moving]
        gram, cross = others.normal(weights)
        right = (cross + inverse @ mean)[..., None]
        arms = np.asarray(np.linalg.solve(gram + inverse, right)[..., 0], float)
        energy = np.maximum(grams.sum(axis=0)[:, -1, -1], _TINY)
        energy_left = others.left_of(grams, arms[:, None])
        return np.maximum(c.PARTS * energy_left / energy, c.FLOOR), arms

    def jackknifed_std(self, fit: ViewFit, slope: Array) -> float:
        """Return the jackknifed standard deviation of a number, from arms fitted without
        each part of the log.

        It holds the errors of the model, which differ from part to part. By the noise alone
        the number would seem too exact.

        Parameters
        ----------
        slope : (n, M) array
            Torque per unit of the number. Where no moving joint has any, nothing is
            known of the number: its standard deviation is infinite.
        """
        size = float(np.linalg.norm(slope[self.log.moving]))
        if size == 0.0:
            return np.inf
        _, arms = self.held_out(fit, slope[:, :, None] / size)
        return float(jackknifed(arms[:, -1:] / size)[1][0])


def without_inertial_power(velocity: Array, acceleration: Array) -> Array:
    """Return velocities (n, M) of n joints without their part in proportion to the
    acceleration.

    The mean product of such a velocity with the torque of an inertia is zero.
    """
    energy = np.sum(acceleration**2, axis=1, keepdims=True)
    common = np.sum(velocity * acceleration, axis=1, keepdims=True)
    return velocity - common / nonzero_or_one(energy) * acceleration
