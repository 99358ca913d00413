"""The one score: a penalised likelihood whose evidence is coarsened and robust against
what a model lacks.

A form beside the model and the terms that were chosen scores

    J = dD / v - (k + s) log(N / v) - 2 log P

with the drop dD of the deviance D = sum_j N_j log V_j + RSS_j / V_j, V_j = max(RSS_j /
N_j, noise); k coefficients (as many as the rows determine beside what is known of their
size, of those that are not held at zero by their sign: Meyer, Woodroofe, Ann. Statist.
2000), s continuous shape constants, P candidates that are looked at, times the laws
among which this one chooses: the extended BIC (Chen, Chen, Biometrika 2008). Beside
findings P is twice as many, or twice as many as there are of an effect that was found
on another joint: half of the odds are that joints are built alike. Evidence is worth v
times less than independent rows would make it:

    v = max over clusterings of tr(A^-1 S) / k, at least 1, + N / ALPHA

A = T'T of the form's columns T beside all others, S = sum over clusters u u', u = sum
of T r within one: the sandwich (Liang, Zeger, Biometrika 1986), by time and, since what
a model lacks comes back with the motion, by phase. N / ALPHA coarsens the likelihood
(Miller, Dunson, JASA 2019): no law is right beyond what ALPHA rows of a joint tell,
however many there are.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from sdp_vs_penalty.diagnosis.candidates import Batch, Candidate, Key
from sdp_vs_penalty.diagnosis.constants import ABSORBED, COARSENING_ROWS
from sdp_vs_penalty.diagnosis.nuisances import Nuisance
from sdp_vs_penalty.diagnosis.whitening import WhiteData, cluster_sums
from sdp_vs_penalty.robot.arrays import Array, nonzero_or_one

#: Share of a column below which what others leave of it is rounding.
DEPENDENT = 1e-5


@dataclass(frozen=True, eq=False)
class ScoredEffect:
    """A form with its white columns (M, k) by joint, judged beside others: the drop of
    the deviance, how many rows are worth one, and the form's price; its coefficients
    (k,), the squares (n,) of the white torque that nothing else makes, and the forms
    that do as well. Equal to itself alone."""

    form: Candidate
    columns: dict[int, Array]
    drop: float = -np.inf
    rows_worth_one: float = 1.0
    price: float = 0.0
    beta: Array = field(default_factory=lambda: np.zeros(0))
    squares: Array = field(default_factory=lambda: np.zeros(0))
    rivals: tuple[ScoredEffect, ...] = ()

    @property
    def evidence(self) -> float:
        return self.drop / self.rows_worth_one - self.price

    def evidence_with_worth_of(self, other: ScoredEffect) -> float:
        """J where rows are worth what they are to another term: of two that make nearly
        the same torque the estimated worths alone differ by more than the evidence
        between them."""
        return self.drop / other.rows_worth_one - self.price

    @property
    def key(self) -> tuple[str, int | None]:
        return self.form.key

    @property
    def text(self) -> str:
        return self.form.effect.text

    @property
    def joints(self) -> frozenset[int]:
        return frozenset(self.columns)


@dataclass(frozen=True, eq=False)
class Design:
    """White columns A (n, M, p) of the model and of terms, of unit length; y (n, M) the
    torque; gram (n, p, p), pull (n, p) : A'A, A'y; model : by key the column of each of
    its own effects whose constant may be another one, under None those of all others;
    at : each term's columns, by text. keys : of a term's column; extra (n,) : rows of a
    joint behind its own, each saying that a misfit's coefficient is zero, or its share
    of one that several joints say.
    """

    A: Array
    y: Array
    gram: Array
    pull: Array
    model: Mapping[Key | None, list[int]]
    at: dict[str, list[int]]
    keys: dict[int, Key]
    extra: Array
    products: dict[Batch, list[tuple[Array, Array]]] = field(default_factory=dict)

    def holds(self, terms: Sequence[ScoredEffect | Nuisance]) -> bool:
        return all(t.text in self.at for t in terms)

    def of(self, batch: Batch) -> list[tuple[Array, Array]]:
        """By joint, A'Z (p, F k) and Z'y (F k,) of a batch's columns Z."""
        if batch not in self.products:
            M = batch.whitened_columns.shape[1]
            pairs = zip(batch.joints, batch.whitened_columns, strict=True)
            self.products[batch] = [
                (self.A[j, :M].T @ Z, Z.T @ self.y[j, :M]) for j, Z in pairs
            ]
        return self.products[batch]


