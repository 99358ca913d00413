"""Filters, derivatives, noise: from samples to rows that every column passes like the
torque."""

from sdp_vs_penalty.plugins import lazy_exports

__getattr__ = lazy_exports(
    __name__,
    kernels="Kernel",
    preprocessing="Preprocessing",
    filtered="FilteredRuns",
    noise="noise_of",
    repetition="repeat_period",
    segments="segmented",
)
