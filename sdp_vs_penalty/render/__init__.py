"""Words, tables, HTML and charts of results. Nothing is computed here that a person
reads as a result: numbers are facts of the records."""

from sdp_vs_penalty.plugins import lazy_exports

__getattr__ = lazy_exports(
    __name__,
    charts="Curves Figure",
    pieces="bars heat_map heat_rows",
    words="describe_diagnosis describe_finding plain_name",
)
