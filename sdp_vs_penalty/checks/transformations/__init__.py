"""Transformations of a log, one class each: those listed here are tried."""

from sdp_vs_penalty.checks.transformation import Transformation
from sdp_vs_penalty.checks.transformations import motion, torque

TRANSFORMATIONS: tuple[Transformation, ...] = (
    motion.Degrees(), motion.Clock(), motion.Sign(), motion.Exchange(), motion.Mounting(),
    torque.Weight(), torque.Gain(), torque.Delay(), torque.Change(), motion.Zero(), torque.Saturation(),
)  # fmt: skip
