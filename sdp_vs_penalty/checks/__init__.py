"""Are these measurements any good? :func:`check.check` says it, issue by issue.

Facts are read from the file (facts/, clock.py); explanations are what a
model of the arm makes of the log (race/, explain.py, residual.py). docs/checks.md says
how a log is judged, in the order of check.py.
"""

from sdp_vs_penalty.checks.check import check, check_runs
from sdp_vs_penalty.checks.facts import mended
from sdp_vs_penalty.checks.issue import EXPLANATION, FACT, Issue
from sdp_vs_penalty.checks.report import Report

__all__ = ["EXPLANATION", "FACT", "Issue", "Report", "check", "check_runs", "mended"]
