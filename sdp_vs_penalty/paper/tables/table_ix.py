"""Table IX: inertias about the centres of mass, published and ours."""

from sdp_vs_penalty.paper.tables.link_parameters import is_inertia, link_table
from sdp_vs_penalty.paper.tables.study import Study
from sdp_vs_penalty.paper.tables.table import Table

NAME = "IX"


def build(study: Study) -> Table:
    return link_table(study, NAME, "inertias about the centres of mass", is_inertia)
