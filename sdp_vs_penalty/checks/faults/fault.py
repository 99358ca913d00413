"""A fault of a log: what is tried, what it costs beforehand, what is said."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np

from sdp_vs_penalty.checks import constants as c
from sdp_vs_penalty.checks.arm_fit import ArmFit
from sdp_vs_penalty.checks.constants import WIDEST
from sdp_vs_penalty.checks.likelihood import At, Likelihood
from sdp_vs_penalty.checks.repair import LogTransform
from sdp_vs_penalty.checks.run_log import RunLog
from sdp_vs_penalty.data.words.units import UNITS as NAMED

#: Factors of units, and what a channel is in whose torque has to be multiplied by one.
UNITS = {
    NAMED["mnm"]: "mN m",
    NAMED["ncm"]: "N cm",
    NAMED["kgfm"]: "kgf m",
    NAMED["lbfin"]: "lbf in",
}


#: Share of an arm's reach that stands for a radian: about the length of one link.
_SHARE_OF_REACH_PER_RADIAN = 0.3


def _length_like_a_radian(log: Likelihood) -> float:
    """Return the length [m] that changes this arm's torques about as a radian does.

    It is 0.3 of the arm's reach, about one link. A tolerance of angles [rad] times this
    length is the tolerance of prismatic joints and link lengths [m].
    """
    return _SHARE_OF_REACH_PER_RADIAN * float(log.problem.robot.link_reach().sum())


def _with_zero(
    log: Likelihood, now: LogTransform, j: int, offset: float
) -> LogTransform:
    """Return ``now`` with another offset of joint j's encoder [rad, m]; angles are
    wrapped to (-pi, pi]."""
    if j in log.revolute:
        offset = float(np.pi - (np.pi - offset) % (2.0 * np.pi))
    return now.with_entries("zero", (j,), offset)


def _degrees(angle: float) -> str:
    """Return an angle [rad] in words: "1.5 degrees"."""
    return f"{np.degrees(angle):.4g} degrees"


def _percent(share: float) -> str:
    """A share in words: "80 %" for 0.8."""
    return f"{100.0 * share:.0f} %"


#: By kind of issue, the word of `--apply`, and the channel that it changes.
APPLY = {
    "positions in degrees": ("degrees", "q"),
    "position unit": ("degrees", "q"),
    "positions in per cent": ("percent", "q"),
    "clock rate": ("clock", "t"),
    "time reversed": ("reverse", "t"),
    "torque sign": ("sign", "tau"),
    "position sign": ("sign", "q"),
    "joint sign": ("sign", "joint"),
    "torque order": ("order", "tau"),
    "position order": ("order", "q"),
    "joint order": ("order", "joint"),
    "torque gain": ("gain", "tau"),
    "delay": ("delay", "tau"),
    "channel delay": ("delay", "tau"),
    "encoder offset": ("zero", "q"),
}


@dataclass(frozen=True)
class FaultSize:
    """The size of a fault: one number of a repair, 0 where the log is right."""

    #: The size, in the number's own unit (rad, m, s, a share, or the natural logarithm
    #: of a factor).
    value: float
    #: Function of another size that returns the repair with it.
    repair_with: At
    #: Difference between arms and between loggers that is no fault.
    tolerance: float
    #: How far to either side of ``value`` the best size is looked for.
    search_radius: float
    #: Function of a size that returns it in words, with its unit.
    in_words: Callable[[float], str]
    #: Round sizes, tried beside it (90 degrees, a factor of 1000).
    round_values: tuple[float, ...] = ()
    #: Widest 95 % interval, to either side, with which a size is claimed.
    widest: float = WIDEST
    #: Function of a size that returns the number in the words, or one that rises with
    #: it.
    number_told: Callable[[float], float] = float

    def interval_in_words(self, ends: Sequence[float]) -> str:
        """Say an interval of sizes: "1.1 times too large to 1.11 times too large".

        Parameters
        ----------
        ends : sequence of float
            In the size's own unit.

        Returns
        -------
        str
            The end of the smaller number first.
        """
        return " to ".join(map(self.in_words, sorted(ends, key=self.number_told)))

    @property
    def first_order_reach(self) -> float:
        """Largest change for which a first-order step is trusted: within the
        tolerance."""
        return 0.9 * self.tolerance

    def round_values_within(self, distance: float) -> list[float]:
        """List the nearest round value, if it is nearer than ``distance``; else
        nothing.

        Parameters
        ----------
        distance : float
            In the size's own unit.

        Returns
        -------
        list of float
            At most one round value.
        """
        by_distance = sorted(self.round_values, key=lambda x: abs(x - self.value))
        return [x for x in by_distance[:1] if abs(x - self.value) < distance]

    @classmethod
    def of_factor(
        cls, factor: float, repair_with_factor: At, round_factors: tuple[float, ...]
    ) -> "FaultSize":
        """Return the size of a channel that is off by a factor: its natural logarithm.

        Parameters
        ----------
        factor : float
            By which the channel has to be multiplied [-].
        repair_with_factor : callable
            The repair with another factor.
        round_factors : tuple of float
            Factors that are likelier than others: 10, 1000.

        Returns
        -------
        FaultSize
            0 for a factor of one.
        """

        def repair_with_logarithm(log_factor: float) -> LogTransform:
            return repair_with_factor(float(np.exp(log_factor)))

        return cls(
            value=float(np.log(factor)),
            repair_with=repair_with_logarithm,
            tolerance=c.CALIBRATED_GAIN,
            search_radius=0.5,  # factors from 0.6 to 1.6 times this one
            in_words=lambda log_factor: f"a factor of {np.exp(log_factor):.3g}",
            round_values=tuple(float(np.log(x)) for x in round_factors),
        )


def odds_against_one_of(count: int) -> float:
    """Natural logarithm of the prior odds against one of ``count`` equally likely
    faults: those against any fault, times their number.

    Parameters
    ----------
    count : int
        Number of equally likely faults.
    """
    return c.LOG_ODDS_AGAINST_FAULT + float(np.log(max(count, 1)))


@dataclass(frozen=True)
class Fault:
    """One fault of a log that a repair corrects, and what the user is told of it."""

    #: What is wrong, in two or three words.
    kind: str
    #: "error", "warning" or "note".
    severity: str
    #: Joints that have the fault, from 0.
    joints: tuple[int, ...]
    #: What is wrong, in one sentence.
    what: str
    #: What to do, in one sentence.
    remedy: str
    #: How the fault is left uncorrected: the repair without this correction, or the
    #: fault's size, which is set to 0.
    removal: LogTransform | FaultSize
    #: Natural logarithm of the prior odds against the fault.
    log_odds_against: float = c.LOG_ODDS_AGAINST_FAULT
    #: Where the fault is, in words; empty: at its joints.
    place: str = ""
    #: Whether a repaired log can be written.
    is_repairable: bool = True
    #: What explains as much, in words.
    equivalents: tuple[str, ...] = ()
    #: Numbers behind the fault, for JSON.
    figures: Mapping[str, Any] = field(default_factory=dict)
    #: For a fault that happens at an instant, figures["t"] [s]: returns the fault in
    #: the words of that instant by another clock [s]; None for what happens at no
    #: instant.
    by_clock: "Callable[[float], Fault] | None" = None
    #: For a fault whose size belongs to each run: returns the fault in the words of
    #: several runs; None for what all runs share.
    by_run: "Callable[[Sequence[RunLog]], Fault] | None" = None

    @property
    def size(self) -> FaultSize | None:
        """The fault's size; None for a fault that is there or not (a sign, an order)."""
        return self.removal if isinstance(self.removal, FaultSize) else None

    @property
    def has_uneven_size(self) -> bool:
        """Whether the fault has a size that is no round value: 0.37 rad, and not 90
        degrees."""
        if self.size is None:
            return False
        return not np.isclose(self.size.value, self.size.round_values).any()

    @property
    def is_of_gravity(self) -> bool:
        """Whether it is the direction, the size or the absence of gravity."""
        return self.kind.startswith("gravity")

    @property
    def repair_without(self) -> LogTransform:
        """The repair without the correction of this fault."""
        if isinstance(self.removal, FaultSize):
            return self.removal.repair_with(0.0)
        return self.removal

    @property
    def apply(self) -> str:
        """The word by which `check --fix --apply` tries the repair, as "sign:tau3";
        empty where no log can be repaired."""
        verb, channel = APPLY.get(self.kind, ("", ""))
        if not verb or not self.is_repairable:
            return ""
        numbered = "+".join(f"{channel}{j + 1}" for j in self.joints)
        return f"{verb}:{numbered or channel}"

    @property
    def name(self) -> tuple[str, tuple[int, ...]]:
        """Kind and joints: two faults of one name differ in their size alone."""
        return self.kind, self.joints


class Transformation(ABC):
    """One kind of fault of a log: which repairs the search may try, and what a repair
    means in words. name : by which other modules refer to the kind."""

    name: ClassVar[str]

    @abstractmethod
    def propose(
        self, log: Likelihood, now: LogTransform, fit: ArmFit
    ) -> Iterator[LogTransform]:
        """Yield repairs that correct one more fault of this kind than ``now`` does.

        Parameters
        ----------
        log : Likelihood
            Rows that repairs are judged on.
        fit : ArmFit
            The arm fitted to the rows as ``now`` repairs them.

        Returns
        -------
        iterator of LogTransform
            Complete repairs, each of which the search fits an arm to.
        """

    @abstractmethod
    def list_faults(self, log: Likelihood, repair: LogTransform) -> Iterator[Fault]:
        """Yield the faults of this kind that a repair corrects.

        Parameters
        ----------
        log : Likelihood
            Rows that the repair is judged on.
        repair : LogTransform
            A complete repair, with faults of any kinds.

        Returns
        -------
        iterator of Fault
            With the words for the user.
        """
