"""The model and some effects, fitted to white rows: the algebra beneath the score."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import scipy

from sdp_vs_penalty.diagnosis.constants import EVIDENCE_TO_DISTINGUISH, LAW_TOLERANCE
from sdp_vs_penalty.diagnosis.library import Batch, Candidate, Key, Nuisance
from sdp_vs_penalty.diagnosis.white_rows import WhiteData
from sdp_vs_penalty.regression.evidence import deviance
from sdp_vs_penalty.regression.linalg import span
from sdp_vs_penalty.robot.arrays import Array, Indices, Mask, nonzero_or_one

#: Share of a column below which what others leave of it is rounding.
DEPENDENT = 1e-5


def margin(evidence: float, least: float = EVIDENCE_TO_DISTINGUISH) -> float:
    """Return the difference of evidence below which another law does as well as one of
    this evidence: odds of 20 to 1 (``least``), and the accuracy of laws, 4 %."""
    return least + LAW_TOLERANCE * max(evidence, 0.0)


class HeldLaw(NamedTuple):
    """A law that a file of `export` holds, in place of a finding that it does not hold."""

    #: The effect as `add` takes it.
    text: str
    #: Files with a place for it, and none for the finding.
    files: tuple[str, ...]
    #: (n,) RMS errors on data left out of the model with it alone [N m or N].
    rmse: Array


@dataclass(frozen=True, eq=False)
class ScoredEffect:
    """A candidate effect with its score as an addition to a fit.

    Two of them are equal only if they are one object.
    """

    #: The candidate.
    form: Candidate
    #: White columns (M, k) of the candidate (noise of variance 1), by joint (from 0).
    columns: dict[int, Array]
    #: Drop of the deviance that the candidate brings.
    drop: float = -np.inf
    #: Number of correlated rows that carry the evidence of one independent row.
    rows_worth_one: float = 1.0
    #: Evidence that the candidate's parameters and the choice among candidates cost.
    price: float = 0.0
    #: Effective number of coefficients, plus shape constants.
    freedom: float = 0.0
    #: (k,) coefficients in SI units.
    beta: Array = field(default_factory=lambda: np.zeros(0))
    #: (n,) sum of squares of the white torque on each joint that the effect explains
    #: and the fit cannot.
    squares: Array = field(default_factory=lambda: np.zeros(0))
    #: Candidates that fit about as well.
    rivals: tuple[ScoredEffect, ...] = ()
    #: The nearest law for which one of these files has a place; None without one.
    held_law: HeldLaw | None = None

    @property
    def evidence(self) -> float:
        """The evidence J: twice the logarithm of the odds that the effect acts.

        J = dD / v - price, with the drop dD of the deviance and the number v of
        correlated rows that count as one.
        """
        return self.drop / self.rows_worth_one - self.price

    def evidence_with_worth_of(self, other: ScoredEffect) -> float:
        """Return the evidence J = dD / v - price with the number v of another effect.

        v is the number of correlated rows that count as one. Two effects that make
        nearly the same torque are compared with one v: the errors of two estimates of v
        would decide otherwise.
        """
        return self.drop / other.rows_worth_one - self.price

    @property
    def key(self) -> Key:
        """Effect name and joint (from 0; None: the whole robot).

        Candidates that differ only in shape constants have the same key.
        """
        return self.form.key

    @property
    def text(self) -> str:
        """The effect as it is written on the command line."""
        return self.form.text

    @property
    def joints(self) -> frozenset[int]:
        """The joints (from 0) whose torque the effect changes."""
        return frozenset(self.columns)


#: What a fit takes besides the model.
Term = ScoredEffect | Nuisance


@dataclass(frozen=True, eq=False)
class ModelColumns:
    """A basis of the model's white columns and the torque, with products of candidates'
    columns."""

    #: (n joints, M, r + 1) the basis B and, last, the white torque y.
    columns: Array
    #: Which of the r columns belong to the effect with a key (name, joint); all columns
    #: without a key of their own are under None.
    columns_by_key: Mapping[Key | None, list[int]]
    #: The products computed so far, by batch of candidates.
    computed: dict[Batch, list[Array]] = field(default_factory=dict)

    @property
    def basis(self) -> Array:
        """(n joints, M, r) the basis."""
        return self.columns[:, :, :-1]

    @property
    def torque(self) -> Array:
        """(n, M) the white torque."""
        return self.columns[:, :, -1]

    @cached_property
    def gram(self) -> Array:
        """(n, r + 1, r + 1) products of the columns and the torque."""
        return self.columns.transpose(0, 2, 1) @ self.columns

    def with_columns(self, joint: int, z: Array) -> Array:
        """Return the products [B y]'Z (r + 1, K) of columns Z (M, K) on a joint."""
        return self.columns[joint].T @ z

    def with_batch(self, batch: Batch) -> list[Array]:
        """Return the products [B y]'Z (r + 1, F k) on each joint of a batch of F candidates
        of k coefficients; they are computed once for each batch."""
        if batch not in self.computed:
            pairs = zip(batch.joints, batch.whitened_columns, strict=True)
            self.computed[batch] = [self.with_columns(j, Z) for j, Z in pairs]
        return self.computed[batch]


