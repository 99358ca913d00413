"""Table VIII: masses and centres of mass, published and ours."""

from __future__ import annotations

from functools import partial

from sdp_vs_penalty.paper.tables.link_parameters import link_table

NAME = "VIII"
build = partial(
    link_table, name=NAME, title="masses and centres of mass", chosen=lambda name: name[0] in "mc"
)
