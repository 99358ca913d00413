"""Which measurements."""

from __future__ import annotations

from functools import partial
from typing import Any

from sdp_vs_penalty import show
from sdp_vs_penalty.data.catalogue import DATASETS
from sdp_vs_penalty.page.controls import (
    button,
    check,
    choice,
    details,
    draw_form,
    drop,
    note,
    number,
    tag,
)
from sdp_vs_penalty.page.part import Part
from sdp_vs_penalty.page.session import Session
from sdp_vs_penalty.page.uploads import RUN_SUFFIXES
from sdp_vs_penalty.page.view import View
from sdp_vs_penalty.page.wording import plain_name

_USES = (
    ("train", "identify from it"),
    ("test", "test on it"),
    ("split", "70 % / test on the rest"),
    ("load", "carries a known load"),
    ("", "remove"),
)


def _depends(session: Session) -> Any:
    return (session.robot or {}).get("source"), session.runs, session.refusals


def _draw(view: View) -> None:
    with tag("div", style="ways"):
        with tag("section", style="way"):
            tag("h4", "Your runs")
            drop(
                "Drop measurements here",
                f"or choose files: {', '.join(sorted(RUN_SUFFIXES))}",
                "runs",
                RUN_SUFFIXES,
                True,
            )
            note("They stay on this computer.")
            with details("Other column names, motors, ROS topics", "reading"):
                draw_form(view.forms.get("read", ()), view.session.reading)
                note("Applies to the files that are read next.")
            _from_folder(view)
        with tag("section", style="way"):
            tag("h4", "Simulated, with a hidden effect")
            _simulated(view)
        with tag("section", style="way"):
            tag("h4", "Real measurements")
            _real(view)
    if view.session.runs:
        _list(view)


def _from_folder(view: View) -> None:
    """Runs of the folder that the page was started with: ticked, then read."""
    files = view.folder_files(RUN_SUFFIXES)
    if not files:
        return
    ticked: set[int] = set()
    with tag("fieldset"):
        tag("legend", "In your folder")
        for k, file in enumerate(files):
            check(
                file.name,
                False,
                lambda on, k=k: (ticked.add if on else ticked.discard)(k),  # type: ignore[misc]
                f"folder-{k}",
            )

        def read() -> None:
            for k in sorted(ticked):
                view.session.arrived[files[k].name] = files[k]
            view.session.read_arrived()

        button("Read the selected files", read, "read-folder")


def _simulated(view: View) -> None:
    session, hiding, robot = view.session, view.hiding, view.session.arm
    if not 0 < hiding["joint"] <= robot["n"]:
        hiding["joint"] = int(robot["n"])
    names = [("none", "Nothing hidden"), *((n, plain_name(n)) for n in view.catalogue["hideable"])]

    def put(name: str, value: Any) -> None:
        hiding[name] = value

    with tag("div", style="fields"):
        choice("Effect", names, hiding["effect"], partial(put, "effect"), "hide-effect")
        joints = [(str(k), f"{k} {name}") for k, name in enumerate(robot["joints"], start=1)]
        choice("On joint", joints, str(hiding["joint"]), lambda v: put("joint", int(v)), "hide-joint")
        levels = [(level, level) for level in view.catalogue["levels"]]
        choice("Level", levels, hiding["level"], partial(put, "level"), "hide-level")
        number("Seed", hiding["seed"], partial(put, "seed"), "hide-seed")

    def simulate() -> None:
        whole = hiding["effect"] in view.catalogue["whole_robot"]
        joints = [] if whole else [hiding["joint"]]
        session.simulate(hiding["effect"], joints, hiding["level"], hiding["seed"])

    button("Simulate four runs", simulate, "simulate")


def _real(view: View) -> None:
    robot = view.session.arm
    title = view.catalogue["real"].get(robot["source"])
    if title is not None:
        note(title)
        button("Use the real runs", view.session.real, "real")
    elif robot["source"] in DATASETS:
        note("Not downloaded. Run:")
        tag("code", f"sdp-vs-penalty fetch {robot['source']}")
    else:
        note(f"Public measurements exist for {show.words(list(DATASETS))}.")


def _list(view: View) -> None:
    session = view.session
    with tag("div", style="wide"), tag("table", style="runs"):
        tag("caption", "Runs", "unseen")
        with tag("thead"), tag("tr"):
            for heading in ("run", "length", "samples", "use"):
                tag("th", heading, scope="col")
        with tag("tbody"):
            for k, run in enumerate(session.runs):
                with tag("tr"):
                    tag("th", run["name"], "name", scope="row")
                    tag("td", f"{run['seconds']:.3g} s")
                    tag("td", f"{run['samples']} at {run['rate']:.4g} Hz")
                    with tag("td"):
                        choice(
                            f"Use of {run['name']}",
                            _USES,
                            run["use"],
                            lambda v, file=run["file"]: session.use(file, v),  # type: ignore[misc]
                            f"use-{k}",
                            hidden_label=True,
                        )
    if session.runs and all(run["use"] == "train" for run in session.runs):
        note(
            "No run is kept for testing: the errors below are training errors, and a diagnosis "
            "holds out parts of the runs, which takes longer."
        )


RUNS = Part(
    "runs",
    "Measurements",
    lambda session: session.robot is not None,
    _depends,
    _draw,
)
