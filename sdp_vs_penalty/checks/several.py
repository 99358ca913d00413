"""Several runs of one arm: is it the same arm in each?

All runs are fitted by one arm, and each by itself; what each joint's own motion makes (friction, which
warms up, and zeros of torque) is a run's own. Where one run does not belong to the others' arm, the same
question is asked as within a log: which number of that run makes it theirs, to first order: a gain, a
zero, or the ten parameters of a load on the last link.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from sdp_vs_penalty.checks import constants as c
from sdp_vs_penalty.checks.issue import Issue, joints_text
from sdp_vs_penalty.checks.likelihood import Equations, Likelihood, jackknifed
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


def compare(
    logs: Sequence[tuple[Likelihood, Repair, str]], worse: float = 1.0
) -> Iterator[tuple[int, Issue]]:
    """(number, issue) where the arm of a log is not that of the others; none for a single one.

    logs : rows, net repair and name of each; worse : only where one arm for all explains them so many
    times worse than one for each. What is said of a run predicts the parts of it that nothing
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

    def one_arm(runs: Sequence[Equations]) -> tuple[Array, Array]:
        """(s,) one arm of all runs; (runs, n) what it leaves of each."""
        theta, left = Equations.together(runs).fitted(asked.ravel())
        return theta[0], left.reshape(asked.shape)

    def gain(left: Array) -> float:
        return 0.5 * samples * float(np.log(one / left)[asked].sum())

    theta, one = one_arm(runs)
    apart, least = gain(alone), 3.0 * c.ODDS  # friction is never quite the same again
    times = float(np.exp(apart / samples / max(asked[0].sum(), 1)))
    if apart < least or times < worse:
        return
    causes = []
    for odd in np.argsort(np.log(one / alone).sum(axis=1))[-2:].tolist():  # of two runs either
        for kind, j, columns in _changes(fits[odd], repairs[odd], theta):
            count = columns.shape[2]
            some = [
                fits[k].equations(repairs[k], columns) if k == odd else r for k, r in enumerate(runs)
            ]
            cost = choices(2 * (1 if count > 1 else fits[odd].n)) + 0.5 * count * np.log(samples)
            left = one_arm(some)[1]
            causes.append((gain(left) - cost, odd, kind, j, columns, left))
    more: Array | None
    value, odd, kind, j, more, left = max(causes, key=lambda cause: cause[0])
    # An arm of its own for each run costs as many parameters.
    own = apart - 0.5 * len(theta) * np.log(samples * len(runs))
    if max(value, own) < least:
        return
    log, ranks = fits[odd], [*(k for k in range(len(runs)) if k != odd), odd]

    def left_out(left: Array, more: Array | None, ranks: Sequence[int]) -> tuple[Array, Array]:
        weights = np.where(asked, 1.0 / left, 0.0)[ranks].ravel()
        return log.left_out(repairs[odd], weights, more, [runs[k] for k in ranks[:-1]])

    _, before = left_out(one, None, ranks)
    if value < 0.5 * own:
        kind, j, ranks, more, left = "another arm", -1, [odd], None, alone
    arms, after = left_out(left, more, ranks)
    found = arms[:, 0 if more is None else -more.shape[2]]
    x, spread = jackknifed(found)
    known = more is None or abs(x) > c.SIGMAS * spread
    if not known or log.predicts(before, after) < c.SIGMAS:
        return
    figures = {"run": names[odd], "j": j + 1, "x": 1.0 + x if kind == "torque gain" else x}
    what, remedy = (text.format(**figures, degrees=np.degrees(-x)) for text in _WORDS[kind])
    joints = [] if more is None else [j]
    yield odd, Issue(
        kind, "warning", joints_text(joints) if joints else "the run", f"{what}, beside the others.",
        f"likely: one arm for all runs explains them {times:.2g} times worse than one for each", remedy,
        None, {"joints": [k + 1 for k in joints], "run": names[odd], "size": x, "times": times},
    )  # fmt: skip


def two_arms(log: Likelihood, repair: Repair) -> Iterator[Issue]:
    """Two stretches of a log that are not one arm's, as two runs: a load picked up, or two arms' logs in
    one file."""
    parts, k = log.parts(repair, 2 * c.PARTS)

    def apart(cut: int) -> float:
        logs = [Equations.of_part(x.sum(axis=0), k) for x in (parts[:cut], parts[cut:])]
        left = np.sum([x.fitted(log.moving)[1][:, 0] for x in logs], axis=0)
        return float(np.log(left[log.moving]).sum())

    cut = min(range(3, len(parts) - 2), key=apart)  # neither may be short
    row = cut * log.data.count // len(parts)
    t, both = float(log.data.motion.t[row]), [log.some(slice(row)), log.some(slice(row, None))]
    names = f"the rows before t = {t:.4g} s", f"the rows from t = {t:.4g} s on"
    logs = [(x, repair, name) for x, name in zip(both, names, strict=True)]
    for _, issue in compare(logs, c.TIMES**0.5):  # within a log, friction changes as well
        place = f"{issue.where}, t = {t:.4g} s" if issue.figures["joints"] else f"t = {t:.4g} s"
        yield replace(
            issue, kind="two arms", where=place,
            severity="error" if issue.figures["times"] > c.TIMES else "warning",
            remedy="cut the run there and use each part by itself (--window)",
            figures={**issue.figures, "t": t},
        )  # fmt: skip


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
