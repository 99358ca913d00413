"""What every result is: named facts, a table in five forms, and how it shows itself."""

from sdp_vs_penalty.plugins import lazy_exports

__getattr__ = lazy_exports(
    __name__,
    issue="Certainty StoredIssue",
    facts="Fact FactMethod columns_of fact facts_of",
    record="Record Shown Summary",
    remedy="Change Remedy",
    table="Cell Table cell_text markdown_lines",
)
