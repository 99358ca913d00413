"""Table IX: inertias about the centres of mass, published and ours."""

from __future__ import annotations

from functools import partial

from sdp_vs_penalty.paper.tables.link_parameters import link_table

NAME = "IX"
build = partial(
    link_table, name=NAME, title="inertias about the centres of mass", chosen=lambda name: name[0] == "I"
)
