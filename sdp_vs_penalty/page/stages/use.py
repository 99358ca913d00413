"""Use: the model's files, its runs, the commands that make the same, and the model run
forward."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

from sdp_vs_penalty import formatting
from sdp_vs_penalty.effects import standard_effect
from sdp_vs_penalty.exporters import EXPORTS
from sdp_vs_penalty.page import controls as draw
from sdp_vs_penalty.page.model_step import level_of
from sdp_vs_penalty.page.session import Session
from sdp_vs_penalty.page.spoken import with_whole_amounts
from sdp_vs_penalty.page.view import (
    Stage,
    StageVerdict,
    View,
    arm_in_words,
    changes_of_data_in_words,
    identified,
    requires_model,
)
from sdp_vs_penalty.results.table import Table

#: Files and what they are for.
FILES = {
    "report.html": "what was found, to be read and handed on",
    "model.h": "for a controller: the model in C",
    "robot.urdf": "for ROS and simulators",
    "robot.xml": "for MuJoCo",
    "model.json": "for this program",
}
#: Of a model with a payload, as the makers' controllers take it; likewise what else
#: `export` writes.
_OTHERS = {
    home.FILE: home.ABOUT for home in EXPORTS.all().values() if home.FILE not in FILES
}
LOAD = {name: use for name, use in _OTHERS.items() if use.startswith("payload")}
MORE = {name: use for name, use in _OTHERS.items() if name not in LOAD}
#: Files that hold a model of the torque, or a part of it.
_MODELS = {home.FILE for home in EXPORTS.all().values() if hasattr(home, "HOLDS")}
_MODELS |= {"model.json"}


def models_taken(session: Session) -> list[str]:
    """Return the files with a model that a person took; before that those that are
    offered first."""
    return sorted(session.taken & _MODELS or FILES.keys() & _MODELS)


@requires_model(
    "take-away",
    "Download",
    lambda s: (
        s.findings is None,
        *(s.runs, s.repairs),
        [step.exported for step in s.history],
    ),
)
def take_away(view: View) -> None:
    """Draw the files to download and the command lines that repeat the session's
    work.
    """
    session = view.session
    flange = {"flange": ""}

    def tiles(label: str, files: dict[str, str]) -> None:
        with draw.tiles(label):
            for name, use in files.items():
                take = partial(session.download, name, view.download, flange)
                _file_card(session, name, use, take)

    for said in filter(
        None, (arm_in_words(session), changes_of_data_in_words(session))
    ):
        draw.tag("p", said, "words")
    if grades := session.current.facts.get("grades"):  # none of older projects
        draw.note(grades.text)
    findings_file = (
        {} if session.findings is None else {"findings.json": "the diagnosis"}
    )
    tiles("Files to download", FILES)
    if standard_effect("payload").name in session.history[-1].effects:
        hint = "Flange in the last link's frame [m]: x,y,z"
        draw.text_field(
            hint, "", lambda text: flange.update(flange=text), "flange", "0,0,0.107"
        )
        tiles("The payload's files", LOAD)
    with draw.details("For other simulators and controllers", "more-files"):
        tiles("More files to download", MORE | findings_file)
    runs = {
        f"run-{k}.csv": f"from {run['name']}"
        for k, run in enumerate(session.runs, start=1)
    }
    with draw.details(
        "Runs as they were used, repaired where that was asked", "runs-files"
    ):
        tiles("Runs to download", runs)
    with draw.details("The same on the command line", "commands"):
        draw.tag("pre", "\n".join(session.commands()), tabindex="0")


def _file_card(session: Session, name: str, use: str, take: Callable[[], None]) -> None:
    """Draw the card of a file: what it is for, the verdict that stands in it, and a
    button to download it; of one that cannot hold all of the model first what it lacks.
    """
    model = session.current
    record = model.exported.get(name)
    errors = record or model.errors
    is_model = name in _MODELS
    worse = model.worse_than(errors, session.history[0]) if is_model else ""
    with draw.tag("div", style="card file-card"):
        with draw.tag("div", style="head"):
            draw.tag("h4", name)
            if is_model:
                grade = model.verdict_on(name).grade
                text = ", ".join(filter(None, (grade, errors.get("error"))))
                badge = f"badge {level_of(grade)}"
                draw.tag("span", formatting.sentence(text), badge)
        draw.note(use)
        if record is not None:
            _lacking(name, record, worse)
        elif worse:
            draw.tag("p", with_whole_amounts(worse), "worst")
        label = f"Download {name}"
        draw.button("Download", take, f"take-{name}", "free", aria_label=label)


def _lacking(name: str, record: dict[str, Any], worse: str) -> None:
    """Draw what a file cannot hold of the model, and which joints err more for that."""
    count = formatting.count(record["n_lost"], "effect")
    how = f"Fitted without {count}" if record.get("model") else f"Without {count}"
    if laws := record.get("in_place"):
        how = f"{how}, with {laws} in place"
    # Records of older versions do not say which joints err more.
    loss = record["worst"]
    if "losses" in record:
        losses = record["losses"]
        loss = f"errs more: {losses}." if losses else "no joint errs more."
    draw.tag("p", with_whole_amounts(f"{how}: {loss} {worse}".rstrip()), "worst")
    with draw.details("What it cannot hold", f"lacks-{name}"):
        draw.note(f"{formatting.sentence(record['lost'])}.")
        draw.note(with_whole_amounts(record.get("loss", "")))


@requires_model("forward", "Run forward", lambda s: s.answer("forward"))
def forward(view: View) -> None:
    """Draw the form to simulate the model along the judged runs, and the last
    result.
    """
    session = view.session
    drive = "servo" if session.current.servo else "torque"
    run = partial(
        session.start, session.ask, "Running the model forward", "forward", drive=drive
    )
    answer = session.answer("forward")
    draw.button("Run it forward", run, "forward")
    if answer is None:
        draw.note(
            "The model is started from measured states and driven by the torque of the"
            " runs that it is judged on: one step, 0.1 s, and as long as it stays with"
            " the measured motion. Simulators and predictive controllers need this; a"
            " model of torques can be good without it."
        )
        return
    draw.tag("p", answer["verdict"], "words")
    draw.table(Table.from_dict(answer["table"]), "Errors of the simulated motion")
    draw.note(answer["explained"])
    if answer["left_out"]:
        draw.tag(
            "p",
            "Without meaning in a simulation, left out:"
            f" {', '.join(answer['left_out'])}.",
            "finding",
        )
    draw.note("The motion of each joint is drawn in report.html.")


def _used(session: Session) -> StageVerdict | None:
    """Return the verdict on the model, and on the files of it that a person took."""
    verdict = identified(session)
    if verdict is None:
        return None
    model, names = session.current, sorted(session.taken & _MODELS)
    levels = {level_of(model.verdict_on(name).grade) for name in names}
    if levels <= {verdict.level}:
        return verdict
    level = levels.pop() if len(levels) == 1 else "usable"
    word = f"{verdict.word}, not in every file"
    return replace(verdict, level=level, word=word, text=model.lesser_files(names))


USE = Stage("use", "Use", "Identify a model first.", (take_away, forward), _used)
