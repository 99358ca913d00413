"""The model with other constants of its own shapes, and a search carried on beside it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.diagnosis.remaining import refitted
from sdp_vs_penalty.diagnosis.score import Term
from sdp_vs_penalty.diagnosis.search import Search
from sdp_vs_penalty.diagnosis.whitening import whitened, with_estimate
from sdp_vs_penalty.estimation.estimate import Estimate
from sdp_vs_penalty.estimation.shapes import ShapeEstimate, with_shapes
from sdp_vs_penalty.estimators.estimator import make_task
from sdp_vs_penalty.regression.regression import compress

#: Steps in which a model and the columns that refer to it are made to agree.
_TURNS = 2


def adopted(estimate: Estimate, shapes: Sequence[ShapeEstimate], measurements: Measurements) -> Estimate:
    """The model with other shape constants, refitted by least squares."""
    model = replace(estimate.model, effects=with_shapes(estimate.model.effects, shapes))
    regression = compress(measurements, model, estimate.preprocessing)
    theta = make_task(estimate.problem, model, regression, estimate.weighting).ols
    return replace(estimate, model=model, theta=theta)


def referred(search: Search, estimate: Estimate) -> tuple[Estimate, Search]:
    """Where columns refer to the model: that with the parameters that it has beside the findings, and
    these carried on (steps of Gauss and Newton). Fitted without them it has taken a part of their
    torque; of play in a gear 14 % of the size were left out."""
    for _ in range(_TURNS):
        effects = [t.form.effect for t in search.terms]
        if search.data.frozen or not any(e.needs_torque or e.needs_links for e in effects):
            break
        theta = refitted(search.data, effects)[0][: len(estimate.theta)]
        estimate = replace(estimate, theta=theta)
        search = carried(search, estimate)
    return estimate, search


def carried(search: Search, estimate: Estimate) -> Search:
    """The same findings beside another model, in the columns that this one makes."""
    data = search.data
    rows = with_estimate(data.rows, estimate)
    data = whitened(rows, data.noise, estimate, data.frozen)
    named = [t for t in search.terms if not t.form.own]
    out = Search(data, replace(search.library, own=()))
    out.terms = [
        Term(t.form, data.columns(t.form.effect), t.J, t.beta, t.covariance, t.rivals) for t in named
    ]
    out.fit = out.score.fit(out.terms)
    return out


def limited(search: Search, terms: Sequence[Term], least: float = -np.inf) -> Search:
    """The search with some of its terms only, each judged beside those; the worst goes while it has less
    than ``least``."""
    out = Search(search.data, search.library)
    while True:
        fit = out.score.fit(terms)
        found = []
        for t in terms:
            others = out.score.fit([x for x in terms if x != t], fit.level)
            found.append(replace(out.score.judged(others, t.form, t.columns), rivals=t.rivals))
        worst = min(range(len(found)), key=lambda k: found[k].J, default=None)
        if worst is None or least <= found[worst].J:
            break
        terms = [t for k, t in enumerate(terms) if k != worst]
    out.terms, out.fit = found, fit
    return out


def in_order(terms: Sequence[Term]) -> list[Term]:
    """Those that explain most first; a finer form of an effect comes after the plainer."""
    out = sorted(terms, key=lambda t: -t.J)
    for term in list(out):
        place = out.index(term)
        plainer = [k for k, t in enumerate(out) if term.form.refines(t.form)]
        if plainer and max(plainer) > place:
            out.insert(max(plainer), out.pop(place))
    return out
