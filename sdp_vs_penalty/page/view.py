"""What one tab looks at (joint, run, methods), and what its stages and their parts are
made of."""

import re
from argparse import Action
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from nicegui import ui
from nicegui.client import Client

from sdp_vs_penalty import formatting
from sdp_vs_penalty.diagnosis.causes import VELOCITY
from sdp_vs_penalty.estimation.outcome import OfferOutcome
from sdp_vs_penalty.page.model_step import level_of
from sdp_vs_penalty.page.session import Session
from sdp_vs_penalty.page.spoken import graded, label_of, repairs_in_words
from sdp_vs_penalty.reports.demo import HIDDEN, LEVEL, METHODS

#: Options of the command line by the step that offers them.
Forms = Mapping[str, Sequence[Action]]
#: Files or folders that the page lists to choose from.
MOST_OFFERED = 50


@dataclass(frozen=True)
class Project:
    """A session that was saved, as the first screen lists it."""

    #: Secret name of the session in its address.
    token: str
    #: Its name.
    name: str
    #: Its runs, the verdict on its model, and when it was worked on last.
    about: str
    #: Folder of its files.
    folder: Path


@dataclass
class View:
    """The view state of one tab."""

    #: The session that the tab shows.
    session: Session
    #: Folder whose files the page lists; None: none is listed.
    folder: Path | None
    #: The tab's connection.
    client: Client
    #: Options of the command line by the step that offers them.
    forms: Forms
    #: Projects that can be opened, the last one first.
    projects: Sequence[Project] = ()
    #: Deletes a project; InputError where it must stay.
    delete: Callable[[Project], None] = lambda project: None
    #: Index of the joint that every part shows, from 0; None before one is chosen.
    joint: int | None = None
    #: File of the model whose worst joint was selected.
    judged: str = ""
    #: Run that every part shows.
    run: str = ""
    #: Seconds of the run that every part shows [s]; None for all of it.
    span: tuple[float, float] | None = None
    #: Cause against which the error is drawn.
    cause: str = VELOCITY
    #: By part, what to call when these change.
    followers: dict[str, Callable[[], None]] = field(default_factory=dict)
    #: Whether each method is ticked for comparison.
    methods: dict[str, bool] = field(
        default_factory=lambda: dict.fromkeys(METHODS, True)
    )
    #: What the form for simulated runs holds.
    hiding: dict[str, Any] = field(
        default_factory=lambda: {"effect": HIDDEN, "joint": "0", "level": LEVEL}
    )

    def select(self, **at: Any) -> None:
        """Select another joint, run, time span or cause, and redraw every part that
        shows it.

        ``at`` holds the new values by attribute. A change of the run resets the time
        span.
        """
        if at.get("run", self.run) != self.run:
            self.span = None
        for name, value in at.items():
            setattr(self, name, value)
        for follow in list(self.followers.values()):
            follow()

    def look_at_worst_joint(self) -> None:
        """Select the joint of a new model with the largest error relative to its noise
        floor, in a run that differs; what a person selects then stays."""
        model = self.session.current
        if self.joint is None or self.judged != model.file:
            self.judged = model.file
            judged = model.runs[-len(model.judged_on) :]
            of_bars = self.run if self.run in judged else judged[-1]
            self.run = next(iter(model.changed_runs), of_bars)
            self.joint = model.worst_joint - 1
            self.cause = self.session.cause_of(model.worst_joint)

    def select_joint(self, number: Any, cause: str) -> None:
        """Select a joint by its number from 1, as the browser sends it, and the cause
        that its error is drawn against. Numbers out of range are clipped.
        """
        joint = min(max(int(number), 1), self.session.robot["n"]) - 1
        self.select(joint=joint, cause=cause)

    def download(self, name: str) -> None:
        """Make the browser download a file of the session's folder."""
        if not self.client.is_deleted:
            with self.client:
                ui.download.from_url(f"/s/{self.session.token}/take/{name}")

    def _folder_and_content(self) -> list[Path]:
        """List the folder that the page was started with, then what lies in it.

        Links to files outside are left out, so that the page shows nothing else.
        """
        if self.folder is None:
            return []
        folder = self.folder.resolve()
        inside = [p for p in sorted(folder.iterdir()) if p.resolve().parent == folder]
        return [folder, *inside]

    def folder_files(self, suffixes: tuple[str, ...]) -> list[Path]:
        """List the first 50 files with these suffixes in the folder of the page."""
        content = self._folder_and_content()[1:]
        files = [p for p in content if p.suffix.lower() in suffixes and p.is_file()]
        return files[:MOST_OFFERED]

    def folder_problems(self) -> list[Path]:
        """List the folders, the page's own and those in it, that hold a problem.toml.

        Such a file describes a robot with limits and filters.
        """
        folders = self._folder_and_content()
        return [p for p in folders if (p / "problem.toml").is_file()][:MOST_OFFERED]


