"""The score against plain least squares, and what it promises."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from small_runs import small_run

from sdp_vs_penalty import identify
from sdp_vs_penalty.diagnosis import (
    COARSENING_ROWS,
    EVIDENCE_TO_DISTINGUISH,
    LAW_TOLERANCE,
    Batch,
    Candidate,
    ColumnProducts,
    CurveColumns,
    EvidenceScorer,
    Nuisance,
    Search,
    diagnosis_rows,
    list_candidates,
    sizes_with_intervals,
    white_candidate,
    whiten_rows,
)

n = 2
M = 300
p = 5


def form(k=1, lower=-np.inf, name="made"):
    effect = SimpleNamespace(
        parameters=[SimpleNamespace(lower=lower)] * k,
        plausible=None,
        searched=(),
        shapes={},
        text=name,
    )
    return Candidate((name, 0), effect)


def made(seed=0, size=0.0):
    """Rows of two joints with a model of five columns, and a column z of joint 1 that
    makes ``size``."""
    rng = np.random.default_rng(seed)
    X = rng.normal(size=(n, M, p))
    z = rng.normal(size=M)
    y = X @ rng.normal(size=p) + rng.normal(size=(n, M))
    y[0] += size * z
    clusters = (np.arange(M) // 10, np.arange(M) % 30)
    data = SimpleNamespace(
        X=X,
        y=y,
        n=n,
        clusters=clusters,
        count=np.full(n, float(M)),
        noise_is_known=True,
    )
    data.own_effects = {}
    data.signed_effects = {}
    return data, z[:, None]


def plain(data, fit, z=None, drop=()):
    """(n, M) what least squares leave of weighted rows."""
    A = np.delete(data.X, drop, axis=2)
    if z is not None:
        own = np.zeros((n, M, z.shape[1]))
        own[0] = z
        A = np.concatenate([A, own], axis=2)
    A = A / fit.level[:, None, None]
    y = data.y / fit.level[:, None]
    flat = A.reshape(n * M, -1)
    return y - (flat @ np.linalg.lstsq(flat, y.ravel(), rcond=None)[0]).reshape(n, M)


@pytest.mark.parametrize("n_own", [p, 0], ids=["free", "fixed"])
def test_a_fit_is_least_squares_on_weighted_rows(n_own):
    """Beside a fixed model it has no columns but those of effects."""
    data, z = made(size=1.0)
    data.X = data.X[:, :, :n_own]
    score = EvidenceScorer(data, 10)
    fit = score.fit(())
    np.testing.assert_allclose(fit.residual, plain(data, fit), atol=1e-9)
    both = score.fit([score.evidence_of(fit, form(), {0: z})])
    np.testing.assert_allclose(both.residual, plain(data, both, z), atol=1e-9)
    assert np.sum(both.degrees) == pytest.approx(n * M - n_own - 1, abs=1e-6)


def test_the_score_is_the_coarsened_drop_less_its_price():
    data, z = made(size=1.0)
    score = EvidenceScorer(data, 50)
    fit = score.fit(())
    term = score.evidence_of(fit, form(), {0: z})
    left = plain(data, fit, z)
    drop = fit.deviance(fit.rss) - fit.deviance(np.sum(left**2, axis=1) * fit.level**2)
    assert term.beta[0] == pytest.approx(1.0, abs=0.2)
    # It makes no more torque than there is: a prior that is worth a part of one row.
    drop -= float(term.beta[0] ** 2 * np.sum(z**2) / np.sum(data.y[0] ** 2))
    T = fit.residual_of(fit.scaled({0: z}))[:, :, 0]
    sums = [np.bincount(c, np.sum(T * left, axis=0)) for c in data.clusters]
    v = (
        max(1.0, *(float(s @ s) / np.sum(T**2) for s in sums))
        + fit.degrees[0] / COARSENING_ROWS
    )
    expected = drop / v - np.log(fit.degrees[0] / v) - 2.0 * np.log(50)
    assert pytest.approx(expected, rel=1e-2) == term.evidence


def test_the_odds_of_a_candidate_are_those_of_its_laws_together():
    data, z = made(size=0.3)
    one = EvidenceScorer(data, 10)
    four = EvidenceScorer(data, 10, {("made", 0): 4, ("other", 0): 9})
    J = [
        score.evidence_of(score.fit(()), form(), {0: z}).evidence
        for score in (one, four)
    ]
    assert J[0] - J[1] == pytest.approx(2.0 * np.log(4.0))


def test_a_coefficient_that_its_sign_holds_at_zero_has_no_price():
    data, z = made(size=1.0)
    score = EvidenceScorer(data, 10)
    other = np.random.default_rng(1).normal(size=(M, 1))
    both = {0: np.hstack([z, other])}
    fit = score.fit(())
    if score.evidence_of(fit, form(2), both).beta[1] > 0.0:
        both = {0: np.hstack([z, -other])}
    held = score.evidence_of(fit, form(2, 0.0), both)
    alone = score.evidence_of(fit, form(1, 0.0), {0: z})
    assert held.beta.tolist() == [pytest.approx(alone.beta[0]), 0.0]
    price = alone.evidence - score.evidence_of(fit, form(2), both).evidence
    assert abs(alone.evidence - held.evidence) < 0.2 * price


def test_noise_is_not_taken_for_an_effect():
    rng = np.random.default_rng(1)
    highest = []
    for seed in range(20):
        data, _ = made(seed)
        score = EvidenceScorer(data, 100)
        fit = score.fit(())
        terms = [
            score.evidence_of(fit, form(), {0: rng.normal(size=(M, 1))})
            for _ in range(100)
        ]
        highest.append(max(t.evidence for t in terms))
    assert max(highest) < 0.0


def test_a_misfit_is_noise_that_its_columns_make():
    """Beside it a form is judged by generalised least squares with the covariance I + D
    diag(d)^2 D'."""
    data, z = made(size=0.2)
    data.y = (
        0.5 * data.y
    )  # less than the noise that is known: every row counts as it is
    rng = np.random.default_rng(3)
    D = np.zeros((n * M, 4))
    d = np.array([0.05, 0.2, 0.02, 0.3])
    D[:M] = rng.normal(size=(M, 4)) + z
    score = EvidenceScorer(data, 10)
    z = np.vstack([z, 0.0 * z])
    fit = score.fit([Nuisance("misfit", {0: D[:M]}, d)])
    term = score.evidence_of(fit, form(), {0: z[:M]})
    root = np.linalg.cholesky(np.linalg.inv(np.eye(n * M) + (D * d**2) @ D.T)).T
    X = root @ data.X.reshape(n * M, p)
    y = root @ data.y.ravel()

    def left(A):
        return float(np.sum((y - A @ np.linalg.lstsq(A, y, rcond=None)[0]) ** 2))

    assert fit.rss.sum() == pytest.approx(left(X), rel=1e-9)
    with_form = left(np.column_stack([X, root @ z]))
    assert term.drop == pytest.approx(
        left(X) - with_form, rel=1e-2
    )  # but for its prior
    alone = score.evidence_of(score.fit(()), form(), {0: z[:M]})
    assert alone.drop > 2.0 * term.drop > 0.0


