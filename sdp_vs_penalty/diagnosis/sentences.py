"""Sentences and pictures of comparisons and diagnoses; plain values in, no models."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from sdp_vs_penalty import formatting
from sdp_vs_penalty.effects.effect import Effect
from sdp_vs_penalty.estimation.verdict import MOSTLY_NEW
from sdp_vs_penalty.robot.arrays import Array

#: What is said where no motion repeats: the residual was taken for noise, which it then equals.
NOISE_UNKNOWN = "is not known: no motion repeats, so noise and model error cannot be separated."
#: What is said of a weak finding, by the name of the reason; a finding with none is confident.
REASONS: Mapping[str, str] = {
    "rivals": "another effect fits as well",
    "uncertain": "its size is uncertain by > 20 %",
    "small": "its gain is small",
    "not_held_out": "no joint's held-out error falls by 1 %",
    "more_left": "more error is left on its joints than it explains",
    "shared": "other findings share most of its torque: only their sum is known",
    "implausible": "its size is not plausible",
    "looks_like": "something else looks so",
    "curve": "a measured curve explains the joint better",
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


def repeatability_warning(new_share: float | None) -> str | None:
    """One sentence where most of the judged motion is the training motion again, else None."""
    if new_share is None or new_share >= MOSTLY_NEW:
        return None
    percent = f"{100.0 * new_share:.0f}"
    return (
        f"{'None' if percent == '0' else f'Only {percent} %'} of the judged motion is new to the model: "
        "these errors show repeatability; judge on another motion to see how it generalises."
    )


def new_motion(new_share: float | None) -> str:
    """The share of the judged motion that the model has not been trained on, as text."""
    return "not recorded" if new_share is None else f"{100.0 * new_share:.0f} %"


def event_lines(events: Sequence[Any], every: bool = False, most: int = 3) -> list[str]:
    """A line an event; one for all of them where they are more than ``most``, unless ``every``.

    events : with ``joint`` (from 1), ``t_start``, ``t_end`` [s] and ``frequency`` [Hz] or None.
    """
    if len(events) > most and not every:
        where = formatting.joints(sorted({e.joint for e in events}))
        hums = sum(e.frequency is not None for e in events)
        hum = f", {hums} of them a hum" if hums else ""
        first, last = min(e.t_start for e in events), max(e.t_end for e in events)
        return [f"{len(events)} events on {where}, {first:.2f} s to {last:.2f} s{hum}"]
    kinds = (
        "one-off event" if e.frequency is None else f"a hum of {e.frequency:.3g} Hz" for e in events
    )
    return [
        f"{kind} on joint {e.joint}: {e.t_start:.2f} s to {e.t_end:.2f} s"
        for kind, e in zip(kinds, events, strict=True)
    ]


def plot_errors(axes: Any, errors: Mapping[str, Array], floor: Array | None) -> Any:
    """RMSE of each joint as bars, models side by side, with the noise floor as steps."""
    axes = formatting.axes(axes)
    width = 0.8 / len(errors)
    for k, (name, rmse) in enumerate(errors.items()):
        x = np.arange(1, len(rmse) + 1) + (k - 0.5 * (len(errors) - 1)) * width
        axes.bar(x, rmse, width, label=name)
    if floor is not None:
        axes.step(np.arange(1, len(floor) + 1), floor, where="mid", color="black", label="noise floor")
    axes.set(xlabel="joint", ylabel="RMSE [N m or N]")
    axes.legend()
    return axes
