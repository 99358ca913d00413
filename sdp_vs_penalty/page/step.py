"""What a step of the page is."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from sdp_vs_penalty.page.session import Session
    from sdp_vs_penalty.page.view import View


@dataclass(frozen=True)
class Step:
    """anchor, title : where and what; ready : whether it can be taken yet, else ``before`` says what
    comes first; depends : everything that its content is made of, so that it is redrawn only when that
    changes; draw : fills it.
    """

    anchor: str
    title: str
    before: str
    ready: Callable[[Session], bool]
    depends: Callable[[Session], Any]
    draw: Callable[[View], None]
