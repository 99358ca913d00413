"""One tab: what it has chosen, read and identified, what is said of it, and how its jobs are done."""

from __future__ import annotations

import asyncio
import shlex
import time
from collections.abc import Callable, Coroutine, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import wraps
from pathlib import Path
from typing import Any

import numpy as np

from sdp_vs_penalty.data.cli_parsing import numbers
from sdp_vs_penalty.data.files import for_testing
from sdp_vs_penalty.diagnosis.findings import Diagnosis
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.estimators import DEFAULT_METHOD
from sdp_vs_penalty.page.worker import WorkerPool, Working, internal_error
from sdp_vs_penalty.reports.demo import ARM, HIDDEN, LEVEL


@dataclass(frozen=True)
class Notice:
    """One or more sentences for the person: an error, or something worth knowing."""

    texts: tuple[str, ...]
    error: bool = True


def background(title: str) -> Callable[[Callable[..., Coroutine[Any, Any, None]]], Any]:
    """A verb of the session: under a title, whose {} are its arguments, it starts what its coroutine
    does, unless a job is being done; ``.do`` is that coroutine, a step of another verb."""

    def verb(do: Callable[..., Coroutine[Any, Any, None]]) -> Any:
        @wraps(do)
        def start(self: Session, *given: Any) -> None:
            if not self.busy:
                self._start(title.format(*given, self=self), do(self, *given))

        start.do = do  # type: ignore[attr-defined]
        return start

    return verb


@dataclass(frozen=True)
class ModelStep:
    """One model of a session's history, judged: what ``summary`` of jobs.py says.

    file : its model.json, beside it the .npz of each run's torques; runs : names of those, training runs
    first, a part of a run by its seconds; judged_on : the runs behind comparison and failures (as
    `compare --json` writes them); judged, about : what ``judged_row`` and :func:`about` say; label,
    added : what it is called and the effects added to the step below, with the others held where frozen;
    opened : the file that a person brought, if any; servo : whether it knows the servos of a log
    without torque; findings : what it lacks, if it was diagnosed, and what `add` calls its curves.
    """

    file: str
    runs: list[str]
    judged_on: list[str]
    method: str
    effects: list[str]
    comparison: dict[str, Any]
    failures: list[dict[str, Any]]
    judged: list[str]
    about: dict[str, Any]
    on_bounds: list[str]
    seconds: float
    label: str = ""
    added: tuple[str, ...] = ()
    frozen: bool = False
    opened: str = ""
    servo: bool = False
    findings: Diagnosis | None = None
    curve_texts: Sequence[str] = ()


_OTHER_RUNS = "The runs have changed: identify again."


