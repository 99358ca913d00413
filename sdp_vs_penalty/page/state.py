"""What one tab has chosen, read and identified, and what is said of it."""

from __future__ import annotations

import asyncio
import shlex
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from sdp_vs_penalty.check import contradicted
from sdp_vs_penalty.diagnosis.findings import Diagnosis
from sdp_vs_penalty.page.options import FormField, words
from sdp_vs_penalty.page.summary import Rung
from sdp_vs_penalty.page.workshop import Work, Workshop
from sdp_vs_penalty.report.plots import Curves

#: Before the first identification of a robot.
METHOD = "lmi-sdp"


@dataclass
class Working:
    """The job that is being done: what it is, where it stands, since when (monotonic seconds)."""

    title: str
    work: Work
    status: str = ""
    since: float = field(default_factory=time.monotonic)


@dataclass(frozen=True)
class Notice:
    """One or more sentences for the person: an error, or something worth knowing; undo : whether the
    change of robot that it tells of can be taken back."""

    texts: tuple[str, ...]
    error: bool = True
    undo: bool = False


class Watcher(Protocol):
    """A tab that shows a session."""

    @property
    def present(self) -> bool:
        """Whether it is there: loading or connected."""

    def redraw(self) -> None:
        """The session has changed."""


@dataclass
class TabState:
    """The state of a tab; it is kept while the server runs, also when the tab is closed.

    robot : the answer about it, with ``source``; runs : see jobs.read, each with its ``use``; ladder :
    models, the last one current; findings : of the model number ``found_for`` of the ladder, found in
    ``found_in`` seconds.
    """

    token: str
    folder: Path
    workshop: Workshop
    robot: dict[str, Any] | None = None
    runs: list[dict[str, Any]] = field(default_factory=list)
    effects: list[str] = field(default_factory=list)
    method: str = METHOD
    seed: int = 0
    frozen: bool = False
    #: What is written in the fields that are the command line's options, and these fields.
    options: dict[str, str] = field(default_factory=dict)
    asked: tuple[FormField, ...] = ()
    reading: dict[str, str] = field(default_factory=dict)
    #: Identify even from runs that the check calls meaningless.
    anyway: bool = False
    ladder: list[Rung] = field(default_factory=list)
    #: All models of this robot, those that have left the ladder too.
    models: list[Rung] = field(default_factory=list)
    findings: Diagnosis | None = None
    curve_texts: list[str] = field(default_factory=list)
    found_for: int = 0
    found_in: float = 0.0
    #: By job what was answered last, with the ``model`` that was asked about.
    answers: dict[str, dict[str, Any]] = field(default_factory=dict)
    notice: Notice | None = None
    working: Working | None = None
    task: asyncio.Task[None] | None = None
    watchers: list[Watcher] = field(default_factory=list)
    arrived: dict[str, Path] = field(default_factory=dict)
    #: The arguments of the command that makes the simulated runs.
    made_by: list[str] | None = None
    left_at: float = field(default_factory=time.monotonic)
    #: How often a control was moved in vain: it has to be drawn anew as it is.
    refusals: int = 0
    #: Shown names by path.
    names: dict[str, str] = field(default_factory=dict)
    #: The robot before this one and what belonged to it.
    dropped: dict[str, Any] = field(default_factory=dict)
    _read: dict[str, dict[str, Any]] = field(default_factory=dict)

    @property
    def model(self) -> Rung | None:
        return self.ladder[-1] if self.ladder else None

    @property
    def current(self) -> Rung:
        """``model``, in steps that come after the first one."""
        return self.ladder[-1]

    @property
    def arm(self) -> dict[str, Any]:
        """``robot``, in steps that come after it was chosen."""
        assert self.robot is not None
        return self.robot

    @property
    def checked(self) -> list[tuple[dict[str, Any], list[dict[str, Any]]]]:
        """Each run with what the check says of it, beside the other runs of the same arm."""
        keys = [{(f["kind"], f["where"]) for f in run["findings"]} for run in self.runs]
        doubtful = contradicted(keys, [run["whole"] for run in self.runs])

        def weighed(f: dict[str, Any]) -> dict[str, Any]:
            doubt = (f["kind"], f["where"]) in doubtful and not f["mends"]
            return {**f, "severity": "warning"} if doubt else f

        return [(run, [weighed(f) for f in run["findings"]]) for run in self.runs]

    @property
    def meaningless(self) -> list[str]:
        """What the check holds against identifying from the runs for training, a sentence each."""
        return [
            f"{run['name']}: {f['what'].rstrip('.')}: {f['remedy']}"
            for run, found in self.checked
            if run["use"] in ("train", "split")
            for f in found
            if f["severity"] == "error"
        ]

    @property
    def added(self) -> set[str]:
        """Texts of the findings that are part of the current model."""
        return {text for model in self.ladder[self.found_for :] for text in model.added}

    def answer(self, job: str) -> dict[str, Any] | None:
        """What a job said of the current model, if it was asked."""
        found = self.answers.get(job)
        return found if found and self.model and found["model"] == self.model.file else None

    def recording(self, model: Rung, run: str) -> dict[str, Any]:
        """t, torque, modelled, q, dq, ddq, tf and poses of a run (summary.py)."""
        return self.arrays(model.curves, model.runs.index(run))

    def arrays(self, file: str, k: int) -> dict[str, Any]:
        """The arrays of a .npz file whose names end in the number k, without it; once read kept."""
        if file not in self._read:
            with np.load(file, allow_pickle=False) as read:
                self._read[file] = {name: read[name] for name in read.files}
        return {
            name.removesuffix(str(k)): x
            for name, x in self._read[file].items()
            if name.rstrip("0123456789") + str(k) == name
        }

    def curves(self, model: Rung, run: str) -> Curves:
        """Measured and modelled torque of a run."""
        read = self.recording(model, run)
        return Curves(read["t"], read["torque"], {model.label: read["modelled"]})

    def changed(self) -> None:
        for watcher in list(self.watchers):
            watcher.redraw()

    def say(self, *texts: str, error: bool = True) -> None:
        self.notice = Notice(texts, error) if texts else None
        self.changed()

    def commands(self) -> list[str]:
        """The same on the command line, in the folder where the files of the shown names are."""
        if self.robot is None or not self.ladder:
            return []
        robot = self.robot["file"] or self.robot["source"]
        data = ["--data", *(r["given"] for r in self.runs if r["use"] in ("train", "split"))]
        if len(self.runs) == 1 and self.runs[0]["use"] == "split":
            windows = self.runs[0]["split"]["train"]
            data += ["--window", ",".join(f"{a!r}:{b!r}" for a, b in windows)]
        first, seed = self.ladder[0], ["--seed", str(self.seed)]
        out = [["simulate", robot, *self.made_by]] if self.made_by else []
        names = [first.opened or "model1.json"]
        if not first.opened:
            how = ["--method", first.method, "--effects", ",".join(first.effects), *seed]
            how += ["--no-check"] if self.meaningless else []
            how += self.options_as_words()
            out.append(["identify", robot, *data, *how, "--out", names[0]])
        for k, model in enumerate(self.ladder[1:], start=2):
            names.append(f"model{k}.json")
            how = [*seed, *(["--frozen"] if model.frozen else [])]
            out.append(["add", names[-2], ",".join(model.added), *data, *how, "--out", names[-1]])
        return [shlex.join(["sdp-vs-penalty", *words]) for words in out]

    def options_as_words(self) -> list[str]:
        """The options that are chosen, as on the command line."""
        gravity = self.robot and self.robot["gravity"]
        turned = ["--gravity", ",".join(f"{g:g}" for g in gravity)] if gravity else []
        return turned + words(self.asked, self.options)

    def without_paths(self, text: str) -> str:
        """A sentence with shown names instead of where the files are."""
        for path, name in self.names.items():
            text = text.replace(path, name)
        return text.replace(f"{self.folder}/", "")

    def forget_models(self) -> None:
        self.ladder, self.findings, self.answers = [], None, {}
        self._read.clear()
