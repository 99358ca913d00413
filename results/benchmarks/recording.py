"""Long recordings for the part on memory."""

from pathlib import Path

import numpy as np
from challenge.worlds.motion import plan
from challenge.worlds.runs import load_arm

from sdp_vs_penalty import Estimate

RATE_HZ = 1000.0
PART_ROWS = 50_000
NOISE = np.array([0.15, 0.2, 0.15, 0.15, 0.08, 0.08, 0.06])  # N m
POSITION_NOISE = 2e-5  # rad
#: The joint with a Stribeck friction that the model lacks: its size [N m], and the
#: velocities [rad/s] over which it fades and turns.
STRIBECK_JOINT, STRIBECK_TORQUE, STRIBECK_VELOCITY, TURN_VELOCITY = 3, 0.8, 0.05, 0.005


def write_recording(path: Path, rows: int, model: Estimate) -> None:
    """Write a recording of so many rows as CSV, a part at a time.

    A Panda at 1 kHz on a motion that never comes back. Its torque is a model's, with a
    friction that the model lacks and white noise.
    """
    rng = np.random.default_rng(5)
    n = len(NOISE)
    states = plan(load_arm("panda"), "aperiodic", rows / RATE_HZ, rng)
    channels = [f"{name}{j + 1}" for name in ("q", "tau") for j in range(n)]
    formats = ["%.3f"] + ["%.6f"] * n + ["%.4f"] * n
    with path.open("w") as file:
        file.write(",".join(["t", *channels]) + "\n")
        for start in range(0, rows, PART_ROWS):
            t = np.arange(start, min(rows, start + PART_ROWS)) / RATE_HZ
            q, dq, ddq = states(t)
            tau = model.predict(q, dq, ddq)
            speed = dq[:, STRIBECK_JOINT]
            fading = np.exp(-((speed / STRIBECK_VELOCITY) ** 2))
            turning = np.tanh(speed / TURN_VELOCITY)
            tau[:, STRIBECK_JOINT] += STRIBECK_TORQUE * fading * turning
            measured_q = q + rng.normal(0.0, POSITION_NOISE, q.shape)
            measured_tau = tau + rng.normal(size=q.shape) * NOISE
            table = np.column_stack([t, measured_q, measured_tau])
            np.savetxt(file, table, formats, ",")
