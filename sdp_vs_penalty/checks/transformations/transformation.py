"""What a transformation of a log is: its hypotheses, what each costs beforehand, and its words."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.checks.likelihood import Likelihood, Score, independent_samples
from sdp_vs_penalty.checks.repair import Repair
from sdp_vs_penalty.problem.problem import Problem
from sdp_vs_penalty.robot.arrays import Array

#: Prior odds against any repair, and against one whose number is no round one (natural logarithms): one
#: log in some hundred has a given fault; multiples of 90 degrees and powers of ten come first.
ODDS, ODD_NUMBER = 6.0, 3.0
#: Other positions are asked for where some joint leaves more than this share of its torque's energy (3
#: % of the torque): a wrong sign, order or quarter turn leaves more, even of slow motion.
_UNEXPLAINED = 1e-3
#: Ranges are known to so much [rad, m].
_BESIDE = 0.2


@dataclass(frozen=True)
class Scene:
    """What hypotheses are made for: the problem, the rows that they are tried on, and the ones that they
    are judged on; coarse : sampled too seldom for the power of friction to be told."""

    problem: Problem
    tried: Likelihood
    judged: Likelihood
    coarse: bool = False

    @property
    def n(self) -> int:
        """How many joints."""
        return self.tried.data.n

    @property
    def moving(self) -> NDArray[np.bool_]:
        """(n,) joints that move."""
        return self.tried.data.moving

    @cached_property
    def joints(self) -> list[int]:
        """Those that move."""
        return [int(j) for j in np.flatnonzero(self.moving)]

    def poor(self, score: Score) -> NDArray[np.bool_]:
        """(n,) joints of whose torque so much is unexplained that their motion may be another one."""
        return np.asarray(self.moving & (score.shares > _UNEXPLAINED))

    def revolute(self, j: int) -> bool:
        """Whether joint j (from 0) turns."""
        return self.problem.robot.joints[j].kind == "revolute"

    @cached_property
    def length(self) -> float:
        """Of the arm [m]."""
        return float(self.problem.robot.link_reach().sum())

    @cached_property
    def none(self) -> Repair:
        """The repair that changes nothing."""
        return Repair.none(self.n, self.problem.robot.gravity)

    @cached_property
    def samples(self) -> float:
        """Independent samples of the rows that hypotheses are tried on."""
        score = self.tried.scores([self.none])[0]
        return independent_samples(score.residual, self.moving)

    @cached_property
    def _ends(self) -> Array:
        """(2, n) least and largest position of each channel."""
        q = self.judged.data.motion.q
        return np.array([q.min(axis=0), q.max(axis=0)])

    def reach(self, repair: Repair) -> Array:
        """(2, n) positions between which each joint moves, in no order."""
        return repair.positions(self._ends)

    def outside(self, repair: Repair) -> int:
        """How many joints this repair leaves outside their ranges, farther than a zero is calibrated
        to.
        """
        low, high = np.sort(self.reach(repair), axis=0)
        ends = np.array([(j.lower, j.upper) for j in self.problem.robot.joints]).T
        return int(np.sum((low < ends[0] - _BESIDE) | (high > ends[1] + _BESIDE)))


@dataclass(frozen=True)
class Number:
    """One number of a repair, 0 where the log is right; ``at`` gives the repair with another one.

    tolerance : what arms and loggers differ by themselves, in the number's own unit; text : with unit;
    snaps : round values that are tried beside the best one.
    """

    value: float
    at: Callable[[float], Repair]
    tolerance: float
    reach: float
    text: Callable[[float], str]
    snaps: tuple[float, ...] = ()


@dataclass(frozen=True)
class Element:
    """One thing that a repair does: what is said of it, and the repair without it.

    cost : natural logarithm of the odds against it; mends : whether a repaired log can be written;
    gross : no arm or logger is like that by itself.
    """

    kind: str
    severity: str
    joints: tuple[int, ...]
    where: str
    what: str
    remedy: str
    without: Repair
    cost: float
    mends: bool = True
    number: Number | None = None
    figures: Mapping[str, Any] = field(default_factory=dict)


class Transformation(ABC):
    """One kind of change of a log; a file in this folder."""

    @abstractmethod
    def proposals(self, scene: Scene, now: Repair, score: Score) -> Iterator[Repair]:
        """Repairs that differ from ``now``, whose score is given, by one more thing of this kind."""

    def pairs(self, scene: Scene, now: Repair) -> Iterator[Repair]:
        """... or by two, which no single one of them would show."""
        yield from ()

    @abstractmethod
    def elements(self, scene: Scene, repair: Repair) -> Iterator[Element]:
        """What a repair does of this kind."""


def choices(count: int) -> float:
    """Cost of one of so many alike: none of them is likelier than another."""
    return ODDS + float(np.log(max(count, 1)))
