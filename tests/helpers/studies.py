"""Studies of the paper's tables whose measured run does not depend on what is at hand."""

from random_robots import repeating_run

from sdp_vs_penalty import load_problem
from sdp_vs_penalty.paper.tables import Study


class SimulatedStudy(Study):
    """Without the real run."""

    run = None


class MeasuredStudy(Study):
    """The 2R with a run that repeats itself after ten seconds in place of a real one."""

    run = repeating_run(load_problem("two_link"), 0, 0.2)
