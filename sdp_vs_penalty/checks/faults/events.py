"""Laws, drifts and steps of one joint's torque."""

from collections.abc import Iterator

import numpy as np

from sdp_vs_penalty.checks import constants as c
from sdp_vs_penalty.checks.arm_fit import ArmFit
from sdp_vs_penalty.checks.faults.fault import Fault, Transformation, choices
from sdp_vs_penalty.checks.issue import joints_text
from sdp_vs_penalty.checks.likelihood import Likelihood
from sdp_vs_penalty.checks.regression_data import LAWS
from sdp_vs_penalty.checks.repair import LogEvent, LogTransform

#: Share of the time on either side of a step that the joint has to move each way: else
#: it is friction's.
_WAYS = 0.15


class Beside(Transformation):
    """What one joint's torque holds beside the arm's: a law of its own motion that the
    model lacks, no fault of the log, which contends with all that may be; a drift with
    time; a step at some moment (a contact, a load, a zero set anew). Proposed by a
    score test: of each shape the part that the arm leaves, against the residual."""

    name = "events"

    def proposals(
        self,
        log: Likelihood,
        now: LogTransform,
        score: ArmFit,
    ) -> Iterator[LogTransform]:
        """Propose repairs that correct one more fault of this kind than ``now`` does."""
        yield from _laws(log, now, score)
        t = log.data.motion.t
        heard = log.filter_gain(now)[:, :, None]
        drift = score.gained(heard * LogEvent(0).shape(t))
        j = int(np.argmax(drift[:, 0] * log.moving))
        if drift[j, 0] * log.moving[j] > 0.0:
            yield now.with_event(LogEvent(j))
        yield from _likeliest_step(log, now, score)

    def elements(self, log: Likelihood, repair: LogTransform) -> Iterator[Fault]:
        """Yield the faults of this kind that a repair corrects."""
        for event in repair.events:
            if isinstance(event.at, str):
                yield _law(log, repair, event)
            elif event.at is None:
                yield _drift(log, repair, event)
            else:
                yield _step(log, repair, event, event.at)


def _laws(
    log: Likelihood,
    now: LogTransform,
    score: ArmFit,
) -> Iterator[LogTransform]:
    """Of each joint that is poorly explained the law that explains most."""
    order = list(now.order)
    names = [*log.data.laws]
    heard = log.filter_gain(now)[:, :, None]
    gains = [
        score.gained(heard * law[order]).max(axis=1) for law in log.data.laws.values()
    ]
    best = np.argmax(gains, axis=0)
    for j in np.flatnonzero(score.poor).tolist():
        yield now.with_event(LogEvent(j, names[best[j]]))


def _likeliest_step(
    log: Likelihood,
    now: LogTransform,
    score: ArmFit,
) -> Iterator[LogTransform]:
    """The step that explains most, of all joints and moments."""
    motion = log.data.motion
    # Two rows each: the wrong moment explains nothing.
    shares = np.linspace(0.12, 0.88, c.ROWS // 2)
    moments = (motion.t[0] + shares * np.ptp(motion.t)).tolist()
    first_rows = np.searchsorted(motion.t, moments, side="right")
    first_rows = np.minimum(first_rows, len(motion.t) - 1)
    gains = score.gained_by_steps(log.filter_gain(now), first_rows)
    gains = gains * log.moving[:, None]
    goes_forth = motion.dq[:, list(now.order)].T > 0.0
    n_forth = np.cumsum(goes_forth, axis=1)[:, first_rows - 1]
    n_forth_in_all = goes_forth.sum(axis=1)[:, None]
    n_after = len(motion.t) - first_rows
    share_before = n_forth / np.maximum(first_rows, 1)
    share_after = (n_forth_in_all - n_forth) / n_after
    for share in (share_before, share_after):
        gains = gains * (np.minimum(share, 1.0 - share) > _WAYS)
    j, k = divmod(int(np.argmax(gains)), len(moments))
    if gains[j, k] > 0.0:
        yield now.with_event(LogEvent(j, moments[k]))


def _size(log: Likelihood, repair: LogTransform, event: LogEvent) -> float:
    """[N m or N] how large a drift or step is, as far as the fit of its joint needs
    it."""
    j = event.joint
    score = log.score(repair)
    without = log.rows(repair.without(event))
    shape = event.shape(log.data.motion.t)
    x = without.rest(log.filter_gain(repair)[:, :, None] * shape)[j, :, 0]
    left = score.channels[j] - without.apart[j] @ score.theta
    return float(x @ left / max(float(x @ x), 1e-300))


def _law(log: Likelihood, repair: LogTransform, event: LogEvent) -> Fault:
    return Fault(
        kind=f"law: {event.at}",
        severity="note",
        joints=(event.joint,),
        what=f"{joints_text([event.joint])} behaves as if it had {event.at}, which the"
        " model lacks.",
        remedy="identify, and let `diagnose` name it",
        of=repair.without(event),
        cost=choices(log.n * len(LAWS)),
        mends=False,
    )


def _drift(log: Likelihood, repair: LogTransform, event: LogEvent) -> Fault:
    size = _size(log, repair, event)
    unit = log.problem.robot.torque_units[event.joint]
    return Fault(
        kind="torque drift",
        severity="warning",
        joints=(event.joint,),
        what=f"the torque of {joints_text([event.joint])} drifts by {size:+.3g} {unit}"
        " from the first row to the last.",
        remedy="let the sensor warm up and set its zero before the run",
        of=repair.without(event),
        cost=choices(log.n) + 2.0 * c.ODDS,
        mends=False,
        figures={"size": size},
    )


def _step(
    log: Likelihood,
    repair: LogTransform,
    event: LogEvent,
    t: float,
) -> Fault:
    """A step at t [s]; its prior counts the moments that a low-passed torque tells
    apart."""
    size = _size(log, repair, event)
    name = joints_text([event.joint])
    unit = log.problem.robot.torque_units[event.joint]
    return Fault(
        kind="torque step",
        severity="warning",
        joints=(event.joint,),
        what=f"the torque of {name} steps by {size:+.3g} {unit} at t = {t:.4g} s and"
        " stays there.",
        remedy="cut the run there, or find out what touched the arm",
        of=repair.without(event),
        cost=choices(log.n * c.ROWS // c.PARTS) + 2.0 * c.ODDS,
        place=f"{name}, t = {t:.4g} s",
        mends=False,
        figures={"size": size, "t": t},
    )
