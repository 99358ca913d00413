"""How sure an issue is, and why."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

CERTAIN = "certain"
LIKELY = "likely"
POSSIBLE = "possible"


@dataclass(frozen=True)
class Certainty:
    """How sure an issue is, and why; its text is "certain: read from the file"."""

    #: Grade: CERTAIN, LIKELY or POSSIBLE.
    grade: str
    #: Why, in words.
    why: str

    def __str__(self) -> str:
        """Grade and reason in one sentence."""
        return f"{self.grade}: {self.why}"

    @classmethod
    def from_text(cls, text: str) -> Self:
        """Read what :meth:`__str__` wrote."""
        grade, _, why = text.partition(": ")
        return cls(grade, why)


def certain(why: str) -> Certainty:
    """Return that an issue is certain; why, in words."""
    return Certainty(CERTAIN, why)


def likely(why: str) -> Certainty:
    """Return that an issue is likely; why, in words."""
    return Certainty(LIKELY, why)


def possible(why: str) -> Certainty:
    """Return that an issue is possible; why, in words."""
    return Certainty(POSSIBLE, why)
