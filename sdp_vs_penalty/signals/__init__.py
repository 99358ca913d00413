"""Filters, derivatives, noise: from samples to rows that every column passes like the torque."""

from sdp_vs_penalty.plugins import surface

__getattr__ = surface(
    __name__,
    {
        "Kernel": "kernels",
        "Preprocessing": "preprocessing",
        "FilteredRuns": "filtered",
        "noise_of": "noise",
        "repeat_period": "repetition",
        "segmented": "segments",
    },
)
