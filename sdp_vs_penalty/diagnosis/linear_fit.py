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
    """A candidate, scored beside a fit. Two of them are equal only if they are one
    object.

    columns : white, (M, k) by joint (from 0); drop : of the deviance; rows_worth_one :
    number of correlated rows that carry the evidence of one independent row; price : of
    its parameters and of the choice among candidates; freedom : effective number of
    coefficients, plus shape constants; beta (k,) : coefficients in SI units; squares
    (n,) : of the white torque on each joint that nothing else makes; rivals :
    candidates that fit about as well.
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
        """The evidence J: twice the logarithm of the odds that the effect acts."""
        return self.drop / self.rows_worth_one - self.price

    def evidence_with_worth_of(self, other: ScoredEffect) -> float:
        """Return J with the number of rows counted as one that another effect has.

        For comparing two effects that make nearly the same torque: the estimates of
        that number differ by more than the evidences would with a common one.
        """
        return self.drop / other.rows_worth_one - self.price

    @property
    def key(self) -> Key:
        """Effect name and joint (from 0, None for the robot), the same for all shape
        constants.
        """
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
    """Products of candidates' columns with the model's columns and with the torque.

    basis (n joints, M, r) : the model's columns; y (n, M) : white torque; known : what
    was computed, by batch of candidates.
    """

    basis: Array
    y: Array
    known: dict[Batch, list[tuple[Array, Array]]] = field(default_factory=dict)

    def with_batch(self, batch: Batch) -> list[tuple[Array, Array]]:
        """Return, by joint of a batch, the products B'Z (r, F k) and Z'y (F k,).

        B are the model's columns, Z the batch's white columns, y the torque. They are
        computed once for each batch.
        """
        if batch not in self.known:
            pairs = zip(batch.joints, batch.whitened_columns, strict=True)
            self.known[batch] = [
                (self.basis[j].T @ Z, Z.T @ self.y[j]) for j, Z in pairs
            ]
        return self.known[batch]


@dataclass(frozen=True, eq=False)
class Design:
    """White columns of the model and of some terms (effects or nuisances), with
    products.

    A (n joints, M + prior rows, p) : columns of unit length, the model's first; y (n, M
    + prior rows) : torque, 0 in prior rows; gram (n, p, p), pull (n, p) : A'A and A'y;
    columns_of_model : numbers of the model's columns, by key of an effect with a shape
    constant that might be re-estimated, all others under None; at : numbers of each
    term's columns, by its text; keys : key of the effect that a column belongs to;
    extra (n,) : how many prior rows each joint counts. A prior row says that a
    nuisance's coefficient is zero, up to its standard deviation.
    """

    A: Array
    y: Array
    gram: Array
    pull: Array
    columns_of_model: Mapping[Key | None, list[int]]
    columns_by_text: dict[str, list[int]]
    keys: dict[int, Key]
    n_prior_rows: Array
    basis_products: BasisProducts
    products: dict[Batch, list[tuple[Array, Array]]] = field(default_factory=dict)

    def holds(self, terms: Sequence[Term]) -> bool:
        """Return whether the design has columns of all terms."""
        return all(t.text in self.columns_by_text for t in terms)

    def products_with(self, batch: Batch) -> list[tuple[Array, Array]]:
        """Return the products of the design's columns A with a batch's columns Z, by
        its joints.

        They are A'Z (p, F k) and Z'y (F k,) for the F candidates of k columns each.
        Products with the model's columns, the first r of A, are shared by all designs;
        those with the terms' columns are computed once for each batch.
        """
        if batch not in self.products:
            M = batch.whitened_columns.shape[1]
            known = self.basis_products.with_batch(batch)
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
                # Only terms that act on this joint have columns other than zero.
                of_terms = self.A[j, :M, r:]
                acts = of_terms.any(axis=0)
                products[r:][acts] = of_terms[:, acts].T @ Z
                out.append((products, pull))
            self.products[batch] = out
        return self.products[batch]


@dataclass(frozen=True)
class WhiteFit:
    """The model and some terms, fitted to white rows by weighted least squares.

    design : its columns A (n joints, M rows, p) and torque y; columns_kept : which of
    the p columns take part; level (n,) : standard deviation of each joint's residual,
    by which its rows are divided; whitener W (p, r) : A W / level is orthonormal; theta
    (p,) : coefficients; residual (n, M) : weighted; rss (n,) : unweighted squared
    errors; degrees (n,) : rows less the joint's share of the rank; floor : lowest
    variance of a joint; fits_without, derivatives_left : results computed once, by key
    of a model's own effect: the fit without it, and what the fit leaves of its
    constants' derivatives.
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
    fits_without: dict[Key, WhiteFit] = field(default_factory=dict)
    derivatives_left: dict[tuple[str, int], Array] = field(default_factory=dict)

    @property
    def target(self) -> Array:
        """(n, M) the torque in units of each joint's residual."""
        return np.asarray(self.design.y / self.level[:, None])

    @cached_property
    def basis(self) -> Array:
        """(n, M, r) an orthonormal basis of the fit's weighted columns."""
        return np.asarray(self.design.A @ self.whitener / self.level[:, None, None])

    def deviance(self, rss: Array) -> Array:
        """Return -2 log L for squared errors rss (..., n) of the n joints; shape
        (...,).

        It is the sum over joints of N log V + rss / V with the variance V = max(rss /
        N, floor) and N degrees of freedom.
        """
        variance = np.maximum(rss / self.degrees, self.floor)
        by_joint = self.degrees * np.log(variance) + rss / variance
        return np.asarray(np.sum(by_joint, axis=-1))

    def scaled(self, columns: dict[int, Array]) -> dict[int, Array]:
        """Divide columns (M, k), by joint, by the joint's level, as the fit's rows are."""
        return {j: z / self.level[j] for j, z in columns.items()}

    def residual_of(self, scaled: dict[int, Array]) -> Array:
        """Return (n, M, k): what the fit's columns leave of weighted columns (by
        joint).

        It is Z - A W W'A'Z, the projection onto what the fit cannot make. The rows of
        nuisances behind the log's rows are part of it.
        """
        A = self.design.A
        W = self.whitener
        along = sum(A[j, : len(z)].T @ (z / self.level[j]) for j, z in scaled.items())
        explained = A @ (W @ (W.T @ along)) / self.level[:, None, None]
        remaining = -explained
        for j, z in scaled.items():
            remaining[j, : len(z)] += z
        return np.asarray(remaining)

    def energy(self, term: ScoredEffect) -> float:
        """Return the weighted squares of what the fit leaves of an effect's torque."""
        remaining = self.residual_of(self.scaled(term.columns)) @ term.beta
        return float(np.sum(remaining**2))


