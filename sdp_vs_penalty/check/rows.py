"""The test's data of a run: evenly spread rows, filtered as an identification filters them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache, partial

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.check import beyond
from sdp_vs_penalty.check.columns import independent_of
from sdp_vs_penalty.check.own import Own, own_effects
from sdp_vs_penalty.check.physics import Physics
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.effects.effect import JointEffect, Motion
from sdp_vs_penalty.effects.model import Model
from sdp_vs_penalty.problem.problem import Problem
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.signals.kernels import Decimator, LowPass
from sdp_vs_penalty.signals.preprocessing import Preprocessing, RunFilter, no_rows
from sdp_vs_penalty.signals.runs import Stretch, moving_joints

#: A joint slides at this share of its usual speed.
_SLIDES = 0.3
#: A stretch's motion on the column grid, and the low-pass that picks the rows out of it.
_Dense = tuple[Motion, Decimator]


def physics_of(
    problem: Problem,
    run: Measurements,
    settings: Preprocessing,
    rows: int,
    model: Model | None = None,
) -> Physics:
    """At most so many instants of one run at which the robot moves; ``settings`` resolved.

    States are those of the filter, the rigid body's columns follow from them as they are (its torque is
    as slow as the motion); what a joint's own motion makes passes the torque's low-pass, as the torque
    does. model : other than the problem's. Raises InputError for runs shorter than the filters need.
    """
    filters = RunFilter(run, settings)
    margin = filters.state.half + filters.column.half
    places = filters.moving(margin)
    count = sum(len(k) for _, k in places)
    if count == 0:
        raise no_rows(run, 2 * margin * filters.dt)
    model = model or problem.model()
    chosen = np.unique(np.linspace(0, count - 1, min(rows, count)).round().astype(int))
    pieces, own, start = [], [], 0
    for part, k in places:
        at = k[chosen[(chosen >= start) & (chosen < start + len(k))] - start]
        start += len(k)
        if len(at):
            piece, columns = _piece(filters, part, at)
            pieces.append(piece)
            own.append(columns)
    t, q, dq, ddq, tau, rate = (np.concatenate(x) for x in zip(*pieces, strict=True))
    effects = [e for k in own_effects(model) if isinstance(e := model.effects[k], JointEffect)]
    parameters = [model.indices[k] for k in own_effects(model)]
    indices = np.array(parameters, dtype=np.intp).reshape(-1, model.robot.n).T

    def known(motion: Motion) -> list[Array]:
        return [np.column_stack([e.column(motion, j) for j in range(model.robot.n)]) for e in effects]

    late = (cache(partial(_stacked, own, make)) for make in (beyond.usual, beyond.rivals))
    kept = Own(_stacked(own, known), indices, *late)
    independent, nominal = independent_of(model, problem.nominal(model))
    given = Physics(model, Motion(t, q, dq, ddq), tau, rate, nominal, independent=independent, own=kept)
    return beyond.widened(given.part(_sliding(dq[:, moving_joints(run)])))


def _sliding(dq: Array) -> NDArray[np.intp]:
    """Rows in which some joint slides: where all have stopped, stiction holds any torque."""
    usual = np.sqrt(np.mean(dq**2, axis=0))
    return np.flatnonzero(np.any(np.abs(dq) > _SLIDES * usual, axis=1))


def _piece(filters: RunFilter, part: Stretch, at: NDArray[np.int64]) -> tuple[tuple[Array, ...], _Dense]:
    """t, q, dq, ddq, torque and its rate of one stretch, and what own columns are made of there."""
    coarse = filters.coarse
    reach = filters.stride * coarse.half
    dense = filters.motion(part, at[0] - reach, at[-1] + reach)
    # Off the column grid by at most half a step: both sides of the relation alike would cost more.
    local = np.rint((at - at[0] + reach) / filters.stride).astype(np.int64)
    local = np.clip(local, coarse.half, len(dense.t) - 1 - coarse.half)
    exact = at[0] - reach + local * filters.stride
    low_pass = coarse.decimator(local)
    kernel, half = filters.column, filters.column.half
    around = part.resampled(part.tau, int(exact[0]) - half, int(exact[-1]) + half + 1)
    places = exact - exact[0] + half
    torque = [LowPass(x).decimator(places) @ around for x in (kernel.value, kernel.first)]
    states = (x[local] for x in (dense.q, dense.dq, dense.ddq))
    return (part.clock(exact), *states, *torque), (dense, low_pass)


def _stacked(pieces: Sequence[_Dense], make: Callable[[Motion], list[Array]]) -> Array:
    """(n, M, k) columns of each joint's own motion, low-passed as the torque is."""
    parts = []
    for dense, low_pass in pieces:
        made = [low_pass @ c for c in make(dense)]
        empty = np.zeros((len(low_pass.at), dense.q.shape[1], 0))
        parts.append(np.stack(made, axis=2) if made else empty)
    return np.moveaxis(np.concatenate(parts), 1, 0)
