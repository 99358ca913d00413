"""What the repaired log leaves over: is it what such arms leave, everywhere and all the time? Are the
torques of a possible size, and what can this motion not show?

Two witnesses for each joint: how much one arm leaves of its torque, and how much more that is than a
model of this joint alone would leave. Friction, however odd, is in both.
"""

from collections.abc import Iterator
from dataclasses import replace
from functools import partial

import numpy as np

from sdp_vs_penalty.checks import constants as c
from sdp_vs_penalty.checks.issue import Issue, joints_text
from sdp_vs_penalty.checks.likelihood import Likelihood, Score
from sdp_vs_penalty.checks.repair import Repair
from sdp_vs_penalty.checks.several import two_arms
from sdp_vs_penalty.checks.transformations.torque import UNITS
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.estimation.uncertainty import NOT_SEEN, counts, of_regression
from sdp_vs_penalty.estimators.estimator import make_task
from sdp_vs_penalty.problem.problem import Problem
from sdp_vs_penalty.regression.base_parameters import base_rows
from sdp_vs_penalty.regression.regression import compress
from sdp_vs_penalty.signals.preprocessing import Preprocessing

#: A one-off event lasts at most so long [s].
_WIDTH = 1.0
_SURE = (
    "certain: by the best fit of this arm; signs, orders, gains, zeros, delays, units and gravity were "
    "tried, and none explains it"
)


def find(log: Likelihood, repair: Repair, score: Score, settled: bool) -> Iterator[Issue]:
    """A warning where more is left over than such an arm leaves; an error where nothing is explained.

    settled : whether there are samples to spare for the parameters."""
    dark = float(np.mean(score.shares[log.moving]))
    if dark > c.UNRELATED:
        yield Issue(
            "torque not explained", "error", "all torque channels",
            f"No inertia and friction of this arm explain {100.0 * dark:.0f} % of the torque energy.",
            "certain: none of the tried signs, orders, units, zeros, delays and directions of gravity "
            "helps",
            "check that this is the right robot, that the columns are joint torques, and that positions "
            "and torques come from the same recording", None, {"unexplained_percent": 100.0 * dark},
        )  # fmt: skip
    elif settled:
        yield from _unexplained(log, repair, score)
        yield from _event(log, repair, score)
        if not repair.events:
            yield from two_arms(log, repair)


def _unexplained(log: Likelihood, repair: Repair, score: Score) -> Iterator[Issue]:
    moving, percent = log.moving, 100.0 * np.sqrt(score.shares)
    total = 100.0 * float(np.sqrt(score.left[moving].sum() / score.whole[moving].sum()))
    where = np.flatnonzero(score.poor & (score.shares > c.CONTRADICTS[0] * score.left_out_alone(repair)))
    what = "cannot belong to the same arm as the other joints' torques"
    if not len(where):
        where = np.array([np.argmax(np.where(moving, score.left, 0.0))])
        what = f"leaves more than such arms do ({total:.2g} % of all torques)"
        if total <= 200.0 * c.TYPICAL[log.problem.torque_side]:
            return
    left = ", ".join(f"{percent[j]:.2g} %" for j in where)
    yield Issue(
        "unexplained torque", "warning", joints_text(where),
        f"the torque of {joints_text(where)} {what}: {left} of it stays unexplained.", _SURE,
        "look at that channel: `diagnose` draws what is left; check its source, gain and zero, "
        "and that robot, mounting and torque side are those of the problem", None,
        {"percent": percent.round(2).tolist(), "joints": (where + 1).tolist()},
    )  # fmt: skip


