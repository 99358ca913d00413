"""The verb export-sdp: the optimisation problem as a file."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from sdp_vs_penalty.cli.options import Debug

if TYPE_CHECKING:
    pass


def verb(
    problem: Annotated[str, typer.Argument(help="A built-in name, a folder, or a URDF file.")],
    data: Annotated[list[Path], typer.Option("--data", metavar="RUN.csv ...", help="Measured runs.")],
    out: Annotated[Path, typer.Option(metavar="FILE", help="A .dat-s (sparse SDPA) or .cbf file.")],
    method: Annotated[str, typer.Option(help="lmi-sdp, lmi-sdp-plain or lmi-sdp-entropic.")] = "lmi-sdp",
    effects: Annotated[str | None, typer.Option(metavar="a,b,c", help="As for identify.")] = None,
    debug: Debug = False,
) -> None:
    """Write the identification SDP as a file for a solver that is not in the list.

    Example: sdp-vs-penalty export-sdp panda --data run1.csv --out panda.cbf
    """
    from sdp_vs_penalty.cli import console
    from sdp_vs_penalty.export.sdp import export_sdp as write
    from sdp_vs_penalty.export.sdp import posed

    conic = posed(problem, data, method, effects)
    write(conic, out)
    rows, columns = conic.A.shape
    console.out.print(f"written: {out} ({columns} variables, {rows} rows)", markup=False, soft_wrap=True)