class JointTerms(NamedTuple):
    """The columns of terms that act on one joint."""

    #: (t,) numbers of these columns among the design's.
    numbers: Indices
    #: (M, t) the columns, scaled as the design's are.
    columns: Array


@dataclass(frozen=True, eq=False)
class Reduced:
    """A joint's rows without what the columns that act on this joint alone explain.

    Their coefficients are the best for any coefficients of the shared columns, and no
    weight of the joint changes that. So a fit has to solve for the shared ones only.
    """

    #: (o,) numbers of the joint's own columns that take part.
    own: Indices
    #: (M, o) these columns O L^-T, with L L' = O'O and their priors.
    whitened: Array
    #: (o, o) L^-1.
    inverse: Array
    #: (o, q + 1) L^-1 O'[A y], of the q shared columns A and the torque y.
    along_own: Array
    #: (q + 1, q + 1) products of what is left of [A y].
    products: Array
    #: Products of batches of candidates, computed so far.
    by_batch: dict[Batch, tuple[Array, Array]] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Design:
    """White columns of the model and of some terms, with products.

    The design A (n joints, M, p) has columns of unit length. The q shared columns come
    first: the model's r, then those of terms that act on several joints. Those of a term
    that acts on one joint follow, joint by joint. Coefficients of tolerated errors have
    a prior about zero, whose precision is in the joint's products: with it A'A is the
    information on all coefficients.
    """

    #: The model's columns and the torque, with their products.
    model: ModelColumns
    #: Columns of terms that act on several joints, on each of the n joints.
    shared_terms: Sequence[JointTerms]
    #: Columns of terms that act on one joint, by that joint.
    own_terms: Sequence[JointTerms]
    #: (p,) precisions of the priors, on their own joints; zero where there is none.
    precision: Array
    #: The number q of shared columns.
    n_shared: int
    #: Numbers of each term's columns, by its text.
    columns_by_text: dict[str, list[int]]
    #: What is left of the joints' rows, by joint and own columns that take part.
    _reduced: dict[tuple[int, bytes], Reduced] = field(default_factory=dict)

    @cached_property
    def gram(self) -> Array:
        """(n, q + 1, q + 1) products of the shared columns and, last, the torque."""
        if self.n_shared == self.model.basis.shape[2]:
            return self.model.gram
        of_model = [*range(self.model.basis.shape[2]), self.n_shared]
        shape = self.n_shared + 1, self.n_shared + 1
        out = np.zeros((len(self.model.columns), *shape))
        out[np.ix_(range(len(out)), of_model, of_model)] = self.model.gram
        for j, (numbers, columns) in enumerate(self.shared_terms):
            out[j][:, numbers] = self.shared_products(j, columns)
            out[j][numbers] = out[j][:, numbers].T
        return out

    @cached_property
    def with_own(self) -> list[Array]:
        """By joint the products (o, q + 1) of its own columns with the shared ones and the
        torque."""
        return [
            self.shared_products(j, terms.columns).T
            for j, terms in enumerate(self.own_terms)
        ]

    @cached_property
    def own_ends(self) -> Indices:
        """(n + 1,) numbers of the joints' first own columns, and the number p."""
        counts = [len(terms.numbers) for terms in self.own_terms]
        return np.cumsum([self.n_shared, *counts])

    @cached_property
    def shared_squares(self) -> Array:
        """(n, q) squares of the shared columns."""
        return np.diagonal(self.gram, axis1=1, axis2=2)[:, :-1]

    @property
    def torque_squared(self) -> Array:
        """(n,) the squares y'y of each joint's torque."""
        return self.gram[:, -1, -1]

    def times(self, coefficients: Array) -> Array:
        """Return A C (n, M, K) for coefficients C (p, K)."""
        B = self.model.basis
        out = B @ coefficients[: B.shape[2]]
        for terms_by_joint in (self.shared_terms, self.own_terms):
            for j, terms in enumerate(terms_by_joint):
                if len(terms.numbers):
                    out[j] += terms.columns @ coefficients[terms.numbers]
        return out

    def reduced(self, columns: Indices) -> list[Reduced]:
        """Return what is left of each joint's rows; ``columns`` : the numbers of those
        that take part, in order."""
        ends = np.searchsorted(columns, self.own_ends)
        return [
            self._reduced_on(j, columns[start:end])
            for j, (start, end) in enumerate(pairwise(ends.tolist()))
        ]

    def _reduced_on(self, joint: int, own: Indices) -> Reduced:
        """Return what is left of the rows of a joint by some of its own columns; it is
        computed once for the same ones."""
        key = joint, own.tobytes()
        if key not in self._reduced:
            places = own - self.own_ends[joint]
            kept_columns = self.own_terms[joint].columns[:, places]
            gram = kept_columns.T @ kept_columns + np.diag(self.precision[own])
            inverse = _inverse_triangle(_triangle(gram, np.diagonal(gram)))
            along_own = inverse @ self.with_own[joint][places]
            self._reduced[key] = Reduced(
                own=own,
                whitened=kept_columns @ inverse.T,
                inverse=inverse,
                along_own=along_own,
                products=self.gram[joint] - along_own.T @ along_own,
            )
        return self._reduced[key]

    def shared_products(
        self, joint: int, z: Array, with_model: Array | None = None
    ) -> Array:
        """Return the products [A y]'Z (q + 1, K) of columns Z (M, K) on a joint with the
        shared columns and the torque; ``with_model`` : those with the model's columns
        and the torque, where they are known."""
        if with_model is None:
            with_model = self.model.with_columns(joint, z)
        terms = self.shared_terms[joint]
        out = np.zeros((self.n_shared + 1, z.shape[1]))
        out[: len(with_model) - 1] = with_model[:-1]
        out[terms.numbers] = terms.columns.T @ z
        out[-1] = with_model[-1]
        return out

    def products_with(
        self, batch: Batch, reduced: Sequence[Reduced]
    ) -> list[tuple[Array, Array]]:
        """Return the products of a batch of F candidates Z (M, F k), of k coefficients
        each, on each of its joints: [A y]'Z (q + 1, F k) with the shared columns and the
        torque, and Z'Z (F, k, k) of each candidate.

        They are products of what the joint's own columns O leave of the rows
        (:class:`Reduced`), and are computed once for the same own columns.
        """
        return [
            self._products_on_joint(batch, place, reduced[joint])
            for place, joint in enumerate(batch.joints)
        ]

    def _products_on_joint(
        self, batch: Batch, place: int, reduced: Reduced
    ) -> tuple[Array, Array]:
        """Return the products of a batch on the joint at a place of its list."""
        if batch not in reduced.by_batch:
            Z = batch.whitened_columns[place]
            Z_along_own = reduced.whitened.T @ Z  # (o, F k), of the part along O
            with_shared = self.shared_products(
                batch.joints[place], Z, self.model.with_batch(batch)[place]
            )
            with_shared -= reduced.along_own.T @ Z_along_own
            grams = batch.grams[place]  # Z'Z, before O is taken out
            F, k, _ = grams.shape
            E = Z_along_own.reshape(len(Z_along_own), F, k)
            E = E.transpose(1, 2, 0)  # (F, k, o)
            reduced.by_batch[batch] = with_shared, grams - E @ E.transpose(0, 2, 1)
        return reduced.by_batch[batch]

    def holds(self, terms: Sequence[Term]) -> bool:
        """Return whether the design has all terms (effects, nuisances)."""
        return all(t.text in self.columns_by_text for t in terms)


