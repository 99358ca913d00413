"""The verb export: a model for simulators and controllers."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from sdp_vs_penalty.cli.options import Debug

if TYPE_CHECKING:
    pass


def verb(
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

    Example: sdp-vs-penalty export model.json --out robot.urdf
    """
    from sdp_vs_penalty.cli import console
    from sdp_vs_penalty.estimation.estimate import load_estimate
    from sdp_vs_penalty.export import export

    left_out = export(load_estimate(model), out, urdf)
    console.out.print(f"written: {out}", markup=False, soft_wrap=True)
    if urdf is None and out.suffix.lower() in (".urdf", ".xml"):
        own = "; --urdf robot.urdf edits your own URDF and keeps its names and meshes"
        console.err.print(
            "moving links are named link1, link2 ...: a model.json knows only the joints' names"
            f"{own if out.suffix.lower() == '.urdf' else ''}.",
            markup=False,
            soft_wrap=True,
        )
    if left_out:
        console.err.print(
            f"{out.suffix} has no place for: {', '.join(left_out)}; export to .json or .py has them.",
            markup=False,
            soft_wrap=True,
        )
