"""The one score: a penalised likelihood whose evidence is coarsened and robust against what a model
lacks.

A form beside the model and the terms that were chosen scores

    J = dD / v - (k + s) log(N / v) - 2 log P

with the drop dD of the deviance D = sum_j N_j log V_j + RSS_j / V_j, V_j = max(RSS_j / N_j, noise);
k coefficients (as many as the rows determine beside what is known of their size), s continuous shape
constants, P candidates that are looked at: the extended BIC (Chen, Chen, Biometrika 2008). Evidence is
worth v times less than independent rows would make it:

    v = max over clusterings of tr(A^-1 S) / k, at least 1, + N / ALPHA

A = T'T of the form's columns T beside all others, S = sum over clusters u u', u = sum of T r within one:
the sandwich (Liang, Zeger, Biometrika 1986), by time and, since what a model lacks comes back with the
motion, by phase. N / ALPHA coarsens the likelihood (Miller, Dunson, JASA 2019): no law is right beyond
what ALPHA rows of a joint tell, however many there are.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from sdp_vs_penalty.diagnosis.constants import ABSORBED, ALPHA, STEPS
from sdp_vs_penalty.diagnosis.library import Batch, Form
from sdp_vs_penalty.diagnosis.whitening import WhiteData, cluster_sums
from sdp_vs_penalty.robot.arrays import Array, or_one

#: Share of a column below which what others leave of it is rounding.
_DEPENDENT = 1e-5


@dataclass(frozen=True, eq=False)
class Term:
    """A form with its white columns (M, k) by joint, its score beside what it was judged with, its
    coefficients (k,), the forms that do as well, and how many times more energy it has beside the model
    alone than beside the other terms. Equal to itself alone."""

    form: Form
    columns: dict[int, Array]
    J: float = -np.inf
    beta: Array = field(default_factory=lambda: np.zeros(0))
    rivals: tuple[Term, ...] = ()
    times: float = 1.0

    @property
    def key(self) -> tuple[str, int | None]:
        return self.form.key

    @property
    def joints(self) -> frozenset[int]:
        return frozenset(self.columns)


@dataclass(frozen=True)
class Fit:
    """The model and some terms fitted to white rows, each joint's divided by its ``level`` (n,).

    Q (n, M, r) : Q Q' projects onto their columns; residual (n, M) : what they leave; rss, degrees (n,)
    : squared error in units of the noise, and rows less the joint's share of the rank; target (n, M);
    beside_model (r, K) : the terms' columns in the basis Q; dropped : places in theta of the model's
    columns that terms stand for.
    """

    Q: Array
    residual: Array
    target: Array
    level: Array
    rss: Array
    degrees: Array
    floor: float
    beside_model: Array
    dropped: tuple[int, ...] = ()

    def deviance(self, rss: Array) -> float:
        """-2 log L of the joints' squared errors (n,)."""
        v = np.maximum(rss / self.degrees, self.floor)
        return float(np.sum(self.degrees * np.log(v) + rss / v))

    def scaled(self, columns: dict[int, Array]) -> dict[int, Array]:
        return {j: z / self.level[j] for j, z in columns.items()}

    def beside(self, scaled: dict[int, Array]) -> Array:
        """(n, M, k) what the fit leaves of columns, all of them weighted."""
        along = sum(np.tensordot(self.Q[j], z, axes=(0, 0)) for j, z in scaled.items())
        left = -(self.Q @ along)
        for j, z in scaled.items():
            left[j] += z
        return np.asarray(left)

    def energy(self, term: Term) -> float:
        """Weighted squares of what the fit leaves of a term."""
        return float(np.sum((self.beside(self.scaled(term.columns)) @ term.beta) ** 2))

    def without(self, direction: Array) -> Fit:
        """Without one direction Q w of the columns, w (r,) of unit length."""
        u = self.Q @ direction
        own = np.vdot(u, self.target)
        Q, residual = self.Q - u[:, :, None] * direction, self.residual + own * u
        rss = np.sum(residual**2, axis=1) * self.level**2
        return replace(self, Q=Q, residual=residual, rss=rss)