@dataclass(frozen=True)
class WhiteFit:
    """The model and some terms, fitted to white rows by weighted least squares."""

    #: The columns A (n joints, M rows, p) and the torque y.
    design: Design
    #: Numbers of those of the p columns that take part.
    columns_kept: Indices
    #: What the joints' own columns leave of their rows.
    reduced: Sequence[Reduced]
    #: (n, q + 1, q + 1) products of what is left of the shared columns A and the torque.
    products: Array
    #: (q, s) matrix W for which W' (sum_j A_j'A_j / level_j^2) W = 1, of the s shared
    #: columns that take part.
    shared_whitener: Array
    #: (p,) coefficients.
    theta: Array
    #: (n,) standard deviation of each joint's residual, by which its rows are divided.
    level: Array
    #: (n,) unweighted squared errors, with those of the priors.
    rss: Array
    #: (n,) rows less the joint's share of the rank.
    degrees: Array
    #: Lowest variance that a joint's residual may have.
    floor: float
    #: Fits without one of the model's own effects computed so far, by the effect's key.
    fits_without: dict[Key, WhiteFit] = field(default_factory=dict)

    @property
    def target(self) -> Array:
        """(n, M) the torque over the standard deviation of each joint's residual."""
        return self.design.model.torque / self.level[:, None]

    @cached_property
    def own_deviance(self) -> float:
        """The fit's deviance (:meth:`deviance`)."""
        return float(self.deviance(self.rss))

    @cached_property
    def residual(self) -> Array:
        """(n, M) what the fit leaves of the torque, divided by each joint's level."""
        modelled = self.design.times(self.theta[:, None])[:, :, 0]
        return (self.design.model.torque - modelled) / self.level[:, None]

    @property
    def leverage(self) -> Array:
        """(n, M) share of each row's noise that the fit absorbs, from 0 to 1: the sum
        of squares of the row in ``basis``."""
        return np.sum(self.basis**2, axis=2)

    @property
    def basis(self) -> Array:
        """(n, M, r) the fit's weighted columns A W / level, which are orthonormal where
        no coefficient has a prior."""
        return self.design.times(self.whitener) / self.level[:, None, None]

    @property
    def whitener(self) -> Array:
        """(p, r) matrix W for which W' (sum_j A_j'A_j / level_j^2) W = 1, priors
        included: of the shared columns, then of each joint's own."""
        W = [self.with_own_coefficients(self.shared_whitener, {})]
        for x, level in zip(self.reduced, self.level.tolist(), strict=True):
            of_own = np.zeros((len(self.theta), len(x.own)))
            of_own[x.own] = level * x.inverse.T
            W.append(of_own)
        return np.hstack(W)

    @property
    def precision(self) -> Array:
        """(r, r) precision of the priors, of coefficients of ``basis``."""
        summed = np.zeros(len(self.theta))
        for x, level in zip(self.reduced, self.level.tolist(), strict=True):
            summed[x.own] = self.design.precision[x.own] / level**2
        W = self.whitener
        return (W.T * summed) @ W

    @property
    def along_torque(self) -> Array:
        """(r,) the products Q'y with the weighted torque, of Q the ``basis``."""
        return np.tensordot(self.basis, self.target, axes=((0, 1), (0, 1)))

    def with_own_coefficients(
        self, shared: Array, along_own: Mapping[int, Array]
    ) -> Array:
        """Return all coefficients (p, K) of columns Z of rows, with the best ones of each
        joint's own columns beside the ``shared`` ones (q, K).

        along_own : by joint the products (o, K) of Z with ``Reduced.whitened``; zero on
        other joints.
        """
        out = np.zeros((len(self.theta), shared.shape[1]))
        out[: len(shared)] = shared
        for j, x in enumerate(self.reduced):
            out[x.own] = x.inverse.T @ (
                along_own.get(j, 0.0) - x.along_own[:, :-1] @ shared
            )
        return out

    def deviance(self, rss: Array) -> Array:
        """Return the deviance -2 log L (...,) for sums of squared errors rss (..., n).

        It is the sum over the n joints of N log V + rss / V, with N degrees of freedom
        and the variance V = max(rss / N, floor).
        """
        return deviance(rss, self.degrees, self.floor)

    def scaled(self, columns: dict[int, Array]) -> dict[int, Array]:
        """Divide white columns, (M, k) by joint, by the level of their joint.

        The level is the standard deviation of the joint's residual; the fit's rows are
        weighted in the same way.
        """
        return {j: z / self.level[j] for j, z in columns.items()}

    def residual_of(self, scaled: dict[int, Array]) -> Array:
        """Return what the fit leaves (n joints, M, k) of weighted columns Z, (M, k) by
        joint (from 0), divided by the joint's level (:meth:`scaled`)."""
        return ColumnProducts.from_columns(self, scaled).residual


