"""A payload for Franka's controllers: an end effector's endeffector-config.json."""

import json

import numpy as np

from sdp_vs_penalty.estimation.estimate import Estimate
from sdp_vs_penalty.exporters.content import Options, payload
from sdp_vs_penalty.exporters.interface import Written

#: Name of the file in Franka's archive of an end effector; its fields are those of the
#: maker's manual ("End effector commissioning").
ENDING = FILE = "endeffector-config.json"
ABOUT = "payload for Franka"


def write(estimate: Estimate, options: Options) -> Written:
    """Make the JSON file of an end effector for Franka's controllers, from the payload.

    It holds mass [kg], centerOfMass in the flange's frame [m], and inertia about it (9
    entries by columns) [kg m^2]. This module is an :class:`ExportFormat`.
    """
    load = payload(estimate)
    fields_of_file = {
        "id": "identified-payload",
        "name": "Identified payload",
        "color": "#0072B2",
        "mass": load.mass,
        "centerOfMass": (load.com - options.flange).tolist(),
        "transformation": np.eye(4).ravel(order="F").tolist(),
        "inertia": load.about_com.ravel(order="F").tolist(),
    }
    return (json.dumps(fields_of_file, indent=2) + "\n").encode(), ()
