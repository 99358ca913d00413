"""The model, for a simulator, a controller or a colleague."""

from __future__ import annotations

from functools import partial

from sdp_vs_penalty.exporters.export import formats
from sdp_vs_penalty.page.controls import details, tag, text_field, tile
from sdp_vs_penalty.page.part import after_model
from sdp_vs_penalty.page.uploads import MOST_FILES
from sdp_vs_penalty.page.view import View

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

#: The optimisation problem, for other solvers; beside each a .json with what it means.
POSED_FILES = {"problem.cbf": "conic benchmark format", "problem.dat-s": "sparse SDPA"}
#: What else a job may have made to be fetched.
MADE = (
    *("findings.json", "trajectory.csv", "proof.json", "fixed.urdf"),
    *(f"run-{k}.csv" for k in range(1, MOST_FILES + 1)),
    *(name for posed in POSED_FILES for name in (posed, f"{posed}.json")),
)


def _draw(view: View) -> None:
    session = view.session
    flange = {"flange": ""}

    def tiles(files: dict[str, str]) -> None:
        for name, use in files.items():
            tile(name, use, partial(session.take, name, view.download, flange), f"take-{name}")

    with tag("div", style="tiles", role="group", aria_label="Files to download"):
        tiles(FILES)
        if session.findings is not None:
            tiles({"findings.json": "the diagnosis"})
    if "payload" in session.history[-1].effects:
        said = "Flange in the last joint's frame [m]: x,y,z"
        text_field(said, "", lambda text: flange.update(flange=text), "flange", "0,0,0.107")
        with tag("div", style="tiles", role="group", aria_label="The payload's files"):
            tiles(LOAD)
    more = details("For other simulators and controllers", "more-files")
    with more, tag("div", style="tiles", role="group", aria_label="More files to download"):
        tiles(MORE)
    runs = details("Runs as they were used, repaired where that was asked", "runs-files")
    with runs, tag("div", style="tiles", role="group", aria_label="Runs to download"):
        for k, run in enumerate(session.runs):
            take, name = partial(session.take_run, k, view.download), f"run-{k + 1}.csv"
            tile(name, f"from {run['name']}", take, f"take-{name}")
    with details("The same on the command line", "commands"):
        tag("pre", "\n".join(session.commands()), tabindex="0")


def _draw_posed(view: View) -> None:
    with tag("div", style="tiles", role="group", aria_label="Problem files to download"):
        for name, use in POSED_FILES.items():
            ask = partial(view.session.ask, "pose", f"Making {name}", view.download, name=name)
            tile(name, use, ask, f"take-{name}")


TAKE_AWAY = after_model("take-away", "Download", _draw, lambda s: (s.findings is None, s.runs))
POSED = after_model("posed", "The identification problem, for other solvers", _draw_posed)
