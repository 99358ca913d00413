"""The rows of one run, as they are compared with those of others."""

from dataclasses import dataclass

from sdp_vs_penalty.checks.likelihood import Likelihood
from sdp_vs_penalty.checks.repair import LogTransform


@dataclass(frozen=True)
class RunLog:
    """A run's rows, their repair, and the run's name; is_part : whether the rows are a
    part of a run, whose clock the other parts share."""

    log: Likelihood
    repair: LogTransform
    name: str
    is_part: bool = False
