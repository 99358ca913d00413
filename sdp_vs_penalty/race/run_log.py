"""The rows of one run, as they are compared with those of others."""

from dataclasses import dataclass

from sdp_vs_penalty.race.chain import LogTransform
from sdp_vs_penalty.race.likelihood import Likelihood


@dataclass(frozen=True)
class RunLog:
    """The rows of a run under a repair."""

    #: Rows of the run.
    log: Likelihood
    #: How these rows are repaired.
    repair: LogTransform
    #: Name of the run.
    name: str
