"""The steps down the page, one file each: from choosing a robot to taking the model away."""

from sdp_vs_penalty.page.parts.check import CHECK
from sdp_vs_penalty.page.parts.findings import FINDINGS
from sdp_vs_penalty.page.parts.fit import FIT
from sdp_vs_penalty.page.parts.forward import FORWARD
from sdp_vs_penalty.page.parts.methods import METHODS
from sdp_vs_penalty.page.parts.model import MODEL
from sdp_vs_penalty.page.parts.model_history import HISTORY
from sdp_vs_penalty.page.parts.parameters import PARAMETERS
from sdp_vs_penalty.page.parts.proof import PROOF
from sdp_vs_penalty.page.parts.robot import ROBOT
from sdp_vs_penalty.page.parts.runs import RUNS
from sdp_vs_penalty.page.parts.take_away import TAKE_AWAY

#: The five stages of the README's picture, and what most do without.
STAGES = {
    "Measure": (ROBOT, RUNS),
    "Check": (CHECK,),
    "Identify": (MODEL, FIT, PARAMETERS),
    "Diagnose": (FINDINGS, HISTORY),
    "Use": (FORWARD, TAKE_AWAY),
    "Advanced": (METHODS, PROOF),
}
PARTS = tuple(step for steps in STAGES.values() for step in steps)

__all__ = ["PARTS", "STAGES"]
