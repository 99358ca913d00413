"""One tab: what it has chosen, read and identified, what is said of it, and how its
jobs are done."""

from __future__ import annotations

import asyncio
import copy
import inspect
import json
import re
import time
from collections.abc import Callable, Collection, Coroutine, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from filecmp import cmp
from itertools import pairwise
from pathlib import Path
from typing import Any, Self

import numpy as np

from sdp_vs_penalty import formatting
from sdp_vs_penalty.api.remedies import Files, command_of, cut_copy
from sdp_vs_penalty.checks.explain import NOT_REPAIRED
from sdp_vs_penalty.data.files import for_testing
from sdp_vs_penalty.data.formats import suffixes
from sdp_vs_penalty.data.parsing import numbers
from sdp_vs_penalty.diagnosis.causes import TIME, VELOCITY
from sdp_vs_penalty.diagnosis.findings import Diagnosis, is_law_of
from sdp_vs_penalty.diagnosis.where_it_fails import CAUSES
from sdp_vs_penalty.effects import (
    DEFAULT_EFFECTS,
    effect_in_words,
    effect_types,
    effects_in_words,
)
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.estimators import DEFAULT_METHOD
from sdp_vs_penalty.estimators.estimator import no_progress
from sdp_vs_penalty.files import require_format, write_text
from sdp_vs_penalty.page.commands import commands_of, option_words
from sdp_vs_penalty.page.model_step import ModelStep, is_among, joints_of
from sdp_vs_penalty.page.spoken import label_of, progress_in_words, spoken
from sdp_vs_penalty.page.worker import WorkerPool, sentence
from sdp_vs_penalty.problem.check_command import CheckCommand
from sdp_vs_penalty.records import from_json, to_json
from sdp_vs_penalty.render.words import shown_cause, shown_finding
from sdp_vs_penalty.reports.demo import ARM, HIDDEN, LEVEL, RUNS, SEED
from sdp_vs_penalty.results.remedy import Change
from sdp_vs_penalty.robot.joint import parse_held
from sdp_vs_penalty.robot.model_files import ROBOT_FILE_ENDINGS
from sdp_vs_penalty.simulation.hidden_runs import RUN_FILES

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
#: Samples of all runs with which remedies are tried before anyone asks.
_MOST_TRIED = 200_000
#: What is said where the robot or runs for fitting have changed.
_DROPPED = (
    "{} dropped, since identified from what was there before: Undo brings it back."
)
#: Endings of files by what they are for, in the order in which they are opened.
ENDINGS = {
    "robot": ROBOT_FILE_ENDINGS,
    "runs": (*suffixes(), ".txt", ".tsv", ".dat", ".log"),  # tables as text
    "model": (".json",),
}
#: Units of torque to choose from, by the name that `convert` has.
UNITS = {"mNm": "mN m", "Ncm": "N cm", "kgfm": "kgf m", "lbfin": "lbf in"}
#: The same of positions.
ANGLES = {"deg": "degrees", "mrad": "mrad"}
#: What is said where a job that something waited for was cancelled, or failed.
_NOT_BEGUN = "What waited for it was not begun."
#: Letters of a place that is named beside a fault among others.
_MOST_OF_PLACE = 20
#: File of a motion to record.
MOTION = "trajectory.csv"
#: File of a session's state in its folder.
STATE_FILE = "project.json"
_FORMAT = 1


def kind_of(name: str) -> str:
    """Return what a file is for by its ending, a key of ENDINGS; "" for none."""
    ending = Path(name).suffix.lower()
    return next((kind for kind, known in ENDINGS.items() if ending in known), "")


@dataclass(frozen=True)
class PageNotice:
    """One or more sentences for the person: an error, or something worth knowing."""

    #: The sentences.
    texts: tuple[str, ...]
    #: Whether it is an error.
    error: bool = True
    #: Whether files were left out: others can be chosen.
    has_left_out: bool = False


@dataclass(frozen=True)
class Working:
    """A piece of work, of one or more jobs."""

    #: What is done now.
    title: str = ""
    #: Where it stands.
    status: str = ""
    #: When it began, on the monotonic clock [s].
    since: float = field(default_factory=time.monotonic)
    #: What is counted, the first number and when that was heard [s]; None for nothing
    #: yet.
    counted: tuple[str, int, float] | None = None

    def hears(self, text: str) -> Working:
        """Return the work as a job says where it stands, with the time that is left of
        what is counted ("trying effects: 843 of 1503")."""
        status = progress_in_words(text)
        count = re.search(r"(\d+) of (\d+)", text)
        if count is None:
            return replace(self, status=status)
        done, of = map(int, count.groups())
        kind, now = text[: count.start()], time.monotonic()
        begun = self.counted
        if begun is None or begun[0] != kind:
            begun = (kind, done, now)
        _, first_number, since = begun
        if done > first_number:
            left = (now - since) * (of - done) / (done - first_number)
            status += f", about {max(1.0, left):.0f} s left"
        return replace(self, status=status, counted=begun)


def _acts_as(text: str, effect: str, joints: Collection[int]) -> bool:
    """Whether an effect, as `add` writes it, is a law of another one on these joints."""
    name = text.partition("@")[0].partition(":")[0]
    return is_law_of(name, effect) and {*joints} <= joints_of(text)


def _training_of(runs: Iterable[Mapping[str, Any]]) -> list[tuple[Any, ...]]:
    """Return what models are identified from: the runs of training, and the windows of
    those that are split."""
    used = (run for run in runs if run["use"] in ("train", "split"))
    return [(run["file"], run["use"] == "split" and run["split"]) for run in used]


def is_leaving_out(change: Mapping[str, Any]) -> bool:
    """Whether a change leaves a whole run out."""
    return change["verb"] == "cut" and "spans" not in change["arguments"]


def _used(runs: Iterable[Mapping[str, Any]]) -> list[tuple[Any, ...]]:
    """Return what the runs of models and tests are, and what each is used for."""
    names = ("file", "name", "use", "split")
    return [tuple(run[x] for x in names) for run in runs if run["use"] != "wait"]


def is_refused(run: Mapping[str, Any]) -> bool:
    """Whether the check calls something in a run an error."""
    return any(issue["severity"] == "error" for issue in run["findings"])


def asks_for_unit(run: Mapping[str, Any]) -> bool:
    """Whether the check asks in which unit the torques of a run are, and nobody has
    answered."""
    return not run.get("stated") and any(
        remedy["change"]["arguments"].get("scale") == {"tau": None}
        for issue in run["findings"]
        for remedy in issue["remedies"]
    )


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


def _words_of_reading(change: Mapping[str, Any]) -> str:
    """Return in words the units that a change reads columns in, which a person has
    named; "" of another change."""
    texts = []
    for column, unit in change["arguments"].get("scale", {}).items():
        name = {"tau": "the torque", "q": "positions"}.get(column, column)
        gains = str(unit or "").replace(":", ", ")
        named = {key.lower(): words for key, words in (UNITS | ANGLES).items()}
        is_factor = gains[:1].isdigit() or gains[:1] in ("-", ".")
        texts.append(
            f"multiply {name} by {gains}"
            if is_factor
            else f"read {name} in {named.get(gains.lower(), gains)}"
        )
    return formatting.words(texts) if texts else ""


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


