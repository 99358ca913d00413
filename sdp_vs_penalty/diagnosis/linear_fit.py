"""The model and some effects, fitted to white rows: the algebra beneath the score."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from sdp_vs_penalty.diagnosis.library import Batch, Candidate, Key, Nuisance
from sdp_vs_penalty.diagnosis.white_rows import WhiteData
from sdp_vs_penalty.regression.evidence import deviance
from sdp_vs_penalty.robot.arrays import Array, nonzero_or_one

#: Share of a column below which what others leave of it is rounding.
DEPENDENT = 1e-5
#: Rows of a large matrix that are factorised at a time.
_ROWS_AT_A_TIME = 4096


@dataclass(frozen=True, eq=False)
class ScoredEffect:
    """A candidate effect with its score as an addition to a fit.

    Two of them are equal only if they are one object.

    form : the candidate; columns : its white columns (noise of variance 1), (M, k) by
    joint (from 0); drop : the drop of the deviance that it brings; rows_worth_one :
    number of correlated rows that carry the evidence of one independent row; price :
    the evidence that its parameters and the choice among candidates cost; freedom :
    effective number of coefficients, plus shape constants; beta (k,) : coefficients in
    SI units; squares (n,) : sum of squares of the white torque on each joint that the
    effect explains and the fit cannot; rivals : candidates that fit about as well.
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
        return self.form.effect.text

    @property
    def joints(self) -> frozenset[int]:
        """The joints (from 0) whose torque the effect changes."""
        return frozenset(self.columns)


#: What a fit takes besides the model.
Term = ScoredEffect | Nuisance


@dataclass(frozen=True, eq=False)
class BasisProducts:
    """Products of candidates' columns with the model's columns and with the torque.

    basis (n joints, M, r) : the model's columns; y (n, M) : white torque; computed :
    the products computed so far, by batch of candidates.
    """

    basis: Array
    y: Array
    computed: dict[Batch, list[tuple[Array, Array]]] = field(default_factory=dict)

    @cached_property
    def with_torque(self) -> Array:
        """(n, r) the products B'y of the model's columns and the torque."""
        return np.asarray((self.basis.transpose(0, 2, 1) @ self.y[:, :, None])[:, :, 0])

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
    """A basis of the model's white columns.

    columns B (n joints, M, r) : its vectors; gram (n, r, r) : B'B; columns_by_key :
    which of the r columns belong to the effect with a key (name, joint); all columns
    without a key of their own are under None.
    """

    columns: Array
    gram: Array
    columns_by_key: dict[Key | None, list[int]]


class JointTerms(NamedTuple):
    """The columns of terms (effects, nuisances) that act on one joint.

    numbers (t,) : of these columns among the design's; columns (M + prior rows, t) :
    scaled as the design's are.
    """

    numbers: NDArray[np.intp]
    columns: Array


