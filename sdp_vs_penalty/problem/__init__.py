"""What is known of a robot before anything is measured: bounds, nominal links,
published values."""

from sdp_vs_penalty.plugins import surface

__getattr__ = surface(
    __name__,
    load="as_problem with_bounds",
    published="measured_runs published_links",
    problem="open_box",
    bodies="plausible_links",
)
