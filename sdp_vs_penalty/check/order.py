"""Torque channels that belong to other joints."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from sdp_vs_penalty.check.hypothesis import Hypothesis, propose
from sdp_vs_penalty.check.issue import joints_text
from sdp_vs_penalty.check.physics import Physics
from sdp_vs_penalty.check.signs import choose_signs
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.robot.arrays import Array

Order = NDArray[np.intp]


def exchanged(physics: Physics, moving: NDArray[np.bool_]) -> Iterator[Hypothesis]:
    """Torque channels in another order: each pair exchanged, and the order that fits joint by joint."""
    n = physics.n
    orders = []
    for a, b in combinations(np.flatnonzero(moving), 2):
        order: Order = np.arange(n, dtype=np.intp)
        order[[a, b]] = order[[b, a]]
        # Only where both channels suit the other joint at least as well, each joint by itself.
        own = physics.alone[a, a] * physics.alone[b, b]
        if physics.alone[a, b] * physics.alone[b, a] < own:
            orders.append(order)
    # For each joint the channel that its columns alone explain best, all channels given out.
    orders.append(np.asarray(linear_sum_assignment(np.log(physics.alone))[1], np.intp))
    for order in orders:
        changed = np.flatnonzero(order != np.arange(n))
        if not len(changed) or not np.all(moving[changed]):
            continue
        swapped = physics.with_channels(np.ones(n), order)
        signs = choose_signs(swapped)
        turned = np.flatnonzero(signs < 0.0)
        swap = len(changed) == 2
        named = ", ".join(f"tau{order[j] + 1} is that of joint {j + 1}" for j in changed)
        what = (
            f"the torques of {joints_text(changed)} are swapped."
            if swap
            else f"the torque channels are in another order: {named}."
        )
        also = (
            f", and flip the sign of {', '.join(f'tau{j + 1}' for j in turned)}" if len(turned) else ""
        )

        def apply(p: Physics, order: Order = order, signs: Array = signs) -> Physics:
            return p.with_channels(signs, order)

        def repair(run: Measurements, order: Order = order, signs: Array = signs) -> Measurements:
            return replace(run, tau=run.tau[:, order] * signs)

        yield propose(
            apply, len(changed) + len(turned),
            ("torque order", joints_text(changed), what, f"rename the torque columns{also}"), repair,
            order=(order + 1).tolist(), joints=[int(j) + 1 for j in changed], signs=signs.tolist(),
        )  # fmt: skip
