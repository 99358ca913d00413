"""The five stages of the README's picture, each a screen."""

from sdp_vs_penalty.page.stages.diagnose import DIAGNOSE
from sdp_vs_penalty.page.stages.identify import IDENTIFY
from sdp_vs_penalty.page.stages.measure import CHECK, MEASURE
from sdp_vs_penalty.page.stages.use import USE

#: In the order of the work.
STAGES = (MEASURE, CHECK, IDENTIFY, DIAGNOSE, USE)
