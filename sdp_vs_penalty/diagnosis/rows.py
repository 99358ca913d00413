"""Filtered runs with the model in question attached: what the diagnosis and the comparison look at."""

from __future__ import annotations

from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.estimation.estimate import Estimate
from sdp_vs_penalty.estimation.noise_level import with_parameters
from sdp_vs_penalty.signals.preprocessing import Preprocessing
from sdp_vs_penalty.signals.segments import SegmentedRuns, segmented


def diagnosis_rows(
    measurements: Measurements, estimate: Estimate, settings: Preprocessing
) -> SegmentedRuns:
    """Filter all runs; ``settings`` must be resolved. The current model is the estimate.

    Raises InputError where no run is long enough for the filters.
    """
    runs = segmented(measurements, settings)
    if not runs.segments:
        raise InputError(
            "no rows are left after filtering",
            "record longer runs in which the robot moves, or raise the cut-offs",
            ", ".join(runs.names),
        )
    return with_estimate(runs, estimate)


def with_estimate(runs: SegmentedRuns, estimate: Estimate) -> SegmentedRuns:
    """The same runs with an estimate as the current model."""
    return with_parameters(runs, estimate.model, estimate.theta)
