"""What the check says of one run."""

from sdp_vs_penalty.checks import check


def report_of_run(problem, run):
    """The report of a single run, whose excitation is not judged."""
    (report,) = check(problem, run, thorough=False)
    return report
