"""The one evidence: how probable the torques of a log are as seen under a transform.

One arm is fitted to the torques of all joints. With E_j and S_j the squared torque of joint
j and what the arm leaves of it, N_j its independent rows less the columns of its own motion
(friction, rotor, offset and the laws that arms have and models lack, projected out), theta
(s,) the links' independent parameters and the sizes of further columns, with their prior
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

    #: Columns of the links and further ones, and a basis of each joint's own.
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
    v: float = 1.0
    #: (s,) parameters of the links, then sizes of further columns.
    theta: Array = None  # type: ignore[assignment]
    #: Size of the arm beside the nominal one [-].
    scale: float = 1.0
    #: (n,) squared residual.
    left: Array = None  # type: ignore[assignment]
    #: (n,) weights of the rows with which they were fitted.
    weights: Array = None  # type: ignore[assignment]
    #: (s, s) information on the parameters, prior included.
    information: Array = None  # type: ignore[assignment]
    #: Log evidence.
    value: float = 0.0
    #: Log evidence of friction's power, whether or not ``value`` holds it.
    physics: float = 0.0
    #: Log evidence that is lost since the links are not the nominal ones.
    cost_of_links: float = 0.0

    @property
    def chain(self) -> LogTransform:
        """What is done to all rows."""
        return self.view.chain

    @property
    def links(self) -> Array:
        """(s,) parameters of the links."""
        n_further = sum(len(further.sd) for further in self.view.further)
        return self.theta[: len(self.theta) - n_further]

    @property
    def shares(self) -> Array:
        """(n,) share of each torque's energy that is left."""
        return self.left / self.total

    @property
    def is_poorly_explained(self) -> Mask:
        """(n,) whether the arm leaves more of a joint's torque than errors of friction laws
        and filters: its logged motion may be wrong."""
        return self.shares > c.POORLY

    @property
    def is_badly_explained(self) -> bool:
        """Whether much is left of a moving joint's torque: something is missing, or two
        mistakes were made."""
        return bool((self.shares[self.weights > 0.0] > c.BADLY).any())

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
    #: (K, s) unit of each parameter: that size of links, 1 of further columns.
    unit: Array
    #: (K, n) squared residuals.
    left: Array
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
        """Fit an arm to each view, of n_rows (K, n) independent rows of each joint.

        Each round weights a joint's rows by its residual. It also scales the prior of the
        links, the first ``n_links`` parameters, by the size of the arm beside the nominal
        one. The first round takes the size of the torques, since a prior of a wrong size
        would pull the fit to that size.
        """
        mean, inverse = prior.mean, prior.inverse
        s, count = len(mean), len(n_rows)
        is_link = np.arange(s) < n_links
        left = np.maximum(self.energy, c.FLOOR * self.total)
        of_nominal = self._of_nominal_arm(mean)
        scale = _sizes(self.energy, of_nominal)
        shown, change = np.empty((count, s, s)), np.empty_like(left)
        for _ in range(rounds):
            weights = n_rows / left  # (K, n)
            for at, gram in self.grams:
                flat = weights[at] @ gram.reshape(-1, s * s)
                shown[at] = flat.reshape(-1, s, s)
            unit = np.where(is_link, scale[:, None], 1.0)  # (K, s)
            scaled_inverse = inverse / (unit[:, :, None] * unit[:, None, :])
            right = (weights[:, None] @ self.cross)[:, 0] + (inverse @ mean) / unit
            information = shown + scaled_inverse
            theta = np.linalg.solve(information, right[..., None])[..., 0]
            for at, gram in self.grams:
                image = (theta[at] @ gram).swapaxes(0, 1)  # (k, n, s)
                slope = image - 2.0 * self.cross[at]
                change[at] = (slope @ theta[at, :, None])[..., 0]
            left = np.maximum(self.energy + change, c.FLOOR * self.total)
            nominal = shown @ mean  # (K, s)
            likeness = np.sum(theta * nominal, axis=1)
            scale = _sizes(np.maximum(self.energy - left, 0.0), of_nominal)
        return _Arms(
            theta=theta,
            scale=scale,
            unit=unit,
            left=left,
            weights=weights,
            prior=scaled_inverse,
            information=information,
            nominal=nominal,
            likeness=likeness,
        )