@dataclass(frozen=True, eq=False)
class Design:
    """White columns of the model and of some terms (effects or nuisances), with
    products.

    The design A (n joints, M + prior rows, p) has columns of unit length, the model's r
    first. Most terms act on one joint: A is kept as the model's columns and, by joint,
    those of the terms that act there.

    basis_products : the model's columns with their products; terms_by_joint (n) : the
    terms' columns; y (n, M + prior rows) : torque, 0 in prior rows; gram (n, p, p) :
    A'A; Ay (n, p) : A'y; columns_of_model : numbers of the model's columns, by key of
    an effect with a shape constant that might be re-estimated, all others under None;
    columns_by_text : numbers of each term's columns, by its text; key_of_column : key
    of the effect that a column belongs to; n_prior_rows (n,) : how many prior rows each
    joint counts. A prior row says that the coefficient of a nuisance (a small tolerated
    error) is zero, up to its standard deviation.
    """

    basis_products: BasisProducts
    terms_by_joint: Sequence[JointTerms]
    y: Array
    gram: Array
    Ay: Array
    columns_of_model: Mapping[Key | None, list[int]]
    columns_by_text: dict[str, list[int]]
    key_of_column: dict[int, Key]
    n_prior_rows: Array
    products: dict[Batch, list[tuple[Array, Array]]] = field(default_factory=dict)

    @property
    def n_columns(self) -> int:
        """The number p of columns."""
        return self.Ay.shape[1]

    def times(self, coefficients: Array) -> Array:
        """Return A C (n, M + prior rows, K) for coefficients C (p, K)."""
        B = self.basis_products.basis
        n, M, r = B.shape
        out = np.zeros((n, self.y.shape[1], coefficients.shape[1]))
        np.matmul(B, coefficients[:r], out=out[:, :M])
        for j, terms in enumerate(self.terms_by_joint):
            if len(terms.numbers):
                out[j] += terms.columns @ coefficients[terms.numbers]
        return out

    def products_on(self, joint: int, z: Array) -> Array:
        """Return A'Z (p, K) for columns Z on a joint (from 0).

        Z has the M rows of the log, and may have the prior rows behind them.
        """
        out = np.zeros((self.n_columns, z.shape[1]))
        B = self.basis_products.basis[joint]
        M, r = B.shape
        out[:r] = B.T @ z[:M]
        terms = self.terms_by_joint[joint]
        out[terms.numbers] = terms.columns[: len(z)].T @ z
        return out

    def holds(self, terms: Sequence[Term]) -> bool:
        """Return whether the design has columns of all terms (effects, nuisances)."""
        return all(t.text in self.columns_by_text for t in terms)

    def products_with(self, batch: Batch) -> list[tuple[Array, Array]]:
        """Return the products A'Z (p, F k) and Z'y (F k,), one pair a joint of a batch.

        A are the design's p columns, Z the white columns of the batch's F candidates of
        k coefficients each, y the torque. Products with the model's columns, the first
        r of A, are shared by all designs; those with the terms' columns are computed
        once for each batch.
        """
        if batch not in self.products:
            self.products[batch] = self._compute_products_with(batch)
        return self.products[batch]

    def _compute_products_with(self, batch: Batch) -> list[tuple[Array, Array]]:
        """Compute the products that :meth:`products_with` returns and keeps.

        They are A'Z (p, F k) and Z'y (F k,), one pair a joint of the batch.
        """
        M = batch.whitened_columns.shape[1]
        pairs_of_model = self.basis_products.with_batch(batch)
        pairs = []
        for j, Z, (BZ, Zy) in zip(
            batch.joints,
            batch.whitened_columns,
            pairs_of_model,
            strict=True,
        ):
            AZ = np.zeros((self.n_columns, Z.shape[1]))
            AZ[: len(BZ)] = BZ
            terms = self.terms_by_joint[j]
            AZ[terms.numbers] = terms.columns[:M].T @ Z
            pairs.append((AZ, Zy))
        return pairs


@dataclass(frozen=True)
class WhiteFit:
    """The model and some terms, fitted to white rows by weighted least squares.

    design : its columns A (n joints, M rows, p) and torque y; columns_kept : which of
    the p columns take part; level (n,) : standard deviation of each joint's residual,
    by which its rows are divided; whitener W (p, r) : A W / level is orthonormal; theta
    (p,) : coefficients; residual (n, M) : weighted; rss (n,) : unweighted squared
    errors; degrees (n,) : rows less the joint's share of the rank; floor : lowest
    variance of a joint; fits_without : results computed once, by key of a model's own
    effect: the fit without it.
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

    @property
    def target(self) -> Array:
        """(n, M) the torque over the standard deviation of each joint's residual."""
        return np.asarray(self.design.y / self.level[:, None])

    @cached_property
    def basis(self) -> Array:
        """(n, M, r) an orthonormal basis A W / level of the fit's weighted columns."""
        return self.design.times(self.whitener) / self.level[:, None, None]

    @cached_property
    def keys_of_effects(self) -> frozenset[Key]:
        """Keys (effect name, joint) of the effects beside the model's."""
        key_of_column = self.design.key_of_column
        kept = (i for i in self.columns_kept if i in key_of_column)
        return frozenset(key_of_column[i] for i in kept)

    @cached_property
    def design_with_residual(self) -> Array:
        """(n, p) the products A'r / level of the weighted design and residual."""
        weighted = self.design.Ay - self.design.gram @ self.theta
        return np.asarray(weighted / self.level[:, None] ** 2)

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
        """Subtract from weighted columns Z their projection on the fit's columns.

        Returns Z - Q Q'Z (n joints, M + prior rows, k), with the orthonormal basis Q =
        A W / level of the fit. The prior rows of nuisances (small tolerated errors),
        behind the log's M rows, are part of it; Z is zero there.

        Parameters
        ----------
        scaled
            Z, (M, k) by joint from 0, divided by the joint's level (:meth:`scaled`).
        """
        design = self.design
        W = self.whitener
        AZ = sum(design.products_on(j, z / self.level[j]) for j, z in scaled.items())
        remaining = design.times(W @ (W.T @ AZ)) / -self.level[:, None, None]
        for j, z in scaled.items():
            remaining[j, : len(z)] += z
        return np.asarray(remaining)

    def energy(self, term: ScoredEffect) -> float:
        """Return the sum of weighted squares of an effect's torque beyond the fit.

        The effect's torque is its columns times beta; the part that the fit's columns
        can make is subtracted.
        """
        remaining = self.residual_of(self.scaled(term.columns)) @ term.beta
        return float(np.sum(remaining**2))


