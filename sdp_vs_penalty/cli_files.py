"""Verbs about files: what a user brings, and what a user takes away. Registered by cli.py."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from sdp_vs_penalty.urdf_check import LinkCheck

Debug = Annotated[bool, typer.Option("--debug", help="Show the traceback of an error.")]


def register(app: typer.Typer) -> None:
    """Add this file's verbs to the command line."""
    app.command("export")(export_model)
    app.command("check-urdf")(check_urdf_file)


def export_model(
    model: Annotated[Path, typer.Argument(metavar="model.json", help="Written by identify.")],
    out: Annotated[
        Path,
        typer.Option(
            metavar="out.urdf|.xml|.json|.py",
            help="File to write; the suffix chooses URDF, MJCF (MuJoCo), JSON or a NumPy function.",
        ),
    ],
    urdf: Annotated[
        Path | None,
        typer.Option(
            metavar="robot.urdf",
            help="Your own URDF: only its inertials, damping and friction are replaced.",
        ),
    ] = None,
    debug: Debug = False,
) -> None:
    """Take a model to a simulator or a controller; refuses an inertial that is physically impossible.

    Example: [cyan]sdp-vs-penalty export model.json --out robot.urdf[/cyan]
    """
    from sdp_vs_penalty import console
    from sdp_vs_penalty.estimate import load_estimate
    from sdp_vs_penalty.export import export

    left_out = export(load_estimate(model), out, urdf)
    console.out.print(f"written: {out}", markup=False, soft_wrap=True)
    if left_out:
        console.err.print(
            f"{out.suffix} has no place for: {', '.join(left_out)}; export to .json or .py has them.",
            markup=False,
            soft_wrap=True,
        )


def check_urdf_file(
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

    Exit code 1 where one cannot. Example: [cyan]sdp-vs-penalty check-urdf robot.urdf[/cyan]
    """
    from sdp_vs_penalty import console
    from sdp_vs_penalty.files import write_text
    from sdp_vs_penalty.urdf_check import check_urdf, write_nearest

    checks = check_urdf(urdf)
    if json_file is not None:
        content = {"urdf": str(urdf), "links": [c.to_dict() for c in checks]}
        write_text(json_file, json.dumps(content, indent=1).replace("NaN", "null") + "\n")
    _urdf_table(checks)
    if fix is not None:
        write_nearest(urdf, checks, fix)
        console.out.print(f"written: {fix}", markup=False, soft_wrap=True)
    if not all(check.consistent for check in checks):
        raise typer.Exit(1)


def _urdf_table(checks: Sequence[LinkCheck]) -> None:
    """One row a link: margins, verdict, and the nearest consistent inertia where one is needed."""
    from rich import box
    from rich.markup import escape
    from rich.table import Table

    from sdp_vs_penalty.console import out

    table = Table(title="Inertials", title_justify="left", box=box.SIMPLE_HEAD, show_edge=False)
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
            text = " ".join(f'{k}="{v}"' for k, v in c.nearest.urdf_attributes.items())
            out.print(
                f"{c.link}: nearest consistent inertia about the centre of mass, axes of the link "
                f"(Frobenius norm, {c.distance:.3g} kg m^2 away; mass and centre of mass kept): {text}",
                markup=False,
                soft_wrap=True,
            )
