"""Which column of a log is which channel: the answer that all ways of finding it give."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

from sdp_vs_penalty.data.words.tokens import group_of
from sdp_vs_penalty.data.words.units import UNITS
from sdp_vs_penalty.errors import InputError

if TYPE_CHECKING:
    from sdp_vs_penalty.data.hypotheses.weighing import ColumnHypothesis


#: How columns were recognised where no known program wrote them.
BY_WORDS = "by their words"
#: The unit of a torque whose name says a current, and no unit.
UNSAID_CURRENT = "(in A, where it is not raw)"


@dataclass(frozen=True)
class Recognition:
    """Which column of a log is which channel, in which unit and why."""

    #: The file's names by ours (t, q1 ..., or q for a block); that of t is "sec+nanosec"
    #: where a stamp is in two parts, "hour+minute+second" for a time of day.
    rename: dict[str, str]
    #: Factors to SI by our names, where they are not 1.
    scale: dict[str, float] = field(default_factory=dict)
    #: Readings of encoders at zero, in the file's unit, of each joint's position.
    zeros: tuple[float, ...] = ()
    #: The program that writes such files, or how the columns were recognised, in words.
    logger: str = BY_WORDS
    #: Unit of channel groups, with the reason.
    units: Mapping[str, ColumnHypothesis] = field(default_factory=dict)
    #: Other sentences: of motors, of currents, of what is not used.
    said: tuple[str, ...] = ()
    #: ANGLE, SERVO or CLOCK by channel group, of units that the values show.
    inferred: Mapping[str, str] = field(default_factory=dict)
    #: Columns by our names of the sets of torques that compete, by their first and last.
    torques: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    #: Names of the joints, where the file says them.
    joints: tuple[str, ...] = ()
    #: Places of the robot's joints within a block, where the orders differ.
    order: tuple[int, ...] | None = None
    #: Name of the column that counts runs.
    episode: str | None = None
    #: Whether the robot's joints have other names than the file's.
    has_other_joints: bool = False
    #: "A" where the torques are motor currents, by their words.
    torque_unit: str = ""
    #: Whether the arm has told what no command says without it.
    is_of_arm: bool = False
    #: Unit of positions that the arm has told; empty: it has told none.
    unit_by_arm: str = ""
    #: Words of ``--scale`` by group that the arm finds possible, not certain.
    possible_scale: Mapping[str, str] = field(default_factory=dict)
    #: Further words of the `convert` command that the arm finds possible: of gears.
    possible_options: tuple[str, ...] = ()
    #: Those of q and tau whose unit neither names, metadata nor the program that wrote the
    #: file say.
    unsaid: frozenset[str] = frozenset()
    #: Sampling rate [Hz] that velocities tell of a file without a clock.
    rate: float | None = None
    #: What is raised where the arm does not confirm these columns; None: nothing is open.
    unless_confirmed: InputError | None = None
    #: Other orders of columns that the values allow, the likeliest first.
    others: tuple[Recognition, ...] = ()
    #: Odds of an order by its values.
    weight: float = 1.0
    #: Share of the torques that the arm leaves in it.
    share: float = 1.0
    #: Whether the arm has confirmed columns that no name says.
    is_confirmed: bool = False
    #: Whether the arm has told that torques are registers with a sign bit.
    has_sign_bit: bool = False

    @property
    def is_possible(self) -> bool:
        """Whether the arm finds another reading of positions possible, not certain."""
        return bool(self.possible_scale or self.possible_options)

    @property
    def has_our_names(self) -> bool:
        """Whether all columns have our names."""
        return all(x == y for x, y in self.rename.items())

    @property
    def is_identity(self) -> bool:
        """Whether nothing was guessed, since the columns have our names, or the file says
        what they are."""
        is_named = not self.logger or self.has_our_names
        return is_named and not (self.units or self.said)

    def with_unit(self, group: str, unit: ColumnHypothesis) -> Recognition:
        """Return the recognition with another unit of a channel group."""
        found = self.with_factors(group, [UNITS.get(unit.answer.lower(), 1.0)])
        return replace(found, units={**self.units, group: unit})

    def with_factors(self, group: str, factors: Sequence[float]) -> Recognition:
        """Return the recognition with other factors to SI of a group's joints."""
        names = [k for k in self.rename if group_of(k) == group]
        if len({*factors}) == 1:
            factors = [factors[0]] * len(names)
        elif len(names) < len(factors):  # of a block
            names = [f"{group}{k}" for k, _ in enumerate(factors, 1)]
        scale = {k: x for k, x in self.scale.items() if group_of(k) != group}
        scale |= {k: x for k, x in zip(names, factors, strict=True) if x != 1.0}
        return replace(self, scale=scale)

    def without_unit(self, name: str) -> Recognition:
        """Return the recognition that says nothing of the unit of a channel group, or of
        one of its joints, "q2"."""
        group = group_of(name)
        if name != group:
            alone = {**self.scale, name: 1.0}
            names = {k for k in (*self.rename, *alone) if group_of(k) == group}
            if any(alone.get(k) != 1.0 for k in names):
                return replace(self, scale=alone)
        scale = {k: x for k, x in self.scale.items() if group_of(k) != group}
        units = {k: x for k, x in self.units.items() if k != group}
        inferred = {k: x for k, x in self.inferred.items() if k != group}
        return replace(
            self,
            scale=scale,
            units=units,
            inferred=inferred,
            unsaid=self.unsaid - {group},
            zeros=() if group == "q" else self.zeros,
        )

    def without_units_of(self, names: Iterable[str]) -> Recognition:
        """Return the recognition that says nothing of the units of groups, or of single
        joints, that an option states."""
        recognition = self
        for name in names:
            recognition = recognition.without_unit(name)
        return recognition

    def with_sentences(self, *sentences: str) -> Recognition:
        """Return the recognition with further sentences."""
        return replace(self, said=(*self.said, *sentences))

    def factors(self, group: str, n: int) -> list[float]:
        """List the factors to SI of a group's n columns."""
        whole = self.scale.get(group, 1.0)
        return [self.scale.get(f"{group}{k}", whole) for k in range(1, n + 1)]


def has_our_names(names: Sequence[str]) -> bool:
    """Return whether a file has the names of RUN.csv, so that nothing needs to be
    recognised: t, positions (q or q1 ...) and torques or commands, for the same number of
    joints, counted from 1."""
    known = {*names}
    counts = {
        group: sum(x.startswith(group) and x[len(group) :].isdigit() for x in known)
        for group in ("q", "tau", "qcmd")
    }
    n_torques = counts["tau"] or counts["qcmd"]
    return (
        "t" in known
        and not known.isdisjoint({"q", "q1"})
        and not known.isdisjoint({"tau", "tau1", "qcmd", "qcmd1"})
        and (not counts["q"] or not n_torques or counts["q"] == n_torques)
        and not counted_from_zero(names)
    )


def counted_from_zero(names: Sequence[str]) -> bool:
    """Return whether columns with our names count the joints from 0 (q0, tau0)."""
    return not {"q0", "dq0", "tau0", "qcmd0"}.isdisjoint(names)