@dataclass(frozen=True, eq=False)
class ColumnProducts:
    """Products of weighted columns Z, which may join a fit, with the fit's columns.

    They give the squared error of the fit with Z without any work in rows. fit : the
    fit; columns : Z, (M, K) by joint (from 0), divided by the joint's level;
    with_design : A'Z (p, K) by joint, with the fit's weighted design A; grams : Z'Z (K,
    K) by joint; with_residuals : Z'r (K,) by joint, with the fit's residual r.
    """

    fit: WhiteFit
    columns: dict[int, Array]
    with_design: dict[int, Array]
    grams: dict[int, Array]
    with_residuals: dict[int, Array]

    @classmethod
    def of(cls, fit: WhiteFit, columns: dict[int, Array]) -> ColumnProducts:
        """Multiply weighted columns, (M, K) by joint (from 0), with those of a fit."""
        return cls(
            fit=fit,
            columns=columns,
            with_design={
                j: fit.design.products_on(j, z / fit.level[j])
                for j, z in columns.items()
            },
            grams={j: z.T @ z for j, z in columns.items()},
            with_residuals={
                j: fit.residual[j, : len(z)] @ z for j, z in columns.items()
            },
        )

    @property
    def n_columns(self) -> int:
        """The number K of columns."""
        return next(iter(self.columns.values())).shape[1]

    @cached_property
    def along_fit(self) -> Array:
        """(r, K) the products Q'Z with the fit's r orthonormal columns Q."""
        return np.asarray(self.fit.whitener.T @ sum(self.with_design.values()))

    @cached_property
    def gram(self) -> Array:
        """(K, K) the Gram matrix Z'Z over all joints."""
        return np.asarray(sum(self.grams.values()))

    @cached_property
    def gram_left(self) -> Array:
        """(K, K) the Gram matrix of what the fit leaves of Z: Z'Z - (Q'Z)'Q'Z."""
        return self.gram - self.along_fit.T @ self.along_fit

    @cached_property
    def with_residual(self) -> Array:
        """(K,) the products Z'r over all joints, with the fit's residual r."""
        return np.asarray(sum(self.with_residuals.values()))

    def rss_with(self, beta: Array) -> Array:
        """Return the squared errors (n,) of the joints once T beta joins the fit.

        T = Z - Q Q'Z is what the fit leaves of Z. Errors are not weighted.

        Parameters
        ----------
        beta
            (K,) coefficients.
        """
        fit = self.fit
        # T beta = Z beta - A d on each joint, with the weighted design A.
        d = fit.whitener @ (self.along_fit @ beta)
        squares = fit.rss / fit.level**2
        squares = squares + 2.0 * fit.design_with_residual @ d
        squares = squares + (fit.design.gram @ d) @ d / fit.level**2
        for j, gram in self.grams.items():
            along_design = float((self.with_design[j] @ beta) @ d)
            along_residual = float(self.with_residuals[j] @ beta)
            own_squares = float(beta @ gram @ beta)
            squares[j] += own_squares - 2.0 * (along_residual + along_design)
        return np.asarray(np.maximum(squares, 0.0) * fit.level**2)


