"""The noise floor of measurements: theirs, whatever models are compared with them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.effects.effect import CurrentModel, Motion
from sdp_vs_penalty.effects.model import Model
from sdp_vs_penalty.estimators.estimator import make_task
from sdp_vs_penalty.problem.problem import Problem
from sdp_vs_penalty.regression.regression import compress
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.signals.noise import RESIDUAL, noise_of
from sdp_vs_penalty.signals.preprocessing import Preprocessing
from sdp_vs_penalty.signals.segments import SegmentedRuns, segmented
from sdp_vs_penalty.signals.window_subsample import window_subsample


def noise_level(
    problem: Problem, measurements: Measurements, settings: Preprocessing
) -> tuple[Array | None, str]:
    """Standard deviation (n,) of the torque noise below the cut-off [N m or N], and its source.

    From repetition: r(t) - r(t + T) of a residual r. The residual is that of unconstrained least squares
    of the problem's own effects on these measurements, so that the floor does not depend on which models
    are judged beside it. Where nothing repeats, from the torque's spectrum above the motion's band
    (:mod:`~signals.noise`), at most that residual; None and "" where the logs hold nothing
    there. settings : resolved; of long recordings windows are looked at.
    """
    shown = window_subsample(measurements, settings)
    runs = segmented(shown, settings)
    if not runs.segments:
        return None, ""
    model = problem.model().reference_free
    theta = make_task(problem, model, compress(shown, model, settings), "none").ols
    runs = with_parameters(runs, model, theta)
    noise = noise_of(runs)
    return (None, "") if noise.source == RESIDUAL else (noise.floor, noise.source)


def with_parameters(runs: SegmentedRuns, model: Model, theta: Array) -> SegmentedRuns:
    """The same runs with a model's parameters as the current model."""
    return replace(runs.with_model(lambda m: with_current(model, theta, m)), gains=model.gains)


def with_current(model: Model, theta: Array, motion: Motion) -> Motion:
    """The motion with a model's torque, links (none: without mass) and widths of signs."""
    links = theta[model.rigid_indices].reshape(-1, 10)
    current = CurrentModel(model.robot, links if len(links) else np.zeros((model.robot.links, 10)))
    torque = model.torque(theta, motion)
    return replace(motion, torque=torque, current=current, sign_width=model.sign_width)
