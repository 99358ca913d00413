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

    to_beat : the fit that it has to better; fit : beside which it stands; T (n, M, K) :
    what that leaves of its k columns, which come first, and of what else may move; known
    (K,) : standard deviations of all coefficients about zero.
    """

    form: Candidate
    to_beat: WhiteFit
    fit: WhiteFit
    T: Array
    known: Array

    @property
    def k(self) -> int:
        """How many coefficients the candidate has."""
        return self.form.n_coefficients

    @cached_property
    def gram(self) -> Array:
        """(K, K) products of the columns."""
        flat = self.T.reshape(-1, self.T.shape[2])
        return np.asarray(flat.T @ flat)

    @cached_property
    def information(self) -> Array:
        """(K, K) the same with what is known of the sizes."""
        return np.asarray(self.gram + np.diag(self.known**-2.0))

    @cached_property
    def pull(self) -> Array:
        """(K,) products of the columns with the residual."""
        flat = self.T.reshape(-1, self.T.shape[2])
        return np.asarray(flat.T @ self.fit.residual.ravel())

    @cached_property
    def nonnegative(self) -> NDArray[np.bool_]:
        """(K,) which coefficients may not be negative."""
        moving = np.zeros(self.T.shape[2] - self.k, bool)
        return np.append(self.form.nonnegative, moving)

    @cached_property
    def beta(self) -> Array:
        """(K,) coefficients."""
        return bounded_least_squares(self.information, self.pull, self.nonnegative)

    def deviance_drop_to(self, before: WhiteFit, beta: Array) -> float:
        """Of the deviance, from a fit to this one with coefficients beta (K,)."""
        left = self.fit.residual - self.T @ beta
        after = self.fit.deviance(np.sum(left**2, axis=1) * self.fit.level**2)
        prior = np.sum((beta / self.known) ** 2)
        return float(self.fit.deviance(before.rss) - after - prior)


class EvidenceScorer(WhiteFitter):
    """The score of candidates on some rows.

    n_candidates : that there are; laws : among how many each of them chooses, if more
    than one; like : a scorer whose rows may be the same.
    """

    def __init__(
        self,
        data: WhiteData,
        n_candidates: int,
        laws: Mapping[Key, int] | None = None,
        rules: Rules = ALL_RULES,
        like: WhiteFitter | None = None,
    ) -> None:
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
        """A candidate beside a fit, with the model's constants as they are or free.

        Another constant of the model's own effect stands in that one's place.
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
        """The candidate where the model's constants on its joints move with it, to first
        order and at the price of as many numbers; None where there are none.

        Constants that were fitted without an effect have made a part of its torque.
        """
        fit = beside.to_beat
        there = set(fit.columns_kept)
        T = beside.T
        for name, j in self.data.constants:
            if j not in columns or not there.issuperset(fit.design.model[name, j]):
                continue
            if (name, j) not in fit.moved:
                scaled = fit.scaled({j: self.data.constants[name, j]})
                fit.moved[name, j] = fit.residual_of(scaled)
            T = np.concatenate([T, fit.moved[name, j]], axis=2)
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
        """The score of a candidate whose columns are partialled out."""
        form = beside.form
        fit = beside.fit
        k = beside.k
        none = ScoredEffect(form, columns, beta=np.zeros(k))
        if not np.any(beside.gram[:k]):
            return none
        T = beside.T
        left = fit.residual - T @ beside.beta
        inverse = np.asarray(np.linalg.inv(with_ridge(beside.information)))
        torque = T[:, :, :k] @ beside.beta[:k]
        if form.replaces_own_constant:  # what its other constant makes of the torque
            T = beside.to_beat.residual_of(beside.to_beat.scaled(columns))
            energy = float(np.sum(T**2))
            if not DEPENDENT**2 * float(np.sum(beside.T**2)) < energy:
                return none
            inverse = np.array([[1.0 / energy]])
            torque = T[:, :, 0]
            left = left - torque * float(np.sum(torque * left)) / energy
        count = float(fit.degrees[list(columns)].mean())
        v = self.rows_worth_one(
            T,
            left,
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
            none,
            drop=self.deviance_drop(beside),
            rows_worth_one=v,
            price=price,
            freedom=freedom,
            beta=beside.beta[:k],
            squares=np.sum((torque * fit.level[:, None]) ** 2, axis=1),
        )

    @staticmethod
    def deviance_drop(beside: _Beside) -> float:
        """dD. What free constants would do without the candidate is not its merit."""
        drop = beside.deviance_drop_to(beside.to_beat, beside.beta)
        k = beside.k
        if k < len(beside.beta):
            information = beside.information[k:, k:]
            alone = np.linalg.solve(information, beside.pull[k:])
            without = np.append(np.zeros(k), alone)
            drop -= beside.deviance_drop_to(beside.fit, without)
        return drop

    @staticmethod
    def freedom(beside: _Beside) -> float:
        """k + s: as many coefficients as the rows determine, and the shape constants."""
        free = np.flatnonzero((beside.beta != 0.0) | ~beside.nonnegative)
        part = np.ix_(free, free)
        solved = np.linalg.solve(
            with_ridge(beside.information[part]), beside.gram[part]
        )
        return float(np.trace(solved)) + beside.form.constants

    @staticmethod
    def parameter_price(freedom: float, n_independent: float) -> float:
        """(k + s) log(N / v)."""
        return float(freedom * np.log(n_independent))

    def selection_price(self, fit: WhiteFit, form: Candidate) -> float:
        """2 log P, with P the candidates times the laws of this one."""
        candidates = self.n_competing_candidates(fit, form)
        return float(2.0 * np.log(candidates * self.laws.get(form.key, 1)))

    def n_competing_candidates(self, fit: WhiteFit, form: Candidate) -> float:
        """Among how many candidates one is chosen.

        Joints of an arm are built alike: beside findings half of the odds are for
        effects that act on another joint already.
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
        left: Array,
        inverse: Array,
        freedom: float,
    ) -> float:
        """By how much the sandwich's middle is larger than T'T, at least 1.

        It is that of the clusters that make most of it, for a fit with so much freedom.
        """
        scores = np.sum(T * left[:, :, None], axis=0)[: len(self.data.clusters[0])]
        sums = cluster_sums(self.data.clusters, scores)
        return max(1.0, *(float(np.sum((u @ inverse) * u)) / freedom for u in sums))

    def partial_out(
        self,
        fit: WhiteFit,
        form: Candidate,
        columns: dict[int, Array],
    ) -> tuple[Array, Array]:
        """(n, M, k) what a fit leaves of a candidate's weighted columns, and (k,) the
        known standard deviations of their coefficients.

        Nothing is left of a column that the fit makes itself.
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
        """(..., k) standard deviations of coefficients about zero before anything is
        measured.

        They are what the effects say. Where one says none (NaN), it makes no more torque
        than its joints have in all. energy (..., k) : of the weighted columns.
        """
        energy_of_torque = float(np.sum(fit.target[joints] ** 2))
        as_large_as_torque = np.sqrt(energy_of_torque / np.maximum(energy, 1e-200))
        return np.where(np.isnan(plausible), as_large_as_torque, plausible)

    # Many candidates at once.

    def absorbed(self, fit: WhiteFit, batch: Batch) -> Array:
        """(F,) share of each candidate's energy that the fit's columns make; 1 where it
        has none."""
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
        """Of a batch's weighted columns: with a fit's (r, F, k), with what it leaves
        (F, k), and of each candidate's with each other (F, k, k)."""
        F = len(batch.forms)
        k = batch.forms[0].n_coefficients
        weights = fit.level[list(batch.joints)] ** -2.0
        pairs = list(
            zip(
                weights,
                fit.design.of(batch),
                strict=True,
            )
        )
        cross = sum(w * AZ for w, (AZ, _) in pairs)
        pull = sum(w * Zy for w, (_, Zy) in pairs) - fit.theta @ cross
        raw = np.tensordot(weights, batch.grams, axes=1)
        along = np.reshape(fit.whitener.T @ cross, (-1, F, k))
        return along, np.reshape(pull, (F, k)), raw

    def screened(self, fit: WhiteFit, batch: Batch) -> Array:
        """(F,) drop of the weighted squared error less k log N, of a batch."""
        to_beat = fit
        fit = self.without(fit, batch.forms[0])
        degrees = float(fit.degrees[list(batch.joints)].sum())
        price = np.log(max(degrees, 3.0))
        drop, size = self.explained(fit, batch)
        if fit is not to_beat:
            drop = drop - float(np.sum((fit.rss - to_beat.rss) / fit.level**2))
        return np.asarray(drop - size * price)

    def explained(
        self,
        fit: WhiteFit,
        batch: Batch,
    ) -> tuple[Array, Array]:
        """(F,) drop of the weighted squared error, and how many coefficients the rows
        determine, of a batch."""
        if batch.forms[0].n_coefficients == 1:
            return self._drop_of_one_column(fit, batch), np.ones(len(batch.forms))
        return self._drop_of_columns(fit, batch)

    def _drop_of_one_column(self, fit: WhiteFit, batch: Batch) -> Array:
        """(F,) drop of the weighted squared error, of candidates with one column."""
        G, pull, raw = self._products(fit, batch)
        energy = raw[:, 0, 0]
        D = energy - np.sum(G[:, :, 0] ** 2, axis=0)
        good = (ABSORBED * energy < D) & ~(batch.signed & (pull[:, 0] < 0.0))
        return np.where(
            good,
            pull[:, 0] ** 2 / np.where(good, D, 1.0),
            0.0,
        )

    def _drop_of_columns(
        self,
        fit: WhiteFit,
        batch: Batch,
    ) -> tuple[Array, Array]:
        """(F,) the same of candidates with several columns; and (F,) how many
        coefficients the rows determine."""
        G, pull, raw = self._products(fit, batch)
        G = G.transpose(1, 2, 0)
        D = raw - G @ G.transpose(0, 2, 1)
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
        squares = np.einsum("fa,fab,fb->f", beta, A, beta)
        drop = 2.0 * np.sum(beta * pull, axis=1) - squares
        return drop, np.einsum("fab,fba->f", inverse, D)
