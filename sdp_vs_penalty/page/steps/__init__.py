"""The steps down the page, one file each: from choosing a robot to taking the model away."""

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

STEPS = (ROBOT, RUNS, MODEL, FIT, PARAMETERS, FINDINGS, LADDER, METHODS, FORWARD, PROOF, TAKE_AWAY)

__all__ = ["STEPS"]
