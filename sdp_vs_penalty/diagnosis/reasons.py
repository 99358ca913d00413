"""Why a finding is weak: one list of named reasons, from which confidence follows, and the legend is
made."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from sdp_vs_penalty.diagnosis.constants import APART, FAR, INVISIBLE, SHARED, UNCERTAIN
from sdp_vs_penalty.diagnosis.held_out import lowers
from sdp_vs_penalty.effects.effect import Effect, Seen
from sdp_vs_penalty.robot.arrays import Array

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


@dataclass(frozen=True)
class Evidence:
    """What is known of a finding. size, std; J : score; rivals : whether there are any; before, after
    (n,) : held-out errors of the ladder's step, left (n,) : what remains beyond the noise at its end;
    joints : on which it acts; absorbed, shared : shares of its energy; torque : its RMS over its
    joint's, the largest; plausible : the sizes' ratio to what the effect says is plausible, the
    largest; pieces : whether it is one of several that make one function."""

    effect: Effect
    size: float
    std: float
    J: float
    rivals: bool
    before: Array
    after: Array
    left: Array
    joints: tuple[int, ...]
    absorbed: float
    shared: float
    torque: float
    plausible: float
    seen: Seen
    pieces: bool = False


def reasons(e: Evidence) -> dict[str, str]:
    """The reasons that hold, with what is said of each."""
    on = list(e.joints)
    explained = float(np.sum(np.maximum(e.before[on] ** 2 - e.after[on] ** 2, 0.0)))
    looks_like = e.effect.looks_like(e.size, e.seen)
    holds = {
        "rivals": e.rivals,
        "uncertain": not e.std < UNCERTAIN * abs(e.size),  # nothing is known of a size of zero
        "small": not e.J > 2.0 * APART,
        "not_held_out": not lowers(e.before[on], e.after[on]),
        "more_left": bool(explained < np.sum(e.left[on] ** 2)),
        "shared": e.shared > SHARED,
        "absorbed": e.absorbed > INVISIBLE,
        "implausible": e.torque > 1.0 or e.plausible > FAR,
        "looks_like": bool(looks_like),
        "pieces": e.pieces,
    }
    said = {**REASONS, "looks_like": looks_like}
    return {name: said[name] for name, true in holds.items() if true}


def legend() -> str:
    """What `weak` means, in one sentence."""
    return f"weak = at least one of: {'; '.join(REASONS.values())}"
