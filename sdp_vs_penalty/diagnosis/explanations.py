"""Sentences of physics, sizes and remarks of a diagnosis."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from sdp_vs_penalty import show
from sdp_vs_penalty.diagnosis.curves.curve import CURVE
from sdp_vs_penalty.diagnosis.findings import Finding
from sdp_vs_penalty.diagnosis.show import repeatability_warning
from sdp_vs_penalty.diagnosis.verdict import NOMINAL, Remainder
from sdp_vs_penalty.effects import effect_types
from sdp_vs_penalty.effects.effect import Effect
from sdp_vs_penalty.robot.arrays import Array

#: Below this share of all rows' error that of motion is told apart.
_MOSTLY = 0.5


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


def sentence(
    effect: Effect, size: float, std: float, rivals: Sequence[str], finer: Sequence[str] = ()
) -> str:
    """What was found, in one or two sentences."""
    unit = show.plain_unit(effect.parameters[effect.sized_by][0].unit)
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
    if finer:
        text += f" A finer form of the same law explains as much: {', '.join(finer)}."
    return text


def weaknesses(
    rivals: bool, uncertain: bool, small: bool, shared: bool, larger: str, looks_like: str
) -> tuple[str, ...]:
    """Why a finding is weak, a phrase each; nothing for a confident one. larger : the effect whose own
    error it may be, if there is one; looks_like : of the effect."""
    reasons = {
        "another effect fits as well": rivals,
        "its size is uncertain by > 20 %": uncertain,
        "its gain is small": small,
        "other findings share most of its torque: only their sum is known": shared,
        f"{larger} is so much larger that its own error may be this": bool(larger),
    }
    return (*(text for text, true in reasons.items() if true), *([looks_like] if looks_like else []))


def doubts(findings: Sequence[Finding]) -> dict[tuple[str, int], str]:
    """By effect and joint (from 1) what speaks against findings of one kind being physical causes at
    all."""
    found: dict[tuple[str, int], list[Mapping[str, float]]] = {}
    for f in findings:
        if f.joints:
            found.setdefault((f.effect, f.joints[0]), []).append(f.shape)
    said = [(key, effect_types()[key[0]].doubt(key[1], shapes)) for key, shapes in found.items()]
    return {key: text for key, text in said if text}


def doubtful(findings: Sequence[Finding], doubted: Mapping[tuple[str, int], str]) -> tuple[Finding, ...]:
    """The findings, weak where their kind is doubted on their joint: a curve would say the same."""
    return tuple(
        replace(
            f,
            confidence="weak",
            indistinguishable_from=tuple(dict.fromkeys((*f.indistinguishable_from, CURVE))),
            remarks=(*f.remarks, "one of several waves: together one unknown function of the position"),
        )
        if f.joints and (f.effect, f.joints[0]) in doubted
        else f
        for f in findings
    )


def standstill(moving: Array, every: Array) -> str:
    """One sentence where most of the error is of standstill, else nothing; (n,) RMSE while the joints
    move, and on all rows."""
    mostly = [int(j) + 1 for j in np.flatnonzero(moving < _MOSTLY * every)]
    if not mostly:
        return ""
    errors = ", ".join(f"{moving[j - 1]:.2g}" for j in mostly)
    return (
        f"Most of the held-out error of {show.joints(mostly)} is of standstill, where dry friction "
        f"holds any torque up to its own: in motion it is {errors} N m or N, and that is what judges."
    )


def negligible(left: Remainder) -> str:
    """One sentence where error surely repeats that hardly matters, else nothing."""
    if not left.remains or left.matters:
        return ""
    raised = 100.0 * left.raised.max(initial=0.0)
    return (
        f"What else repeats on {show.joints([j + 1 for j in left.joints])} hardly matters: while the "
        f"joint slides it raises the error by {raised:.2g} % above the noise at most, or is below "
        f"{100.0 * NOMINAL:g} % of the torque."
    )


def turning(left: Remainder) -> str:
    """One sentence where most of what is left is of slow joints, else nothing."""
    slow = np.flatnonzero((left.slow > left.floor) & (left.slow > 2.0 * left.beyond))
    if not len(slow):
        return ""
    errors = ", ".join(f"{left.slow[j]:.2g}" for j in slow)
    return (
        f"While {show.joints((slow + 1).tolist())} is slow, {errors} N m or N RMS are left beyond the "
        "noise: where dry friction turns round its laws hold only approximately."
    )


def remarks(
    noise_source: str, said: Sequence[str], held_out: str, new_share: float | None
) -> tuple[str, ...]:
    """Sentences about the diagnosis as a whole; said : of this one alone, empty ones are dropped."""
    out = []
    if noise_source == "residual":
        out.append(
            "No motion repeats, so noise and model error cannot be separated: the noise shown is the "
            "error itself. Record a run with more than one period."
        )
    out += [text for text in said if text]
    if warning := repeatability_warning(new_share):
        out.append(warning)
    if held_out == "folds":
        out.append(
            "Held-out errors come from outer folds: without each of them it is searched anew which of "
            "these findings are justified, with which shapes and sizes; one that a fold does not find "
            "keeps its error there. A test run (--test) shows each step."
        )
    return tuple(out)
