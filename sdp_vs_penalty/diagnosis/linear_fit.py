"""The model and some effects, fitted to white rows: the algebra beneath the score."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import scipy
from numpy.typing import NDArray

from sdp_vs_penalty.diagnosis.library import Batch, Candidate, Key, Nuisance
from sdp_vs_penalty.diagnosis.white_rows import WhiteData
from sdp_vs_penalty.robot.arrays import Array, nonzero_or_one

#: Share of a column below which what others leave of it is rounding.
DEPENDENT = 1e-5


@dataclass(frozen=True, eq=False)
class ScoredEffect:
    """A candidate judged beside others. It equals itself alone.

    columns : white, (M, k) by joint; drop : of the deviance; rows_worth_one : how many
    rows are worth one; price : of its parameters and of the choice; freedom :
    coefficients that the rows determine, and shape constants; beta (k,) : coefficients;
    squares (n,) : of the white torque that nothing else makes; rivals : the candidates
    that do as well.
    """

    form: Candidate
    columns: dict[int, Array]
    drop: float = -np.inf
    rows_worth_one: float = 1.0
    price: float = 0.0
    freedom: float = 0.0
    beta: Array = field(default_factory=lambda: np.zeros(0))
    squares: Array = field(default_factory=lambda: np.zeros(0))
    rivals: tuple[ScoredEffect, ...] = ()

    @property
    def evidence(self) -> float:
        """J, twice the logarithm of the odds."""
        return self.drop / self.rows_worth_one - self.price

    def evidence_with_worth_of(self, other: ScoredEffect) -> float:
        """J with the worth of rows of another effect.

        Two that make nearly the same torque differ more by the error of this worth than
        by their evidence.
        """
        return self.drop / other.rows_worth_one - self.price

    @property
    def key(self) -> Key:
        """Its candidate, whatever the shape constants."""
        return self.form.key

    @property
    def text(self) -> str:
        """The effect as it is written on the command line."""
        return self.form.effect.text

    @property
    def joints(self) -> frozenset[int]:
        """The joints (from 0) whose torque it changes."""
        return frozenset(self.columns)


#: What a fit takes besides the model.
Term = ScoredEffect | Nuisance


@dataclass(frozen=True, eq=False)
class BasisProducts:
    """Products of candidates' columns with those of the model, basis (n, M, r), and with
    the torque y (n, M), each worked out once."""

    basis: Array
    y: Array
    known: dict[Batch, list[tuple[Array, Array]]] = field(default_factory=dict)

    def of(self, batch: Batch) -> list[tuple[Array, Array]]:
        """By joint, (r, F k) and (F k,)."""
        if batch not in self.known:
            pairs = zip(batch.joints, batch.whitened_columns, strict=True)
            self.known[batch] = [
                (self.basis[j].T @ Z, Z.T @ self.y[j]) for j, Z in pairs
            ]
        return self.known[batch]


@dataclass(frozen=True, eq=False)
class Design:
    """White columns of the model and of some terms, and their products.

    A (n, M, p) : columns of unit length; y (n, M) : torque; gram (n, p, p), pull (n, p) :
    A'A and A'y; model : by key the column of each effect of the model whose constant may
    be another one, under None those of all others; at : the columns of each term, by
    text; keys : of a term's column; extra (n,) : rows of a joint behind the log's, each
    of which says that the coefficient of a nuisance is zero, or a share of one where
    several joints say it.
    """

    A: Array
    y: Array
    gram: Array
    pull: Array
    model: Mapping[Key | None, list[int]]
    at: dict[str, list[int]]
    keys: dict[int, Key]
    extra: Array
    basis_products: BasisProducts
    products: dict[Batch, list[tuple[Array, Array]]] = field(default_factory=dict)

    def holds(self, terms: Sequence[Term]) -> bool:
        """Whether all terms have columns here."""
        return all(t.text in self.at for t in terms)

    def of(self, batch: Batch) -> list[tuple[Array, Array]]:
        """By joint, A'Z (p, F k) and Z'y (F k,) of a batch's columns Z.

        Those of the model's columns serve all designs.
        """
        if batch not in self.products:
            M = batch.whitened_columns.shape[1]
            known = self.basis_products.of(batch)
            r = self.basis_products.basis.shape[2]
            out = []
            for j, Z, (of_basis, pull) in zip(
                batch.joints,
                batch.whitened_columns,
                known,
                strict=True,
            ):
                products = np.zeros((self.A.shape[2], Z.shape[1]))
                products[:r] = of_basis
                of_terms = self.A[j, :M, r:]
                acts = of_terms.any(axis=0)
                products[r:][acts] = of_terms[:, acts].T @ Z
                out.append((products, pull))
            self.products[batch] = out
        return self.products[batch]


@dataclass(frozen=True)
class WhiteFit:
    """The model and some terms fitted to white rows, each joint's divided by its
    ``level`` (n,).

    columns_kept : the columns that take part; whitener W (p, r) : the columns A W, divided
    by the levels, are orthonormal; theta (p,) : coefficients; residual (n, M) : what they
    leave; rss (n,) : squared error in units of the noise; degrees (n,) : rows less the
    joint's share of the rank; floor : lowest variance of a joint.
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
        """(n, M, r) an orthonormal basis of the columns."""
        return np.asarray(self.design.A @ self.whitener / self.level[:, None, None])

    def deviance(self, rss: Array) -> Array:
        """(...,) -2 log L of the joints' squared errors (..., n)."""
        variance = np.maximum(rss / self.degrees, self.floor)
        by_joint = self.degrees * np.log(variance) + rss / variance
        return np.asarray(np.sum(by_joint, axis=-1))

    def scaled(self, columns: dict[int, Array]) -> dict[int, Array]:
        """Columns (M, k) by joint, weighted as the rows are."""
        return {j: z / self.level[j] for j, z in columns.items()}

    def residual_of(self, scaled: dict[int, Array]) -> Array:
        """(n, M, k) what the fit leaves of weighted columns."""
        A = self.design.A
        along = sum(A[j, : len(z)].T @ (z / self.level[j]) for j, z in scaled.items())
        explained = A @ (self.whitener @ (self.whitener.T @ along))
        left = -(explained / self.level[:, None, None])
        for j, z in scaled.items():
            left[j, : len(z)] += z
        return np.asarray(left)

    def energy(self, term: ScoredEffect) -> float:
        """Weighted squares of what the fit leaves of a term."""
        left = self.residual_of(self.scaled(term.columns)) @ term.beta
        return float(np.sum(left**2))


