"""Records of the race: a number of a transform, rows of a part, and a hypothesis."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from sdp_vs_penalty import formatting
from sdp_vs_penalty.race import constants as c
from sdp_vs_penalty.race.chain import LogTransform
from sdp_vs_penalty.robot.arrays import Array, Indices, Mask

#: What of the arm may be another one in a part of a log: what its last link carries, its
#: links, the friction of a joint.
ArmDifference = Literal["load", "links", "friction"]


@dataclass(frozen=True)
class Number:
    """The size of a hypothesis: one number of a transform, 0 where the log is right.

    The size of a factor is the natural logarithm of its absolute value.
    """

    #: Field of the transform.
    field: str
    #: Joints (from 0) whose entries have this number; empty for a field without joints.
    joints: tuple[int, ...]
    #: Prior standard deviation of the size, in its own unit.
    sd: float
    #: Largest size that healthy arms and loggers have: up to there it is no fault.
    usual: float = 0.0
    #: The same below zero, as a positive number; None: as above zero.
    usual_below: float | None = None
    #: Whether the entries are factors.
    is_factor: bool = False
    #: Step of the difference quotient.
    step: float = 0.01
    #: Widest 95 % interval, to either side, with which it is claimed.
    widest: float = 1e9
    #: Sizes that are likelier than others: a quarter turn, a factor of ten.
    round_sizes: tuple[float, ...] = ()
    #: Largest distance from a round size at which the size is rounded to it.
    rounded_within: float = 1e9
    #: Half of the widest 95 % interval with which a log is repaired: with a wider one the
    #: user is asked for the size.
    known_within: float = 1e9
    #: Smallest and largest possible size.
    limits: tuple[float, float] = (-1e9, 1e9)

    @property
    def is_gain(self) -> bool:
        """Whether it is a factor of torque channels."""
        return self.field == "gain"

    def size_in(self, transform: LogTransform) -> float:
        """Return the size that a transform has: its entry, or the natural logarithm of its
        absolute value for a factor."""
        entries = getattr(transform, self.field)
        value = entries[self.joints[0]] if self.joints else entries
        return float(np.log(abs(value))) if self.is_factor else float(value)

    def at(self, transform: LogTransform, size: float) -> LogTransform:
        """Return a transform with the entries of this number's joints at a size; a factor
        keeps its sign."""
        value = float(np.exp(size)) if self.is_factor else size
        changed: Any = value
        if self.joints:
            entries = [*getattr(transform, self.field)]
            for j in self.joints:
                is_negative = self.is_factor and entries[j] < 0.0
                entries[j] = -value if is_negative else value
            changed = tuple(entries)
        return replace(transform, **{self.field: changed})


def factor_of(field: str, joints: tuple[int, ...]) -> Number:
    """Return the number of a factor, of the field ``field``, that drives and loggers know
    to a few per cent; its natural logarithm is sought between -2 and 2."""
    return Number(
        field,
        joints,
        sd=0.5,
        usual=c.CALIBRATED_GAIN,
        is_factor=True,
        widest=c.WIDEST,
        limits=(-2.0, 2.0),
    )


@dataclass(frozen=True)
class Part:
    """Rows of a log to which a difference is confined: those of a run, those after an
    instant, or those of a span of time."""

    #: Number of the run, from 0; None for rows of any run.
    run: int | None = None
    #: Instant [s] after which the rows are; None for all.
    after: float | None = None
    #: Instant [s] up to which they are; None: to the end.
    until: float | None = None

    @property
    def ends(self) -> tuple[float, float]:
        """Both ends of a span [s]."""
        assert self.after is not None
        assert self.until is not None
        return self.after, self.until

    def rows(self, runs: Indices, t: Array) -> Mask:
        """Return which rows (M,) belong to it.

        Parameters
        ----------
        runs : (M,) array of int
            Number of each row's run, from 0.
        t : (M,) array
            Instants of the rows [s].
        """
        belongs = np.ones(len(t), bool) if self.run is None else runs == self.run
        if self.after is not None:
            belongs = belongs & (t > self.after)
        return belongs if self.until is None else belongs & (t <= self.until)


@dataclass(frozen=True, eq=False)
class ExtraTorque:
    """Columns of torque in addition to the arm's, with the prior of their sizes."""

    #: (n, M, r) torque per unit of each size.
    columns: Array
    #: (r,) standard deviation of each size beforehand.
    sd: Array
    #: Whether the first size is positive: a mass that is added.
    is_positive: bool = False
    #: Largest absolute value of the first size that healthy arms have: no fault up to there.
    usual: float = 0.0
    #: Span of time outside of which they are zero; None where it is all.
    span: Part | None = None
    #: Function that makes the same columns under another transform; None if they do not
    #: depend on it.
    recompute: Callable[[LogTransform], ExtraTorque] | None = None


