"""Table VIII: masses and centres of mass, published and ours."""

from sdp_vs_penalty.paper.tables.link_parameters import is_mass_or_centre, link_table
from sdp_vs_penalty.paper.tables.study import Study
from sdp_vs_penalty.paper.tables.table import Table

NAME = "VIII"


def build(study: Study) -> Table:
    return link_table(study, NAME, "masses and centres of mass", is_mass_or_centre)
