"""A project: what one tab has chosen, read and identified, kept on disk with steps back, and what
is said of it."""

import asyncio
import copy
import json
import re
import time
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Self

from sdp_vs_penalty import formatting
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.estimators import DEFAULT_METHOD
from sdp_vs_penalty.files import require_format, write_text
from sdp_vs_penalty.page.model_step import ModelStep
from sdp_vs_penalty.page.spoken import name_beside, spoken
from sdp_vs_penalty.page.unit_form import UnitForm
from sdp_vs_penalty.page.worker import WorkerPool, sentence
from sdp_vs_penalty.records import JsonRecord, from_json, to_json
from sdp_vs_penalty.results.issue import StoredIssue
from sdp_vs_penalty.results.remedy import Remedy

#: What a step back brings back: everything that was made of the person's choices.
KEPT = (
    "robot",
    "runs",
    "remedies",
    "prepared",
    "repairs",
    "effects",
    "method",
    "mappings",
    "assigned",
    "history",
    "hidden",
)
#: What is chosen besides.
CHOSEN = (
    *("options", "reading", "anyway", "seen_issues"),
    *("names", "name", "begun", "unfinished"),
)
#: Steps back that are kept.
MOST_STEPS = 20
#: File of a session's state in its folder.
STATE_FILE = "project.json"
#: Format 1 has issues as 0.1 wrote them.
_FORMAT = 2


#: How a notice says that a step can be taken back, with a button for it.
UNDO = "Undo brings"


@dataclass(frozen=True)
class PageNotice:
    """One or more sentences for the person: an error, or something worth knowing."""

    #: The sentences.
    texts: tuple[str, ...]
    #: Whether it is an error.
    error: bool = True
    #: Whether files were left out: others can be chosen.
    has_left_out: bool = False


def _alike_once(texts: Iterable[str]) -> tuple[str, ...]:
    """Return each sentence once, with all files that it is about: "a.csv and b.csv: ..."."""
    files_of = dict[str, list[str]]()
    for text in texts:
        name, colon, said = text.partition(": ")
        is_about_file = bool(colon and Path(name).suffix)
        files = files_of.setdefault(said if is_about_file else text, [])
        if is_about_file and name not in files:
            files.append(name)
    return tuple(
        f"{formatting.words(files)}: {said}" if files else said
        for said, files in files_of.items()
    )


@dataclass(frozen=True)
class TrialOutcome(JsonRecord):
    """What a change did to the error on motion left out: a sentence, "" where that was not
    judged, and whether the error falls."""

    sentence: str = ""
    falls: bool = True


@dataclass(frozen=True)
class TriedRemedy(Remedy):
    """A remedy of the check, with what its change would do."""

    #: What it would do to the error on motion left out; None where it was not tried.
    effect: TrialOutcome | None = None
    #: Why it is refused; "" where it is not.
    refused: str = ""

    @property
    def is_tried(self) -> bool:
        """Whether it is known what its change would do."""
        return self.effect is not None or bool(self.refused)

    @property
    def outcome(self) -> TrialOutcome | None:
        """What its change would do, or why it is refused; None where nothing is known."""
        if self.refused:
            return TrialOutcome(f"Not done: {spoken(self.refused)}", falls=False)
        return self.effect if self.effect and self.effect.sentence else None


