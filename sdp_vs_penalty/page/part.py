"""What a stage of the page and its parts are, and the sentence that a stage ends in."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

from sdp_vs_penalty.page.wording import spoken

if TYPE_CHECKING:
    from sdp_vs_penalty.page.session import Session
    from sdp_vs_penalty.page.view import View


@dataclass(frozen=True)
class Verdict:
    """What a stage has come to, in a sentence; level : its colour, "" for none; word : what it begins
    with. Only estimation/verdict.py grades a model (:func:`identified`)."""

    level: Literal["good", "usable", "bad", ""]
    text: str
    word: str = ""


#: The colours of the grades.
_COLOURS: dict[str, Literal["good", "usable", "bad"]] = {
    "good": "good", "usable": "usable", "do not use": "bad",
}  # fmt: skip


def identified(session: Session) -> Verdict | None:
    """What estimation/verdict.py says of the current model."""
    if session.model is None:
        return None
    said = session.model.comparison["verdict"]
    return Verdict(_COLOURS[said["grade"]], spoken(said["lines"][0]["text"]), said["grade"].capitalize())


def _nothing(session: Session) -> None:
    return None


@dataclass(frozen=True)
class Part:
    """anchor, title : where and what; ready : whether it is shown yet; depends : everything that its
    content is made of, so that it is drawn anew only when that changes; draw : fills it."""

    anchor: str
    title: str
    ready: Callable[[Session], bool]
    depends: Callable[[Session], Any]
    draw: Callable[[View], None]


@dataclass(frozen=True)
class Stage:
    """One screen. before : what comes first, while none of its parts is ready; verdict : the sentence
    that it ends in, None while nothing can be judged."""

    anchor: str
    title: str
    before: str
    parts: tuple[Part, ...]
    verdict: Callable[[Session], Verdict | None] = _nothing

    def ready(self, session: Session) -> bool:
        return any(part.ready(session) for part in self.parts)


def after_model(
    anchor: str,
    title: str,
    draw: Callable[[View], None],
    also: Callable[[Session], Any] = _nothing,
) -> Part:
    """A part that is shown once there is a model; it depends on the models and on ``also``."""
    return Part(
        anchor,
        title,
        lambda s: s.model is not None,
        lambda s: ([model.file for model in s.history], also(s)),
        draw,
    )
