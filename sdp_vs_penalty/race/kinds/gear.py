"""A gear ratio that is not the logger's: a joint's position r times too large, its torque r
times too small."""

from collections.abc import Iterator

import numpy as np

from sdp_vs_penalty.race.chain import LogTransform
from sdp_vs_penalty.race.evidence import Evidence, ViewFit
from sdp_vs_penalty.race.fault import Fault, joints_text, prior_of_one_of, times_text
from sdp_vs_penalty.race.likelihood import Likelihood
from sdp_vs_penalty.race.records import Hypothesis, at_sizes, factor_of

#: Ratios that are tried, over the logger's [-].
_RATIOS = (1.0, 0.6, 1.6)


def propose(evidence: Evidence, fit: ViewFit) -> Iterator[Hypothesis]:
    """Yield other gear ratios of each revolute joint, if the arm is poorly explained."""
    log, current = evidence.log, fit.transform
    if not fit.is_poorly_explained.any():
        return
    for j in log.revolute:
        prior = prior_of_one_of(log.n)
        number = factor_of("ratio", (j,))
        yield from at_sizes("gear ratio", prior, current, number, np.log(_RATIOS))


def list_faults(log: Likelihood, transform: LogTransform) -> Iterator[Fault]:
    """Yield a fault for each joint whose gear ratio is not the logger's: the transform
    multiplies its position by ``ratio`` and divides its torque by it."""
    for j in np.flatnonzero(np.array(transform.ratio) != 1.0).tolist():
        ratio, number = transform.ratio[j], factor_of("ratio", (j,))
        yield Fault(
            kind="gear ratio",
            of_positions="factor",
            joints=(j,),
            what=f"the gear ratio of {joints_text([j])} is another one: its position is"
            f" {times_text(ratio)}, its torque {times_text(1.0 / ratio)}.",
            remedy=f"multiply q{j + 1} (and dq{j + 1}) by {ratio:.3g} and tau{j + 1} by"
            f" {1.0 / ratio:.3g}",
            without=number.at(transform, 0.0),
            number=number,
            in_words=lambda x: f"a factor of {np.exp(x):.3g}",
            repaired_by=("ratio", "joint"),
            figures={"factor": ratio},
        )