class WhiteFitter:
    """Fits of the model and some effects to white rows; one basis serves them all.

    like : a fitter whose rows may be the same; its basis then serves again.
    """

    def __init__(
        self,
        data: WhiteData,
        like: WhiteFitter | None = None,
    ) -> None:
        self.data = data
        self.floor = 1.0 if data.known else 1e-12
        if like is not None and like.has_rows_of(data):
            self._basis = like._basis
            self._basis_products = like._basis_products

    def has_rows_of(self, data: WhiteData) -> bool:
        """Whether the model's columns and the torque of other data are these."""
        same_effects = list(self.data.own_effects) == list(data.own_effects)
        return (
            same_effects
            and np.array_equal(self.data.X, data.X)
            and np.array_equal(self.data.y, data.y)
        )

    @cached_property
    def _basis(self) -> tuple[Array, Array, dict[Key | None, list[int]]]:
        """(n, M, r) a basis of the model's columns, its products (n, r, r), and where
        the columns of each key stand.

        Effects whose constant may be another one keep columns of their own.
        """
        X = self.data.X
        own_columns = self.data.own_effects
        n, M, _ = X.shape
        separate = [column for _, column in own_columns.values()]
        shared = orthonormal(np.delete(X, separate, axis=2).reshape(n * M, -1))
        r = shared.shape[1]
        parts = [
            shared.reshape(n, M, r),
            _unit(X[:, :, separate]),
        ]
        B = np.concatenate(parts, axis=2)
        at: dict[Key | None, list[int]] = {None: list(range(r))}
        at |= {key: [r + k] for k, key in enumerate(own_columns)}
        return B, B.transpose(0, 2, 1) @ B, at

    @cached_property
    def _basis_products(self) -> BasisProducts:
        return BasisProducts(self._basis[0], self.data.y)

    def fit(
        self,
        terms: Sequence[Term],
        near: WhiteFit | None = None,
    ) -> WhiteFit:
        """The model with the terms; each joint's rows are weighted by what is left.

        near : a fit whose columns serve where they hold the terms', and at whose levels
        this one begins.
        """
        design = None if near is None else near.design
        if design is None or not design.holds(terms):
            design = self._design(terms)
        replaced = {
            t.key
            for t in terms
            if isinstance(t, ScoredEffect) and t.form.replaces_own_constant
        }
        columns = [
            i
            for key, its_columns in design.model.items()
            if key not in replaced
            for i in its_columns
        ]
        columns += sorted(i for t in terms for i in design.at[t.text])
        level = np.ones(len(design.y)) if near is None else near.level
        return self._fitted(design, tuple(columns), level)

    def without(self, fit: WhiteFit, form: Candidate) -> WhiteFit:
        """A fit, at its levels, without what a candidate stands in the place of.

        It is the fit itself where that is nothing.
        """
        if not form.replaces_own_constant:
            return fit
        if form.key not in fit.apart:
            replaced = fit.design.model[form.key]
            left = tuple(i for i in fit.columns_kept if i not in replaced)
            fit.apart[form.key] = self._fitted(
                fit.design,
                left,
                fit.level,
                rounds=1,
            )
        return fit.apart[form.key]

    def _design(self, terms: Sequence[Term]) -> Design:
        """The columns of the model and of the terms, with their products."""
        B, gram, model = self._basis
        n, M, r = B.shape
        A, at, extra = self._columns_with_priors(terms)
        p = A.shape[2]
        G = np.zeros((n, p, p))
        G[:, :r, :r] = gram
        for j in range(n):
            on_joint = [i for t in terms if j in t.columns for i in at[t.text]]
            cross = A[j].T @ A[j][:, on_joint]
            G[j][:, on_joint] = cross
            G[j][on_joint] = cross.T
        energy = np.sum(np.diagonal(G, axis1=1, axis2=2), axis=0)
        scale = np.ones(p)
        scale[r:] = 1.0 / nonzero_or_one(np.sqrt(energy[r:]))
        A[:, :, r:] *= scale[r:]
        G *= scale[:, None] * scale
        y = np.zeros(A.shape[:2])
        y[:, :M] = self.data.y
        pull = (A.transpose(0, 2, 1) @ y[:, :, None])[:, :, 0]
        effects = [t for t in terms if isinstance(t, ScoredEffect)]
        keys = {i: t.key for t in effects for i in at[t.text]}
        return Design(
            A=A,
            y=y,
            gram=G,
            pull=pull,
            model=model,
            at=at,
            keys=keys,
            extra=extra,
            basis_products=self._basis_products,
        )

    def _columns_with_priors(
        self, terms: Sequence[Term]
    ) -> tuple[Array, dict[str, list[int]], Array]:
        """(n, M + rows, p) columns of the model and of the terms; where each term's
        stand; and (n,) rows behind the log's, which hold nuisances near zero."""
        B, _, _ = self._basis
        n, M, r = B.shape
        widths = [next(iter(t.columns.values())).shape[1] for t in terms]
        ends = np.cumsum([r, *widths]).tolist()
        n_rows = np.full(n, M)
        extra = np.zeros(n)
        for t, width in zip(terms, widths, strict=True):
            if isinstance(t, Nuisance):
                extra[[*t.columns]] += width / len(t.columns)
                n_rows[[*t.columns]] += width
        A = np.zeros((n, n_rows.max(initial=M), ends[-1]))
        A[:, :M, :r] = B
        n_rows[:] = M
        at = dict[str, list[int]]()
        for t, first, width in zip(terms, ends, widths, strict=False):
            at[t.text] = list(range(first, first + width))
            for j, z in t.columns.items():
                A[j, :M, first : first + width] = z
                if isinstance(t, Nuisance):
                    rows = n_rows[j] + np.arange(width)
                    weight = 1.0 / t.deviations / len(t.columns) ** 0.5
                    A[j, rows, at[t.text]] = weight
                    n_rows[j] += width
        return A, at, extra

    def _fitted(
        self,
        design: Design,
        columns: tuple[int, ...],
        level: Array,
        rounds: int = 20,
    ) -> WhiteFit:
        """Coefficients and levels in turn.

        rounds : at most; each raises the likelihood, and six were the most on three
        arms; one: at the levels as they are.
        """
        kept = np.array(columns, int)
        G = design.gram.take(kept, 1).take(kept, 2)
        pull = design.pull[:, kept]
        flat_gram = G.reshape(len(G), -1)
        square = np.sum(design.y**2, axis=1)
        degrees = self.data.count + design.extra
        for _ in range(rounds):
            L = _triangle((level**-2.0 @ flat_gram).reshape(G.shape[1:]))
            weighted_pull = level**-2.0 @ pull
            theta = scipy.linalg.cho_solve(
                (L, True),
                weighted_pull,
                check_finite=False,
            )
            rss = np.maximum(square - 2.0 * pull @ theta + (G @ theta) @ theta, 0.0)
            last = level
            level = np.sqrt(np.maximum(rss / degrees, self.floor))
            if np.all(np.abs(level - last) < 1e-2 * level):
                break
        unit = np.eye(len(L))
        inverse = scipy.linalg.solve_triangular(
            L,
            unit,
            lower=True,
            check_finite=False,
        )
        root = inverse.T
        p = design.A.shape[2]
        W = np.zeros((p, len(kept)))
        W[kept] = root
        all_theta = np.zeros(p)
        all_theta[kept] = theta
        residual = (design.y - design.A @ all_theta) / last[:, None]
        rank_of_joint = flat_gram @ (root @ root.T).ravel() / last**2
        return WhiteFit(
            design=design,
            columns_kept=columns,
            whitener=W,
            theta=all_theta,
            level=last,
            residual=residual,
            rss=np.sum(residual**2, axis=1) * last**2,
            degrees=np.maximum(degrees - rank_of_joint, 1.0),
            floor=self.floor,
        )


