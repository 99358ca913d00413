"""The one score: a penalised likelihood, coarsened and robust.

A candidate beside the model and the terms that were chosen scores

    J = dD / v - (k + s) log(N / v) - 2 log P

with

- the drop dD of the deviance D = sum_j N_j log V_j + RSS_j / V_j, where V_j =
  max(RSS_j / N_j, noise) (:meth:`EvidenceScorer.deviance_drop`);
- the rows v that are worth one (:meth:`EvidenceScorer.rows_worth_one`);
- k coefficients and s continuous shape constants
  (:meth:`EvidenceScorer.parameter_price`). As many coefficients count as the rows
  determine beside what is known of their size. One that its sign holds at zero does not
  count (Meyer, Woodroofe, Ann. Statist. 2000);
- P candidates, times the laws among which this one chooses
  (:meth:`EvidenceScorer.selection_price`): the extended BIC (Chen, Chen, Biometrika
  2008).

Rows are not independent evidence:

    v = max over clusterings of tr(A^-1 S) / k, at least 1, + N / 3000

A = T'T of the candidate's columns T beside all others. S = sum over clusters of u u',
with u the sum of T r within one: the sandwich (Liang, Zeger, Biometrika 1986). Clusters
are stretches of time and, since what a model lacks comes back with the motion, of its
phase. N / 3000 coarsens the likelihood (Miller, Dunson, JASA 2019): no law is right
beyond what some 3000 rows of a joint tell, however many there are.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.diagnosis.constants import ABSORBED, COARSENING_ROWS
from sdp_vs_penalty.diagnosis.library import Batch, Candidate, Key
from sdp_vs_penalty.diagnosis.linear_fit import (
    DEPENDENT,
    ScoredEffect,
    WhiteFit,
    WhiteFitter,
    bounded_least_squares,
    with_ridge,
)
from sdp_vs_penalty.diagnosis.rules import ALL_RULES, Rules
from sdp_vs_penalty.diagnosis.white_rows import WhiteData, cluster_sums
from sdp_vs_penalty.robot.arrays import Array


@dataclass(frozen=True, eq=False)
class _Beside:
    """A candidate beside a fit, and what may move with it.

    to_beat : the fit that the candidate has to improve on. fit : the fit that it is
    added to (without the present value, where the candidate is another value of a
    constant of the model's own). T (n joints, M rows, K) : what that fit's columns
    leave of the candidate's k white columns, which come first, and of further columns
    that may move with it. known (K,) : standard deviations of all coefficients about
    zero, known beforehand.
    """

    form: Candidate
    to_beat: WhiteFit
    fit: WhiteFit
    T: Array
    known: Array

    @property
    def k(self) -> int:
        """The number of coefficients of the candidate itself."""
        return self.form.n_coefficients

    @cached_property
    def gram(self) -> Array:
        """(K, K) the products T'T over all joints and rows."""
        flat = self.T.reshape(-1, self.T.shape[2])
        return np.asarray(flat.T @ flat)

    @cached_property
    def information(self) -> Array:
        """(K, K) the information matrix T'T + diag(known^-2), with the prior on the
        coefficients.
        """
        return np.asarray(self.gram + np.diag(self.known**-2.0))

    @cached_property
    def pull(self) -> Array:
        """(K,) the products T'r with the residual r of the fit."""
        flat = self.T.reshape(-1, self.T.shape[2])
        return np.asarray(flat.T @ self.fit.residual.ravel())

    @cached_property
    def nonnegative(self) -> NDArray[np.bool_]:
        """(K,) flags: which coefficients must not be negative; none of the further
        columns.
        """
        moving = np.zeros(self.T.shape[2] - self.k, bool)
        return np.append(self.form.nonnegative, moving)

    @cached_property
    def beta(self) -> Array:
        """(K,) the coefficients that maximise the posterior, with the sign constraints."""
        return bounded_least_squares(self.information, self.pull, self.nonnegative)

    def deviance_drop_to(self, before: WhiteFit, beta: Array) -> float:
        """Return the drop of the deviance from the fit ``before`` to this fit plus T
        beta.

        The deviance is -2 log L, plus (beta / known)^2 for the prior. beta (K,) are
        coefficients.
        """
        residual = self.fit.residual - self.T @ beta
        after = self.fit.deviance(np.sum(residual**2, axis=1) * self.fit.level**2)
        prior = np.sum((beta / self.known) ** 2)
        return float(self.fit.deviance(before.rss) - after - prior)


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
        rules: Rules = ALL_RULES,
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
            By candidate the number of laws that it chooses among, where there is more
            than one.
        rules
            Which optional rules of the search apply.
        like
            A scorer whose rows may be equal to these; its basis of the model's columns
            is then used again.
        """
        super().__init__(data, like)
        self.n_candidates = max(n_candidates, 1)
        self.laws = laws or {}
        self.rules = rules
        self.laws_by_effect = Counter(name for name, _ in self.laws)

    def evidence_of(
        self,
        fit: WhiteFit,
        form: Candidate,
        columns: dict[int, Array],
    ) -> ScoredEffect:
        """Score a candidate beside a fit, with the model's own shape constants fixed or
        free.

        The candidate is scored twice: with these constants as they are, and with those
        on its joints free to first order, each at the price of one parameter. The
        higher evidence counts. ``columns`` are its white columns, (M, k) by joint. A
        candidate that is another value of an own constant replaces the present value's
        columns.

        Returns
        -------
        ScoredEffect
            The candidate with evidence, coefficients and explained squares.
        """
        fit_without = self.without(fit, form)
        T, known = self.partial_out(fit_without, form, columns)
        beside = _Beside(form, fit, fit_without, T, known)
        term = self._score(beside, columns)
        if form.replaces_own_constant or not self.rules.free_constants:
            return term
        moved = self.score_with_free_constants(beside, columns)
        if moved is None:
            return term
        return max(term, moved, key=lambda t: t.evidence_with_worth_of(term))

    def score_with_free_constants(
        self,
        beside: _Beside,
        columns: dict[int, Array],
    ) -> ScoredEffect | None:
        """Score a candidate while the model's own shape constants on its joints may
        move.

        They move to first order (their derivatives are added as columns), each at the
        price of one parameter. The model's constants were fitted without the candidate,
        and may have absorbed a part of its torque. None where no such constant exists.
        """
        fit = beside.to_beat
        columns_in_fit = set(fit.columns_kept)
        T = beside.T
        for key, derivatives in self.data.constant_derivatives.items():
            _, joint = key
            is_present = columns_in_fit.issuperset(fit.design.columns_of_model[key])
            if joint not in columns or not is_present:
                continue
            if key not in fit.derivatives_left:
                scaled = fit.scaled({joint: derivatives})
                fit.derivatives_left[key] = fit.residual_of(scaled)
            T = np.concatenate([T, fit.derivatives_left[key]], axis=2)
        n_moving = T.shape[2] - beside.k
        if not n_moving or not T[:, :, : beside.k].any():
            return None
        known = np.append(beside.known, np.ones(n_moving))
        return self._score(_Beside(beside.form, fit, fit, T, known), columns)

    def _score(
        self,
        beside: _Beside,
        columns: dict[int, Array],
    ) -> ScoredEffect:
        """Compute the evidence J = dD / v - price of a candidate beside a fit.

        dD is the drop of the deviance, v the number of correlated rows that count as
        one, and the price is (k + s) log(N / v) + 2 log P for its k coefficients and s
        shape constants and for the choice among P candidates and laws. Without any
        visible column, J is minus infinity.
        """
        form = beside.form
        fit = beside.fit
        k = beside.k
        without_evidence = ScoredEffect(form, columns, beta=np.zeros(k))
        if not np.any(beside.gram[:k]):
            return without_evidence
        T = beside.T
        residual = fit.residual - T @ beside.beta
        inverse = np.asarray(np.linalg.inv(with_ridge(beside.information)))
        torque = T[:, :, :k] @ beside.beta[:k]
        if form.replaces_own_constant:
            # It differs from the present value by what the fit with that leaves of it.
            T = beside.to_beat.residual_of(beside.to_beat.scaled(columns))
            energy = float(np.sum(T**2))
            if not DEPENDENT**2 * float(np.sum(beside.T**2)) < energy:
                return without_evidence
            inverse = np.array([[1.0 / energy]])
            torque = T[:, :, 0]
            residual = residual - torque * float(np.sum(torque * residual)) / energy
        count = float(fit.degrees[list(columns)].mean())
        v = self.rows_worth_one(
            T,
            residual,
            inverse,
            beside.T.shape[2],
        )
        if self.rules.coarsening:
            v += count / COARSENING_ROWS
        n_independent = max(count * len(columns) / v, 3.0)
        freedom = self.freedom(beside)
        price = self.parameter_price(freedom, n_independent)
        price += self.selection_price(fit, form)
        return replace(
            without_evidence,
            drop=self.deviance_drop(beside),
            rows_worth_one=v,
            price=price,
            freedom=freedom,
            beta=beside.beta[:k],
            squares=np.sum((torque * fit.level[:, None]) ** 2, axis=1),
        )

    @staticmethod
    def deviance_drop(beside: _Beside) -> float:
        """Return the drop dD of the deviance that is due to the candidate.

        Where further constants may move, the drop that these would bring without the
        candidate is subtracted: it is not the candidate's merit.
        """
        drop = beside.deviance_drop_to(beside.to_beat, beside.beta)
        k = beside.k
        if k < len(beside.beta):
            information = beside.information[k:, k:]
            moved_alone = np.linalg.solve(information, beside.pull[k:])
            without = np.append(np.zeros(k), moved_alone)
            drop -= beside.deviance_drop_to(beside.fit, without)
        return drop

    @staticmethod
    def freedom(beside: _Beside) -> float:
        """Return the effective number of parameters of a candidate, k + s.

        k is the trace of (T'T + prior)^-1 T'T, where T are the candidate's columns
        beside the fit: a coefficient counts 1 if the rows determine it and 0 if only
        the prior does. Coefficients that a sign constraint holds at zero do not count.
        s is the number of continuous shape constants.
        """
        free = np.flatnonzero((beside.beta != 0.0) | ~beside.nonnegative)
        part = np.ix_(free, free)
        solved = np.linalg.solve(
            with_ridge(beside.information[part]), beside.gram[part]
        )
        return float(np.trace(solved)) + beside.form.n_constants

    @staticmethod
    def parameter_price(freedom: float, n_independent: float) -> float:
        """Return (k + s) log(N / v): the price of parameters, as in the BIC.

        freedom is k + s, n_independent is N / v, the number of rows in units of those
        that count as one.
        """
        return float(freedom * np.log(n_independent))

    def selection_price(self, fit: WhiteFit, form: Candidate) -> float:
        """Return 2 log P, the price of choosing among many, as in the extended BIC.

        P is the number of candidates times the number of laws of this one.
        """
        candidates = self.n_competing_candidates(fit, form)
        return float(2.0 * np.log(candidates * self.laws.get(form.key, 1)))

    def n_competing_candidates(self, fit: WhiteFit, form: Candidate) -> float:
        """Return the number of candidates among which this one was chosen.

        Joints of one arm are similar. Once effects are in the fit, half of the prior
        probability therefore goes to the same effects on other joints: such a candidate
        competes with twice the number of joints' candidates of its effect, any other
        candidate with twice the number of all.
        """
        keys = fit.design.keys
        effects_in_fit = {keys[i] for i in fit.columns_kept if i in keys}
        if not effects_in_fit or not self.rules.joints_alike:
            return float(self.n_candidates)
        name, joint = form.key
        if any(other == name and j != joint for other, j in effects_in_fit):
            return 2.0 * self.laws_by_effect[name]
        return 2.0 * self.n_candidates

    def rows_worth_one(
        self,
        T: Array,
        residual: Array,
        inverse: Array,
        freedom: float,
    ) -> float:
        """Return v, the number of correlated rows that carry the evidence of one
        independent row.

        v = tr(A^-1 S) / freedom, at least 1, where S sums the outer products of the
        score T'r over clusters of rows (the middle of the sandwich covariance). Of the
        two ways to cluster rows, by time and by phase of the motion, the larger v
        counts.

        Parameters
        ----------
        T
            (n, M, K) columns beside the fit.
        residual
            (n, M) residual with the candidate.
        inverse
            (K, K) A^-1, the inverse information matrix.
        freedom
            Effective number of coefficients.
        """
        scores = np.sum(T * residual[:, :, None], axis=0)[: len(self.data.clusters[0])]
        sums = cluster_sums(self.data.clusters, scores)
        # tr(A^-1 sum u u') = sum of u' A^-1 u over the clusters' sums u.
        traces = [float(np.sum((u @ inverse) * u)) for u in sums]
        return max(1.0, *(trace / freedom for trace in traces))

    def partial_out(
        self,
        fit: WhiteFit,
        form: Candidate,
        columns: dict[int, Array],
    ) -> tuple[Array, Array]:
        """Return what a fit leaves of a candidate's weighted columns, and the prior of
        its sizes.

        Columns of which the fit's columns absorb all but 0.1 % (ABSORBED) are set to
        zero.

        Returns
        -------
        (n, M, k) array
            The columns, orthogonal to the fit's.
        (k,) array
            Standard deviations of their coefficients about zero.
        """
        scaled = fit.scaled(columns)
        energy = np.sum([np.sum(z**2, axis=0) for z in scaled.values()], axis=0)
        T = fit.residual_of(scaled)
        T = T * (np.sum(T**2, axis=(0, 1)) > ABSORBED * energy)
        return T, self.prior(fit, form.plausible, list(columns), energy)

    @staticmethod
    def prior(
        fit: WhiteFit,
        plausible: Array,
        joints: Sequence[int],
        energy: Array,
    ) -> Array:
        """Return standard deviations (..., k) of coefficients about zero, before any
        measurement.

        They are what the effects declare as plausible (``plausible``). Where an effect
        declares nothing (NaN), it is assumed to make no more torque than its joints
        have: the RMS torque of ``joints`` over the RMS of the column. energy (..., k)
        holds the squares of the weighted columns.
        """
        energy_of_torque = float(np.sum(fit.target[joints] ** 2))
        as_large_as_torque = np.sqrt(energy_of_torque / np.maximum(energy, 1e-200))
        return np.where(np.isnan(plausible), as_large_as_torque, plausible)

    # Many candidates at once.

    def absorbed(self, fit: WhiteFit, batch: Batch) -> Array:
        """Return (F,) shares of each candidate's squares that the fit's columns absorb.

        A candidate without any torque counts as absorbed: 1.
        """
        G, _, raw = self._products(fit, batch)
        energy = np.trace(raw, axis1=1, axis2=2)
        share = np.ones(len(energy))
        np.divide(
            np.sum(G**2, axis=(0, 2)),
            energy,
            out=share,
            where=energy > 0.0,
        )
        return share

    @staticmethod
    def _products(fit: WhiteFit, batch: Batch) -> tuple[Array, Array, Array]:
        """Return the products of a batch's F candidates of k weighted columns each.

        Returns
        -------
        (r, F, k) array
            With the fit's r orthonormal columns.
        (F, k) array
            With the fit's residual.
        (F, k, k) array
            Of each candidate's columns with each other.
        """
        F = len(batch.forms)
        k = batch.forms[0].n_coefficients
        weights = fit.level[list(batch.joints)] ** -2.0
        # By joint: its weight, A'Z (p, F k) and Z'y (F k,).
        by_joint = list(zip(weights, fit.design.products_with(batch), strict=True))
        cross = sum(w * AZ for w, (AZ, _) in by_joint)
        pull = sum(w * Zy for w, (_, Zy) in by_joint) - fit.theta @ cross
        raw = np.tensordot(weights, batch.grams, axes=1)
        along = np.reshape(fit.whitener.T @ cross, (-1, F, k))
        return along, np.reshape(pull, (F, k)), raw

    def screened(self, fit: WhiteFit, batch: Batch) -> Array:
        """Return a cheap score (F,) of a batch's candidates: drop - k log N.

        drop is the fall of the weighted squared error, k the effective number of
        coefficients and N the number of rows of the batch's joints. A candidate that
        replaces one of the model's own constants starts without the present one, whose
        part is subtracted.
        """
        fit_without = self.without(fit, batch.forms[0])
        n_rows = float(fit_without.degrees[list(batch.joints)].sum())
        price = np.log(max(n_rows, 3.0))
        drop, n_determined = self.explained(fit_without, batch)
        if fit_without is not fit:
            rise = (fit_without.rss - fit.rss) / fit_without.level**2
            drop = drop - float(np.sum(rise))
        return np.asarray(drop - n_determined * price)

    def explained(
        self,
        fit: WhiteFit,
        batch: Batch,
    ) -> tuple[Array, Array]:
        """Return how much each candidate of a batch lowers the weighted squared error.

        Returns
        -------
        (F,) array
            The drop of the weighted squared error.
        (F,) array
            The effective number of coefficients, those that the rows determine.
        """
        if batch.forms[0].n_coefficients == 1:
            return self._drop_of_one_column(fit, batch), np.ones(len(batch.forms))
        return self._drop_of_columns(fit, batch)

    def _drop_of_one_column(self, fit: WhiteFit, batch: Batch) -> Array:
        """Return the drop (F,) of the weighted squared error by candidates with one
        column.

        It is (z'r)^2 / z'z for what the fit leaves of the column z. Zero if that is
        less than ABSORBED of the column, or if its coefficient had the wrong sign.
        """
        G, pull, raw = self._products(fit, batch)
        energy = raw[:, 0, 0]
        energy_left = energy - np.sum(G[:, :, 0] ** 2, axis=0)
        is_visible = ABSORBED * energy < energy_left
        has_wrong_sign = batch.signed & (pull[:, 0] < 0.0)
        counts = is_visible & ~has_wrong_sign
        divisor = np.where(counts, energy_left, 1.0)
        return np.where(counts, pull[:, 0] ** 2 / divisor, 0.0)

    def _drop_of_columns(
        self,
        fit: WhiteFit,
        batch: Batch,
    ) -> tuple[Array, Array]:
        """Return the drop of the weighted squared error by candidates with several
        columns.

        Coefficients have the prior of :meth:`prior`; columns that the fit absorbs are
        ignored, and sign constraints hold.

        Returns
        -------
        (F,) array
            The drop of the weighted squared error.
        (F,) array
            The effective number of coefficients.
        """
        G, pull, raw = self._products(fit, batch)
        G = G.transpose(1, 2, 0)  # (F, k, r)
        D = raw - G @ G.transpose(0, 2, 1)  # (F, k, k): what the fit leaves of Z'Z
        energy = np.diagonal(raw, axis1=1, axis2=2)
        is_visible = np.diagonal(D, axis1=1, axis2=2) > ABSORBED * energy
        D = D * is_visible[:, :, None] * is_visible[:, None, :]
        pull = pull * is_visible
        known = self.prior(
            fit,
            batch.plausible,
            list(batch.joints),
            energy,
        )
        k = pull.shape[1]
        A = with_ridge(D + np.eye(k) * known[:, :, None] ** -2.0)
        inverse = np.linalg.inv(A)
        beta = (inverse @ pull[:, :, None])[:, :, 0]
        nonnegative = np.array([f.nonnegative for f in batch.forms])
        is_below = np.any(nonnegative & (beta < 0.0), axis=1)
        for f in np.flatnonzero(is_below).tolist():
            beta[f] = bounded_least_squares(
                A[f],
                pull[f],
                nonnegative[f],
            )
        # For each candidate: beta'A beta, and the trace of A^-1 D.
        squares = np.einsum("fa,fab,fb->f", beta, A, beta)
        freedom = np.einsum("fab,fba->f", inverse, D)
        drop = 2.0 * np.sum(beta * pull, axis=1) - squares
        return drop, freedom
