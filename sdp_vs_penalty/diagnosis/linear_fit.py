"""The model and some effects, fitted to white rows: the algebra beneath the score."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
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
class BasisProducts:
    """Products of candidates' columns with the model's columns and with the torque."""

    #: (n joints, M, r) the model's columns.
    basis: Array
    #: (n, M) white torque.
    y: Array
    #: The products computed so far, by batch of candidates.
    computed: dict[Batch, list[tuple[Array, Array]]] = field(default_factory=dict)

    @cached_property
    def with_torque(self) -> Array:
        """(n, r) the products B'y of the model's columns and the torque."""
        return (self.basis.transpose(0, 2, 1) @ self.y[:, :, None])[:, :, 0]

    def with_batch(self, batch: Batch) -> list[tuple[Array, Array]]:
        """Return the products B'Z (r, F k) and Z'y (F k,), one pair a joint of a batch.

        B are the model's r columns, Z the white columns of the batch's F candidates of
        k coefficients each, y the torque. They are computed once for each batch.
        """
        if batch not in self.computed:
            pairs = zip(batch.joints, batch.whitened_columns, strict=True)
            self.computed[batch] = [
                (self.basis[j].T @ Z, Z.T @ self.y[j]) for j, Z in pairs
            ]
        return self.computed[batch]


class ModelBasis(NamedTuple):
    """A basis of the model's white columns."""

    #: (n joints, M, r) the vectors B of the basis.
    columns: Array
    #: (n, r, r) products B'B.
    gram: Array
    #: Which of the r columns belong to the effect with a key (name, joint); all columns
    #: without a key of their own are under None.
    columns_by_key: dict[Key | None, list[int]]


class JointTerms(NamedTuple):
    """The columns of terms that act on one joint."""

    #: (t,) numbers of these columns among the design's.
    numbers: Indices
    #: (M, t) the columns, scaled as the design's are.
    columns: Array


@dataclass(frozen=True, eq=False)
class Design:
    """White columns of the model and of some terms, with products.

    The design A (n joints, M, p) has columns of unit length, the model's r first. Most
    terms act on one joint: A is kept as the model's columns and, by joint, those of the
    terms that act there. Coefficients of tolerated errors have a prior about zero, whose
    precision is in the joint's products: with it A'A is the information on all
    coefficients.
    """

    #: The model's columns with their products.
    basis_products: BasisProducts
    #: The terms' columns on each of the n joints.
    terms_by_joint: Sequence[JointTerms]
    #: (n, p) precisions of the priors; zero where there is none.
    precision: Array
    #: (n, M) white torque.
    y: Array
    #: (n, p, p) products A'A, with the precisions of the priors.
    gram: Array
    #: (n, p) products A'y.
    Ay: Array
    #: Numbers of the model's columns, by key of an effect with a shape constant that
    #: might be re-estimated, all others under None.
    columns_of_model: Mapping[Key | None, list[int]]
    #: Numbers of each term's columns, by its text.
    columns_by_text: dict[str, list[int]]
    #: Products of batches of candidates, computed so far.
    _by_batch: dict[Batch, list[tuple[Array, Array]]] = field(default_factory=dict)

    @property
    def n_columns(self) -> int:
        """The number p of columns."""
        return self.Ay.shape[1]

    @cached_property
    def torque_squared(self) -> Array:
        """(n,) the squares y'y of each joint's torque."""
        return np.sum(self.y**2, axis=1)

    def times(self, coefficients: Array) -> Array:
        """Return A C (n, M, K) for coefficients C (p, K)."""
        B = self.basis_products.basis
        r = B.shape[2]
        out = B @ coefficients[:r]
        for j, terms in enumerate(self.terms_by_joint):
            if len(terms.numbers):
                out[j] += terms.columns @ coefficients[terms.numbers]
        return out

    def products_on(self, joint: int, z: Array) -> Array:
        """Return A'Z (p, K) for columns Z (M, K) on a joint (from 0)."""
        out = np.zeros((self.n_columns, z.shape[1]))
        B = self.basis_products.basis[joint]
        out[: B.shape[1]] = B.T @ z
        terms = self.terms_by_joint[joint]
        out[terms.numbers] = terms.columns.T @ z
        return out

    def products_with(self, batch: Batch) -> list[tuple[Array, Array]]:
        """Return the products A'Z (p, F k) and Z'y (F k,), one pair a joint of a batch
        of F candidates of k coefficients; they are computed once for each batch."""
        if batch not in self._by_batch:
            pairs = []
            for place, joint in enumerate(batch.joints):
                BZ, Zy = self.basis_products.with_batch(batch)[place]
                AZ = np.zeros((self.n_columns, BZ.shape[1]))
                AZ[: len(BZ)] = BZ
                terms = self.terms_by_joint[joint]
                AZ[terms.numbers] = terms.columns.T @ batch.whitened_columns[place]
                pairs.append((AZ, Zy))
            self._by_batch[batch] = pairs
        return self._by_batch[batch]

    def holds(self, terms: Sequence[Term]) -> bool:
        """Return whether the design has all terms (effects, nuisances)."""
        return all(t.text in self.columns_by_text for t in terms)


