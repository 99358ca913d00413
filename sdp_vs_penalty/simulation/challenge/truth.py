"""What a scorer knows and the diagnosis does not: how visible an effect is, how large the noise is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sdp_vs_penalty.data.measurements import Measurements, concatenate
from sdp_vs_penalty.diagnosis.fit import orthonormal
from sdp_vs_penalty.diagnosis.rows import diagnosis_rows
from sdp_vs_penalty.diagnosis.stage import model_columns, white_rows
from sdp_vs_penalty.estimation.estimate import Estimate
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.signals.noise import noise_in
from sdp_vs_penalty.signals.segments import SegmentedRuns
from sdp_vs_penalty.simulation.worlds.world import Logged


def energies(logged: Sequence[Logged], estimate: Estimate, frozen: bool) -> list[float]:
    """Energy of each hidden effect's torque, white, the model's columns partialled out.

    White as the true noise is, which is the log less what perfect torque channels would have shown.
    """
    silent = _filtered([x.ideal.tau for x in logged], logged, estimate)
    rows = _filtered([x.run.tau for x in logged], logged, estimate)
    noise = noise_in(rows, rows.residual - silent.residual)
    columns = model_columns(rows, estimate, frozen)
    out = []
    for k in range(len(logged[0].shares)):
        without = _filtered([x.ideal.tau - x.shares[k] for x in logged], logged, estimate)
        white, change = white_rows(rows, noise, columns, silent.residual - without.residual)
        Q = orthonormal(white)
        out.append(float(np.sum((change - Q @ (Q.T @ change)) ** 2)))
    return out


def _filtered(taus: Sequence[Array], logged: Sequence[Logged], estimate: Estimate) -> SegmentedRuns:
    """Rows of the logged positions with other torques."""
    runs = [replace(x.run, tau=tau) for x, tau in zip(logged, taus, strict=True)]
    data = concatenate(runs)
    return diagnosis_rows(data, estimate, estimate.preprocessing.resolve(data))


def true_floor(test: Logged, estimate: Estimate) -> Array:
    """(n,) standard deviation of what noise, and the encoders' steps, leave of the filtered torque."""

    def residual(run: Measurements) -> Array:
        rows = diagnosis_rows(run, estimate, estimate.preprocessing)
        return rows.residual[rows.keep[:, 0]]

    real, ideal = residual(test.run), residual(test.ideal)
    if real.shape != ideal.shape:  # the encoders' steps change what counts as standstill
        ideal = residual(replace(test.run, tau=test.ideal.tau))
    return np.asarray((real - ideal).std(axis=0))
