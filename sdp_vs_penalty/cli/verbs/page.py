from pathlib import Path
from typing import Any

from sdp_vs_penalty.errors import missing_extra


def verb(
    folder: Path | None = None, port: int | None = None, browser: bool = True
) -> None:
    """Open the workbench: a local page to identify, diagnose, add effects and export the model.

    The page is served to this computer only, and asks no other.
    Example: sdp-vs-penalty page measurements --port 8200 --no-browser

    folder [FOLDER]: Folder whose runs and URDF files the page offers.
    --port >=1 <=65535: Port; default: a free one.
    --browser/--no-browser: Browser window on the page.
    """
    try:
        from sdp_vs_penalty.page.server import serve
    except ImportError as error:
        raise missing_extra("The page needs", "page") from error
    from sdp_vs_penalty.cli.options import Parser
    from sdp_vs_penalty.cli.verbs import convert, identify

    # Options of two verbs that the page shows as fields, by the step that offers them.
    offered: dict[str, tuple[Any, str]] = {
        "identify": (identify, "window filters bounds solver gain_uncertainty jobs"),
        "robot": (identify, "gravity"),
        "read": (convert, "rename motors motor_side rate topic joints"),
    }
    forms = {
        step: [Parser("", home.verb).options[name] for name in names.split()]
        for step, (home, names) in offered.items()
    }
    serve(folder, port, browser, forms)