class Score:
    """The score of forms on some rows; looked : candidates that there are."""

    def __init__(self, data: WhiteData, looked: int, owned: Iterable[tuple[int, ...]] = ()) -> None:
        self.data, self.looked = data, max(looked, 1)
        self.floor = 1.0 if data.known else 1e-12
        self.owned = tuple(owned)
        self._bases: dict[tuple[int, ...], tuple[Array, Array]] = {}
        self._own: dict[tuple[tuple[int, ...], str], NDArray[np.intp]] = {}
        self._last: tuple[Fit, dict[tuple[int, ...], Array]] | None = None

    def _basis(self, dropped: tuple[int, ...]) -> tuple[Array, Array]:
        """(n, M, r) a basis of the model's columns without some, and its products (n, r, r)."""
        if dropped not in self._bases:
            X = self.data.X
            n, M, _ = X.shape
            kept = np.delete(X, list(dropped), axis=2).reshape(n * M, -1)
            B = orthonormal(kept).reshape(n, M, -1)
            self._bases[dropped] = B, B.transpose(0, 2, 1) @ B
        return self._bases[dropped]

    def _told(self, term: Term, dropped: tuple[int, ...]) -> NDArray[np.intp]:
        """Which of a term's columns neither the model nor its others make: of those with many (a robot's
        geometry) half are the links' as well, and a matrix of all would be singular."""
        k = term.form.k
        if k == 1:
            return np.arange(1)
        key = dropped, term.form.effect.text
        if key not in self._own:
            B, _ = self._basis(dropped)
            Z = np.zeros((*B.shape[:2], k))
            for j, z in term.columns.items():
                Z[j] = z
            Z = Z.reshape(-1, k) / or_one(np.sqrt(np.sum(Z**2, axis=(0, 1))))
            B = B.reshape(len(Z), -1)
            R = np.linalg.qr(Z - B @ (B.T @ Z), mode="r")
            R, order = scipy.linalg.qr(R, mode="r", pivoting=True)
            self._own[key] = np.sort(order[np.abs(np.diagonal(R)) > _DEPENDENT])
        return self._own[key]

    def fit(self, terms: Sequence[Term], level: Array | None = None) -> Fit:
        """The model with the terms, each joint's rows weighted by what is left of them."""
        data = self.data
        dropped = tuple(sorted({i for t in terms for i in t.form.own}))
        B, gram = self._basis(dropped)
        n, M, r = B.shape
        told = [self._told(t, dropped) for t in terms]
        at = r + sum(map(len, told))
        A = np.zeros((n, M, at))
        A[:, :, :r] = B
        ends = np.cumsum([r, *map(len, told)])
        for t, kept, first, stop in zip(terms, told, ends, ends[1:], strict=False):
            for j, z in t.columns.items():
                A[j][:, first:stop] = z[:, kept]
        norms = np.sqrt(np.sum(A[:, :, r:] ** 2, axis=(0, 1)))
        A[:, :, r:] /= or_one(norms)
        G = np.zeros((n, at, at))
        G[:, :r, :r] = gram
        cross = A.transpose(0, 2, 1) @ A[:, :, r:]
        G[:, :, r:], G[:, r:, :r] = cross, cross[:, :r].transpose(0, 2, 1)
        pull = (A.transpose(0, 2, 1) @ data.y[:, :, None])[:, :, 0]
        square = np.sum(data.y**2, axis=1)
        level = np.ones(n) if level is None else level
        for _ in range(STEPS):
            root = _whitener(np.tensordot(level**-2.0, G, axes=1))
            P = root @ root.T
            theta = P @ (level**-2.0 @ pull)
            rss = np.maximum(square - 2.0 * pull @ theta + (G @ theta) @ theta, 0.0)
            degrees = np.maximum(data.count - np.sum(G * P, axis=(1, 2)) / level**2, 1.0)
            last, level = level, np.sqrt(np.maximum(rss / degrees, self.floor))
            if np.allclose(last, level, rtol=1e-2):
                break
        A /= level[:, None, None]
        Q, target = A @ _whitener(np.tensordot(level**-2.0, G, axes=1)), data.y / level[:, None]
        residual = target - Q @ np.tensordot(Q, target, axes=((0, 1), (0, 1)))
        rss = np.sum(residual**2, axis=1) * level**2
        others = np.tensordot(Q, A[:, :, r:], axes=((0, 1), (0, 1)))
        return Fit(Q, residual, target, level, rss, degrees, self.floor, others, dropped)

    def judged(self, fit: Fit, form: Form, columns: dict[int, Array]) -> Term:
        """A form beside a fit."""
        if form.own:
            return self._retuned(fit, form, columns)
        return self._judged(fit, fit.deviance(fit.rss), form, columns)

    def _judged(
        self, fit: Fit, before: float, form: Form, columns: dict[int, Array], spent: float = 0.0
    ) -> Term:
        """spent : coefficients that the fit to compare with has, of the form's."""
        none = Term(form, columns, beta=np.zeros(form.k))
        T, known = self.apart(fit, form, columns)
        flat = T.reshape(-1, form.k)
        D = flat.T @ flat
        if not D.any():
            return none
        A = D + np.diag(known**-2.0)
        inverse = np.asarray(np.linalg.inv(_ridged(A)))
        beta = _bounded(A, flat.T @ fit.residual.ravel(), form.nonnegative)
        left = fit.residual - T @ beta
        drop = before - fit.deviance(np.sum(left**2, axis=1) * fit.level**2)
        drop -= float(np.sum((beta / known) ** 2))
        on = list(columns)
        count = float(fit.degrees[on].mean())
        v = self.worth_of_one(T, left, inverse, form.k) + count / ALPHA
        N = max(count * len(on) / v, 3.0)
        size = float(np.trace(inverse @ D)) - spent
        J = drop / v - (size + form.constants) * np.log(N) - 2.0 * np.log(self.looked)
        return replace(none, J=J, beta=beta)

    def apart(self, fit: Fit, form: Form, columns: dict[int, Array]) -> tuple[Array, Array]:
        """(n, M, k) what a fit leaves of a form's columns, all of them weighted, nothing of those that
        the fit makes itself; and (k,) standard deviations that are known of their coefficients."""
        scaled = fit.scaled(columns)
        energy = np.sum([np.sum(z**2, axis=0) for z in scaled.values()], axis=0)
        T = fit.beside(scaled)
        T = T * (np.sum(T**2, axis=(0, 1)) > ABSORBED * energy)
        return T, self.prior(fit, form, tuple(columns), energy)

    def worth_of_one(self, T: Array, left: Array, inverse: Array, freedom: float) -> float:
        """How many rows are worth one: by how much the sandwich's middle, of the clusters that make most
        of it, is larger than T'T; of a fit with so much freedom, and at least 1."""
        scores = np.sum(T * left[:, :, None], axis=0)
        sums = cluster_sums(self.data.clusters, scores)
        return max(1.0, *(float(np.sum((u @ inverse) * u)) / freedom for u in sums))

    def prior(self, fit: Fit, form: Form, joints: Sequence[int], energy: Array) -> Array:
        """(k,) standard deviations of a form's coefficients about zero before anything is measured: what
        its effect says; else that it makes no more torque than its joints have in all.

        energy (k,) : of the form's weighted columns.
        """
        known = form.effect.plausible
        if known is not None:
            return known
        whole = float(np.sum(fit.target[list(joints)] ** 2))
        return np.asarray(np.sqrt(whole / np.maximum(energy, 1e-200)))

    def _retuned(self, fit: Fit, form: Form, columns: dict[int, Array]) -> Term:
        """A form in the place of the model's own column, of which the fit has one."""
        bare = self.without_own(fit, form)
        if bare is None:
            return Term(form, columns, beta=np.zeros(form.k))
        return self._judged(bare, fit.deviance(fit.rss), form, columns, float(form.k))

    def without_own(self, fit: Fit, form: Form) -> Fit | None:
        """A fit without the model's own column that a form stands for; None where others make it."""
        direction = self._directions(fit).get(form.own)
        return None if direction is None else fit.without(direction)

    def _directions(self, fit: Fit) -> dict[tuple[int, ...], Array]:
        """By place in theta, the direction (r,) of a fit's columns that one of the model's own makes
        alone: w with B'w = e, B the columns in the basis of the fit."""
        if self._last is None or self._last[0] is not fit:
            X = self.data.X / fit.level[:, None, None]
            B = np.tensordot(fit.Q, X, axes=((0, 1), (0, 1)))
            B[:, list(fit.dropped)] = 0.0
            norms = np.linalg.norm(B, axis=0)
            seen = norms > 1e-12 * norms.max(initial=0.0)  # others are rounding
            B = np.hstack([B * (seen / np.where(seen, norms, 1.0)), fit.beside_model])
            W = np.linalg.pinv(B.T, rcond=1e-9)
            found = dict[tuple[int, ...], Array]()
            for own in self.owned:
                (place,) = own
                apart = B.T @ W[:, place]
                apart[place] -= 1.0
                if seen[place] and np.max(np.abs(apart)) < 1e-6:
                    found[own] = W[:, place] / np.linalg.norm(W[:, place])
            self._last = fit, found
        return self._last[1]

    def absorbed(self, fit: Fit, batch: Batch) -> Array:
        """(F,) share of each form's energy that the fit's columns make; 1 where it has none."""
        G, _, raw = self._products(fit, batch)
        energy, made = np.trace(raw, axis1=1, axis2=2), np.sum(G**2, axis=(0, 2))
        return np.asarray(np.divide(made, energy, out=np.ones(len(energy)), where=energy > 0.0))

    @staticmethod
    def _products(fit: Fit, batch: Batch) -> tuple[Array, Array, Array]:
        """Of a batch's weighted columns: with a fit's (r, F, k), with what it leaves (F, k), and of each
        form's with each other (F, k, k)."""
        F, k, weight = len(batch.forms), batch.forms[0].k, 1.0 / fit.level[list(batch.joints)]
        of = list(zip(weight, batch.joints, batch.white, strict=True))
        G, pull = (
            sum(w * (fit.Q[j].T @ Z) for w, j, Z in of),
            sum(w * (fit.residual[j] @ Z) for w, j, Z in of),
        )
        raw = np.tensordot(weight**2, batch.grams, axes=1)
        return np.reshape(G, (-1, F, k)), np.reshape(pull, (F, k)), raw

    def screened(self, fit: Fit, batch: Batch) -> Array:
        """(F,) drop of the weighted squared error less k log N, of a batch's forms; of those that
        stand for the model's own columns, less what these take."""
        k, F, on = batch.forms[0].k, len(batch.forms), list(batch.joints)
        lost, price = 0.0, np.log(max(float(fit.degrees[on].sum()), 3.0))
        if batch.own:
            bare = self.without_own(fit, batch.forms[0])
            if bare is None:
                return np.full(F, -np.inf)
            lost, fit = float(np.sum((bare.rss - fit.rss) / fit.level**2)), bare
        G, pull, raw = self._products(fit, batch)
        if k == 1:
            energy = raw[:, 0, 0]
            D = energy - np.sum(G[:, :, 0] ** 2, axis=0)
            good = (ABSORBED * energy < D) & ~(batch.signed & (pull[:, 0] < 0.0))
            return np.where(good, pull[:, 0] ** 2 / np.where(good, D, 1.0), 0.0) - price - lost
        G = G.transpose(1, 2, 0)
        D = raw - G @ G.transpose(0, 2, 1)
        energy = np.diagonal(raw, axis1=1, axis2=2)
        seen = np.diagonal(D, axis1=1, axis2=2) > ABSORBED * energy
        D, pull = D * seen[:, :, None] * seen[:, None, :], pull * seen
        known = np.array([self.prior(fit, f, on, e) for f, e in zip(batch.forms, energy, strict=True)])
        A = _ridged(D + np.eye(k) * known[:, :, None] ** -2.0)
        inverse = np.linalg.inv(A)
        beta = (inverse @ pull[:, :, None])[:, :, 0]
        low = np.array([f.nonnegative for f in batch.forms])
        for f in np.flatnonzero(np.any(low & (beta < 0.0), axis=1)).tolist():
            beta[f] = _bounded(A[f], pull[f], low[f].tolist())
        drop = 2.0 * np.sum(beta * pull, axis=1) - np.einsum("fa,fab,fb->f", beta, A, beta)
        return np.asarray(drop - np.einsum("fab,fba->f", inverse, D) * price)


