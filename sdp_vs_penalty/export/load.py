"""A payload as the makers' controllers take it: Franka's endeffector-config.json, UR's set_payload."""

from __future__ import annotations

import json

import numpy as np

from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.estimation.estimate import Estimate
from sdp_vs_penalty.export.content import Inertial, number, require_consistent

#: What Franka's archive of an end effector calls its file; its fields are those of the maker's manual
#: ("End effector commissioning").
FRANKA = "endeffector-config.json"


def make_franka(estimate: Estimate, flange: tuple[float, float, float]) -> bytes:
    """JSON with mass [kg], centerOfMass in the flange's frame [m], and inertia (9, by columns) about it
    [kg m^2]; the tool's transformation is the flange itself."""
    load = _payload(estimate)
    made = {
        "id": "identified-payload",
        "name": "Identified payload",
        "color": "#0072B2",
        "mass": load.mass,
        "centerOfMass": (load.com - flange).tolist(),
        "transformation": np.eye(4).ravel(order="F").tolist(),
        "inertia": load.about_com.ravel(order="F").tolist(),
    }
    return (json.dumps(made, indent=2) + "\n").encode()


def make_set_payload(estimate: Estimate, flange: tuple[float, float, float]) -> bytes:
    """URScript: set_target_payload(m, cog, inertia): mass [kg], centre of gravity in the flange's frame
    [m], inertia Ixx, Iyy, Izz, Ixy, Ixz, Iyz about it [kg m^2]; set_payload for older controllers."""
    load = _payload(estimate)
    cog = ", ".join(number(x) for x in load.com - flange)
    tensor = load.about_com[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
    moments = ", ".join(number(x) for x in tensor)
    head = f"{number(load.mass)}, [{cog}]"
    text = f"set_target_payload({head}, [{moments}])\n# before PolyScript 5.10: set_payload({head})\n"
    return text.encode()


def _payload(estimate: Estimate) -> Inertial:
    """The model's payload in the last link's frame. Raises InputError where it has none."""
    own = [p.effect == "payload" for p in estimate.model.parameters]
    if not any(own):
        raise InputError(
            "the model has no payload", "add one: `sdp-vs-penalty add model.json payload --frozen`"
        )
    load = estimate.theta[np.array(own)]
    require_consistent(load, "payload")
    if load[0] <= 0.0:
        raise InputError("the payload has no mass", "measure with the load on")
    return Inertial.of(load)
