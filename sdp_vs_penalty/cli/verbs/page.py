"""The verb page: the workbench in a browser."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from sdp_vs_penalty.errors import missing_extra


def verb(
    folder: Annotated[
        Path | None,
        typer.Argument(metavar="[FOLDER]", help="Folder whose runs and URDF files the page offers."),
    ] = None,
    port: Annotated[
        int | None,
        typer.Option(min=1, max=65535, help="Port on 127.0.0.1; default: 8137, or a free one."),
    ] = None,
    browser: Annotated[
        bool, typer.Option("--browser/--no-browser", help="Browser window on the page.")
    ] = True,
) -> None:
    """Open the workbench: a local page to identify, diagnose, add effects and export the model.

    The page is served to this computer only and makes no outside requests.
    Example: sdp-vs-penalty page measurements --port 8200 --no-browser
    """
    try:
        from sdp_vs_penalty.page.server import serve
    except ImportError as error:
        raise missing_extra("The page needs", "page") from error
    serve(folder, port, browser)
