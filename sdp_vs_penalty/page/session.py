"""Everything that can be done to what one tab has chosen, read and identified."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from sdp_vs_penalty import show
from sdp_vs_penalty.data.cli_parsing import numbers
from sdp_vs_penalty.data.files import for_testing
from sdp_vs_penalty.diagnosis.findings import Diagnosis
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.page import uploads
from sdp_vs_penalty.page.state import METHOD, Notice, TabState
from sdp_vs_penalty.page.summary import ModelStep
from sdp_vs_penalty.reports.demo import ARM, HIDDEN, LEVEL

#: What belongs to a robot, and is put aside with it.
_OF_A_ROBOT = (
    "robot", "runs", "effects", "method", "history", "findings", "found_for",
    "made_by", "curve_texts",
)  # fmt: skip
_OTHER_RUNS = "The runs have changed: identify again."


@dataclass
class Session(TabState):
    """What can be done to the state. Every verb starts its work in the background and returns."""

    def choose_robot(self, source: str, urdf: str | None = None) -> None:
        """A built-in name, or the path of a URDF with its shown name; everything else starts anew."""

        self._start("Reading the robot", self._choose(source, urdf), {source: urdf or source})

    async def _choose(self, source: str, urdf: str | None = None) -> None:
        answer = await self._job("robot", source=source)
        self._remember()
        self.robot = {**answer, "source": source, "gravity": None, "file": urdf}
        self.runs, self.effects, self.method = [], list(answer["effects"]), METHOD
        self.forget_models()

    def _remember(self) -> None:
        """Before the robot changes: what is dropped, said and kept, so that it can be brought back."""
        self.dropped = {name: getattr(self, name) for name in _OF_A_ROBOT}
        if self.robot is not None and self.runs:
            what = [show.count(len(self.runs), "run")]
            what += [show.count(len(self.history), "model")] if self.history else []
            said = f"{self.robot['name']}: {show.words(what)} put aside with the robot."
            self.notice = Notice((said,), error=False, undo=True)

    def bring_back(self) -> None:
        """The robot before this one, with its runs and models."""
        if self.busy or not self.dropped:
            return
        for name, value in self.dropped.items():
            setattr(self, name, value)
        self.dropped = {}
        self.say()

    def read_arrived(self) -> None:
        """Read the files that were dropped; after the job that is being done, if there is one."""
        if self.busy or not self.arrived:
            return
        files, self.arrived = self.arrived, {}
        given = list(files.values())
        log = uploads.logger_folder(self.folder, files)
        listed = [{"path": str(path), "name": name} for name, path in files.items()]
        if log is not None:
            listed.append({"path": str(log), "name": "exciting_traj"})
        names = {str(file["path"]): str(file["name"]) for file in listed}

        async def do() -> None:
            try:
                await self._take_runs("read", files=listed, options=self.reading)
            finally:
                uploads.forget(self.folder, [*given, *([] if log is None else [log])])

        self._start("Reading measurements", do(), names)

    def simulate(self, effect: str, joints: list[int], level: str, seed: int) -> None:
        """The built-in data with an effect hidden in them, instead of the runs that are there."""
        self._start("Simulating", self._simulate(effect, joints, level, seed))

    async def _simulate(self, effect: str, joints: list[int], level: str, seed: int) -> None:
        await self._take_runs("simulate", effect=effect, joints=joints, level=level, seed=seed)
        at = ":" + "+".join(map(str, joints)) if joints else ""
        hide = [] if effect == "none" else ["--hide", f"{effect}{at}"]
        self.made_by = [*hide, "--level", level, "--seed", str(seed), "--out", "."]

    def real(self) -> None:
        """The real runs of this robot that are on the computer, instead of those that are there."""
        self._start("Reading measurements", self._take_runs("real"))

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

    def mount(self, gravity: str) -> None:
        """Another direction of gravity, "x,y,z" [m/s^2]: the runs are checked again, models dropped."""

        async def do() -> None:
            if self.robot is None:
                raise InputError("No robot is chosen", "choose it first")
            turned = {**self.robot, "gravity": numbers("gravity", gravity, 3)}
            answer = await self._job("look_again", robot=turned)
            self.robot, self.runs = turned, answer["runs"]
            had_models = bool(self.history)
            self.forget_models()
            if had_models:
                self.notice = Notice(("Gravity has changed: identify again.",), error=False)

        self._start("Turning the robot", do())

    def mend(self, file: str) -> None:
        """Put the repaired copy of a run in its place, and say what was changed."""

        async def do() -> None:
            answer = await self._job("mend", file=file)
            new = answer["run"]
            self.runs = [new if run["file"] == file else run for run in self.runs]
            self.names[str(self.folder / new["file"])] = new["name"]
            self.forget_models()
            self.notice = Notice(tuple(answer["changes"]), error=False)

        self._start("Repairing a run", do())

    def identify(self) -> None:
        """The first model of a new history."""
        self._start(f"Identifying by {self.method}", self._identify())

    async def _identify(self) -> None:
        if not self.effects:
            raise InputError("No effect is chosen", "choose at least rigid_body")
        self._refuse_meaningless()
        answer = await self._job(
            "fit",
            effects=",".join(self.effects),
            method=self.method,
            options=self.options,
            out=self._next_file(),
        )
        self.forget_models()
        self.history = [ModelStep(**{**answer, "label": "identified"})]

    def open_model(self, path: str, name: str) -> None:
        """Go on from a model.json, identified from other runs perhaps: how a payload is found."""

        async def do() -> None:
            answer = await self._job("open_model", model=path, out=self._next_file())
            self.forget_models()
            self.history = [ModelStep(**{**answer, "label": name, "opened": name})]

        self._start(f"Opening {name}", do(), {path: name})

    def diagnose(self) -> None:
        """What the current model misses."""
        self._start("Looking for what is missing", self._diagnose())

    async def _diagnose(self) -> None:
        self._refuse_meaningless()
        answer = await self._job("find", model=self._current(), frozen=self.frozen)
        self.findings = Diagnosis.from_dict(answer["diagnosis"])
        self.curve_texts = answer["curves"]
        self.found_for = len(self.history)

    def add(self, texts: list[str]) -> None:
        """Add effects to the current model, a step of the history each."""
        named = ", ".join(text.partition("@")[0] for text in texts)
        self._start(f"Adding {named}", self._add(texts))

    async def _add(self, texts: list[str]) -> None:
        frozen = self.frozen or (self.findings is not None and self.findings.frozen)
        model, steps = self._current(), []
        for text in texts:
            details = {"effect": text, "frozen": frozen, "out": self._next_file()}
            answer = await self._job("extend", model=model, **details)
            new = {"label": f"+ {text.partition('@')[0]}", "added": (text,), "frozen": frozen}
            steps.append(ModelStep(**{**answer, **new}))
            model = steps[-1].file
        self.history, self.undone = [*self.history, *steps], []

    def ask(self, job: str, title: str, ready: Callable[[str], None] | None = None, **on: Any) -> None:
        """A job that changes nothing: its answer is kept; ``ready`` hears of the files that it made."""

        async def do() -> None:
            model = self.model.file if self.model else None
            window = self.options.get("window")
            answer = await self._job(job, **{"model": model, "window": window, **on})
            self._read.pop(str(answer.get("file")), None)
            if answer.get("notice"):
                self.notice = Notice(tuple(answer["notice"]), error=False)
            self.answers[job] = {**answer, "model": model}
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
        if len(self.history) < self.found_for:
            self.findings = None
        self.changed()

    def redo(self) -> None:
        """The model that was left last, once more."""
        if not self.busy and self.undone:
            self.history.append(self.undone.pop())
            self.changed()

    def show_me(self, seed: int = 7) -> None:
        """The whole job in small, on simulated runs with something hidden: the verb ``demo``."""

        async def do() -> None:
            await self._choose(ARM)
            await self._simulate(HIDDEN, [self.arm["n"]], LEVEL, seed)
            await self._identify()
            await self._diagnose()
            assert self.findings is not None
            sure = [f.text for f in self.findings.effects if f.confidence == "confident"]
            await self._add(sure)

        self._start("Showing the whole job on a simulated arm", do())

    def take(
        self, name: str, ready: Callable[[str], None], options: Mapping[str, str] | None = None
    ) -> None:
        """Make a file to take away; ``ready`` hears its name. options : the flange, for a payload."""
        steps = enumerate(self.history, start=1)
        self.ask(
            "take",
            f"Making {name}",
            ready,
            name=name,
            models=[{"label": f"{k}: {m.label}", "file": m.file} for k, m in steps],
            commands=self.commands(),
            findings=self.findings and self.findings.to_dict(),
            urdf=self.robot["source"] if self.robot and self.robot["file"] else None,
            **(options or {}),
        )

    async def _take_runs(self, job: str, **details: Any) -> None:
        if self.robot is None:
            raise InputError("No robot is chosen", "choose it first, so that its joints are known")
        before = self.runs if job == "read" else []
        answer = await self._job(job, **{"runs": before, **details})
        new = answer["runs"]
        for run in new:  # a name says what a run is for
            if job == "read" and for_testing(run["name"]):
                run["use"] = "test"
        self.runs, self.made_by = [*before, *new], None
        self.names |= {str(self.folder / run["file"]): run["name"] for run in new}
        if len(self.runs) == 1:  # one run alone is tested on its own end
            self.runs[0]["use"] = "split" if self.runs[0]["split"] else "train"
        elif new and len(new) == len(self.runs) and all(run["use"] == "test" for run in new):
            new[0]["use"] = "train"
        if "effects" in answer:
            self.effects = list(answer["effects"])
        had_models = bool(self.history)
        if new:
            self.forget_models()
        if answer["refused"]:
            self.notice = Notice(tuple(self.without_paths(text) for text in answer["refused"]))
        elif had_models or answer.get("remarks"):
            said = answer.get("remarks", []) + [_OTHER_RUNS] * had_models
            self.notice = Notice(tuple(map(self.without_paths, said)), error=False)
