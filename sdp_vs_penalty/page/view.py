"""What one tab looks at (joint, run, methods), and what its stages and their parts are
made of."""

from argparse import Action
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

from nicegui import ui
from nicegui.client import Client

from sdp_vs_penalty.page.session import Session
from sdp_vs_penalty.reports.demo import HIDDEN, LEVEL, METHODS

#: Options of the command line by the step that offers them.
Forms = Mapping[str, Sequence[Action]]


@dataclass
class View:
    """The view state of one tab.

    joint, run, span : what every part shows (span : seconds of the run, None for all of
    it); signal : what the error is drawn against; followers : by part, what to call
    when they change; methods : ticked for comparison; hiding : what the form for
    simulated runs holds.
    """

    session: Session
    folder: Path | None
    client: Client
    forms: Forms
    joint: int | None = None
    run: str = ""
    span: tuple[float, float] | None = None
    signal: str = "dq"
    followers: dict[str, Callable[[], None]] = field(default_factory=dict)
    methods: dict[str, bool] = field(
        default_factory=lambda: dict.fromkeys(METHODS, True)
    )
    folds: bool = False
    drive: str = ""
    hiding: dict[str, Any] = field(
        default_factory=lambda: {
            "effect": HIDDEN,
            "joint": "0",
            "level": LEVEL,
            "seed": 7,
        }
    )

    def select(self, **at: Any) -> None:
        """Look at another joint, run, span or signals, in every step at once."""
        if at.get("run", self.run) != self.run:
            self.span = None
        for name, value in at.items():
            setattr(self, name, value)
        for follow in list(self.followers.values()):
            follow()

    def look_at_worst_joint(self) -> None:
        """Choose the joint whose error is the most times its noise, unless one was
        chosen that the robot has."""
        n_joints = self.session.robot["n"]
        if self.joint is None or self.joint >= n_joints:
            worst = self.session.current.comparison["facts"]["worst_joint"]["value"]
            self.joint = int(worst) - 1
            self.signal = self.session.current.signal_of(self.joint, self.signal)

    def select_joint(self, number: Any, signal: str) -> None:
        """Look at a joint by its number from 1, as a browser says it, against a signal."""
        joint = min(max(int(number), 1), self.session.robot["n"]) - 1
        self.select(joint=joint, signal=signal)

    def download(self, name: str) -> None:
        """Hand a file of the session to the browser."""
        if not self.client.is_deleted:
            with self.client:
                ui.download.from_url(f"/s/{self.session.token}/take/{name}")

    def _own(self) -> list[Path]:
        """The folder that the page was started with, and what lies in it; nothing from
        outside it."""
        if self.folder is None:
            return []
        inside = self.folder.resolve()
        return [
            inside,
            *(p for p in sorted(inside.iterdir()) if p.resolve().parent == inside),
        ]

    def folder_files(self, suffixes: tuple[str, ...]) -> list[Path]:
        """Files of that folder."""
        return [
            p for p in self._own()[1:] if p.suffix.lower() in suffixes and p.is_file()
        ][:50]

    def folder_problems(self) -> list[Path]:
        """Folders in it, and itself, that hold a problem.toml: a robot with bounds and
        filters."""
        return [p for p in self._own() if (p / "problem.toml").is_file()][:50]


@dataclass(frozen=True)
class StageVerdict:
    """What a stage has come to, in a sentence; level : its colour, good, usable, bad or
    "" for none; word : what it begins with. Only estimation/verdict.py grades a model
    (:func:`identified`)."""

    level: str
    text: str
    word: str = ""


def identified(session: Session) -> StageVerdict | None:
    """What estimation/verdict.py says of the current model."""
    if session.model is None:
        return None
    verdict_of_model = session.model.comparison["verdict"]
    grade = verdict_of_model["grade"]
    level = "bad" if grade == "do not use" else grade
    return StageVerdict(
        level,
        spoken(verdict_of_model["lines"][0]["text"]),
        grade.capitalize(),
    )


def spoken(text: str) -> str:
    """A sentence of the command line's for the page, where a stage stands for the
    command.

    >>> spoken("Torque beyond the noise; `diagnose` names causes.")
    'Torque beyond the noise; Diagnose names causes.'
    """
    return text.replace("`diagnose`", "Diagnose").replace("`", "")


@dataclass(frozen=True)
class PagePart:
    """anchor, title : where and what; ready : whether it is shown yet; depends :
    everything that its content is made of, so that it is drawn anew only when that
    changes; draw : fills it: the function that ``@partial(Part, ...)`` stands before.
    """

    anchor: str
    title: str
    ready: Callable[[Session], bool]
    depends: Callable[[Session], Any]
    draw: Callable[[View], None]


@dataclass(frozen=True)
class Stage:
    """One screen. before : what comes first, while none of its parts is ready; verdict
    : the sentence that it ends in, None while nothing can be judged."""

    anchor: str
    title: str
    before: str
    parts: tuple[PagePart, ...]
    verdict: Callable[[Session], StageVerdict | None] = lambda session: None


def requires_model(
    anchor: str,
    title: str,
    also: Callable[[Session], Any] = lambda session: None,
) -> Callable[[Callable[[View], None]], PagePart]:
    """A part that is shown once there is a model; it depends on the models and on
    ``also``."""
    ready = lambda session: session.model is not None  # noqa: E731
    depends = lambda session: ([model.file for model in session.history], also(session))  # noqa: E731
    return partial(PagePart, anchor, title, ready, depends)
