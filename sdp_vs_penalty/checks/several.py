"""Several runs of one arm: is it the same arm in each?

All runs are fitted by one arm, and each by itself; what each joint's own motion makes (friction, which
warms up, and zeros of torque) is a run's own. Where one run does not belong to the others' arm, the same
question is asked as within a log: which change of that run makes it theirs, a gain, a zero, or a load
on the last link.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from sdp_vs_penalty.checks.issue import Issue, joints_text
from sdp_vs_penalty.checks.likelihood import FLOOR, minimised
from sdp_vs_penalty.checks.repair import Repair
from sdp_vs_penalty.checks.transformations import Scene
from sdp_vs_penalty.checks.transformations.transformation import ODD_NUMBER, choices
from sdp_vs_penalty.robot.arrays import Array

#: Runs are set apart by so much (natural logarithm of the odds): friction, which is a run's own, is
#: never quite the same again.
_APART = 20.0
#: A cause explains at least half of what sets the runs apart.
_HALF = 0.5
#: Changes of one run that are tried: gains (natural logarithm), zeros [rad].
_GAINS = tuple(s * x for x in (0.06, 0.1, 0.15, 0.22, 0.3, 0.45, 0.7) for s in (-1.0, 1.0))
_ZEROS = tuple(s * x for x in np.radians((2.0, 3.0, 6.0, 12.0, 25.0)).tolist() for s in (-1.0, 1.0))


@dataclass(frozen=True)
class Normal:
    """One run's normal equations with own columns projected out: gram (n, s, s), cross (n, s), energy
    and whole (n,); ``samples`` for each of its rows."""

    gram: Array
    cross: Array
    energy: Array
    whole: Array
    heard: Array


def normal(scene: Scene, repair: Repair, load: bool = False) -> Normal:
    """load : with the last link's own ten parameters once more."""
    joints, y = scene.judged.joints(repair), scene.judged.channels(repair)
    if load:
        more = zip(joints, scene.judged.last_link(repair), strict=True)
        joints = [replace(x, columns=np.hstack([x.columns, c])) for x, c in more]
    rest = [c - x.basis @ (x.basis.T @ c) for c, x in zip(y.T, joints, strict=True)]
    return Normal(
        np.stack([x.columns.T @ x.columns for x in joints]),
        np.stack([x.columns.T @ r for x, r in zip(joints, rest, strict=True)]),
        np.array([r @ r for r in rest]),
        np.maximum(np.sum(y**2, axis=0), 1e-280),
        np.asarray(scene.moving, float),
    )


def together(runs: Sequence[Normal]) -> Array:
    """(R, n) what one arm leaves of each run."""
    gram, cross, energy, whole, heard = (
        np.concatenate([getattr(r, name) for r in runs])
        for name in ("gram", "cross", "energy", "whole", "heard")
    )
    left = minimised(gram, cross[None], energy[None], whole[None], heard)[1][0]
    return np.maximum(left, FLOOR * whole).reshape(len(runs), -1)


def compare(
    scenes: Sequence[Scene], repairs: Sequence[Repair], names: Sequence[str]
) -> list[tuple[int, Issue]]:
    """(run, issue) where a run's arm is not that of the others; none for a single run."""
    if len(scenes) < 2:
        return []
    runs = [normal(s, r) for s, r in zip(scenes, repairs, strict=True)]
    alone = np.array([together([r])[0] for r in runs])
    one = together(runs)
    samples = sum(s.samples for s in scenes)
    moving = np.array([s.moving for s in scenes])
    apart = 0.5 * samples / len(runs) * np.where(moving, np.log(one / alone), 0.0).sum(axis=1)
    if apart.max() < _APART:
        return []
    odd = int(np.argmax(apart))
    if len(runs) > 2:  # the run without which the others agree best
        rest = [together([r for r in runs if r is not out]) for out in runs]
        base = [np.delete(alone, k, axis=0) for k in range(len(runs))]
        odd = int(np.argmin([np.log(x / b).mean() for x, b in zip(rest, base, strict=True)]))
    issue = _cause(scenes, repairs, runs, one, odd, names, float(samples))
    return [] if issue is None else [(odd, issue)]


