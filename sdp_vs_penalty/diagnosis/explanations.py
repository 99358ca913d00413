"""Sentences of physics, sizes and remarks of a diagnosis."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.diagnosis.findings import Finding
from sdp_vs_penalty.effects.effect import Effect

Array = NDArray[np.float64]


def size_of(effect: Effect, beta: Array, covariance: Array) -> tuple[float, float]:
    """One number for the size of an effect, and its standard deviation.

    The parameter itself; the amplitude of a ripple and of a tilt; the force of a wrench; the mass
    of a payload.
    """
    if len(beta) == 1 or effect.name == "payload":
        return float(beta[0]), float(max(covariance[0, 0], 0.0) ** 0.5)
    part = slice(0, 3) if effect.name == "external_wrench" else slice(0, len(beta))
    b, c = beta[part], covariance[part, part]
    size = float(np.linalg.norm(b))
    if size == 0.0:
        return 0.0, float(np.sqrt(np.trace(c)))
    direction = b / size
    return size, float(max(float(direction @ c @ direction), 0.0) ** 0.5)


def sentence(effect: Effect, size: float, std: float, rivals: Sequence[str]) -> str:
    """What was found, in one or two sentences."""
    unit = effect.parameters[0].unit
    where = (
        "the whole robot"
        if effect.whole_robot
        else "joint " + "+".join(str(j + 1) for j in effect.joints)
    )
    amount = f"{size:.4g} ± {std:.1g}" + ("" if unit == "-" else f" {unit}")
    constants = ", ".join(
        f"{key} = {value:.4g}" for key, value in effect.shape.items() if key not in ("t0", "v_s")
    )
    head = f"{effect.name} on {where}: {amount}" + (f" ({constants})" if constants else "")
    text = f"{head}. {effect.explanation}"
    if effect.name == "base_tilt":
        text += f" Here: {np.degrees(size / 9.81):.2g} degrees."
    if rivals:
        text += f" Indistinguishable in these data from {', '.join(rivals)}."
    return text


def unrelated_ripples(findings: Sequence[Finding]) -> tuple[int, ...]:
    """Joints (from 1) on which ripples were found whose orders are no multiples of the lowest, or three
    and more: that is an unknown function of the position, written as a sum of waves."""
    orders: dict[int, list[float]] = {}
    for f in findings:
        if f.effect == "torque_ripple":
            orders.setdefault(f.joints[0], []).append(f.shape["k"])
    out = []
    for joint, found in orders.items():
        lowest = min(found)
        unrelated = [k for k in found if abs(k / lowest - round(k / lowest)) > 0.02]
        if len(found) >= 3 or unrelated:
            out.append(joint)
    return tuple(out)


def remarks(noise_source: str, unknown_functions: Sequence[int], held_out: str) -> tuple[str, ...]:
    """Sentences about the diagnosis as a whole."""
    out = []
    if noise_source == "residual":
        out.append(
            'No motion repeats, so noise and model error cannot be separated; "nothing missing" '
            "is weaker evidence. Record a run with more than one period."
        )
    for joint in unknown_functions:
        out.append(
            f"Several unrelated ripples on joint {joint}: read them as one unknown function of its "
            "position, not as ripples."
        )
    if held_out == "folds":
        out.append(
            "Held-out errors come from outer folds: the search was repeated without each of them; "
            "steps a fold did not reach repeat its last error. A test run (--test) shows each step."
        )
    return tuple(out)
