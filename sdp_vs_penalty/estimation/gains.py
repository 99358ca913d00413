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
        """Half-width of the 95 % interval in words.

        "given" for an exact value; "not determined" if the interval contains zero,
        since then no motion of the log shows the gain.
        """
        if self.half_width is None:
            return "given"
        if not self.half_width < abs(self.value):
            return "not determined"
        return f"{self.half_width:.2g}"


def channel_gains(estimate: Estimate) -> list[Gain]:
    """Return the gains of the torque channels (reading over true torque).

    Parameters
    ----------
    estimate : Estimate
        Estimate from runs with torque.

    Returns
    -------
    list of Gain
        One a joint; empty if no known load determined them.
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
    """Return the gains of servo loops that were fitted to a logged torque.

    Parameters
    ----------
    estimate : Estimate
        Estimate from runs with torque and commands.

    Returns
    -------
    list of Gain
        In the order of the model's drives; empty without servo effects.
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
    """Yield the gain of each servo loop with its 95 % interval.

    In these estimates the servo's control law (torque = gain times control error)
    replaces a torque sensor. Then all parameters are known up to one common scale,
    which the user fixes by one given gain (a member of ``model.known``) with a
    relative standard deviation ``scale_error`` (0: the user calls it exact).

    Interval's half-width: 1.96 std for an estimated gain; 1.96 scale_error |value| for
    the given gain; None for the given gain if it is exact.

    Parameters
    ----------
    estimate : Estimate
        Estimate from runs without torque.

    Returns
    -------
    iterator of Gain
        One entry a servo gain, in the order of the model's parameters.
    """
    model = estimate.model
    scale_error = estimate.details["servo"].get("scale_error", 0.0)
    parameters = zip(
        model.parameters,
        estimate.theta,
        estimate.uncertainty.std,
        model.drives,
        strict=True,
    )
    for parameter, value, std, is_servo_gain in parameters:
        if not is_servo_gain:
            continue
        half_width: float | None = NORMAL_95 * float(std)
        if parameter.name in model.known:
            half_width = NORMAL_95 * scale_error * float(value) if scale_error else None
        yield Gain(parameter.name, float(value), half_width, parameter.unit)
