"""The one score: a penalised likelihood, coarsened and robust.

A candidate beside the model and the terms that were chosen scores

    J = dD / v - (k + s) log(N / v) - 2 log P

with

- the drop dD of the deviance D = sum_j N_j log V_j + RSS_j / V_j, where V_j =
  max(RSS_j / N_j, noise) (:attr:`Trial.deviance_drop`);
- the rows v that are worth one (:meth:`EvidenceScorer.rows_worth_one`);
- k coefficients and s continuous shape constants
  (:func:`~sdp_vs_penalty.regression.evidence.price`). As many coefficients count as the rows
  determine beside what is known of their size. One that its sign holds at zero does not
  count (Meyer, Woodroofe, Ann. Statist. 2000);
- P candidates, times the laws among which this one chooses.

Rows are not independent evidence:

    v = max over clusterings of tr(A^-1 S) / k, at least 1, + N / 3000

A = T'T of the candidate's columns T beside all others. S = sum over clusters of u u',
with u the sum of T r within one: the sandwich (Liang, Zeger, Biometrika 1986). Clusters
are stretches of time and, since what a model lacks comes back with the motion, of its
phase. N / 3000 coarsens the likelihood (Miller, Dunson, JASA 2019): no law is right
beyond what some 3000 rows of a joint tell, however many there are.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from sdp_vs_penalty.diagnosis.constants import ABSORBED, COARSENING_ROWS
from sdp_vs_penalty.diagnosis.library import Batch, Candidate, Key
from sdp_vs_penalty.diagnosis.linear_fit import (
    DEPENDENT,
    ColumnProducts,
    ScoredEffect,
    WhiteFit,
    WhiteFitter,
    bounded_least_squares,
    with_ridge,
)
from sdp_vs_penalty.diagnosis.white_rows import WhiteData
from sdp_vs_penalty.regression.evidence import price, rows_worth_one
from sdp_vs_penalty.robot.arrays import Array, Mask, nonzero_or_one


@dataclass(frozen=True, eq=False)
class Trial:
    """A candidate as an addition to a fit.

    Its columns of torque T (n joints, M rows, k) are weighted, less what the fit
    explains of them. All but the count of independent rows follows from products of
    columns, without T itself.
    """

    #: The candidate.
    form: Candidate
    #: The fit that it has to improve on; it is ``fit`` unless the candidate replaces
    #: the value of one of the model's shape constants (``fit`` then lacks that effect's
    #: column).
    fit_to_beat: WhiteFit
    #: The fit that it is added to.
    fit: WhiteFit
    #: Products of the k weighted columns with ``fit``.
    products: ColumnProducts
    #: (k,) flags of the columns of which the fit leaves more than 0.01 % (ABSORBED); T
    #: is zero in the others.
    is_visible: Mask
    #: (k,) prior standard deviations of the k coefficients about zero.
    prior_std: Array

    @property
    def k(self) -> int:
        """The number of the candidate's coefficients."""
        return self.form.n_coefficients

    @property
    def columns_left(self) -> Array:
        """(n, M, k) the columns T."""
        return self.products.residual * self.is_visible

    @property
    def is_absorbed(self) -> bool:
        """Whether the fit absorbs all of the candidate's columns."""
        return not np.any(self.gram)

    @cached_property
    def gram(self) -> Array:
        """(k, k) the Gram matrix T'T of the columns T (n joints, M rows, k)."""
        is_visible = self.is_visible
        return self.products.gram_left * np.outer(is_visible, is_visible)

    @cached_property
    def information(self) -> Array:
        """(k, k) the information matrix T'T + diag(prior_std^-2) of the coefficients.

        T'T comes from the rows, the diagonal from the prior on the coefficients.
        """
        return self.gram + np.diag(self.prior_std**-2.0)

    @property
    def nonnegative(self) -> Mask:
        """(k,) flags: which coefficients must not be negative (a friction's size, say)."""
        return np.array(self.form.nonnegative, bool)

    @cached_property
    def beta(self) -> Array:
        """(k,) the coefficients of the columns T with the highest posterior probability.

        They minimise b'(T'T + diag(prior_std^-2)) b / 2 - (T'r)'b for the fit's
        residual r, subject to the sign constraints ``nonnegative``.
        """
        with_residual = self.products.with_residual * self.is_visible
        return bounded_least_squares(self.information, with_residual, self.nonnegative)

    @cached_property
    def squares(self) -> Array:
        """(n,) squares of the candidate's torque T beta on each joint, in units of the
        joint's level."""
        return self.products.squares_with(self.beta * self.is_visible)

    @cached_property
    def deviance_drop(self) -> float:
        """The drop dD of the deviance that is due to the candidate.

        dD = D(fit to beat) - D(fit + T beta) - sum (beta / prior_std)^2, where D = -2
        log L is the deviance, and the last term is that of the prior.
        """
        beta = self.beta
        rss = self.products.rss_with(beta * self.is_visible)
        deviance_before = self.fit.own_deviance
        before = self.fit_to_beat
        if before is not self.fit:  # with the degrees of freedom of this fit
            deviance_before = float(self.fit.deviance(before.rss))
        deviance_after = self.fit.deviance(rss)
        prior = np.sum((beta / self.prior_std) ** 2)
        return float(deviance_before - deviance_after - prior)

    @cached_property
    def freedom(self) -> float:
        """The effective number of parameters k + s of the candidate.

        k = trace((T'T + diag(prior_std^-2))^-1 T'T) for the columns T that the fit
        leaves: a coefficient counts 1 if the rows determine it and 0 if only the prior
        does. Coefficients that a sign constraint holds at zero do not count. s is the
        number of the candidate's continuous shape constants.
        """
        is_held_at_zero = self.nonnegative & (self.beta == 0.0)
        free = np.flatnonzero(~is_held_at_zero)
        among_free = np.ix_(free, free)
        information = with_ridge(self.information[among_free])
        determined = np.linalg.solve(information, self.gram[among_free])
        return float(np.trace(determined)) + self.form.n_constants


