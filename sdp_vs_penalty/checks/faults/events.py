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
        self, log: Likelihood, now: LogTransform, score: ArmFit
    ) -> Iterator[LogTransform]:
        motion = log.data.motion
        order = list(now.order)
        laws = log.data.laws
        span = float(np.ptp(motion.t))
        heard = log.filter_gain(now)[:, :, None]
        gains = [
            score.gained(score.rows.rest(heard * x[order])).max(axis=1)
            for x in laws.values()
        ]
        for j in np.flatnonzero(score.poor).tolist():  # the likeliest of each
            yield now.with_event(LogEvent(j, [*laws][int(np.argmax(gains, axis=0)[j])]))
        steps = np.linspace(
            0.12, 0.88, c.ROWS // 2
        )  # two rows each: the wrong moment explains nothing
        events = [None, *(float(motion.t[0] + s * span) for s in steps)]
        shapes = np.hstack([LogEvent(0, at).shape(motion.t) for at in events])
        found = score.gained(score.rows.rest(heard * shapes)) * log.moving[:, None]
        forth = (motion.dq[:, order].T > 0.0) * 1.0
        for side in (shapes[:, 1:] > 0.0, shapes[:, 1:] <= 0.0):
            share = forth @ side / np.maximum(side.sum(axis=0), 1)
            found[:, 1:] *= np.minimum(share, 1.0 - share) > _WAYS
        for some, at in ((found[:, :1], events[:1]), (found[:, 1:], events[1:])):
            j, k = divmod(int(np.argmax(some)), len(at))
            if some[j, k] > 0.0:
                yield now.with_event(LogEvent(j, at[k]))

    def elements(self, log: Likelihood, repair: LogTransform) -> Iterator[Fault]:
        for event in repair.events:
            j = event.joint
            t = event.at
            without = repair.without(event)
            name = joints_text([j])
            unit = log.problem.robot.torque_units[j]
            if isinstance(t, str):
                what = (
                    f"the torque of {name} holds a law that the model lacks, most like"
                    f" {t}."
                )
                remedy = "identify, and let `diagnose` name it"
                cost = choices(log.n * len(LAWS))
                yield Fault(
                    f"law: {t}", "note", (j,), what, remedy, without, cost, mends=False
                )
                continue
            # As far as the fit of its joint needs it.
            score = log.score(repair)
            lacking = log.rows(without)
            shape = event.shape(log.data.motion.t)
            x = lacking.rest(log.filter_gain(repair)[:, :, None] * shape)[j, :, 0]
            away = score.channels[j] - lacking.apart[j] @ score.theta
            size = float(x @ away / max(x @ x, 1e-300))
            kind = "torque drift"
            many = log.n
            place = ""
            figures = {"size": size}
            how = f"drifts by {size:+.3g} {unit} from the first row to the last"
            remedy = "let the sensor warm up and set its zero before the run"
            if t is not None:
                # Moments that a low-passed torque tells apart.
                kind = "torque step"
                many = log.n * c.ROWS // c.PARTS
                place = f"{name}, t = {t:.4g} s"
                how = f"steps by {size:+.3g} {unit} at t = {t:.4g} s and stays there"
                remedy, figures["t"] = (
                    "cut the run there, or find out what touched the arm",
                    t,
                )
            what = f"the torque of {name} {how}."
            cost = choices(many) + 2.0 * c.ODDS
            yield Fault(
                kind,
                "warning",
                (j,),
                what,
                remedy,
                without,
                cost,
                place,
                mends=False,
                figures=figures,
            )
