"""What one tab has chosen, read and identified, what is said of it, and how its jobs are done."""

from __future__ import annotations

import asyncio
import shlex
import time
from collections.abc import Coroutine, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from sdp_vs_penalty.diagnosis.findings import Diagnosis
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.page.options import FormField, words
from sdp_vs_penalty.page.summary import ModelStep
from sdp_vs_penalty.page.worker_pool import Cancelled, WorkerPool, Working
from sdp_vs_penalty.reports.plots import Curves

#: Before the first identification of a robot.
METHOD = "lmi-sdp"


def internal_error(error: Exception) -> str:
    """What is said of an error that is ours."""
    name = type(error).__name__
    return f"Internal error ({name}): nothing was changed; try again, and report it."


@dataclass(frozen=True)
class Notice:
    """One or more sentences for the person: an error, or something worth knowing; undo : whether the
    change of robot that it tells of can be taken back."""

    texts: tuple[str, ...]
    error: bool = True
    undo: bool = False


@dataclass
class TabState:
    """The state of a tab, with one job at a time; kept while the server runs, also of a closed tab.

    robot : the answer about it, with ``source``; runs : see jobs.read, each with its ``use``; history :
    models, the last one current; findings : of the model number ``found_for`` of the history.
    """

    token: str
    folder: Path
    pool: WorkerPool
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
    history: list[ModelStep] = field(default_factory=list)
    #: Models that were undone, the last one first to come back.
    undone: list[ModelStep] = field(default_factory=list)
    findings: Diagnosis | None = None
    curve_texts: list[str] = field(default_factory=list)
    found_for: int = 0
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
    #: Whether a tab has shown it yet.
    shown: bool = False
    #: How often a control was moved in vain: it has to be drawn anew as it is.
    refusals: int = 0
    #: Shown names by path.
    names: dict[str, str] = field(default_factory=dict)
    #: The robot before this one and what belonged to it.
    dropped: dict[str, Any] = field(default_factory=dict)
    #: Names of files that jobs have made, to be fetched.
    made: set[str] = field(default_factory=set)
    _read: dict[str, dict[str, Any]] = field(default_factory=dict)
    _count: int = 0

    @property
    def model(self) -> ModelStep | None:
        return self.history[-1] if self.history else None

    @property
    def current(self) -> ModelStep:
        """``model``, in steps that come after the first one."""
        return self.history[-1]

    @property
    def arm(self) -> dict[str, Any]:
        """``robot``, in steps that come after it was chosen."""
        assert self.robot is not None
        return self.robot

    @property
    def checked(self) -> list[tuple[dict[str, Any], list[dict[str, Any]]]]:
        """Each run with what the check says of it."""
        return [(run, run["findings"]) for run in self.runs]

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
        return {text for model in self.history[self.found_for :] for text in model.added}

    def answer(self, job: str) -> dict[str, Any] | None:
        """What a job said of the current model, if it was asked."""
        found = self.answers.get(job)
        return found if found and self.model and found["model"] == self.model.file else None

    def recording(self, model: ModelStep, run: str) -> dict[str, Any]:
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

    def curves(self, model: ModelStep, run: str) -> Curves:
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
        if self.robot is None or not self.history:
            return []
        robot = self.robot["file"] or self.robot["source"]
        data = ["--data", *(r["given"] for r in self.runs if r["use"] in ("train", "split"))]
        if len(self.runs) == 1 and self.runs[0]["use"] == "split":
            windows = self.runs[0]["split"]["train"]
            data += ["--window", ",".join(f"{a!r}:{b!r}" for a, b in windows)]
        first, seed = self.history[0], ["--seed", str(self.seed)]
        out = [["simulate", robot, *self.made_by]] if self.made_by else []
        names = [first.opened or "model1.json"]
        if not first.opened:
            how = ["--method", first.method, "--effects", ",".join(first.effects), *seed]
            how += ["--no-check"] if self.meaningless else []
            how += self.options_as_words()
            out.append(["identify", robot, *data, *how, "--out", names[0]])
        for k, model in enumerate(self.history[1:], start=2):
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
        self.history, self.undone, self.findings, self.answers = [], [], None, {}
        self._read.clear()

    def cancel(self) -> None:
        """End the job that is being done, at once; nothing that was there before changes."""
        if self.working is not None:
            self.working.cancel()

    @property
    def busy(self) -> bool:
        """Whether a job is being done."""
        return self.task is not None and not self.task.done()

    def _start(
        self, title: str, doing: Coroutine[Any, Any, None], names: Mapping[str, str] | None = None
    ) -> None:
        """Begin a job unless one is being done; names : what to call the paths that it reads."""
        if self.busy:
            doing.close()
            return
        self.names |= names or {}
        self.notice = None
        self.working = Working(title)
        self.task = asyncio.get_running_loop().create_task(self._watch(doing))
        self.changed()

    async def _watch(self, doing: Coroutine[Any, Any, None]) -> None:
        try:
            await doing
        except Cancelled:
            self.notice = Notice(("Cancelled: nothing was changed.",), error=False)
        except InputError as error:
            self.notice = Notice((self.without_paths(str(error)),))
        except Exception as error:
            self.notice = Notice((internal_error(error),))
        finally:
            self.working, self.task = None, None
            self.changed()
            self.read_arrived()

    async def _job(self, job: str, **details: Any) -> dict[str, Any]:
        assert self.working is not None
        request = {
            "job": job,
            "folder": str(self.folder),
            "robot": self.robot,
            "runs": self.runs,
            "seed": self.seed,
            **details,
        }
        return await self.pool.run(self.working, request, self._progress)

    def _progress(self, text: str) -> None:
        if self.working is not None:
            self.working.status = text
            self.changed()

    def read_arrived(self) -> None:
        """What is to be done when a job has ended."""

    def _refuse_meaningless(self) -> None:
        if self.meaningless and not self.anyway:
            raise InputError(
                self.meaningless[0],
                'repair it with `sdp-vs-penalty check RUN --fix`, or tick "Identify anyway"',
            )

    def _current(self) -> str:
        if self.model is None:
            raise InputError("No model yet", "identify one first")
        return self.model.file

    def _next_file(self) -> str:
        self._count += 1
        return str(self.folder / f"model-{self._count}.json")
