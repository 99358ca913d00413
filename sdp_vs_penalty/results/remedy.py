"""A remedy: what is wrong, how sure that is, and the change that would mend it, as data.

A change is one of eight verbs with arguments; docs/contracts.md lists them. Whoever finds
something wrong (the check, the diagnosis, a race of hypotheses) makes this record.
`api/remedies.py` applies it and writes it as a command. Terminal, page, report and
JSON show it.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, get_args

from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.records import JsonRecord

#: What a change does.
Verb = Literal["transform", "cut", "read", "hold", "mount", "add", "reset", "record"]
#: How sure a check is of an issue.
Grade = Literal["certain", "likely", "possible"]
#: How sure a diagnosis is of a finding; see :attr:`Rated.rating`.
Rating = Literal["confident", "near-tie", "weak"]
#: Those that need no word, and those by which nothing is advised as a next step.
SURE = {"certain", "confident"}
GUESSES = {"possible", "weak"}
#: Arguments of each verb.
ARGUMENTS: Mapping[Verb, frozenset[str]] = {
    # Words of `check --fix --apply` ("sign:tau3"); none: what is certain by a fact.
    "transform": frozenset({"apply"}),
    # Spans (begin, end) [s] of a run's clock, by its name, that are left out; without
    # spans the whole run.
    "cut": frozenset({"run", "spans"}),
    # Units or factors of columns; the file's names by ours; rate [Hz]; topic of a bag;
    # the run that is read so, by its name: all where none is named; whether the factors
    # are judged by size, and nobody has stated them.
    "read": frozenset({"scale", "rename", "rate", "topic", "run", "by_size"}),
    # Positions [rad, m] of joints by name.
    "hold": frozenset({"positions"}),
    # Gravity in the base frame [m/s^2].
    "mount": frozenset({"gravity"}),
    # Effects as `add` takes them, and which findings these are: their numbers,
    # "confident" or "all".
    "add": frozenset({"effects", "findings"}),
    "reset": frozenset({"effects"}),
    # Two effects, as `add` takes them, that a new run has to tell apart.
    "record": frozenset({"separate"}),
}


@dataclass(frozen=True)
class Change(JsonRecord):
    """A verb and its arguments: what would be done to runs, problem or model."""

    #: What it does.
    verb: Verb
    #: What a person does with it, in words, such as "flip the sign of tau3".
    words: str
    #: Its arguments by name, as plain JSON.
    arguments: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Refuse a verb or an argument that is not in the table: it cannot be advised."""
        if self.verb not in ARGUMENTS:
            known = ", ".join(get_args(Verb))
            raise InputError(f"{self.verb!r} is no change", f"choose one of {known}")
        for name in self.arguments:
            if name not in ARGUMENTS[self.verb]:
                known = ", ".join(sorted(ARGUMENTS[self.verb]))
                what = f"the change {self.verb!r} has no argument {name!r}"
                raise InputError(what, f"name one of {known}")


@dataclass(frozen=True)
class Remedy(JsonRecord):
    """Something that is wrong, and a change that would mend it."""

    #: What is wrong and where, in one sentence.
    problem: str
    #: How sure that is, in the word of the check or of the diagnosis.
    certainty: Grade | Rating
    #: Why it is that sure, in words.
    why: str
    #: What would mend it.
    change: Change
    #: (n,) error of each joint on data left out without the change [N m, N]; None where
    #: nothing was left out.
    before: tuple[float, ...] | None = None
    #: The same with the change.
    after: tuple[float, ...] | None = None
    #: Changes that explain as much.
    rivals: tuple[Change, ...] = ()
    #: How probable it is where one of these and it is so; None without rivals.
    probability: float | None = None
    #: Whether an effect of the arm explains as much: the log may be right.
    may_be_the_arm: bool = False
    #: Whether the errors on data left out leave it a next step: it raises none beyond the
    #: noise.
    is_advisable: bool = True


def one_of_rivals(remedies: Iterable[Remedy]) -> list[Remedy]:
    """List remedies that can be made together: of each set that explains as much the
    first."""
    chosen = list[Remedy]()
    for remedy in remedies:
        if not any(remedy.change in x.rivals for x in chosen):
            chosen.append(remedy)
    return chosen
