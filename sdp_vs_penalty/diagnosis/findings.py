"""What a diagnosis says: findings, verdict, and the JSON of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.diagnosis.events import Event
from sdp_vs_penalty.diagnosis.show import diagnosis_verdict, plot_ladder
from sdp_vs_penalty.show import Shown, Summary, Table

Array = NDArray[np.float64]

EFFECT_MISSING, NOTHING_MISSING, UNKNOWN = "effect_missing", "nothing_missing", "unknown_effect"


@dataclass(frozen=True)
class Finding:
    """One missing effect.

    joints from 1, empty for the whole robot; size : of the effect's parameter (the amplitude where
    there are several) in ``unit``, with its standard deviation; parameters : all of them by name;
    held_out_rmse_before, _after (n,) : cumulative along the ladder; text : how to write the effect.
    """

    effect: str
    joints: tuple[int, ...]
    shape: Mapping[str, float]
    size: float
    unit: str
    std: float
    parameters: Mapping[str, float]
    confidence: str
    indistinguishable_from: tuple[str, ...]
    held_out_rmse_before: Array
    held_out_rmse_after: Array
    explanation: str
    text: str
    gain: float

    def to_dict(self) -> dict[str, Any]:
        return {
            "effect": self.effect,
            "joints": list(self.joints),
            "shape": dict(self.shape),
            "size": self.size,
            "unit": self.unit,
            "confidence": self.confidence,
            "indistinguishable_from": list(self.indistinguishable_from),
            "held_out_rmse_before": self.held_out_rmse_before.tolist(),
            "held_out_rmse_after": self.held_out_rmse_after.tolist(),
            "explanation": self.explanation,
        }


@dataclass(frozen=True)
class Invisible:
    """An effect whose torque the model's own parameters absorb: no measurement like this shows it."""

    effect: str
    joints: tuple[int, ...]
    absorbed_share: float

    def to_dict(self) -> dict[str, Any]:
        return {
            "effect": self.effect,
            "joints": list(self.joints),
            "absorbed_share": self.absorbed_share,
        }


@dataclass(frozen=True, repr=False)
class Diagnosis(Shown):
    """verdict : "effect_missing", "nothing_missing" or "unknown_effect"; effects in the order of
    adding; noise_floor (n,) of the filtered torque; events : what happened once.

    noise_source : "repetition", or "residual" where nothing repeats and abstention is weaker;
    unexplained (n,) : repeatable error left, as a share of the noise's variance; remarks : sentences.
    """

    verdict: str
    effects: tuple[Finding, ...]
    noise_floor: Array
    invisible: tuple[Invisible, ...]
    events: tuple[Event, ...]
    noise_source: str
    unexplained: Array
    held_out_rmse: Array
    band_hz: float
    remarks: tuple[str, ...] = ()

    @property
    def headline(self) -> str:
        """What is missing, in one sentence."""
        found = [(f.effect, f.joints, f.confidence) for f in self.effects]
        return diagnosis_verdict(self.verdict == UNKNOWN, found, self.noise_source == "repetition")

    def plot(self, axes: Any = None) -> Any:
        """Draw the held-out error over the noise floor as the effects are added; returns the axes.

        Raises InputError without matplotlib (extra [plot]).
        """
        steps = ["the model", *(f"+ {f.text.partition('@')[0]}" for f in self.effects)]
        errors = [f.held_out_rmse_before for f in self.effects] + [self.held_out_rmse]
        return plot_ladder(axes, steps, np.array(errors), self.noise_floor)

    def _summary(self) -> Summary:
        before = self.effects[0].held_out_rmse_before if self.effects else self.held_out_rmse
        rows = [("held-out RMSE", ", ".join(f"{x:.3g}" for x in before))]
        if self.effects:
            rows.append(("with the findings", ", ".join(f"{x:.3g}" for x in self.held_out_rmse)))
        name = "noise floor" if self.noise_source == "repetition" else "noise (estimated)"
        return self.headline, [*rows, (name, ", ".join(f"{x:.3g}" for x in self.noise_floor))]

    def _table(self) -> Table:
        rows = [
            (
                f.text,
                f"{f.size:.3g} ± {f.std:.1g} {f.unit}",
                f.confidence,
                ", ".join(f.indistinguishable_from),
            )
            for f in self.effects
        ]
        return ("effect", "size", "confidence", "indistinguishable from"), rows

    def to_dict(self) -> dict[str, Any]:
        """findings.json."""
        return {
            "verdict": self.verdict,
            "effects": [f.to_dict() for f in self.effects],
            "noise_floor": self.noise_floor.tolist(),
            "invisible": [i.to_dict() for i in self.invisible],
            "events": [e.to_dict() for e in self.events],
        }
