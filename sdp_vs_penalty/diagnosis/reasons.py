"""Why a finding is weak: one list of named reasons, from which confidence follows, and the legend is
made."""

from __future__ import annotations

from collections.abc import Mapping

#: What is said of a weak finding, by the name of the reason; a finding with none is confident.
REASONS: Mapping[str, str] = {
    "rivals": "another effect fits as well",
    "uncertain": "its size is uncertain by > 20 %",
    "small": "its gain is small",
    "not_held_out": "no joint's held-out error falls by 1 %",
    "more_left": "more error is left on its joints than it explains",
    "shared": "other findings share most of its torque: only their sum is known",
    "absorbed": "the model's own parameters make nearly all of its torque",
    "implausible": "its size is not plausible",
    "looks_like": "something else looks so",
    "pieces": "it is a part of a function of the position that has no name",
    "curve": "a measured curve explains the joint better",
}


def legend() -> str:
    """What `weak` means, in one sentence."""
    return f"weak = at least one of: {'; '.join(REASONS.values())}"
