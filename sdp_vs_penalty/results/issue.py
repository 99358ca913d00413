"""An issue of the check, as files keep it: what model.json, report and page read again."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from sdp_vs_penalty.records import JsonRecord
from sdp_vs_penalty.results.remedy import Grade, Remedy


@dataclass(frozen=True)
class Certainty(JsonRecord):
    """How sure an issue is, and why; in a sentence "certain: read from the file"."""

    #: Grade: CERTAIN, LIKELY or POSSIBLE of `checks/certainty.py`.
    grade: Grade
    #: Why, in words.
    why: str

    def __str__(self) -> str:
        """Grade and reason in one sentence."""
        return f"{self.grade}: {self.why}"


@dataclass(frozen=True, kw_only=True)
class IssueInWords:
    """What people read of an issue, and what the package reads of it again."""

    #: What is wrong, in two or three words.
    kind: str
    #: The same for a screen that has room for more; "": the kind.
    heading: str = ""
    #: What of the log it leaves in doubt, in words: a model of it is not good, whatever its
    #: error; "" where nothing.
    in_doubt: str = ""
    #: "error" (identification would be meaningless), "warning" (it would be worse than
    #: it need be) or "note" (a fact worth knowing).
    severity: str = "warning"
    #: Where it is: joints, channels, rows or instants, in words.
    where: str
    #: What is wrong, in one sentence.
    what: str
    #: How sure it is, "certain", "likely" or "possible", and why.
    certainty: Certainty = Certainty("certain", "read from the file")
    #: What to do, in one sentence.
    remedy: str
    #: Whether a person has to do it: some facts are reckoned with already.
    needs_action: bool = True
    #: Unit that it says positions are in; "" where a part of the joints has it alone;
    #: None for an issue about no unit of positions.
    position_unit: str | None = None
    #: Whether the arm is another one in this run (its load, its links, its friction): no
    #: change of the log undoes that.
    is_another_arm: bool = False

    @property
    def remedies(self) -> tuple[Remedy, ...]:
        """What would mend it, the likeliest first; subclasses define it."""
        raise NotImplementedError

    @property
    def title(self) -> str:
        """What is wrong, for a screen that has room for it."""
        return self.heading or self.kind


@dataclass(frozen=True, kw_only=True)
class StoredIssue(IssueInWords, JsonRecord):
    """An issue that is read from a file, with what would mend it."""

    #: What would mend it, the likeliest first.
    remedies: tuple[Remedy, ...] = ()
    #: Instant of what happens in the run [s].
    at: float | None = None
    #: Begin and end of what acts for a part of the time [s].
    span: tuple[float, float] | None = None

    @classmethod
    def upgraded(cls, data: Mapping[str, Any]) -> Mapping[str, Any]:
        """Bring the JSON of the check, and of older versions, to these fields. Instants
        are among its figures; an older version wrote the certainty as a text, "likely:
        an arm leaves less", and in kind and remedy alone what has fields of its own."""
        figures = data.get("figures") or {}
        certainty = data.get("certainty")
        if isinstance(certainty, str):
            grade, _, why = certainty.partition(": ")
            certainty = {"grade": grade, "why": why}
        kind, remedy = str(data.get("kind")), str(data.get("remedy"))
        begin, _, unit = kind.partition("positions in ")
        read = {
            "at": figures.get("t"),
            "span": figures.get("span"),
            "needs_action": not remedy.startswith("no action needed"),
            "position_unit": unit if unit and not begin else None,
            "is_another_arm": kind
            in ("another load", "another arm", "another friction"),
        }
        return {**read, **data, "certainty": certainty}
