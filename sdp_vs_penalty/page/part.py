"""What a step of the page is, and the sentence that it ends in."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

if TYPE_CHECKING:
    from sdp_vs_penalty.page.session import Session
    from sdp_vs_penalty.page.summary import ModelStep
    from sdp_vs_penalty.page.view import View


@dataclass(frozen=True)
class Verdict:
    """What a step has come to, in a sentence; level : its colour, "" for none; word : what it begins
    with. Only the step Verdict grades the model (estimation/verdict.py)."""

    level: Literal["good", "usable", "bad", ""]
    text: str
    word: str = ""


#: The colours of the grades.
_COLOURS: dict[str, Literal["good", "usable", "bad"]] = {
    "good": "good", "usable": "usable", "do not use": "bad",
}  # fmt: skip


def model_verdict(model: ModelStep) -> Verdict:
    """What estimation/verdict.py says of a model."""
    said = model.comparison["verdict"]
    grade = said["grade"]
    return Verdict(_COLOURS[grade], said["lines"][0]["text"], grade.capitalize())


def no_verdict(session: Session) -> Verdict | None:
    return None


@dataclass(frozen=True)
class Part:
    """anchor, title : where and what; ready : whether it can be taken yet, else ``before`` says what
    comes first; depends : everything that its content is made of, so that it is redrawn only when that
    changes; draw : fills it; verdict : the sentence that it ends in, None while nothing can be judged.
    """

    anchor: str
    title: str
    before: str
    ready: Callable[[Session], bool]
    depends: Callable[[Session], Any]
    draw: Callable[[View], None]
    verdict: Callable[[Session], Verdict | None] = no_verdict


def after_model(
    anchor: str,
    title: str,
    draw: Callable[[View], None],
    verdict: Callable[[Session], Verdict | None] = no_verdict,
    also: Callable[[Session], Any] = no_verdict,
) -> Part:
    """A step that can be taken once there is a model; it depends on the history and on ``also``."""
    return Part(
        anchor,
        title,
        "Identify a model first.",
        lambda s: s.model is not None,
        lambda s: ([model.file for model in s.history], also(s)),
        draw,
        verdict,
    )
