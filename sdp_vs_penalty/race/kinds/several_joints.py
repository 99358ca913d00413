"""Effects of the arm that act on several joints at once, and so resemble a fault of the log:
a constant force on the last link, always or for a time, gears that couple two joints.

What one joint's own motion makes is in its own columns; a load that all runs carry is in
the last link's parameters. Which effect it is, a diagnosis judges.
"""

from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from itertools import pairwise

import numpy as np

from sdp_vs_penalty.race import constants as c
from sdp_vs_penalty.race.chain import LogTransform
from sdp_vs_penalty.race.evidence import Evidence, ViewFit
from sdp_vs_penalty.race.fault import prior_of_one_of
from sdp_vs_penalty.race.kinds.of_one_part import loads_on_last_link
from sdp_vs_penalty.race.likelihood import Likelihood
from sdp_vs_penalty.race.records import ExtraTorque, Hypothesis, Part
from sdp_vs_penalty.robot.arrays import Indices

#: Standard deviation beforehand of a force [N] and of its moment [N m].
_FORCE, _MOMENT = 30.0, 6.0
#: Prior standard deviation of the gears' ratio [-].
_SD_OF_RATIO = 1.0
#: Prior standard deviation of the gears' friction and inertia, as a share of the joint's
#: torque [-].
_SD_OF_SHARE = 0.3
#: How long somebody pushes [s].
_SPANS = (0.5, 1.0, 1.5, 2.5, 4.0)
#: Parameters of a link, and how many of them make its weight.
_PARAMETERS_OF_A_LINK, _STATIC = 10, 4


def propose(evidence: Evidence, fit: ViewFit) -> Iterator[Hypothesis]:
    """Yield effects of several joints: a load whose weight the controller subtracts, a
    force on the last link, and a coupling of each joint with each neighbour."""
    model = evidence.log.data.shared
    if model is None or not len(model.rigid_indices):
        return
    if any(fit.transform.gravity):
        weightless = replace(fit.transform, gravity=(0.0, 0.0, 0.0))
        heavy, _ = loads_on_last_link(evidence, fit, weightless)
        yield Hypothesis(
            kind="tool weight removed",
            joints=(),
            log_prior=prior_of_one_of(1),
            transform=fit.transform,
            extra_torque=heavy,
            effect="a load on the last link whose weight the controller subtracted",
            by_controller="the torques hold the inertia of a load on the last link without"
            " its weight: the controller subtracted that",
        )
    yield from _forces(evidence, fit, model.rigid_indices[-_PARAMETERS_OF_A_LINK:])
    yield from _couplings(evidence.log, fit.transform)


def _forces(
    evidence: Evidence, fit: ViewFit, last_link: Indices
) -> Iterator[Hypothesis]:
    """Yield a constant force on the last link, over the whole log and in the spans in which
    the arm errs most.

    A force F at the point r acts like the weight of a mass there under a gravity along F:
    its torque is linear in F_k and r_i F_k. last_link (10,) : indices of its parameters.
    """
    log, current = evidence.log, fit.transform
    static = last_link[:_STATIC]
    columns = [
        log.columns(replace(current, gravity=tuple(axis)), is_still=True)[:, :, static]
        for axis in np.eye(3).tolist()
    ]
    sd = np.tile([_FORCE, _MOMENT, _MOMENT, _MOMENT], 3)
    force = ExtraTorque(np.concatenate(columns, axis=2), sd)
    what = "a constant force on the last link"
    yield Hypothesis(
        "force", (), prior_of_one_of(1), current, extra_torque=force, effect=what
    )
    odds = -c.LOG_ODDS_AGAINST_DIFFERENCE - float(np.log(c.ROWS))
    for span in _worst_spans(evidence, fit):
        at = evidence.rows_of(span)[None, :, None]
        pushed = ExtraTorque(force.columns * at, force.sd, span=span)
        yield Hypothesis(
            "passing force", (), odds, current, part=span, extra_torque=pushed
        )


def _couplings(log: Likelihood, current: LogTransform) -> Iterator[Hypothesis]:
    """Yield gears that couple each joint with its neighbour: the motor of either one turns
    with the other joint as well."""
    for first, second in pairwise(range(log.n)):
        for a, b in ((first, second), (second, first)):
            extra_torque_at = partial(_coupling, log, a, b, current)
            yield Hypothesis(
                kind="coupling",
                joints=(a, b),
                log_prior=prior_of_one_of(2 * log.n),
                transform=current,
                extra_torque=extra_torque_at(0.0),
                extra_torque_at=extra_torque_at,
                effect=f"gears that couple joints {first + 1} and {second + 1}",
            )


def _worst_spans(evidence: Evidence, fit: ViewFit) -> list[Part]:
    """List, for each duration of a push, the span of rows with the largest excess of
    squared residual; spans that a force explains already do not count."""
    t = evidence.log.data.motion.t
    errors = fit.weights @ evidence.residual(fit) ** 2  # (M,)
    for explained in fit.view.extra_torques:
        if explained.span is not None:
            errors[evidence.rows_of(explained.span)] = 0.0
    summed = np.concatenate([[0.0], np.cumsum(errors)])
    spans = []
    for seconds in _SPANS:
        first = np.flatnonzero(t + seconds <= t[-1])
        if not len(first):
            continue
        ends = np.searchsorted(t, t[first] + seconds, side="right")
        # A sum of K squares of unit variance errs by sqrt(2 K); rows come unevenly.
        count = ends - first
        excess = summed[ends] - summed[first] - count * summed[-1] / len(t)
        k = int(np.argmax(excess / np.sqrt(count)))
        before = t[first[k] - 1] if first[k] else t[0] - 1.0
        spans.append(Part(after=float(before), until=float(t[ends[k] - 1])))
    return spans


def _coupling(
    log: Likelihood, a: int, b: int, current: LogTransform, ratio: float
) -> ExtraTorque:
    """Return the extra torque of gears by which the motor of joint b also turns with joint
    a (both from 0), at the velocity dq_b + ratio dq_a.

    Motor a lacks ratio times the torque of motor b, less its friction and inertia; on b
    act friction and inertia at the motor's velocity. The first size is the ratio.
    """
    motion, torque = log.motion(current), log.torques(current)
    velocity = motion.dq[:, b] + ratio * motion.dq[:, a]
    friction = [np.tanh(velocity / width) for width in c.COULOMB_WIDTHS]
    of_a = [-torque[b], motion.dq[:, b], motion.ddq[:, b], *friction]
    of_b = [motion.dq[:, a], motion.ddq[:, a], *friction]
    columns = np.zeros((log.n, log.data.count, len(of_a) + len(of_b)))
    columns[a, :, : len(of_a)] = np.column_stack(of_a)
    columns[b, :, len(of_a) :] = np.column_stack(of_b)
    rms_of_columns = np.sqrt(np.mean(columns**2, axis=1)).max(axis=0)
    rms_of_torques = np.sqrt(np.mean(torque**2, axis=1))  # (n,)
    load = np.repeat(rms_of_torques[[a, b]], [len(of_a), len(of_b)])
    sd = _SD_OF_SHARE * load / np.maximum(rms_of_columns, 1e-12)
    sd[0] = _SD_OF_RATIO
    recompute = partial(_coupling, log, a, b, ratio=ratio)
    return ExtraTorque(columns, np.maximum(sd, 1e-12), recompute=recompute)