def _sizes(energy: Array, of_nominal: Array) -> Array:
    """Return the size (K,) of arms beside the nominal one: the median over the joints of
    torque over nominal torque, by squared torques (K, n); 1 where the nominal arm has no
    torque.

    Of the median, no single joint sets the size of the others.
    """
    sizes = np.sqrt(energy / nonzero_or_one(of_nominal))
    ranked = np.sort(np.where(of_nominal > 0.0, sizes, 1.0), axis=1)
    n = ranked.shape[1]
    # Faster than NumPy's median, of few joints.
    of_median = 0.5 * (ranked[:, (n - 1) // 2] + ranked[:, n // 2])
    return np.asarray(np.clip(nonzero_or_one(of_median), 1e-9, 1e9))


def _evidence_of_fit(arms: _Arms, total: Array, n_rows: Array, prior: _Prior) -> Array:
    """Return the log evidence (K,) of fitted arms, without that of friction and of their
    links: the module's equation, less the price of a size of the whole arm that is not the
    nominal one.

    total, n_rows (K, n) : squared torques, and numbers of independent rows.
    """
    value = -0.5 * np.sum(n_rows * np.log(arms.left / total), axis=1)
    value -= 0.5 * (np.linalg.slogdet(arms.information)[1] - prior.log_determinant)
    value -= np.sum(np.log(arms.unit), axis=1)
    cost_of_scale = 0.5 * (np.log(arms.unit[:, 0]) / c.MASSES_KNOWN) ** 2
    value -= np.minimum(cost_of_scale, c.LOG_ODDS_AGAINST_FAULT)
    return np.asarray(value)


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
        data, problem = self.log.data, self.log.problem
        if data.shared is None:
            return _Prior(np.zeros(0), np.zeros((0, 0)), 0.0, np.zeros((0, 0)))
        dependence = data.dependence
        links = problem.prior_links
        reach = np.maximum(problem.robot.link_reach(), 0.05)
        reach = np.resize(reach, len(links))
        mass = links[:, 0] + 0.05 * np.median(links[:, 0]) + 1e-3
        mass = mass * np.where(problem.guessed_links, _GUESSED, 1.0)
        spread = np.empty((len(links), 10))
        spread[:, 0] = 0.5 * mass
        centres = np.zeros_like(spread)
        centres[:, 1:4] = _CENTRE * (mass * reach)[:, None]
        spread[:, 1:4] = 0.5 * np.abs(links[:, 1:4]) + centres[:, 1:4]
        spread[-1, 1:4] += (_GUESSED - 1.0) * centres[-1, 1:4]
        inertia = mass * (0.4 * reach) ** 2
        spread[:, 4:] = inertia[:, None] + np.abs(links[:, 4:])
        p = len(data.shared.parameters)
        rigid = data.shared.rigid_indices
        # Couplings, and other parameters that joints share, may be as large as a link's.
        mean, sd = np.zeros(p), np.full(p, np.median(spread[:, 0], axis=0))
        mean[rigid] = links.ravel()[: len(rigid)]
        sd[rigid] = spread.ravel()[: len(rigid)]
        covariance = (dependence * sd**2) @ dependence.T
        sd = np.zeros(p)
        sd[rigid] = centres.ravel()[: len(rigid)]
        of_centres = (dependence * sd**2) @ dependence.T
        size = np.diag(covariance)
        covariance = covariance + np.diag(1e-9 * size + 1e-14 * size.sum())
        inverse = np.linalg.inv(covariance)
        inverse = 0.5 * (inverse + inverse.T)
        log_determinant = -float(np.linalg.slogdet(covariance)[1])
        return _Prior(dependence @ mean, inverse, log_determinant, of_centres)

    @property
    def covariance_of_links(self) -> Array:
        """(s, s) covariance of the links' independent parameters beforehand."""
        return np.asarray(np.linalg.inv(self._prior.inverse), float)

    def nominal_size(self, columns: Array) -> float:
        """Return the expected size of the nominal links' torques: the root of the expected
        sum of squares, by columns (n, M, s) of the links' independent parameters. Centres
        of mass are known as the prior says."""
        gram = np.tensordot(columns, columns, ((0, 1), (0, 1)))
        mean = self._prior.mean
        second_moment = np.outer(mean, mean) + self._prior.of_centres
        return float(np.sqrt(np.maximum(np.sum(gram * second_moment), _TINY)))

    def _prior_of(self, view: LogView) -> _Prior:
        """Return the prior of a view's parameters: those of the links, then the sizes of
        its further columns about zero."""
        links = self._prior
        if not view.further:
            return links
        sd = np.concatenate([further.sd for further in view.further])
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
        """Make what all fits to one motion share."""
        log, chain = self.log, motion.chain
        basis, raw, mask = log.basis(chain), log.raw(chain), log.torque_mask(chain)
        states = np.stack(self._states(chain))
        if motion.parts:
            raw, states, mask = raw.copy(), states.copy(), mask.copy()
            own = self._own_columns(chain, chain)
            is_own_changed = False
            for part, transform in motion.parts:
                at, of_part = self.rows_of(part), transform.followed_by(chain)
                raw[:, at] = log.raw(of_part)[:, at]
                mask[:, at] = log.torque_mask(of_part)[:, at]
                states[:, :, at] = np.stack(self._states(of_part))[:, :, at]
                own_of_part = self._own_columns(of_part, chain)[:, at]
                is_own_changed |= not np.array_equal(own[:, at], own_of_part)
                own[:, at] = own_of_part
                for event in transform.events:
                    column = np.zeros((*own.shape[:2], 1))
                    column[event.joint, at] = event.shape(log.data.motion.t[at])
                    own = np.concatenate([own, column], axis=2)
                    is_own_changed = True
            if is_own_changed:  # else the basis of all rows, which is cached, is that
                basis = orthonormal(own * mask[:, :, None])
        if motion.further:
            further = [x.columns * mask[:, :, None] for x in motion.further]
            raw = np.concatenate([raw, *further], axis=2)
        states = states - states.mean(axis=2, keepdims=True)
        velocity = without_inertial_power(*(states * mask))
        size = np.linalg.norm(velocity, axis=1, keepdims=True)
        probe = velocity / nonzero_or_one(size)
        power = (probe[:, None] @ raw)[:, 0]
        rows = RepairedRows.from_basis(basis, raw)
        return _Columns(rows, probe, power, mask.sum(axis=1))

    def _own_columns(self, part: LogTransform, whole: LogTransform) -> Array:
        """Return the joints' own columns (n, M, k) under the transform of a part, for the
        parameters that they have in the whole log. Columns of friction change their sign
        where the part's velocity does; the offset keeps its sign."""
        data = self.log.data
        columns = data.own_columns[list(part.order)]
        sign = np.sign(np.array(part.scale) / np.array(whole.scale))
        of_time = np.where(data.turns, -1.0 if part.reversed else 1.0, 1.0)
        turned = columns * (sign[:, None] * of_time)[:, None, :]
        turned[:, :, OFFSET] = columns[:, :, OFFSET]
        return turned

    def _states(self, chain: LogTransform) -> tuple[Array, Array]:
        """Return velocity and acceleration (n, M) of the motors under a transform."""
        motion = self.log.motion(chain.with_defaults("carried"))
        return (-motion.dq.T if chain.reversed else motion.dq.T), motion.ddq.T

    def _torque(self, view: LogView) -> Array:
        """Return the torque (n, M) of a view."""
        torque = self.log.channels(view.chain)
        for part, beside in view.parts:
            at = self.rows_of(part)
            of_part = self.log.channels(beside.followed_by(view.chain))
            torque = np.where(at, of_part, torque)
        return torque

    def _total(self, view: LogView, squares: Array) -> Array:
        """Return the squared torque (n,) that residuals are divided by, so that the evidence
        does not depend on gains; squares (n,) : squared torque of the view.

        If parts have gains of their own, it is the squared torque without these gains,
        times each squared gain to the power of its part's share of the rows.
        """
        if not view.parts:
            return np.maximum(squares, _TINY)
        total = np.sum(self.log.channels(view.chain) ** 2, axis=1)
        for part, transform in view.parts:
            share = np.mean(self.rows_of(part))
            total = total * np.abs(transform.torque_factors) ** (2.0 * share)
        return np.maximum(total, _TINY)

    # -- fits

    def _unfitted(self, columns: _Columns, views: Sequence[LogView]) -> list[ViewFit]:
        """Return what :meth:`fitted` needs of K views of one motion: fits that have the
        products of torque and columns, and no parameters yet."""
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

    def fit(self, view: LogView, v: float) -> ViewFit:
        """Fit one arm to the rows of one view; v : rows worth one independent row."""
        unfitted = self._unfitted(self._columns(view.motion), [view])
        return self.fitted(unfitted, v)[0]

    def values(
        self, views: Sequence[LogView], v: float, rounds: int = _ROUNDS
    ) -> Array:
        """Return the log evidence (K,) of each of several views with the same number of
        further columns.

        Parameters
        ----------
        v : float
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
            self.log.prepare_columns([x for motion in batch for x in motion.chains])
            places = [k for motion in batch for k in by_motion[motion]]
            unfitted: list[ViewFit] = []
            for motion in batch:
                of_motion = [views[k] for k in by_motion[motion]]
                unfitted += self._unfitted(self._columns(motion), of_motion)
            values[places] = [x.value for x in self.fitted(unfitted, v, rounds)]
        return values

    def fitted(
        self, products: Sequence[ViewFit], v: float, rounds: int = _ROUNDS
    ) -> list[ViewFit]:
        """Fit one arm to each of K views with known products, for v rows that are worth
        one; see :meth:`values`."""
        moving = self.log.moving
        stacked = _Products.of_views(products, moving)
        n_rows = np.stack([self._independent(x, v) for x in products])[:, moving]
        prior = self._prior_of(products[0].view)
        arms = stacked.fit_arms(n_rows, prior, len(self._prior.mean), rounds)
        value = _evidence_of_fit(arms, stacked.total, n_rows, prior)
        value -= [self._price_of_events(x, v) for x in products]
        value += [self._of_velocity(x.view) + self.of_ranges(x.view) for x in products]
        # Mean power of each joint's friction (K, n), and the variance of it and of the
        # links' likeness to the nominal ones (K, n + 1).
        of_arms = (stacked.probe_on_columns @ arms.theta[..., None])[..., 0]
        power = stacked.probe_on_torque - of_arms
        known = np.concatenate(
            [stacked.probe_on_columns, arms.nominal[:, None]], axis=1
        )
        known = known.swapaxes(1, 2)
        variance = np.sum(known * np.linalg.solve(arms.information, known), axis=1)
        directions = np.where([x.chain.reversed for x in products], -1.0, 1.0)
        sd_of_power = np.sqrt(np.maximum(arms.left / n_rows + variance[:, :-1], _TINY))
        log_odds = np.log(2.0) + log_ndtr(directions[:, None] * power / sd_of_power)
        physics = np.sum(np.maximum(log_odds, -c.MAX_PHYSICS_LOG_ODDS), axis=1)
        # The links resemble the nominal ones rather than their mirror image, unless their
        # centres are so near the axes that they may lie on the other side.
        sd_of_likeness = np.sqrt(np.maximum(variance[:, -1], _TINY))
        log_odds_of_mirror = np.log(2.0) + log_ndtr(arms.likeness / sd_of_likeness)
        beforehand = np.sqrt(
            np.sum(arms.nominal * (arms.nominal @ prior.of_centres), axis=1)
        )
        expected = arms.nominal @ prior.mean / np.maximum(beforehand, _TINY)
        least = np.maximum(np.log(2.0) + log_ndtr(-expected), -c.MAX_PHYSICS_LOG_ODDS)
        away = arms.theta - prior.mean * arms.unit
        cost_of_links = 0.5 * np.sum(
            away * (arms.prior @ away[..., None])[..., 0], axis=1
        )
        cost_of_links -= np.maximum(log_odds_of_mirror, least)
        value -= cost_of_links
        # A controller that compensates friction leaves little of it, of either sign: the
        # more is left, the more it costs.
        shares = power / np.sqrt(stacked.total)
        cost = np.minimum(0.5 * (shares / c.COMPENSATED) ** 2, c.MAX_PHYSICS_LOG_ODDS)
        is_real = np.array([x.view.is_friction_real for x in products])
        of_friction = np.where(is_real, physics, -np.sum(cost, axis=1))
        fits = []
        for k, of_view in enumerate(products):
            left = of_view.total.copy()
            left[moving] = arms.left[k]
            weights = np.zeros(len(left))
            weights[moving] = arms.weights[k]
            fit = replace(
                of_view,
                v=v,
                theta=arms.theta[k],
                scale=float(arms.scale[k]),
                left=left,
                weights=weights,
                information=arms.information[k],
                value=float(value[k] + of_friction[k]),
                physics=float(physics[k]),
                cost_of_links=float(cost_of_links[k]),
            )
            fits.append(fit)
        return fits

    def worth(self, fit: ViewFit, v: float) -> ViewFit:
        """Return a fit with v rows worth one independent row; itself if it has this v."""
        return fit if fit.v == v else self.fitted([fit], v)[0]

    def _independent(self, fit: ViewFit, v: float) -> Array:
        """Return the number (n,) of independent rows less own columns, if v rows are
        worth one."""
        count = fit.columns.count / v
        n_own = fit.columns.rows.basis.shape[2]
        return np.maximum(count - n_own, _LEAST_SHARE * count)

    def _of_velocity(self, view: LogView) -> float:
        """Return the log evidence of the logged velocities' signs. If the velocities of a
        run have the other sign than its positions' derivative, its rows are in reverse
        order; if they have the same sign, its rows are in order."""
        of_parts = {part.run: transform.reversed for part, transform in view.parts}
        evidence = 0.0
        for run, sign in enumerate(self.log.data.velocity_signs):
            is_reversed = view.chain.reversed != of_parts.get(run, False)
            if sign < 0.0 and not is_reversed:
                evidence = min(evidence, c.VELOCITY_TURNED)
            elif sign > 0.0 and is_reversed:
                evidence = min(evidence, -c.MAX_PHYSICS_LOG_ODDS)
        return evidence

    @cached_property
    def _farthest(self) -> dict[int, Array]:
        """(2, n) smallest and largest position of each channel, by run; only runs whose
        angles lie far outside the joints' ranges."""
        q, runs = self.log.data.motion.q, self.log.data.run
        ends = {}
        for run in np.unique(runs).tolist():
            of_run = q[runs == run]
            ends[run] = np.array([of_run.min(axis=0), of_run.max(axis=0)])
        return {run: q for run, q in ends.items() if self._is_impossible(q)}

    def _is_impossible(self, q: Array) -> bool:
        """Whether angles among positions (N, n) [rad, m] are those of no joint."""
        far = far_outside(self.log.problem.robot, q)
        return any(j in self.log.revolute for j in far)

    def of_ranges(self, view: LogView) -> float:
        """Return the log evidence of the joints' ranges: 0, or the lowest there is if a view
        leaves angles far outside the ranges, however well it explains the torques. Only
        runs that are so as logged are looked at."""
        of_parts = {part.run: transform for part, transform in view.parts}
        for run, logged in self._farthest.items():
            before, chain = of_parts.get(run), view.chain
            chain = chain if before is None else before.followed_by(chain)
            if self._is_impossible(chain.positions(logged)):
                return -c.MAX_PHYSICS_LOG_ODDS
        return 0.0

    @staticmethod
    def _price_of_events(fit: ViewFit, v: float) -> float:
        """Return what the sizes of a view's events cost (Schwarz 1978)."""
        count = np.maximum(fit.columns.count / v, 1.0)
        events = [x for chain in fit.view.chains for x in chain.events]
        return sum(0.5 * float(np.log(count[x.joint])) for x in events)

    def residual(self, fit: ViewFit) -> Array:
        """Return the torque (n, M) that the arm and each joint's own columns leave."""
        rows = fit.columns.rows
        beside_own = rows.project_out_own(self._torque(fit.view)[:, :, None])[:, :, 0]
        return beside_own - rows.projected @ fit.theta

    def rows_worth_one(self, fit: ViewFit) -> float:
        """Return how many rows are worth one independent row, by the correlation of the
        residual."""
        residual = self.residual(fit)[self.log.moving]
        return max(1.0, residual.shape[1] / independent_rows(residual))

    # -- numbers, to first order

    def slopes(
        self, fit: ViewFit, hypotheses: Sequence[Hypothesis], sizes: Sequence[float]
    ) -> Array:
        """Return the torque (n, M, r) per unit of the number of each hypothesis at a size;
        0 on rows that the hypothesis is not about.

        The slope by a gain is minus the modelled torque: the logged torque keeps its size,
        and the model's is divided by the gain.
        """
        modelled = self._torque(fit.view) - self.residual(fit)
        slopes = np.zeros((*modelled.shape, len(hypotheses)))
        # Hypotheses about one number of several parts share a slope: only their rows differ.
        places_by_number: dict[tuple[Number | None, float, bool], list[int]] = {}
        for k, (h, size) in enumerate(zip(hypotheses, sizes, strict=True)):
            places_by_number.setdefault((h.number, size, h.part is None), []).append(k)
        # Places of columns, step of their number, transform at the size and a step on.
        moved: list[tuple[list[int], float, LogTransform, LogTransform]] = []
        for (number, size, _), places in places_by_number.items():
            assert number is not None
            if number.field == "gain":
                for j in number.joints:
                    slopes[j][:, places] = -modelled[j][:, None]
            else:
                h = hypotheses[places[0]]
                now = h.at_size(fit.chain, size)
                then = h.at_size(fit.chain, size + number.step)
                moved.append((places, number.step, now, then))
        chains = [*dict.fromkeys(x for _, _, now, then in moved for x in (now, then))]
        self.log.prepare_columns(chains[: self.log.n_kept])
        unexplained = {x: self.log.unexplained(x, fit.links) for x in chains}
        for places, step, now, then in moved:
            slope = (unexplained[now] - unexplained[then]) / step
            slopes[:, :, places] = slope[:, :, None]
        for k, h in enumerate(hypotheses):
            if h.part is not None:
                slopes[:, ~self.rows_of(h.part), k] = 0.0
        return slopes

    def score_test(
        self, fit: ViewFit, columns: Array, sd: Array
    ) -> tuple[Array, Array]:
        """Return the likeliest sizes (r,) of further columns (n, M, r), each alone, with
        the noise as it is, and the information of the rows on each (r,).

        Parameters
        ----------
        sd : (r,) array
            Standard deviations of their sizes beforehand.
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
        """Return log-odds and first size of each of several groups of further columns,
        with arm and noise fitted anew to first order.

        z is what is left of a group's columns beside the arm's and each joint's own. With
        sizes x and the residual e, joint j's squared residual S_j becomes
        S_j - 2 x^T z_j^T e_j + x^T z_j^T z_j x.

        Parameters
        ----------
        groups : sequence of tuple
            Of each its columns (n, M, r), and the standard deviations (r,) of their
            sizes x beforehand.
        """
        columns = np.concatenate([of_group for of_group, _ in groups], axis=2)
        sd = np.concatenate([of_group for _, of_group in groups])
        sizes = [len(of_group) for _, of_group in groups]
        moving = self.log.moving
        rows = fit.columns.rows
        arm = rows.projected[moving]
        used = columns * self.log.torque_mask(fit.chain)[:, :, None]
        z = rows.project_out_own(used)[moving]
        alone = np.einsum("jmr,jmr->r", z, z)
        weighted = fit.weights[moving][:, None, None] * z
        with_arm = np.tensordot(arm, weighted, ((0, 1), (0, 1)))
        z = z - arm @ np.linalg.solve(fit.information, with_arm)
        residual = self.residual(fit)[moving]
        score = (residual[:, None, :] @ z)[:, 0]
        odds, first = np.empty(len(sizes)), np.empty(len(sizes))
        begins = np.cumsum(sizes) - sizes
        # Groups of as many columns are solved at once.
        for size in {*sizes}:
            alike = np.flatnonzero(np.equal(sizes, size))
            places = begins[alike][:, None] + np.arange(size)  # (G, size)
            odds[alike], first[alike] = self._gains(
                fit, z[:, :, places], score[:, places], sd[places], alone[places]
            )
        return odds, first

    def _gains(
        self, fit: ViewFit, z: Array, score: Array, sd: Array, alone: Array
    ) -> tuple[Array, Array]:
        """Return log-odds and first size (G,) of G groups of r columns each.

        z (n, M, G, r) : the columns beside the arm's of moving joints; score (n, G, r) :
        their products with the residual; sd, alone (G, r) : standard deviations beforehand,
        and squares before the arm's were taken out.
        """
        moving = self.log.moving
        left, least = fit.left[moving], c.FLOOR * fit.total[moving]
        n_rows = fit.weights[moving] * left
        by_group = z.transpose(2, 0, 3, 1)  # (G, n, r, M)
        gram = by_group @ by_group.swapaxes(2, 3)  # (G, n, r, r)
        score = score.swapaxes(0, 1)  # (G, n, r)
        # Where the arm's parameters span a column, rounding errors must not count.
        ridge = (sd**-2.0 + 1e-9 * alone)[:, :, None] * np.eye(sd.shape[1])
        after = np.broadcast_to(left, score.shape[:2])
        for _ in range(2):
            weights = n_rows / after  # (G, n)
            information = np.einsum("gj,gjab->gab", weights, gram)
            right = np.einsum("gj,gja->ga", weights, score)
            x = np.linalg.solve(information + ridge, right[..., None])  # (G, r, 1)
            change = (gram @ x[:, None])[..., 0] - 2.0 * score
            after = np.maximum(left + (change @ x)[..., 0], least)
        scaled = np.eye(sd.shape[1]) + sd[:, :, None] * information * sd[:, None]
        x = x[..., 0]
        odds = np.log(after / left) @ n_rows + np.sum((x / sd) ** 2, axis=1)
        return -0.5 * (odds + np.linalg.slogdet(scaled)[1]), x[:, 0]

    # -- the second witness

    def held_out(
        self, fit: ViewFit, further: Array | None = None, span: Part | None = None
    ) -> tuple[Array, Array]:
        """Fit an arm to all parts of the log but one, each in turn.

        Parameters
        ----------
        span : Part, optional
            Rows of which each part has its share.
        further : (n, M, r) array, optional
            Columns beside those of the fit, of sizes that may be any.

        Returns
        -------
        errors : (PARTS, K) array
            Share of the energy of each moving joint's torque that the arm leaves of the
            part that it was not fitted to.
        arms : (PARTS, s + r) array
            The parameters of each arm.
        """
        moving = self.log.moving
        rows = fit.columns.rows
        beside = [] if further is None else [further]
        torque = self._torque(fit.view)[:, :, None]
        columns = np.concatenate([rows.basis, rows.raw, *beside, torque], axis=2)[
            moving
        ]
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
        # Of the sizes of ``further``, which come last, nothing is known beforehand.
        prior = self._prior_of(fit.view)
        n_known, s = len(prior.mean), others.cross.shape[-1]
        mean, inverse = np.zeros(s), np.zeros((s, s))
        mean[:n_known] = prior.mean
        inverse[:n_known, :n_known] = prior.inverse
        weights = (fit.columns.count / fit.v / fit.left)[moving]
        gram, cross = others.normal(weights)
        right = (cross + inverse @ mean)[..., None]
        arms = np.asarray(np.linalg.solve(gram + inverse, right)[..., 0], float)
        energy = np.maximum(grams.sum(axis=0)[:, -1, -1], _TINY)
        left = others.left_of(grams, arms[:, None])
        return np.maximum(c.PARTS * left / energy, c.FLOOR), arms

    def jackknifed_spread(self, fit: ViewFit, slope: Array) -> float:
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