class WhiteFitter:
    """Fits the model and effects to white rows; one basis of the model serves all fits."""

    def __init__(
        self,
        data: WhiteData,
        like: WhiteFitter | None = None,
    ) -> None:
        """Prepare fits to white rows.

        ``like`` is another fitter; if its rows are equal, its basis of the model's
        columns is used again. A joint's variance is at least 1 where the noise is
        known: white rows are in units of it.
        """
        self.data = data
        self.floor = 1.0 if data.noise_is_known else 1e-12
        if like is not None and like.has_rows_of(data):
            self._basis = like._basis
            self._basis_products = like._basis_products

    def has_rows_of(self, data: WhiteData) -> bool:
        """Return whether other data have the same columns of the model and the same
        torque.
        """
        same_effects = list(self.data.own_effects) == list(data.own_effects)
        return (
            same_effects
            and np.array_equal(self.data.X, data.X)
            and np.array_equal(self.data.y, data.y)
        )

    @cached_property
    def _basis(self) -> tuple[Array, Array, dict[Key | None, list[int]]]:
        """The model's columns: a basis B (n, M, r), B'B (n, r, r), and each key's place
        in it.

        Effects with a shape constant that might be re-estimated keep a column of their
        own, so that it can be left out; all other columns share an orthonormal basis
        under the key None.
        """
        X = self.data.X
        own_effects = self.data.own_effects
        n, M, _ = X.shape
        separate = [column for _, column in own_effects.values()]
        shared = orthonormal(np.delete(X, separate, axis=2).reshape(n * M, -1))
        n_shared = shared.shape[1]
        B = np.concatenate(
            [shared.reshape(n, M, n_shared), _unit(X[:, :, separate])], axis=2
        )
        columns_by_key: dict[Key | None, list[int]] = {None: list(range(n_shared))}
        for k, key in enumerate(own_effects):
            columns_by_key[key] = [n_shared + k]
        return B, B.transpose(0, 2, 1) @ B, columns_by_key

    @cached_property
    def _basis_products(self) -> BasisProducts:
        """Products of candidates' columns with the model's basis, filled as they are
        needed.
        """
        return BasisProducts(self._basis[0], self.data.y)

    def fit(
        self,
        terms: Sequence[Term],
        near: WhiteFit | None = None,
    ) -> WhiteFit:
        """Fit the model with some terms; each joint is weighted by its own residual.

        Parameters
        ----------
        terms
            Effects and nuisances beside the model. An effect that is another value of
            one of the model's constants replaces that column of the model.
        near
            A fit whose columns are used again if they hold all the terms, and at whose
            levels the iteration begins.

        Returns
        -------
        WhiteFit
            Coefficients, levels and residual.
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
            for key, its_columns in design.columns_of_model.items()
            if key not in replaced
            for i in its_columns
        ]
        columns += sorted(i for t in terms for i in design.columns_by_text[t.text])
        level = np.ones(len(design.y)) if near is None else near.level
        return self._fitted(design, tuple(columns), level)

    def without(self, fit: WhiteFit, form: Candidate) -> WhiteFit:
        """Return a fit without the column that a candidate replaces, at the same
        levels.

        It is the fit itself where the candidate replaces none of the model's constants.
        """
        if not form.replaces_own_constant:
            return fit
        if form.key not in fit.fits_without:
            replaced = fit.design.columns_of_model[form.key]
            columns_left = tuple(i for i in fit.columns_kept if i not in replaced)
            fit.fits_without[form.key] = self._fitted(
                fit.design,
                columns_left,
                fit.level,
                rounds=1,
            )
        return fit.fits_without[form.key]

    def _design(self, terms: Sequence[Term]) -> Design:
        """Assemble the columns of the model and of the terms, with their products.

        A is (n, M + extra rows, p): the model's basis first, then each term's columns
        scaled to unit length. Only products with a term's columns are computed; the
        model's are known.
        """
        B, gram_of_model, model = self._basis
        n, M, r = B.shape
        A, at, extra = self._columns_with_priors(terms)
        p = A.shape[2]
        G = np.zeros((n, p, p))
        G[:, :r, :r] = gram_of_model
        for j in range(n):
            columns_of_terms = [i for t in terms if j in t.columns for i in at[t.text]]
            cross = A[j].T @ A[j][:, columns_of_terms]
            G[j][:, columns_of_terms] = cross
            G[j][columns_of_terms] = cross.T
        # The terms' columns to unit length over all joints; the model's have it.
        energy = np.sum(np.diagonal(G, axis1=1, axis2=2), axis=0)
        scale = np.ones(p)
        scale[r:] = 1.0 / nonzero_or_one(np.sqrt(energy[r:]))
        A[:, :, r:] *= scale[r:]
        G *= scale[:, None] * scale
        y = np.zeros(A.shape[:2])  # zero in the rows of priors
        y[:, :M] = self.data.y
        pull = (A.transpose(0, 2, 1) @ y[:, :, None])[:, :, 0]
        effects = [t for t in terms if isinstance(t, ScoredEffect)]
        keys = {i: t.key for t in effects for i in at[t.text]}
        return Design(
            A=A,
            y=y,
            gram=G,
            pull=pull,
            columns_of_model=model,
            columns_by_text=at,
            keys=keys,
            n_prior_rows=extra,
            basis_products=self._basis_products,
        )

    def _columns_with_priors(
        self, terms: Sequence[Term]
    ) -> tuple[Array, dict[str, list[int]], Array]:
        """Stack the columns of the model and of the terms, and the priors of nuisances.

        A nuisance's coefficient a has a prior N(0, d^2). It enters as rows a / d = 0
        behind the M rows of the log, on each joint that the nuisance acts on; several
        joints share the weight.

        Returns
        -------
        (n, M + rows, p) array
            The columns, not scaled.
        dict of str to list of int
            The columns of each term, by its text.
        (n,) array
            How many prior rows each joint counts: a share of one where several joints
            share it.
        """
        B, _, _ = self._basis
        n, M, r = B.shape
        n_prior_rows, extra = _count_prior_rows(terms, n)
        n_columns = r + sum(_width(t) for t in terms)
        A = np.zeros((n, M + n_prior_rows.max(initial=0), n_columns))
        A[:, :M, :r] = B
        next_row = np.full(n, M)
        next_column = r
        columns_by_text = dict[str, list[int]]()
        for term in terms:
            width = _width(term)
            first = next_column
            next_column += width
            its_columns = list(range(first, next_column))
            columns_by_text[term.text] = its_columns
            for j, z in term.columns.items():
                A[j, :M, first:next_column] = z
                if isinstance(term, Nuisance):
                    rows = next_row[j] + np.arange(width)
                    n_joints = len(term.columns)
                    A[j, rows, its_columns] = 1.0 / term.deviations / n_joints**0.5
                    next_row[j] += width
        return A, columns_by_text, extra

    def _fitted(
        self,
        design: Design,
        columns: tuple[int, ...],
        level: Array,
        rounds: int = 20,
    ) -> WhiteFit:
        """Estimate coefficients and the joints' levels in turn, until the levels
        settle.

        Parameters
        ----------
        design
            All columns with their products.
        columns
            Which of them take part.
        level
            (n,) standard deviations of the joints' residuals to begin with.
        rounds
            The most iterations, each of which raises the likelihood (six were needed at
            most on three arms); one leaves the levels as they are.
        """
        columns_kept = np.array(columns, int)
        G = design.gram.take(columns_kept, 1).take(columns_kept, 2)
        pull = design.pull[:, columns_kept]
        flat_gram = G.reshape(len(G), -1)
        squares_of_torque = np.sum(design.y**2, axis=1)
        degrees = self.data.count + design.n_prior_rows
        for _ in range(rounds):
            L = _triangle((level**-2.0 @ flat_gram).reshape(G.shape[1:]))
            weighted_pull = level**-2.0 @ pull
            theta = scipy.linalg.cho_solve(
                (L, True),
                weighted_pull,
                check_finite=False,
            )
            rss = squares_of_torque - 2.0 * pull @ theta + (G @ theta) @ theta
            rss = np.maximum(rss, 0.0)
            last = level
            level = np.sqrt(np.maximum(rss / degrees, self.floor))
            if np.all(np.abs(level - last) < 1e-2 * level):
                break
        # With the weighted Gram matrix L L', the columns A L^-T are orthonormal.
        inverse = scipy.linalg.solve_triangular(
            L,
            np.eye(len(L)),
            lower=True,
            check_finite=False,
        )
        root = inverse.T
        # Zero for columns of the design that take no part.
        p = design.A.shape[2]
        W = np.zeros((p, len(columns_kept)))
        W[columns_kept] = root
        all_theta = np.zeros(p)
        all_theta[columns_kept] = theta
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


def _width(term: Term) -> int:
    """Return the number of columns of an effect or a nuisance."""
    return next(iter(term.columns.values())).shape[1]


def _count_prior_rows(terms: Sequence[Term], n: int) -> tuple[NDArray[np.intp], Array]:
    """Count the rows that hold the nuisances' priors, on each of n joints.

    Returns how many rows a joint needs (n,), and how many it counts (n,): several joints
    of one nuisance share one prior.
    """
    n_rows = np.zeros(n, np.intp)
    counted = np.zeros(n)
    for term in terms:
        if isinstance(term, Nuisance):
            joints = list(term.columns)
            n_rows[joints] += _width(term)
            counted[joints] += _width(term) / len(joints)
    return n_rows, counted


def orthonormal(columns: Array) -> Array:
    """Return an orthonormal basis (N, r) of the column space of ``columns`` (N, p).

    The rank r comes from a pivoted QR of the columns' triangular factor, which is
    small. The basis is orthogonalised once more: twice is enough (Giraud et al. 2005).
    """
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
    """Scale columns (n joints, M, k) to unit length over all joints; zero columns stay."""
    return columns / nonzero_or_one(np.sqrt(np.sum(columns**2, axis=(0, 1))))


def _triangle(gram: Array) -> Array:
    """Return the lower Cholesky factor (p, p) of a Gram matrix, with a small ridge.

    The ridge, DEPENDENT^2 of the diagonal, keeps it positive where one column depends
    on others.
    """
    return np.asarray(
        np.linalg.cholesky(
            gram + np.diag(DEPENDENT**2 * nonzero_or_one(np.diagonal(gram)))
        )
    )


def with_ridge(A: Array) -> Array:
    """Add 1e-10 of the diagonal to positive matrices (..., k, k), against rounding."""
    diagonal = np.diagonal(A, axis1=-2, axis2=-1)
    return np.asarray(A + 1e-10 * (diagonal + 1e-300)[..., None] * np.eye(A.shape[-1]))


def bounded_least_squares(
    A: Array,
    pull: Array,
    nonnegative: NDArray[np.bool_],
) -> Array:
    """Minimise b'A b / 2 - pull'b, with some coefficients not negative.

    Parameters
    ----------
    A
        (k, k) positive matrix.
    pull
        (k,) vector.
    nonnegative
        (k,) which coefficients must be at least zero.

    Returns
    -------
    (k,) array
        The minimiser; by non-negative least squares if the free one violates a sign.
    """
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
