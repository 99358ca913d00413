"""Measurements: the type, its files (one file a format in formats/), public data sets."""

from sdp_vs_penalty.plugins import surface

__getattr__ = surface(
    __name__,
    {
        "DATASETS": "datasets",
        "check_plausible": "plausibility",
        "columns_of": "formats.columns",
        "concatenate": "measurements",
        "read_run": "files",
        "save": "files",
    },
)
