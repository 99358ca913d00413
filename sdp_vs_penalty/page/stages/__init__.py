"""The five stages of the README's picture, each a screen, and what most people do without."""

from sdp_vs_penalty.page.stages.advanced import ADVANCED
from sdp_vs_penalty.page.stages.check import CHECK
from sdp_vs_penalty.page.stages.diagnose import DIAGNOSE
from sdp_vs_penalty.page.stages.identify import IDENTIFY
from sdp_vs_penalty.page.stages.measure import MEASURE
from sdp_vs_penalty.page.stages.use import USE

#: In the order of the work; ADVANCED stands beside them.
WORK = (MEASURE, CHECK, IDENTIFY, DIAGNOSE, USE)
STAGES = (*WORK, ADVANCED)