def _event(log: Likelihood, repair: Repair, score: Score) -> Iterator[Issue]:
    """A moment at which the error is far larger than at any other: contact, a push."""
    t = log.data.motion.t
    for j in log.joints:
        error = np.abs(score.residual[j])
        k = int(np.argmax(error))
        elsewhere = error[np.abs(t - t[k]) > _WIDTH]
        # At its ends the arm starts or comes to rest: stiction; a step has been told.
        known = [e.at for e in repair.events if isinstance(e.at, float)]
        inside = (
            min(t[k] - t[0], t[-1] - t[k]) > 3.0 * _WIDTH < np.min(np.abs(t[k] - known), initial=9e9)
        )
        if inside and len(elsewhere) and error[k] > c.TIMES * elsewhere.max():
            at, unit = float(t[k]), log.problem.robot.torque_units[j]
            yield Issue(
                "one-off event", "warning", f"t = {at:.3g} s, {joints_text([j])}",
                f"a one-off event at t = {at:.3g} s (a knock, a contact, a lost packet): the error "
                f"there is {error[k]:.3g} {unit} in joint {j + 1}, over {c.TIMES:g} times that at "
                f"any other moment.",
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
    needed = float(np.linalg.norm(log.heard(repair).T * log.nominal(repair, still=False)))
    ratio = max(float(np.linalg.norm(channels)), 1e-300) / max(needed, 1e-300)  # of 1e-300 squares are 0
    effort = np.array([j.effort if 0.0 < j.effort < np.inf else np.nan for j in problem.robot.joints])
    each = np.abs(channels).max(axis=0) / effort
    over = float(np.nanmax(each)) if np.isfinite(effort).any() else np.nan
    masses, (low, high) = float(problem.nominal_links[:, 0].sum()), problem.total_mass
    known, weighs = masses > 0.0 and not np.all(problem.guessed_links), f"{low:g} to {high:g}"
    if not np.isfinite(high):
        low, high, weighs = 0.5 * masses, 2.0 * masses, f"{masses:.3g}"
    odd = np.flatnonzero(each > c.EFFORT[1])
    by_size = "likely: judged by size alone"
    convert = "convert to N m (N for a prismatic joint): N cm times 0.01, mN m times 0.001"
    if known and 0 < len(odd) <= 0.3 * log.n:
        for j in odd.tolist():
            yield Issue(
                "torque unit", "error", joints_text([j]),
                f"the torque of joint {j + 1} is too large, {each[j]:.3g} times what the joint is made "
                "for: its unit is not that of the others.", by_size, convert, None,
                {"joints": [j + 1], "times_effort_limit": float(each[j])},
            )  # fmt: skip
        return
    # Least and largest ratio of measured to nominal torque.
    least, most = 1e-2, 1.0
    if known:
        least, most = max(low, 0.1 * high) / masses / c.EFFORT[1], high / masses * c.EFFORT[1]
    large, small, far = known and ratio > most, known and ratio < least, over > c.EFFORT[1]
    times = f"{ratio:.3g} times what" if large else f"{1.0 / ratio:.3g} times less than"
    told, right = f"{times} an arm of {weighs} kg needs", "if right, correct the problem's masses"
    figures = {"times_effort_limit": over, "times_nominal": ratio if known else None}
    if (large or small) and c.EFFORT[0] <= over <= c.EFFORT[1]:
        yield Issue(
            "masses of the problem", "error", "the problem",
            f"the torques are {told}, yet they reach {100.0 * over:.0f} % of the joints' effort "
            f"limits, as torques do: the problem's masses are wrong.", by_size,
            "correct total_mass in problem.toml (the inertials of a URDF)", None, figures,
        )  # fmt: skip
    elif large or (far and not known):
        measured = ratio if known else over
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


def not_excited(problem: Problem, run: Measurements, settings: Preprocessing) -> Iterator[Issue]:
    """Base parameters that the data do not determine; those of idle joints are named elsewhere."""
    model = problem.model()
    data = compress(run, model, settings)
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


def hidden_errors(log: Likelihood, repair: Repair) -> Iterator[Issue]:
    """One note: from which size on the zero of a joint would be named."""
    zeros = {}
    for j in log.revolute:
        at = partial(repair.with_entries, "zero", (j,))
        zeros[j + 1] = 3.0 * log.screen.change(at, repair.zero[j], 0.3 * c.CALIBRATED)[1]
    hidden = [
        f"joint {j}{'' if not x < np.pi else f' below {np.degrees(x):.2g} degrees'}"
        for j, x in zeros.items()
        if not x < c.CALIBRATED
    ]
    if hidden:
        yield Issue(
            "not visible", "note", "the motion",
            f"errors of these joints' zeros could not be seen in this motion: {', '.join(hidden)}.",
            "likely: to first order, from what the arm leaves unexplained",
            "move these joints farther, and in other poses of the joints before them", None,
            {"zeros": zeros},
        )  # fmt: skip
