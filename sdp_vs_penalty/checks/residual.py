"""What the repaired log leaves over: is it what such arms leave, everywhere and all the
time? Are the torques of a possible size, and which parameters can this motion not show?

Two witnesses for each joint: how much one arm leaves of its torque, and how much more
that is than a model of this joint alone would leave. Friction, however odd, is in both.

Of several runs: is it the same arm in each? All are fitted by one arm, and each by
itself; what each joint's own motion makes (friction, which warms up, and zeros of
torque) is a run's own. Where one run does not belong to the others' arm, the same
question is asked as within a log: which number of that run makes it theirs, to first
order: a gain, a zero, or the ten parameters of a load on the last link.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from sdp_vs_penalty import formatting
from sdp_vs_penalty.checks import constants as c
from sdp_vs_penalty.checks.faults.fault import UNITS
from sdp_vs_penalty.checks.issue import EXPLANATION, Issue, joints_text
from sdp_vs_penalty.checks.likelihood import ArmFit, Equations, Likelihood, jackknifed
from sdp_vs_penalty.checks.repair import LogTransform
from sdp_vs_penalty.estimation.uncertainty import NOT_SEEN, counts, of_regression
from sdp_vs_penalty.estimators.estimator import make_task
from sdp_vs_penalty.problem.problem import Problem
from sdp_vs_penalty.regression.base_parameters import base_rows
from sdp_vs_penalty.regression.regression import compress
from sdp_vs_penalty.robot.arrays import Array, at_least_tiny, nonzero_or_one
from sdp_vs_penalty.signals.filtered import FilteredRuns

explanation = partial(Issue.of, nature=EXPLANATION)
#: A one-off event lasts at most so long [s].
_WIDTH = 1.0
_SURE = (
    "likely: signs, orders, gains, zeros, delays, units and gravity were tried; none"
    " explains it"
)


def unexplained_torque(log: Likelihood, repair: LogTransform) -> Iterator[Issue]:
    """A warning where more is left over than such an arm leaves, of logs with samples
    to spare for its parameters; an error where nothing is explained."""
    score = log.score(repair)
    dark = _dark(score)
    percent = 100.0 * np.sqrt(score.shares)
    total = 100.0 * score.unexplained**0.5
    if dark > c.UNRELATED:
        yield explanation(
            kind="torque not explained",
            severity="warning",
            joints=(),
            what=f"No inertia and friction of this arm explain {100.0 * dark:.0f} % of the"
            " torque energy.",
            certainty=_SURE,
            remedy="check that this is the right robot, that the columns are joint torques,"
            " and that positions and torques come from the same recording",
            where="all torque channels",
            unexplained_percent=100.0 * dark,
        )
    elif log.spare > 0.0:
        times, share_limit = c.CONTRADICTS
        is_unexplained = score.shares > np.maximum(
            times * log.alone(repair), share_limit
        )
        joints = np.flatnonzero(log.moving & is_unexplained)
        what = "cannot belong to the same arm as the other joints' torques"
        if not len(joints) and total > 200.0 * c.TYPICAL[log.problem.torque_side]:
            joints = np.array([np.argmax(np.where(log.moving, score.left, 0.0))])
            what = f"leaves more than such arms do ({total:.2g} % of all torques)"
        left = ", ".join(f"{percent[j]:.2g} %" for j in joints)
        if left:
            yield explanation(
                kind="unexplained torque",
                severity="warning",
                joints=joints,
                what=f"the torque of {{where}} {what}: {left} of it stays unexplained.",
                certainty=_SURE,
                remedy="look at that channel: `diagnose` draws what is left; check its source,"
                " gain and zero, and that robot, mounting and torque side are those of"
                " the problem",
                percent=percent[joints].round(2).tolist(),
            )
        yield from _event(log, repair, score)


def _dark(score: ArmFit) -> float:
    return float(np.mean(score.shares[score.of.moving]))


def _event(log: Likelihood, repair: LogTransform, score: ArmFit) -> Iterator[Issue]:
    """A moment at which the error is far larger than at any other: contact, a push. At
    its ends the arm starts or comes to rest, which is stiction; a step has been told.
    """
    t = log.data.motion.t
    known = [t[0], t[-1], *(e.at for e in repair.events if isinstance(e.at, float))]
    for j in log.joints:
        error = np.abs(score.residual[j])
        at = float(t[np.argmax(error)])
        largest = float(error.max())
        elsewhere = error[np.abs(t - at) > _WIDTH].max(initial=0.0)
        if (
            np.min(np.abs(np.subtract(known, at))) > 3.0 * _WIDTH
            and largest > c.TIMES * elsewhere > 0.0
        ):
            yield explanation(
                kind="one-off event",
                severity="warning",
                joints=[j],
                what=f"a one-off event at t = {at:.3g} s (a knock, a contact, a lost"
                f" packet): the error is {largest:.3g} {log.problem.robot.torque_units[j]}"
                f" in joint {j + 1}, over {c.TIMES:g} times that at any other moment.",
                certainty="likely: an effect of the arm itself would recur",
                remedy=f"exclude {_WIDTH:g} s around it",
                repair=lambda r: r.rows(np.abs(r.t - at) > 0.5 * _WIDTH),  # noqa: B023
                where=f"t = {at:.3g} s, {joints_text([j])}",
                t=at,
            )
            return


def torque_magnitude(log: Likelihood, repair: LogTransform) -> Iterator[Issue]:
    """Torques of an impossible size: another unit, motor currents, the motor's side of
    the gear.

    What joints share tells the channels' ratios, never their common size. Two witnesses
    do: the joints' effort limits, which bind every sample, and what an arm of the
    problem's masses needs on the motion.
    """
    problem = log.problem
    channels = log.channels(repair).T
    sure = "likely: judged by size alone"
    effort = np.array(
        [j.effort if 0.0 < j.effort < np.inf else np.nan for j in problem.robot.joints]
    )
    share_of_effort = (
        log.data.largest[list(repair.tau_order)] * np.abs(repair.gain) / effort
    )
    over = float(np.max(share_of_effort, initial=-1.0, where=share_of_effort > 0.0))
    too_large = np.flatnonzero(share_of_effort > c.EFFORT[1])
    convert = (
        "convert to N m (N for a prismatic joint): N cm times 0.01, mN m times 0.001"
    )
    if 0 < len(too_large) <= 0.3 * log.n:
        times = formatting.words([f"{x:.3g}" for x in share_of_effort[too_large]])
        what = (
            f"the torque of {{where}} is {times} times what the joint is made for: in"
            " another unit."
        )
        yield explanation(
            kind="torque unit",
            severity="warning",
            joints=too_large,
            what=what,
            certainty=sure,
            remedy=convert,
        )
        return
    masses, (low, high) = float(problem.nominal_links[:, 0].sum()), problem.total_mass
    known = masses > 0.0 and not np.all(problem.guessed_links)
    weighs = f"{low:g} to {high:g}"
    if not np.isfinite(high):
        low = 0.5 * masses
        high = 2.0 * masses
        weighs = f"{masses:.3g}"
    smallest, largest, measured = (
        1e-2,
        1.0,
        over,
    )  # beside the effort limits where no mass is known
    description = f"{over:.3g} times what the joints are made for"
    large = small = False
    if known:  # least and largest ratio of measured to nominal torque
        rows = log.rows(repair)
        arm = (log.filter_gain(repair).T * log.nominal(repair)).T[:, :, None]
        measured = _size(channels) / _size(arm)
        smallest = max(low, 0.1 * high) / masses / c.EFFORT[1]
        largest = high / masses * c.EFFORT[1]
        description = f"{measured:.3g} times what an arm of {weighs} kg needs"
        # Upright axes bear friction, and no weight: without it they have to be too
        # large as well.
        model_ratio = _size(rows.apart @ log.score(repair).theta) / _size(
            rows.rest(arm)
        )
        large = min(measured, model_ratio) > largest
        small = measured < smallest
    far = over > c.EFFORT[1]
    kind = "torque unit"
    where = "all torque channels"
    mend = None
    right = "if right, correct the problem's masses"
    if (large or small) and c.EFFORT[0] <= over <= c.EFFORT[1]:
        kind = "masses of the problem"
        where = "the problem"
        share = 100.0 * over
        why = "the problem's masses are wrong: the torques reach what torques do,"
        why = f"{why} {share:.0f} % of the joints' effort limits"
        remedy = "correct total_mass in problem.toml (the inertials of a URDF)"
    elif large or (far and not known):
        factor = next(
            (
                u
                for u in UNITS
                if far and u < 0.1 and smallest <= measured * u <= largest
            ),
            None,
        )
        why = "their unit is not N m"
        remedy = f"{convert}; {right}"
        if factor is not None:
            why = f"they are in {UNITS[factor]}"
            remedy = f"multiply by {factor:g}"
            mend = lambda r: replace(r, tau=r.tau * factor)  # noqa: E731
    elif small and _resembles(channels, log.nominal(repair)) < c.RESEMBLES:
        kind = "external torque"
        why = (
            "they do not follow the arm's weight and inertia: what is left where a model"
            " was subtracted (external torque)"
        )
        remedy = (
            "log the measured joint torque: neither masses nor inertias can be"
            " identified from this"
        )
    elif small:
        kind = "torque channel kind"
        why = (
            "they are motor currents, or torques on the motor side of the gear. A model"
            " of them is"
        )
        why = f"{why} unscaled: its ratios are right, its kilograms are not"
        remedy = (
            "multiply each channel by its drive gain (N m per A, gear ratio included);"
            f" {right}"
        )
    else:
        return
    what = f"the torques are {description}: {why}."
    ratio = measured if known else None
    yield explanation(
        kind=kind,
        severity="warning",
        joints=range(log.n),
        what=what,
        certainty=sure,
        remedy=remedy,
        repair=mend,
        where=where,
        times_nominal=ratio,
    )


def kind_of_torque(log: Likelihood) -> Iterator[Issue]:
    """Torques that a controller's model made, and no motor: the weight of an arm alone,
    without inertia and friction. Nothing else can be asked of such torques."""
    if log.data.shared is None or not any(log.none.gravity) or log.spare <= 0.0:
        return
    score = log.score(log.none)
    weight = log.filter_gain(log.none)[:, :, None] * log.shared(log.none, 0.0, 0.0)
    ones = log.filter_gain(log.none)[:, :, None]
    n_joints, n_rows = weight.shape[:2]
    place = np.eye(n_joints)[:, None, :] * ones
    columns = np.concatenate([weight, place], axis=2).reshape(n_joints * n_rows, -1)
    y = score.channels.reshape(-1)
    size = np.repeat(np.sqrt(np.maximum(score.total, 1e-280)), n_rows)
    columns = columns / size[:, None]
    y = y / size
    left = y - columns @ np.linalg.lstsq(columns, y, rcond=1e-9)[0]
    shares = np.sum(left.reshape(n_joints, n_rows) ** 2, axis=1)
    if shares[log.moving].max() < c.MODEL_OF_WEIGHT:
        yield explanation(
            kind="gravity model",
            severity="warning",
            joints=(),
            what="the torques are the weight of an arm alone: no inertia, and no"
            f" friction of any joint ({100.0 * shares.max() ** 0.5:.2g} % is left).",
            certainty="likely: every motor bears friction",
            remedy="log the measured torque or current: this is the controller's model"
            " of gravity, from which friction and inertia cannot be identified",
            where="all torque channels",
        )


def _size(torques: Array) -> float:
    """Their norm, by which others may be divided."""
    return float(at_least_tiny(np.linalg.norm(torques)))


def _resembles(torques: Array, nominal: Array) -> float:
    """The largest squared correlation of a joint's torque (N, n) with the nominal arm's."""
    x = torques - torques.mean(axis=0)
    y = nominal - nominal.mean(axis=0)
    common = np.sum(x * y, axis=0) ** 2
    return float(
        np.max(common / nonzero_or_one(np.sum(x**2, axis=0) * np.sum(y**2, axis=0)))
    )


def not_excited(problem: Problem, rows: FilteredRuns) -> Iterator[Issue]:
    """Base parameters that the data do not determine; those of idle joints are named
    elsewhere."""
    model = problem.model()
    data = compress(rows, model)
    known = of_regression(
        make_task(problem, model, data), data, base_rows(problem, model), white=True
    )
    dark = [i.name.split(" ")[0] for i in known.base if i.verdict == NOT_SEEN]
    if dark:
        total = len(known.base)
        joint_of = {p.name: p.joint for p in model.parameters}
        joints = sorted({joint_of[name] - 1 for name in dark if joint_of[name]})
        severity = "warning" if len(dark) > c.UNRELATED * total else "note"
        yield Issue(
            kind="poor excitation",
            severity=severity,
            where=joints_text(joints) if joints else "the robot",
            what=f"{len(dark)} of {total} base parameters are not identifiable from this"
            f" motion: {', '.join(dark)}.",
            certainty="likely: by least squares, were its error white noise",
            remedy="move these joints farther, faster and independently of each other, or add"
            " runs that do",
            repair=None,
            figures={"base_parameters": total, **counts(known.base), "names": dark},
            nature=EXPLANATION,
        )


#: What is different in a run, and what to do about it; x is the number, j the joint
#: from 1.
_WORDS = {
    "another arm": (
        (
            "{run} is not of the same arm: no gain, zero or load of one run explains"
            " the difference"
        ),
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
        "the zero of joint {j} is {away} away in {run}",
        "add {x:+.3g} {unit} to q{j} of this run, or calibrate its zero",
    ),
}


def compare_runs(
    logs: Sequence[tuple[Likelihood, LogTransform, str]], worse: float = 1.0
) -> Iterator[tuple[int, Issue]]:
    """(number, issue) where the arm of a log is not that of the others; none for a
    single one.

    logs : rows, net repair and name of each; worse : only where one arm for all
    explains them so many times worse than one for each. What is said of a run predicts
    the parts of it that nothing was fitted to, best of all that may be different, and
    its number is far from none."""
    if len(logs) < 2:
        return
    fits, repairs, names = zip(*logs, strict=True)
    # A law of one run's joint is that of the arm's.
    laws = dict.fromkeys(e for r in repairs for e in r.events if isinstance(e.at, str))
    repairs = tuple(
        replace(r, events=tuple(dict.fromkeys((*r.events, *laws)))) for r in repairs
    )
    samples = float(
        np.mean([s.score(r).samples for s, r in zip(fits, repairs, strict=True)])
    )
    runs = [Equations.of(*s.parts(r, 1)) for s, r in zip(fits, repairs, strict=True)]
    moving = np.stack([s.moving for s in fits])
    separate_losses = np.concatenate(
        [x.fitted(a)[1] for x, a in zip(runs, moving, strict=True)]
    )
    (theta,), left = Equations.together(runs).fitted(moving.ravel())
    one = left.reshape(moving.shape)
    lost = np.where(moving, np.log(one / separate_losses), 0.0)
    times = float(np.exp(0.5 * lost.sum() / max(moving[0].sum(), 1)))
    # Friction is never quite the same again.
    if 0.5 * samples * lost.sum() < 3.0 * c.ODDS or times < max(worse, c.TIMES_BETTER):
        return
    usual = {"torque gain": c.CALIBRATED_GAIN, "encoder offset": c.CALIBRATED}
    weights = np.where(moving, 1.0 / one, 0.0)
    causes = []
    for run_number in sorted(
        np.argsort(lost.sum(axis=1))[-2:].tolist()
    ):  # of two runs either
        log = fits[run_number]
        repair = repairs[run_number]
        other_runs = [
            runs[k].normal(weights[k]) for k in range(len(runs)) if k != run_number
        ]
        others = tuple(
            np.concatenate(x).sum(axis=0) for x in zip(*other_runs, strict=True)
        )
        none = log.raw(repair)[:, :, :0]
        before = log.jackknife_errors(repair, weights[run_number], none, others)[1]
        for kind, j, more in (("another arm", -1, none), *_changes(log, repair, theta)):
            arms, after = log.jackknife_errors(
                repair, weights[run_number], more, others if j >= 0 else None
            )
            gain = float(np.log(before / after)[:, log.moving].sum()) * (
                1.0 if j >= 0 else 0.5
            )
            x, spread = map(float, jackknifed(arms[:, -max(more.shape[2], 1)]))
            certain = abs(x) > max(c.SIGMAS * spread, usual.get(kind, 0.0))
            if j < 0 or (certain and _can_be(log, kind, j, x)):
                causes.append(
                    (gain, run_number, kind, j, x, log.predicts(before, after))
                )
    _, run_number, kind, j, x, sure = max(causes, key=lambda cause: cause[0])
    # Of a number, whose interval tells as well, half as clear a prediction is enough.
    if sure < c.SIGMAS * (1.0 if j < 0 else 0.5):
        return
    unit = fits[run_number].problem.robot.position_units[j]
    difference = (
        f"{np.degrees(-x):.2g} degrees" if unit == "rad" else f"{-x:.2g} {unit}"
    )
    figures = {
        "run": names[run_number],
        "j": j + 1,
        "x": 1.0 + x if kind == "torque gain" else x,
    }
    what, remedy = (
        text.format(**figures, away=difference, unit=unit) for text in _WORDS[kind]
    )
    joints = [] if j < 0 else [j]
    yield (
        run_number,
        Issue(
            kind=kind,
            severity="warning",
            where=joints_text(joints) if joints else "the run",
            what=f"{what}, beside the others.",
            certainty=f"likely: one arm for all runs explains them {times:.2g} times worse than"
            " one for each",
            remedy=remedy,
            repair=None,
            figures={
                "joints": [k + 1 for k in joints],
                "run": names[run_number],
                "size": x,
                "times": times,
            },
            nature=EXPLANATION,
        ),
    )


def _can_be(log: Likelihood, kind: str, j: int, x: float) -> bool:
    """Whether a number that is different in a run is of a size that it can have: a gain
    is positive, a zero within a part of a turn, a load less than the arm."""
    if kind == "torque gain":
        return 0.2 < 1.0 + x < 5.0
    if kind == "encoder offset":
        return abs(x) < (
            0.5 if j in log.revolute else log.problem.robot.link_reach()[j]
        )
    masses = log.problem.nominal_links[:, 0]
    return bool(abs(x) < max(float(masses.sum()), 1.0))


def two_arms(log: Likelihood, repair: LogTransform) -> Iterator[Issue]:
    """Two stretches of a log that are not one arm's, as two runs: a load picked up, or
    two arms' logs in one file. Each run has offsets of its own, so that of a step in a
    torque alone nothing is left."""
    repair = replace(
        repair, events=tuple(e for e in repair.events if not isinstance(e.at, float))
    )
    too_few = (
        log.data.count < 4 * c.PARTS
    )  # each of the two has parts of its own, that are left out
    if (
        repair.events
        or too_few
        or log.spare <= 0.0
        or _dark(log.score(repair)) > c.UNRELATED
    ):
        return
    parts, k = log.parts(repair, 2 * c.PARTS)
    cuts = range(3, len(parts) - 2)  # neither may be short
    both = [[x.sum(axis=0) for x in (parts[:cut], parts[cut:])] for cut in cuts]
    left = Equations.of(np.array(both), k).fitted(log.moving)[1].sum(axis=1)
    cut = cuts[int(np.argmin(np.log(left[:, log.moving]).sum(axis=1)))]
    row = cut * log.data.count // len(parts)
    t = float(log.data.motion.t[row])
    sides = (slice(row), slice(row, None))
    names = f"the part before t = {t:.4g} s", f"the part from t = {t:.4g} s on"
    logs = [
        (log.some(rows), repair, name) for rows, name in zip(sides, names, strict=True)
    ]
    for _, issue in compare_runs(
        logs, c.TIMES**0.5
    ):  # within a log, friction changes as well
        place = (
            f"{issue.where}, t = {t:.4g} s"
            if issue.figures["joints"]
            else f"t = {t:.4g} s"
        )
        yield replace(
            issue,
            kind="two arms",
            where=place,
            severity="warning",
            remedy="cut the run there and use each part by itself (--window)",
            figures={**issue.figures, "t": t},
        )


def _changes(
    log: Likelihood, repair: LogTransform, theta: Array
) -> Iterator[tuple[str, int, Array]]:
    """Kind, joint and columns (n, M, r) of what may be different in a run, beside an
    arm's torque."""
    torque = log.raw(repair) @ theta
    residual = log.unexplained(repair, theta)
    for j in log.joints:
        yield "torque gain", j, (torque * np.eye(log.n)[j][:, None])[:, :, None]
        shifted = repair.with_entries("zero", (j,), repair.zero[j] + 0.01)
        yield (
            "encoder offset",
            j,
            (residual - log.unexplained(shifted, theta))[:, :, None] / 0.01,
        )
    if log.data.shared is not None:
        last = log.columns(repair.of_arm)[:, :, log.data.shared.rigid_indices[-10:]]
        yield "another load", log.n - 1, log.filter_gain(repair)[:, :, None] * last
