"""What the repaired log leaves over: is it what such arms leave, everywhere and all the
time? Which parameters can this motion not show?

Two witnesses for each joint: how much one arm leaves of its torque, and how much more
that is than a model of this joint alone would leave. Friction, however odd, is in both.
"""

from collections.abc import Iterator
from functools import partial

import numpy as np

from sdp_vs_penalty.checks import constants as c
from sdp_vs_penalty.checks.certainty import likely
from sdp_vs_penalty.checks.issue import Issue, joints_text, make_explanation
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.estimation.uncertainty import (
    NOT_SEEN,
    counts,
    regression_uncertainty,
)
from sdp_vs_penalty.estimators.estimator import make_task
from sdp_vs_penalty.problem.problem import Problem
from sdp_vs_penalty.race.arm_fit import ArmFit
from sdp_vs_penalty.race.chain import LogTransform
from sdp_vs_penalty.race.constants import LEAST_SHARE
from sdp_vs_penalty.race.likelihood import Likelihood
from sdp_vs_penalty.regression.base_parameters import base_rows
from sdp_vs_penalty.regression.regression import compress
from sdp_vs_penalty.results.remedy import Change
from sdp_vs_penalty.robot.arrays import Indices
from sdp_vs_penalty.signals.filtered import FilteredRuns

#: Kind of what happens once.
EVENT = "one-off event"
#: A one-off event lasts at most so long [s].
EVENT_WIDTH = 1.0
_SURE = likely(
    "signs, orders, gains, zeros, delays, units and gravity were tried; none"
    " explains it"
)


def unrelated_torque(fit: ArmFit) -> Iterator[Issue]:
    """Yield a warning where the arm's inertia, weight and friction leave a quarter or
    more of the torques' energy, in the mean over the joints.

    Parameters
    ----------
    fit : ArmFit
        One arm fitted to the rows.
    """
    if fit.mean_unexplained_share <= c.UNRELATED:
        return
    percent = 100.0 * fit.mean_unexplained_share
    yield make_explanation(
        kind="torque not explained",
        in_doubt="torque not explained",
        what=f"No inertia and friction of this arm explain {percent:.0f} % of the torque"
        " energy.",
        certainty=_SURE,
        remedy="check that this is the right robot, that the columns are joint torques,"
        " and that positions and torques come from the same recording",
        where="all torque channels",
        figures={"unexplained_percent": percent},
    )


def unexplained_torque(
    log: Likelihood,
    repair: LogTransform,
    has_gains: bool = True,
    is_one_arm: bool = True,
) -> Iterator[Issue]:
    """Yield warnings where the repaired log leaves more torque unexplained than such
    arms do: in all joints, in single joints, or at a single moment.

    Joints and moments are judged only where the log has more samples than one arm has
    parameters.

    Parameters
    ----------
    repair : LogTransform
        How the log is repaired.
    has_gains : bool
        Whether the channels have known gains, so that joints can be compared.
    is_one_arm : bool
        Whether one arm has made all rows, so that moments can be compared.

    Returns
    -------
    iterator of Issue
        About all joints, single joints, or a moment.
    """
    fit = log.fit(repair)
    unrelated = [*unrelated_torque(fit)]
    yield from unrelated
    if unrelated or log.spare_share <= 0.0:
        return
    if has_gains:
        yield from _unexplained_joints(log, repair, fit)
    if is_one_arm:
        yield from _event(log, repair)


def _unexplained_joints(
    log: Likelihood, repair: LogTransform, fit: ArmFit
) -> Iterator[Issue]:
    """Yield a warning about the joints that contradict the others: the arm leaves far
    more of their torque than a model of that joint alone. Without any, yield one about
    the worst joint if all together leave more than such arms do."""
    joints = contradicting_joints(log, repair)
    what = "does not fit the arm that explains the other joints' torques"
    if not len(joints):
        # What a law of friction or a spring explains is the model's matter.
        with_laws = log.with_all_laws.fit(repair)
        if not leaves_more_than_usual(log, with_laws):
            return
        joints = np.array([np.argmax(np.where(log.moving, fit.energy_left, 0.0))])
        percent_of_all = 100.0 * fit.unexplained**0.5
        what = f"leaves more than such arms do ({percent_of_all:.2g} % of all torques)"
    percent = 100.0 * np.sqrt(fit.unexplained_shares[joints])
    left = ", ".join(f"{x:.2g} %" for x in percent)
    yield make_explanation(
        kind="unexplained torque",
        joints=joints,
        what=f"the torque of {{where}} {what}: {left} of it stays unexplained.",
        certainty=_SURE,
        remedy="look at that channel: check its source, gain and zero, and that robot,"
        " mounting and torque side are those of the problem",
        figures={"percent": percent.round(2).tolist()},
    )


def leaves_more_than_usual(log: Likelihood, fit: ArmFit) -> bool:
    """Whether one arm leaves more than twice the usual root mean square of all joints'
    torques; usual is 5 % for sensors on the link, 10 % for motor currents.

    Parameters
    ----------
    fit : ArmFit
        One arm fitted to the rows.
    """
    return fit.unexplained**0.5 > 2.0 * c.TYPICAL[log.problem.torque_side]


