"""What a transformation of a log is: its hypotheses, what each costs beforehand, and its words."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np

from sdp_vs_penalty.checks.constants import CALIBRATED_GAIN, ODDS
from sdp_vs_penalty.checks.likelihood import Likelihood, Score
from sdp_vs_penalty.checks.repair import Repair


@dataclass(frozen=True)
class Number:
    """One number of a repair, 0 where the log is right; ``at`` gives the repair with another one.

    tolerance : what arms and loggers differ by themselves, in the number's own unit; text : with unit;
    reach : how far to either side the best value is looked for; snaps : round values, tried beside it.
    """

    value: float
    at: Callable[[float], Repair]
    tolerance: float
    reach: float
    text: Callable[[float], str]
    snaps: tuple[float, ...] = ()

    @classmethod
    def of(cls, repair: Repair, name: str, joints: tuple[int, ...], value: float, *more: Any) -> Number:
        """The entry of some joints."""
        return cls(value, partial(repair.with_entries, name, joints), *more)

    @classmethod
    def factor(cls, x: float, at: Callable[[float], Repair], snaps: tuple[float, ...]) -> Number:
        """The natural logarithm of a factor x, which ``at`` and snaps count in."""
        logs = tuple(float(np.log(s)) for s in snaps)
        text = lambda v: f"a factor of {np.exp(v):.3g}"  # noqa: E731
        return cls(float(np.log(x)), lambda v: at(float(np.exp(v))), CALIBRATED_GAIN, 0.5, text, logs)


@dataclass(frozen=True)
class Element:
    """One thing that a repair does, and what is said of it; ``of`` : the repair without it, or its
    number.

    cost : natural logarithm of the odds against it; place : default: the joints; mends : whether a
    repaired log can be written.
    """

    kind: str
    severity: str
    joints: tuple[int, ...]
    what: str
    remedy: str
    of: Repair | Number
    cost: float = ODDS
    place: str = ""
    mends: bool = True
    figures: Mapping[str, Any] = field(default_factory=dict)

    @property
    def number(self) -> Number | None:
        return self.of if isinstance(self.of, Number) else None

    @property
    def odd(self) -> bool:
        """Whether it is a number that is not round."""
        return self.number is not None and not np.isclose(self.number.value, self.number.snaps).any()

    @property
    def without(self) -> Repair:
        return self.of.at(0.0) if isinstance(self.of, Number) else self.of

    @property
    def name(self) -> tuple[str, tuple[int, ...]]:
        return self.kind, self.joints


class Transformation(ABC):
    """One kind of change of a log."""

    @abstractmethod
    def proposals(self, log: Likelihood, now: Repair, score: Score) -> Iterator[Repair]:
        """Repairs that differ from ``now``, whose score is given, by one more thing of this kind."""

    @abstractmethod
    def elements(self, log: Likelihood, repair: Repair) -> Iterator[Element]:
        """What a repair does of this kind."""


def choices(count: int) -> float:
    """Cost of one of so many alike: none of them is likelier than another."""
    return ODDS + float(np.log(max(count, 1)))
