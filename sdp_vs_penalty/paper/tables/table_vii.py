"""Table VII: all parameters of the 2R toy robot, published and ours."""

from sdp_vs_penalty.paper.tables.link_parameters import link_table
from sdp_vs_penalty.paper.tables.study import Study
from sdp_vs_penalty.paper.tables.table import Table

NAME = "VII"
PROBLEMS = ("two_link",)


def build(study: Study) -> Table:
    return link_table(study, NAME, "parameters", lambda _: True)
