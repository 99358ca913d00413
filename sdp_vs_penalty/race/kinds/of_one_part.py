"""What differs in one run, or from an instant on: a torque's gain, an encoder's zero, a load
on the last link, a joint's sign, an order of two torques.

A load phi adds Y_last phi on the part's rows, Y_last the regressor of the last link.
"""

from collections.abc import Iterator
from itertools import combinations

import numpy as np

from sdp_vs_penalty.race import constants as c
from sdp_vs_penalty.race.chain import LogTransform
from sdp_vs_penalty.race.evidence import Evidence, ViewFit
from sdp_vs_penalty.race.kinds.sign import SIGNS, with_sign
from sdp_vs_penalty.race.kinds.zero import zero_number
from sdp_vs_penalty.race.likelihood import Likelihood
from sdp_vs_penalty.race.records import Further, Hypothesis, Number, Part

#: Instants at which a run may change, in shares of its rows.
_CUTS = np.arange(3, 14) / 16.0
#: Standard deviation beforehand of a gain (natural logarithm), and of a zero [rad].
_SD_OF_GAIN, _SD_OF_ZERO = 0.5, 0.1
#: The same of a delay of all torques [s].
_SD_OF_DELAY = 0.05
#: Standard deviation of a load: of its mass as a share of the arm's mass, its centre
#: [m], and its radius of gyration squared [m^2].
_SHARE_OF_ARM, _CENTRE, _GYRATION = 1.0, 0.5, 0.3
#: Signs and orders of single runs are tried where so large a share of a torque's energy
#: is left.
_CONTRADICTS = 1e-3


def parts_of(evidence: Evidence) -> list[Part]:
    """List the parts that may differ: each of several runs, or what follows an instant
    of a single one."""
    runs = np.unique(evidence.log.data.run)
    if len(runs) > 1:
        return [Part(run=int(run)) for run in runs]
    t = evidence.log.data.motion.t
    return [Part(after=float(t[int(share * len(t))])) for share in _CUTS]


def propose(evidence: Evidence, fit: ViewFit) -> Iterator[Hypothesis]:
    """Yield, of each part, a gain and a zero of each joint, and a load; of runs a delay
    too. Of an arm that leaves much, another arm, and of runs signs and orders of torques."""
    log, none = evidence.log, evidence.log.as_logged
    parts = parts_of(evidence)
    odds = -c.LOG_ODDS_AGAINST_DIFFERENCE - float(np.log(len(parts)))
    odds_of_joint = odds - float(np.log(log.n))
    numbers = [
        Number("gain", (j,), _SD_OF_GAIN, c.CALIBRATED_GAIN, is_factor=True)
        for j in log.joints
    ]
    numbers += [zero_number(log, j, _SD_OF_ZERO) for j in log.joints]
    load = load_on_last_link(evidence, fit, fit.chain)
    arm = _another_arm(evidence, fit) if (fit.shares > c.BADLY).any() else None
    every = tuple(range(log.n))
    leaves_much = bool((fit.shares > _CONTRADICTS).any())
    for part in parts:
        at = evidence.rows_of(part)[None, :, None]
        is_run = part.run is not None
        for number in numbers:
            kind = "torque gain" if number.field == "gain" else "encoder offset"
            yield Hypothesis(kind, number.joints, odds_of_joint, none, number, part)
        if is_run:
            late = Number("lead", every, _SD_OF_DELAY, c.USUAL_DELAY, step=1e-3)
            yield Hypothesis("delay", every, odds, none, late, part)
        if load is not None:
            # Of what follows an instant the load may have been put down.
            further = Further(load.columns * at, load.sd, is_positive=is_run)
            yield Hypothesis("another load", (), odds, none, part=part, further=further)
        if leaves_much and arm is not None:
            further = Further(arm.columns * at, arm.sd)
            rare = odds - c.LOG_ODDS_AGAINST_DIFFERENCE
            yield Hypothesis("another arm", (), rare, none, part=part, further=further)
        if leaves_much and is_run:
            yield from _signs_and_orders(log, part, odds_of_joint)


def _signs_and_orders(log: Likelihood, run: Part, odds: float) -> Iterator[Hypothesis]:
    """Yield other signs of each joint and an exchange of each two torques in one run;
    odds : prior log-odds of one joint's fault."""
    none = log.as_logged
    for j in log.joints:
        for kind in SIGNS:
            yield Hypothesis(kind, (j,), odds, with_sign(none, kind, j), part=run)
    odds_of_pair = odds - float(np.log(log.n))
    for pair in combinations(log.joints, 2):
        swapped = none.with_swap(*pair, "tau_order")
        yield Hypothesis("torque order", pair, odds_of_pair, swapped, part=run)


def _another_arm(evidence: Evidence, fit: ViewFit) -> Further | None:
    """Return the torque of links that differ, by what is known of links beforehand;
    None for an arm without links."""
    columns = evidence.log.raw(fit.chain)
    if not columns.shape[2]:
        return None
    spread = fit.scale * np.linalg.cholesky(evidence.covariance_of_links)
    return Further(columns @ spread, np.ones(columns.shape[2]))


def load_on_last_link(
    evidence: Evidence, fit: ViewFit, chain: LogTransform
) -> Further | None:
    """Return the torque of a load on the last link under a transform; None for an arm
    without links."""
    log = evidence.log
    model = log.data.shared
    if model is None or not len(model.rigid_indices):
        return None
    columns = log.columns(chain.arm_part)[:, :, model.rigid_indices[-10:]]
    mass = _SHARE_OF_ARM * max(float(log.problem.prior_links[:, 0].sum()), 1.0)
    sd = np.array([1.0, *3 * (_CENTRE,), *6 * (_GYRATION,)])
    return Further(columns, fit.scale * mass * sd)
