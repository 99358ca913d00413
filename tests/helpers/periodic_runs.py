"""Runs of a motion that repeats itself, for whatever tells new motion from old."""

import numpy as np

from sdp_vs_penalty import Measurements
from sdp_vs_penalty.signals import Preprocessing

SETTINGS = Preprocessing(5.0, 8.0)
JOINTS = 4


def periodic(rng: np.random.Generator, t: np.ndarray, period: float, joints: int = 3) -> np.ndarray:
    """Five harmonics a joint (N, joints)."""
    w = 2.0 * np.pi / period * np.arange(1, 6)
    a, b = rng.normal(size=(2, joints, 5)) / np.arange(1, 6)
    return np.sin(np.outer(t, w)) @ a.T + np.cos(np.outer(t, w)) @ b.T


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
    t = np.arange(0.0, still + seconds, dt)
    clock = np.maximum(t - still, 0.0) + first
    q = periodic(np.random.default_rng(seed // 10), clock, period, JOINTS)
    q = q * [1.0, 0.3, 2.0, 0.0] + [0.0, 1.0, -3.0, 0.7]
    q += 1e-4 * np.random.default_rng(seed).normal(size=q.shape)
    return Measurements(t, q, np.ones_like(q), names=(f"run {seed}",))
