"""Between which values the torque of a motion can lie at all.

A row y^T theta of the regressor is a linear function. Over the data's ellipsoid alone its ends
are known in closed form, an outer bound for every sample:

    y^T theta_ls -+ sqrt(loss* - loss_ls + c(y)) |V^T y|,      A V = 1,

with c(y) of y's own interval (:mod:`allowed`), and the model's error added for the wider one.
Constraints can only shorten it: at a joint's peak both ends are certified by an SDP.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sdp_vs_penalty.data.files import Source, as_measurements
from sdp_vs_penalty.estimation.build_problem import filter_runs
from sdp_vs_penalty.estimation.constants import LEVEL
from sdp_vs_penalty.estimation.estimate import Estimate, as_estimate
from sdp_vs_penalty.ranges.allowed import AllowedSet, allowed_set
from sdp_vs_penalty.ranges.ends import EndSearch
from sdp_vs_penalty.ranges.table import training_of
from sdp_vs_penalty.records import JsonRecord
from sdp_vs_penalty.regression.instruments import free_rows
from sdp_vs_penalty.results.record import Record, Summary
from sdp_vs_penalty.results.table import Cell, Table
from sdp_vs_penalty.robot.arrays import Array


@dataclass(frozen=True, repr=False)
class Band(Record, JsonRecord):
    """The band of torque along a motion, behind the model's filters."""

    #: (N,) instants [s].
    t: Array
    #: (N, n) torque at least squares, the band's centre [N m, N].
    centre: Array
    #: (N, n) half of the band's width [N m, N].
    half_width: Array
    #: (N, n) the same where the model may err as much unseen as seen [N m, N].
    half_width_with_error: Array
    #: (N, n) measured torque, filtered alike [N m, N].
    measured: Array
    #: (n,) noise floor of the measured torque [N m, N]; zero where it is not known.
    noise: Array
    #: (n, 2) certified least and greatest torque at each joint's peak, constraints
    #: included [N m, N].
    peaks: Array

    def inside(self, with_error: bool = True) -> Array:
        """Return the share of samples (n,) whose torque lies in the band, widened by 1.96
        times the noise."""
        half = self.half_width_with_error if with_error else self.half_width
        reach = half + 1.96 * self.noise
        return np.mean(np.abs(self.measured - self.centre) <= reach, axis=0)

    def _summary(self) -> Summary:
        """Return the title and the (label, text) lines of the printed summary."""
        lines = [
            (f"joint {j + 1}", f"{100 * x:.1f} % of samples within the band")
            for j, x in enumerate(self.inside().tolist())
        ]
        return f"Band of torque: {len(self.t)} samples", lines

    def table(self) -> Table:
        """Return one row a joint: width, peak torque, and samples inside."""
        headings = (
            "joint",
            "measured RMS [N m or N]",
            "half width, RMS",
            "with model error",
            "least at the peak",
            "greatest at the peak",
            "inside [%]",
            "inside with model error [%]",
        )
        rms = [
            np.sqrt(np.mean(x**2, axis=0))
            for x in (self.measured, self.half_width, self.half_width_with_error)
        ]
        columns = [
            *rms,
            *self.peaks.T,
            100.0 * self.inside(with_error=False),
            100.0 * self.inside(),
        ]
        rows: list[list[Cell]] = [
            [str(j + 1), *(float(column[j]) for column in columns)]
            for j in range(self.centre.shape[1])
        ]
        return Table(headings, rows, digits=3, notes=self.notes())

    def notes(self) -> list[str]:
        """Return a sentence on noise that is not known, and on joints whose torque the
        wider band does not hold."""
        notes = []
        if not self.noise.any():
            notes.append(
                "The noise is not known: the model's own error may widen the band."
            )
        short = [str(j) for j, x in enumerate(self.inside(), start=1) if x < LEVEL]
        if short:
            notes.append(
                f"The band with model error holds the measured torque in less than"
                f" {100 * LEVEL:g} % of samples of joint {', '.join(short)}: the model lacks"
                " something there."
            )
        return notes


def torque_band(
    model: Estimate | str, motion: Source, data: Source | None = None
) -> Band:
    """Return the band of torque along a measured motion, by default of the data that
    the model was identified from.

    Parameters
    ----------
    motion : path, arrays, Measurements
        A run, with the torque that was measured.
    data : path, arrays, Measurements, optional
        Measurements, as :func:`~sdp_vs_penalty.ranges.table.find_ranges` takes them.

    Returns
    -------
    Band
        A closed form at every sample, an SDP at each joint's peak.
    """
    estimate = as_estimate(model, "torque_band(model=...)")
    posed, floor = training_of(estimate, data)
    allowed = allowed_set(posed, estimate.theta, floor)
    robot = estimate.robot
    runs = as_measurements(
        motion, robot.n, robot.joint_names, "torque_band(motion=...)"
    )
    filtered = filter_runs(posed.problem, runs, estimate.preprocessing)
    parts = [rows for run in filtered.runs for rows in free_rows(run, posed.task.model)]
    p = len(allowed.bound)
    columns = [
        np.vstack([rows.columns[joint].dense_columns(p) for rows in parts])
        for joint in range(robot.n)
    ]
    return band_of(
        allowed,
        t=np.concatenate([rows.motion.t for rows in parts]),
        columns=columns,
        measured=np.concatenate([rows.torque for rows in parts]),
    )


def band_of(
    allowed: AllowedSet, t: Array, columns: list[Array], measured: Array
) -> Band:
    """Return the band of the torque that regressor rows (N, p) of each joint make.

    Without the constraints the torque y^T theta of a row y is within
    sqrt(loss |V^T y|^2 + (z std(y))^2) of that of least squares: ``loss`` is what the
    constraints cost, and with model error also what the noise does not explain.
    """
    ball = allowed.ball
    V = ball.directions
    least_squares = V @ ball.a
    centre, half_width, half_width_with_error = np.zeros((3, len(t), len(columns)))
    peaks = np.zeros((len(columns), 2))
    rows_of_peaks = []
    for j, Y in enumerate(columns):
        centre[:, j] = Y @ least_squares
        leverage = np.linalg.norm(Y @ V, axis=1)  # (N,) |V^T y|
        by_noise = (allowed.z * np.nan_to_num(ball.spread(Y))) ** 2
        half_width[:, j] = np.sqrt(allowed.cost * leverage**2 + by_noise)
        with_error = allowed.cost + ball.structure
        half_width_with_error[:, j] = np.sqrt(with_error * leverage**2 + by_noise)
        peak = np.argmax(np.abs(centre[:, j]) + half_width[:, j])
        rows_of_peaks.append(Y[peak])
    # At the peaks the ends are those under the constraints as well.
    for j, (low, high) in enumerate(
        EndSearch(allowed).least_and_greatest(rows_of_peaks)
    ):
        peaks[j] = low.value, high.value
    floor = allowed.floor
    noise = np.zeros(len(columns)) if floor is None else np.asarray(floor, float)
    return Band(t, centre, half_width, half_width_with_error, measured, noise, peaks)