@dataclass(frozen=True)
class StageVerdict:
    """What a stage has come to. Only estimation/verdict.py grades a model
    (:func:`identified`)."""

    #: Colour: "good", "usable", "bad", or "" for none.
    level: str
    #: What the stage has come to, in a sentence.
    text: str
    #: Word with which the sentence begins.
    word: str = ""


def label_of_change(session: Session, change: Mapping[str, Any]) -> str:
    """Return what the button of a change says: of several repairs which."""
    faults = session.faults_in_words(change)
    kinds = re.sub(r" \([^)]*\)", "", faults)  # where each is stands in the line
    label = f"Repair {kinds}" if faults else label_of(change["words"])
    if change["arguments"].get("by_size"):  # of what the person was asked for
        return f"I do not know them: {label[:1].lower()}{label[1:]}"
    return label


def label_of_motion(change: Mapping[str, Any]) -> str:
    """Return the label of the button that makes a motion to record; a card's, whose
    change has no words, decides what the card is about."""
    words = str(change.get("words", "record a motion that decides it"))
    return label_of(words.replace("record", "make", 1))


def look_in_words(session: Session) -> str:
    """Return what looks for a load, or another change, with the model as it is."""
    names = formatting.words([run["name"] for run in session.runs_since])
    return f"Find a load, or what else has changed, in {names}"


def arm_in_words(session: Session) -> str:
    """Say which arm a model is of, where the rest was held when it was extended; else ""."""
    if not session.current.frozen:
        return ""
    names = formatting.words([run["name"] for run in session.runs])
    return f"This model is of the arm as in {names}; Undo leads back to the one before."


def changes_of_data_in_words(session: Session) -> str:
    """Say which changes of runs and robot a model is judged with, without what is advised
    beside them; "" without any."""
    done = repairs_in_words(session.repairs)
    return f"Judged with the data changed: {done}." if done else ""


def set_aside_in_words(runs: Sequence[Mapping[str, Any]]) -> str:
    """Return what keeps runs that differ out of the model."""
    names = formatting.words([run["name"] for run in runs])
    return f"Identify without {names}, and test on {'it' if len(runs) == 1 else 'them'}"


#: Steps are even where the samples over the time are the rate of the steps within this
#: share.
_EVEN = 0.01


def samples_in_words(run: Mapping[str, Any]) -> str:
    """Return a run's samples with their rate: that of its steps, or where these are uneven
    the samples over the time."""
    rate, seconds = run["rate"], run["seconds"]
    mean = (run["samples"] - 1) / seconds if seconds > 0.0 else rate
    if abs(mean - rate) <= _EVEN * rate:
        return f"{run['samples']} at {rate:.4g} Hz"
    return f"{run['samples']}, {mean:.3g} a second on average"


def read_measured_torque(session: Session) -> tuple[str, Callable[[], Any]] | None:
    """Return the label of the button that reads measured columns in place of a torque that
    a controller computed, and what it does; None where there are none."""
    if (found := session.computed_torque) is None:
        return None
    columns, file, name = found
    read = partial(session.start, session.read_mapped, file["columns"], name)
    return f"Read {columns.replace('#', '')} instead", read


