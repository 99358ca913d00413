"""View state of one tab (selected joint, run, methods), and what the steps may ask of the tab."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from nicegui import ui
from nicegui.client import Client

from sdp_vs_penalty.page.options import FormField
from sdp_vs_penalty.page.session import Session

#: Options of the command line by the step that offers them.
Forms = Mapping[str, tuple[FormField, ...]]


@dataclass
class View:
    """The view state of one tab.

    joint, run, span : what every part shows (span : seconds of the run, None for all of it); signal :
    what the error is drawn against; followers : by part, what to call when they change; methods :
    ticked for comparison; hiding : what the form for simulated runs holds.
    """

    session: Session
    catalogue: Mapping[str, Any]
    folder: Path | None
    client: Client
    forms: Forms
    joint: int | None = None
    run: str = ""
    span: tuple[float, float] | None = None
    signal: str = "dq"
    followers: dict[str, Callable[[], None]] = field(default_factory=dict)
    methods: set[str] = field(default_factory=lambda: {"lmi-sdp", "ols", "penalty"})
    folds: bool = False
    drive: str = ""
    separating: dict[str, str] = field(default_factory=dict)
    hiding: dict[str, Any] = field(
        default_factory=lambda: {
            "effect": "presliding_hysteresis",
            "joint": 0,
            "level": "strong",
            "seed": 7,
        }
    )

    def look(self, **at: Any) -> None:
        """Look at another joint, run, span or signals, in every step at once."""
        if at.get("run", self.run) != self.run:
            self.span = None
        for name, value in at.items():
            setattr(self, name, value)
        for follow in list(self.followers.values()):
            follow()

    def forget(self, step: str) -> None:
        """Nothing of a step is shown any more."""
        self.followers.pop(step, None)

    def download(self, name: str) -> None:
        """Hand a file of the session to the browser."""
        if not self.client.is_deleted:
            with self.client:
                ui.download.from_url(f"/s/{self.session.token}/take/{name}")

    def folder_files(self, suffixes: tuple[str, ...]) -> list[Path]:
        """Files of the folder that the page was started with, none from outside it."""
        if self.folder is None:
            return []
        inside = self.folder.resolve()
        found = [p for p in sorted(inside.iterdir()) if p.suffix.lower() in suffixes and p.is_file()]
        return [p for p in found if p.resolve().parent == inside][:50]

    def folder_problems(self) -> list[Path]:
        """Folders in it, and itself, that hold a problem.toml: a robot with bounds and filters."""
        if self.folder is None:
            return []
        inside = self.folder.resolve()
        found = [p for p in (inside, *sorted(inside.iterdir())) if (p / "problem.toml").is_file()]
        return [p for p in found if p.resolve() in (inside, inside / p.name)][:50]
