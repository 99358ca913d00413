"""One race of what may explain a log's torques: faults of the measuring transform, what differs
in one run, and effects of the arm that resemble them.

:class:`race.Race` is the race; kinds/ has the hypotheses, one file each; evidence.py the
one evidence that all are scored by, on the rows of rows.py under a transform of chain.py.
"""

from sdp_vs_penalty.race.likelihood import Likelihood
from sdp_vs_penalty.race.race import Claim, Race, RaceOutcome
from sdp_vs_penalty.race.records import Hypothesis, Number, Part

__all__ = ["Claim", "Hypothesis", "Likelihood", "Number", "Part", "Race", "RaceOutcome"]
