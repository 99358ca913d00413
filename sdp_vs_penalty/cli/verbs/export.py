"""The verb export: a model for simulators and controllers."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from sdp_vs_penalty.cli.options import Model


def verb(
    model: Model,
    out: Annotated[
        Path,
        typer.Option(
            metavar="out.urdf|.xml|.sdf|.json|.h|.csv|.script",
            help="File to write; its name chooses the format: see `list exports`.",
        ),
    ],
    urdf: Annotated[
        Path | None,
        typer.Option(
            metavar="robot.urdf",
            help="Your own URDF, of which only inertials, damping and friction are replaced.",
        ),
    ] = None,
    flange: Annotated[
        str | None,
        typer.Option(
            metavar="x,y,z", help="Flange in the last joint's frame [m], for a payload; default: 0,0,0."
        ),
    ] = None,
    force: Annotated[
        bool,
        typer.Option("--force", help="Links whose mass lies outside of their bodies, too."),
    ] = False,
) -> None:
    """Export a model to a simulator or a controller; an impossible or implausible inertial is refused.

    Example: sdp-vs-penalty export model.json --out robot.urdf
    """
    from sdp_vs_penalty.cli import console
    from sdp_vs_penalty.data.cli_parsing import numbers
    from sdp_vs_penalty.estimation.estimate import load_estimate
    from sdp_vs_penalty.estimation.verdict import NOT_JUDGED
    from sdp_vs_penalty.exporters.export import export

    estimate = load_estimate(model)
    said = estimate.verdict
    console.say(NOT_JUDGED if said is None else f"Verdict: {said.headline}")
    x, y, z = numbers("--flange", flange, 3) if flange is not None else (0.0, 0.0, 0.0)
    left_out = export(estimate, out, urdf, force=force, flange=(x, y, z))
    console.written(out)
    if urdf is None and out.suffix.lower() in (".urdf", ".xml", ".sdf"):
        own = "; --urdf robot.urdf edits your own URDF and keeps its names and meshes"
        console.warn(
            "Moving links are named link1, link2 ...: a model.json holds only the joints' names"
            f"{own if out.suffix.lower() == '.urdf' else ''}."
        )
    if left_out:
        console.warn(f"{out.suffix} files cannot hold {', '.join(left_out)}; .json files can.")
