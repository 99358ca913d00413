"""What an offer does to the errors on data left out: bar, card, terminal and report read
it."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np

from sdp_vs_penalty import formatting
from sdp_vs_penalty.estimation.constants import CHANGES
from sdp_vs_penalty.robot.arrays import Array, nonzero_or_one


@dataclass(frozen=True)
class OfferOutcome:
    """The error of each joint on data left out, before and after a change of the model."""

    #: (n,) RMS errors without the change [N m or N].
    before: Array
    #: (n,) RMS errors with it [N m or N].
    after: Array
    #: (n,) noise floor [N m or N]; None where it is not known.
    floor: Array | None
    #: (n,) units of the errors, for people.
    units: Sequence[str]

    @property
    def rising(self) -> list[int]:
        """The joints (from 1) whose error rises by more than CHANGES, and beyond the
        noise."""
        least = np.zeros(len(self.before)) if self.floor is None else self.floor
        rises = (self.after > (1.0 + CHANGES) * self.before) & (self.after > least)
        return [int(j) + 1 for j in np.flatnonzero(rises)]

    def falls(self, joint: int) -> bool:
        """Whether the error of a joint (from 1) falls by more than CHANGES."""
        was, now = self.before[joint - 1], self.after[joint - 1]
        return bool(now < (1.0 - CHANGES) * was)

    @property
    def errs_most(self) -> int:
        """The joint (from 1) that errs most before, in multiples of its noise where that is
        known."""
        scale = np.ones(len(self.before)) if self.floor is None else self.floor
        return int(np.argmax(self.before / nonzero_or_one(scale))) + 1

    @property
    def gains_most(self) -> int:
        """The joint (from 1) whose error falls most, in multiples of its noise, or as a share
        where that is not known."""
        scale = self.before if self.floor is None else self.floor
        return int(np.argmax((self.before - self.after) / nonzero_or_one(scale))) + 1

    @property
    def left(self) -> Array:
        """(n,) the errors that it leaves [N m or N]; what is below the noise counts as the
        noise."""
        return self.after if self.floor is None else np.maximum(self.after, self.floor)

    @property
    def size(self) -> float:
        """One number for all joints, by which outcomes are ordered: the mean logarithm of
        what is left."""
        return float(np.mean(np.log(nonzero_or_one(self.left))))

    def does_as_much_as(self, other: OfferOutcome) -> bool:
        """Whether no joint's error is larger than with another change by more than
        CHANGES."""
        return bool(np.all(self.left <= (1.0 + CHANGES) * other.left))

    def change_of(self, joint: int) -> str:
        """Say how the error of a joint (from 1) changes: "2.63 → 1.19 N m (-55 %)"."""
        errors = [float(x[joint - 1]) for x in (self.before, self.after)]
        amounts = formatting.amounts(errors, self.units[joint - 1])
        return f"{amounts} ({formatting.change_of(*errors)})"

    def losses(self, besides: Collection[int] = ()) -> list[str]:
        """Say of each joint that errs more by how much, but for ``besides`` (from 1)."""
        joints = [joint for joint in self.rising if joint not in besides]
        return [f"joint {joint} errs more: {self.change_of(joint)}" for joint in joints]

    def share_of(self, joint: int) -> str:
        """Say by how much the error of a joint (from 1) changes: "joint 3's +7 %"."""
        errors = (float(x[joint - 1]) for x in (self.before, self.after))
        return f"joint {joint}'s {formatting.change_of(*errors)}"

    def shown(self, worst: int) -> int:
        """The joint (from 1) by which it is said: the one that errs most, ``worst``, or where
        that does not gain the one that gains most."""
        return worst if self.falls(worst) else self.gains_most

    def in_brief(self, worst: int) -> str:
        """Say by how much the error changes of the joint that :meth:`in_words` shows, and of
        those that err more."""
        rising = [self.share_of(joint) for joint in self.rising]
        return ", ".join(dict.fromkeys([self.share_of(self.shown(worst)), *rising]))

    def in_words(self, worst: int) -> str:
        """Say how the error changes of the joint that errs most, ``worst`` (from 1), or where
        that does not gain of the one that gains most, and which joints err more."""
        most = self.shown(worst)
        rising = {*self.rising}
        if self.falls(most):
            texts = [f"joint {most}'s error: {self.change_of(most)}"]
        elif worst in rising:
            texts = [f"joint {worst} errs more: {self.change_of(worst)}"]
        else:
            texts = [f"joint {worst} does not gain: {self.change_of(worst)}"]
        if self.floor is not None and self.before[worst - 1] < self.floor[worst - 1]:
            texts.append("that cannot be told from the noise")
        elif self.falls(most) and worst not in {most, *rising}:
            texts.append(f"joint {worst}, which errs most, does not gain")
        texts += self.losses({most} if self.falls(most) else {most, worst})
        if self.falls(most) and not self.rising and len(self.before) > 1:
            texts.append(f"no joint errs more{self._limit_of_rises}")
        return "; ".join(texts)

    @property
    def _limit_of_rises(self) -> str:
        """The limit within which the errors rise where none is among :attr:`rising`, as the
        end of a sentence; "" where none rises at all."""
        if np.all(self.after <= self.before):
            return ""
        is_small = bool(np.all(self.after <= (1.0 + CHANGES) * self.before))
        return (
            f" by more than {CHANGES:.0%}".replace("%", " %")
            if is_small
            else (" beyond its noise")
        )