@pytest.fixture(scope="module")
def white(two_link):
    """Rows of a clean run, all candidates on them, and what is said meanwhile."""
    run = small_run(two_link, seed=2)
    estimate = identify(two_link, run, "ols", check=False)
    settings = estimate.preprocessing.resolve(run)
    data = whiten_rows(diagnosis_rows(run, estimate, settings), estimate)
    said = []
    return data, list_candidates(data, said.append), said


@pytest.fixture
def search(white):
    """A search that has not begun."""
    return Search(*white[:2])


def terms(search, name="", joint=0):
    """The candidates of an effect on a joint, or all first ones of a batch, scored."""
    forms = [
        f for b in search.library.batches for f in (b.forms if name else b.forms[:2])
    ]
    return [
        search.evidence_of(search.fit, f)
        for f in forms
        if not f.replaces_own_constant and (not name or f.key == (name, joint))
    ]


def test_what_a_law_gets_wrong_is_a_share_of_what_it_makes(search):
    """Beyond the model, on each joint, as the misfits' deviations expect it: FORM of
    its squares."""
    term = max(
        (t for t in terms(search) if t.form.n_constants), key=lambda t: t.squares.sum()
    )
    misfits = search.nuisances.law_misfits(term)
    assert [j for m in misfits for j in m.columns] == sorted(term.joints)
    for m in misfits:
        T = (
            search.bare.residual_of(search.bare.scaled(m.columns))
            * search.bare.level[:, None, None]
        )
        expected = np.sum(np.sum(T**2, axis=(0, 1)) * m.deviations**2)
        (joint,) = m.columns
        assert expected == pytest.approx(LAW_TOLERANCE * term.squares[joint], rel=1e-6)
    assert search.nuisances.with_law_misfits([term]) == [
        term
    ]  # what explains little is wrong by less than a rival
    much = replace(
        term,
        drop=1.0
        + term.rows_worth_one * (EVIDENCE_TO_DISTINGUISH / LAW_TOLERANCE + term.price),
    )
    assert len(search.nuisances.with_law_misfits([much])) > 1


