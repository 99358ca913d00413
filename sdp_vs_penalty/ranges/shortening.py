"""Which motion shortens a range most: random motions, and the range that each would leave.

A motion adds rows Y to the data. If it is measured like the data (as many rows a second, with
the same noise) and the model theta_c in the middle of the set were the true one, the set becomes

    |A theta - a|^2 + |Y (theta - theta_c)|^2 <= loss* - loss_ls + c,

and both ends of the function over this set are certified as over any other. The range is one of
the function that was named: a motion that conditions all parameters alike may tell less of it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from sdp_vs_penalty.data.files import Source
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.estimation.build_problem import EstimationProblem
from sdp_vs_penalty.estimation.estimate import Estimate, as_estimate
from sdp_vs_penalty.estimation.excitation import Limits, shrunk
from sdp_vs_penalty.estimators.estimator import Progress, no_progress
from sdp_vs_penalty.ranges.allowed import AllowedSet, allowed_set
from sdp_vs_penalty.ranges.ends import EndSearch
from sdp_vs_penalty.ranges.functions import coefficients
from sdp_vs_penalty.ranges.table import training_of
from sdp_vs_penalty.regression.instruments import free_rows
from sdp_vs_penalty.regression.linalg import column_space
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.trajectory import FourierTrajectory, random_trajectory
from sdp_vs_penalty.signals.filtered import FilteredRuns

#: Random motions that are compared.
CANDIDATES = 24


@dataclass(frozen=True)
class ShorteningRun:
    """A motion, and the range that it would leave of a function."""

    #: The motion.
    trajectory: FourierTrajectory
    #: Least and greatest value by the data so far.
    before: tuple[float, float]
    #: Least and greatest value with the motion measured as well, predicted.
    predicted: tuple[float, float]

    @property
    def length(self) -> float:
        """Length of the predicted range, over that before."""
        return (self.predicted[1] - self.predicted[0]) / (
            self.before[1] - self.before[0]
        )


def shortening_runs(
    model: Estimate | str,
    function: str,
    data: Source | None = None,
    *,
    duration: float = 21.0,
    candidates: int = CANDIDATES,
    seed: int = 0,
    progress: Progress = no_progress,
) -> tuple[ShorteningRun, ...]:
    """Return random motions within the robot's limits, the one that shortens the range of a
    linear function most first.

    Parameters
    ----------
    function : str
        Name of a linear function, such as "m4".
    data : path, arrays, Measurements, optional
        Measurements so far; default: those that the model was identified from, as long
        as the program runs.
    duration : float
        Length of each motion [s].
    candidates : int
        Number of motions that are compared.
    seed : int
        Seed of the first motion.
    progress : callable
        Receives a line of text a motion.

    Raises
    ------
    InputError
        For an unknown or nonlinear function, and as
        :func:`~sdp_vs_penalty.ranges.table.find_ranges` does.
    """
    estimate = as_estimate(model, "shortening_runs(model=...)")
    posed, floor = training_of(estimate, data)
    g = coefficients(posed.problem, posed.task.model, function)
    motions = [
        random_trajectory(estimate.robot, seed + k, duration) for k in range(candidates)
    ]
    allowed = allowed_set(posed, estimate.theta, floor)
    return compare_motions(allowed, posed, g, motions, progress)


def compare_motions(
    allowed: AllowedSet,
    posed: EstimationProblem,
    g: Array,
    motions: Sequence[FourierTrajectory],
    progress: Progress = no_progress,
) -> tuple[ShorteningRun, ...]:
    """Return the ranges of g^T theta that motions would leave, the shortest first; each
    motion is shrunk into the robot's limits."""
    limits = Limits.from_robot(posed.task.model.robot)
    ((least, greatest),) = EndSearch(allowed).least_and_greatest([g])
    before = least.value, greatest.value
    c = max(least.rise, greatest.rise)
    runs = []
    for k, motion in enumerate(motions, start=1):
        progress(f"motion {k} of {len(motions)}")
        fitting = shrunk(motion, limits)
        smaller = with_rows(allowed, rows_of_motion(posed, fitting), c)
        ((least, greatest),) = EndSearch(smaller).least_and_greatest([g])
        # What is known already stays known.
        after = max(least.value, before[0]), min(greatest.value, before[1])
        runs.append(ShorteningRun(fitting, before, after))
    return tuple(sorted(runs, key=lambda run: run.length))


def with_rows(allowed: AllowedSet, rows: Array, rise: float) -> AllowedSet:
    """Return the set of models that would be left with further rows (N, p), weighted
    like the data's.

    What these rows would measure is not known: it is taken for what the model in the
    middle of the set makes there, whose loss may rise by ``rise`` [(N m)^2].
    """
    ball = allowed.ball
    further = np.linalg.qr(rows, mode="r")
    A = np.vstack([ball.A, further])
    a = np.concatenate([ball.a, further @ allowed.optimiser(rise).centre])
    # In an orthonormal basis U of the columns; what lies outside of it is in every loss.
    U, _ = column_space(A)
    outside = a - U @ (U.T @ a)
    loss_ls = ball.loss_ls + float(outside @ outside)
    extended = replace(ball, A=U.T @ A, a=U.T @ a, loss_ls=loss_ls)
    row_std = np.sqrt(rise) / allowed.z

    def spread(w: Array) -> Array:
        """Return the standard deviations (k,) of functions w (k, p), of white noise."""
        return row_std * np.linalg.norm(w @ extended.directions, axis=1)

    smaller = replace(allowed, ball=replace(extended, spread=spread))
    return replace(smaller, fit=smaller.best_fit(1e-10))


def rows_of_motion(posed: EstimationProblem, motion: FourierTrajectory) -> Array:
    """Return the rows (N, p) that a motion would add to the data: at their rate, behind
    their filters, weighted as they are."""
    runs = posed.runs
    assert runs is not None
    model = posed.task.model
    step = float(np.median(np.diff(runs.measurements.t)))
    t = np.arange(0.0, motion.duration, step)
    q = motion.states(t)[0]
    measured = FilteredRuns.filtering(
        Measurements(t, q, np.zeros_like(q)), runs.settings
    )
    p = len(model.parameters)
    parts = []
    for run in measured.runs:
        for rows in free_rows(run, model):
            for weight, joint in zip(posed.task.weights, rows.columns, strict=True):
                parts.append(weight * joint.dense_columns(p))
    return np.vstack(parts)