def _cause(
    scenes: Sequence[Scene], repairs: Sequence[Repair], runs: list[Normal], one: Array, odd: int,
    names: Sequence[str], samples: float,
) -> Issue | None:  # fmt: skip
    scene, repair = scenes[odd], repairs[odd]

    def gain(changed: Normal, cost: float) -> float:
        left = together([changed if k == odd else r for k, r in enumerate(runs)])
        return 0.5 * samples / len(runs) * float(np.log(one / left).sum()) - cost

    known = choices(scene.n) + ODD_NUMBER
    found: list[tuple[float, str, int, float]] = []
    for j in scene.joints:
        for x in _GAINS:
            other = repair.with_entry("gain", j, repair.gain[j] * float(np.exp(x)))
            found.append((gain(normal(scene, other), known), "torque gain", j, x))
        for x in _ZEROS if scene.revolute(j) else ():
            found.append(
                (
                    gain(normal(scene, repair.with_entry("zero", j, repair.zero[j] + x)), known),
                    "encoder offset",
                    j,
                    x,
                )
            )
    loaded = together(_with_load(runs, scene, repair, odd))
    tool = (
        0.5 * samples / len(runs) * float(np.log(one / loaded).sum())
        - choices(1)
        - 5.0 * np.log(samples)
    )
    found.append((tool, "another load", scene.n - 1, 0.0))
    alone = np.array([together([r])[0] for r in runs])
    most = 0.5 * samples / len(runs) * float(np.log(one / alone).sum())
    value, kind, j, x = max(found)
    beside = f"beside {'the other run' if len(runs) == 2 else 'the other runs'}"
    another = most - 0.5 * runs[odd].gram.shape[1] * np.log(samples)
    if value < max(_HALF * another, _APART) and another < _APART:
        return None
    if value < _HALF * another:
        kind, where, what, remedy = (
            "another arm", "the run", f"{names[odd]} is not of the same arm {beside}: no gain, zero "
            f"or load of "
            "one run explains the difference.", "identify from one run at a time",
        )  # fmt: skip
    elif kind == "another load":
        where, remedy = joints_text([j]), "identify the runs apart, or log with the same tool"
        what = f"{names[odd]} carries another load on its last link {beside}."
    elif kind == "torque gain":
        where, remedy = (
            joints_text([j]),
            f"multiply tau{j + 1} of this run by {np.exp(x):.3g}, or of the others",
        )
        what = (
            f"the torque of joint {j + 1} is {np.exp(-x):.3g} times as large in {names[odd]} {beside}."
        )
    else:
        where, remedy = (
            joints_text([j]),
            f"add {x:+.3g} rad to q{j + 1} of this run, or calibrate its zero",
        )
        what = (
            f"the zero of joint {j + 1} is {np.degrees(-x):.2g} degrees away in {names[odd]} {beside}."
        )
    percent = [100.0 * float(np.sqrt(np.mean(e[odd] / runs[odd].whole))) for e in (one, alone)]
    return Issue(
        kind, "warning", where, what,
        f"likely: one arm for all runs leaves {percent[0]:.3g} % of its torque, one of its own "
        f"{percent[1]:.3g} %",
        remedy, None, {"joints": [j + 1] if kind != "another arm" else [], "run": names[odd], "size": x},
    )  # fmt: skip


def _with_load(runs: list[Normal], scene: Scene, repair: Repair, odd: int) -> list[Normal]:
    """The runs, the odd one's last link with parameters of its own."""
    own = normal(scene, repair, load=True)
    more = own.gram.shape[1] - runs[odd].gram.shape[1]
    wide = [
        replace(
            r,
            gram=np.pad(r.gram, ((0, 0), (0, more), (0, more))),
            cross=np.pad(r.cross, ((0, 0), (0, more))),
        )
        for r in runs
    ]
    wide[odd] = own
    return wide