@dataclass(frozen=True)
class LogView:
    """How rows are seen: under a transform of all rows, with extra columns of torque.

    Rows of some parts are changed by a transform of their own first.
    """

    #: What is done to all rows.
    transform: LogTransform
    #: Parts that have a transform of their own, which comes before that of all rows.
    parts: tuple[tuple[Part, LogTransform], ...] = ()
    #: Columns beside the arm's.
    extra_torques: tuple[ExtraTorque, ...] = ()
    #: Whether friction takes power.
    is_friction_dissipative: bool = True

    @property
    def motion(self) -> LogView:
        """The part of the view on which the regression's columns depend: without changes
        of the torques alone. Views with the same motion share their columns."""
        parts = []
        for part, part_transform in self.parts:
            # Friction of a part that runs backwards differs from that of the others.
            motion = replace(
                part_transform.motion_part, reversed=part_transform.reversed
            )
            if motion != motion.unchanged(motion.n, motion.assumed):
                parts.append((part, motion))
        return LogView(self.transform.motion_part, tuple(parts), self.extra_torques)

    @property
    def transforms(self) -> list[LogTransform]:
        """The transform of all rows, then that of each part's rows: the part's transform
        followed by that of all rows."""
        return [self.transform, *(x.followed_by(self.transform) for _, x in self.parts)]

    def with_transform(self, transform: LogTransform) -> LogView:
        """Return the view with another transform of all rows, and extra torques computed
        for it."""
        if transform == self.transform:
            return self
        extra = tuple(
            x.recompute(transform) if x.recompute else x for x in self.extra_torques
        )
        return replace(self, transform=transform, extra_torques=extra)

    def with_part(self, part: Part, transform: LogTransform) -> LogView:
        """Return the view in which a part's rows go through a transform first, and then
        through what the view does to them already."""
        parts = dict(self.parts)
        parts[part] = transform.followed_by(parts[part]) if part in parts else transform
        return replace(self, parts=tuple(parts.items()))


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """One thing that may be wrong with a log, or missing in the model of the arm.

    It is a remedy before it is judged: ``transform`` is the transform that undoes it.
    """

    #: What is wrong, in two or three words: the kind of its issue.
    kind: str
    #: Joints that it is about, from 0.
    joints: tuple[int, ...]
    #: Natural logarithm of its prior odds against "nothing".
    log_prior: float
    #: What is done to the rows where it holds; of a part: before what all rows have.
    transform: LogTransform
    #: Its size, which the race refines; None for what is there or not.
    number: Number | None = None
    #: Rows to which it is confined; None: all.
    part: Part | None = None
    #: Torque beside the arm's; the first size is that of the hypothesis.
    extra_torque: ExtraTorque | None = None
    #: The same torque where its columns depend on that size.
    extra_torque_at: Callable[[float], ExtraTorque] | None = None
    #: Whether friction takes power under it.
    is_friction_dissipative: bool = True
    #: Whether only the sign of friction shows it. A missing law, or a controller that
    #: subtracts friction, changes that sign as well.
    tells_by_friction: bool = False
    #: What an effect of the arm is, in words; empty for a fault of the log.
    effect: str = ""
    #: What a controller did to the torques, in a sentence; the effect is then no missing
    #: law of the arm.
    by_controller: str = ""
    #: Whether arms and loggers differ as much by themselves.
    is_usual: bool = False
    #: Unit that positions are in, as its fault has it.
    position_unit: str | None = None
    #: Whether other joints may have the same mistake: patterns of several are tried too,
    #: where it seems likely of one.
    suggests_patterns: bool = False
    #: Whether it may begin within a run, as a zero that is set anew does.
    may_begin_in_run: bool = False
    #: What of the arm is another one in its part; None for a fault of the log.
    arm_difference: ArmDifference | None = None

    @property
    def name(self) -> tuple[str, tuple[int, ...]]:
        """Kind and joints: the name of the fault that it corrects."""
        return self.kind, self.joints

    @property
    def in_words(self) -> str:
        """The hypothesis in a few words: the effect of the arm, or the kind of fault and
        its joints."""
        if self.effect or not self.joints:
            return self.effect or self.kind
        return f"{self.kind} of {formatting.joints([j + 1 for j in self.joints])}"

    @property
    def key(self) -> tuple[str, tuple[int, ...], Part | None]:
        """Kind, joints and part: hypotheses of one key differ in their size alone."""
        return self.kind, self.joints, self.part

    def at_size(self, base: LogTransform, size: float) -> LogTransform:
        """Return the transform of the hypothesis's rows at a size of its number; ``base``
        is that of all rows, which follows the transform of a part."""
        assert self.number is not None
        transform = self.number.at(self.transform, size)
        return transform if self.part is None else transform.followed_by(base)

    def applied_to(self, view: LogView, size: float | None = None) -> LogView:
        """Return a view with the hypothesis added.

        Parameters
        ----------
        size : float, optional
            Of its number; default: that of its transform.
        """
        if not self.is_friction_dissipative:
            return replace(view, is_friction_dissipative=False)
        if self.extra_torque is not None:
            return replace(view, extra_torques=(*view.extra_torques, self.extra_torque))
        transform = self.transform
        if size is not None and self.number is not None:
            transform = self.number.at(transform, size)
        if self.part is not None:
            return view.with_part(self.part, transform)
        return view.with_transform(transform)


def at_sizes(
    kind: str,
    log_prior: float,
    transform: LogTransform,
    number: Number,
    changes: Iterable[float] = (0.0,),
    may_begin_in_run: bool = False,
) -> Iterator[Hypothesis]:
    """Yield one hypothesis about a number of a transform for each change of its size: the
    sizes from which the race begins its search."""
    for change in changes:
        changed = transform
        if change:
            changed = number.at(transform, number.size_in(transform) + change)
        yield Hypothesis(
            kind,
            number.joints,
            log_prior,
            changed,
            number,
            may_begin_in_run=may_begin_in_run,
        )
