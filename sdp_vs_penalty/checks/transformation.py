"""What a transformation of a log is: its hypotheses, what each costs beforehand, and its words."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.checks.constants import CONTRADICTS, ODDS
from sdp_vs_penalty.checks.likelihood import Likelihood, Score, independent_samples
from sdp_vs_penalty.checks.repair import Repair
from sdp_vs_penalty.problem.problem import Problem
from sdp_vs_penalty.robot.arrays import Array


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
    def factor(
        cls, x: float, at: Callable[[float], Repair], tolerance: float, reach: float,
        snaps: tuple[float, ...],
    ) -> Number:  # fmt: skip
        """The natural logarithm of a factor x, which ``at`` and snaps count in."""
        logs = tuple(float(np.log(s)) for s in snaps)
        text = lambda v: f"a factor of {np.exp(v):.3g}"  # noqa: E731
        return cls(float(np.log(x)), lambda v: at(float(np.exp(v))), tolerance, reach, text, logs)


@dataclass(frozen=True)
class Element:
    """One thing that a repair does: what is said of it, and the repair ``without`` it.

    cost : natural logarithm of the odds against it; place : default: the joints; mends : whether a
    repaired log can be written.
    """

    kind: str
    severity: str
    joints: tuple[int, ...]
    what: str
    remedy: str
    cost: float
    without: Repair
    number: Number | None = None
    mends: bool = True
    place: str = ""
    figures: Mapping[str, Any] = field(default_factory=dict)

    @property
    def name(self) -> tuple[str, tuple[int, ...]]:
        return self.kind, self.joints


@dataclass(frozen=True)
class Scene:
    """What hypotheses are made for: the problem, and the likelihood of the log's rows."""

    problem: Problem
    likelihood: Likelihood

    @cached_property
    def screen(self) -> Likelihood:
        """Of fewer rows: enough to see which hypotheses are worth a closer look."""
        return Likelihood(self.likelihood.data.few())

    @property
    def n(self) -> int:
        """How many joints."""
        return self.likelihood.data.n

    @property
    def moving(self) -> NDArray[np.bool_]:
        """(n,) joints that move."""
        return self.likelihood.data.moving

    @cached_property
    def joints(self) -> list[int]:
        """Those that move."""
        return [int(j) for j in np.flatnonzero(self.moving)]

    @cached_property
    def revolute(self) -> list[int]:
        """Those of ``joints`` that turn."""
        return [j for j in self.joints if self.problem.robot.joints[j].kind == "revolute"]

    @cached_property
    def none(self) -> Repair:
        """The repair that changes nothing."""
        return Repair.none(self.n, self.problem.robot.gravity)

    @cached_property
    def samples(self) -> float:
        """Independent samples of the rows."""
        return independent_samples(self.likelihood.score(self.none).residual, self.moving)

    def poor(self, score: Score) -> NDArray[np.bool_]:
        """(n,) joints of whose torque so much is unexplained that their motion may be another one."""
        return np.asarray(self.moving & (score.shares > CONTRADICTS[1]))

    def reach(self, repair: Repair) -> Array:
        """(n,) largest position of each joint, whatever its sign."""
        return np.abs(repair.positions(self.likelihood.data.motion.q)).max(axis=0)


class Transformation(ABC):
    """One kind of change of a log."""

    @abstractmethod
    def proposals(self, scene: Scene, now: Repair, score: Score) -> Iterator[Repair]:
        """Repairs that differ from ``now``, whose score is given, by one more thing of this kind."""

    @abstractmethod
    def elements(self, scene: Scene, repair: Repair) -> Iterator[Element]:
        """What a repair does of this kind."""


def choices(count: int) -> float:
    """Cost of one of so many alike: none of them is likelier than another."""
    return ODDS + float(np.log(max(count, 1)))
