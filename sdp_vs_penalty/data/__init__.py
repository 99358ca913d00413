"""Measurements: the type, its files (one adapter a file in formats/), public data sets."""

from sdp_vs_penalty.plugins import lazy_exports

__getattr__ = lazy_exports(
    __name__,
    datasets="DATASETS fetch to_joints",
    plausibility="check_plausible",
    measurements="columns_of concatenate Measurements Runs",
    files="as_measurements load_measurements read_run save",
    **{
        "hypotheses.report": "ColumnReport ColumnRow describe_columns",
        "hypotheses.weighing": "unit_of_clock",
        "hypotheses.recognition": "recognise",
        "words.loggers": "LOGGERS",
    },
)
