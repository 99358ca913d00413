"""What differs in one run, or from an instant on: any change of the log that all rows may
need, there alone; a load on the last link, another arm, the friction of a joint.

A load phi adds Y_last phi on the part's rows, Y_last the regressor of the last link; joint j's
friction adds x_1 c + x_2 (w - c) + ..., c its dry friction, w its velocity over the root mean
square (then c of other widths): x_1 is what it has more at that velocity.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace

import numpy as np
from scipy.special import ndtr

from sdp_vs_penalty.race import constants as c
from sdp_vs_penalty.race.chain import LogTransform
from sdp_vs_penalty.race.evidence import Evidence, ViewFit
from sdp_vs_penalty.race.records import ExtraTorque, Hypothesis, Part
from sdp_vs_penalty.race.rows import DRY, OFFSET, ROTOR, VISCOUS
from sdp_vs_penalty.regression.linalg import min_norm_lstsq
from sdp_vs_penalty.robot.arrays import Array, nonzero_or_one

#: Instants at which a run may change, in shares of its rows.
_CUTS = np.arange(3, 14) / 16.0
#: Standard deviation of a Gaussian low-pass that halves at its cutoff, times the cutoff.
_SPREAD = 0.187
#: Distances of instants from the likeliest, in shares of the rows; then of the likeliest
#: of these.
NEARER = np.arange(-3, 4) / 64.0, np.arange(-3, 4) / 256.0
#: Standard deviation beforehand of a load: of its mass as shares of the arm's mass, for a
#: heavy and a light one, its centre [m], and its radius of gyration squared [m^2].
_SHARES_OF_ARM, _CENTRE, _GYRATION = (1.0, 0.05), 0.5, 0.3
#: The same of friction, as a share of what links leave of the joint's torque [-].
_SHARE_OF_TORQUE = 0.5


def parts_of(evidence: Evidence) -> list[Part]:
    """List the parts that may differ: each of several runs, or what follows an instant
    of a single one."""
    runs = np.unique(evidence.log.data.run)
    if len(runs) > 1:
        return [Part(run=int(run)) for run in runs]
    t = evidence.log.data.motion.t
    return [Part(after=float(t[int(share * len(t))])) for share in _CUTS]


def parts_near(evidence: Evidence, instant: float, distances: Array) -> list[Part]:
    """List the parts that begin near an instant [s], one for each of ``distances`` (k,)
    from it, in shares of the rows."""
    t = evidence.log.data.motion.t
    rows = np.searchsorted(t, instant) + (distances * len(t)).astype(int)
    return [Part(after=float(t[row])) for row in np.unique(rows)]


def propose(evidence: Evidence, fit: ViewFit) -> Iterator[Hypothesis]:
    """Yield what may differ in each part: a load, the whole arm if it is badly explained,
    and, if the parts are runs, the friction of each joint."""
    parts = parts_of(evidence)
    yield from in_parts(evidence, fit, parts, len(parts))
    if parts[0].run is None:
        return
    none = evidence.log.as_logged
    odds = -c.LOG_ODDS_AGAINST_DIFFERENCE - float(np.log(len(parts) * evidence.log.n))
    for j in evidence.log.joints:
        friction = friction_of(evidence, fit, j)
        for part in parts:
            at = evidence.rows_of(part)[None, :, None]
            extra = replace(friction, columns=friction.columns * at)
            yield Hypothesis(
                "another friction",
                (j,),
                odds,
                none,
                part=part,
                extra_torque=extra,
                arm_difference="friction",
            )


def _share_of_rows(evidence: Evidence, part: Part) -> Array:
    """Return the share of each row (M,) that belongs to a part, from 0 to 1.

    What begins at an instant fades in over filtered rows, by the step response of a Gaussian
    low-pass at the log's cutoff.
    """
    if part.after is None:
        return evidence.rows_of(part).astype(float)
    data = evidence.log.data
    spread = _SPREAD / data.cutoff
    return np.asarray(ndtr((data.motion.t - part.after) / spread))


def in_parts(
    evidence: Evidence, fit: ViewFit, parts: Sequence[Part], n_possible: int
) -> Iterator[Hypothesis]:
    """Yield a load on the last link in each part, and other links there if the arm is badly
    explained; ``n_possible`` : number of parts that are equally likely beforehand."""
    none = evidence.log.as_logged
    loads = loads_on_last_link(evidence, fit, fit.transform)
    arm = another_arm(evidence, fit) if fit.is_badly_explained else None
    odds = -c.LOG_ODDS_AGAINST_DIFFERENCE - float(np.log(n_possible))
    for part in parts:
        at = _share_of_rows(evidence, part)[None, :, None]
        for load in loads:
            # Of what follows an instant the load may have been put down.
            is_positive = part.run is not None
            extra = ExtraTorque(load.columns * at, load.sd, is_positive=is_positive)
            one_of = odds - float(np.log(len(loads)))
            yield Hypothesis(
                "another load",
                (),
                one_of,
                none,
                part=part,
                extra_torque=extra,
                arm_difference="load",
            )
        if arm is not None:
            extra = ExtraTorque(arm.columns * at, arm.sd)
            rare = odds - c.LOG_ODDS_AGAINST_DIFFERENCE
            yield Hypothesis(
                "another arm",
                (),
                rare,
                none,
                part=part,
                extra_torque=extra,
                arm_difference="links",
            )


def confined(
    hypotheses: Iterable[Hypothesis],
    as_logged: LogTransform,
    parts: Sequence[Part],
    odds_against: float,
    is_suspect: bool = False,
) -> Iterator[Hypothesis]:
    """Yield hypotheses about all rows again, each confined to one part of them.

    Only those about a number near its present size are, but in suspect parts all. Left out
    is what cannot be of a part alone: a change that is lost when the transform of an
    unchanged log, ``as_logged``, follows it.

    odds_against : log-odds against a fault of one part, beyond those of all rows.
    """
    for hypothesis in hypotheses:
        is_near = hypothesis.number is not None and hypothesis.transform == as_logged
        is_tried = (
            hypothesis.extra_torque is None and hypothesis.is_friction_dissipative
        )
        if not is_tried or not (is_near or is_suspect):
            continue
        transform = (
            hypothesis.number.at(as_logged, hypothesis.number.step)
            if hypothesis.number and is_near
            else hypothesis.transform
        )
        if transform.followed_by(as_logged) != transform:
            continue
        odds = hypothesis.log_prior - odds_against
        in_part = replace(hypothesis, log_prior=odds, tells_by_friction=False)
        for part in parts:
            if part.run is not None or hypothesis.may_begin_in_run:
                yield replace(in_part, part=part)


def another_arm(evidence: Evidence, fit: ViewFit) -> ExtraTorque | None:
    """Return the extra torque of links that differ from the arm's, with the prior of its
    links; None for an arm without links."""
    columns = evidence.log.raw(fit.transform)
    if not columns.shape[2]:
        return None
    spread = fit.scale * np.linalg.cholesky(evidence.covariance_of_links)
    return ExtraTorque(columns @ spread, np.ones(columns.shape[2]))


def friction_of(evidence: Evidence, fit: ViewFit, j: int) -> ExtraTorque:
    """Return the extra torque of joint j's friction: dry friction of several widths, and
    viscous; see the module's equation."""
    log, transform = evidence.log, fit.transform
    own_columns = log.data.own_columns[transform.order[j]] * np.sign(transform.scale[j])
    dry, velocity = own_columns[:, [DRY]], own_columns[:, [VISCOUS]]
    velocity = velocity / nonzero_or_one(float(np.sqrt(np.mean(velocity**2))))
    others = np.column_stack([velocity, own_columns[:, [DRY - 1, DRY + 1]]])
    of_friction = np.column_stack([dry, others - dry])
    columns_of_joint = np.column_stack([of_friction, own_columns[:, [ROTOR, OFFSET]]])
    torque = log.unexplained(transform, fit.links)[j]
    dry_friction = float(min_norm_lstsq(columns_of_joint, torque)[0])
    columns = np.zeros((log.n, *of_friction.shape))
    columns[j] = of_friction
    rms = float(np.sqrt(np.mean(torque**2)))
    sd = np.full(of_friction.shape[1], _SHARE_OF_TORQUE * rms)
    return ExtraTorque(columns, sd, usual=c.USUAL_FRICTION * abs(dry_friction))


def loads_on_last_link(
    evidence: Evidence, fit: ViewFit, transform: LogTransform
) -> list[ExtraTorque]:
    """List the extra torques of a heavy and of a light load on the last link, under a
    transform of the log; empty for an arm without links."""
    log = evidence.log
    model = log.data.shared
    if model is None or not len(model.rigid_indices):
        return []
    columns = log.columns(transform.arm_part)[:, :, model.rigid_indices[-10:]]
    mass = max(float(log.problem.prior_links[:, 0].sum()), 1.0)
    sd = np.array([1.0, *3 * (_CENTRE,), *6 * (_GYRATION,)])
    return [
        ExtraTorque(columns, share * fit.scale * mass * sd) for share in _SHARES_OF_ARM
    ]
