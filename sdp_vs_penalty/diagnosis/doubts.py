"""Reasons to doubt a finding: which there are, what each says, and what it leaves open."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from sdp_vs_penalty.records import JsonRecord


@dataclass(frozen=True)
class Reason:
    """What a reason to doubt a finding says, and what follows from it."""

    #: What is said of a weak finding.
    sentence: str
    #: What it leaves open. "name": the torque is there, and something else explains it as
    #: well. "size": how large it is. "torque": whether one is there, unless adding it helps
    #: on data left out. "cause": which of several effects makes how much of it.
    leaves_open: Literal["name", "size", "torque", "cause"]
    #: Whether a finding with it is not added.
    forbids_adding: bool = False
    #: Whether the effect is certain beside it, if all that fits as well are other formulas
    #: of the same effect.
    leaves_effect_certain: bool = False


#: The reasons by name; a finding with none is confident. Those from "small_here" on stand
#: in older files alone.
REASONS: Mapping[str, Reason] = {
    "rivals": Reason("another effect fits as well", "name", leaves_effect_certain=True),
    "uncertain": Reason(
        "its size is uncertain by > 20 %", "size", leaves_effect_certain=True
    ),
    "insignificant": Reason("its size is not told from zero", "size"),
    "small": Reason("its gain is small", "torque"),
    "not_held_out": Reason(
        "adding it lowers no joint's error on data left out by 1 %", "torque"
    ),
    "raises": Reason(
        "on data left out its joints' errors rise more than they fall with it", "torque"
    ),
    "alone": Reason(
        "beside what is added it does not clearly lower the error on data left out, or"
        " raises a joint's",
        "cause",
        forbids_adding=True,
    ),
    "sticks": Reason(
        "where the joints slide it has another size, or is not evident: friction that"
        " sticks at reversals looks so",
        "torque",
    ),
    "looks_like": Reason("another cause makes a similar torque", "torque"),
    "sharp": Reason("any sharp friction makes a similar torque", "cause"),
    "no_torque": Reason("its torque is not told from zero", "torque"),
    "stand_in": Reason(
        "its law may stand in for another one, which other motion follows", "torque"
    ),
    "few_splits": Reason(
        "fewer than two thirds of this run's splits show it",
        "cause",
        forbids_adding=True,
    ),
    "curve": Reason("a measured curve explains the joint better", "cause"),
    "explained": Reason("the check explains its torque as well", "name"),
    "log": Reason(
        "the log itself is likely wrong, which explains more: mend it first",
        "cause",
        forbids_adding=True,
    ),
    "at_end": Reason(
        "it lies at the end of the range in which it was looked for",
        "cause",
        forbids_adding=True,
    ),
    "small_here": Reason(
        "its gain is small here, though it lowers the error on data left out", "cause"
    ),
    "no_gain": Reason(
        "alone or beside the others it lowers no joint's error on data left out by 1 %",
        "cause",
        forbids_adding=True,
    ),
    "held": Reason(
        "its joint hardly moves: dry friction that does not slide holds any torque",
        "cause",
        forbids_adding=True,
    ),
    "series": Reason(
        "three or more of its kind on one joint may be one curve without a name",
        "cause",
    ),
    "more_left": Reason("more error is left on its joints than it explains", "cause"),
    "shared": Reason(
        "other findings share most of its torque: only their sum is known", "size"
    ),
    "implausible": Reason("its size is not plausible", "cause"),
}
#: A reason that another version of this program has given.
_UNKNOWN = Reason(
    "another version of this program doubted it", "cause", forbids_adding=True
)


@dataclass(frozen=True)
class Doubt(JsonRecord):
    """A reason to doubt a finding or a re-estimated constant."""

    #: Key of REASONS.
    reason: str
    #: What would look like the finding, in words, if the reason is "looks_like",
    #: "sharp" or "explained".
    cause: str = ""

    @property
    def meaning(self) -> Reason:
        """What its reason says of a finding; a file of another version may hold a reason
        that this one does not know."""
        return REASONS.get(self.reason, _UNKNOWN)

    @property
    def sentence(self) -> str:
        """What is said of it, such as "its gain is small"."""
        if self.cause:
            return self.cause
        unknown_name = f" ({self.reason!r})" if self.meaning is _UNKNOWN else ""
        return f"{self.meaning.sentence}{unknown_name}"

    @property
    def leaves_torque_open(self) -> bool:
        """Whether it leaves open that a torque is there."""
        return self.meaning.leaves_open == "torque"

    @property
    def forbids_adding(self) -> bool:
        """Whether a finding with it is not added: also where the reason is not known."""
        return self.meaning.forbids_adding
