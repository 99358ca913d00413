"""What is logged late is all of the torque, not the model's part alone.

Torque channels pass what everything else makes. So where something makes torque late,
columns refer to a model beside the findings, and to the findings' torque.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.diagnosis.library import Candidate, Key
from sdp_vs_penalty.diagnosis.refit import least_squares_refit
from sdp_vs_penalty.diagnosis.search import Search
from sdp_vs_penalty.diagnosis.white_rows import whitened, with_estimate
from sdp_vs_penalty.effects.effect import Effect
from sdp_vs_penalty.estimation.estimate import Estimate
from sdp_vs_penalty.estimators.estimator import Progress, no_progress
from sdp_vs_penalty.robot.arrays import Array


def refer_columns_to_current_model(
    search: Search, progress: Progress = no_progress
) -> Search:
    """Where a term or the model makes torque late (a delay, a filter), columns that refer
    to the model are made anew: of its parameters beside the findings, and of the
    findings' torque. The search goes on from there, until it ends with findings that it
    has had before: steps of Gauss and Newton.
    """
    before = list[set[Key]]()
    if search.terms and not delays_torque(search):
        search = look_for_delays(search, progress)
    while delays_torque(search):
        keys = {t.key for t in search.terms}
        if keys in before:
            break
        before.append(keys)
        search = refer_once(search)
        search.library = search.library.with_current_columns(search.data)
        search.terms = search.drop_weak(search.terms, frozenset(range(search.data.n)))
        search.run(progress)
    return search


def look_for_delays(search: Search, progress: Progress = no_progress) -> Search:
    """The search goes on where a delay shows in torque of which the findings are a part.

    A causal filter beside friction that turns round over a travel does not show in the
    torque of a model whose friction turns at once: what it delays is another torque.
    """
    referred = refer_once(search)
    referred.library = search.library.only(_delays, referred.data)
    if referred.best_addition() is None:
        return search
    referred.library = search.library.with_current_columns(referred.data)
    referred.run(progress)
    return referred


def _is_delay(effect: Effect) -> bool:
    """Whether it makes torque late."""
    return effect.needs_torque and effect.has_memory


def _delays(form: Candidate) -> bool:
    """Whether a candidate makes torque late."""
    return _is_delay(form.effect)


def delays_torque(search: Search) -> bool:
    """Whether something makes torque late, a term or the model: all of it, also what
    terms make."""
    effects = [t.form.effect for t in search.terms]
    effects += search.data.estimate.model.effects
    is_late = any(map(_is_delay, effects))
    return bool(search.terms) and is_late


def refer_once(search: Search) -> Search:
    """The same findings in columns that refer to the model beside them: to its
    parameters there, and to their torque.

    Fitted without them it has taken a part of that; of play in a gear 14 % of the size
    were left out.
    """
    data = search.data
    theta = least_squares_refit(data, [t.form.effect for t in search.terms])[0]
    widths = [t.form.n_coefficients for t in search.terms]
    ends = data.raw.shape[2] + np.cumsum([0, *widths])
    own_theta, *thetas = np.split(theta, ends[:-1])
    estimate = data.estimate
    if not data.frozen:
        estimate = replace(estimate, theta=own_theta)
    return beside_model(search, estimate, thetas=thetas)


def beside_model(
    search: Search,
    estimate: Estimate,
    without: NDArray[np.bool_] | None = None,
    thetas: Sequence[Array] = (),
) -> Search:
    """The same findings beside another model, in the columns that this one makes.

    without : rows (M, n) that are no evidence; thetas : the terms' parameters beside it,
    if not those of the search.
    """
    data = search.data
    pairs = zip(
        search.terms,
        thetas or [t.beta for t in search.terms],
        strict=True,
    )
    with_torque = [(t, b) for t, b in pairs if not t.form.effect.needs_torque]
    others = [(t.form.effect, b) for t, b in with_torque]
    rows = with_estimate(data.rows, estimate, others)
    if without is not None:
        masked = rows.masked | without if rows.masked.size else without
        rows = replace(rows, masked=masked)
    data = whitened(rows, data.noise, estimate, data.frozen)
    out = Search(data, search.library, search.rules, like=search)
    out.nuisances.frequencies = search.nuisances.frequencies
    out.in_reference = {t.key for t, _ in with_torque}
    out.terms = [replace(t, columns=data.columns(t.form.effect)) for t in search.terms]
    out.fit = out.score.fit(out.terms)
    return out
