"""Use: the model's files, its runs, and the commands that make the same."""

from functools import partial

from sdp_vs_penalty.exporters.export import formats
from sdp_vs_penalty.page import controls as draw
from sdp_vs_penalty.page.view import Stage, View, after_model, identified

#: Files and what they are for.
FILES = {
    "model.json": "for this program",
    "robot.urdf": "for ROS and simulators",
    "robot.xml": "for MuJoCo",
    "report.html": "HTML report",
}
#: Of a model with a payload, as the makers' controllers take it; likewise what else `export` writes.
_EXPORTS = {home.FILE: home.ABOUT for home in formats().values() if home.FILE not in FILES}
LOAD = {name: use for name, use in _EXPORTS.items() if use.startswith("payload")}
MORE = {name: use for name, use in _EXPORTS.items() if name not in LOAD}


@after_model("take-away", "Download", lambda s: (s.findings is None, s.runs))
def take_away(view: View) -> None:
    """The model's files, its runs, and the commands that make the same."""
    session = view.session
    flange = {"flange": ""}

    def tiles(files: dict[str, str]) -> None:
        for name, use in files.items():
            draw.tile(name, use, partial(session.take, name, view.download, flange), f"take-{name}")

    with draw.tiles("Files to download"):
        tiles(FILES)
        if session.findings is not None:
            tiles({"findings.json": "the diagnosis"})
    if "payload" in session.history[-1].effects:
        said = "Flange in the last joint's frame [m]: x,y,z"
        draw.text_field(said, "", lambda text: flange.update(flange=text), "flange", "0,0,0.107")
        with draw.tiles("The payload's files"):
            tiles(LOAD)
    more = draw.details("For other simulators and controllers", "more-files")
    with more, draw.tiles("More files to download"):
        tiles(MORE)
    runs = draw.details("Runs as they were used, repaired where that was asked", "runs-files")
    with runs, draw.tiles("Runs to download"):
        for k, run in enumerate(session.runs):
            name = f"run-{k + 1}.csv"
            take = partial(session.take, name, view.download)
            draw.tile(name, f"from {run['name']}", take, f"take-{name}")
    with draw.details("The same on the command line", "commands"):
        draw.tag("pre", "\n".join(session.commands()), tabindex="0")


USE = Stage("use", "Use", "Identify a model first.", (take_away,), identified)