@dataclass(frozen=True)
class WhiteFit:
    """The model and some terms fitted to white rows, each joint's divided by its
    ``level`` (n,).

    columns_kept : the columns that take part; whitener (p, r) : the columns A W, divided by the
    levels, are orthonormal; theta (p,) : coefficients; residual (n, M) : what they
    leave; rss, degrees (n,) : squared error in units of the noise, and rows less the
    joint's share of the rank.
    """

    design: Design
    columns_kept: tuple[int, ...]
    whitener: Array
    theta: Array
    level: Array
    residual: Array
    rss: Array
    degrees: Array
    floor: float
    apart: dict[Key, WhiteFit] = field(default_factory=dict)
    moved: dict[tuple[str, int], Array] = field(default_factory=dict)

    @property
    def target(self) -> Array:
        """(n, M) weighted torque."""
        return np.asarray(self.design.y / self.level[:, None])

    @cached_property
    def basis(self) -> Array:
        """(n, M, r) an orthonormal one of the columns."""
        return np.asarray(self.design.A @ self.whitener / self.level[:, None, None])

    def deviance(self, rss: Array) -> Array:
        """(...,) -2 log L of the joints' squared errors (..., n)."""
        v = np.maximum(rss / self.degrees, self.floor)
        return np.asarray(np.sum(self.degrees * np.log(v) + rss / v, axis=-1))

    def scaled(self, columns: dict[int, Array]) -> dict[int, Array]:
        return {j: z / self.level[j] for j, z in columns.items()}

    def residual_of(self, scaled: dict[int, Array]) -> Array:
        """(n, M, k) what the fit leaves of columns, all of them weighted."""
        A = self.design.A
        along = sum(A[j, : len(z)].T @ (z / self.level[j]) for j, z in scaled.items())
        left = -(
            A @ (self.whitener @ (self.whitener.T @ along)) / self.level[:, None, None]
        )
        for j, z in scaled.items():
            left[j, : len(z)] += z
        return np.asarray(left)

    def energy(self, term: ScoredEffect) -> float:
        """Weighted squares of what the fit leaves of a term."""
        return float(
            np.sum((self.residual_of(self.scaled(term.columns)) @ term.beta) ** 2)
        )