class WhiteFitter:
    """Fits the model and effects to white rows; one basis of the model serves all fits."""

    def __init__(
        self,
        data: WhiteData,
        like: WhiteFitter | None = None,
    ) -> None:
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
        same_effects = list(self.data.own_effects) == list(data.own_effects)
        return (
            same_effects
            and np.array_equal(self.data.X, data.X)
            and np.array_equal(self.data.y, data.y)
        )

    @cached_property
    def _model_basis(self) -> ModelBasis:
        """A basis B (n, M, r) of the model's white columns, with B'B (n, r, r).

        An effect with a shape constant that might be re-estimated keeps its column,
        scaled to unit length, so that a fit can leave it out. All other columns are
        replaced by an orthonormal basis, the first vectors of B, under the key None.
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
        return ModelBasis(B, B.transpose(0, 2, 1) @ B, columns_by_key)

    @cached_property
    def _basis_products(self) -> BasisProducts:
        """Products of candidates' columns with the model's basis and the torque.

        They are computed when a batch of candidates is first scored.
        """
        return BasisProducts(self._model_basis.columns, self.data.y)

    def fit(
        self,
        terms: Sequence[Term],
        near: WhiteFit | None = None,
    ) -> WhiteFit:
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

        Returns
        -------
        WhiteFit
            Coefficients, levels and residual.
        """
        design = None if near is None else near.design
        if design is None or not design.holds(terms):
            design = self._design(terms)
        effects = [t for t in terms if isinstance(t, ScoredEffect)]
        replaced = {t.key for t in effects if t.form.replaces_own_constant}
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
        """Return the fit without the model's column that a candidate replaces.

        A candidate replaces a column if it is another value of one of the model's shape
        constants. If it is not, the fit itself is returned. Each joint keeps its level,
        the standard deviation by which its rows are divided.
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
                rounds=1,  # one round leaves the levels as they are
            )
        return fit.fits_without[form.key]

    def _design(self, terms: Sequence[Term]) -> Design:
        """Assemble the design A of the model and of the terms, with A'A and A'y.

        The r columns of the model's basis come first, then those of the terms (effects
        and nuisances), scaled to unit length. The torque y is 0 in the prior rows.
        """
        model = self._model_basis
        n, M, r = model.columns.shape
        blocks, columns_by_text, n_prior_rows = self._columns_with_priors(terms)
        p = r + sum(_width(t) for t in terms)
        # Scale the terms' columns to unit length over all joints; the model's have it.
        energy = np.zeros(p)
        for numbers, columns in blocks:
            energy[numbers] += np.sum(columns**2, axis=0)
        scale = 1.0 / nonzero_or_one(np.sqrt(energy))
        G = np.zeros((n, p, p))
        G[:, :r, :r] = model.gram
        Ay = np.zeros((n, p))
        Ay[:, :r] = self._basis_products.with_torque
        y = np.zeros((n, len(blocks[0].columns)))
        y[:, :M] = self.data.y
        for j, (numbers, columns) in enumerate(blocks):
            columns *= scale[numbers]
            cross = model.columns[j].T @ columns[:M]
            G[j][:r, numbers] = cross
            G[j][numbers, :r] = cross.T
            G[j][np.ix_(numbers, numbers)] = columns.T @ columns
            Ay[j, numbers] = columns.T @ y[j]
        effects = [t for t in terms if isinstance(t, ScoredEffect)]
        key_of_column = {i: t.key for t in effects for i in columns_by_text[t.text]}
        return Design(
            basis_products=self._basis_products,
            terms_by_joint=blocks,
            y=y,
            gram=G,
            Ay=Ay,
            columns_of_model=model.columns_by_key,
            columns_by_text=columns_by_text,
            key_of_column=key_of_column,
            n_prior_rows=n_prior_rows,
        )

    def _columns_with_priors(
        self, terms: Sequence[Term]
    ) -> tuple[list[JointTerms], dict[str, list[int]], Array]:
        """Stack the columns of the terms by joint, with the priors of nuisances.

        The coefficient a of a nuisance (a small tolerated error) has a prior N(0, d^2).
        It enters as a prior row a / d = 0 behind the M rows of the log, on each joint
        that the nuisance acts on. Each of m such joints gets a / (d sqrt(m)) = 0, so
        that their squares add up to one prior.

        Returns
        -------
        list of JointTerms
            For each joint the columns that act there, not scaled, on as many rows.
        dict of str to list of int
            The numbers of each term's columns, by the term's text.
        (n,) array
            How many prior rows each joint counts: 1 / m of each that m joints share.
        """
        n, M, r = self._model_basis.columns.shape
        n_prior_rows, n_rows_counted = _count_prior_rows(terms, n)
        columns_by_text = dict[str, list[int]]()
        next_column = r
        for term in terms:
            width = _width(term)
            columns_by_text[term.text] = list(range(next_column, next_column + width))
            next_column += width
        n_rows = M + int(n_prior_rows.max(initial=0))
        blocks = []
        for j in range(n):
            on_joint = [t for t in terms if j in t.columns]
            numbers = [i for t in on_joint for i in columns_by_text[t.text]]
            columns = np.zeros((n_rows, len(numbers)))
            next_row = M  # the first prior row that is not used yet
            next_place = 0
            for term in on_joint:
                width = _width(term)
                columns[:M, next_place : next_place + width] = term.columns[j]
                if isinstance(term, Nuisance):
                    # One prior row a column: entry 1 / (d sqrt(m)).
                    steps = np.arange(width)
                    entries = 1.0 / term.deviations / len(term.columns) ** 0.5
                    columns[next_row + steps, next_place + steps] = entries
                    next_row += width
                next_place += width
            blocks.append(JointTerms(np.array(numbers, np.intp), columns))
        return blocks, columns_by_text, n_rows_counted

    def _fitted(
        self,
        design: Design,
        columns: tuple[int, ...],
        level: Array,
        rounds: int = 20,
    ) -> WhiteFit:
        """Estimate the coefficients and the joints' levels in turn, until these settle.

        A joint's level is the standard deviation of its residual; the rows of joint j
        are weighted by 1 / level_j. theta solves (sum_j A_j'A_j / level_j^2) theta =
        sum_j A_j'y_j / level_j^2, then level_j^2 = |y_j - A_j theta|^2 / rows.

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
        columns_kept = np.array(columns, int)
        among_kept = np.ix_(columns_kept, columns_kept)
        n, p = design.Ay.shape
        # Of all columns: a selection from each joint's Gram matrix would cost more.
        flat_gram = design.gram.reshape(n, -1)
        all_theta = np.zeros(p)  # zero for columns that take no part
        squares_of_torque = np.sum(design.y**2, axis=1)
        n_rows = self.data.count + design.n_prior_rows
        for _ in range(rounds):
            weighted_gram = (level**-2.0 @ flat_gram).reshape(p, p)
            weighted_Ay = level**-2.0 @ design.Ay
            L = _triangle(weighted_gram[among_kept])
            all_theta[columns_kept] = scipy.linalg.cho_solve(
                (L, True),
                weighted_Ay[columns_kept],
                check_finite=False,
            )
            rss = squares_of_torque - 2.0 * design.Ay @ all_theta
            rss += (design.gram @ all_theta) @ all_theta
            rss = np.maximum(rss, 0.0)  # rounding may make it negative
            level_of_fit = level
            level = np.sqrt(np.maximum(rss / n_rows, self.floor))
            if np.all(np.abs(level - level_of_fit) < 1e-2 * level):
                break
        # With the weighted Gram matrix L L', the columns A L^-T are orthonormal.
        L_inverse = scipy.linalg.solve_triangular(
            L,
            np.eye(len(L)),
            lower=True,
            check_finite=False,
        )
        W = np.zeros((p, len(columns_kept)))
        W[columns_kept] = L_inverse.T
        residual = design.y - design.times(all_theta[:, None])[:, :, 0]
        residual /= level_of_fit[:, None]
        # The trace of the joint's block of the projection on the fit's columns.
        covariance = np.zeros((p, p))
        covariance[among_kept] = L_inverse.T @ L_inverse
        rank_of_joint = flat_gram @ covariance.ravel() / level_of_fit**2
        return WhiteFit(
            design=design,
            columns_kept=columns,
            whitener=W,
            theta=all_theta,
            level=level_of_fit,
            residual=residual,
            rss=np.sum(residual**2, axis=1) * level_of_fit**2,
            degrees=np.maximum(n_rows - rank_of_joint, 1.0),
            floor=self.floor,
        )


def _width(term: Term) -> int:
    """Return the number k of columns of an effect or a nuisance, equal on all joints."""
    return next(iter(term.columns.values())).shape[1]


def _count_prior_rows(terms: Sequence[Term], n: int) -> tuple[NDArray[np.intp], Array]:
    """Count the prior rows of nuisances (small tolerated errors) on each of n joints.

    A nuisance has one prior row a column on each joint that it acts on; m such joints
    share one prior, so that each counts 1 / m of a row.

    Returns
    -------
    (n,) array
        The number of prior rows that a joint has.
    (n,) array
        The number that it counts, in degrees of freedom.
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

    The rank r comes from a pivoted QR of the columns' triangular factor R (p, p), which
    is small. The basis, columns R^-1, is orthogonalised a second time against rounding:
    twice is enough (Giraud et al. 2005).
    """
    norms = np.sqrt(np.einsum("mp,mp->p", columns, columns))
    is_nonzero = norms > 1e-12 * norms.max(initial=0.0)
    if not is_nonzero.any():
        return np.zeros((len(columns), 0))
    unit = columns[:, is_nonzero]
    unit /= norms[is_nonzero]
    triangle, order = scipy.linalg.qr(
        _triangular_factor(unit),
        mode="r",
        pivoting=True,
    )
    diagonal = np.abs(np.diagonal(triangle))
    rank = int(np.sum(diagonal > 1e-8 * diagonal[0]))
    basis = unit[:, order[:rank]]
    del unit  # of a long recording some ten megabytes
    basis = _times_inverse(basis, triangle[:rank, :rank])
    return _times_inverse(basis, _triangular_factor(basis))


def _triangular_factor(columns: Array) -> Array:
    """Return the factor R (p, p) of the QR decomposition of columns (N, p), by some
    thousand rows at a time; (N, p) where there are fewer rows than columns."""
    factor: Array = columns[:0]
    for start in range(0, len(columns), _ROWS_AT_A_TIME):
        rows = columns[start : start + _ROWS_AT_A_TIME]
        stacked = np.concatenate([factor, rows])
        factor = np.asarray(np.linalg.qr(stacked, mode="r"))
    return factor


def _times_inverse(columns: Array, triangle: Array) -> Array:
    """Return columns R^-1 (N, r) of columns (N, r) and a triangle R (r, r), in place of
    the columns."""
    transposed = scipy.linalg.solve_triangular(
        triangle,
        columns.T,
        trans="T",
        overwrite_b=True,
    )
    return np.ascontiguousarray(transposed.T)


def _unit(columns: Array) -> Array:
    """Scale columns (n joints, M, k) to unit length over all joints; zero columns stay."""
    return columns / nonzero_or_one(np.sqrt(np.sum(columns**2, axis=(0, 1))))


def _triangle(gram: Array) -> Array:
    """Return the lower Cholesky factor L (p, p) of a Gram matrix, with a small ridge.

    L L' = gram + DEPENDENT^2 diag(gram). The ridge keeps it positive where one column
    depends on others.
    """
    ridge = DEPENDENT**2 * nonzero_or_one(np.diagonal(gram))
    return np.asarray(np.linalg.cholesky(gram + np.diag(ridge)))


def with_ridge(A: Array) -> Array:
    """Add 1e-10 of the diagonal to positive matrices (..., k, k), against rounding.

    A zero on the diagonal becomes 1e-310, so that the matrix can be inverted.
    """
    diagonal = np.diagonal(A, axis1=-2, axis2=-1) + 1e-300
    return np.asarray(A + 1e-10 * diagonal[..., None] * np.eye(A.shape[-1]))


def bounded_least_squares(
    A: Array,
    Xy: Array,
    nonnegative: NDArray[np.bool_],
) -> Array:
    """Minimise b'A b / 2 - (X'y)'b, with some coefficients b not negative.

    Parameters
    ----------
    A
        (k, k) positive definite matrix, such as X'X.
    Xy
        (k,) the products X'y.
    nonnegative
        (k,) flags: which coefficients must be at least zero.

    Returns
    -------
    (k,) array
        The minimiser: A^-1 X'y if it satisfies the signs, otherwise that of
        non-negative least squares.
    """
    beta = np.linalg.solve(with_ridge(A), Xy)
    if not np.any(beta[nonnegative] < 0.0):
        return np.asarray(beta)
    if len(beta) == 1:
        return np.zeros(1)
    # With A = R'R, minimise |R b - R'^-1 X'y|^2. A coefficient of any sign is the
    # difference of two that are not negative: R has a second column for it.
    R = np.linalg.cholesky(with_ridge(A)).T
    target = np.linalg.solve(R.T, Xy)
    columns = np.hstack([R, -R[:, ~nonnegative]])
    solution = scipy.optimize.nnls(columns, target)[0]
    k = len(nonnegative)
    beta = solution[:k].copy()
    beta[~nonnegative] -= solution[k:]
    return np.asarray(beta)
