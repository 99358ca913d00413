"""What a joint's dry friction holds where it stands or turns round, and how little such
rows say of anything else.

Dry friction that sticks holds any torque up to its limit, and no law of sliding is right
to the last row. So effects are searched in the rows in which the joints slide. Then all
rows count, each as much as what is found explains it: a row in which a joint is slow has
the variance that is left in such rows beyond that of sliding ones. Laws of dry friction
alone are searched there.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sdp_vs_penalty.diagnosis.library import Batch, Candidate
from sdp_vs_penalty.diagnosis.refit import least_squares_refit
from sdp_vs_penalty.diagnosis.search import Search
from sdp_vs_penalty.diagnosis.white_rows import WhiteData, count_of_rows
from sdp_vs_penalty.estimators.estimator import Progress, no_progress
from sdp_vs_penalty.robot.arrays import Array, Mask, nonzero_or_one

#: Share of a row that comes from a slow joint, from which it tells what friction holds.
_MOSTLY = 0.5
#: Fewest sliding rows of a joint that a search can do with.
_FEWEST = 60
#: Standard deviation of a row that says nothing, over the joint's largest torque.
_NOTHING = 1e3
#: Most times that what friction holds is estimated anew.
_ROUNDS = 3
#: Relative change of it that matters.
_SETTLED = 0.2


def where_joints_slide(data: WhiteData) -> WhiteData:
    """Return rows of which those say nothing in which a joint stands or turns round.

    A joint with too few rows in which it slides keeps all.
    """
    rows = data.rows
    slides = rows.keep & rows.slides
    has_enough = slides.sum(axis=0) >= _FEWEST
    nothing = _NOTHING * np.abs(rows.torque).max(axis=0)
    return holding(data, ~rows.slides * (has_enough * nothing))


def holding(data: WhiteData, held: Array) -> WhiteData:
    """Return white rows with another torque that friction may hold, (M, n) standard
    deviations [N m or N]."""
    noise = replace(data.noise, held=held)
    factor = (data.noise.scale / noise.scale).T  # (n, M)
    return replace(
        data,
        noise=noise,
        X=data.X * factor[:, :, None],
        y=data.y * factor,
        count=count_of_rows(data.rows, noise),
    )


def scaled(search: Search, data: WhiteData) -> Search:
    """Return a search with the same effects on the same rows, weighted otherwise."""
    factor = (search.data.noise.scale / data.noise.scale).T  # (n, M)

    def of_batch(batch: Batch) -> Batch:
        """Weight the columns of a batch."""
        columns = batch.whitened_columns * factor[list(batch.joints), :, None]
        return replace(batch, whitened_columns=columns)

    library = replace(
        search.library, batches=tuple(map(of_batch, search.library.batches))
    )
    out = Search(data, library)
    out.barred = {*search.barred}
    out.terms = [
        replace(t, columns={j: z * factor[j][:, None] for j, z in t.columns.items()})
        for t in search.terms
    ]
    out.fit = out.score.fit(out.terms)
    return out


def is_friction(form: Candidate) -> bool:
    """Return whether a candidate is a law of friction that may show where a joint turns
    round alone, or another constant of the model's own."""
    return form.replaces_own_constant or form.effect.is_finer_friction


def held_beside(search: Search, still: Array) -> Array:
    """Return what friction holds beside the findings, (M, n) standard deviations [N m or
    N], at least ``still``."""
    rows = search.data.rows
    _, residual = least_squares_refit(
        search.data, [t.form.effect for t in search.terms]
    )
    share = np.minimum(rows.slow, 1.0)
    held = still.copy()
    for j in range(rows.n):
        keep = rows.keep[:, j]
        turns = keep & (share[:, j] > _MOSTLY)
        slides = keep & rows.slides[:, j]
        if turns.any() and slides.sum() >= _FEWEST:
            squares = residual[:, j] ** 2
            excess = max(float(squares[turns].mean() - squares[slides].mean()), 0.0)
            held[:, j] = np.maximum(held[:, j], excess**0.5 * share[:, j])
    return held


def turning_weights(search: Search) -> Array:
    """Return the weights (n,) of rows in which a joint stands or turns round, by which a
    model is fitted: their share of the error of sliding rows.

    Where their error is at most twice that of sliding rows, they weigh as much.
    """
    _, residual = least_squares_refit(
        search.data, [t.form.effect for t in search.terms]
    )
    rows = search.data.rows
    turns = rows.keep & (rows.slow > _MOSTLY)
    slides = rows.keep & rows.slides

    def error(which: Mask) -> Array:
        """Return the RMS residual (n,) of some rows."""
        squares = np.sum(residual**2, axis=0, where=which)
        return np.asarray(np.sqrt(squares / np.maximum(which.sum(axis=0), 1)))

    enough = (slides.sum(axis=0) >= _FEWEST) & turns.any(axis=0)
    acted_on = {joint for term in search.terms for joint in term.joints}
    enough &= np.isin(np.arange(rows.n), [*acted_on])
    weights = error(slides) / nonzero_or_one(error(turns))
    return np.where(enough & (weights < 0.5), weights, 1.0)


def search_where_joints_turn(
    search: Search, still: Array, progress: Progress = no_progress
) -> Search:
    """Continue a search of sliding rows on all rows, each by what it tells.

    Laws of friction come first. Then what friction holds is estimated beside what is
    found, until that changes no more. A law of sliding that only rows show in which a
    joint turns round has to explain them: what explains them in part stands in for
    friction that sticks. Laws of friction at rest are of such rows alone.

    Parameters
    ----------
    still
        (M, n) what friction holds while a joint stands still [N m or N].
    progress
        Called with a short text whenever an effect is added.
    """
    found = {t.key for t in search.terms}
    laws = search.library.laws
    several = {t.key for t in search.terms if laws.get(t.key, 1) > 1}
    search = scaled(search, holding(search.data, still))
    forms = [form for batch in search.library.batches for form in batch.forms]
    friction = {form.key for form in forms if is_friction(form)}
    search.refused = {form.key for form in forms} - friction - several
    # Beside all rows another law of what was found may be right.
    search = search.with_terms([t for t in search.terms if t.key not in several])
    search.run(progress)
    search = _settled(search, still, progress)
    weights = turning_weights(search)
    in_part = [
        t
        for t in search.terms
        if is_friction(t.form)
        and not t.form.replaces_own_constant
        and not t.form.effect.at_rest
        and t.key not in found
        and any(weights[j] < 1.0 for j in t.joints)
    ]
    if in_part:
        search.barred |= {t.key for t in in_part}
        search = search.with_terms([t for t in search.terms if t not in in_part])
        search = _settled(search, still, progress)
    return search


def _settled(search: Search, still: Array, progress: Progress) -> Search:
    """Search all rows until what friction holds beside the findings changes no more."""
    held = still
    for _ in range(_ROUNDS):
        before, keys = held, {t.key for t in search.terms}
        held = held_beside(search, still)
        search = scaled(search, holding(search.data, held))
        weakest_first = sorted(search.terms, key=lambda t: t.evidence)
        joints = frozenset(range(search.data.n))
        search.terms = search.drop_weak(weakest_first, on=joints)
        search.run(progress)
        is_settled = np.abs(held - before) <= _SETTLED * (
            held + search.data.noise.floor
        )
        if keys == {t.key for t in search.terms} and np.all(is_settled):
            break
    return search
