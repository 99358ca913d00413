"""The verbs that users call, with full signatures.

The command line, the page and Python call these functions. Paths, problem and options
are resolved, read, checked and filtered once here, and handed on.
"""

from sdp_vs_penalty.plugins import lazy_exports

__all__ = [
    "add",
    "diagnose",
    "export",
    "identify",
    "identify_and_judge",
    "identify_many",
]
__getattr__ = lazy_exports(
    __name__,
    adding="add",
    diagnosis="diagnose add_certain_findings",
    exporting="export judge_as_exported",
    identification="identify identify_and_judge identify_many",
    remedies="Files State apply_change command_of next_command next_remedy",
)