class _BatchProducts(NamedTuple):
    """Products of the columns Z of F candidates, of k coefficients each, weighted by each
    joint's residual as a fit's rows are."""

    #: (F, k) squares of the columns.
    energy: Array
    #: (F, k) Z'r with the fit's residual r.
    with_residual: Array
    #: (F, k, k) Gram matrices of what the fit leaves of each candidate.
    grams_left: Array


class EvidenceScorer(WhiteFitter):
    """Scores candidates by their evidence J on some white rows.

    The module's docstring has the equation of J: twice the logarithm of the odds that
    an effect acts.
    """

    def __init__(
        self,
        data: WhiteData,
        n_candidates: int,
        laws: Mapping[Key, int] | None = None,
        like: WhiteFitter | None = None,
    ) -> None:
        """Prepare the scorer of candidates on white rows.

        Parameters
        ----------
        data
            The rows in units of their noise.
        n_candidates
            How many candidates there are; a choice among many costs evidence.
        laws
            The number of laws (discrete variants) of a candidate, by its key (effect
            name, joint). A candidate that is missing here has one law.
        like
            A scorer whose rows may be equal to these; its basis of the model's columns
            is then used again.
        """
        super().__init__(data, like)
        self.n_candidates = max(n_candidates, 1)
        self.laws = laws or {}

    def evidence_of(
        self, fit: WhiteFit, form: Candidate, columns: dict[int, Array]
    ) -> ScoredEffect:
        """Score a candidate effect as an addition to a fit.

        Parameters
        ----------
        fit
            The fit of the model and the effects chosen so far.
        form
            The candidate. If it is another value of one of the model's shape constants,
            it replaces the columns of the present value.
        columns
            Its white columns (noise of variance 1), (M, k) by joint from 0.

        Returns
        -------
        ScoredEffect
            The candidate with evidence, coefficients and explained squares.
        """
        return self._score(self._trial(fit, form, columns), columns)

    def with_drop_beside(self, fit: WhiteFit, term: ScoredEffect) -> ScoredEffect:
        """Return a scored effect with its drop of the deviance beside another fit.

        Coefficients and squares are those beside the fit, too. The number of correlated
        rows that count as one, which takes most of the time of a score, and the price
        stay: they hardly depend on effects of other joints.
        """
        trial = self._trial(fit, term.form, term.columns)
        if trial.is_absorbed:
            return replace(term, drop=-np.inf)
        return replace(
            term,
            drop=trial.deviance_drop,
            beta=trial.beta,
            squares=trial.squares * trial.fit.level**2,
        )

    def deviance_drop_of(
        self, fit: WhiteFit, form: Candidate, columns: dict[int, Array]
    ) -> float:
        """Return the drop of the deviance by a candidate, minus infinity if the fit
        absorbs it.

        It takes a quarter of the time of the evidence, which also counts the
        independent rows. The parameters are those of :meth:`evidence_of`.
        """
        trial = self._trial(fit, form, columns)
        return -np.inf if trial.is_absorbed else trial.deviance_drop

    def _trial(
        self, fit: WhiteFit, form: Candidate, columns: dict[int, Array]
    ) -> Trial:
        """Prepare a candidate, with white columns (M, k) by joint, to be tried beside
        a fit."""
        trial = self.trial_beside(fit, self.without(fit, form), form, columns)
        own = self._own_below_zero(trial)
        if own is None:
            return trial
        rest = self.without_own(fit, own)
        return self.trial_beside(fit, rest, form, columns)

    def trial_beside(
        self,
        fit_to_beat: WhiteFit,
        fit: WhiteFit,
        form: Candidate,
        columns: dict[int, Array],
    ) -> Trial:
        """Prepare a candidate to be added to a fit, and compared with another one."""
        products = ColumnProducts.from_columns(fit, fit.scaled(columns))
        energy = products.energy
        energy_left = np.diagonal(products.gram_left)
        return Trial(
            form=form,
            fit_to_beat=fit_to_beat,
            fit=fit,
            products=products,
            is_visible=energy_left > ABSORBED * energy,
            prior_std=self.prior(fit, form.plausible, list(columns), energy),
        )

    def _own_below_zero(self, trial: Trial) -> Key | None:
        """Return the key of the model's effect that the candidate refines and whose
        parameter falls below zero with the candidate; None if there is none.

        `add` does not let it: friction that cools by a law with too large a constant
        minus a constant friction, for example. At the limit it is zero, and the
        candidate stands in its place.
        """
        fit, form = trial.fit, trial.form
        signed = self.data.signed_effects
        if form.replaces_own_constant or not signed:
            return None
        refined = {(name, form.key[1]) for name in form.effect.refines}
        change = trial.products.change(trial.beta)
        for key in refined & signed.keys():
            for number in fit.design.model.columns_by_key[key]:
                is_fitted = number in fit.columns_kept
                if is_fitted and fit.theta[number] < change[number]:
                    return key
        return None

    def _score(self, trial: Trial, columns: dict[int, Array]) -> ScoredEffect:
        """Compute the evidence J = dD / v - price of a candidate that is added to a fit.

        dD is the drop of the deviance, v the number of correlated rows that count as
        one. price = (k + s) log(N / v) + 2 log P is for its k coefficients and s shape
        constants, and for the choice among P candidates and laws. J is minus infinity
        if the fit absorbs all of the candidate's columns.

        Parameters
        ----------
        trial
            The candidate, tried beside a fit.
        columns
            Its white columns, (M, k) by joint from 0.

        Returns
        -------
        ScoredEffect
            The candidate with dD, v, price, coefficients and explained squares.
        """
        form = trial.form
        fit = trial.fit
        k = trial.k
        without_evidence = ScoredEffect(form, columns, beta=np.zeros(k))
        if trial.is_absorbed:
            return without_evidence
        T = trial.columns_left
        residual = fit.residual - T @ trial.beta
        inverse = np.asarray(np.linalg.inv(with_ridge(trial.information)))
        # (n,) squares of the candidate's torque, weighted.
        squares = trial.squares
        if form.replaces_own_constant:
            # The rows tell the new value from the present one only by what the fit
            # with the present value leaves of the new column: v is computed from that.
            T = trial.fit_to_beat.residual_of(trial.fit_to_beat.scaled(columns))
            energy = float(np.sum(T**2))
            # "not ... <" also refuses NaN.
            if not DEPENDENT**2 * float(np.trace(trial.gram)) < energy:
                return without_evidence
            inverse = np.array([[1.0 / energy]])
            torque = T[:, :, 0]
            residual = residual - torque * float(np.sum(torque * residual)) / energy
            squares = np.sum(torque**2, axis=1)
        # v: how many rows carry the evidence of one.
        rows_per_joint = float(fit.degrees[list(columns)].mean())
        v = self.rows_worth_one(T, residual, inverse, k)
        v += rows_per_joint / COARSENING_ROWS
        n_choices = self.n_candidates * self.laws.get(form.key, 1)
        cost = price(trial.freedom, rows_per_joint * len(columns), v, n_choices)
        return replace(
            without_evidence,
            drop=trial.deviance_drop,
            rows_worth_one=v,
            price=float(cost),
            freedom=trial.freedom,
            beta=trial.beta,
            squares=squares * fit.level**2,
        )

    def rows_worth_one(
        self, T: Array, residual: Array, inverse: Array, freedom: float
    ) -> float:
        """Return v, the number of correlated rows that carry the evidence of one
        independent row, for an effective number of coefficients (``freedom``).

        Rows are clustered in two ways, by time and by phase of the motion; the larger v
        counts (:func:`~sdp_vs_penalty.regression.evidence.rows_worth_one`).

        Parameters
        ----------
        T
            (n, M, K) weighted columns, less what the fit explains of them.
        residual
            (n, M) weighted residual r of the fit with the candidate.
        inverse
            (K, K) A^-1, the inverse information matrix.
        """
        scores = np.einsum("jmk,jm->mk", T, residual)  # (rows, K)
        return rows_worth_one(self.data.clusters, scores, inverse, freedom)

    @staticmethod
    def prior(
        fit: WhiteFit, plausible: Array, joints: Sequence[int], energy: Array
    ) -> Array:
        """Return prior standard deviations (..., k) of coefficients about zero.

        An effect is assumed to make no more torque than its joints have, unless it
        declares a plausible size: std = RMS torque of the joints / RMS of the column.

        Parameters
        ----------
        fit
            The fit whose weighted torque is compared with.
        plausible
            (..., k) standard deviations that the effects declare; NaN: not declared.
        joints
            The joints (from 0) on which the effects act.
        energy
            (..., k) sums of squares of the weighted columns.
        """
        energies = fit.design.torque_squared / fit.level**2
        energy_of_torque = float(np.sum(energies[joints]))
        as_large_as_torque = np.sqrt(energy_of_torque / np.maximum(energy, 1e-200))
        return np.where(np.isnan(plausible), as_large_as_torque, plausible)

    # Many candidates at once.

    def absorbed(self, fit: WhiteFit, batch: Batch) -> Array:
        """Return the share (F,) of each candidate's torque that the fit can explain, of
        the squares of its weighted columns, from 0 to 1; 1 for one without any torque.
        """
        products = self._products(fit, batch)
        energy = products.energy.sum(axis=1)
        left = np.trace(products.grams_left, axis1=1, axis2=2)
        return 1.0 - left / nonzero_or_one(energy)

    @staticmethod
    def _products(fit: WhiteFit, batch: Batch) -> _BatchProducts:
        """Multiply the columns of a batch's F candidates with those of a fit."""
        weights = fit.level[list(batch.joints)] ** -2.0
        # Of each joint [A y]'Z and Z'Z, of what its own columns leave.
        pairs = fit.design.products_with(batch, fit.reduced)
        with_shared = sum(w * x for w, (x, _) in zip(weights, pairs, strict=True))
        grams = sum(w * x for w, (_, x) in zip(weights, pairs, strict=True))
        AZ, Zy = with_shared[:-1], with_shared[-1]
        Zr = Zy - fit.theta[: len(AZ)] @ AZ  # the residual is r = y - A theta
        QZ = np.reshape(fit.shared_whitener.T @ AZ, (-1, *grams.shape[:2]))
        ZQ = QZ.transpose(1, 2, 0)  # (F, k, s)
        squares = np.diagonal(batch.grams, axis1=2, axis2=3)
        return _BatchProducts(
            energy=np.tensordot(weights, squares, axes=1),
            with_residual=np.reshape(Zr, grams.shape[:2]),
            grams_left=grams - ZQ @ ZQ.transpose(0, 2, 1),
        )

    def screened(self, fit: WhiteFit, batch: Batch) -> Array:
        """Return a cheap score (F,) of a batch's candidates: drop - k log N.

        drop is the fall of the weighted squared error, k the effective number of
        coefficients and N the number of rows of the batch's joints. Candidates that
        replace one of the model's shape constants are added to the fit without the
        present value; what that value explained is subtracted from the drop.
        """
        fit_without = self.without(fit, batch.forms[0])
        n_rows = float(fit_without.degrees[list(batch.joints)].sum())
        price_per_coefficient = np.log(max(n_rows, 3.0))  # 3: the price is above one
        drop, n_determined = self.explained(fit_without, batch)
        replaces_constant = fit_without is not fit
        if replaces_constant:
            rise = (fit_without.rss - fit.rss) / fit_without.level**2
            drop = drop - float(np.sum(rise))
        return drop - n_determined * price_per_coefficient

    def explained(self, fit: WhiteFit, batch: Batch) -> tuple[Array, Array]:
        """Return how much each candidate of a batch lowers the weighted squared error.

        The F candidates of a batch have k coefficients each, and are added to ``fit``
        one at a time. With D, what the fit leaves of a candidate's Gram matrix Z'Z,
        and its residual r, the coefficients are beta = A^-1
        Z'r with A = D + diag(prior_std^-2), or the constrained minimiser where beta
        violates a sign. drop = 2 beta'Z'r - beta'A beta. Columns that the fit absorbs
        are ignored.

        Returns
        -------
        (F,) array
            The drop of the weighted squared error.
        (F,) array
            The effective number of coefficients, trace(A^-1 D).
        """
        products = self._products(fit, batch)
        energy = products.energy
        D = products.grams_left
        is_visible = np.diagonal(D, axis1=1, axis2=2) > ABSORBED * energy
        D = D * is_visible[:, :, None] * is_visible[:, None, :]
        Zr = products.with_residual * is_visible
        prior_std = self.prior(fit, batch.plausible, list(batch.joints), energy)
        k = Zr.shape[1]
        A = with_ridge(D + np.eye(k) * prior_std[:, :, None] ** -2.0)
        inverse = np.linalg.inv(A)
        beta = (inverse @ Zr[:, :, None])[:, :, 0]
        has_wrong_sign = batch.nonnegative & (beta < 0.0)
        if k == 1:
            beta[has_wrong_sign] = 0.0
        for f in np.flatnonzero(np.any(has_wrong_sign, axis=1) & (k > 1)).tolist():
            beta[f] = bounded_least_squares(A[f], Zr[f], batch.nonnegative[f])
        # For each candidate f: beta'A beta, and the trace of A^-1 D.
        squares = np.einsum("fa,fab,fb->f", beta, A, beta)
        freedom = np.einsum("fab,fba->f", inverse, D)
        drop = 2.0 * np.sum(beta * Zr, axis=1) - squares
        return drop, freedom
