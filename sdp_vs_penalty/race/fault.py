"""A fault that a transform of a log corrects: what is said of it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

from sdp_vs_penalty import formatting
from sdp_vs_penalty.data.words.units import UNITS as NAMED
from sdp_vs_penalty.race.chain import LogTransform
from sdp_vs_penalty.race.constants import LOG_ODDS_AGAINST_FAULT
from sdp_vs_penalty.race.likelihood import Likelihood
from sdp_vs_penalty.race.records import Number

#: What of positions may be another, beside their unit: where they count from, a factor as
#: gears have, or the steps in which they are counted.
PositionError = Literal["zero", "factor", "steps"]
#: Factors of units, and what a channel is in whose torque has to be multiplied by one.
UNITS = {
    NAMED["mnm"]: "mN m",
    NAMED["ncm"]: "N cm",
    NAMED["kgfm"]: "kgf m",
    NAMED["lbfin"]: "lbf in",
}


#: Name and rows of each run, and how they are repaired.
Runs = Sequence[tuple[str, Likelihood, LogTransform]]
#: Share of an arm's reach that stands for a radian: about the length of one link.
_SHARE_OF_REACH_PER_RADIAN = 0.3


def length_like_a_radian(log: Likelihood) -> float:
    """Return the length [m] that changes an arm's torques about as much as a radian: 0.3
    of its reach, about one link.

    A tolerance of angles [rad] times this
    length is the tolerance of prismatic joints and link lengths [m].
    """
    return _SHARE_OF_REACH_PER_RADIAN * float(log.problem.robot.link_reach().sum())


def degrees_text(angle: float) -> str:
    """Return an angle [rad] in words: "1.5 degrees"."""
    return f"{np.degrees(angle):.4g} degrees"


def percent_text(share: float) -> str:
    """Write a share in words: "80 %" for 0.8."""
    return f"{100.0 * share:.0f} %"


def times_text(factor: float) -> str:
    """Say how wrong a channel is that a factor repairs: "2 times too large" for 0.5."""
    if factor < 1.0:
        return f"{1.0 / factor:.3g} times too large"
    return f"{factor:.3g} times too small"


def joints_text(joints: Sequence[int]) -> str:
    """Name joints given from 0: "joint 1", "joints 2 to 4"."""
    return formatting.joints([int(j) + 1 for j in joints])


def prior_of_one_of(count: int) -> float:
    """Natural logarithm of the prior odds of one of ``count`` equally likely faults.

    Parameters
    ----------
    count : int
        Number of equally likely faults.
    """
    return -LOG_ODDS_AGAINST_FAULT - float(np.log(max(count, 1)))


@dataclass(frozen=True)
class Fault:
    """One fault of a log that a transform corrects, and what the user is told of it."""

    #: What is wrong, in two or three words.
    kind: str
    #: Joints that have the fault, from 0.
    joints: tuple[int, ...]
    #: What is wrong, in one sentence; "{t:.4g}" stands for the instant ``at``.
    what: str
    #: What to do, in one sentence.
    remedy: str
    #: The transform without this correction.
    without: LogTransform
    #: The number that is its size; None for what is there or not (a sign, an order).
    number: Number | None = None
    #: Function of a size that returns it in words, with its unit.
    in_words: Callable[[float], str] = str
    #: Function of a size that returns the number in these words, or one that rises with
    #: it.
    sort_key: Callable[[float], float] = float
    #: Where the fault is, in words; empty: at its joints.
    place: str = ""
    #: The word of `--apply` that repairs a log, and the channel that it changes; None
    #: where no repaired log can be written.
    repaired_by: tuple[str, str] | None = None
    #: Unit that positions are in; "" where a part of the joints has it alone; None for a
    #: fault that is about no unit of positions.
    position_unit: str | None = None
    #: What of positions it says is another.
    of_positions: PositionError | None = None
    #: What of the log it leaves in doubt, in words: a model of it is not good, whatever its
    #: error; "" where nothing.
    in_doubt: str = ""
    #: Whether columns hold something else than they are read as: their unit, order or sign.
    is_of_columns: bool = False
    #: Gravity that the torques show instead [m/s^2], for a fault about it.
    gravity: tuple[float, ...] | None = None
    #: Instant from which it acts [s]; None for one of all rows.
    at: float | None = None
    #: Function that returns the fault in the words of several runs, whose names, rows and
    #: repairs it takes; None: as of one.
    in_words_of_runs: Callable[[Fault, Runs], Fault] | None = None
    #: Numbers behind the fault, for JSON.
    figures: Mapping[str, Any] = field(default_factory=dict)

    @property
    def is_gain(self) -> bool:
        """Whether torque channels have another factor."""
        return self.number is not None and self.number.is_gain

    @property
    def changes_positions(self) -> bool:
        """Whether its repair changes positions."""
        return self.repaired_by is not None and self.repaired_by[1] in ("q", "joint")

    @property
    def changes_order(self) -> bool:
        """Whether its repair gives joints other channels."""
        return self.repaired_by is not None and self.repaired_by[0] == "order"

    @property
    def sentence(self) -> str:
        """What is wrong, by the clock of all runs together."""
        return self.what.format(t=self.at)

    @property
    def apply(self) -> str:
        """The word by which `check --fix --apply` tries the repair, as "sign:tau3";
        empty where no log can be repaired."""
        if self.repaired_by is None:
            return ""
        verb, channel = self.repaired_by
        numbered = "+".join(f"{channel}{j + 1}" for j in self.joints)
        return f"{verb}:{numbered or channel}"

    @property
    def name(self) -> tuple[str, tuple[int, ...]]:
        """Kind and joints: two faults of one name differ in their size alone."""
        return self.kind, self.joints

    def interval_in_words(self, ends: Sequence[float]) -> str:
        """Say an interval of sizes: "1.1 times too large to 1.11 times too large".

        Parameters
        ----------
        ends : (2,) sequence of float
            In the size's own unit.

        Returns
        -------
        str
            The end of the smaller number first.
        """
        first, last = map(self.in_words, sorted(ends, key=self.sort_key))
        return f"{first} to {last}"
