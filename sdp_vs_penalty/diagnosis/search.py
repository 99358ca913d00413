"""The whole search: the model's own shape constants, what is missing beside them, and again."""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass, replace

from sdp_vs_penalty.diagnosis.ladder import TOLD_APART, by_gain, next_pick, reshaped, search_through
from sdp_vs_penalty.diagnosis.library import Candidacy
from sdp_vs_penalty.diagnosis.own_shapes import (
    adopted,
    beside_the_best,
    doubted,
    given_again,
    moved,
    profiled,
    refitted_beside,
    widened,
)
from sdp_vs_penalty.diagnosis.parsimony import merged
from sdp_vs_penalty.diagnosis.rows import with_estimate
from sdp_vs_penalty.diagnosis.stage import Stage, model_columns, prepare, quiet
from sdp_vs_penalty.diagnosis.state import SearchState
from sdp_vs_penalty.estimation.estimate import Estimate
from sdp_vs_penalty.estimation.shape_profiles import ShapeEstimate
from sdp_vs_penalty.signals.segments import SegmentedRuns

#: How often the model's own shape constants are adopted, before the search and after.
_ADOPTIONS = 2
#: Constants that leave at most so many times the squared error explain as well as what was found.
_AS_WELL = 1.1


@dataclass(frozen=True)
class Found:
    """What a search came to: first : the model as it was given; estimate : with the shape constants
    that explain most, refitted; shapes : those constants; state : the search beside them."""

    first: Estimate
    estimate: Estimate
    shapes: tuple[ShapeEstimate, ...]
    state: SearchState


def search(
    rows: SegmentedRuns,
    estimate: Estimate,
    frozen: bool = False,
    seed: int = 0,
    progress: Callable[[str], None] = quiet,
    whole: SegmentedRuns | None = None,
) -> Found:
    """The search, beside the model's own shape constants as these rows show them: they are adopted
    before the first name is given, and again beside the picks. whole : the runs that show the noise, if
    not these."""

    def staged(model: Estimate) -> Stage:
        return prepare(with_estimate(rows, model), model, frozen, seed, progress, whole)

    now, shapes = estimate, list[ShapeEstimate]()

    def searched_again(before: SearchState, model: Estimate) -> SearchState:
        begin = before.on(staged(model), moved(now, model))
        before.release()
        return search_through(begin)

    state = SearchState.start(prepare(rows, estimate, frozen, seed, progress, whole))
    if not frozen:
        for _ in range(_ADOPTIONS):
            shapes = profiled(estimate, now, state)
            other = adopted(now, state, shapes)
            if other is None:
                break
            now, state = other, SearchState.start(staged(other))
        first = next_pick(state)
        # Friction laws that a filter of all channels bends have no constants of their own beside it.
        if first is None or not (first.candidate.effect.needs_torque and first.candidate.key[1] is None):
            other = adopted(now, state, beside_the_best(estimate, now, state))
            if other is not None:
                now, state = other, SearchState.start(staged(other))
                first = next_pick(state)
        if first is not None and first.candidate.effect.needs_torque:
            # What a late or smoothed torque does at reversals has been taken for the model's own
            # constants, and its column is of a model that was identified without it.
            state = state.with_picks([first])
            for _ in range(_ADOPTIONS):
                now = refitted_beside(now, state, profiled(estimate, now, state))
                state = reshaped(state.on(staged(now)))
    progress("searching for what is missing")
    state = search_through(state)
    for _ in range(0 if frozen else _ADOPTIONS):
        if not state.picks:
            break
        shapes = profiled(estimate, now, state)
        other = adopted(now, state, shapes)
        if other is None:
            break
        # What was found on joints whose constants were wrong may be their work.
        again = searched_again(state, other)
        if _lost(again, state):
            break
        now, state = other, again
    for rest in () if frozen else doubted(estimate, now, state):
        other = adopted(now, rest, profiled(estimate, now, rest))
        if other is None:
            continue
        again = searched_again(rest, other)
        if _plainer(again, state):
            now, state = other, again
            shapes = profiled(estimate, now, state)
            break
    wide = [] if frozen else widened(estimate, now, state)
    if wide:
        kept = [s for s in shapes if (s.effect, s.joint) not in {(w.effect, w.joint) for w in wide}]
        other = adopted(now, state, [*kept, *wide])
        if other is not None:
            again = searched_again(state, other)
            if not _lost(again, state):
                now, state = other, again
                shapes = profiled(estimate, now, state)
    return Found(estimate, now, tuple(shapes), by_gain(merged(state)))


def reverted(found: Found, joints: Collection[int]) -> Found:
    """The same findings beside the constants that the model was given on some joints."""
    state, now = found.state, found.estimate
    other = refitted_beside(now, state, given_again(found.first, now, joints))
    stage = state.stage
    rows = with_estimate(stage.rows, other)
    stage = replace(
        stage,
        rows=rows,
        columns=model_columns(rows, other, stage.frozen),
        residual=rows.residual,
        candidacy=Candidacy(rows, other.model, stage.frozen),
    )
    shapes = tuple(s for s in found.shapes if s.joint not in joints)
    return Found(found.first, other, shapes, state.on(stage))


def _plainer(again: SearchState, before: SearchState) -> bool:
    """Whether fewer findings say as much, or as many say more, of the same rows and noise."""
    other = again.with_noise(before.stage.noise)
    better = before.fit.likelihood_gain(other.fit.joint_chi2)
    return bool(better > -TOLD_APART * (len(before.picks) - len(again.picks)))


def _lost(again: SearchState, before: SearchState) -> bool:
    """Whether nothing is found any more although the constants do not explain what was found."""
    left, had = (float(state.fit.joint_chi2.sum()) for state in (again, before))
    return bool(before.picks) and not again.picks and left > _AS_WELL * had
