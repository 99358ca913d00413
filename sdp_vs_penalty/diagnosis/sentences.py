"""Sentences of a diagnosis: what was found, why it is weak, and what is said of the whole."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from sdp_vs_penalty import formatting
from sdp_vs_penalty.diagnosis.remaining import Remainder
from sdp_vs_penalty.diagnosis.show import repeatability_warning
from sdp_vs_penalty.diagnosis.whitening import WhiteData
from sdp_vs_penalty.effects.effect import Effect
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.signals.noise import REPETITION, RESIDUAL, SPECTRUM_KNOWN
from sdp_vs_penalty.signals.standstill import STILL

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
    "not_alone": "beside the confident findings alone it raises a joint's held-out error by 10 %",
}


def size_of(effect: Effect, beta: Array, covariance: Array) -> tuple[float, float]:
    """One number for the size of an effect, and its standard deviation.

    The parameter that the effect is sized by, with its sign; the norm where it is several.
    """
    b, c = beta[effect.sized_by], covariance[effect.sized_by, effect.sized_by]
    if len(b) == 1:
        return float(b[0]), float(max(c[0, 0], 0.0) ** 0.5)
    size = float(np.linalg.norm(b))
    if size == 0.0:
        return 0.0, float(np.sqrt(np.trace(c)))
    direction = b / size
    return size, float(max(float(direction @ c @ direction), 0.0) ** 0.5)


def sentence(effect: Effect, size: float, std: float, rivals: Sequence[str]) -> str:
    """What was found, in one or two sentences."""
    unit = formatting.plain_unit(effect.parameters[effect.sized_by][0].unit)
    where = (
        "the whole robot"
        if effect.whole_robot
        else "joint " + "+".join(str(j + 1) for j in effect.joints)
    )
    amount = f"{size:.4g} ± {std:.1g} {unit}".rstrip()
    head = f"{effect.name} on {where}: {amount}"
    head += f" ({effect.constants})" if effect.constants else ""
    text = f"{head}. {effect.explanation} {effect.remark(size)}".rstrip()
    if rivals:
        text += f" Indistinguishable in these data from {', '.join(rivals)}."
    return text


def remarks(
    data: WhiteData, left: Remainder, residual: Array, held_out: str, new_share: float | None
) -> tuple[str, ...]:
    """Sentences about the diagnosis as a whole."""
    found = [_noise(data.noise.source), _standstill(data, residual)]
    if data.noise.source == REPETITION:
        found.append(_turning(left))
    found.append(repeatability_warning(new_share) or "")
    if held_out == "folds":
        found.append(
            "Held-out errors come from folds by the phase of the motion: sizes from the other folds, "
            "the choice of effects and constants from all rows. A test run (--test) judges both."
        )
    return tuple(text for text in found if text)


def _noise(source: str) -> str:
    if source == REPETITION:
        return ""
    if source == RESIDUAL:
        return (
            "No motion repeats and the log shows no steady noise above the motion's band (too slow, "
            "smoothed before it was logged, or louder in motion), so noise and model error cannot be "
            "separated: the noise shown is the error itself. Record a run with more than one period."
        )
    return (
        f"No motion repeats: the noise is that of the torque's spectrum above the motion's band, "
        f"{SPECTRUM_KNOWN}. Record a run with more than one period to know it better."
    )


def _standstill(data: WhiteData, residual: Array) -> str:
    """Where most of what is left (M, n) is of standstill."""
    keep, moves = data.rows.keep, data.rows.keep & (data.rows.still <= STILL)
    every, moving = (np.sum(residual**2 * x, axis=0) for x in (keep, moves))
    mostly = [int(j) + 1 for j in np.flatnonzero(every > 2.0 * moving)]
    if not mostly:
        return ""
    moving = np.sqrt(moving / np.maximum(moves.sum(axis=0), 1))
    said = ", ".join(f"{moving[j - 1]:.2g}" for j in mostly)
    return (
        f"Most of the error that is left on {formatting.joints(mostly)} is of standstill, where dry "
        f"friction holds any torque up to its own: in motion it is {said} N m or N."
    )


def _turning(left: Remainder) -> str:
    """Where most of what is left is of slow joints."""
    slow = np.flatnonzero((left.slow > left.floor) & (left.slow > 2.0 * left.beyond))
    if not len(slow):
        return ""
    errors = ", ".join(f"{left.slow[j]:.2g}" for j in slow)
    return (
        f"At low speed of {formatting.joints((slow + 1).tolist())}, {errors} N m or N RMS are left "
        "beyond the noise: near reversals friction models are least accurate."
    )


def legend() -> str:
    """What `weak` means, in one sentence."""
    return f"weak = at least one of: {'; '.join(REASONS.values())}"