def with_issues(runs: Iterable[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Return runs of a file or an answer, in which issues are JSON, with records of them."""
    return [
        {**run, "findings": from_json(tuple[StoredIssue, ...], run["findings"])}
        for run in runs
    ]


def read_state(folder: Path) -> dict[str, Any]:
    """Return the content of a project's state; its runs are files of the folder alone.

    Raises InputError for a file that is none of ours. (It is read here, since files that
    :func:`read_json` reads count as inputs, which are never written over.)
    """
    try:
        content = json.loads((folder / STATE_FILE).read_bytes())
        files = [
            run[name] for run in content["now"]["runs"] for name in ("file", "view")
        ]
        is_ours = all(Path(file).name == file for file in files)
    except (OSError, ValueError, LookupError, TypeError, AttributeError):
        is_ours = False
    if not is_ours:
        what = f"{STATE_FILE} is no project of the page"
        raise InputError(what, "name another folder", folder)
    return dict(content)


@dataclass
class ProjectState:
    """What one tab has chosen, read and identified: saved in a folder, with steps back."""

    #: Secret name of the session in its address.
    token: str
    #: Folder of the session's files.
    folder: Path
    #: Processes that run its jobs.
    pool: WorkerPool
    #: What is known of the robot, with its ``source``; empty before one is read.
    robot: dict[str, Any] = field(default_factory=dict)
    #: Name of the project, for people.
    name: str = ""
    #: When it was begun [s since 1970].
    begun: float = field(default_factory=time.time)
    #: The runs, as ``keep`` of jobs.py answers.
    runs: list[dict[str, Any]] = field(default_factory=list)
    #: The effect that was hidden in simulated runs, as `add` writes it; "" for others.
    hidden: str = ""
    #: What would mend the runs, as the check orders it.
    remedies: list[TriedRemedy] = field(default_factory=list)
    #: Effects that were chosen.
    effects: list[str] = field(default_factory=list)
    #: Method that was chosen.
    method: str = DEFAULT_METHOD
    #: What is written in the fields that are the command line's options.
    options: dict[str, str] = field(default_factory=dict)
    #: What is written in the fields of the options for reading files.
    reading: dict[str, str] = field(default_factory=dict)
    #: Options of `convert` that a person stated of files, by the JSON of their columns.
    assigned: dict[str, dict[str, str]] = field(default_factory=dict)
    #: Identify even from runs that the check calls meaningless.
    anyway: bool = False
    #: Kinds of issues that the person was led to.
    seen_issues: list[str] = field(default_factory=list)
    #: Why these runs cannot be identified, not even anyway; "" while that is not known.
    impossible: str = ""
    #: Models, the last one current.
    history: list[ModelStep] = field(default_factory=list)
    #: What was there before each step, with the step's name; the last one comes back
    #: first.
    past: list[tuple[str, dict[str, Any]]] = field(default_factory=list)
    #: What was there before each step back.
    future: list[tuple[str, dict[str, Any]]] = field(default_factory=list)
    #: The job that runs, if it can be started again after the server has ended: "do",
    #: "arguments" and "how" of :meth:`start`, and its "title".
    unfinished: dict[str, Any] = field(default_factory=dict)
    #: Files that were refused for their columns, with what is known of these.
    mappings: list[dict[str, Any]] = field(default_factory=list)
    #: The words of the commands that make the runs as they are: simulated, converted,
    #: repaired.
    prepared: list[list[str]] = field(default_factory=list)
    #: Of each change of runs and robot its words, what it did to the error, and the
    #: change itself.
    repairs: list[list[Any]] = field(default_factory=list)
    #: Shown names by path.
    names: dict[str, str] = field(default_factory=dict)
    #: Names of the files that were downloaded.
    taken: set[str] = field(default_factory=set)
    #: What is typed in the forms of units, by robot and channel.
    unit_forms: dict[tuple[str, str], UnitForm] = field(default_factory=dict)
    #: The coroutine that runs a job; None while idle.
    task: asyncio.Task[None] | None = None
    #: What is said to the person; None for nothing.
    notice: PageNotice | None = None
    #: Tabs that show the session (workbench.py).
    watchers: list[Any] = field(default_factory=list)
    #: Since when no tab shows it, on the monotonic clock [s].
    left_at: float = field(default_factory=time.monotonic)
    #: The stage and the part where what is new can be seen.
    new: tuple[str, str] | None = None

    @property
    def model(self) -> ModelStep | None:
        """The current model, the last one of the history; None before the first."""
        return self.history[-1] if self.history else None

    @property
    def current(self) -> ModelStep:
        """The current model. Raises InputError if no model was identified yet."""
        if not self.history:
            raise InputError("No model yet", "identify one first")
        return self.history[-1]

    @property
    def robot_word(self) -> str:
        """The robot as a command names it: its file, or its name."""
        return str(self.robot["file"] or self.robot["source"])

    def left(self, watcher: Any) -> None:
        """Unregister a tab that was closed. A running job goes on."""
        self.watchers = [tab for tab in self.watchers if tab is not watcher]
        if not self.watchers:
            self.left_at = time.monotonic()

    def changed(self) -> None:
        """Redraw every tab that shows this session."""
        for watcher in self.watchers:
            watcher.redraw()

    def say(self, *texts: str, error: bool = True, has_left_out: bool = False) -> None:
        """Show these sentences as the page's notice, in place of the previous ones.

        Without sentences the notice disappears; the same sentence about several files
        stands once. error : whether the notice is an error or a remark; has_left_out :
        whether files were left out.
        """
        texts = _alike_once(map(self.in_words, texts))
        self.notice = PageNotice(texts, error, has_left_out) if texts else None
        self.changed()

    def in_words(self, text: str) -> str:
        """Rephrase a sentence for the page; paths are replaced by the names that the
        person knows: of the robot, of runs and of dropped files.
        """
        names_by_file = {
            str(self.folder / run["file"]): run["name"] for run in self.runs
        }
        for path, name in {
            **self.names,
            **names_by_file,
            f"{self.folder}/": "",
        }.items():
            text = text.replace(path, name)
        return spoken(text)

    def _step_from_here(self, label: str, keeps_models: bool = False) -> None:
        """Remember the present state by a label, so that the step that begins now can be
        undone; nothing is left to redo.

        Downloads and what was impossible belong to the state before. So do the models
        (``history``), unless ``keeps_models``: they no longer fit the data.
        """
        self.taken = set()
        self.impossible = ""
        now = self._copied()
        self.past = [*self.past, (label, now)][-MOST_STEPS:]
        self.future = []
        if not keeps_models:
            self.history = []

    def _copied(self, *more: str) -> dict[str, Any]:
        """Return a copy of what a step back brings back, and of ``more`` fields."""
        return {name: copy.copy(getattr(self, name)) for name in (*KEPT, *more)}

    def undo(self) -> None:
        """Take the last step back: :meth:`redo` can repeat it."""
        self._exchange(self.past, self.future)

    def redo(self) -> None:
        """Repeat the step that was taken back last."""
        self._exchange(self.future, self.past)

    def _exchange(self, source: list[Any], target: list[Any]) -> None:
        """Go to the last state of ``source``, and put the present one into ``target``."""
        if self.task is not None or not source:
            return
        self.impossible = ""
        label, kept = source.pop()
        target.append((label, {name: getattr(self, name) for name in KEPT}))
        for name, value in kept.items():
            setattr(self, name, value)
        self.say()
        self.save()

    def save(self) -> None:
        """Write what was chosen and made to the session's folder, so that it can be opened
        again after the server has ended.
        """
        steps: list[ModelStep] = []

        def written(kept: Mapping[str, Any]) -> dict[str, Any]:
            places = []
            for step in kept["history"]:
                known = [k for k, other in enumerate(steps) if other is step]
                places.append(known[0] if known else len(steps))
                steps.extend([] if known else [step])
            return {**kept, "history": places}

        now = {name: getattr(self, name) for name in KEPT}
        content = {
            "format": _FORMAT,
            "token": self.token,
            **{name: getattr(self, name) for name in CHOSEN},
            "now": written(now),
            "past": [[label, written(kept)] for label, kept in self.past],
            "future": [[label, written(kept)] for label, kept in self.future],
            "steps": steps,
        }
        file, text = self.folder / STATE_FILE, json.dumps(to_json(content))
        try:
            # Its time is that of the last work, not of the server's end.
            if not file.exists() or file.read_text("utf-8") != text:
                write_text(file, text)
        except (OSError, InputError) as error:  # a full disk: the work goes on
            self.say(f"The project is not saved. {sentence(error)}")

    @classmethod
    def load(cls, folder: Path, pool: WorkerPool, token: str) -> Self:
        """Open what :meth:`save` wrote; paths follow the folder to where it is now.

        Raises InputError for a file that is none of ours.
        """
        content = read_state(folder)
        require_format(content, _FORMAT)
        session = cls(content.get("token") or token, folder, pool)

        def here(path: str) -> str:
            moved = folder / Path(path).name
            return str(moved) if path and moved.exists() else path

        def effect_of(effect: Any) -> Any:
            if not isinstance(effect, str):
                return effect
            errors = [float(x) for x in re.findall(r"([\d.]+) %", effect)]
            falls = len(errors) < 2 or errors[1] < errors[0]
            return {"sentence": effect, "falls": falls} if effect else {}

        steps = [from_json(ModelStep, step) for step in content["steps"]]
        steps = [replace(step, file=here(step.file)) for step in steps]

        def read(kept: dict[str, Any]) -> dict[str, Any]:
            robot = kept["robot"]
            if robot:
                robot["source"] = here(robot["source"])
            for mapping in kept["mappings"]:
                mapping["path"] = here(mapping["path"])
            taken = list[str]()
            # An older version knows one name of a run, or has one twice.
            for run in kept["runs"]:
                run.setdefault("in_commands", run["name"])
                run["name"] = name_beside(run["name"], taken)
                taken.append(run["name"])
            kept["runs"] = with_issues(kept["runs"])
            # An older version does not know the change, and the effect in words alone.
            none = {"verb": "", "arguments": {}}
            kept["repairs"] = [
                [words, effect_of(effect), *(change or [none])]
                for words, effect, *change in kept["repairs"]
            ]
            for remedy in kept["remedies"]:
                remedy |= {x: effect_of(remedy[x]) for x in {"effect"} & remedy.keys()}
            kept["remedies"] = from_json(list[TriedRemedy], kept["remedies"])
            return {**kept, "history": [steps[k] for k in kept["history"]]}

        for name in {*CHOSEN} & content.keys():  # an older version has fewer
            setattr(session, name, content[name])
        session.names = {here(path): name for path, name in session.names.items()}
        for name, value in read(content["now"]).items():
            setattr(session, name, value)
        session.past = [(label, read(kept)) for label, kept in content["past"]]
        session.future = [(label, read(kept)) for label, kept in content["future"]]
        if title := session.unfinished.get("title"):
            session.say(f"{title}: the program ended before it was done.", error=False)
        return session

    def rename(self, name: str) -> None:
        """Give the project a name of the person's own."""
        self.name = name.strip()[:80]
        self.save()
        self.changed()
