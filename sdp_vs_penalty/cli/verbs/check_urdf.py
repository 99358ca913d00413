"""The verb check-urdf: which inertials are possible."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from sdp_vs_penalty.cli.options import json_option

if TYPE_CHECKING:
    from sdp_vs_penalty.check.urdf import LinkCheck


def verb(
    urdf: Annotated[Path, typer.Argument(metavar="robot.urdf", help="File to check.")],
    json_file: Annotated[Path | None, json_option("figures")] = None,
    fix: Annotated[
        Path | None,
        typer.Option(metavar="fixed.urdf", help="Copy to write, with the nearest consistent inertials."),
    ] = None,
) -> None:
    """Check the inertials of a URDF: which bodies are impossible, by how much, the nearest possible.

    Exit code 1 where one is impossible.
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
            console.explain(
                f"{c.link}: consistent but implausible: radius of gyration {c.gyration:.3g} m for "
                f"{c.mass:.3g} kg, and its body reaches {c.reach:.3g} m. The torques of a link that "
                "hardly moves do not determine its mass and inertia separately; the default method of "
                "`identify` keeps every link in its body."
            )
    if massless:
        console.explain(
            f"Moving links without an inertial: {', '.join(massless)}. Simulators refuse or drop such "
            "links. `identify` does not need inertials, and `export --urdf` adds them."
        )
    if fix is not None:
        write_nearest(urdf, checks, fix)
        console.written(fix)
    if not all(check.consistent for check in checks):
        raise typer.Exit(1)


def _urdf_table(checks: Sequence[LinkCheck]) -> None:
    """The verdict; one row a link; the nearest consistent inertia where one is needed."""
    from sdp_vs_penalty import show
    from sdp_vs_penalty.cli import console

    broken = [c.link for c in checks if not c.consistent]
    if not checks:
        console.say("The file has no inertials.", style="bold")
        return
    verdict = f"{show.count(len(checks), 'inertial')} checked: "
    verdict += f"{', '.join(broken)} physically impossible." if broken else "all are consistent."
    console.say(verdict, style="bold")
    rows = [
        (
            c.link,
            c.verdict,
            console.number(c.mass, 4),
            console.number(c.triangle_margin),
            console.number(c.pseudo_inertia_margin),
        )
        for c in checks
    ]
    heads = ("link", "verdict", "mass [kg]", "triangle [kg m^2]", "pseudo-inertia")
    console.table("Inertials: mass and margins (negative: violated)", heads, rows, words=2)
    for c in checks:
        if c.nearest is not None:
            console.explain(
                f"{c.link}: nearest consistent inertia about the centre of mass, axes of the link "
                f"(Frobenius norm, {c.distance:.3g} kg m^2 away; mass and centre of mass kept):"
            )
            for key, value in c.nearest.urdf_attributes.items():
                console.say(f'  {key}="{value}"')
