"""The five stages of the README's picture, each a screen, and what most people do without."""

from sdp_vs_penalty.page.stages.diagnose import DIAGNOSE
from sdp_vs_penalty.page.stages.identify import IDENTIFY
from sdp_vs_penalty.page.stages.measure import CHECK, MEASURE
from sdp_vs_penalty.page.stages.use import ADVANCED, USE

#: In the order of the work; ADVANCED stands beside them.
WORK = (MEASURE, CHECK, IDENTIFY, DIAGNOSE, USE)
STAGES = (*WORK, ADVANCED)