class EvidenceScorer:
    """The score of forms on some rows; n_candidates : candidates that there are; laws : among
    how many each of them chooses, if more than one."""

    def __init__(
        self, data: WhiteData, n_candidates: int, laws: Mapping[Key, int] | None = None
    ) -> None:
        self.data, self.n_candidates, self.laws = data, max(n_candidates, 1), laws or {}
        self.floor = 1.0 if data.known else 1e-12
        self.laws_by_effect = Counter(name for name, _ in self.laws)

    @cached_property
    def _basis(self) -> tuple[Array, Array, dict[Key | None, list[int]]]:
        """(n, M, r) a basis of the model's columns, with those of effects whose
        constant may be another one by themselves; its products (n, r, r); and where
        whose stand."""
        X = self.data.X
        own_columns = self.data.own_effects
        n, M, _ = X.shape
        separate_columns = [column for _, column in own_columns.values()]
        B = orthonormal(np.delete(X, separate_columns, axis=2).reshape(n * M, -1))
        r = B.shape[1]
        B = np.concatenate(
            [B.reshape(n, M, r), _unit(X[:, :, separate_columns])], axis=2
        )
        at: dict[Key | None, list[int]] = {None: list(range(r))}
        return (
            B,
            B.transpose(0, 2, 1) @ B,
            at | {key: [r + k] for k, key in enumerate(own_columns)},
        )

    def fit(
        self, terms: Sequence[ScoredEffect | Nuisance], near: WhiteFit | None = None
    ) -> WhiteFit:
        """The model with the terms, each joint's rows weighted by what is left of them;
        near : a fit whose columns serve where they hold the terms', and at whose levels
        it begins."""
        design = (
            near.design
            if near is not None and near.design.holds(terms)
            else self._design(terms)
        )
        others = {
            t.key
            for t in terms
            if isinstance(t, ScoredEffect) and t.form.replaces_own_constant
        }
        model_columns_kept = [
            i
            for key, columns in design.model.items()
            if key not in others
            for i in columns
        ]
        columns_kept = (
            *model_columns_kept,
            *sorted(i for t in terms for i in design.at[t.text]),
        )
        return self._fitted(
            design, columns_kept, np.ones(len(design.y)) if near is None else near.level
        )

    def without(self, fit: WhiteFit, form: Candidate) -> WhiteFit:
        """A fit, at its levels, without what a form stands in the place of; itself
        where that is nothing."""
        if not form.replaces_own_constant:
            return fit
        if form.key not in fit.apart:
            left = tuple(
                i for i in fit.columns_kept if i not in fit.design.model[form.key]
            )
            fit.apart[form.key] = self._fitted(fit.design, left, fit.level, rounds=1)
        return fit.apart[form.key]

    def _design(self, terms: Sequence[ScoredEffect | Nuisance]) -> Design:
        B, gram, model = self._basis
        n, M, r = B.shape
        ends = np.cumsum(
            [r, *(next(iter(t.columns.values())).shape[1] for t in terms)]
        ).tolist()
        blocks = list(zip(terms, ends, ends[1:], strict=False))
        extra = np.zeros(n)
        behind = np.full(n, M)
        for t, first, stop in blocks:
            if isinstance(t, Nuisance):
                extra[[*t.columns]] += (stop - first) / len(t.columns)
                behind[[*t.columns]] += stop - first
        A = np.zeros((n, behind.max(initial=M), ends[-1]))
        behind[:] = M
        A[:, :M, :r] = B
        at = dict[str, list[int]]()
        for t, first, stop in blocks:
            at[t.text] = list(range(first, stop))
            for j, z in t.columns.items():
                A[j, :M, first:stop] = z
                if isinstance(t, Nuisance):
                    row = behind[j] + np.arange(stop - first)
                    A[j, row, at[t.text]] = 1.0 / t.deviations / len(t.columns) ** 0.5
                    behind[j] += len(row)
        G = np.zeros((n, ends[-1], ends[-1]))
        G[:, :r, :r] = gram
        for j in range(n):
            columns_on_joint = [i for t in terms if j in t.columns for i in at[t.text]]
            cross = A[j].T @ A[j][:, columns_on_joint]
            G[j][:, columns_on_joint], G[j][columns_on_joint] = cross, cross.T
        scale = np.ones(ends[-1])
        scale[r:] = 1.0 / nonzero_or_one(
            np.sqrt(np.sum(np.diagonal(G, axis1=1, axis2=2), axis=0)[r:])
        )
        A[:, :, r:] *= scale[r:]
        G *= scale[:, None] * scale
        y = np.zeros(A.shape[:2])
        y[:, :M] = self.data.y
        pull = (A.transpose(0, 2, 1) @ y[:, :, None])[:, :, 0]
        keys = {
            i: t.key for t in terms if isinstance(t, ScoredEffect) for i in at[t.text]
        }
        return Design(A, y, G, pull, model, at, keys, extra)

    def _fitted(
        self, design: Design, columns: tuple[int, ...], level: Array, rounds: int = 20
    ) -> WhiteFit:
        """rounds : of coefficients and levels in turn, at most; each raises the
        likelihood, and six were the most on three arms; one: at the levels as they are.
        """
        columns_kept = np.array(columns, int)
        G = design.gram.take(columns_kept, 1).take(columns_kept, 2)
        pull = design.pull[:, columns_kept]
        flat_gram = G.reshape(len(G), -1)
        square = np.sum(design.y**2, axis=1)
        degrees = self.data.count + design.extra
        for _ in range(rounds):
            L = _triangle((level**-2.0 @ flat_gram).reshape(G.shape[1:]))
            theta = scipy.linalg.cho_solve(
                (L, True), level**-2.0 @ pull, check_finite=False
            )
            rss = np.maximum(square - 2.0 * pull @ theta + (G @ theta) @ theta, 0.0)
            last = level
            level = np.sqrt(np.maximum(rss / degrees, self.floor))
            if np.all(np.abs(level - last) < 1e-2 * level):
                break
        root = scipy.linalg.solve_triangular(
            L, np.eye(len(L)), lower=True, check_finite=False
        ).T
        p = design.A.shape[2]
        W = np.zeros((p, len(columns_kept)))
        all_theta = np.zeros(p)
        W[columns_kept], all_theta[columns_kept] = root, theta
        residual = (design.y - design.A @ all_theta) / last[:, None]
        rss = np.sum(residual**2, axis=1) * last**2
        degrees = np.maximum(
            degrees - flat_gram @ (root @ root.T).ravel() / last**2, 1.0
        )
        return WhiteFit(
            design, columns, W, all_theta, last, residual, rss, degrees, self.floor
        )

    def evidence_of(
        self, fit: WhiteFit, form: Candidate, columns: dict[int, Array]
    ) -> ScoredEffect:
        """A form beside a fit, the better of two: the model's constants on its joints
        stay as they are, or move with it. Another constant of the model's own effect
        stands in that one's place."""
        fit_without = self.without(fit, form)
        there = set(fit.columns_kept)
        T, known = self.partial_out(fit_without, form, columns)
        term = self._evidence_of(fit, fit_without, form, columns, T, known)
        moving = (
            []
            if form.replaces_own_constant
            else [key for key in self.data.constants if key[1] in columns]
        )
        for name, j in (
            key for key in moving if there.issuperset(fit.design.model[key])
        ):
            if (name, j) not in fit.moved:
                fit.moved[name, j] = fit.residual_of(
                    fit.scaled({j: self.data.constants[name, j]})
                )
            T = np.concatenate([T, fit.moved[name, j]], axis=2)
        if (
            T.shape[2] == form.n_coefficients
            or not T[:, :, : form.n_coefficients].any()
        ):
            return term
        known = np.append(known, np.ones(T.shape[2] - form.n_coefficients))
        moved = self._evidence_of(fit, fit, form, columns, T, known)
        return max(term, moved, key=lambda t: t.evidence_with_worth_of(term))

    def _evidence_of(
        self,
        fit_to_beat: WhiteFit,
        fit: WhiteFit,
        form: Candidate,
        columns: dict[int, Array],
        T: Array,
        known: Array,
    ) -> ScoredEffect:
        """fit_to_beat : the fit that it has to better, fit : beside which it stands; T (n, M,
        K) : what that leaves of its columns and of what else may move; known (K,) :
        standard deviations of sizes."""
        none = ScoredEffect(form, columns, beta=np.zeros(form.n_coefficients))
        K = T.shape[2]
        low = np.append(form.nonnegative, np.zeros(K - form.n_coefficients, bool))
        flat = T.reshape(-1, K)
        D = flat.T @ flat
        if not np.any(D[: form.n_coefficients]):
            return none
        A = D + np.diag(known**-2.0)
        pull = flat.T @ fit.residual.ravel()
        inverse = np.asarray(np.linalg.inv(_ridged(A)))
        beta = _bounded(A, pull, low)

        def gained(before: WhiteFit, beta: Array) -> float:
            left = fit.residual - T @ beta
            after = fit.deviance(np.sum(left**2, axis=1) * fit.level**2)
            return float(fit.deviance(before.rss) - after - np.sum((beta / known) ** 2))

        drop = gained(fit_to_beat, beta)
        if (
            form.n_coefficients < K
        ):  # what those would do without the form is not its merit
            more = np.linalg.solve(
                A[form.n_coefficients :, form.n_coefficients :],
                pull[form.n_coefficients :],
            )
            drop -= gained(fit, np.append(np.zeros(form.n_coefficients), more))
        on = list(columns)
        some = np.flatnonzero((beta != 0.0) | ~low)
        part = np.ix_(some, some)
        size = float(np.trace(np.linalg.solve(_ridged(A[part]), D[part])))
        count = float(fit.degrees[on].mean())
        left = fit.residual - T @ beta
        beta = beta[: form.n_coefficients]
        torque = T[:, :, : form.n_coefficients] @ beta
        if form.replaces_own_constant:  # what its other constant makes of it
            T = fit_to_beat.residual_of(fit_to_beat.scaled(columns))
            energy = float(np.sum(T**2))
            if not DEPENDENT**2 * float(np.sum(flat**2)) < energy:
                return none
            inverse = np.array([[1.0 / energy]])
            torque = T[:, :, 0]
            left = left - torque * float(np.sum(torque * left)) / energy
        v = self.rows_worth_one(T, left, inverse, K) + count / COARSENING_ROWS
        N = max(count * len(on) / v, 3.0)
        looked = self.n_competing_candidates(fit, form) * self.laws.get(form.key, 1)
        price = float((size + form.constants) * np.log(N) + 2.0 * np.log(looked))
        squares = np.sum((torque * fit.level[:, None]) ** 2, axis=1)
        return replace(
            none, drop=drop, rows_worth_one=v, price=price, beta=beta, squares=squares
        )

    def partial_out(
        self, fit: WhiteFit, form: Candidate, columns: dict[int, Array]
    ) -> tuple[Array, Array]:
        """(n, M, k) what a fit leaves of a form's columns, all of them weighted,
        nothing of those that the fit makes itself; and (k,) standard deviations that
        are known of their coefficients."""
        scaled = fit.scaled(columns)
        energy = np.sum([np.sum(z**2, axis=0) for z in scaled.values()], axis=0)
        T = fit.residual_of(scaled)
        T = T * (np.sum(T**2, axis=(0, 1)) > ABSORBED * energy)
        return T, self.prior(fit, form.plausible, list(columns), energy)

    def n_competing_candidates(self, fit: WhiteFit, form: Candidate) -> float:
        """Among how many candidates one is chosen: beside findings half of the odds are
        for effects that act on another joint already, as joints of an arm are built
        alike."""
        effects_in_fit = {
            fit.design.keys[i] for i in fit.columns_kept if i in fit.design.keys
        }
        (name, joint), all_candidates = (
            form.key,
            self.n_candidates * (2.0 if effects_in_fit else 1.0),
        )
        is_on_another_joint = any(
            other == name and j != joint for other, j in effects_in_fit
        )
        return (
            2.0 * self.laws_by_effect[name] if is_on_another_joint else all_candidates
        )

    def rows_worth_one(
        self, T: Array, left: Array, inverse: Array, freedom: float
    ) -> float:
        """How many rows are worth one: by how much the sandwich's middle, of the
        clusters that make most of it, is larger than T'T; of a fit with so much
        freedom, and at least 1."""
        scores = np.sum(T * left[:, :, None], axis=0)[: len(self.data.clusters[0])]
        sums = cluster_sums(self.data.clusters, scores)
        return max(1.0, *(float(np.sum((u @ inverse) * u)) / freedom for u in sums))

    @staticmethod
    def prior(
        fit: WhiteFit, plausible: Array, joints: Sequence[int], energy: Array
    ) -> Array:
        """(..., k) standard deviations of coefficients about zero before anything is
        measured: what their effects say; else (NaN) that they make no more torque than
        their joints have in all.

        energy (..., k) : of the weighted columns.
        """
        energy_of_torque = float(np.sum(fit.target[joints] ** 2))
        return np.where(
            np.isnan(plausible),
            np.sqrt(energy_of_torque / np.maximum(energy, 1e-200)),
            plausible,
        )

    def absorbed(self, fit: WhiteFit, batch: Batch) -> Array:
        """(F,) share of each form's energy that the fit's columns make; 1 where it has
        none."""
        G, _, raw = self._products(fit, batch)
        energy = np.trace(raw, axis1=1, axis2=2)
        absorbed_energy = np.sum(G**2, axis=(0, 2))
        return np.asarray(
            np.divide(
                absorbed_energy, energy, out=np.ones(len(energy)), where=energy > 0.0
            )
        )

    @staticmethod
    def _products(fit: WhiteFit, batch: Batch) -> tuple[Array, Array, Array]:
        """Of a batch's weighted columns: with a fit's (r, F, k), with what it leaves
        (F, k), and of each form's with each other (F, k, k)."""
        F = len(batch.forms)
        k = batch.forms[0].n_coefficients
        squares = fit.level[list(batch.joints)] ** -2.0
        of = list(zip(squares, fit.design.of(batch), strict=True))
        cross = sum(w * AZ for w, (AZ, _) in of)
        pull = sum(w * Zy for w, (_, Zy) in of) - fit.theta @ cross
        raw = np.tensordot(squares, batch.grams, axes=1)
        return (
            np.reshape(fit.whitener.T @ cross, (-1, F, k)),
            np.reshape(pull, (F, k)),
            raw,
        )

    def screened(self, fit: WhiteFit, batch: Batch) -> Array:
        """(F,) drop of the weighted squared error less k log N, of a batch's forms."""
        k = batch.forms[0].n_coefficients
        on = list(batch.joints)
        fit_to_beat = fit
        fit = self.without(fit, batch.forms[0])
        lost = float(np.sum((fit.rss - fit_to_beat.rss) / fit.level**2))
        price = np.log(max(float(fit.degrees[on].sum()), 3.0))
        G, pull, raw = self._products(fit, batch)
        if k == 1:
            energy = raw[:, 0, 0]
            D = energy - np.sum(G[:, :, 0] ** 2, axis=0)
            good = (ABSORBED * energy < D) & ~(batch.signed & (pull[:, 0] < 0.0))
            return (
                np.where(good, pull[:, 0] ** 2 / np.where(good, D, 1.0), 0.0)
                - lost
                - price
            )
        G = G.transpose(1, 2, 0)
        D = raw - G @ G.transpose(0, 2, 1)
        energy = np.diagonal(raw, axis1=1, axis2=2)
        is_visible = np.diagonal(D, axis1=1, axis2=2) > ABSORBED * energy
        D = D * is_visible[:, :, None] * is_visible[:, None, :]
        pull = pull * is_visible
        known = self.prior(fit, batch.plausible, on, energy)
        A = _ridged(D + np.eye(k) * known[:, :, None] ** -2.0)
        inverse = np.linalg.inv(A)
        beta = (inverse @ pull[:, :, None])[:, :, 0]
        low = np.array([f.nonnegative for f in batch.forms])
        for f in np.flatnonzero(np.any(low & (beta < 0.0), axis=1)).tolist():
            beta[f] = _bounded(A[f], pull[f], low[f])
        drop = 2.0 * np.sum(beta * pull, axis=1) - np.einsum(
            "fa,fab,fb->f", beta, A, beta
        )
        return np.asarray(drop - np.einsum("fab,fba->f", inverse, D) * price)


