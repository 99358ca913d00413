"""What is known of a robot before anything is measured: bounds, nominal links,
published values."""

from sdp_vs_penalty.plugins import lazy_exports

__getattr__ = lazy_exports(
    __name__,
    load="as_problem with_bounds",
    published="measured_runs published_links",
    problem="open_box",
    bodies="plausible_links",
)