def contradicting_joints(log: Likelihood, repair: LogTransform) -> Indices:
    """Return the joints (K,), from 0, that contradict the others: one arm for all
    joints leaves far more of their torque's energy than a model of the joint alone.

    It has to be so with all laws of friction and position fitted as well.
    """
    times, smallest = c.CONTRADICTS
    of_own_models = log.shares_left_by_own_models(repair)
    shares = log.fit(repair).unexplained_shares
    is_worse = shares > np.maximum(times * of_own_models, smallest)
    joints = np.flatnonzero(log.moving & is_worse)
    if not len(joints):
        return joints
    with_laws = log.with_all_laws
    of_own_models = with_laws.shares_left_by_own_models(repair)
    is_still_worse = with_laws.fit(repair).unexplained_shares > times * of_own_models
    return joints[is_still_worse[joints]]


#: A one-off event is a moment whose error is so many times that of any other moment: what
#: the arm itself does recurs.
_EVENT_OVER_REST = 3.0


def _event(log: Likelihood, repair: LogTransform) -> Iterator[Issue]:
    """Yield a warning about the first joint with a moment at which the error is far
    larger than at any other: a contact, a push.

    Left out are the ends of the log, where the arm starts or comes to rest (stiction),
    and steps of the torque, which are faults of their own. What a law of friction or the
    filters make of a motion that does not recur, such as the fastest, is no event: all
    laws are fitted as well. It holds the least share of the torque's energy that a claim
    explains.
    """
    fit = log.with_all_laws.fit(repair)
    t = log.data.motion.t
    steps = [event.at for event in repair.events if event.at is not None]
    known = np.array([t[0], t[-1], *steps])
    for j in log.joints:
        error = np.abs(fit.residual[j])
        at = float(t[np.argmax(error)])
        largest = float(error.max())
        is_near = np.abs(t - at) <= EVENT_WIDTH
        elsewhere = error[~is_near].max(initial=0.0)
        is_little = np.sum(error[is_near] ** 2) < LEAST_SHARE * fit.energy[j]
        is_known = np.min(np.abs(known - at)) <= 3.0 * EVENT_WIDTH
        stands_out = largest > _EVENT_OVER_REST * elsewhere > 0.0
        if is_little or is_known or not stands_out:
            continue
        unit = log.torque_unit(j)
        yield make_explanation(
            kind=EVENT,
            joints=[j],
            what=f"a one-off event at t = {at:.3g} s (a knock, a contact, a lost"
            f" packet): the error is {largest:.3g} {unit} in joint {j + 1}, over"
            f" {_EVENT_OVER_REST:g} times that at any other moment.",
            certainty=likely("an effect of the arm itself would recur"),
            remedy=f"exclude {EVENT_WIDTH:g} s around it",
            repair=partial(without_moment, at=at),
            where=f"t = {at:.3g} s, {joints_text([j])}",
            at=at,
            span=(at - 0.5 * EVENT_WIDTH, at + 0.5 * EVENT_WIDTH),
        )
        return


def without_moment(
    run: Measurements, at: float, width: float = EVENT_WIDTH
) -> Measurements:
    """Return the run without the rows within half of a width of an instant [s]."""
    return run.rows(np.abs(run.t - at) > 0.5 * width)


def not_excited(problem: Problem, rows: FilteredRuns) -> Iterator[Issue]:
    """Yield an issue that lists the base parameters which the data do not determine.

    Parameters
    ----------
    problem : Problem
        Of the robot that was logged.
    rows : FilteredRuns
        The filtered rows of the run.

    Returns
    -------
    iterator of Issue
        At most one: a warning where a quarter of the base parameters or more is not
        determined, else a note.
    """
    model = problem.model()
    data = compress(rows, model)
    known = regression_uncertainty(
        make_task(problem, model, data),
        data,
        base_rows(model, problem.independent),
        white=True,
    )
    # A base parameter is named after its first link parameter, "m3 + 0.2 m4" after m3.
    dark = [x.name.split(" ")[0] for x in known.base if x.verdict == NOT_SEEN]
    if dark:
        total = len(known.base)
        joint_of = {p.name: p.joint for p in model.parameters}  # from 1; 0: of none
        joints = sorted({joint_of[name] - 1 for name in dark if joint_of[name]})
        severity = "warning" if len(dark) > c.UNRELATED * total else "note"
        yield make_explanation(
            kind="poor excitation",
            severity=severity,
            where=joints_text(joints) if joints else "the robot",
            what=f"{len(dark)} of {total} base parameters are not identifiable from this"
            f" motion: {', '.join(dark)}.",
            certainty=likely("by least squares, were its error white noise"),
            remedy="move these joints farther, faster and independently of each other, or add"
            " runs that do",
            changes=(Change("record", "record a motion that excites every joint"),),
            figures={"base_parameters": total, **counts(known.base), "names": dark},
        )
