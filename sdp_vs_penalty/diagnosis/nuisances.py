"""What a law and a mounting get wrong: columns beside terms, of which little is
expected.

Nobody mounts an arm exactly: what a term explains has to show beside placements of the
joints that are off by as much as their effect says is plausible, unless that is what
the term says.

No law is exact (Kennedy, O'Hagan, J. R. Statist. Soc. B 2001). Beside a term that makes
the torque c of a joint a fit has

    sum_i a_i c g_i + sum_s a_s dc/ds,    a ~ N(0, diag(d)^2),    g = t, v, |v|, v^2, q, q^2, q v

with the time t and the joint's velocity v and position q in units of their largest, s
its free shape constants, and c by itself where the term acts on several joints.
Together they are expected to make, beyond the model, the share FORM of the squares that
the term makes there. What is found besides has to show beyond that.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sdp_vs_penalty.diagnosis.whitening import WhiteData, spread_columns
from sdp_vs_penalty.effects.effect import Effect
from sdp_vs_penalty.estimation.sensitivity import ShapeSensitivity, free_constants
from sdp_vs_penalty.robot.arrays import Array, nonzero_or_one


@dataclass(frozen=True, eq=False)
class Nuisance:
    """White columns (M, k) by joint, and the deviations (k,) of their coefficients
    about zero."""

    text: str
    columns: dict[int, Array]
    deviations: Array


def law_misfit_columns(
    data: WhiteData, effect: Effect, beta: Array
) -> dict[int, Array]:
    """(M, k) white columns of what the law of an effect with parameters beta may get
    wrong, by joint whose torque it changes."""
    rows = data.rows
    out = dict[int, Array]()
    torque = spread_columns(rows, effect) @ beta
    moved = np.zeros((*torque.shape, 0))
    if free_constants(effect):
        moved = spread_columns(rows, ShapeSensitivity(effect, beta))
    joints = np.flatnonzero(torque.any(axis=1)).tolist()
    for j in joints:
        states = (
            rows.t - rows.t.mean(),
            rows.dq[:, j],
            rows.q[:, j] - rows.q[:, j].mean(),
        )
        t, v, q = (x / nonzero_or_one(np.abs(x).max()) for x in states)
        factors = [
            t,
            v,
            np.abs(v),
            v**2,
            q,
            q**2,
            q * v,
            *([np.ones(len(v))] if len(joints) > 1 else []),
        ]
        out[j] = data.white(
            np.column_stack([*(torque[j] * g for g in factors), moved[j]]), j
        )
    return out