def _options_of(columns: Sequence[str], chosen: Mapping[str, str]) -> dict[str, str]:
    """Return the options of `convert` that read files with these columns as they were
    chosen, by our names.

    Raises InputError where nothing is chosen, or a column twice.
    """
    pairs = {k: v for k, v in chosen.items() if v and k != "rate"}
    if not pairs:
        needed = [name for name in chosen if name != "rate"]
        where = f"choose one for each of {needed[0]} to {needed[-1]}"
        raise InputError("No column is chosen", where)
    taken = [*pairs.values()]
    for column in taken:
        if taken.count(column) > 1:
            what = f"column {column} is chosen more than once"
            raise InputError(what, "choose another for one of them")
    rename = ",".join(
        f"{ours}=#{columns.index(theirs) + 1}" for ours, theirs in pairs.items()
    )
    rate = chosen.get("rate", "")
    return {"rename": rename} | ({"rate": rate} if rate else {})


@dataclass
class Session:
    """What one tab has chosen, read and identified, what is said of it, and all that
    can be done to it.

    One job at a time: :meth:`start` begins one of the coroutines below. Kept while the
    server runs, also of a closed tab.
    """

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
    remedies: list[dict[str, Any]] = field(default_factory=list)
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
    #: By job the last answer, with the ``model`` that it is about.
    answers: dict[str, dict[str, Any]] = field(default_factory=dict)
    #: The job that runs, if it can be started again after the server has ended: "do",
    #: "arguments" and "how" of :meth:`start`, and its "title".
    unfinished: dict[str, Any] = field(default_factory=dict)
    #: What is said to the person; None for nothing.
    notice: PageNotice | None = None
    #: Work in progress; None while idle.
    working: Working | None = None
    #: The coroutine that runs a job; None while idle.
    task: asyncio.Task[None] | None = None
    #: What :meth:`start` was called with for that job.
    running: tuple[Any, ...] = ()
    #: The same of what was asked for while it ran, in order.
    waiting: list[tuple[Any, ...]] = field(default_factory=list)
    #: What tries the remedies beside everything else; None while nothing does.
    aside: asyncio.Task[None] | None = None
    #: What the changes answered that were tried on the runs as they are, by the request.
    foreseen: dict[str, dict[str, Any]] = field(default_factory=dict)
    #: Tabs that show the session (workbench.py).
    watchers: list[Any] = field(default_factory=list)
    #: Since when no tab shows it, on the monotonic clock [s].
    left_at: float = field(default_factory=time.monotonic)
    #: Files that have arrived and are not yet read, by name.
    arrived: dict[str, Path] = field(default_factory=dict)
    #: Files that were refused for their columns, with what is known of these.
    mappings: list[dict[str, Any]] = field(default_factory=list)
    #: The words of the commands that make the runs as they are: simulated, converted,
    #: repaired.
    prepared: list[list[str]] = field(default_factory=list)
    #: Of each change of runs and robot its words, what it did to the error, and the
    #: change itself.
    repairs: list[list[Any]] = field(default_factory=list)
    #: The stage and the part where what is new can be seen.
    new: tuple[str, str] | None = None
    #: Names of the files that were downloaded.
    taken: set[str] = field(default_factory=set)
    #: By file that was made, what it was made of.
    made: dict[str, str] = field(default_factory=dict)
    #: What makes a file beside another job.
    making: set[asyncio.Task[None]] = field(default_factory=set)
    #: Shown names by path.
    names: dict[str, str] = field(default_factory=dict)

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
    def meaningless(self) -> list[str]:
        """The errors that the data check found in the training runs, a sentence each.

        With any of them, a model identified from these runs would be meaningless.
        """
        return [
            spoken(f"{run['name']}: {f['what'].rstrip('.')}: {f['remedy']}")
            for run in self.runs
            if run["use"] in ("train", "split")
            for f in run["findings"]
            if f["severity"] == "error"
        ]

    @property
    def differing_runs(self) -> list[dict[str, Any]]:
        """The runs for training that the check calls another arm or load than the others;
        none where no other is left."""
        training = [run for run in self.runs if run["use"] == "train"]
        differing = [
            run
            for run in training
            if any(issue["kind"] in NOT_REPAIRED for issue in run["findings"])
        ]
        return differing if len(differing) < len(training) else []

    @property
    def fault_of_changed_run(self) -> str:
        """What the check says is wrong with the log of a run in which the model errs far
        more, in a sentence: an error, or a likely cause that the person was not led to;
        "" where the arm itself may have changed."""
        changed = {name.partition(", ")[0] for name in self.current.changed_runs}
        seen = {*self.seen_issues, *NOT_REPAIRED}
        for run in self.runs:
            for issue in run["findings"] if run["name"] in changed else ():
                is_new = issue["severity"] == "warning" and issue["kind"] not in seen
                is_likely = not issue["certainty"].startswith("possible")
                if issue["severity"] == "error" or (is_new and is_likely):
                    return f"{run['name']}: {spoken(issue['what'])}"
        return ""

    @property
    def first_and_current(self) -> list[ModelStep]:
        """The first and the current model of the history; a single one if they are
        the same.
        """
        first = self.history[0]
        current = self.current
        return [current] if current is first else [first, current]

    @property
    def findings_of_current(self) -> Diagnosis | None:
        """The diagnosis of the current model; None if it was not diagnosed."""
        return self.model.findings if self.model else None

    @property
    def diagnosed(self) -> ModelStep:
        """The model of the history that was diagnosed last."""
        return next(model for model in self.history[::-1] if model.findings)

    @property
    def findings(self) -> Diagnosis | None:
        """The last diagnosis, perhaps of an earlier model; None without one."""
        found = (model.findings for model in self.history[::-1] if model.findings)
        return next(found, None)

    @property
    def added(self) -> set[str]:
        """The effects added to the model since the last diagnosis, as `add` writes
        them.
        """
        texts = set[str]()
        for model in self.history:
            texts = set() if model.findings else texts.union(model.added)
        return texts

    @property
    def hidden_and_found(self) -> str:
        """A sentence on the effect that was hidden in simulated runs, and what the last
        diagnosis says of it; "" for measured runs, and without a diagnosis."""
        diagnosis = self.findings
        if diagnosis is None or not self.hidden:
            return ""
        # "joint_coupling:2+3" is an effect on joints 2 and 3, "base_tilt" on the arm.
        effect = self.hidden.partition(":")[0]
        if effect == "none":
            return "Nothing was hidden in these runs."
        joints = joints_of(self.hidden)
        added = [text for step in self.history for text in step.added]
        found = [finding.text for finding in diagnosis.effects]
        absorbed = [x for x in diagnosis.invisible if x.effect == effect]
        if any(_acts_as(text, effect, joints) for text in added):
            outcome = "found, and in the model"
        elif any(_acts_as(text, effect, joints) for text in found):
            outcome = "found"
        elif any(joints.issubset(x.joints) for x in absorbed):
            outcome = "not found: parameters of the model absorb it in these runs"
        else:
            outcome = "not found by this name"
        return f"We hid {effect_in_words(self.hidden)}: {outcome}."

    def cause_of(self, joint: int) -> str:
        """Return the cause that shows the error of a joint (from 1): that of its
        finding, or else the one that the error depends on most; TIME without any."""
        if not self.current.failures:
            return VELOCITY
        finding = shown_finding(self.findings_of_current, joint)
        cause = shown_cause(finding, self.current.where_it_fails, joint)
        return cause if cause in CAUSES else TIME

    def answer(self, job: str) -> dict[str, Any] | None:
        """Return the last answer of a job, such as "methods", for the current model.

        None if the job was not run for this model.
        """
        stored = self.answers.get(job)
        if stored is None or self.model is None:
            return None
        return stored if stored["model"] == self.model.file else None

    def recording(self, model: ModelStep, run: str) -> dict[str, Any]:
        """Load the curves of one run as a model explains it.

        Parameters
        ----------
        model : ModelStep
            A model of the history.
        run : str
            Name of one of the model's runs.

        Returns
        -------
        dict
            t (M,) [s]; torque, modelled, q, dq, ddq (M, n); tf (F,) [s] and poses
            (F, joints, 4, 4): instants and poses of the arm for the 3D view.
        """
        return self.arrays(f"{Path(model.file).stem}-{model.runs.index(run)}.npz")

    def arrays(self, name: str) -> dict[str, Any]:
        """Load the arrays, by name, that a job saved as an .npz file in the
        session's folder.
        """
        with np.load(self.folder / name, allow_pickle=False) as read:
            return dict(read)

    def commands(self) -> list[str]:
        """Return the command lines that repeat this session's work, one for each step.

        They name files as the page shows them, to be run in the folder of the logs.
        """
        return [formatting.command(*words) for words in self.command_words()]

    def command_words(self) -> list[list[str]]:
        """Return the words of each of these commands."""
        return commands_of(
            robot=self.robot,
            runs=self.runs,
            history=self.history,
            prepared=self.prepared,
            options=self.options,
            has_check=not self.meaningless,
        )

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

    def start(
        self, do: Callable[..., Coroutine[Any, Any, None]], *arguments: Any, **how: Any
    ) -> None:
        """Start one of this session's coroutines as its only task.

        do : the coroutine function; arguments, how : what it is called with. While
        another task is running, the call waits.
        """
        call = do, arguments, how
        if self.task is not None:
            if call not in (self.running, *self.waiting):  # pressed twice: done once
                self.waiting.append(call)
                job = f" after: {self.working.title}" if self.working else ""
                self.say(f"Your press waits for its turn{job}.", error=False)
            return
        if self.aside is not None:
            self.aside.cancel()
        self.notice = None
        self.working = Working()
        self.running = call
        self.unfinished = {
            "do": getattr(do, "__name__", ""),
            "arguments": arguments,
            "how": how,
        }
        try:
            json.dumps(self.unfinished)
        except TypeError:  # it is of this tab
            self.unfinished = {}
        self.task = asyncio.get_running_loop().create_task(do(*arguments, **how))
        self.task.add_done_callback(self._ended)

    def cancel(self) -> None:
        """Cancel the running job at once; the session stays as it was before."""
        if self.task is not None:
            self.unfinished = {}
            self.task.cancel()

    def start_again(self) -> None:
        """Start the job again that the end of a server has ended."""
        job, self.unfinished = self.unfinished, {}
        if inspect.iscoroutinefunction(do := getattr(self, str(job.get("do")), None)):
            self.start(do, *job["arguments"], **job["how"])

    def _ended(self, task: asyncio.Task[None]) -> None:
        """Clean up after a task: say how it failed, or do what waits for it; redraw, and
        read files dropped meanwhile.
        """
        self.working = self.task = None
        waiting, self.waiting = self.waiting, []
        dropped = [_NOT_BEGUN] if waiting else []
        if not task.cancelled():
            self.unfinished = {}
        if task.cancelled():
            self.say("Cancelled: nothing was changed.", *dropped, error=False)
        elif (error := task.exception()) is not None:
            self.say(sentence(error), *dropped)
        else:
            for do, arguments, how in waiting:
                self.start(do, *arguments, **how)
        self.save()
        self.changed()
        self.read_arrived()
        if self.task is None:
            self.aside = asyncio.get_running_loop().create_task(self._foresee())

    async def _foresee(self) -> None:
        """Try the remedies of the runs beside everything else, and keep what each would
        do to the error on motion left out, and what it would answer."""
        untried = [
            x["change"]
            for x in self.remedies
            if x["change"]["verb"] != "record"
            and not is_leaving_out(x["change"])
            and all(x["change"]["arguments"].get("scale", {"": "1"}).values())
            and not x.keys() & {"effect", "refused"}
        ]
        n_samples = sum(run["samples"] for run in self.runs)
        if not untried or n_samples > _MOST_TRIED or self.model is not None:
            return
        self.foreseen = {}
        for change in untried:
            request = self._change_request(change)
            try:
                answer = await self.pool.run(request, no_progress, is_aside=True)
            except InputError as error:
                self._keep_outcome(change, {"refused": str(error)})
            else:
                self.foreseen[json.dumps(request)] = answer
                self._keep_outcome(change, {"effect": answer["effect"]})
            self.save()
            self.changed()

    def _keep_outcome(
        self, change: Mapping[str, Any], outcome: Mapping[str, Any]
    ) -> None:
        """Keep what a change of a remedy would do ("effect"), or why not ("refused")."""
        self.remedies = [
            {**x, **outcome} if x["change"] == change else x for x in self.remedies
        ]

    def outcome_of(self, change: Mapping[str, Any]) -> dict[str, Any]:
        """Return what a remedy's change would do to the error on motion left out, or why
        it is refused, in a "sentence", and whether that "falls"; empty where it was not
        tried."""
        for remedy in self.remedies:
            if remedy["change"] == change:
                if refused := remedy.get("refused"):
                    return {"sentence": f"Not done: {spoken(refused)}", "falls": False}
                return dict(remedy.get("effect", {}))
        return {}

    def _doing(self, **what: str) -> None:
        """Update the running work, given its new ``title`` or ``status``, and redraw
        the tabs."""
        self.working = replace(self.working or Working(), **what)  # type: ignore[arg-type]
        if self.unfinished and "title" in what:
            self.unfinished["title"] = what["title"]
            self.save()
        self.changed()

    async def _job(self, title: str, job: str, **details: Any) -> dict[str, Any]:
        """Run a function of jobs.py, by its name, in a worker, and return its answer.

        The request holds the session's state and the ``details``.
        """
        self._doing(title=title, status="")
        return await self._run(self._request(job, **details))

    async def _run(self, request: Mapping[str, Any]) -> dict[str, Any]:
        """Run a request in a worker, and show where it stands."""

        def hear(text: str) -> None:
            self.working = (self.working or Working()).hears(text)
            self.changed()

        return await self.pool.run(request, hear)

    def _request(self, job: str, **details: Any) -> dict[str, Any]:
        """Return the request for a function of jobs.py: the session's state and the
        ``details``."""
        names = ("robot", "runs", "options")
        return {
            **{name: getattr(self, name) for name in names},
            "job": job,
            "folder": str(self.folder),
            "model": self.model and self.model.file,
            **details,
        }

    def _step_from_here(self, label: str, keeps_models: bool = False) -> None:
        """Remember the present state by a label, so that the step that begins now can be
        undone; nothing is left to redo.

        Downloads and what was impossible belong to the state before. So do the models
        (``history``), unless ``keeps_models``: they no longer fit the data.
        """
        self.taken = set()
        self.impossible = ""
        now = {name: copy.copy(getattr(self, name)) for name in KEPT}
        self.past = [*self.past, (label, now)][-MOST_STEPS:]
        self.future = []
        if not keeps_models:
            self.history = []

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
            for run in kept["runs"]:  # an older version knows one name
                run.setdefault("in_commands", run["name"])
            # An older version does not know the change, and the effect in words alone.
            none = {"verb": "", "arguments": {}}
            kept["repairs"] = [
                [words, effect_of(effect), *(change or [none])]
                for words, effect, *change in kept["repairs"]
            ]
            for remedy in kept["remedies"]:
                remedy |= {x: effect_of(remedy[x]) for x in {"effect"} & remedy.keys()}
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

    def _refuse_meaningless(self) -> None:
        """Raise InputError if the check found errors and the person did not overrule
        it.
        """
        if self.meaningless and not self.anyway:
            raise InputError(
                self.meaningless[0].rstrip("."),
                'repair it under Check, or press "Identify anyway"',
            )

    async def choose_robot(self, source: str, urdf: str | None = None) -> None:
        """Choose a robot: a built-in name, or the path of a URDF file with its shown
        name.

        Runs and models of the previous robot are dropped.
        """
        self.names[source] = urdf or source
        answer = await self._job("Reading the robot", "robot", robot={"source": source})
        if self.robot:
            self._step_from_here("another robot")
        own = {"source": source, "own_gravity": answer["gravity"], "file": urdf}
        self.robot = answer | own
        self.runs = []
        self.remedies = []
        self.prepared = []
        self.repairs = []
        self.assigned = {}
        self.mappings = []
        self.effects = list(answer["effects"])
        self.method = DEFAULT_METHOD

    def read_arrived(self) -> None:
        """Start to open the files that were dropped, unless a job is running.

        In that case the end of that job calls this method again. Runs wait for a robot.
        """
        if self.arrived and (self.robot or "robot" in map(kind_of, self.arrived)):
            self.start(self.open_arrived)
        elif self.arrived and self.notice is None:
            names = formatting.words([*self.arrived])
            self.say(f"{names}: read once the robot is chosen.", error=False)

    async def open_arrived(self) -> None:
        """Open the files that were dropped, by what their endings say: first robots, then
        runs, then models."""
        for name, path in self._take_arrived("robot").items():
            is_here = self.robot and self.robot["file"] is not None
            if not is_here or not cmp(self.robot["source"], path, shallow=False):
                await self.choose_robot(str(path), name)
        if "runs" in map(kind_of, self.arrived):
            await self.read_files()
        for name, path in self._take_arrived("model").items():
            await self.open_model(str(path), name)

    def _take_arrived(self, kind: str) -> dict[str, Path]:
        """Take the files of a kind, a key of ENDINGS, out of those that have arrived."""
        files = {k: x for k, x in self.arrived.items() if kind_of(k) == kind}
        self.arrived = {k: x for k, x in self.arrived.items() if k not in files}
        return files

    async def read_files(
        self, reading: Mapping[str, str] | None = None, again: Collection[str] = ()
    ) -> None:
        """Read the files that were dropped, and add them to the session's runs.

        reading : options of `convert` for these files; again : files of the runs that
        were read from them before.
        """
        files = self._take_arrived("runs")
        self.names |= {str(path): name for name, path in files.items()}
        listed = [{"path": str(path), "name": name} for name, path in files.items()]
        options = self.reading if reading is None else reading
        how: dict[str, Any] = {"files": listed, "options": options}
        how["assigned"] = self.assigned
        others = [run for run in self.runs if run["file"] not in again]
        try:
            await self._take_runs("Reading measurements", "read", others, **how)
        finally:
            # Uploaded copies are deleted, except for files whose columns the person
            # still has to assign.
            unassigned = {mapping["path"] for mapping in self.mappings}
            for path in files.values():
                if path.parent == self.folder and str(path) not in unassigned:
                    path.unlink(missing_ok=True)

    async def fetch_measured(self) -> None:
        """Load the public measurements of a built-in robot, and read them as runs."""
        name = self.robot["data"]["name"]
        answer = await self._job(f"Loading {name}'s measurements", "fetch", data=name)
        self.arrived |= {name: Path(path) for name, path in answer["files"].items()}
        await self.read_files()

    def choose_column(self, columns: Sequence[str], ours: str, theirs: str) -> None:
        """Assign a column of the refused files that have these columns to one of the
        names that a run needs.

        The form is not drawn anew: the browser shows the choice, and the next one may be
        on its way.

        Parameters
        ----------
        ours : str
            Name in a run, such as "q1" or "tau1"; "rate" for the samples a second.
        theirs : str
            Name of the column in the files, or the rate; "" for none.
        """
        self.mappings = [
            {**mapping, "chosen": {**mapping["chosen"], ours: theirs}}
            if mapping["columns"] == columns
            else mapping
            for mapping in self.mappings
        ]
        self.save()
        self.changed()

    async def leave_out(self, columns: Sequence[str]) -> None:
        """Leave the refused files with these columns out."""
        gone = [m for m in self.refused if m["columns"] == columns]
        names = formatting.words([m["name"] for m in gone])
        self._step_from_here(f"{names} left out", keeps_models=True)
        self.mappings = [m for m in self.mappings if m not in gone]

    async def read_mapped(self, columns: Sequence[str], torques: str = "") -> None:
        """Read the files with these columns again, as the person assigned them; the runs
        that were read from them before go.

        A file that is refused again keeps its choices, with the reason beside them.

        torques : name of another set of torques to take; the rest stays as it was read.
        """
        files = [m for m in self.mappings if m["columns"] == columns]
        chosen = files[0]["torques"].get(torques) or files[0]["chosen"]
        try:
            options = _options_of(columns, chosen)
        except InputError as error:
            self.mappings = [
                {**m, "reason": str(error)} if m["columns"] == columns else m
                for m in self.mappings
            ]
            raise
        self.arrived |= {file["name"]: Path(file["path"]) for file in files}
        again = {file["run"] for file in files}
        await self.read_files({**self.reading, **options}, again)
        if all(mapping["columns"] != columns for mapping in self.refused):
            self.assigned = {**self.assigned, json.dumps(columns): options}

    async def simulate(
        self,
        effect: str,
        joints: list[int],
        level: str,
        seed: int,
        names: Sequence[str] = RUN_FILES,
    ) -> None:
        """Replace the runs by simulated ones of the robot, with one effect hidden in
        them.

        joints : numbers from 1, where the effect acts; level : how strong it is; names
        : of the simulated runs.
        """
        how = {"effect": effect, "joints": joints, "level": level, "seed": seed}
        how["names"] = list(names)
        await self._take_runs("Simulating", "simulate", [], **how)
        at = ":" + "+".join(map(str, joints)) if joints else ""
        self.hidden = f"{effect}{at}"
        hide = [] if effect == "none" else ["--hide", self.hidden]
        words = ["--level", level, "--seed", str(seed), "--out", "."]
        self.prepared = [["simulate", self.robot_word, *hide, *words]]

    async def _take_runs(
        self, title: str, job: str, before: list[dict[str, Any]], **details: Any
    ) -> None:
        """Run a job that makes runs beside the runs ``before``.

        A run whose name says "test" is used for testing, and so is one that arrives where
        there is a model: that is judged again, with the new run.
        """
        if not self.robot:
            raise InputError(
                "No robot is chosen", "choose it first, so that its joints are known"
            )
        answer = await self._job(title, job, runs=before, **details)
        new = answer["runs"][len(before) :]
        refused = [f"{why} It is left out." for why in answer.get("refused", ())]
        has_left_out = bool(refused)
        asked = {mapping["path"] for mapping in self.mappings}
        mappings = answer.get("mappings", ())
        dropped = list[str]()
        refused += [m["reason"] for m in mappings if m["path"] in asked and m["reason"]]
        if new:
            is_for_model = bool(self.history) and len(before) == len(self.runs)
            for run in new:
                if is_for_model or for_testing(run["name"]):
                    run["use"] = "test"
            answer["runs"] = self._with_questions(answer["runs"])
            new = answer["runs"][len(before) :]
            counted = f"{formatting.count(len(new), 'run')} added"
            dropped = await self._go_on_with(answer, counted)
            self.hidden = self.hidden if before else ""
            self.prepared = [] if not before else self.prepared
            self.repairs = [] if not before else self.repairs
            for run, how in zip(new, answer.get("read", ()), strict=False):
                if how["options"]:
                    words = ["convert", how["file"]]
                    for name, value in how["options"].items():
                        words += option_words(name, value)
                    words += ["--problem", self.robot_word, "--out", run["in_commands"]]
                    self.prepared = [*self.prepared, words]
            self._choose_uses(new)
            self.effects = list(answer.get("effects", self.effects))
        self._keep_mappings(details.get("files", ()), mappings)
        remarks = [*answer.get("remarks", ())]
        if waiting := [run for run in new if run["use"] == "wait"]:
            self.new = ("check", "check")
        tested = [run["name"] for run in new if run not in waiting]
        if tested and self.history:
            names = formatting.words(tested)
            remarks.append(f"The model is tested on {names} as well.")
        remarks += dropped
        self.say(*refused, *remarks, error=bool(refused), has_left_out=has_left_out)

    async def _judged_on(
        self, runs: Sequence[dict[str, Any]], robot: Mapping[str, Any]
    ) -> list[ModelStep]:
        """Return the models of the history judged on other runs; of another robot none,
        nor those that were identified from other runs. A model that was brought was
        identified elsewhere: it stays.

        What a diagnosis has found is of the runs that it saw: it is dropped.
        """
        kept = self.history
        same_robot = all(robot[x] == self.robot[x] for x in ("hold", "gravity"))
        if same_robot and _used(runs) == _used(self.runs):
            return kept
        if not same_robot:
            kept = []
        elif _training_of(runs) != _training_of(self.runs):
            kept = [step for step in kept if step.opened]
        if not kept:
            return []
        n_files = len([*self.folder.glob("model-*.json")])
        steps = [
            {"model": step.file, "out": str(self.folder / f"model-{k}.json")}
            for k, step in enumerate(kept, start=n_files + 1)
        ]
        title = "Testing the model" if len(steps) == 1 else "Testing the models"
        answer = await self._job(title, "judge", runs=runs, steps=steps)
        return [
            replace(step, **{**judged, "seconds": step.seconds}, findings=None)
            for step, judged in zip(kept, answer["steps"], strict=True)
        ]

    def _with_questions(self, runs: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
        """Return the runs, of which those wait that no model is tested on before a
        question is answered: in which unit its torque is, or what becomes of what the
        check calls an error. The others are tested on."""
        unit = runs[0].get("torque_unit")
        has_units = not any(asks_for_unit(run) for run in runs if run["use"] == "train")

        def use_of(run: Mapping[str, Any]) -> str:
            if run["use"] not in ("test", "wait"):
                return str(run["use"])
            is_open = run.get("torque_unit") != unit
            is_open |= is_refused(run) or (has_units and asks_for_unit(run))
            return "wait" if is_open and self.history else "test"

        return [{**run, "use": use_of(run)} for run in runs]

    async def _go_on_with(self, answer: Mapping[str, Any], label: str) -> list[str]:
        """Go on, as a step by a label, with what a job has answered, and with the models
        as they are judged on it; return what is said of those that are dropped."""
        models = await self._judged_on(
            answer["runs"], {**self.robot, **answer["robot"]}
        )
        if len(models) < len(self.history):
            opened = f"What was added to {models[0].opened} is" if models else ""
            dropped = [_DROPPED.format(opened or "The model is")]
        else:
            dropped = []
        self._step_from_here(label)
        self._take(answer)
        self.history = models
        if models:
            self.new = ("identify", "fit")
        return dropped

    def _take(self, answer: Mapping[str, Any]) -> None:
        """Take over runs, remedies and robot as a job has answered them."""
        self.runs = answer["runs"]
        self.remedies = answer["remedies"]
        self.robot = {**self.robot, **answer["robot"]}

    def _keep_mappings(
        self, files: Sequence[Mapping[str, str]], new: Sequence[Mapping[str, Any]]
    ) -> None:
        """Keep what is known of the columns of files: what a person has chosen stays
        where they are refused again.

        files : what was read, with path and name; new : those whose columns can be chosen.
        """
        paths = {file["path"] for file in files}
        before = {m["path"]: m for m in self.mappings}
        self.mappings = [m for m in self.mappings if m["path"] not in paths]
        for file in new:
            kept = {} if file["run"] else before.get(file["path"], {})
            self.mappings.append(
                {**kept, **file, "chosen": kept.get("chosen") or file["chosen"]}
            )
        if self.refused:  # their columns are to be seen
            self.new = ("measure", "runs")

    @property
    def published_gains(self) -> list[str]:
        """Drive gains of the robot's joints [N m per A] that the data set of it publishes;
        none of another robot."""
        gains = (self.robot["data"] or {}).get("drive_gains") or ()
        return [f"{gain:g}" for gain in gains]

    @property
    def refused(self) -> list[dict[str, Any]]:
        """The files that wait for their columns."""
        return [m for m in self.mappings if not m["run"]]

    @property
    def guessed(self) -> list[dict[str, Any]]:
        """The files whose columns were guessed, and whose run is there as it was read."""
        there = {run["file"] for run in self.runs}
        return [m for m in self.mappings if m["run"] in there]

    @property
    def warnings(self) -> list[dict[str, Any]]:
        """What the check found in the runs; notes do not count."""
        issues = [issue for run in self.runs for issue in run["findings"]]
        return [issue for issue in issues if issue["severity"] != "note"]

    @property
    def issues(self) -> list[tuple[dict[str, Any], list[dict[str, Any]]]]:
        """Each issue of the check once, with the runs that have it.

        Issues are the same if kind, place and remedy are equal; the first run's sentence
        stands for all. Example: [({"kind": "torque sign", ...}, [run 1, run 2])].
        """
        groups = dict[
            tuple[str, str, str], tuple[dict[str, Any], list[dict[str, Any]]]
        ]()
        for run in self.runs:
            for issue in run["findings"]:
                key = (issue["kind"], issue["where"], issue["remedy"])
                groups.setdefault(key, (issue, []))[1].append(run)
        return list(groups.values())

    def units_as_logged(self, run: str) -> tuple[str, str]:
        """Return the units of a run's positions and of its torque where these are not the
        robot's; "" where they are."""
        (one,) = (x for x in self.runs if x["name"] == run)
        kinds = [issue["kind"].partition("positions in ") for issue in one["findings"]]
        position = next((unit for begin, _, unit in kinds if unit and not begin), "")
        torque = one.get("torque_unit") or ("A?" if asks_for_unit(one) else "")
        return position, torque

    def faults_in_words(self, change: Mapping[str, Any]) -> str:
        """What a change repairs that makes several repairs, in a few words each: "torque
        sign (joint 4) in run2.csv"; "" of one that is a single issue's."""
        faults_by_runs = dict[str, list[str]]()
        made = set(change["arguments"].get("apply", ()))
        for issue, runs in self.issues:
            repairs = [x["change"] for x in issue["remedies"]]
            if change in repairs or change["verb"] != "transform":
                return ""
            words = [
                x["arguments"]["apply"] for x in repairs if "apply" in x["arguments"]
            ]
            if not any(made.issuperset(word) for word in words):
                continue
            names = formatting.words([run["name"] for run in runs])
            names = "all runs" if len(runs) == len(self.runs) > 1 else names
            where = issue["where"] if len(issue["where"]) < _MOST_OF_PLACE else ""
            fault = f"{issue['kind']} ({where})".removesuffix(" ()")
            faults_by_runs.setdefault(names, []).append(fault)
        found = faults_by_runs.items()
        return "; ".join(f"{formatting.words(x)} in {names}" for names, x in found)

    @property
    def kinds_of_issue(self) -> list[str]:
        """Kinds of what the check found in the runs, each once."""
        return sorted({issue["kind"] for issue in self.warnings})

    @property
    def robot_word(self) -> str:
        """The robot as a command names it: its file, or its name."""
        return str(self.robot["file"] or self.robot["source"])

    def _choose_uses(self, new: Sequence[dict[str, Any]]) -> None:
        """Give each run a use, so that some data are for training and, if possible,
        some for testing.

        A single run is split into both if it is long enough. Of several that are all new
        (``new``) the last is for testing, as `check` advises, unless no other is for
        training; where their names make all of them for testing, the first is for training.
        """
        if len(self.runs) == 1:
            self.runs[0]["use"] = "split" if self.runs[0]["split"] else "train"
            return
        if not new or len(new) < len(self.runs):
            return
        uses = [run["use"] for run in new]
        if len({*uses}) == 1:
            new[0]["use"], new[-1]["use"] = "train", "test"
        elif uses[-1] == "train" and "train" in uses[:-1]:
            new[-1]["use"] = "test"

    async def use(self, file: str, use: str) -> None:
        """Use a run for "train", "test" or "split", or remove it ("").

        The models are judged again; they are dropped where other runs are for training
        now than they were identified from.
        """
        chosen = next((run for run in self.runs if run["file"] == file), None)
        if chosen is None:  # the job before has changed or removed it
            raise InputError("This run has changed", "choose its use again")
        changed = ({**run, "use": use} if run is chosen else run for run in self.runs)
        runs = [run for run in changed if run["use"]]
        if not use and {run["use"] for run in runs} <= {"test", "wait"}:
            one = "split" if len(runs) == 1 and runs[0]["split"] else "train"
            runs = [{**run, "use": one} if run is runs[0] else run for run in runs]
        if use:
            left = {"runs": runs, "remedies": self.remedies, "robot": {}}
            gone = await self._go_on_with(left, f"use of {chosen['name']}")
        else:
            left = await self._job("Checking the runs", "check_again", runs=runs)
            gone = [f"{chosen['name']} is removed: Undo brings it back."]
            gone += await self._go_on_with(left, "a run removed")
        self.say(*gone, error=False)

    async def identify_from(self, names: Collection[str]) -> None:
        """Identify the model again from the runs of these names, and test on the others."""
        uses = ["train" if run["name"] in names else "test" for run in self.runs]
        runs = [{**run, "use": use} for run, use in zip(self.runs, uses, strict=True)]
        which = formatting.words([*names]) if "test" in uses else "all runs"
        step = await self._fit(
            f"Identifying from {which}", f"identified from {which}", runs
        )
        self._begin(step)
        self.runs = runs

    async def mount(self, gravity: str) -> None:
        """Set gravity in the robot's base frame, "x,y,z" [m/s^2]."""
        vector = numbers("gravity", gravity, 3)
        words = f"gravity {gravity}"
        await self.apply(Change("mount", words, {"gravity": vector}).to_dict())

    async def hold(self, positions: str) -> None:
        """Hold joints that do not move, "finger_joint=0"."""
        words = f"{positions} held"
        held = {"positions": parse_held(positions)}
        await self.apply(Change("hold", words, held).to_dict())

    def before_repair(self, k: int) -> dict[str, Any] | None:
        """Return what was there before the k-th repair (from 0); None where more than
        repairs has changed the runs since, or that was too long ago."""
        now = {name: getattr(self, name) for name in KEPT}
        states = [*(kept for _, kept in self.past), now]
        begins = [n for n, kept in enumerate(states) if len(kept["repairs"]) == k]
        states = states[begins[-1] :] if begins else []
        is_kept = all(
            len(after["repairs"]) == len(before["repairs"]) + 1
            if after["repairs"] != before["repairs"]
            else after["runs"] == before["runs"]
            for before, after in pairwise(states)
        )
        is_known = all(change["verb"] for _, _, change in self.repairs)
        return states[0] if states and is_kept and is_known else None

    async def take_back(
        self, k: int, instead: Sequence[Mapping[str, Any]] = ()
    ) -> None:
        """Take the k-th repair (from 0) back, or make others instead of it; those after
        it are made again."""
        before = self.before_repair(k)
        if before is None:
            raise InputError("This repair cannot be taken back alone", "press Undo")
        again = [*instead, *(change for _, _, change in self.repairs[k + 1 :])]
        had_model = self.model is not None
        self._step_from_here(f"taken back: {self.repairs[k][0]}")
        for name, value in before.items():
            setattr(self, name, value)
        for change in again:
            await self.apply(change)
        if had_model and self.model is None:
            self.say(_DROPPED.format("The model is"), error=False)

    def _earlier_unit(self, change: Mapping[str, Any]) -> tuple[int, dict[str, Any]]:
        """Return the repair (from 0) that has set the unit of the channels that a change
        reads, and what else that repaired; -1 where none has."""
        channels = {*change["arguments"].get("scale", {})}
        for k, (_, _, made) in enumerate(self.repairs):
            arguments = made["arguments"]
            words = arguments.get("apply", ())
            others = [word for word in words if word != "unit:tau"]
            is_same = not channels.isdisjoint(arguments.get("scale", {}))
            is_same |= "tau" in channels and len(others) < len(words)
            if is_same and self.before_repair(k) is not None:
                return k, {**made, "arguments": {"apply": others}} if others else {}
        return -1, {}

    async def read_in_unit(self, change: Mapping[str, Any]) -> None:
        """Read runs in the unit that a person names of the log: in place of the unit that
        an earlier repair has taken it for."""
        k, others = self._earlier_unit(change)
        if k < 0:
            await self.apply(change)
        else:
            await self.take_back(k, [x for x in (others, change) if x])

    async def apply(self, change: Mapping[str, Any]) -> None:
        """Do what a remedy says: to the runs and the robot, to the model, or a motion to
        record.

        change : as the remedy's JSON has it.
        """
        verb = change["verb"]
        if verb in ("add", "reset"):
            await self._add(change)
            return
        named = change["arguments"].get("run")
        files = [run["file"] for run in self.runs if named in (None, run["name"])]
        if is_leaving_out(change):
            await self.use(files[0], "")
        elif verb == "read":
            one = {k: x for k, x in change["arguments"].items() if k != "run"}
            await self._change({**change, "arguments": one}, files)
        elif verb != "record":
            await self._change(change)
        if verb != "record" and not is_leaving_out(change):
            self.repairs[-1][2] = {**change}

    async def _change(
        self, change: Mapping[str, Any], files: Collection[str] | None = None
    ) -> None:
        """Change runs and robot, and check them again; what it did to the error on data
        left out is said. Models stay that the change leaves their robot and runs.

        files : the runs that are changed; None: all.
        """
        request = self._change_request(change, files)
        words = request["change"]["words"]
        self._doing(title=label_of(words), status="")
        try:
            answer = self.foreseen.get(json.dumps(request)) or await self._run(request)
        except InputError as error:
            self._keep_outcome(change, {"refused": str(error)})
            raise
        commands = self._commands_of(change, request["files"])
        answer = {**answer, "runs": self._with_questions(answer["runs"])}
        done = words
        if faults := self.faults_in_words(change):  # the words count them
            done = f"repaired: {faults}"
        elif len(request["files"]) < len(self.runs):
            names = [r["name"] for r in self.runs if r["file"] in request["files"]]
            done = f"{words} in {formatting.words(names)}"
        columns = [x["columns"] for x in self.runs if x["file"] in request["files"]]
        dropped = await self._go_on_with(answer, done)
        scale = change["arguments"].get("scale", {})
        for key in {json.dumps(names) for names in columns if names and scale}:
            texts = ",".join(f"{name}={unit}" for name, unit in scale.items())
            options = {**self.assigned.get(key, {}), "scale": texts}
            self.assigned = {**self.assigned, key: options}
        if change["verb"] in ("transform", "read", "cut"):
            self.prepared = [*self.prepared, *commands]
        self.new = ("check", "check")
        self.seen_issues = self.kinds_of_issue
        self.repairs = [*self.repairs, [done, answer["effect"], change]]
        self.say(*dropped, error=False)

    def _commands_of(
        self, change: Mapping[str, Any], files: Collection[str]
    ) -> list[list[str]]:
        """Return the words of the commands that make a change of these runs: one for
        all, or, where each is read anew, one a run."""
        written = {run["name"]: run["in_commands"] for run in self.runs}
        arguments = change["arguments"]
        if "run" in arguments:
            arguments = {**arguments, "run": written[arguments["run"]]}
        one = Change.from_dict({**change, "arguments": arguments})
        checks = [self._check_command]
        if change["verb"] == "read":
            names = [run["in_commands"] for run in self.runs if run["file"] in files]
            checks = [replace(checks[0], runs=[name]) for name in names]
        commands = [command_of(one, Files(check)) for check in checks]
        return [words for words in commands if words is not None]

    def _change_request(
        self, change: Mapping[str, Any], files: Collection[str] | None = None
    ) -> dict[str, Any]:
        """Return the request for a change of robot and runs, with what commands call the
        runs afterwards: as the command that does the same."""
        command = self._check_command
        names = [run["in_commands"] for run in self.runs]
        chosen = [run["file"] for run in self.runs]
        chosen = [file for file in chosen if files is None or file in files]
        has_commands = bool(self._commands_of(change, chosen))
        if change["verb"] == "transform" and has_commands and len(names) > 1:
            names = [f"{command.copy}/{Path(name).stem}.csv" for name in names]
        elif change["verb"] in ("transform", "read") and has_commands:
            names = [
                str(replace(command, runs=[run["in_commands"]]).copy)
                if run["file"] in chosen
                else run["in_commands"]
                for run in self.runs
            ]
        elif change["verb"] == "cut":
            cut = change["arguments"]["run"]
            places = enumerate(run["name"] == cut for run in self.runs)
            names = [
                str(cut_copy(names[k])) if is_cut else names[k] for k, is_cut in places
            ]
        change = {**change, "words": _words_of_reading(change) or change["words"]}
        return self._request("change", change=change, files=chosen, names=names)

    async def leave_as_read(self, chosen: Mapping[str, Any]) -> None:
        """Remember that a run is in the unit in which it was read: it may be tested on."""
        runs = [
            {**run, "stated": True} if run["file"] == chosen["file"] else run
            for run in self.runs
        ]
        left = {"remedies": self.remedies, "robot": {}}
        left["runs"] = self._with_questions(runs)
        await self._go_on_with(left, f"{chosen['name']} left as read")

    @property
    def _check_command(self) -> CheckCommand:
        """The `check` of the runs, as a terminal needs it."""
        gravity = self.robot["gravity"]
        is_own = gravity == self.robot["own_gravity"]
        return CheckCommand(
            problem=self.robot_word,
            runs=[run["in_commands"] for run in self.runs] or ["run.csv"],
            hold=self.robot["hold"] or None,
            gravity=None if is_own else ",".join(f"{g:g}" for g in gravity),
        )

    async def make_motion(
        self, change: Mapping[str, Any], ready: Callable[[str], None]
    ) -> None:
        """Make the motion that a remedy asks to record; ``ready`` is called with its
        file's name."""
        separate = change.get("arguments", {}).get("separate", ())
        how: dict[str, Any] = {"separate": separate}
        # Effects are told apart beside the last model that holds none of them.
        for model in self.history if separate else ():
            if not any(is_among(text, model.effects) for text in separate):
                how["model"] = model.file
        answer = await self._job("Making a motion", "motion", **how)
        self.taken = {*self.taken, answer["file"]}
        self.say(answer["words"], error=False)
        ready(answer["file"])

    async def identify(self) -> None:
        """Identify the first model of a new history with the chosen effects and
        method.
        """
        self._begin(await self._fit("Identifying the model", "identified", self.runs))

    async def _fit(
        self, title: str, label: str, runs: Sequence[Mapping[str, Any]]
    ) -> ModelStep:
        """Return the model that is identified from runs, as a step of the history."""
        if not self.effects:
            raise InputError(
                "No effect is chosen", f"choose at least {DEFAULT_EFFECTS[0]}"
            )
        self._refuse_meaningless()
        request = {
            "effects": ",".join(self.effects),
            "method": self.method,
            "anyway": self.anyway,
            "runs": runs,
        }
        return await self._step(title, "fit", request, label=label)

    async def identify_anyway(self) -> None:
        """Identify from runs that the check calls meaningless."""
        self.anyway = True
        try:
            await self.identify()
        except InputError as error:
            self.impossible = sentence(error)
            raise

    def rename(self, name: str) -> None:
        """Give the project a name of the person's own."""
        self.name = name.strip()[:80]
        self.save()
        self.changed()

    def see_issues(self) -> None:
        """Remember that the person was led to the issues of the check."""
        self.seen_issues = self.kinds_of_issue
        self.save()
        self.changed()

    async def open_model(self, path: str, name: str) -> None:
        """Begin a new history with a model.json, perhaps identified from other runs.

        This is how a payload is identified: the model of the arm stays fixed.
        """
        self.names[path] = name
        step_fields = {"label": name, "opened": name}
        self._begin(
            await self._step(
                f"Opening {name}", "open_model", {"model": path}, **step_fields
            )
        )

    async def _step(
        self, title: str, job: str, request: dict[str, Any], **step_fields: Any
    ) -> ModelStep:
        """Run a job that makes a model, and return that model as a step of the history.

        step_fields : fields of ModelStep that the job's answer does not hold.
        """
        out = self.folder / f"model-{len([*self.folder.glob('model-*.json')]) + 1}.json"
        return ModelStep(
            **await self._job(title, job, out=str(out), **request), **step_fields
        )

    def _begin(self, step: ModelStep) -> None:
        """Begin a new history with this model, and point the page to its fit."""
        self._step_from_here(step.label)
        self.history = [step]
        self.new = ("identify", "fit")

    @property
    def runs_since(self) -> list[dict[str, Any]]:
        """The runs that may show what has changed since the model was identified, such as
        a load: those that it was not identified from."""
        if self.history[0].opened:
            return self.runs
        changed = self.current.changed_runs
        tested = [run for run in self.runs if run["use"] == "test"]
        return [run for run in tested if run["name"] in changed] or tested

    async def keep_model(self) -> None:
        """Keep the model, and go on with the runs alone that may show what has changed
        since: as if it were opened with them on a page of its own."""
        if not self.runs_since:
            what = "A load is part of a model that is identified with it"
            raise InputError(what, "bring a run with the load, or a model without it")
        runs = [{**run, "use": "train"} for run in self.runs_since]
        if len(runs) == 1 and runs[0]["split"]:
            runs[0]["use"] = "split"
        commands = self.command_words()
        request = {"model": self.current.file, "runs": runs}
        n_made = sum(words[0] in ("identify", "add") for words in commands)
        kept = {"label": "what has changed since", "opened": f"model{n_made}.json"}
        left = await self._job("Checking the runs", "check_again", runs=runs)
        step = await self._step("Testing the model", "open_model", request, **kept)
        self._begin(step)
        self._take(left)
        self.prepared = commands

    async def find_change(self) -> None:
        """Look with the model as it is for a load, or for what else has changed since."""
        if not self.history[0].opened:
            await self.keep_model()
        await self.diagnose(frozen=True)

    async def diagnose(self, frozen: bool = False) -> None:
        """Diagnose which effects the current model misses, and store that with the
        model; ``frozen``: its parameters are kept."""
        self._refuse_meaningless()
        pictures = f"cards-{Path(self.current.file).stem}.npz"
        verdicts = {file: x["verdict"] for file, x in self.current.exported.items()}
        how = {"frozen": frozen, "pictures": pictures}
        how["verdicts"] = {"": self.current.comparison["verdict"], **verdicts}
        answer = await self._job("Looking for what is missing", "find", **how)
        diagnosis = Diagnosis.from_dict(answer["diagnosis"])
        # A model that lacks a confident finding gets a lower grade.
        verdict = answer["verdicts"].pop("")
        exported = {
            file: {**self.current.exported[file], "verdict": one}
            for file, one in answer["verdicts"].items()
        }
        diagnosed = replace(
            self.current,
            findings=diagnosis,
            curve_texts=tuple(answer["curves"]),
            pictures=pictures,
            exported=exported,
            not_held=answer["not_held"],
            comparison={**self.current.comparison, "verdict": verdict},
        )
        self.history = [*self.history[:-1], diagnosed]
        self.new = "diagnose", "history"

    async def add(self, text: str) -> None:
        """Add an effect by its text to the current model, which is kept for one that only
        a fixed model shows."""
        words = f"add {effect_in_words(text)}"
        change = Change("add", words, {"effects": [text]}).to_dict()
        frozen = effect_types()[text.partition(":")[0]].frozen_only
        if frozen and not self.history[0].opened:
            await self.keep_model()
        await self._add(change, frozen)

    async def _add(self, change: Mapping[str, Any], frozen: bool = False) -> None:
        """Add what a change says to the current model; the result is a new step of the
        history."""
        texts = change["arguments"]["effects"]
        diagnosis = self.findings
        frozen = frozen or (diagnosis is not None and diagnosis.frozen)
        request: dict[str, Any] = {
            "change": change,
            "frozen": frozen,
            "diagnosed": diagnosis and diagnosis.to_dict(),
        }
        label = f"with {formatting.count(len(texts), 'finding')}"
        if len(texts) <= 1:
            label = f"with {effects_in_words(texts) or 'measured curves'}"
        step = await self._step(
            "Adding what was chosen",
            "extend",
            request,
            label=label,
            added=tuple(texts),
            findings_added=change["arguments"].get("findings"),
            frozen=frozen,
        )
        self._step_from_here(change["words"], keeps_models=True)
        self.history = [*self.history, step]
        self.new = "diagnose", "history"

    async def ask(self, title: str, job: str, **on: Any) -> None:
        """Run a job that changes nothing, and keep its answer for the current model."""
        model = self.current.file
        self.answers[job] = {**await self._job(title, job, **on), "model": model}

    async def show_me(self) -> None:
        """Demonstrate the full workflow on simulated runs with a hidden effect.

        The steps and runs are those of `sdp-vs-penalty demo`.
        """
        await self.choose_robot(ARM)
        joint = self.robot["n"]
        await self.simulate(HIDDEN, [joint], LEVEL, SEED, RUNS)
        await self.identify()
        await self.diagnose()
        assert self.findings is not None
        found = [f.text for f in self.findings.helpful]
        if found:
            await self.apply(self.findings.remedies[0].change.to_dict())

    def download(
        self,
        name: str,
        ready: Callable[[str], None],
        options: Mapping[str, str] | None = None,
    ) -> None:
        """Give out a file, at once where it was made of the same; ``ready`` is called with
        its name once it exists. It is made beside a job that runs.

        options : further fields of the request, such as the flange of a payload.
        """
        request = self._request(
            "take", name=name, **self._content(name), **(options or {})
        )
        if self.made.get(name) == json.dumps(request):
            ready(name)
        elif self.task is None:
            self.start(self._take_file, request, ready)
        else:
            self.say(
                f"{name} is made beside the job, and then downloaded.", error=False
            )
            making = self._take_file(request, ready, is_aside=True)
            task = asyncio.get_running_loop().create_task(making)
            self.making.add(task)
            task.add_done_callback(self.making.discard)

    async def _take_file(
        self,
        request: Mapping[str, Any],
        ready: Callable[[str], None],
        is_aside: bool = False,
    ) -> None:
        """Make a file to download, as :meth:`download` asks for it."""
        name = request["name"]
        try:
            if is_aside:
                await self.pool.run(request, no_progress, is_aside=True)
            else:
                self._doing(title=f"Making {name}", status="")
                await self._run(request)
        except InputError as error:
            self.say(f"{name}: {error}")
            return
        self.made[name] = json.dumps(request)
        self.taken = {*self.taken, name}
        self.say()
        ready(name)

    def _content(self, name: str) -> dict[str, Any]:
        """Return what a file to download is made of, besides robot, runs and model."""
        steps = enumerate(self.history, start=1)
        return {
            "models": [{"label": f"{k}: {m.label}", "file": m.file} for k, m in steps],
            "commands": self.commands(),
            "findings": self.findings and self.findings.to_dict(),
            "urdf": self.robot["source"] if self.robot["file"] else None,
            "forward": self.answer("forward") is not None,
            "verdict": self.current.verdict_on(name).to_dict(),
            "model": self.current.model_of(name),
        }

    async def identify_for(self, file: str) -> None:
        """Identify without the effects that a file cannot hold, for this file alone: the
        model stays as it is."""
        effects = self.current.exported[file]["effects"]
        known = (
            effect_types()
        )  # what was found with the model fixed is in its last link
        effects = [x for x in effects if not known[x.partition(":")[0]].frozen_only]
        request = {
            "effects": ",".join(effects),
            "method": self.method,
            "anyway": self.anyway,
            "runs": self.runs,
            "diagnosed": self.findings and self.findings.to_dict(),
        }
        title = f"Identifying for {file}"
        again = await self._step(title, "fit", request)
        self._step_from_here(f"identified for {file}", keeps_models=True)
        self.history = [*self.history[:-1], self.current.beside(file, again)]
        self.new = ("use", "take-away")
