"""How sure an issue is, and why."""

from __future__ import annotations

from typing import Final

from sdp_vs_penalty.results.issue import Certainty

CERTAIN: Final = "certain"
LIKELY: Final = "likely"
POSSIBLE: Final = "possible"


def stated(why: str) -> Certainty:
    """Return how sure is what a file or this package itself states; why, in words."""
    return Certainty(CERTAIN, why)


def told_by(witness: str, second: str = "") -> Certainty:
    """Return how sure a fact is: certain where a second witness, independent of the values
    that the first judges, agrees with it (the file's words, another channel, the arm);
    else likely."""
    if second:
        return Certainty(CERTAIN, f"{witness}; {second}")
    return Certainty(LIKELY, witness)


def likely(why: str) -> Certainty:
    """Return that an issue is likely; why, in words."""
    return Certainty(LIKELY, why)


def possible(why: str) -> Certainty:
    """Return that an issue is possible; why, in words."""
    return Certainty(POSSIBLE, why)


#: How certain a fact is that stands in the file.
READ = stated("read from the file")
#: How certain a fault of the log is that an effect of the arm explains as well.
RIVAL_EFFECT = possible("an effect of the arm explains the same torques")
