"""The verb check-urdf: which inertials are possible."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from sdp_vs_penalty.cli.options import Debug

if TYPE_CHECKING:
    from sdp_vs_penalty.check.urdf import LinkCheck


def verb(
    urdf: Annotated[Path, typer.Argument(metavar="robot.urdf", help="The file to check.")],
    json_file: Annotated[
        Path | None, typer.Option("--json", metavar="out.json", help="Write the figures to this file.")
    ] = None,
    fix: Annotated[
        Path | None,
        typer.Option(metavar="fixed.urdf", help="Write a copy with the nearest consistent inertials."),
    ] = None,
    debug: Debug = False,
) -> None:
    """Check the inertials of a URDF: which bodies cannot exist, by how much, and the nearest that can.

    Exit code 1 where one cannot.
    Example: sdp-vs-penalty check-urdf robot.urdf
    """
    from sdp_vs_penalty.check.urdf import check_urdf, massless_links, write_nearest
    from sdp_vs_penalty.cli import console
    from sdp_vs_penalty.files import write_text

    checks, massless = check_urdf(urdf), massless_links(urdf)
    if json_file is not None:
        content = {
            "urdf": str(urdf),
            "links": [c.to_dict() for c in checks],
            "moving_links_without_inertial": massless,
        }
        write_text(json_file, json.dumps(content, indent=1).replace("NaN", "null") + "\n")
    _urdf_table(checks)
    for c in checks:
        if c.unlikely:
            console.out.print(
                f"{c.link}: can exist, but {c.mass:.3g} kg with this inertia lie {c.gyration:.3g} m "
                "from their centre. Torques of a link that hardly moves do not tell its mass from its "
                "inertia; `identify --method lmi-sdp-entropic` keeps both in proportion.",
                markup=False,
            )
    if massless:
        console.out.print(
            f"No inertial, though a joint moves them: {', '.join(massless)}. Simulators refuse or drop "
            "such links; `identify` needs none to begin with, and `export --urdf` adds them.",
            markup=False,
        )
    if fix is not None:
        write_nearest(urdf, checks, fix)
        console.out.print(f"written: {fix}", markup=False, soft_wrap=True)
    if not all(check.consistent for check in checks):
        raise typer.Exit(1)


def _urdf_table(checks: Sequence[LinkCheck]) -> None:
    """One row a link: margins, verdict, and the nearest consistent inertia where one is needed."""
    from rich.markup import escape

    from sdp_vs_penalty.cli.console import out, titled_table

    table = titled_table("Inertials")
    for heading in ("link", "mass [kg]", "triangle margin [kg m^2]", "pseudo-inertia margin", "verdict"):
        table.add_column(heading, justify="left" if heading in ("link", "verdict") else "right")
    for c in checks:
        numbers = [f"{c.mass:.4g}", f"{c.triangle_margin:.3g}", f"{c.pseudo_inertia_margin:.3g}"]
        table.add_row(escape(c.link), *numbers, c.verdict)
    out.print(table)
    if not checks:
        out.print("The file has no inertial at all.")
    for c in checks:
        if c.nearest is not None:
            out.print(
                f"{c.link}: nearest consistent inertia about the centre of mass, axes of the link "
                f"(Frobenius norm, {c.distance:.3g} kg m^2 away; mass and centre of mass kept):",
                markup=False,
            )
            for key, value in c.nearest.urdf_attributes.items():
                out.print(f'  {key}="{value}"', markup=False, soft_wrap=True)