def orthonormal(columns: Array) -> Array:
    """An orthonormal basis (N, r) of columns (N, p), their rank found by a pivoted QR
    of their triangle."""
    norms = np.linalg.norm(columns, axis=0)
    unit = columns[:, norms > 1e-12 * norms.max(initial=0.0)]
    if not unit.shape[1]:
        return np.zeros((len(columns), 0))
    unit = unit / np.linalg.norm(unit, axis=0)
    triangle, order = scipy.linalg.qr(
        np.linalg.qr(unit, mode="r"),
        mode="r",
        pivoting=True,
    )
    diagonal = np.abs(np.diagonal(triangle))
    rank = int(np.sum(diagonal > 1e-8 * diagonal[0]))
    basis = unit[:, order[:rank]]
    R = triangle[:rank, :rank]
    basis = scipy.linalg.solve_triangular(R, basis.T, trans="T").T
    # Twice is enough (Giraud et al. 2005).
    R = np.linalg.qr(basis, mode="r")
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


def with_ridge(A: Array) -> Array:
    """Positive matrices (..., k, k) with a ridge against rounding."""
    diagonal = np.diagonal(A, axis1=-2, axis2=-1)
    return np.asarray(A + 1e-10 * (diagonal + 1e-300)[..., None] * np.eye(A.shape[-1]))


def bounded_least_squares(
    A: Array,
    pull: Array,
    nonnegative: NDArray[np.bool_],
) -> Array:
    """(k,) minimiser of b'A b / 2 - pull'b, those that may not be negative (``nonnegative``) at
    least zero."""
    beta = np.linalg.solve(with_ridge(A), pull)
    if not np.any(beta[nonnegative] < 0.0):
        return np.asarray(beta)
    if len(beta) == 1:
        return np.zeros(1)
    root = np.linalg.cholesky(with_ridge(A)).T
    target = np.linalg.solve(root.T, pull)

    solution = scipy.optimize.nnls(np.hstack([root, -root[:, ~nonnegative]]), target)[0]
    out = solution[: len(nonnegative)].copy()
    out[~nonnegative] -= solution[len(nonnegative) :]
    return np.asarray(out)
