"""Fits with columns more: what is kept of each column makes the same products as all rows do."""

from __future__ import annotations

import numpy as np
import pytest

from sdp_vs_penalty.diagnosis.coloured import Coloured
from sdp_vs_penalty.diagnosis.extension import factored, products
from sdp_vs_penalty.diagnosis.fit import RowLabels, Weighting, WhiteFit, orthonormal
from sdp_vs_penalty.diagnosis.library import Library, grams
from sdp_vs_penalty.signals.autoregression import ORDER, Pieces

n, M = 2, 300


def fitted(rng: np.random.Generator) -> tuple[WhiteFit, Library]:
    rows = RowLabels(n, np.arange(M) // 10, np.arange(M) // 100, np.full(n, float(M)))
    weighting = Weighting(np.array([0.5, 2.0]), np.zeros((n, ORDER)), (Pieces(()),) * n)
    joints = tuple(rng.normal(size=(M, 4)) for _ in range(n))
    several = rng.normal(size=(n, M, 3))
    parts = tuple(np.hstack(pair) for pair in zip(joints, several, strict=True))
    library = Library((), parts, tuple(Z.shape[1] for Z in joints), ())
    basis = orthonormal(rng.normal(size=(n * M, 5)))
    return Coloured.of(basis, rng.normal(size=n * M), weighting).fit(rows, weighting), library


@pytest.mark.parametrize("apart", [1.0, 1e-3, 1e-6])
def test_products_of_an_extended_fit_need_no_rows(apart: float) -> None:
    """However close the columns are to each other, and whichever of them are in."""
    rng = np.random.default_rng(3)
    fit, library = fitted(rng)
    one = rng.normal(size=(n * M, 1))
    columns = [one, one + apart * rng.normal(size=(n * M, 1)), rng.normal(size=(n * M, 2))]
    for chosen in (columns, columns[1:], [columns[2], columns[0]], columns[:1]):
        more = fit.extended(*chosen)
        np.testing.assert_allclose(more.Q.T @ more.Q, np.eye(more.Q.shape[1]), atol=1e-9)
        np.testing.assert_allclose(more.Q.T @ more.residual, 0.0, atol=1e-8)
        for joint in (0, 1, None):
            np.testing.assert_allclose(
                more.overlaps(library, joint), products(more.Q, library, joint), atol=1e-8
            )
            pulls = products(more.residual[:, None], library, joint)[..., 0, :]
            np.testing.assert_allclose(more.pulls(library, joint), pulls, atol=1e-7)
        np.testing.assert_allclose(
            np.trace(more.joint_products[0], axis1=1, axis2=2), fit.rows.count - more.degrees
        )


def test_what_is_there_already_adds_nothing() -> None:
    rng = np.random.default_rng(4)
    fit, _ = fitted(rng)
    one = rng.normal(size=(n * M, 1))
    known = fit.Q[:, :1] * np.repeat(fit.weighting.level, M)[:, None]
    assert fit.extended(one, 3.0 * one, known, np.zeros((n * M, 1))).Q.shape[1] == fit.Q.shape[1] + 1


def test_a_triangle_makes_its_columns_again() -> None:
    rng = np.random.default_rng(5)
    one, many = rng.normal(size=(50, 1)), rng.normal(size=(50, 4))
    close = np.hstack([one, one + 1e-7 * rng.normal(size=(50, 1)), many])
    for columns in (many, close, np.zeros((50, 0))):
        q, r, kept = factored(columns, np.full(columns.shape[1], 1e-9))
        assert len(kept) == columns.shape[1]
        np.testing.assert_allclose(q @ r, columns, atol=1e-12)
        np.testing.assert_allclose(q.T @ q, np.eye(len(kept)), atol=1e-12)
        np.testing.assert_allclose(np.tril(r, -1), 0.0)
    # Whatever those before leave little of is left out, and only that.
    double = np.hstack([one, 2.0 * one, many, many[:, :1] + one, np.zeros((50, 1))])
    q, r, kept = factored(double, np.full(double.shape[1], 1e-9))
    np.testing.assert_array_equal(kept, [0, 2, 3, 4, 5])
    np.testing.assert_allclose(q @ r, double[:, kept], atol=1e-12)


def test_a_triangle_of_each_joint_leaves_the_same_errors() -> None:
    rng = np.random.default_rng(6)
    fit, _ = fitted(rng)
    pieces = (Pieces((np.arange(M),)),) * n
    colour = np.array([[0.4, 0.1, 0.0, 0.0], np.zeros(ORDER)])
    one = np.zeros((n * M, 2))
    one[M:] = rng.normal(size=(M, 2))
    columns = [one, rng.normal(size=(n * M, 1)), one[:, :1] * 3.0]
    coloured = Coloured.of(fit.Q, fit.target, Weighting(np.ones(n), colour, pieces))
    for level in ([1.0, 1.0], [0.3, 7.0]):
        weighting = Weighting(np.array(level), colour, pieces)
        few = coloured.compressed(fit.rows, columns, weighting)
        whole = coloured.fit(fit.rows, weighting).extended(*columns)
        assert few is not None
        assert len(few.target) < len(whole.target) / 3
        np.testing.assert_allclose(few.joint_chi2, whole.joint_chi2, rtol=1e-10)
        np.testing.assert_allclose(few.degrees, whole.degrees, rtol=1e-10)
    assert coloured.compressed(fit.rows, [rng.normal(size=(n * M, M))], weighting) is None


def test_a_frozen_model_has_no_columns_that_groups_could_share() -> None:
    np.testing.assert_array_equal(grams(np.zeros((0, 6)), 3), np.zeros((3, 2, 2)))