@dataclass(frozen=True, eq=False)
class ColumnProducts:
    """Products of weighted columns Z, which may join a fit, with the fit's columns.

    They give the squared error of the fit with Z without any work in rows.
    """

    #: The fit that the columns may join.
    fit: WhiteFit
    #: Columns Z (M, K), divided by the joint's level, by joint (from 0).
    columns: dict[int, Array]
    #: By joint the squares (K,) of the columns.
    squares: dict[int, Array]
    #: By joint the products (o, K) of its own columns, ``Reduced.whitened``, and Z times
    #: the level.
    along_own: dict[int, Array]
    #: By joint [A y]'Z (q + 1, K) of what its own columns leave of the fit's weighted
    #: shared columns A, of the torque y and of Z.
    with_shared: dict[int, Array]
    #: By joint Z'Z (K, K) of the same.
    grams: dict[int, Array]

    @classmethod
    def from_columns(cls, fit: WhiteFit, columns: dict[int, Array]) -> ColumnProducts:
        """Multiply weighted columns, (M, K) by joint (from 0), with those of a fit."""
        design = fit.design
        squares, along_own, with_shared, grams = {}, {}, {}, {}
        for j, z in columns.items():
            reduced = fit.reduced[j]
            gram = z.T @ z
            squares[j] = np.diagonal(gram)
            e = reduced.whitened.T @ z
            along_own[j] = e * fit.level[j]
            products = design.shared_products(j, z) - reduced.along_own.T @ e
            with_shared[j] = products / fit.level[j]
            grams[j] = gram - e.T @ e
        return cls(fit, columns, squares, along_own, with_shared, grams)

    @property
    def energy(self) -> Array:
        """(K,) squares of the columns."""
        return np.asarray(sum(self.squares.values()))

    @cached_property
    def _with_all_joints(self) -> Array:
        """(q + 1, K) ``with_shared``, summed over the joints."""
        return np.asarray(sum(self.with_shared.values()))

    @cached_property
    def along_fit(self) -> Array:
        """(s, K) the products Q'Z with the fit's s orthonormal shared columns Q."""
        return self.fit.shared_whitener.T @ self._with_all_joints[:-1]

    @cached_property
    def gram_left(self) -> Array:
        """(K, K) the Gram matrix of what the fit leaves of Z."""
        return sum(self.grams.values()) - self.along_fit.T @ self.along_fit

    @cached_property
    def with_residual(self) -> Array:
        """(K,) the products Z'r over all joints, with the fit's residual r."""
        with_columns, with_torque = (
            self._with_all_joints[:-1],
            self._with_all_joints[-1],
        )
        return with_torque - self.fit.theta[: len(with_columns)] @ with_columns

    @property
    def residual(self) -> Array:
        """(n, M, K) what the fit leaves of Z."""
        fit = self.fit
        shared = fit.shared_whitener @ self.along_fit
        explained = fit.with_own_coefficients(shared, self.along_own)
        left = fit.design.times(explained) / -fit.level[:, None, None]
        for j, z in self.columns.items():
            left[j] += z
        return left

    def change(self, beta: Array) -> Array:
        """Return by how much the coefficients (q,) of the shared columns fall once Z beta
        joins the fit, with coefficients beta (K,)."""
        return self.fit.shared_whitener @ (self.along_fit @ beta)

    def squares_with(self, beta: Array) -> Array:
        """Return the squares (n,) of T beta on each joint for coefficients beta (K,),
        with T what the fit leaves of Z, in units of the joint's level."""
        return self._squares(np.append(-self.change(beta), 0.0), beta)

    def rss_with(self, beta: Array) -> Array:
        """Return the squared errors (n,) of the joints once T beta joins the fit, with
        coefficients beta (K,).

        T is what the fit leaves of Z. Errors are not weighted.
        """
        theta = self.fit.theta[: self.fit.design.n_shared] - self.change(beta)
        return self._squares(np.append(theta, -1.0), beta) * self.fit.level**2

    def _squares(self, shared: Array, beta: Array) -> Array:
        """Return the squares (n,) of the joints' torque, in units of their levels: of the
        shared columns and the measured torque with coefficients (q + 1,), and of Z beta.
        """
        fit = self.fit
        squares = (fit.products @ shared) @ shared / fit.level**2
        for j, gram in self.grams.items():
            along = float(shared @ (self.with_shared[j] @ beta))
            squares[j] += float(beta @ gram @ beta) + 2.0 * along
        return np.maximum(squares, 0.0)


