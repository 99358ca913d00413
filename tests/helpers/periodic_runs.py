"""Runs of a motion that repeats itself, for whatever tells new motion from old."""

import numpy as np

from sdp_vs_penalty import Measurements
from sdp_vs_penalty.signals import Preprocessing

SETTINGS = Preprocessing(5.0, 8.0)
JOINTS = 4


def run_of(
    seed: int,
    seconds: float,
    first: float = 0.0,
    period: float = 9.63,
    dt: float = 4e-3,
    still: float = 0.0,
) -> Measurements:
    """Five harmonics a joint in other units each, encoder noise; it stands ``still`` seconds at first.

    The motion depends on the seed's tens only, the noise on all of it. The last joint does not move.
    """
    shape = np.random.default_rng(seed // 10)
    t = np.arange(0.0, still + seconds, dt)
    w = 2.0 * np.pi / period * np.arange(1, 6)
    a, b = shape.normal(size=(2, JOINTS, 5)) / np.arange(1, 6)
    clock = np.maximum(t - still, 0.0) + first
    q = np.sin(np.outer(clock, w)) @ a.T + np.cos(np.outer(clock, w)) @ b.T
    q = q * [1.0, 0.3, 2.0, 0.0] + [0.0, 1.0, -3.0, 0.7]
    q += 1e-4 * np.random.default_rng(seed).normal(size=q.shape)
    return Measurements(t, q, np.ones_like(q), names=(f"run {seed}",))