@dataclass(frozen=True)
class WhiteFit:
    """The model and some terms, fitted to white rows by weighted least squares."""

    #: The columns A (n joints, M rows, p) and the torque y.
    design: Design
    #: Numbers of those of the p columns that take part.
    columns_kept: tuple[int, ...]
    #: (p, r) matrix W for which W' (sum_j A_j'A_j / level_j^2) W = 1, priors included.
    whitener: Array
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
        return self.design.y / self.level[:, None]

    @cached_property
    def own_deviance(self) -> float:
        """The fit's deviance (:meth:`deviance`)."""
        return float(self.deviance(self.rss))

    @cached_property
    def residual(self) -> Array:
        """(n, M) what the fit leaves of the torque, divided by each joint's level."""
        residual = self.design.y - self.design.times(self.theta[:, None])[:, :, 0]
        return residual / self.level[:, None]

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
    def precision(self) -> Array:
        """(r, r) precision of the priors, of coefficients of ``basis``."""
        summed = self.level**-2.0 @ self.design.precision
        return (self.whitener.T * summed) @ self.whitener

    @property
    def along_torque(self) -> Array:
        """(r,) the products Q'y with the weighted torque, of Q the ``basis``."""
        return self.whitener.T @ (self.level**-2.0 @ self.design.Ay)

    @cached_property
    def design_with_residual(self) -> Array:
        """(n, p) the products A'r / level of the weighted design and residual, less the
        pull of the priors."""
        left = self.design.Ay - self.design.gram @ self.theta
        return left / self.level[:, None] ** 2

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
    #: A'Z (p, K) with the fit's weighted design A, by joint.
    with_design: dict[int, Array]

    @classmethod
    def from_columns(cls, fit: WhiteFit, columns: dict[int, Array]) -> ColumnProducts:
        """Multiply weighted columns, (M, K) by joint (from 0), with those of a fit."""
        with_design = {
            j: fit.design.products_on(j, z) / fit.level[j] for j, z in columns.items()
        }
        return cls(fit, columns, with_design)

    @cached_property
    def grams(self) -> dict[int, Array]:
        """Z'Z (K, K), by joint."""
        return {j: z.T @ z for j, z in self.columns.items()}

    @cached_property
    def energy(self) -> Array:
        """(K,) squares of the columns."""
        return np.diagonal(sum(self.grams.values()))

    @cached_property
    def along_fit(self) -> Array:
        """(r, K) the products Q'Z with the fit's r columns Q, its ``basis``."""
        return self.fit.whitener.T @ sum(self.with_design.values())

    @cached_property
    def gram_left(self) -> Array:
        """(K, K) the Gram matrix of what the fit leaves of Z: Z'Z - (Q'Z)'Q'Z."""
        gram = sum(self.grams.values())
        return gram - self.along_fit.T @ self.along_fit

    @cached_property
    def with_residuals(self) -> dict[int, Array]:
        """Z'r (K,) by joint, with the fit's residual r."""
        fit = self.fit
        out = {}
        for j, z in self.columns.items():
            with_torque = z.T @ fit.design.y[j] / fit.level[j]
            out[j] = with_torque - self.with_design[j].T @ fit.theta
        return out

    @cached_property
    def with_residual(self) -> Array:
        """(K,) the products Z'r over all joints, with the fit's residual r."""
        return np.asarray(sum(self.with_residuals.values()))

    @property
    def residual(self) -> Array:
        """(n, M, K) what the fit leaves of Z: Z - Q Q'Z."""
        fit = self.fit
        explained = fit.whitener @ self.along_fit
        left = fit.design.times(explained) / -fit.level[:, None, None]
        for j, z in self.columns.items():
            left[j] += z
        return left

    def squares_with(self, beta: Array) -> Array:
        """Return the squares (n,) of T beta on each joint for coefficients beta (K,),
        with T what the fit leaves of Z, in units of the joint's level."""
        fit = self.fit
        # T beta = Z beta - A d on each joint, with the weighted design A.
        d = fit.whitener @ (self.along_fit @ beta)
        squares = (fit.design.gram @ d) @ d / fit.level**2
        for j, gram in self.grams.items():
            along_design = float((self.with_design[j] @ beta) @ d)
            squares[j] += float(beta @ gram @ beta) - 2.0 * along_design
        return np.maximum(squares, 0.0)

    def rss_with(self, beta: Array, squares_of_torque: Array) -> Array:
        """Return the squared errors (n,) of the joints once T beta joins the fit, with
        coefficients beta (K,) and the squares (n,) of T beta (:meth:`squares_with`).

        T is what the fit leaves of Z. Errors are not weighted.
        """
        fit = self.fit
        d = fit.whitener @ (self.along_fit @ beta)
        squares = fit.rss / fit.level**2 + squares_of_torque
        squares += 2.0 * fit.design_with_residual @ d
        for j, products in self.with_residuals.items():
            squares[j] -= 2.0 * float(products @ beta)
        return np.maximum(squares, 0.0) * fit.level**2


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
            self._model_basis = like._model_basis
            self._basis_products = like._basis_products

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
    def _model_basis(self) -> ModelBasis:
        """A basis B (n, M, r) of the model's white columns, with B'B (n, r, r).

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
        return ModelBasis(B, B.transpose(0, 2, 1) @ B, columns_by_key)

    @cached_property
    def _basis_products(self) -> BasisProducts:
        """Products of candidates' columns with the model's basis and the torque.

        They are computed when a batch of candidates is first scored.
        """
        return BasisProducts(self._model_basis.columns, self.data.y)

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
        columns = list[int]()
        for key, its_columns in design.columns_of_model.items():
            if key not in replaced:
                columns += its_columns
        columns += sorted(i for t in terms for i in design.columns_by_text[t.text])
        level = np.ones(len(design.y)) if near is None else near.level
        return self._fitted(design, tuple(columns), level)

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
            replaced = fit.design.columns_of_model[key]
            columns_left = tuple(i for i in fit.columns_kept if i not in replaced)
            fit.fits_without[key] = self._fitted(
                fit.design,
                columns_left,
                fit.level,
                rounds=1,  # one round leaves the levels as they are
            )
        return fit.fits_without[key]

    def _design(self, terms: Sequence[Term]) -> Design:
        """Assemble the design A of the model and of terms, with A'A and A'y.

        The r columns of the model's basis come first, then those of the terms, scaled
        to unit length over all joints.
        """
        model = self._model_basis
        n, M, r = model.columns.shape
        y = self.data.y
        columns_by_text = dict[str, list[int]]()
        p = r
        for term in terms:
            columns_by_text[term.text] = list(range(p, p + _width(term)))
            p += _width(term)
        blocks = [_columns_on(j, terms, columns_by_text, M) for j in range(n)]
        energy = np.zeros(p)
        for numbers, unscaled in blocks:
            energy[numbers] += np.sum(unscaled**2, axis=0)
        scale = 1.0 / nonzero_or_one(np.sqrt(energy))
        precision = np.zeros((n, p))
        for term in terms:
            if isinstance(term, Nuisance):
                (joint,) = term.columns
                its_own = columns_by_text[term.text]
                precision[joint, its_own] = (scale[its_own] / term.deviations) ** 2
        G = np.zeros((n, p, p))
        G[:, :r, :r] = model.gram
        Ay = np.zeros((n, p))
        Ay[:, :r] = self._basis_products.with_torque
        scaled_blocks = []
        for j, (numbers, unscaled) in enumerate(blocks):
            columns = unscaled * scale[numbers]
            scaled_blocks.append(JointTerms(numbers, columns))
            if len(numbers):
                cross = model.columns[j].T @ columns
                G[j][:r, numbers] = cross
                G[j][numbers, :r] = cross.T
                G[j][np.ix_(numbers, numbers)] = columns.T @ columns
                G[j][numbers, numbers] += precision[j, numbers]
                Ay[j, numbers] = columns.T @ y[j]
        return Design(
            basis_products=self._basis_products,
            terms_by_joint=scaled_blocks,
            precision=precision,
            y=y,
            gram=G,
            Ay=Ay,
            columns_of_model=model.columns_by_key,
            columns_by_text=columns_by_text,
        )

    def _fitted(
        self, design: Design, columns: tuple[int, ...], level: Array, rounds: int = 20
    ) -> WhiteFit:
        """Estimate the coefficients and the joints' levels in turn, until these settle.

        A joint's level is the standard deviation of its residual; the rows of joint j
        are weighted by 1 / level_j. theta solves (sum_j A_j'A_j / level_j^2) theta =
        sum_j A_j'y_j / level_j^2, then level_j^2 is the joint's squared error over
        its rows; each prior is one row more of its joint.

        Parameters
        ----------
        design
            All columns and the torque.
        columns
            Numbers of the columns that take part.
        level
            (n,) the levels to begin with.
        rounds
            The most iterations, each of which raises the likelihood (six were needed at
            most on three arms); one leaves the levels as they are.
        """
        columns_kept = np.array(columns, np.intp)
        n, p = design.Ay.shape
        # Of all columns: a selection from each joint's Gram matrix would cost more.
        flat_gram = design.gram.reshape(n, -1)
        # Places of the products of the kept columns in a flat (p, p) matrix.
        among_kept = columns_kept[:, None] * p + columns_kept
        all_theta = np.zeros(p)  # zero for columns that take no part
        n_priors = np.count_nonzero(design.precision[:, columns_kept], axis=1)
        for _ in range(rounds):
            weights = level**-2.0
            L = _triangle((weights @ flat_gram)[among_kept])
            all_theta[columns_kept] = _solve(L, (weights @ design.Ay)[columns_kept])
            rss = design.torque_squared - 2.0 * design.Ay @ all_theta
            rss += (design.gram @ all_theta) @ all_theta
            rss = np.maximum(rss, 0.0)  # rounding may make it negative
            level_of_fit = level
            mean = rss / (self.data.count + n_priors)
            level = np.sqrt(np.maximum(mean, self.floor))
            if np.all(np.abs(level - level_of_fit) < 1e-2 * level):
                break
        # With the weighted Gram matrix L L', the columns A L^-T are orthonormal.
        L_inverse = _inverse_triangle(L)
        W = np.zeros((p, len(columns_kept)))
        W[columns_kept] = L_inverse.T
        # The trace of the joint's block of the projection on the fit's columns.
        covariance = np.zeros(p * p)
        covariance[among_kept] = L_inverse.T @ L_inverse
        rank_of_joint = flat_gram @ covariance / level_of_fit**2 - n_priors
        return WhiteFit(
            design=design,
            columns_kept=columns,
            whitener=W,
            theta=all_theta,
            level=level_of_fit,
            rss=rss,
            degrees=np.maximum(self.data.count - rank_of_joint, 1.0),
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


def _triangle(gram: Array) -> Array:
    """Return the lower Cholesky factor L (p, p) of a Gram matrix, with a small ridge.

    L L' = gram + DEPENDENT^2 diag(gram). The ridge keeps it positive where one column
    depends on others.
    """
    regular = gram.copy()
    diagonal = regular.ravel()[:: len(gram) + 1]  # a view
    diagonal += DEPENDENT**2 * nonzero_or_one(diagonal)
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