def orthonormal(columns: Array) -> Array:
    """An orthonormal basis (N, r) of columns (N, p), their rank found by a pivoted QR of their
    triangle."""
    norms = np.linalg.norm(columns, axis=0)
    unit = columns[:, norms > 1e-12 * norms.max(initial=0.0)]
    if not unit.shape[1]:
        return np.zeros((len(columns), 0))
    unit = unit / np.linalg.norm(unit, axis=0)
    triangle, order = scipy.linalg.qr(np.linalg.qr(unit, mode="r"), mode="r", pivoting=True)
    diagonal = np.abs(np.diagonal(triangle))
    rank = int(np.sum(diagonal > 1e-8 * diagonal[0]))
    basis = unit[:, order[:rank]]
    for _ in range(2):  # twice is enough (Giraud et al. 2005)
        R = np.linalg.qr(basis, mode="r") if _ else triangle[:rank, :rank]
        basis = scipy.linalg.solve_triangular(R, basis.T, trans="T").T
    return np.ascontiguousarray(basis)


def _whitener(gram: Array) -> Array:
    """(p, r) W with W'G W = 1, of a positive matrix G (p, p) of rank r, of columns near unit length."""
    size = 1.0 / np.sqrt(np.maximum(np.diagonal(gram), 1e-300))
    unit = gram * size * size[:, None]
    L, info = scipy.linalg.lapack.dpotrf(unit, lower=1, clean=1)
    if info == 0 and np.min(np.diagonal(L), initial=1.0) > _DEPENDENT:
        return np.asarray(scipy.linalg.solve_triangular(L, np.diag(size), lower=True).T)
    values, vectors = np.linalg.eigh(unit)
    kept = values > _DEPENDENT**2
    return np.asarray(size[:, None] * vectors[:, kept] / np.sqrt(values[kept]))


def _ridged(A: Array) -> Array:
    """Positive matrices (..., k, k) with a ridge against rounding."""
    diagonal = np.diagonal(A, axis1=-2, axis2=-1)
    return np.asarray(A + 1e-10 * (diagonal + 1e-300)[..., None] * np.eye(A.shape[-1]))


def _bounded(A: Array, pull: Array, nonnegative: Sequence[bool]) -> Array:
    """(k,) minimiser of b'A b / 2 - pull'b, those that may not be negative at least zero."""
    beta = np.linalg.solve(_ridged(A), pull)
    low = np.array(nonnegative)
    if not np.any(beta[low] < 0.0):
        return np.asarray(beta)
    if len(beta) == 1:
        return np.zeros(1)
    root = np.linalg.cholesky(_ridged(A)).T
    target = np.linalg.solve(root.T, pull)
    from scipy.optimize import nnls  # its import takes longer than a report

    found = nnls(np.hstack([root, -root[:, ~low]]), target)[0]
    out = found[: len(low)].copy()
    out[~low] -= found[len(low) :]
    return np.asarray(out)
