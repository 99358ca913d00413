"""Gains of channels, drives and loops as a model has them, with 95 % intervals."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from sdp_vs_penalty.estimation.constants import NORMAL_95
from sdp_vs_penalty.estimation.estimate import Estimate


@dataclass(frozen=True)
class Gain:
    """value ± half_width (95 %) in ``unit``; half_width is None where the value was
    given as exact, and infinite where the data do not determine it."""

    name: str
    value: float
    half_width: float | None
    unit: str

    @property
    def spread(self) -> str:
        """Half the 95 % interval in words. Where it holds zero, no motion of this log
        shows the gain."""
        if self.half_width is None:
            return "given"
        if not self.half_width < abs(self.value):
            return "not determined"
        return f"{self.half_width:.2g}"


def channel_gains(estimate: Estimate) -> list[Gain]:
    """What the torque channels read over the true torque, where a known load told it.

    Parameters
    ----------
    estimate : Estimate
        From runs with torque.

    Returns
    -------
    list of Gain
        One a joint; none without a known load.
    """
    gains = estimate.details.get("gains")
    if not gains:
        return []
    pairs = zip(gains["gain"], gains["std"], strict=True)
    return [
        Gain(f"joint {j}", gain, NORMAL_95 * std, "")
        for j, (gain, std) in enumerate(pairs, start=1)
    ]


def loop_gains(estimate: Estimate) -> list[Gain]:
    """Of the servos' loops beside a logged torque.

    Parameters
    ----------
    estimate : Estimate
        From runs with torque and commands.

    Returns
    -------
    list of Gain
        In the order of the model's drives.
    """
    loop = estimate.details.get("loop") or {"gains": {}}
    return [
        Gain(
            name,
            gain["value"],
            NORMAL_95 * gain["std"],
            gain["unit"],
        )
        for name, gain in loop["gains"].items()
    ]


def drive_gains(estimate: Estimate) -> Iterator[Gain]:
    """Of the servos that stand for a torque.

    The gain that sets the scale is as uncertain as what set it.

    Parameters
    ----------
    estimate : Estimate
        From runs without torque.

    Returns
    -------
    iterator of Gain
        One a servo's gain.
    """
    model = estimate.model
    scale_error = estimate.details["servo"].get("scale_error", 0.0)
    columns = zip(
        model.parameters,
        estimate.theta,
        estimate.uncertainty.std,
        model.drives,
        strict=True,
    )
    for parameter, value, std, is_drive in columns:
        if not is_drive:
            continue
        half: float | None = NORMAL_95 * float(std)
        if parameter.name in model.known:
            half = NORMAL_95 * scale_error * float(value) if scale_error else None
        yield Gain(parameter.name, float(value), half, parameter.unit)
