"""What the repaired log leaves over: is it what such arms leave, everywhere and all the time? Are the
torques of a possible size, and which parameters can this motion not show?

Two witnesses for each joint: how much one arm leaves of its torque, and how much more that is than a
model of this joint alone would leave. Friction, however odd, is in both.

Of several runs: is it the same arm in each? All are fitted by one arm, and each by itself; what each
joint's own motion makes (friction, which warms up, and zeros of torque) is a run's own. Where one run
does not belong to the others' arm, the same question is asked as within a log: which number of that run
makes it theirs, to first order: a gain, a zero, or the ten parameters of a load on the last link.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from sdp_vs_penalty.checks import constants as c
from sdp_vs_penalty.checks.issue import Issue, joints_text
from sdp_vs_penalty.checks.likelihood import Equations, Likelihood, Score, jackknifed
from sdp_vs_penalty.checks.repair import Repair
from sdp_vs_penalty.checks.transformation import choices
from sdp_vs_penalty.checks.transformations.torque import UNITS
from sdp_vs_penalty.estimation.uncertainty import NOT_SEEN, counts, of_regression
from sdp_vs_penalty.estimators.estimator import make_task
from sdp_vs_penalty.problem.problem import Problem
from sdp_vs_penalty.regression.base_parameters import base_rows
from sdp_vs_penalty.regression.regression import compress
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.signals.filtered import FilteredRuns

#: A one-off event lasts at most so long [s].
_WIDTH = 1.0
_SURE = "certain: signs, orders, gains, zeros, delays, units and gravity were tried; none explains it"


def find(log: Likelihood, repair: Repair) -> Iterator[Issue]:
    """A warning where more is left over than such an arm leaves, of logs with samples to spare for its
    parameters; an error where nothing is explained."""
    score = log.score(repair)
    dark, percent, total = _dark(score), 100.0 * np.sqrt(score.shares), 100.0 * score.unexplained**0.5
    if dark > c.UNRELATED:
        yield Issue(
            "torque not explained", "error", "all torque channels",
            f"No inertia and friction of this arm explain {100.0 * dark:.0f} % of the torque energy.",
            _SURE, "check that this is the right robot, that the columns are joint torques, and that "
            "positions and torques come from the same recording", None,
            {"unexplained_percent": 100.0 * dark},
        )  # fmt: skip
    if dark > c.UNRELATED or log.spare <= 0.0:
        return
    where = np.flatnonzero(score.poor & (score.shares > c.CONTRADICTS[0] * score.left_out_alone(repair)))
    what = "cannot belong to the same arm as the other joints' torques"
    if not len(where) and total > 200.0 * c.TYPICAL[log.problem.torque_side]:
        where = np.array([np.argmax(np.where(log.moving, score.left, 0.0))])
        what = f"leaves more than such arms do ({total:.2g} % of all torques)"
    if len(where):
        left = ", ".join(f"{percent[j]:.2g} %" for j in where)
        yield Issue(
            "unexplained torque", "warning", joints_text(where),
            f"the torque of {joints_text(where)} {what}: {left} of it stays unexplained.", _SURE,
            "look at that channel: `diagnose` draws what is left; check its source, gain and zero, "
            "and that robot, mounting and torque side are those of the problem", None,
            {"percent": percent[where].round(2).tolist(), "joints": (where + 1).tolist()},
        )  # fmt: skip
    yield from _event(log, repair, score)


def _dark(score: Score) -> float:
    return float(np.mean(score.shares[score.of.moving]))


def _event(log: Likelihood, repair: Repair, score: Score) -> Iterator[Issue]:
    """A moment at which the error is far larger than at any other: contact, a push. At its ends the arm
    starts or comes to rest, which is stiction; a step has been told."""
    t = log.data.motion.t
    known = [t[0], t[-1], *(e.at for e in repair.events if isinstance(e.at, float))]
    for j in log.joints:
        error = np.abs(score.residual[j])
        at, most = float(t[np.argmax(error)]), float(error.max())
        elsewhere = error[np.abs(t - at) > _WIDTH].max(initial=0.0)
        if np.min(np.abs(np.subtract(known, at))) > 3.0 * _WIDTH and most > c.TIMES * elsewhere > 0.0:
            yield Issue(
                "one-off event", "warning", f"t = {at:.3g} s, {joints_text([j])}",
                f"a one-off event at t = {at:.3g} s (a knock, a contact, a lost packet): the error is "
                f"{most:.3g} {log.problem.robot.torque_units[j]} in joint {j + 1}, over {c.TIMES:g} "
                "times that at any other moment.",
                "likely: an effect of the arm itself would recur", f"exclude {_WIDTH:g} s around it",
                lambda r: r.rows(np.abs(r.t - at) > 0.5 * _WIDTH), {"t": at, "joints": [j + 1]},  # noqa: B023
            )  # fmt: skip
            return


def size(log: Likelihood, repair: Repair) -> Iterator[Issue]:
    """Torques of an impossible size: another unit, motor currents, the motor's side of the gear.

    What joints share tells the channels' ratios, never their common size. Two witnesses do: the joints'
    effort limits, and what an arm of the problem's masses needs on the same motion.
    """
    problem, channels = log.problem, log.channels(repair).T
    needed = float(np.linalg.norm(log.heard(repair).T * log.nominal(repair)))
    ratio = max(float(np.linalg.norm(channels)), 1e-300) / max(needed, 1e-300)  # of 1e-300 squares are 0
    effort = np.array([j.effort if 0.0 < j.effort < np.inf else np.nan for j in problem.robot.joints])
    each = np.abs(channels).max(axis=0) / effort
    over, odd = float(np.max(each, initial=-1.0, where=each > 0.0)), np.flatnonzero(each > c.EFFORT[1])
    by_size = "likely: judged by size alone"
    convert = "convert to N m (N for a prismatic joint): N cm times 0.01, mN m times 0.001"
    if 0 < len(odd) <= 0.3 * log.n:
        for j in odd.tolist():
            yield Issue(
                "torque unit", "error", joints_text([j]),
                f"the torque of joint {j + 1} is too large, {each[j]:.3g} times what the joint is made "
                "for: its unit is not that of the others.", by_size, convert, None, {"joints": [j + 1]},
            )  # fmt: skip
        return
    masses, (low, high) = float(problem.nominal_links[:, 0].sum()), problem.total_mass
    known, weighs = masses > 0.0 and not np.all(problem.guessed_links), f"{low:g} to {high:g}"
    if not np.isfinite(high):
        low, high, weighs = 0.5 * masses, 2.0 * masses, f"{masses:.3g}"
    least, most, measured = 1e-2, 1.0, over  # beside the effort limits where no mass is known
    if known:  # least and largest ratio of measured to nominal torque
        least, most = max(low, 0.1 * high) / masses / c.EFFORT[1], high / masses * c.EFFORT[1]
        measured = ratio
    large, small, far = known and ratio > most, known and ratio < least, over > c.EFFORT[1]
    times = f"{ratio:.3g} times what" if large else f"{1.0 / ratio:.3g} times less than"
    told, right = f"{times} an arm of {weighs} kg needs", "if right, correct the problem's masses"
    figures = {"times_nominal": ratio if known else None, "joints": list(range(1, log.n + 1))}
    if (large or small) and c.EFFORT[0] <= over <= c.EFFORT[1]:
        yield Issue(
            "masses of the problem", "error", "the problem",
            f"the torques are {told}, yet they reach {100.0 * over:.0f} % of the joints' effort "
            f"limits, as torques do: the problem's masses are wrong.", by_size,
            "correct total_mass in problem.toml (the inertials of a URDF)", None, figures,
        )  # fmt: skip
    elif large or (far and not known):
        factor = next((u for u in UNITS if far and u < 0.1 and least <= measured * u <= most), None)
        told = f"{over:.3g} times what the joints are made for" if far else told
        how = f"they are in {UNITS[factor]}" if factor else "their unit is not N m"
        yield Issue(
            "torque unit", "error", "all torque channels", f"the torques are too large, {told}: {how}.",
            by_size, f"multiply by {factor:g}" if factor else f"{convert}; {right}",
            None if factor is None else lambda r: replace(r, tau=r.tau * factor), figures,
        )  # fmt: skip
    elif small:
        yield Issue(
            "torque channel kind", "warning", "all torque channels",
            f"the torques are {told}: they are motor currents, or torques on the motor side of the "
            "gear. A model of them is unscaled: its ratios are right, its kilograms are not.", by_size,
            f"multiply each channel by its drive gain (N m per A, gear ratio included); {right}",
            None, figures,
        )  # fmt: skip


def not_excited(problem: Problem, rows: FilteredRuns) -> Iterator[Issue]:
    """Base parameters that the data do not determine; those of idle joints are named elsewhere."""
    model = problem.model()
    data = compress(rows, model)
    known = of_regression(make_task(problem, model, data), data, base_rows(problem, model), white=True)
    dark = [i.name.split(" ")[0] for i in known.base if i.verdict == NOT_SEEN]
    if not dark:
        return
    total, joint_of = len(known.base), {p.name: p.joint for p in model.parameters}
    joints = sorted({joint_of[name] - 1 for name in dark if joint_of[name]})
    yield Issue(
        "poor excitation", "warning" if len(dark) > c.UNRELATED * total else "note",
        joints_text(joints) if joints else "the robot",
        f"{len(dark)} of {total} base parameters are not identifiable from this motion: "
        f"{', '.join(dark)}.", "likely: by least squares, were its error white noise",
        "move these joints farther, faster and independently of each other, or add runs that do",
        None, {"base_parameters": total, **counts(known.base), "names": dark},
    )  # fmt: skip


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
    samples = float(np.mean([s.score(r).samples for s, r in zip(fits, repairs, strict=True)]))
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
            some = [x.wider(count := columns.shape[2]) for x in runs]
            some[odd] = fits[odd].equations(repairs[odd], columns)
            cost = choices(2 * (1 if count > 1 else fits[odd].n)) + 0.5 * count * np.log(samples)
            left = one_arm(some)[1]
            causes.append((gain(left) - cost, odd, kind, j, columns, left))
    value, odd, kind, j, more, left = max(causes, key=lambda cause: cause[0])
    # An arm of its own for each run costs as many parameters.
    own = apart - 0.5 * len(theta) * np.log(samples * len(runs))
    if max(value, own) < least:
        return
    log, others = fits[odd], [k for k in range(len(runs)) if k != odd]

    def left_out(left: Array, more: Array, others: Sequence[int]) -> tuple[Array, Array]:
        weights = np.where(asked, 1.0 / left, 0.0)
        both = [runs[k].wider(more.shape[2]).normal(weights[k][:, None]) for k in others]
        gram, cross = (np.sum([x[i][0] for x in both], axis=0) for i in (0, 1))
        return log.left_out(repairs[odd], weights[odd], more, (gram, cross))

    none = more[:, :, :0]
    _, before = left_out(one, none, others)
    if value < 0.5 * own:
        kind, j, others, more, left = "another arm", -1, [], none, alone
    arms, after = left_out(left, more, others)
    x, spread = map(float, jackknifed(arms[:, -more.shape[2]]))
    known = j < 0 or abs(x) > c.SIGMAS * spread
    if not known or log.predicts(before, after) < c.SIGMAS:
        return
    figures = {"run": names[odd], "j": j + 1, "x": 1.0 + x if kind == "torque gain" else x}
    what, remedy = (text.format(**figures, degrees=np.degrees(-x)) for text in _WORDS[kind])
    joints = [] if j < 0 else [j]
    yield odd, Issue(
        kind, "warning", joints_text(joints) if joints else "the run", f"{what}, beside the others.",
        f"likely: one arm for all runs explains them {times:.2g} times worse than one for each", remedy,
        None, {"joints": [k + 1 for k in joints], "run": names[odd], "size": x, "times": times},
    )  # fmt: skip


def two_arms(log: Likelihood, repair: Repair) -> Iterator[Issue]:
    """Two stretches of a log that are not one arm's, as two runs: a load picked up, or two arms' logs in
    one file. Each run has offsets of its own, so that of a step in a torque alone nothing is left."""
    repair = replace(repair, events=tuple(e for e in repair.events if not isinstance(e.at, float)))
    few = log.data.count < 4 * c.PARTS  # each of the two has parts of its own, that are left out
    if repair.events or few or log.spare <= 0.0 or _dark(log.score(repair)) > c.UNRELATED:
        return
    parts, k = log.parts(repair, 2 * c.PARTS)
    cuts = range(3, len(parts) - 2)  # neither may be short
    both = [[x.sum(axis=0) for x in (parts[:cut], parts[cut:])] for cut in cuts]
    left = Equations.of(np.array(both), k).fitted(log.moving)[1][..., 0].sum(axis=1)
    cut = cuts[int(np.argmin(np.log(left[:, log.moving]).sum(axis=1)))]
    row = cut * log.data.count // len(parts)
    t, sides = float(log.data.motion.t[row]), (slice(row), slice(row, None))
    names = f"the part before t = {t:.4g} s", f"the part from t = {t:.4g} s on"
    logs = [(log.some(rows), repair, name) for rows, name in zip(sides, names, strict=True)]
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
    torque, here = log.raw(repair) @ theta, log.unexplained(repair, theta)
    for j in log.joints:
        yield "torque gain", j, (torque * np.eye(log.n)[j][:, None])[:, :, None]
        if j in log.revolute:
            shifted = repair.with_entries("zero", (j,), repair.zero[j] + 0.01)
            yield "encoder offset", j, (here - log.unexplained(shifted, theta))[:, :, None] / 0.01
    if log.data.shared is not None:
        last = log.columns(repair.of_arm)[:, :, log.data.shared.rigid_indices[-10:]]
        yield "another load", log.n - 1, log.heard(repair)[:, :, None] * last