def test_a_candidate_that_does_not_stay_leaves_the_others_as_they_were(
    search, monkeypatch
):
    first, *_, last = terms(search)
    stays, goes = replace(first, drop=1e6), replace(last, drop=1e6)
    steps = {
        "top_candidates": lambda *_: [] if search.refused else [goes],
        "beside_each_other": lambda: search.terms,
        "drop_weak": lambda _: [],
    }
    for name, step in steps.items():
        monkeypatch.setattr(search, name, step)
    search.terms = [stays]
    assert search.run() == [stays]
    assert search.refused == {goes.key}


def test_squared_errors_from_products_are_those_of_the_rows(search):
    batch = search.library.batches[0]
    scaled = search.fit.scaled(batch.columns(0))
    products = ColumnProducts.from_columns(search.fit, scaled)
    beta = np.full(batch.forms[0].n_coefficients, 0.3)
    residual = search.fit.residual - search.fit.residual_of(scaled) @ beta
    of_rows = np.sum(residual**2, axis=1) * search.fit.level**2
    np.testing.assert_allclose(products.rss_with(beta), of_rows, rtol=1e-6)


def test_parameters_beyond_those_of_any_model_contradict_themselves(search):
    (term,) = terms(search, "joint_spring")
    assert not search.contradicts_itself(term)
    assert search.contradicts_itself(replace(term, beta=np.array([6e9])))


def test_a_law_is_as_uncertain_after_many_rows_as_its_tolerated_error(search):
    """Another value of its constant that loses an eighth of 4 % of its drop (it has
    eight misfits) moves the size by one standard deviation."""
    term = max(terms(search, "power_law_friction"), key=lambda t: t.drop)
    search.terms = [term]
    data = search.data
    errors = data.constant_error_columns([term.form.effect], [term.beta])
    nothing_else = np.zeros((data.n, len(data.rows.t), 0))
    (known,) = sizes_with_intervals(search, nothing_else, errors)
    std = np.sqrt(known.covariance_of_law[0, 0])
    # The constant's derivative, beyond the model and the friction itself.
    fit = search.score.fit(())
    ((derivative, columns),) = [e for e in errors if e[0].effect is term.form.effect]
    friction = fit.residual_of(fit.scaled(term.columns))[0]
    by_constant = fit.residual_of(fit.scaled(columns))[0]
    share = float(np.vdot(friction, by_constant) / np.vdot(friction, friction))
    lost = np.sum((by_constant - share * friction) ** 2)
    lost += 1.0  # by the constant's prior, a standard normal
    moved = np.sqrt(LAW_TOLERANCE / 8 * term.drop / lost)
    assert derivative.keys == ("alpha",)
    assert std == pytest.approx(abs(share) * moved, rel=0.2)
    assert known.std_of_law(term.form.effect) <= 0.5 * abs(term.beta[0])


def test_a_drop_beside_another_fit_is_that_of_the_whole_score(search):
    (spring,) = terms(search, "joint_spring")
    beside = search.score.fit(terms(search, "torque_gain", 1))
    quick = search.score.with_drop_beside(beside, spring)
    full = search.score.evidence_of(beside, spring.form, spring.columns)
    assert quick.drop == pytest.approx(full.drop)
    np.testing.assert_allclose(quick.beta, full.beta)
    np.testing.assert_allclose(quick.squares, full.squares)
    assert quick.rows_worth_one == spring.rows_worth_one


