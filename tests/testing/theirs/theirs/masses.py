"""The masses of the links, one a line."""

from sdp_vs_penalty.estimation.estimate import Estimate
from sdp_vs_penalty.exporters.content import Options
from sdp_vs_penalty.exporters.interface import Written

ENDING = ".masses"
FILE = "robot.masses"
ABOUT = "the masses of the links, for a scale"


def write(estimate: Estimate, options: Options) -> Written:
    """Write the masses [kg]; all effects but the links are left out."""
    text = "".join(f"{link[0]:.6g}\n" for link in estimate.links)
    others = (e.brief for e in estimate.model.effects if e.simulator_field != "links")
    return text.encode(), tuple(others)
