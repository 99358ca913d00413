"""What the data check says: one issue a problem."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from sdp_vs_penalty import formatting
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.errors import InputError

#: The two natures of an issue.
FACT = "fact"
EXPLANATION = "explanation"


@dataclass(frozen=True, kw_only=True)
class Issue:
    """kind : what is wrong, in two or three words; where : joints, channels, rows or
    instants.

    severity : "error" (identification would be meaningless), "warning" (it would be worse than it
        need be) or "note" (a fact worth knowing).
    what, remedy : one sentence each. certainty : "certain", "likely" or "possible", and why.
    repair : where mending is safe, how (``remedy`` in words); figures : the numbers behind it.
    gravity : where gravity points instead [m/s^2], for an issue about it.
    nature : FACT, which is read from the file, or EXPLANATION, which a model of the arm
        gives: it competes with other explanations and is never an error.
    """

    kind: str
    severity: str
    where: str
    what: str
    certainty: str
    remedy: str
    repair: Callable[[Measurements], Measurements] | None = None
    figures: Mapping[str, Any] = field(default_factory=dict)
    gravity: tuple[float, ...] | None = None
    nature: str = FACT
    apply: str = ""
    equivalents: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if self.nature == EXPLANATION and self.severity == "error":
            raise ValueError(f"{self.kind}: an explanation is never an error")

    @classmethod
    def of(
        cls,
        *,
        kind: str,
        severity: str,
        joints: Any,
        what: str,
        certainty: str,
        remedy: str,
        where: str = "",
        repair: Callable[[Measurements], Measurements] | None = None,
        nature: str = FACT,
        apply: str = "",
        **figures: Any,
    ) -> "Issue":
        """About some joints (from 0), whose names ``{where}`` is in ``what`` if it is
        not said."""
        where = where or joints_text(joints)
        numbers = {"joints": [int(j) + 1 for j in joints]} if len(joints) else {}
        return cls(
            kind=kind,
            severity=severity,
            where=where,
            what=what.replace("{where}", where),
            certainty=certainty,
            remedy=remedy,
            repair=repair,
            figures={**numbers, **figures},
            nature=nature,
            apply=apply,
        )

    @classmethod
    def of_refusal(
        cls,
        kind: str,
        error: InputError,
        certainty: str,
        joints: Sequence[int] = (),
    ) -> "Issue":
        """Of what identification would refuse."""
        return cls.of(
            kind=kind,
            severity="error",
            joints=joints,
            what=f"{error.what.rstrip('.')}.",
            certainty=certainty,
            remedy=error.remedy,
            where="" if joints else "the run",
        )

    @property
    def mends(self) -> bool:
        """Whether `check --fix` repairs it: it is a fact with a repair."""
        is_certain = self.certainty.startswith("certain")
        return self.nature == FACT and self.repair is not None and is_certain

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> "Issue":
        """What :meth:`to_dict` wrote; without the repair."""
        names = ("kind", "nature", "severity", "where", "what", "certainty", "remedy")
        gravity = data["gravity"]
        return cls(
            **{name: data[name] for name in names},
            apply=data["apply"],
            equivalents=tuple(data["equivalents"]),
            figures=dict(data["figures"]),
            gravity=None if gravity is None else tuple(gravity),
        )

    def to_dict(self) -> dict[str, Any]:
        """Plain JSON; joints count from 1."""
        names = ("kind", "nature", "severity", "where", "what", "certainty", "remedy")
        plain = {name: getattr(self, name) for name in names}
        return {
            **plain,
            "can_fix": self.mends,
            "apply": self.apply,
            "equivalents": [*self.equivalents],
            "figures": dict(self.figures),
            "gravity": self.gravity,
        }


def joints_text(joints: Any) -> str:
    """As :func:`formatting.joints`, from indices that count from 0."""
    return formatting.joints([int(j) + 1 for j in joints])


def rows_text(rows: Any) -> str:
    """ "row 12", "rows 12 to 14 and 3 more": the first of the row numbers that follow each other."""
    first = next((k for k, row in enumerate(rows) if row != rows[0] + k), len(rows))
    text = f"row {rows[0]}" if first == 1 else f"rows {rows[0]} to {rows[first - 1]}"
    return text + (f" and {len(rows) - first} more" if len(rows) > first else "")


def gravest_first(issues: Sequence[Issue]) -> tuple[Issue, ...]:
    """In the order of their severity, otherwise as they came."""
    grave = ("error", "warning", "note").index
    return tuple(sorted(issues, key=lambda issue: grave(issue.severity)))