class WhiteFitter:
    """Fits the model and effects to white rows; one basis of the model serves all fits."""

    def __init__(self, data: WhiteData, like: WhiteFitter | None = None) -> None:
        """Prepare fits to white rows.

        ``like`` is another fitter; if its rows are equal, its basis of the model's
        columns is used again. The floor is the lowest variance of a joint's residual: 1
        where the noise was measured, since white rows are in units of it.
        """
        self.data = data
        self.floor = 1.0 if data.noise_is_known else 1e-12
        if like is not None and like.has_rows_of(data):
            self._model_columns = like._model_columns

    def has_rows_of(self, data: WhiteData) -> bool:
        """Return whether other data have the same rows.

        These are rows with equal columns of the model and equal torque, whose effects
        with re-estimable shape constants are the same.
        """
        if self.data.X is data.X and self.data.y is data.y:
            return True
        same_effects = list(self.data.own_effects) == list(data.own_effects)
        return (
            same_effects
            and np.array_equal(self.data.X, data.X)
            and np.array_equal(self.data.y, data.y)
        )

    @cached_property
    def _model_columns(self) -> ModelColumns:
        """A basis B (n, M, r) of the model's white columns.

        An effect with a shape constant that might be re-estimated, or a parameter that
        must not be negative, keeps its column, scaled to unit length, so that a fit can
        leave it out. All other columns are
        replaced by an orthonormal basis, the first vectors of B, under the key None.
        """
        X = self.data.X
        own_effects = {k: column for k, (_, column) in self.data.own_effects.items()}
        own_effects |= self.data.signed_effects
        n, M, _ = X.shape
        separate = [*own_effects.values()]
        shared = span(np.delete(X, separate, axis=2).reshape(n * M, -1))
        n_shared = shared.shape[1]
        B = np.concatenate(
            [shared.reshape(n, M, n_shared), _unit(X[:, :, separate])], axis=2
        )
        columns_by_key: dict[Key | None, list[int]] = {None: list(range(n_shared))}
        for k, key in enumerate(own_effects):
            columns_by_key[key] = [n_shared + k]
        columns = np.concatenate([B, self.data.y[:, :, None]], axis=2)
        return ModelColumns(columns, columns_by_key)

    def fit(self, terms: Sequence[Term], near: WhiteFit | None = None) -> WhiteFit:
        """Fit the model with some terms; each joint is weighted by its own residual.

        Parameters
        ----------
        terms
            Effects and nuisances (small tolerated errors) that join the model. An
            effect that is another value of one of the model's shape constants replaces
            that column of the model.
        near
            A similar fit. Its columns are used again if they hold all the terms, and
            the iteration begins at its levels (standard deviations of the residuals).
        """
        design = None if near is None else near.design
        if design is None or not design.holds(terms):
            design = self._design(terms)
        effects = [t for t in terms if isinstance(t, ScoredEffect)]
        replaced = {t.key for t in effects if t.form.replaces_own_constant}
        columns = [i for t in terms for i in design.columns_by_text[t.text]]
        for key, its_columns in design.model.columns_by_key.items():
            if key not in replaced:
                columns += its_columns
        level = np.ones(self.data.n) if near is None else near.level
        return self._fitted(design, np.sort(np.array(columns, int)), level)

    def at_level(self, fit: WhiteFit, level: Array) -> WhiteFit:
        """Return a fit of the same columns with given levels (n,), standard deviations
        by which the joints' rows are divided."""
        return self._fitted(
            fit.design,
            fit.columns_kept,
            level,
            rounds=1,  # one round leaves the levels as they are
        )

    def without(self, fit: WhiteFit, form: Candidate) -> WhiteFit:
        """Return the fit without the model's column that a candidate replaces.

        A candidate replaces a column if it is another value of one of the model's shape
        constants. If it is not, the fit itself is returned. Each joint keeps its level,
        the standard deviation by which its rows are divided.
        """
        return self.without_own(fit, form.key) if form.replaces_own_constant else fit

    def without_own(self, fit: WhiteFit, key: Key) -> WhiteFit:
        """Return the fit without the column of one of the model's effects on a joint."""
        if key not in fit.fits_without:
            replaced = fit.design.model.columns_by_key[key]
            columns_left = np.setdiff1d(fit.columns_kept, replaced)
            fit.fits_without[key] = self._fitted(
                fit.design,
                columns_left,
                fit.level,
                rounds=1,  # one round leaves the levels as they are
            )
        return fit.fits_without[key]

    def _design(self, terms: Sequence[Term]) -> Design:
        """Assemble the design A of the model and of terms, with its products.

        Columns are scaled to unit length over all joints.
        """
        model = self._model_columns
        n, M, r = model.basis.shape
        shared = [t for t in terms if len(t.columns) > 1]
        on_one = [[t for t in terms if [*t.columns] == [j]] for j in range(n)]
        columns_by_text = dict[str, list[int]]()
        p = r
        for term in [*shared, *(t for of_joint in on_one for t in of_joint)]:
            columns_by_text[term.text] = list(range(p, p + _width(term)))
            p += _width(term)
        q = r + sum(map(_width, shared))
        shared_terms = [_columns_on(j, shared, columns_by_text, M) for j in range(n)]
        own_terms = [_columns_on(j, on_one[j], columns_by_text, M) for j in range(n)]
        energy = np.zeros(p)
        for numbers, unscaled in [*shared_terms, *own_terms]:
            energy[numbers] += np.sum(unscaled**2, axis=0)
        scale = 1.0 / nonzero_or_one(np.sqrt(energy))
        shared_terms, own_terms = (
            [JointTerms(numbers, x * scale[numbers]) for numbers, x in of_joints]
            for of_joints in (shared_terms, own_terms)
        )
        precision = np.zeros(p)
        for term in terms:
            if isinstance(term, Nuisance):
                its_own = columns_by_text[term.text]
                precision[its_own] = (scale[its_own] / term.deviations) ** 2
        design = Design(
            model=model,
            shared_terms=shared_terms,
            own_terms=own_terms,
            precision=precision,
            n_shared=q,
            columns_by_text=columns_by_text,
        )
        return design

    def _fitted(
        self, design: Design, columns: Indices, level: Array, rounds: int = 20
    ) -> WhiteFit:
        """Estimate the coefficients and the joints' levels in turn, until these settle.

        A joint's level is the standard deviation of its residual; the rows of joint j
        are weighted by 1 / level_j. theta solves (sum_j A_j'A_j / level_j^2) theta =
        sum_j A_j'y_j / level_j^2, then level_j^2 is the joint's squared error over
        its rows; each prior is one row more of its joint. A and y are what is left by
        the joints' own columns, whose coefficients follow.

        Parameters
        ----------
        design
            All columns and the torque.
        columns
            Numbers of the columns that take part, in order.
        level
            (n,) the levels to begin with.
        rounds
            The most iterations, each of which raises the likelihood (six were needed at
            most on three arms); one leaves the levels as they are.
        """
        reduced = design.reduced(columns)
        products = np.stack([x.products for x in reduced])
        q = design.n_shared
        kept = columns[: np.searchsorted(columns, q)]
        # Of all columns: a selection from each joint's products would cost more.
        flat = products.reshape(len(level), -1)
        # Places of the products of the kept columns, and of their squares before.
        among_kept = kept[:, None] * (q + 1) + kept
        squares = design.shared_squares[:, kept]
        signed = np.zeros(q + 1)  # zero for columns that take no part
        signed[-1] = -1.0
        n_priors = np.array(
            [np.count_nonzero(design.precision[x.own]) for x in reduced]
        )
        for _ in range(rounds):
            weights = level**-2.0
            weighted = weights @ flat
            L = _triangle(weighted[among_kept], weights @ squares)
            signed[kept] = _solve(L, weighted[kept * (q + 1) + q])
            rss = (products @ signed) @ signed
            rss = np.maximum(rss, 0.0)  # rounding may make it negative
            level_of_fit = level
            mean = rss / (self.data.count + n_priors)
            level = np.sqrt(np.maximum(mean, self.floor))
            if np.all(np.abs(level - level_of_fit) < 1e-2 * level):
                break
        # With the weighted products L L', the columns A L^-T are orthonormal.
        L_inverse = _inverse_triangle(L)
        W = np.zeros((q, len(kept)))
        W[kept] = L_inverse.T
        # The trace of the joint's block of the projection on the fit's columns.
        covariance = np.zeros((q + 1) ** 2)
        covariance[among_kept] = L_inverse.T @ L_inverse
        rank = flat @ covariance / level_of_fit**2
        rank += [len(x.own) for x in reduced] - n_priors
        theta = np.zeros(len(design.precision))
        theta[:q] = signed[:-1]
        for x in reduced:
            theta[x.own] = -x.inverse.T @ (x.along_own @ signed)
        return WhiteFit(
            design=design,
            columns_kept=columns,
            reduced=reduced,
            products=products,
            shared_whitener=W,
            theta=theta,
            level=level_of_fit,
            rss=rss,
            degrees=np.maximum(self.data.count - rank, 1.0),
            floor=self.floor,
        )


