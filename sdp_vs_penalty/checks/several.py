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

from sdp_vs_penalty.checks.constants import APART
from sdp_vs_penalty.checks.issue import Issue, joints_text
from sdp_vs_penalty.checks.likelihood import Equations
from sdp_vs_penalty.checks.repair import Repair
from sdp_vs_penalty.checks.transformation import Scene, choices
from sdp_vs_penalty.robot.arrays import Array


def compare(
    scenes: Sequence[Scene], repairs: Sequence[Repair], names: Sequence[str]
) -> Iterator[tuple[int, Issue]]:
    """(run, issue) where a run's arm is not that of the others; none for a single run."""
    runs = [_equations(s, r) for s, r in zip(scenes, repairs, strict=True)]
    asked = [s.moving.astype(float) for s in scenes]
    samples = sum(s.samples for s in scenes) / max(len(runs), 1)
    if len(runs) < 2:
        return

    def gain(before: Array, after: Array) -> float:
        return 0.5 * samples * float(np.log(before / after)[np.concatenate(asked) > 0.0].sum())

    alone = np.concatenate([x.fitted(a)[1] for x, a in zip(runs, asked, strict=True)])
    one = _fitted(runs, asked)[1]
    apart = gain(one, alone)
    if apart < APART:
        return
    each = np.log(one / alone).reshape(len(runs), -1).sum(axis=1)
    odd = int(np.argmax(each))
    if len(runs) > 2:  # the run without which the others agree best
        kept = [[k for k in range(len(runs)) if k != out] for out in range(len(runs))]
        rest = [_fitted([runs[k] for k in ks], [asked[k] for k in ks])[1] for ks in kept]
        base = [np.concatenate([alone.reshape(len(runs), -1)[k] for k in ks]) for ks in kept]
        odd = int(np.argmin([np.log(x / b).mean() for x, b in zip(rest, base, strict=True)]))
    causes = []
    for kind, j, more in _changes(scenes[odd], repairs[odd], runs, asked, odd):
        wide, count = _equations(scenes[odd], repairs[odd], more), more.shape[2]
        some = [wide if k == odd else _widened(r, count) for k, r in enumerate(runs)]
        cost = choices(1 if count > 1 else scenes[odd].n) + 0.5 * count * np.log(samples)
        theta, left = _fitted(some, asked)
        causes.append((gain(one, left) - cost, kind, j, float(theta[-1])))
    value, kind, j, x = max(causes)
    # An arm of its own for each run costs as many parameters.
    own = apart - 0.5 * runs[0].gram.shape[1] * np.log(samples * len(runs))
    if value < max(0.5 * own, APART) and own < APART:
        return
    if value < 0.5 * own:
        kind = "another arm"
    run, joint = names[odd], joints_text([j])
    what, remedy = {
        "another arm": (
            f"{run} is not of the same arm: no gain, zero or load of one run explains the difference",
            "identify from one run at a time",
        ),
        "another load": (
            f"{run} carries another load on its last link",
            "identify the runs apart, or log with the same tool",
        ),
        "torque gain": (
            f"the torque of {joint} is {1.0 + x:.3g} times as large in {run}",
            f"divide tau{j + 1} of this run by {1.0 + x:.3g}, or multiply the others",
        ),
        "encoder offset": (
            f"the zero of {joint} is {np.degrees(-x):.2g} degrees away in {run}",
            f"add {x:+.3g} rad to q{j + 1} of this run, or calibrate its zero",
        ),
    }[kind]
    yield odd, Issue(
        kind, "warning", "the run" if kind == "another arm" else joint, f"{what}, beside the others.",
        f"likely: one arm for all runs explains them "
        f"{np.exp(apart / samples / max(asked[odd].sum(), 1)):.2g}"
        " times worse than one for each",
        remedy, None, {"joints": [j + 1] if kind != "another arm" else [], "run": run, "size": x},
    )  # fmt: skip


def _changes(
    scene: Scene, repair: Repair, runs: list[Equations], asked: list[Array], odd: int
) -> Iterator[tuple[str, int, Array]]:
    """Kind, joint and columns (n, M, r) of what may be different in the odd run."""
    others = [k for k in range(len(runs)) if k != odd]
    theta = _fitted([runs[k] for k in others], [asked[k] for k in others])[0]
    torque = scene.judged.rows(repair).columns @ theta
    for j in scene.joints:
        yield "torque gain", j, (torque * np.eye(scene.n)[j][:, None])[:, :, None]
        if j in scene.revolute:
            at = partial(repair.with_entries, "zero", (j,))
            yield "encoder offset", j, -scene.judged.slope(at, repair.zero[j], 0.01, theta)[:, :, None]
    yield "another load", scene.n - 1, scene.judged.last_link(repair)


def _equations(scene: Scene, repair: Repair, more: Array | None = None) -> Equations:
    parts, k = scene.judged.parts(repair, 1, more)
    return Equations.of(parts[0], k)


def _widened(run: Equations, count: int) -> Equations:
    """With further parameters that this run knows nothing of."""
    gram = np.pad(run.gram, ((0, 0), (0, count), (0, count)))
    return replace(run, gram=gram, cross=np.pad(run.cross, ((0, 0), (0, count))))


def _fitted(runs: Sequence[Equations], asked: Sequence[Array]) -> tuple[Array, Array]:
    """(s,) one arm of all runs, whose joints stand side by side, and what it leaves of each."""
    gram, cross, energy, whole = (
        np.concatenate([getattr(r, name) for r in runs]) for name in ("gram", "cross", "energy", "whole")
    )
    return Equations(gram, cross, energy, whole, runs[0].own).fitted(np.concatenate(list(asked)))
