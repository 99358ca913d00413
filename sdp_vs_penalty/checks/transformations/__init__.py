"""Transformations of a log, one idea a file: a file here is tried after it is listed below."""

from sdp_vs_penalty.checks.transformation import Transformation
from sdp_vs_penalty.checks.transformations.clock import Clock
from sdp_vs_penalty.checks.transformations.degrees import Degrees
from sdp_vs_penalty.checks.transformations.delay import Delay
from sdp_vs_penalty.checks.transformations.event import Change
from sdp_vs_penalty.checks.transformations.gain import Gain
from sdp_vs_penalty.checks.transformations.mounting import Mounting, Weight
from sdp_vs_penalty.checks.transformations.order import Exchange
from sdp_vs_penalty.checks.transformations.saturation import Saturation
from sdp_vs_penalty.checks.transformations.sign import Sign
from sdp_vs_penalty.checks.transformations.zero import Zero

TRANSFORMATIONS: tuple[Transformation, ...] = (
    Degrees(), Clock(), Sign(), Exchange(), Mounting(), Weight(), Gain(), Delay(), Change(), Zero(),
    Saturation(),
)  # fmt: skip
