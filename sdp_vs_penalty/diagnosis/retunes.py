"""Findings of kind "retune": a shape constant of an effect that the model has is another one."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Self

import numpy as np

from sdp_vs_penalty.diagnosis.constants import APART, FAR
from sdp_vs_penalty.diagnosis.score import Term
from sdp_vs_penalty.diagnosis.sizes import Size
from sdp_vs_penalty.effects import effect_types
from sdp_vs_penalty.estimation.constants import CHANGES
from sdp_vs_penalty.estimation.estimate import Estimate
from sdp_vs_penalty.estimation.shapes import ShapeEstimate, at_end
from sdp_vs_penalty.files.plain import Plain
from sdp_vs_penalty.formatting import plain_unit
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.robot import Robot


@dataclass(frozen=True)
class Retune(Plain):
    """A shape constant of the model's own effect on one joint, as it explains most beside the findings.

    rmse_before, rmse_after : held-out error of the joint, with the model's constants and with the new
    ones; remarks : why it is weak, if it is.
    """

    estimate: ShapeEstimate
    confidence: str
    rmse_before: float
    rmse_after: float
    explanation: str
    remarks: tuple[str, ...] = ()

    @property
    def effect(self) -> str:
        """The name of the effect."""
        return self.estimate.effect

    @property
    def joint(self) -> int:
        """From 1."""
        return self.estimate.joint + 1

    @property
    def joints(self) -> tuple[int, ...]:
        """Its one joint, as a finding has them."""
        return (self.joint,)

    @property
    def text(self) -> str:
        """How :func:`~sdp_vs_penalty.diagnosis.add` takes it."""
        s = self.estimate
        return f"{s.effect}:{self.joint}@{s.shape}={s.after:.6g}"

    def to_dict(self) -> dict[str, Any]:
        """std is null where the data bound the constant on one side only."""
        own = super().to_dict()
        return {**own.pop("estimate"), **own, "kind": "retune", "text": self.text}

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Self:
        """What :meth:`to_dict` wrote."""
        return super().from_dict({**data, "estimate": {"at_end": False, **data}})


def shape_estimate(term: Term, estimate: Estimate, size: Size) -> ShapeEstimate:
    """A nuisance of the search as an estimate of the model's shape constant."""
    effect, name, (joint,) = term.form.effect, term.form.moves, term.form.effect.joints
    now = next(e for e in estimate.model.effects if e.name == effect.name and joint in e.joints)
    after = float(f"{effect.shape[name]:.6g}")
    shape = effect.shapes[name].on(estimate.robot.joints[joint].kind)
    bounds = shape.bounds or (1e-9, 1e9)
    ends = at_end(*map(math.log, (after, bounds[0], shape.earned or bounds[1])))
    std = after * size.constants.get(name, np.inf)
    return ShapeEstimate(effect.name, joint, name, now.shape[name], after, std, term.J, ends)


def told(s: ShapeEstimate, before: Array, after: Array) -> bool:
    """Whether the data tell a constant from the model's, and its joint's held-out error falls."""
    spread = s.std / s.after if np.isfinite(s.std) else 0.0
    moves = abs(np.log(s.after / s.before)) >= max(FAR * spread, CHANGES)
    return bool(moves and s.gain > APART and after[s.joint] < before[s.joint])


def retunes(
    found: Sequence[ShapeEstimate], robot: Robot, before: Array, after: Array
) -> tuple[Retune, ...]:
    """before, after (n,) : held-out errors with the model's own constants, and with the new ones."""
    out = []
    for s in (s for s in found if told(s, before, after)):
        shape, kind = effect_types()[s.effect].shapes[s.shape], robot.joints[s.joint].kind
        values = [shape.said(v, kind) for v in (s.after, s.before)]
        unit = plain_unit(robot.torque_units[s.joint])
        verb = effect_types()[s.effect].turns or f"{s.effect} has {s.shape} ="
        errors = float(before[s.joint]), float(after[s.joint])
        said = f"joint {s.joint + 1}: {verb} {values[0]}, not {values[1]}"
        said += f"; held-out error {errors[0]:.3g} to {errors[1]:.3g} {unit}"
        remarks = []
        if s.at_end:
            remarks.append("it lies at the end of the range in which it was looked for")
        if s.gain <= 2.0 * APART:
            remarks.append("its gain is small")
        out.append(Retune(s, "weak" if remarks else "confident", *errors, said, tuple(remarks)))
    return tuple(out)
