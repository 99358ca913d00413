"""Positions in degrees, with the wrong sign, or of other joints; torques logged long after them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.check import events
from sdp_vs_penalty.check.hypothesis import BETTER, Hypothesis, few_rows, propose
from sdp_vs_penalty.check.issue import Array, joints_text
from sdp_vs_penalty.check.physics import Physics
from sdp_vs_penalty.check.signals import angle_scale
from sdp_vs_penalty.data.measurements import Measurements


def degrees(physics: Physics, moving: NDArray[np.bool_]) -> Iterator[Hypothesis]:
    robot = physics.model.robot
    scale = angle_scale(robot)
    if np.all(scale == 1.0):
        return
    same = np.arange(robot.n)
    largest = float(np.abs(physics.motion.q[:, scale != 1.0]).max(initial=0.0))
    if largest < np.pi:
        return

    def repair(run: Measurements) -> Measurements:
        dq = None if run.dq is None else run.dq * scale
        return replace(run, q=run.q * scale, dq=dq)

    yield propose(
        physics,
        lambda p: p.with_motion(scale, same),
        0,
        (
            "positions in degrees",
            "q1" if robot.n == 1 else f"q1 to q{robot.n}",
            f"the positions are in degrees, not in radians (they reach {largest:.4g}).",
            "multiply q (and dq) of revolute joints by pi / 180",
        ),
        repair,
        largest=largest,
    )


def delay(physics: Physics, moving: NDArray[np.bool_]) -> Iterator[Hypothesis]:
    """A delay so long that it spoils the test of everything else."""
    seconds = events.long_delay(physics)
    if seconds == 0.0:
        return
    made = propose(
        physics,
        lambda p: p.with_delay(seconds),
        1,
        events.delay_texts(seconds),
        lambda run: events.shifted(run, seconds),
        seconds=seconds,
    )
    yield replace(made, issue=replace(made.issue, severity="warning"))


def turned_or_exchanged(physics: Physics, moving: NDArray[np.bool_]) -> Iterator[Hypothesis]:
    """A position channel with the wrong sign, or two exchanged: tried on few rows first."""
    n = physics.n
    few = physics.part(few_rows(physics))
    base = few.unexplained
    movers = np.flatnonzero(moving)
    tried: list[tuple[float, Array, NDArray[np.intp], tuple[str, str, str, str], dict[str, object]]] = []
    for j in movers:
        scale = np.ones(n)
        scale[j] = -1.0
        name = joints_text([j])
        texts = (
            "position sign",
            name,
            f"the position of {name} has the wrong sign.",
            f"flip the sign of q{j + 1} (and dq{j + 1})",
        )
        same = np.arange(n)
        left = few.with_motion(scale, same).unexplained
        tried.append((left, scale, same, texts, {"joints": [int(j) + 1]}))
    for a, b in combinations(movers, 2):
        order: NDArray[np.intp] = np.arange(n, dtype=np.intp)
        order[[a, b]] = order[[b, a]]
        name = joints_text([a, b])
        texts = (
            "position order",
            name,
            f"the positions of {name} are swapped.",
            f"swap q{a + 1} and q{b + 1} (and dq)",
        )
        left = few.with_motion(np.ones(n), order).unexplained
        tried.append((left, np.ones(n), order, texts, {"joints": [int(a) + 1, int(b) + 1]}))
    if not tried:
        return
    left, scale, order, texts, figures = min(tried, key=lambda item: item[0])
    if left > BETTER * base:
        return

    def repair(run: Measurements) -> Measurements:
        dq = None if run.dq is None else scale * run.dq[:, order]
        return replace(run, q=scale * run.q[:, order], dq=dq)

    yield propose(physics, lambda p: p.with_motion(scale, order), 3, texts, repair, None, **figures)
