"""Table VII: all parameters of the 2R toy robot, published and ours."""

from __future__ import annotations

from functools import partial

from sdp_vs_penalty.paper.tables.link_parameters import link_table

NAME = "VII"
PROBLEMS = ("two_link",)
build = partial(link_table, name=NAME, title="parameters", chosen=lambda _: True)