def _width(term: Term) -> int:
    """Return the number k of columns of a term, equal on all its joints."""
    return next(iter(term.columns.values())).shape[1]


def _columns_on(
    joint: int,
    terms: Sequence[Term],
    columns_by_text: Mapping[str, list[int]],
    n_rows: int,
) -> JointTerms:
    """Stack the columns of the terms that act on a joint, not scaled.

    ``columns_by_text`` holds the numbers of each term's columns, by its text;
    ``n_rows`` is the number of rows of each joint.
    """
    on_joint = [t for t in terms if joint in t.columns]
    numbers = [i for t in on_joint for i in columns_by_text[t.text]]
    columns = np.zeros((n_rows, 0))
    if on_joint:
        columns = np.hstack([t.columns[joint] for t in on_joint])
    return JointTerms(np.array(numbers, np.intp), columns)


def _solve(L: Array, b: Array) -> Array:
    """Solve L L' x = b (m,) for a lower triangle L (m, m); return x (m,)."""
    if not len(b):  # LAPACK refuses an empty matrix
        return b
    return scipy.linalg.lapack.dpotrs(L, b, lower=True)[0]


def _inverse_triangle(L: Array) -> Array:
    """Return the inverse (m, m) of a lower triangle L (m, m)."""
    if not len(L):
        return L
    return scipy.linalg.lapack.dtrtri(L, lower=True)[0]


