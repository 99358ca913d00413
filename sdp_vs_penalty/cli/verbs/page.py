from pathlib import Path

from sdp_vs_penalty.errors import missing_extra


def verb(
    folder: Path | None = None,
    project: Path | None = None,
    port: int | None = None,
    browser: bool = True,
) -> None:
    """Open the workbench: a local page to identify, diagnose, add effects and export the model.

    The page is served to this computer only, and asks no other. What is done there is kept as a
    project, which the first screen lists and opens again.
    Example: sdp-vs-penalty page measurements --port 8200 --no-browser

    folder [FOLDER]: Folder whose runs and URDF files the page offers.
    --project DIR: Folder to keep this work in, and to go on from; default: one of the user's.
    --port >=1 <=65535: Port; default: a free one.
    --browser/--no-browser: Browser window on the page.
    """
    try:
        from sdp_vs_penalty.page.server import serve
    except ImportError as error:
        raise missing_extra("The page needs", "page") from error
    from sdp_vs_penalty.cli.options import Parser
    from sdp_vs_penalty.cli.verbs import convert, identify

    identifying = Parser("", identify.verb).options
    reading = Parser("", convert.verb).options
    # Options of two verbs that the page shows as fields, by the step that offers them.
    # Of `identify` it shows all but those that it asks for elsewhere, or that name
    # files of this computer.
    elsewhere = (
        "problem data out method effects gravity hold seed no_check proof known_load"
        " known instruments scheduler"
    )
    forms = {
        "identify": [
            option
            for name, option in identifying.items()
            if name not in elsewhere.split()
        ],
        "robot": [identifying[name] for name in ("gravity", "hold")],
        "read": [
            reading[name]
            for name in ("rename", "motors", "motor_side", "rate", "topic", "joints")
        ],
    }
    serve(folder, project, port, browser, forms)
