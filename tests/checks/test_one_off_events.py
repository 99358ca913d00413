"""What a motion does once is no one-off event."""

from sdp_vs_penalty import check, load_problem
from sdp_vs_penalty.simulation.hidden_runs import hidden_runs


def test_the_fastest_moment_of_a_motion_is_no_event():
    """A joint passes its largest velocity once: friction there has no other witness."""
    ur10e = load_problem("ur10e")
    hidden = [("presliding_hysteresis", [5])]
    run = hidden_runs(ur10e, hidden, "medium", 7, 3).runs[2]
    (report,) = check(ur10e, run, thorough=False)
    assert report.errors_and_warnings == ()
