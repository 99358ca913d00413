"""A fault of a log: what is tried, what it costs beforehand, what is said."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np

from sdp_vs_penalty.checks import constants as c
from sdp_vs_penalty.checks.arm_fit import ArmFit
from sdp_vs_penalty.checks.constants import WIDEST
from sdp_vs_penalty.checks.likelihood import At, Likelihood
from sdp_vs_penalty.checks.repair import LogTransform
from sdp_vs_penalty.data.formats.units import UNITS as NAMED

#: Factors of units, and what a channel is in whose torque has to be multiplied by one.
UNITS = {
    NAMED["mnm"]: "mN m",
    NAMED["ncm"]: "N cm",
    NAMED["kgfm"]: "kgf m",
    NAMED["lbfin"]: "lbf in",
}


def _length(log: Likelihood) -> float:
    """What a radian is to an angle: a length of this arm's size [m]."""
    return 0.3 * float(log.problem.robot.link_reach().sum())


def _shifted(
    log: Likelihood,
    now: LogTransform,
    j: int,
    x: float,
) -> LogTransform:
    """An angle in (-pi, pi]; a length as it is."""
    wrapped = float(np.pi - (np.pi - x) % (2.0 * np.pi)) if j in log.revolute else x
    return now.with_entries("zero", (j,), wrapped)


def _degrees(angle: float) -> str:
    return f"{np.degrees(angle):.4g} degrees"


def _percent(share: float) -> str:
    return f"{100.0 * share:.0f} %"


#: By kind of issue, what `--apply` calls it, and the channel that it changes.
APPLY = {
    "positions in degrees": ("degrees", "q"),
    "position unit": ("degrees", "q"),
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
    """One number of a repair, 0 where the log is right; ``at`` gives the repair with
    another one.

    tolerance : what arms and loggers differ by themselves, in the number's own unit;
    reach : how far to either side the best value is looked for; text : with unit; round_values
    : round values, tried beside it.
    """

    value: float
    at: At
    tolerance: float
    search_radius: float
    text: Callable[[float], str]
    round_values: tuple[float, ...] = ()
    widest: float = WIDEST

    def round_within(self, reach: float) -> list[float]:
        """The nearest round value, where it is nearer than that."""
        by_distance = sorted(self.round_values, key=lambda x: abs(x - self.value))
        return [x for x in by_distance[:1] if abs(x - self.value) < reach]

    @classmethod
    def factor(
        cls,
        x: float,
        at: At,
        snaps: tuple[float, ...],
    ) -> "FaultSize":
        """The natural logarithm of a factor x, which ``at`` and snaps count in."""
        logs = tuple(float(np.log(s)) for s in snaps)
        text = lambda v: f"a factor of {np.exp(v):.3g}"  # noqa: E731
        return cls(
            float(np.log(x)),
            lambda v: at(float(np.exp(v))),
            c.CALIBRATED_GAIN,
            0.5,
            text,
            logs,
        )


def choices(count: int) -> float:
    """Natural logarithm of the odds against one of so many alike, none of them likelier
    than another."""
    return c.ODDS + float(np.log(max(count, 1)))


@dataclass(frozen=True)
class Fault:
    """One thing that a repair does, and what is said of it; ``of`` : the repair without
    it, or its number.

    cost : natural logarithm of the odds against it; place : default: the joints; mends
    : whether a repaired log can be written.
    """

    kind: str
    severity: str
    joints: tuple[int, ...]
    what: str
    remedy: str
    of: LogTransform | FaultSize
    cost: float = c.ODDS
    place: str = ""
    mends: bool = True
    equivalents: tuple[str, ...] = ()
    figures: Mapping[str, Any] = field(default_factory=dict)

    @property
    def number(self) -> FaultSize | None:
        return self.of if isinstance(self.of, FaultSize) else None

    @property
    def odd(self) -> bool:
        """Whether it is a number that is not round."""
        return (
            isinstance(self.of, FaultSize)
            and not np.isclose(self.of.value, self.of.round_values).any()
        )

    @property
    def is_of_gravity(self) -> bool:
        return self.kind.startswith("gravity")

    @property
    def without(self) -> LogTransform:
        return self.of.at(0.0) if isinstance(self.of, FaultSize) else self.of

    @property
    def apply(self) -> str:
        """The word by which `check --fix --apply` tries it; empty where it cannot."""
        verb, channel = APPLY.get(self.kind, ("", ""))
        if not verb or not self.mends:
            return ""
        numbered = "+".join(f"{channel}{j + 1}" for j in self.joints)
        return f"{verb}:{numbered or channel}"

    @property
    def name(self) -> tuple[str, tuple[int, ...]]:
        return self.kind, self.joints


class Transformation(ABC):
    """One kind of change of a log; name : how others speak of it."""

    name: ClassVar[str]

    @abstractmethod
    def proposals(
        self,
        log: Likelihood,
        now: LogTransform,
        score: ArmFit,
    ) -> Iterator[LogTransform]:
        """Repairs that differ from ``now``, whose score is given, by one more thing of
        this kind."""

    @abstractmethod
    def elements(self, log: Likelihood, repair: LogTransform) -> Iterator[Fault]:
        """What a repair does of this kind."""
