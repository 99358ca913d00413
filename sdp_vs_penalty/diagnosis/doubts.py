"""Reasons to doubt a finding: which there are, what each says, and what it leaves open."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from sdp_vs_penalty.records import JsonRecord

#: What is said of a weak finding, by the name of the reason; a finding with none is
#: confident. Those from "small_here" on stand in older files alone.
REASONS: Mapping[str, str] = {
    "rivals": "another effect fits as well",
    "uncertain": "its size is uncertain by > 20 %",
    "insignificant": "its size is not told from zero",
    "small": "its gain is small",
    "not_held_out": "adding it lowers no joint's error on data left out by 1 %",
    "raises": "on data left out its joints' errors rise more than they fall with it",
    "alone": "beside what is added it does not clearly lower the error on data left out, or"
    " raises a joint's",
    "sticks": "where the joints slide it has another size, or is not evident: friction"
    " that sticks at reversals looks so",
    "looks_like": "another cause makes a similar torque",
    "sharp": "any sharp friction makes a similar torque",
    "no_torque": "its torque is not told from zero",
    "stand_in": "its law may stand in for another one, which other motion follows",
    "few_splits": "fewer than two thirds of this run's splits show it",
    "curve": "a measured curve explains the joint better",
    "explained": "the check explains its torque as well",
    "log": "the log itself is likely wrong, which explains more: mend it first",
    "at_end": "it lies at the end of the range in which it was looked for",
    "small_here": "its gain is small here, though it lowers the error on data left out",
    "no_gain": "alone or beside the others it lowers no joint's error on data left out by"
    " 1 %",
    "held": "its joint hardly moves: dry friction that does not slide holds any torque",
    "series": "three or more of its kind on one joint may be one curve without a name",
    "more_left": "more error is left on its joints than it explains",
    "shared": "other findings share most of its torque: only their sum is known",
    "implausible": "its size is not plausible",
}

#: Reasons of which each says that something else explains the torque as well: it is
#: there, and its name alone is open.
NAME_IS_OPEN = {"rivals", "explained"}

#: Reasons of which each says that the size of a torque is open.
SIZE_IS_OPEN = {"uncertain", "insignificant", "shared"}

#: Reasons for which a finding is not added.
NOT_ADDED = {"alone", "no_gain", "few_splits", "held", "log", "at_end"}

#: Reasons that leave open whether a torque is there, unless adding it helps on data left
#: out. All others leave open which of several effects makes how much of it.
TORQUE_IS_OPEN = {
    "small",
    "not_held_out",
    "raises",
    "sticks",
    "looks_like",
    "no_torque",
    "stand_in",
}


@dataclass(frozen=True)
class Doubt(JsonRecord):
    """A reason to doubt a finding or a re-estimated constant."""

    #: Key of REASONS.
    reason: str
    #: What would look like the finding, in words, if the reason is "looks_like",
    #: "sharp" or "explained".
    cause: str = ""

    @property
    def sentence(self) -> str:
        """What is said of it, such as "its gain is small"; a file of another version may
        hold a reason that this one does not know."""
        unknown = f"another version of this program doubted it ({self.reason!r})"
        return self.cause or REASONS.get(self.reason, unknown)

    @property
    def leaves_torque_open(self) -> bool:
        """Whether it leaves open that a torque is there."""
        return self.reason in TORQUE_IS_OPEN

    @property
    def forbids_adding(self) -> bool:
        """Whether a finding with it is not added: also where the reason is not known."""
        return self.reason in NOT_ADDED or self.reason not in REASONS
