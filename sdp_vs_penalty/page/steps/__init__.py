"""The steps down the page, one file each: from choosing a robot to taking the model away."""

from sdp_vs_penalty.page.steps.check import CHECK
from sdp_vs_penalty.page.steps.findings import FINDINGS
from sdp_vs_penalty.page.steps.fit import FIT
from sdp_vs_penalty.page.steps.forward import FORWARD
from sdp_vs_penalty.page.steps.ladder import LADDER
from sdp_vs_penalty.page.steps.methods import METHODS
from sdp_vs_penalty.page.steps.model import MODEL
from sdp_vs_penalty.page.steps.parameters import PARAMETERS
from sdp_vs_penalty.page.steps.proof import PROOF
from sdp_vs_penalty.page.steps.robot import ROBOT
from sdp_vs_penalty.page.steps.runs import RUNS
from sdp_vs_penalty.page.steps.take_away import TAKE_AWAY

#: The five stages of the README's picture, and what most do without.
STAGES = {
    "Measure": (ROBOT, RUNS),
    "Check": (CHECK,),
    "Identify": (MODEL, FIT, PARAMETERS),
    "Diagnose": (FINDINGS, LADDER),
    "Use": (FORWARD, TAKE_AWAY),
    "Advanced": (METHODS, PROOF),
}
STEPS = tuple(step for steps in STAGES.values() for step in steps)

__all__ = ["STAGES", "STEPS"]
