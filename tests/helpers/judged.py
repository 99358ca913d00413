"""What the check says of one run."""

from sdp_vs_penalty.checks import Issue, check
from sdp_vs_penalty.checks.certainty import likely


def report_of_run(problem, run):
    """The report of a single run, whose excitation is not judged."""
    (report,) = check(problem, run, thorough=False)
    return report


def likely_issue(kind, severity, where, apply, **more):
    """An issue as the check says it of a likely fault."""
    words = {"what": "x", "certainty": likely("x"), "remedy": "r"} | more
    return Issue(kind=kind, severity=severity, where=where, apply=apply, **words)