def orthonormal(columns: Array) -> Array:
    """An orthonormal basis (N, r) of columns (N, p), their rank found by a pivoted QR
    of their triangle."""
    norms = np.linalg.norm(columns, axis=0)
    unit = columns[:, norms > 1e-12 * norms.max(initial=0.0)]
    if not unit.shape[1]:
        return np.zeros((len(columns), 0))
    unit = unit / np.linalg.norm(unit, axis=0)
    triangle, order = scipy.linalg.qr(
        np.linalg.qr(unit, mode="r"), mode="r", pivoting=True
    )
    diagonal = np.abs(np.diagonal(triangle))
    rank = int(np.sum(diagonal > 1e-8 * diagonal[0]))
    basis = unit[:, order[:rank]]
    for _ in range(2):  # twice is enough (Giraud et al. 2005)
        R = np.linalg.qr(basis, mode="r") if _ else triangle[:rank, :rank]
        basis = scipy.linalg.solve_triangular(R, basis.T, trans="T").T
    return np.ascontiguousarray(basis)


def _unit(columns: Array) -> Array:
    """Columns (n, M, k) at unit length."""
    return columns / nonzero_or_one(np.sqrt(np.sum(columns**2, axis=(0, 1))))


def _triangle(gram: Array) -> Array:
    """(p, p) Cholesky factor of a positive matrix, with a ridge against columns that
    others make."""
    return np.asarray(
        np.linalg.cholesky(
            gram + np.diag(DEPENDENT**2 * nonzero_or_one(np.diagonal(gram)))
        )
    )


def _ridged(A: Array) -> Array:
    """Positive matrices (..., k, k) with a ridge against rounding."""
    diagonal = np.diagonal(A, axis1=-2, axis2=-1)
    return np.asarray(A + 1e-10 * (diagonal + 1e-300)[..., None] * np.eye(A.shape[-1]))


def _bounded(A: Array, pull: Array, low: NDArray[np.bool_]) -> Array:
    """(k,) minimiser of b'A b / 2 - pull'b, those that may not be negative (``low``) at
    least zero."""
    beta = np.linalg.solve(_ridged(A), pull)
    if not np.any(beta[low] < 0.0):
        return np.asarray(beta)
    if len(beta) == 1:
        return np.zeros(1)
    root = np.linalg.cholesky(_ridged(A)).T
    target = np.linalg.solve(root.T, pull)
    from scipy.optimize import nnls  # its import takes longer than a report

    solution = nnls(np.hstack([root, -root[:, ~low]]), target)[0]
    out = solution[: len(low)].copy()
    out[~low] -= solution[len(low) :]
    return np.asarray(out)
