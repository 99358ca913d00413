"""Several runs of one arm: is it the same arm in each?

All runs are fitted by one arm, and each by itself; what each joint's own motion makes (friction, which
warms up, and zeros of torque) is a run's own. Where one run does not belong to the others' arm, the same
question is asked as within a log: which number of that run makes it theirs, to first order: a gain, a
zero, or the ten parameters of a load on the last link.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.checks import constants as c
from sdp_vs_penalty.checks.issue import Issue, joints_text
from sdp_vs_penalty.checks.likelihood import Equations, Likelihood
from sdp_vs_penalty.checks.repair import Repair
from sdp_vs_penalty.checks.transformation import choices
from sdp_vs_penalty.robot.arrays import Array

#: What is different in a run, and what to do about it; x is the number, j the joint from 1.
_WORDS = {
    "another arm": (
        "{run} is not of the same arm: no gain, zero or load of one run explains the difference",
        "identify from one run at a time",
    ),
    "another load": (
        "{run} carries another load on its last link ({x:+.2g} kg)",
        "identify the runs apart, or log with the same tool",
    ),
    "torque gain": (
        "the torque of joint {j} is {x:.3g} times as large in {run}",
        "divide tau{j} of this run by {x:.3g}, or multiply the others",
    ),
    "encoder offset": (
        "the zero of joint {j} is {degrees:.2g} degrees away in {run}",
        "add {x:+.3g} rad to q{j} of this run, or calibrate its zero",
    ),
}  # fmt: skip


def compare(logs: Sequence[tuple[Likelihood, Repair, str]]) -> Iterator[tuple[int, Issue]]:
    """(number, issue) where the arm of a log is not that of the others; none for a single one.

    logs : rows, net repair and name of each. What is said of a run predicts the parts of it that nothing
    was fitted to, and its number is far from none."""
    if len(logs) < 2:
        return
    fits, repairs, names = zip(*logs, strict=True)
    # A law of one run's joint is that of the arm's.
    laws = dict.fromkeys(e for r in repairs for e in r.events if isinstance(e.at, str))
    repairs = tuple(replace(r, events=tuple(dict.fromkeys((*r.events, *laws)))) for r in repairs)
    samples = float(np.mean([s.samples for s in fits]))
    runs = [s.equations(r) for s, r in zip(fits, repairs, strict=True)]
    asked = np.stack([s.moving for s in fits])
    alone = np.stack([x.fitted(a)[1][:, 0] for x, a in zip(runs, asked, strict=True)])
    theta, one = _one_arm(runs, asked)

    def gain(left: Array) -> float:
        return 0.5 * samples * float(np.log(one / left)[asked].sum())

    apart, least = gain(alone), c.ODDS + c.SLOW_ODDS  # friction is never quite the same again
    if apart < least:
        return
    causes = []
    for odd in np.argsort(np.log(one / alone).sum(axis=1))[-2:].tolist():  # of two runs either
        for kind, j, more in _changes(fits[odd], repairs[odd], theta):
            count = more.shape[2]
            some = [_widened(r, count) for r in runs]
            some[odd] = fits[odd].equations(repairs[odd], more)
            cost = choices(2 * (1 if count > 1 else fits[odd].n)) + 0.5 * count * np.log(samples)
            causes.append((gain(_one_arm(some, asked)[1]) - cost, odd, kind, j, more))
    value, odd, kind, j, more = max(causes, key=lambda cause: cause[0])
    # An arm of its own for each run costs as many parameters.
    own = apart - 0.5 * len(theta) * np.log(samples * len(runs))
    if max(value, own) < least:
        return
    log, repair = fits[odd], repairs[odd]
    others, moving = [r for k, r in enumerate(runs) if k != odd], np.delete(asked, odd, axis=0)
    before, _ = _left_out(log, repair, others, moving, more[:, :, :0])
    if value < 0.5 * own:
        kind, others, moving, more = "another arm", [], moving[:0], more[:, :, :0]
    after, found = _left_out(log, repair, others, moving, more)
    change = np.log(before / after)[:, log.moving].sum(axis=1)
    x, spread = float(np.mean(found)), float(np.sqrt((c.PARTS - 1) * np.var(found)))
    known = kind == "another arm" or abs(x) > c.SIGMAS * spread
    if not known or np.mean(change) < c.SIGMAS * np.std(change) / np.sqrt(c.PARTS):
        return
    figures = {"run": names[odd], "j": j + 1, "x": 1.0 + x if kind == "torque gain" else x}
    what, remedy = (text.format(**figures, degrees=np.degrees(-x)) for text in _WORDS[kind])
    times = np.exp(apart / samples / max(asked[odd].sum(), 1))
    yield odd, Issue(
        kind, "warning", "the run" if kind == "another arm" else joints_text([j]),
        f"{what}, beside the others.",
        f"likely: one arm for all runs explains them {times:.2g} times worse than one for each", remedy,
        None, {"joints": [j + 1] if kind != "another arm" else [], "run": names[odd], "size": x},
    )  # fmt: skip


def _left_out(
    log: Likelihood, repair: Repair, others: Sequence[Equations], moving: NDArray[np.bool_], more: Array
) -> tuple[Array, Array]:
    """(PARTS, n) what the arm of other runs and of a log's other parts leaves of each part of this log;
    (PARTS,) its gain or zero, or the mass of its load."""
    (parts, k), some = log.parts(repair, c.PARTS, more), [_widened(r, more.shape[2]) for r in others]
    rests = [Equations.of_part(parts.sum(axis=0) - part, k) for part in parts]
    arms = [_one_arm([*some, rest], np.vstack([moving, log.moving]))[0] for rest in rests]
    left = [rest.left_of(part, a) for rest, part, a in zip(rests, parts, arms, strict=True)]
    return np.maximum(left, 1e-280), np.array([a[-max(more.shape[2], 1)] for a in arms])


def _changes(log: Likelihood, repair: Repair, theta: Array) -> Iterator[tuple[str, int, Array]]:
    """Kind, joint and columns (n, M, r) of what may be different in a run, beside an arm's torque."""
    torque = log.raw(repair) @ theta
    for j in log.joints:
        yield "torque gain", j, (torque * np.eye(log.n)[j][:, None])[:, :, None]
        if j in log.revolute:
            at = partial(repair.with_entries, "zero", (j,))
            away = log.slope(at, repair.zero[j], 0.01, theta)
            yield "encoder offset", j, -away[:, :, None]
    if log.data.shared is not None:
        last = log.shared(repair, log.motion(repair))[:, :, log.data.shared.rigid_indices[-10:]]
        yield "another load", log.n - 1, log.heard(repair)[:, :, None] * last


def _widened(run: Equations, count: int) -> Equations:
    """With further parameters that this run knows nothing of."""
    gram = np.pad(run.gram, ((0, 0), (0, count), (0, count)))
    return replace(run, gram=gram, cross=np.pad(run.cross, ((0, 0), (0, count), (0, 0))))


def _one_arm(runs: Sequence[Equations], asked: NDArray[np.bool_]) -> tuple[Array, Array]:
    """(s,) one arm of all runs, whose joints stand side by side; (runs, n) what it leaves of each."""
    names = ("gram", "cross", "energy", "whole")
    both = {name: np.concatenate([getattr(r, name) for r in runs]) for name in names}
    theta, left = replace(runs[0], **both).fitted(asked.ravel())
    return theta[0], left.reshape(asked.shape)