def checked(session: Session) -> StageVerdict:
    """Return the verdict of the check: errors first, then warnings, else all is well.

    Of warnings the first is said, and how many other kinds there are.
    """
    if session.meaningless:
        return StageVerdict("bad", session.meaningless[0], "Check failed")
    if warnings := session.warnings:
        others = len(session.kinds_of_issue) - 1
        first, grade = warnings[0], warnings[0].certainty.grade
        having = next((r for issue, r in session.issues if issue is first), ())
        names = formatting.words([run["name"] for run in having or session.runs])
        text = first.title
        if not first.needs_action:
            text = f"{first.what.rstrip('.')}; {first.remedy}"
        text = f"{names}: {graded(text, grade).rstrip('.')}."
        text += f" And {others} more." if others else ""
        return StageVerdict("usable", text, "Check")
    runs = formatting.count(len(session.runs), "run")
    return StageVerdict("good", f"Nothing wrong in {runs}.", "Done")


def identified(session: Session) -> StageVerdict | None:
    """Return the verdict on the current model for the stage's heading; None without a
    model.

    The grade is that of estimation/verdict.py.
    """
    if session.model is None:
        return None
    verdict = session.model.verdict
    level, word = level_of(verdict.grade), verdict.grade.capitalize()
    return StageVerdict(level, session.model.headline, word)


def in_brief(text: str) -> str:
    """Return what a sentence says first, without what it adds; an interval stays.

    >>> in_brief("Joint 2 errs by 2 N m, 6 times its noise (4 % of it); that is rough.")
    'Joint 2 errs by 2 N m, 6 times its noise.'
    >>> in_brief("Joint 1 rubs about 15 N (5 to 25) more when it creeps: oil is pressed out.")
    'Joint 1 rubs about 15 N (5 to 25) more when it creeps.'
    """
    added = r"(?<=.{13})(?:[:;.] | [(](?!\S+ to \S+[)]))"
    return f"{re.split(added, text)[0].rstrip('.')}."


def measured_on(session: Session, names_runs: bool = False) -> str:
    """Say on what the errors of the current model's diagnosis are measured, or those of
    the model before that: with the names of the runs or without."""
    scope = session.current.scope
    scope = scope if names_runs else scope.partition(" (")[0]
    diagnosis = session.findings_of_current
    if diagnosis is not None and diagnosis.held_out_source != "test":
        return "on data left out"
    left_out = "" if diagnosis is None else "on data left out, "
    return f"{left_out}{scope.removeprefix('on ') if left_out else scope}"


def changes_in_words(
    session: Session, worst: int, before: Sequence[float], after: Sequence[float]
) -> str:
    """Say how the errors (n,) [N m, N] of the joint that errs most before, ``worst`` (from
    1), and of those that err more change, and what they are measured on."""
    outcome = OfferOutcome(
        np.array(before),
        np.array(after),
        session.current.noise_floor,
        [formatting.plain_unit(unit) for unit in session.torque_units],
    )
    return f"{outcome.in_words(worst)}, {measured_on(session)}"


@dataclass(frozen=True)
class PagePart:
    """A part of a stage: the function that ``@partial(PagePart, ...)`` stands before,
    and when it is drawn."""

    #: Name of the place on the page.
    anchor: str
    #: Title of the part.
    title: str
    #: Whether the part is shown yet.
    ready: Callable[[Session], bool]
    #: Everything that the content is made of: the part is drawn anew only when that
    #: changes.
    depends: Callable[[Session], Any]
    #: Fills the part.
    draw: Callable[[View], None]


@dataclass(frozen=True)
class Stage:
    """One screen."""

    #: Name of the place on the page.
    anchor: str
    #: Title of the screen.
    title: str
    #: What comes first, while none of its parts is ready.
    before: str
    #: Parts of the screen, from top to bottom.
    parts: tuple[PagePart, ...]
    #: Sentence that the screen ends in; None while nothing can be judged.
    verdict: Callable[[Session], StageVerdict | None] = lambda session: None


def requires_model(
    anchor: str, title: str, also: Callable[[Session], Any] = lambda session: None
) -> Callable[[Callable[[View], None]], PagePart]:
    """Return a decorator that makes a function a part of the page, shown once there is
    a model.

    Parameters
    ----------
    anchor, title : str
        Identifier and heading of the part.
    also : callable
        Returns what the part depends on besides the models: it is redrawn when that
        changes.
    """
    ready = lambda session: session.model is not None  # noqa: E731
    depends = lambda session: ([model.file for model in session.history], also(session))  # noqa: E731
    return partial(PagePart, anchor, title, ready, depends)
