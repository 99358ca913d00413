"""What the data check says: one issue a problem; and rules, the rows of one table, that find them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Any

from sdp_vs_penalty import formatting
from sdp_vs_penalty.checks.glance import Glance
from sdp_vs_penalty.data.measurements import Measurements

#: Repairs one run; the issue's ``remedy`` says in words what it does.
Repair = Callable[[Measurements], Measurements]
#: What a rule finds: where, the repair, and the figures that its words hold.
Finding = tuple[str, Repair | None, dict[str, Any]]


@dataclass(frozen=True)
class Issue:
    """kind : what is wrong, in two or three words; where : joints, channels, rows or instants.

    severity : "error" (identification would be meaningless), "warning" (it would be worse than it
        need be) or "note" (a fact worth knowing).
    what, remedy : one sentence each. certainty : "certain", "likely" or "possible", and why.
    repair : where mending is safe, how; figures : the numbers behind it.
    gravity : where gravity points instead [m/s^2], for an issue about it.
    """

    kind: str
    severity: str
    where: str
    what: str
    certainty: str
    remedy: str
    repair: Repair | None = None
    figures: Mapping[str, Any] = field(default_factory=dict)
    gravity: tuple[float, ...] | None = None

    @property
    def mends(self) -> bool:
        """Whether `check --fix` repairs it: there is a repair, and no doubt."""
        return self.repair is not None and self.certainty.startswith("certain")

    def to_dict(self) -> dict[str, Any]:
        """Plain JSON; joints count from 1."""
        names = ("kind", "severity", "where", "what", "certainty", "remedy")
        plain = {name: getattr(self, name) for name in names}
        return {**plain, "can_fix": self.mends, "figures": dict(self.figures)}


@dataclass(frozen=True)
class Rule:
    """One row of a table of rules: the kind of issue, how grave, its three sentences with the finding's
    figures (and ``where``) in braces, and what finds it in a glance at a run, any number of times. A
    figure "severity" is another one than usual.
    """

    kind: str
    severity: str
    what: str
    sure: str
    remedy: str
    find: Callable[[Glance], Iterator[Finding]]

    def __call__(self, g: Glance) -> Iterator[Issue]:
        for where, repair, figures in self.find(g):
            texts = (self.what, self.sure, self.remedy)
            what, sure, remedy = (text.format(where=where, **figures) for text in texts)
            severity = figures.pop("severity", self.severity)
            yield Issue(self.kind, severity, where, what, sure, remedy, repair, figures)


def rule(kind: str, severity: str, what: str, sure: str, remedy: str) -> Callable[..., Rule]:
    """Makes a :class:`Rule` of the function that finds it."""
    return partial(Rule, kind, severity, what, sure, remedy)


def joints_text(joints: Any) -> str:
    """As :func:`formatting.joints`, from indices that count from 0."""
    return formatting.joints([int(j) + 1 for j in joints])


def rows_text(rows: Any) -> str:
    """ "row 12", "rows 12 to 14 and 3 more": the first of the row numbers that follow each other."""
    first = next((k for k, row in enumerate(rows) if row != rows[0] + k), len(rows))
    text = f"row {rows[0]}" if first == 1 else f"rows {rows[0]} to {rows[first - 1]}"
    return text + (f" and {len(rows) - first} more" if len(rows) > first else "")
