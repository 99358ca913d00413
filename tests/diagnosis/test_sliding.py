"""Sizes that the rows in which a joint slides contradict."""

from types import SimpleNamespace

import numpy as np
import pytest

from sdp_vs_penalty.diagnosis.sliding import contradicted_by_sliding


@pytest.mark.parametrize(
    ("acts", "is_dry_friction", "contradicted"),
    [
        ("everywhere", False, False),
        ("where it sticks", False, True),
        ("where it slides", False, True),
        ("where it sticks", True, True),
        # Friction that sticks looks like anything that slow rows alone show, but for a
        # law of this friction.
        ("only slow rows have it", False, True),
        ("only slow rows have it", True, False),
    ],
)
def test_what_acts_where_a_joint_sticks_alone_is_contradicted(
    acts, is_dry_friction, contradicted
):
    rng = np.random.default_rng(0)
    M = 2_000
    is_slow = np.arange(M) % 100 < 30
    column = rng.normal(size=M)
    if acts == "only slow rows have it":
        column = np.where(is_slow, column, 0.0)
    acts_in = {"where it sticks": is_slow, "where it slides": ~is_slow}
    torque = np.where(acts_in.get(acts, True), 3.0 * column, 0.0)
    y = torque + rng.normal(size=M)
    A = np.column_stack([rng.normal(size=M), column])
    L = np.linalg.cholesky(A.T @ A)
    whitener = np.linalg.inv(L).T
    theta = whitener @ (whitener.T @ (A.T @ y))
    fit = SimpleNamespace(
        basis=(A @ whitener)[None],
        residual=(y - A @ theta)[None],
        precision=np.zeros((2, 2)),
        whitener=whitener,
        theta=theta,
        design=SimpleNamespace(columns_by_text={"effect": [1]}),
    )
    rows = SimpleNamespace(keep=np.ones((M, 1), bool), slides=~is_slow[:, None])
    clusters = (np.arange(M) // 40, np.arange(M) // 40)
    data = SimpleNamespace(rows=rows, clusters=clusters)
    form = SimpleNamespace(effect=SimpleNamespace(is_dry_friction=is_dry_friction))
    terms = [SimpleNamespace(text="effect", price=10.0, form=form)]
    assert contradicted_by_sliding(data, fit, terms) == [contradicted]
