"""Measurements: the type, its files (one file a format in formats/), public data sets."""

from sdp_vs_penalty.plugins import lazy_exports

__getattr__ = lazy_exports(
    __name__,
    datasets="DATASETS",
    plausibility="check_plausible",
    measurements="concatenate",
    files="read_run save",
    **{"formats.columns": "columns_of"},
)
