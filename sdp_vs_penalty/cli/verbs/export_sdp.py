"""The verb export-sdp: the optimisation problem as a file."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from sdp_vs_penalty.cli.options import Data, Problem


def verb(
    problem: Problem,
    data: Data,
    out: Annotated[
        Path, typer.Option(metavar="FILE", help="File to write: .dat-s (sparse SDPA) or .cbf.")
    ],
    method: Annotated[
        str, typer.Option(help="Method: lmi-sdp or lmi-sdp-thickness, -plain, -entropic.")
    ] = "lmi-sdp",
    effects: Annotated[
        str | None, typer.Option(metavar="a,b,c", help="Effects, as for `identify`.")
    ] = None,
) -> None:
    """Write the identification SDP as a file for another solver, and FILE.json with what it means.

    The JSON holds offset and scale, with which the file's optimum becomes the loss, and the proved
    interval of that. Example: sdp-vs-penalty export-sdp panda --data run1.csv --out panda.cbf
    """
    from sdp_vs_penalty.cli import console
    from sdp_vs_penalty.exporters import sdp

    told = sdp.write_posed(problem, data, out, method, effects)
    console.written(out, f"{told['variables']} variables, {told['rows']} rows")
    console.written(f"{out}.json", f"the loss lies in [{told['lower']!r}, {told['upper']!r}]")
