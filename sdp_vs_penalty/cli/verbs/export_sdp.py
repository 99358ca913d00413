"""The verb export-sdp: the optimisation problem as a file."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from sdp_vs_penalty.cli.options import Data, Debug, Problem


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
    debug: Debug = False,
) -> None:
    """Write the identification SDP as a file for another solver.

    Example: sdp-vs-penalty export-sdp panda --data run1.csv --out panda.cbf
    """
    from sdp_vs_penalty.cli import console
    from sdp_vs_penalty.export.sdp import export_sdp as write
    from sdp_vs_penalty.export.sdp import posed

    conic = posed(problem, data, method, effects)
    write(conic, out)
    rows, columns = conic.A.shape
    console.written(out, f"{columns} variables, {rows} rows")
