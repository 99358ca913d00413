"""The shape constants of the model's own effects: a wrong one must not be taken for a missing effect.

Whatever a search adds is judged beside the constants that explain most: they are profiled on the
search's white rows before the first name is given, and again beside the picks.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.diagnosis.library import spread_columns
from sdp_vs_penalty.diagnosis.stage import white_rows
from sdp_vs_penalty.diagnosis.state import Pick, SearchState
from sdp_vs_penalty.effects.effect import Effect
from sdp_vs_penalty.estimation.estimate import Estimate
from sdp_vs_penalty.estimation.shape_profiles import (
    Normal,
    ShapeBank,
    ShapeEstimate,
    alone,
    best_shapes,
    with_shapes,
)

Array = NDArray[np.float64]

#: A constant that moves by less than this share makes no other columns.
_MOVES = 0.05
#: Values between which a constant is looked for that has no range of its own to be profiled over.
_AROUND = 2.0 ** np.linspace(-2.0, 2.0, 7)


@dataclass(frozen=True)
class _Own:
    """A shape constant of the model on one joint: its effect there, its place in theta."""

    effect: Effect
    joint: int
    key: str
    theta: NDArray[np.intp]


def profiled(first: Estimate, now: Estimate, state: SearchState) -> list[ShapeEstimate]:
    """Every shape constant of the model, as it explains most beside the picks of a search.

    first : the model as it was given, whose constants are the ``before``; now : that of the state.
    """
    own, before = _constants(now), {(o.effect.name, o.joint, o.key): o for o in _constants(first)}
    if not own:
        return []
    stage = state.stage
    free = np.unique(np.concatenate([o.theta for o in own]))
    kept = np.setdiff1d(np.arange(stage.columns.shape[2]), free)
    target = stage.residual + (stage.columns[:, :, free] @ now.theta[free]).T
    parts, banks = [stage.columns[:, :, kept]], []
    first_column = len(kept) + sum(p.candidate.columns.shape[1] for p in _beside(state))
    for o in own:
        was = before[o.effect.name, o.joint, o.key].effect.shape[o.key]
        values, ends = _values(o, was)
        columns = [
            spread_columns(stage.rows, alone(o.effect, o.joint, **{o.key: float(v)})) for v in values
        ]
        parts += columns
        k = columns[0].shape[2]
        places = first_column + np.arange(k * len(values)).reshape(len(values), k)
        first_column += places.size
        banks.append(ShapeBank(o.effect, o.joint, o.key, values, was, places, ends))
    white, y = white_rows(stage.rows, stage.noise, np.concatenate(parts, axis=2), target)
    picked = [p.candidate.columns for p in _beside(state)]
    rows = np.hstack([white[:, : len(kept)], *picked, white[:, len(kept) :]])
    scale = np.repeat(1.0 / state.base.weighting.level, len(stage.rows.t))
    rows, y = rows * scale[:, None], y * scale
    data = Normal(rows.T @ rows, rows.T @ y, float(y @ y))
    base = np.setdiff1d(np.arange(rows.shape[1]), np.concatenate([b.columns.ravel() for b in banks]))
    return best_shapes(data, base, banks, 1.0)


def adopted(now: Estimate, state: SearchState, found: Sequence[ShapeEstimate]) -> Estimate | None:
    """The model with these constants, refitted beside the picks; None where none of them moves."""
    current = {(o.effect.name, o.joint, o.key): o.effect.shape[o.key] for o in _constants(now)}
    steps = [np.log(s.after / current[s.effect, s.joint, s.shape]) for s in found]
    if not np.any(np.abs(steps) > _MOVES):
        return None
    stage = state.stage
    model = replace(now.model, effects=with_shapes(now.model.effects, found))
    columns, moved = stage.columns.copy(), np.zeros(len(now.theta), bool)
    for effect, indices in zip(model.effects, model.indices, strict=True):
        if any(s.effect == effect.name and s.joint in effect.joints for s in found):
            columns[:, :, indices], moved[indices] = spread_columns(stage.rows, effect), True
    change = columns[:, :, moved] - stage.columns[:, :, moved]
    residual = stage.residual - (change @ now.theta[moved]).T
    picks = [spread_columns(stage.rows, p.candidate.effect) for p in _beside(state)]
    refitted = replace(stage, columns=columns, residual=residual)
    step = refitted.least_squares(np.concatenate([columns, *picks], axis=2), balanced=True)
    return replace(now, model=model, theta=now.theta + step[: len(now.theta)])


def _beside(state: SearchState) -> list[Pick]:
    """The picks that are no other account of how dry friction turns round: those have to earn it."""
    return [p for p in state.picks if not p.candidate.effect.widens]


def _constants(estimate: Estimate) -> list[_Own]:
    model, out = estimate.model, []
    for effect, indices in zip(model.effects, model.indices, strict=True):
        if effect.whole_robot or effect.needs_links or effect.several:
            continue
        k = len(indices) // len(effect.joints)
        for key in effect.searched:
            if effect.shapes[key].bounds is None:
                continue
            out += [
                _Own(alone(effect, joint), joint, key, indices[k * m : k * m + k])
                for m, joint in enumerate(effect.joints)
            ]
    return out


def _values(own: _Own, was: float) -> tuple[Array, tuple[float, float]]:
    """The values to profile a constant over, and the ends of its range."""
    shape = own.effect.shapes[own.key].on(own.effect.robot.joints[own.joint].kind)
    assert shape.bounds is not None
    low, high = shape.bounds
    if shape.role == "estimated" and low <= was <= high:
        return np.array(shape.grid), shape.bounds
    # What was found wide once has earned it: it stays in its neighbourhood.
    around = was * _AROUND if shape.scale == "log" else was + np.linspace(-0.6, 0.6, 7)
    ends = (min(low, was), max(high, was))
    return np.unique(np.clip(around, *ends)), ends