@pytest.mark.parametrize("size", [1e160, np.inf, np.nan])
def test_columns_without_bound_are_no_candidate(size):
    columns = np.array([[1.0], [size]])
    data = SimpleNamespace(
        rows=SimpleNamespace(
            blocks=lambda *_, **__: [SimpleNamespace(joint=0, columns=columns)]
        ),
        white=lambda x, _: x,
    )
    assert not white_candidate(data, form())[0].any()


def test_a_shape_constant_is_where_it_explains_most(search, monkeypatch):
    """Whatever the rows are found to be worth there: that is as uncertain as the
    evidence is."""
    first, *others = terms(search, "sigmoid_friction")
    refined = search.refined(search.fit, first)
    law = first.form.discrete_choice
    assert refined.drop >= max(t.drop for t in others if t.form.discrete_choice == law)
    rng = np.random.default_rng(0)
    monkeypatch.setattr(
        EvidenceScorer, "rows_worth_one", lambda *_: rng.uniform(1.0, 3.0)
    )
    again = search.evidence_of(search.fit, first.form)
    assert search.refined(search.fit, again).text == refined.text


def test_what_the_model_makes_itself_is_no_candidate():
    data, _ = made()
    score = EvidenceScorer(data, 10)
    fit = score.fit(())
    columns = {j: data.X[j][:, :1] for j in range(n)}
    assert np.isneginf(score.evidence_of(fit, form(), columns).evidence)
    batch = Batch((0, 1), (form(),), np.stack([columns[0], columns[1]]))
    assert score.absorbed(fit, batch)[0] == pytest.approx(1.0)


def test_another_constant_of_the_models_own_effect_stands_in_its_place():
    data, z = made(size=1.0)
    data.X[1, :, 4], key = 0.0, ("own", 0)
    data.own_effects = {key: (form().effect, 4)}
    score = EvidenceScorer(data, 10)
    own = replace(form(), key=key, replaces_own_constant=True)
    fit = score.fit(())
    np.testing.assert_allclose(fit.residual, plain(data, fit), atol=1e-9)
    data.y[0] -= (
        data.X[0, :, 4] * np.linalg.lstsq(data.X[0], data.y[0], rcond=None)[0][4]
    )
    score = EvidenceScorer(data, 10)
    fit = score.fit(())
    term = score.evidence_of(fit, own, {0: z})
    left = plain(data, fit, z, drop=(4,))
    without = score.without(fit, own)
    drop = without.deviance(fit.rss) - without.deviance(
        np.sum(left**2, axis=1) * fit.level**2
    )
    assert pytest.approx(drop - np.log(M) - 2.0 * np.log(10), rel=0.1) == term.evidence
    both = score.fit([term])
    np.testing.assert_allclose(
        both.residual, plain(data, both, z, drop=(4,)), atol=1e-9
    )
    batch = Batch((0,), (own,), z[None])
    exact = np.sum(fit.residual**2) - np.sum(left**2)
    assert score.screened(fit, batch)[0] == pytest.approx(
        exact - np.log(without.degrees[0]), rel=1e-2
    )
    noise = np.random.default_rng(5).normal(size=(M, 1))
    assert score.evidence_of(fit, own, {0: noise}).evidence < 0.0


def test_rows_that_err_together_are_worth_less_unless_it_is_not_asked():
    data, z = made()
    z, errors = np.repeat(
        np.random.default_rng(6).normal(size=(2, M // 10)), 10, axis=1
    )  # by clusters
    data.y[0] += 2.0 * errors
    fit = (score := EvidenceScorer(data, 10)).fit(())
    robust = CurveColumns.from_columns(score, fit, z[:, None], 0, robust=True)
    plainly = CurveColumns.from_columns(score, fit, z[:, None], 0, robust=False)
    assert plainly.rows_worth_one == pytest.approx(
        1.0 + plainly.degrees / COARSENING_ROWS
    )
    assert robust.rows_worth_one > 2.0 * plainly.rows_worth_one
