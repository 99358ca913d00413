"""The verb page: the workbench in a browser."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from sdp_vs_penalty.errors import InputError

if TYPE_CHECKING:
    pass


def verb(
    folder: Annotated[
        Path | None,
        typer.Argument(metavar="[FOLDER]", help="Whose runs and URDF files the page offers."),
    ] = None,
    port: Annotated[
        int | None,
        typer.Option(min=1, max=65535, help="Of 127.0.0.1; default: 8137, or a free one."),
    ] = None,
    browser: Annotated[bool, typer.Option("--browser/--no-browser", help="Open a browser.")] = True,
    debug: Annotated[bool, typer.Option("--debug", help="Show the traceback of an error.")] = False,
) -> None:
    """Open the workbench: a local page to identify, diagnose, add effects and take the model away.

    It is served to this computer only, and asks nobody for anything.
    Example: sdp-vs-penalty page measurements --port 8200 --no-browser
    """
    try:
        from sdp_vs_penalty.page.server import serve
    except ImportError as error:
        raise InputError(
            f"The page needs the extra [page] ({error.name} is missing): from a checkout, "
            "pip install '.[page]'."
        ) from error
    serve(folder, port, browser)
