"""The verb fetch: public measurements."""

from __future__ import annotations

import shlex
import sys
from pathlib import Path
from typing import Annotated

import typer


def verb(
    names: Annotated[
        list[str] | None,
        typer.Argument(metavar="[panda|ur10e|emps|tx40] ...", help="Data sets; default: all."),
    ] = None,
    folder: Annotated[
        Path | None, typer.Option(help="Folder for the files; default: the user's cache.")
    ] = None,
) -> None:
    """Download public measurements and write them as RUN.csv files; prints their paths.

    Example: sdp-vs-penalty fetch emps
    """
    from sdp_vs_penalty.cli import console
    from sdp_vs_penalty.data.datasets import DATASETS, cache_folder, dataset
    from sdp_vs_penalty.data.datasets import fetch as fetch_dataset

    for name in [dataset(name).name for name in names or DATASETS]:
        with console.progress(f"fetching {name}"):
            remarks: list[str] = []
            paths = fetch_dataset(name, folder, say=remarks.append)
        for remark in remarks:
            print(f"sdp-vs-penalty: {remark}", file=sys.stderr)
        for path in paths:
            print(path)
        words = ["sdp-vs-penalty", "check", str(paths[0]), "--problem", dataset(name).problem]
        print(f"Next: {shlex.join(words)}", file=sys.stderr)
    kept = folder or cache_folder()
    print(f"sdp-vs-penalty: for the tables, set SDP_VS_PENALTY_DATA={kept}", file=sys.stderr)
