"""Measurements: the type, its files (one file a format in formats/), public data sets."""

from sdp_vs_penalty.plugins import lazy_exports

__getattr__ = lazy_exports(
    __name__,
    datasets="DATASETS fetch to_joints",
    plausibility="check_plausible",
    measurements="concatenate Measurements Runs",
    files="as_measurements load_measurements read_run save",
    **{
        "formats.columns": "columns_of",
        "formats.column_report": "ColumnReport ColumnRow describe_columns",
        "formats.inferred_units": "decide_units unit_of_clock",
        "formats.loggers": "LOGGERS",
        "formats.recognition": "recognise recognised",
    },
)
