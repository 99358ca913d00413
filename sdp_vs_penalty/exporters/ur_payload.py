"""A payload for Universal Robots' controllers: URScript's set_target_payload."""

from sdp_vs_penalty.estimation.estimate import Estimate
from sdp_vs_penalty.exporters.content import Options, number, payload
from sdp_vs_penalty.exporters.interface import Written

ENDING = ".script"
FILE = "payload.script"
ABOUT = "payload for UR"


def write(estimate: Estimate, options: Options) -> Written:
    """Make URScript that sets the payload: set_target_payload(m, cog, inertia).

    Mass [kg], centre of gravity in the flange's frame [m], inertia Ixx, Iyy, Izz, Ixy,
    Ixz, Iyz about it [kg m^2]; set_payload for older controllers. This module is an
    :class:`ExportFormat`.
    """
    load = payload(estimate)
    cog = ", ".join(number(x) for x in load.com - options.flange)
    tensor = load.about_com[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
    moments = ", ".join(number(x) for x in tensor)
    head = f"{number(load.mass)}, [{cog}]"
    text = (
        f"set_target_payload({head}, [{moments}])\n# before PolyScript 5.10:"
        f" set_payload({head})\n"
    )
    return text.encode(), ()
