"""Transformations of a log, one class each: those listed here are tried."""

from sdp_vs_penalty.checks.transformation import Transformation
from sdp_vs_penalty.checks.transformations.motion import (
    Clock,
    Degrees,
    Exchange,
    Mounting,
    Sign,
    Zero,
)  # fmt: skip
from sdp_vs_penalty.checks.transformations.torque import Change, Delay, Gain, Saturation, Weight

TRANSFORMATIONS: tuple[Transformation, ...] = (
    Degrees(), Clock(), Sign(), Exchange(), Mounting(), Weight(), Gain(), Delay(), Change(), Zero(),
    Saturation(),
)  # fmt: skip
