"""What the check says of one run."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from sdp_vs_penalty import formatting
from sdp_vs_penalty.checks.facts.lockstep import LockstepMotion
from sdp_vs_penalty.checks.issue import Issue, gravest_first
from sdp_vs_penalty.checks.long_runs import is_long
from sdp_vs_penalty.checks.torque_size import with_one_unit
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.race.arm_fit import text_of_share
from sdp_vs_penalty.records import NOT_STORED, stored_as
from sdp_vs_penalty.results.facts import fact
from sdp_vs_penalty.results.record import Record, Summary
from sdp_vs_penalty.results.remedy import Change, Remedy, one_of_rivals
from sdp_vs_penalty.results.table import Table
from sdp_vs_penalty.signals.preprocessing import Preprocessing

if TYPE_CHECKING:
    import pandas


def list_remedies(reports: Sequence[Report]) -> tuple[Remedy, ...]:
    """List what would mend runs that were judged together, each once, the most useful
    first: all likely repairs at once, then gravity, readings, and runs to record, of
    errors before warnings.
    """
    issues = gravest_first(
        [f for r in reports for f in r.by_cause if f.severity != "note"]
    )
    by_change = {str(x.change): x for f in reversed(issues) for x in f.remedies[::-1]}
    remedies = list(by_change.values())[::-1]
    repairs = [x for x in remedies if x.change.verb == "transform"]
    repairs = one_of_rivals(x for x in repairs if x.certainty != "possible")
    if len(repairs) > 1:
        words = [word for x in repairs for word in x.change.arguments["apply"]]
        problems = dict.fromkeys(x.problem.rstrip(".") for x in repairs)
        certainty = min((x.certainty for x in repairs), key=_GRADES.index)
        least = "" if certainty == _GRADES[-1] else "at least "
        everything = Remedy(
            f"{formatting.words(list(problems))}.",
            certainty,
            f"each of them is {least}{certainty}",
            Change("transform", f"make these {len(repairs)} repairs", {"apply": words}),
        )
        remedies.insert(0, everything)
    first = ("transform", "mount", "read", "cut", "hold", "record").index
    return tuple(sorted(remedies, key=lambda x: first(x.change.verb)))


#: From the least sure one on.
_GRADES = ("possible", "likely", "certain")


@dataclass(frozen=True, repr=False)
class Report(Record):
    """What the check found in one run."""

    derived = ("meaningless", "unexplained_percent", "facts")

    #: Name of the run.
    run: str
    #: Issues of the run, the gravest first.
    issues: tuple[Issue, ...] = field(metadata=stored_as("findings"))
    #: The run with every repair, likely ones included.
    repaired_all: Measurements = field(metadata=NOT_STORED)
    #: The run with the safe repairs alone, which nobody has to name.
    repaired_unasked: Measurements = field(metadata=NOT_STORED)
    #: Share of the torques' energy that the arm's dynamics leave, after repair [-];
    #: None where there is nothing to fit.
    unexplained: float | None = field(default=None, metadata=NOT_STORED)
    #: Gravity that the torques show [m/s^2]; None for a run with fewer samples than one
    #: arm has parameters.
    gravity: tuple[float, ...] | None = field(
        default=None, compare=False, repr=False, metadata=NOT_STORED
    )
    #: The run as logged.
    original: Measurements | None = field(
        default=None, compare=False, repr=False, metadata=NOT_STORED
    )
    #: Joints that move in proportion; None where none do.
    lockstep: LockstepMotion | None = field(
        default=None, compare=False, repr=False, metadata=NOT_STORED
    )
    #: Settings of the filters for the run with its facts mended; None for a run that is
    #: too short for them.
    filters: Preprocessing | None = field(
        default=None, compare=False, repr=False, metadata=NOT_STORED
    )
    #: Kinds of issue that ``unexplained`` is corrected for, each once.
    corrected: tuple[str, ...] = ()

    @property
    def meaningless(self) -> bool:
        """Whether nothing sensible can be identified from these data: a fact says so."""
        return any(f.severity == "error" for f in self.issues)

    @property
    def has_poor_motion(self) -> bool:
        """Whether the motion has at most half as many directions as moving joints."""
        return self.lockstep is not None and self.lockstep.is_poor

    @property
    def as_logged(self) -> Measurements:
        """The run before any repair."""
        return self.original or self.repaired_all

    @property
    def is_long(self) -> bool:
        """Whether windows stand for the run: it is not repaired then."""
        return is_long(self.repaired_all)

    @property
    def errors_and_warnings(self) -> tuple[Issue, ...]:
        """Errors and warnings, without notes."""
        return tuple(f for f in self.issues if f.severity != "note")

    @property
    def by_cause(self) -> tuple[Issue, ...]:
        """The issues, where those of one cause are one: torques of many joints that have
        another size in this run alone have another unit."""
        return with_one_unit(self.run, self.issues, self.repaired_all.n)

    @fact("", digits=9)
    def n_problems(self) -> int:
        """Errors and warnings of the check; notes do not count."""
        return len(self.errors_and_warnings)

    @fact("%", digits=2, name="unexplained torque")
    def unexplained_percent(self) -> float | None:
        """What the arm's dynamics leave over of the torque's root mean square, with
        every repair made; unknown where there is nothing to fit."""
        return None if self.unexplained is None else 100.0 * self.unexplained**0.5

    def to_frame(self) -> pandas.DataFrame:
        """Return a table with one row an issue: kind, severity, where, what, certainty,
        remedy."""
        import pandas

        columns = ["kind", "severity", "where", "what", "certainty", "remedy"]
        rows = [
            [str(getattr(issue, name)) for name in columns] for issue in self.issues
        ]
        return pandas.DataFrame(rows, columns=columns)

    @property
    def verdict(self) -> str:
        """One sentence: the number of problems, and the share of the torque that the
        arm's dynamics leave unexplained, with what is corrected first.

        The share is that of the log as repaired, which may be far better than the log
        as recorded. Without such a share (``unexplained`` is None) it says why there is none.
        """
        problems = formatting.count(len(self.errors_and_warnings), "problem")
        if self.unexplained is not None:
            share = text_of_share(self.unexplained, digits=2)
            torque = f"the arm's dynamics leave {share} of the torque unexplained (RMS)"
            if self.corrected:
                torque = f"with {formatting.words(self.corrected)} corrected, {torque}"
        elif not self.repaired_all.torque_logged:
            torque = "no torque was logged"
        elif self.meaningless:  # errors of facts: no row can be believed
            torque = "nothing to identify from"
        else:  # the caller asked for facts alone
            torque = "its torques were not judged"
        return f"{self.run}: {problems}; {torque}"

    def _summary(self) -> Summary:
        """Write the verdict, and severity and sentence of each issue, for printing."""
        return self.verdict, [(f.severity, f.what) for f in self.issues]

    def _table(self) -> Table | None:
        """Make a table of kind, place, certainty and remedy of each issue; None without
        issues."""
        rows = [(f.kind, f.where, str(f.certainty), f.remedy) for f in self.issues]
        if not rows:
            return None
        return Table(("kind", "where", "certainty", "remedy"), rows, words=(0, 1, 2, 3))

    def changes(self, name: str, done: Sequence[Issue]) -> str:
        """Describe a repaired copy of a file: what was repaired, and what is left to
        do.

        Parameters
        ----------
        done : sequence of Issue
            The issues that were repaired.
        """
        left = [f for f in self.errors_and_warnings if f not in done]
        if done:
            lines = [f"Repaired copy of {name}, in the order of repair:"]
        else:
            lines = [f"Copy of {name}:", "- nothing was changed"]
        lines += [
            f"- {f.kind} ({f.where}): {f.what} Done: {f.remedy}. ({f.certainty})"
            for f in done
        ]
        if left:
            lines.append("Not repaired:")
        lines += [f"- {f.kind} ({f.where}): {f.what} To do: {f.remedy}." for f in left]
        return "\n".join(lines) + "\n"