def _unit(columns: Array) -> Array:
    """Scale columns (n joints, M, k) to unit length over all joints; zero columns stay."""
    return columns / nonzero_or_one(np.sqrt(np.sum(columns**2, axis=(0, 1))))


def _triangle(gram: Array, squares: Array) -> Array:
    """Return the lower Cholesky factor L (p, p) of a Gram matrix, with a small ridge.

    L L' = gram + DEPENDENT^2 diag(squares), the squares (p,) of the columns before others
    were taken from them. The ridge keeps it positive where one column depends on others.
    """
    regular = gram.copy()
    diagonal = regular.ravel()[:: len(gram) + 1]  # a view
    diagonal += DEPENDENT**2 * nonzero_or_one(squares)
    return np.asarray(np.linalg.cholesky(regular))


def with_ridge(A: Array) -> Array:
    """Add 1e-10 of the diagonal to positive matrices (..., k, k), against rounding.

    A zero on the diagonal becomes 1e-310, so that the matrix can be inverted.
    """
    diagonal = np.diagonal(A, axis1=-2, axis2=-1) + 1e-300
    return A + 1e-10 * diagonal[..., None] * np.eye(A.shape[-1])


def bounded_least_squares(A: Array, Xy: Array, nonnegative: Mask) -> Array:
    """Minimise b'A b / 2 - (X'y)'b, with some coefficients b not negative.

    Parameters
    ----------
    A
        (k, k) positive definite matrix, such as X'X.
    nonnegative
        (k,) flags: which coefficients must be at least zero.

    Returns
    -------
    (k,) array
        The minimiser: A^-1 X'y if it satisfies the signs, otherwise that of
        non-negative least squares.
    """
    if len(Xy) == 1:
        a = float(A[0, 0])
        ridge = 1e-10 * (a + 1e-300)  # as that of more coefficients
        coefficient = float(Xy[0] / (a + ridge))
        return np.array([max(coefficient, 0.0) if nonnegative[0] else coefficient])
    beta = np.asarray(np.linalg.solve(with_ridge(A), Xy))
    if not np.any(beta[nonnegative] < 0.0):
        return beta
    # With A = R'R, minimise |R b - R'^-1 X'y|^2. A coefficient of any sign is the
    # difference of two that are not negative: R has a second column for it.
    R = np.linalg.cholesky(with_ridge(A)).T
    target = np.linalg.solve(R.T, Xy)
    columns = np.hstack([R, -R[:, ~nonnegative]])
    solution = scipy.optimize.nnls(columns, target)[0]
    k = len(nonnegative)
    beta = solution[:k].copy()
    beta[~nonnegative] -= solution[k:]
    return beta
