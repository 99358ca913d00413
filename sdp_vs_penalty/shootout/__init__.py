"""Solvers against instances of identification, every answer judged by our own
certificate."""

from sdp_vs_penalty.plugins import lazy_exports

__getattr__ = lazy_exports(
    __name__,
    augmented_lagrangian="Chart",
    catalogue="everything instance",
    instances="chain_task in_units Instance shape_cones",
    judge="Answer Reference reference relative_violation",
)
