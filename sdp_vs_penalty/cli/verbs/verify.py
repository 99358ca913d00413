"""The verb verify: proofs of optima, checked in exact arithmetic."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from sdp_vs_penalty.errors import InputError


def verb(
    proofs: Annotated[
        list[Path],
        typer.Argument(metavar="proof.json ...", help="Proofs, or folders that are searched for them."),
    ],
) -> None:
    """Check proofs of optimality in exact arithmetic, independently of every solver.

    Exit code 1 if one is refused. The checker is one file on Python's standard library alone.
    Example: sdp-vs-penalty verify proof.json
    """
    from sdp_vs_penalty.cli import console
    from sdp_vs_penalty.solvers import verify_proof
    from sdp_vs_penalty.solvers.proof import verdict

    files = [f for p in proofs for f in (sorted(p.rglob("*proof.json")) if p.is_dir() else [p])]
    if not files:
        raise InputError("no file named *proof.json in this folder", "name the proofs", proofs[0])
    refused = 0
    for path in files:
        holds, text = verdict(path)
        refused += not holds
        console.say(text)
    console.warn(f"checker: {verify_proof.__file__}")
    if refused:
        raise typer.Exit(1)
