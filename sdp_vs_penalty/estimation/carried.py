"""What a model says of the load that the arm carries, and which of its bodies no material
could make."""

from __future__ import annotations

import numpy as np

from sdp_vs_penalty import formatting
from sdp_vs_penalty.estimation.constants import NORMAL_95
from sdp_vs_penalty.estimation.estimate import Estimate
from sdp_vs_penalty.robot import inertia
from sdp_vs_penalty.robot.arrays import Array


def payload_parameters(estimate: Estimate) -> tuple[int, Array] | None:
    """Return the index of a payload's mass in theta, and its (10,) standard parameters
    about the last link's frame [kg, kg m, kg m^2]; None for a model without one."""
    for effect, indices in estimate.model.parts:
        if effect.simulator_field == "payload":
            return int(indices[0]), estimate.theta[indices]
    return None


def payload_in_words(estimate: Estimate) -> str:
    """Say the mass of a model's payload, with its interval, and where it is.

    Returns
    -------
    str
        The sentence; "" for a model without a payload.
    """
    found = payload_parameters(estimate)
    if found is None:
        return ""
    index, theta = found
    mass = f"payload: {estimate.value_text(index)}"
    if not theta[0] > 0.0:
        return mass
    centre = ", ".join(formatting.number(x) for x in theta[1:4] / theta[0])
    return f"{mass}, centre of mass at {centre} m in the last link's frame"


def doubts_of_payload(estimate: Estimate) -> list[str]:
    """Say why the mass of a payload is none, a sentence each: the data do not determine
    it, or its 95 % interval holds zero.

    Its inertia is another matter (:func:`doubts_of_bodies`): a mass is as good without.

    Returns
    -------
    list of str
        The sentences; none for a model without a payload.
    """
    found = payload_parameters(estimate)
    if found is None:
        return []
    index, theta = found
    mass = f"{formatting.number(theta[0])} kg"
    half_width = NORMAL_95 * estimate.uncertainty.std[index]
    if estimate.sources[index] != "data":
        return [
            f"payload: these data do not determine its mass of {mass}: move the joints"
            " that carry it against gravity"
        ]
    if half_width >= theta[0]:
        return [
            f"payload: its mass of {mass} may be zero (± {half_width:.2g} kg): measure"
            " with the load on"
        ]
    return []


def doubts_of_bodies(estimate: Estimate) -> list[str]:
    """Say why links or a payload should not be used as they are, a sentence each.

    A body that would have to be denser than any material is one whose inertia the torque
    does not show: it is consistent, and thinner than it can be.

    Returns
    -------
    list of str
        The sentences, none for bodies that can be made.
    """
    doubts = doubts_of_payload(estimate)
    if found := payload_parameters(estimate):
        doubts += _doubt_of_density("payload", found[1])
    for number, theta in enumerate(estimate.links, start=1):
        doubts += _doubt_of_density(f"link {number}", theta)
    return doubts


def _doubt_of_density(name: str, theta: Array) -> list[str]:
    """Say that no material is as dense as a body (10,) needs; none where one is."""
    density = float(inertia.least_density(theta))
    if density <= inertia.DENSEST:
        return []
    return [
        f"{name}: no material is as dense as its mass and inertia need (at least"
        f" {_density_in_words(density)}): the torque does not show its inertia; set it"
        " from its drawing, or move the arm so that it shows"
    ]


def _density_in_words(density: float) -> str:
    """Write a density; a flat body's is infinite."""
    if not np.isfinite(density):
        return "an infinite density"
    return f"{density:.2g} kg/m^3, and osmium has {inertia.DENSEST:.5g}"