@dataclass
class Session:
    """What one tab has chosen, read and identified, what is said of it, and all that can be done to it.

    One job at a time: a verb starts its work in the background and returns. Kept while the server runs,
    also of a closed tab.

    robot : the answer about it, with ``source``, or nothing; runs : see run_jobs.keep; history : models,
    the last one current; undone : those that were left, the last one first to come back.
    """

    token: str
    folder: Path
    pool: WorkerPool
    robot: dict[str, Any] = field(default_factory=dict)
    runs: list[dict[str, Any]] = field(default_factory=list)
    effects: list[str] = field(default_factory=list)
    method: str = DEFAULT_METHOD
    seed: int = 0
    frozen: bool = False
    #: What is written in the fields that are the command line's options.
    options: dict[str, str] = field(default_factory=dict)
    reading: dict[str, str] = field(default_factory=dict)
    #: Identify even from runs that the check calls meaningless.
    anyway: bool = False
    history: list[ModelStep] = field(default_factory=list)
    undone: list[ModelStep] = field(default_factory=list)
    #: By job what was answered last, with the ``model`` that was asked about.
    answers: dict[str, dict[str, Any]] = field(default_factory=dict)
    notice: Notice | None = None
    working: Working | None = None
    task: asyncio.Task[None] | None = None
    #: The tabs that show it (workbench.py).
    watchers: list[Any] = field(default_factory=list)
    arrived: dict[str, Path] = field(default_factory=dict)
    #: The arguments of the command that makes the simulated runs.
    made_by: list[str] | None = None
    left_at: float = field(default_factory=time.monotonic)
    #: The stage and the part where what is new can be seen.
    new: tuple[str, str] | None = None
    #: Whether a tab has shown it yet.
    shown: bool = False
    #: How often a control was moved in vain: it has to be drawn anew as it is.
    refusals: int = 0
    #: Shown names by path.
    names: dict[str, str] = field(default_factory=dict)
    #: Names of files that jobs have made, to be fetched.
    made: set[str] = field(default_factory=set)
    _read: dict[str, dict[str, Any]] = field(default_factory=dict)
    _count: int = 0

    @property
    def model(self) -> ModelStep | None:
        return self.history[-1] if self.history else None

    @property
    def current(self) -> ModelStep:
        """``model``, in steps that come after the first one. Raises InputError where there is none."""
        if not self.history:
            raise InputError("No model yet", "identify one first")
        return self.history[-1]

    @property
    def meaningless(self) -> list[str]:
        """What the check holds against identifying from the runs for training, a sentence each."""
        return [
            f"{run['name']}: {f['what'].rstrip('.')}: {f['remedy']}"
            for run in self.runs
            if run["use"] in ("train", "split")
            for f in run["findings"]
            if f["severity"] == "error"
        ]

    @property
    def found_for(self) -> int:
        """How many models there were when the last diagnosis was made; 0 without one."""
        return max((k for k, m in enumerate(self.history, start=1) if m.findings), default=0)

    @property
    def findings(self) -> Diagnosis | None:
        """The last diagnosis."""
        return self.history[self.found_for - 1].findings if self.found_for else None

    @property
    def added(self) -> set[str]:
        """Texts of the findings that are part of the current model."""
        return {text for model in self.history[self.found_for :] for text in model.added}

    def answer(self, job: str) -> dict[str, Any] | None:
        """What a job said of the current model, if it was asked."""
        found = self.answers.get(job)
        return found if found and self.model and found["model"] == self.model.file else None

    def recording(self, model: ModelStep, run: str) -> dict[str, Any]:
        """t, torque, modelled, q, dq, ddq, tf and poses of a run (jobs.py)."""
        return self.arrays(f"{Path(model.file).stem}-{model.runs.index(run)}.npz")

    def arrays(self, name: str) -> dict[str, Any]:
        """What a job has kept in an .npz file of the session's folder; once read it stays."""
        if name not in self._read:
            with np.load(self.folder / name, allow_pickle=False) as read:
                self._read[name] = dict(read)
        return self._read[name]

    def changed(self) -> None:
        for watcher in list(self.watchers):
            watcher.redraw()

    def say(self, *texts: str, error: bool = True) -> None:
        self.notice = Notice(texts, error) if texts else None
        self.changed()

    def commands(self) -> list[str]:
        """The same on the command line, in the folder where the files of the shown names are."""
        if not self.robot or not self.history:
            return []
        robot = self.robot["file"] or self.robot["source"]
        data = ["--data", *(r["name"] for r in self.runs if r["use"] in ("train", "split"))]
        if len(self.runs) == 1 and self.runs[0]["use"] == "split":
            windows = self.runs[0]["split"]["train"]
            data += ["--window", ",".join(f"{a!r}:{b!r}" for a, b in windows)]
        first, seed = self.history[0], ["--seed", str(self.seed)]
        out = [["simulate", robot, *self.made_by]] if self.made_by else []
        name = first.opened or "model1.json"
        if not first.opened:
            how = ["--method", first.method, "--effects", ",".join(first.effects), *seed]
            how += ["--no-check"] if self.meaningless else []
            if gravity := self.robot["gravity"]:
                how += ["--gravity", ",".join(f"{g:g}" for g in gravity)]
            how += [w for k, v in self.options.items() for w in (f"--{k.replace('_', '-')}", v)]
            out.append(["identify", robot, *data, *how, "--out", name])
        for k, model in enumerate(self.history[1:], start=2):
            before, name = name, f"model{k}.json"
            what = [",".join(model.added), *data, *seed, *["--frozen"] * model.frozen]
            out.append(["add", before, *what, "--out", name])
        return [shlex.join(["sdp-vs-penalty", *words]) for words in out]

    def without_paths(self, text: str) -> str:
        """A sentence with shown names instead of where the files are."""
        for path, name in self.names.items():
            text = text.replace(path, name)
        return text.replace(f"{self.folder}/", "")

    def forget_models(self) -> None:
        self.history, self.undone, self.answers = [], [], {}
        self._read.clear()

    def cancel(self) -> None:
        """End the job that is being done, at once; nothing that was there before changes."""
        if self.task is not None:
            self.task.cancel()

    def rest(self) -> None:
        """Nobody looks any more: no work, and nothing in memory that is in files."""
        self.cancel()
        self._read.clear()

    @property
    def busy(self) -> bool:
        """Whether a job is being done."""
        return self.task is not None and not self.task.done()

    def _start(self, title: str, doing: Coroutine[Any, Any, None]) -> None:
        self.notice = None
        self.working = Working(title)
        self.task = asyncio.get_running_loop().create_task(doing)
        self.task.add_done_callback(self._ended)
        self.changed()

    def _ended(self, task: asyncio.Task[None]) -> None:
        error = None if task.cancelled() else task.exception()
        if task.cancelled():
            self.notice = Notice(("Cancelled: nothing was changed.",), error=False)
        elif isinstance(error, InputError):
            self.notice = Notice((self.without_paths(str(error)),))
        elif error is not None:
            self.notice = Notice((internal_error(error),))
        self.working, self.task = None, None
        self.changed()
        self.read_arrived()

    async def _job(self, job: str, **details: Any) -> dict[str, Any]:
        def progress(text: str) -> None:
            if self.working is not None:
                self.working.status = text
                self.changed()

        model, folder = self.model and self.model.file, str(self.folder)
        own = {name: getattr(self, name) for name in ("robot", "runs", "seed", "options")}
        request = {"job": job, "folder": folder, "model": model, **own, **details}
        return await self.pool.run(request, progress)

    def _refuse_meaningless(self) -> None:
        if self.meaningless and not self.anyway:
            raise InputError(self.meaningless[0], 'repair it under Check, or tick "Identify anyway"')

    def _next_file(self) -> str:
        self._count += 1
        return str(self.folder / f"model-{self._count}.json")

    @background("Reading the robot")
    async def choose_robot(self, source: str, urdf: str | None = None) -> None:
        """A built-in name, or the path of a URDF with its shown name; everything else starts anew."""
        self.names[source] = urdf or source
        answer = await self._job("robot", robot={"source": source})
        self.robot = {**answer, "source": source, "gravity": None, "file": urdf}
        self.runs, self.effects, self.method = [], list(answer["effects"]), DEFAULT_METHOD
        self.forget_models()

    def read_arrived(self) -> None:
        """Read the files that were dropped; after the job that is being done, if there is one."""
        if not self.busy and self.arrived:
            self._read_files()

    @background("Reading measurements")
    async def _read_files(self) -> None:
        files, self.arrived = self.arrived, {}
        self.names |= {str(path): name for name, path in files.items()}
        try:
            listed = [{"path": str(path), "name": name} for name, path in files.items()]
            await self._take_runs("read", self.runs, files=listed, options=self.reading)
        finally:
            for path in files.values():  # copies of ours: their runs are kept
                if path.parent == self.folder:
                    path.unlink(missing_ok=True)

    @background("Simulating")
    async def simulate(self, effect: str, joints: list[int], level: str, seed: int) -> None:
        """The built-in data with an effect hidden in them, instead of the runs that are there."""
        await self._take_runs("simulate", [], effect=effect, joints=joints, level=level, seed=seed)
        at = ":" + "+".join(map(str, joints)) if joints else ""
        hide = [] if effect == "none" else ["--hide", f"{effect}{at}"]
        self.made_by = [*hide, "--level", level, "--seed", str(seed), "--out", "."]

    def use(self, file: str, use: str) -> None:
        """Use a run for training, for testing, or not at all ("")."""
        if self.busy:
            self.refusals += 1
            self.say("Wait until the job is done, or cancel it.", error=False)
            return
        for run in self.runs:
            if run["file"] == file:
                run["use"] = use
        self.runs = [run for run in self.runs if run["use"]]
        self.notice = Notice((_OTHER_RUNS,), error=False) if self.history else None
        self.forget_models()
        self.changed()

    @background("Turning the robot")
    async def mount(self, gravity: str) -> None:
        """Another direction of gravity, "x,y,z" [m/s^2]: the runs are checked again, models dropped."""
        turned = {**self.robot, "gravity": numbers("gravity", gravity, 3)}
        answer = await self._job("look_again", robot=turned)
        self.robot, self.runs = turned, answer["runs"]
        if self.history:
            self.notice = Notice(("Gravity has changed: identify again.",), error=False)
        self.forget_models()

    @background("Repairing a run")
    async def mend(self, file: str) -> None:
        """Put the repaired copy of a run in its place, and say what was changed."""
        answer = await self._job("mend", file=file)
        new = answer["run"]
        self.runs = [new if run["file"] == file else run for run in self.runs]
        self.names[str(self.folder / new["file"])] = new["name"]
        self.forget_models()
        self.notice = Notice(tuple(answer["changes"]), error=False)

    @background("Identifying by {self.method}")
    async def identify(self) -> None:
        """The first model of a new history."""
        if not self.effects:
            raise InputError("No effect is chosen", "choose at least rigid_body")
        self._refuse_meaningless()
        how = {"effects": ",".join(self.effects), "method": self.method}
        answer = await self._job("fit", **how, out=self._next_file())
        self._begin(answer, label="identified")

    def _begin(self, answer: dict[str, Any], **how: str) -> None:
        self.forget_models()
        self.history, self.new = [ModelStep(**{**answer, **how})], ("identify", "fit")

    @background("Opening {1}")
    async def open_model(self, path: str, name: str) -> None:
        """Go on from a model.json, identified from other runs perhaps: how a payload is found."""
        self.names[path] = name
        answer = await self._job("open_model", model=path, out=self._next_file())
        self._begin(answer, label=name, opened=name)

    @background("Looking for what is missing")
    async def diagnose(self) -> None:
        """What the current model misses."""
        self._refuse_meaningless()
        answer = await self._job("find", frozen=self.frozen)
        found = Diagnosis.from_dict(answer["diagnosis"])
        self.history[-1] = replace(self.current, findings=found, curve_texts=answer["curves"])
        self.new = "diagnose", "findings"

    @background("Adding what was chosen")
    async def add(self, texts: list[str]) -> None:
        """Add effects to the current model, a step of the history each."""
        frozen = self.frozen or (self.findings is not None and self.findings.frozen)
        steps = [self.current]
        for text in texts:
            how = {"effect": text, "frozen": frozen, "out": self._next_file()}
            answer = await self._job("extend", model=steps[-1].file, **how)
            new = {"label": f"+ {text.partition('@')[0]}", "added": (text,), "frozen": frozen}
            steps.append(ModelStep(**{**answer, **new}))
        self.history, self.undone = [*self.history, *steps[1:]], []
        self.new = "diagnose", "history"

    def ask(self, job: str, title: str, ready: Callable[[str], None] | None = None, **on: Any) -> None:
        """A job that changes nothing: its answer is kept; ``ready`` hears of the files that it made."""
        if self.busy:
            return

        async def do() -> None:
            model = self.model and self.model.file
            answer = await self._job(job, **on)
            for file in answer.get("arrays", ()):
                self._read.pop(file, None)
            if answer.get("notice"):
                self.notice = Notice(tuple(answer["notice"]), error=False)
            self.answers[job] = {**answer, "model": model}
            self.new = ("identify", "methods") if job == "methods" else self.new
            self.made |= set(answer.get("files", ()))
            for name in answer.get("files", ()):
                if ready is not None:
                    ready(name)

        self._start(title, do())

    def undo(self) -> None:
        """One model back."""
        if self.busy or len(self.history) < 2:
            return
        self.undone.append(self.history.pop())
        self.changed()

    def redo(self) -> None:
        """The model that was left last, once more."""
        if not self.busy and self.undone:
            self.history.append(self.undone.pop())
            self.changed()

    @background("Showing the whole job on a simulated arm")
    async def show_me(self) -> None:
        """The whole job in small, on simulated runs with something hidden: the verb ``demo``."""
        await Session.choose_robot.do(self, ARM)
        await Session.simulate.do(self, HIDDEN, [self.robot["n"]], LEVEL, 7)
        await Session.identify.do(self)
        await Session.diagnose.do(self)
        assert self.findings is not None
        sure = [f.text for f in self.findings.effects if f.confidence == "confident"]
        await Session.add.do(self, sure)

    def take(
        self, name: str, ready: Callable[[str], None], options: Mapping[str, str] | None = None
    ) -> None:
        """Make a file to take away; ``ready`` hears its name. options : the flange, for a payload."""
        steps = enumerate(self.history, start=1)
        content = {
            "models": [{"label": f"{k}: {m.label}", "file": m.file} for k, m in steps],
            "commands": self.commands(),
            "findings": self.findings and self.findings.to_dict(),
            "urdf": self.robot["source"] if self.robot["file"] else None,
        }
        self.ask("take", f"Making {name}", ready, name=name, **content, **(options or {}))

    async def _take_runs(self, job: str, before: list[dict[str, Any]], **details: Any) -> None:
        """The runs of a job's answer, after those ``before``; a name says what a run is for."""
        if not self.robot:
            raise InputError("No robot is chosen", "choose it first, so that its joints are known")
        answer = await self._job(job, runs=before, **details)
        new = answer["runs"]
        for run in new:
            run["use"] = "test" if for_testing(run["name"]) else run["use"]
        self.runs, self.made_by = [*before, *new], None
        self.names |= {str(self.folder / run["file"]): run["name"] for run in new}
        if len(self.runs) == 1:  # one run alone is tested on its own end
            self.runs[0]["use"] = "split" if self.runs[0]["split"] else "train"
        elif new and len(new) == len(self.runs) and all(run["use"] == "test" for run in new):
            new[0]["use"] = "train"
        if "effects" in answer:
            self.effects = list(answer["effects"])
        said = answer["refused"] or [*answer.get("remarks", ()), *[_OTHER_RUNS] * bool(self.history)]
        if said:
            self.notice = Notice(tuple(map(self.without_paths, said)), error=bool(answer["refused"]))
        if new:
            self.forget_models()
