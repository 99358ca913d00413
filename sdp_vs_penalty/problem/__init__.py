"""What is known of a robot before anything is measured: bounds, nominal links, published values."""

from sdp_vs_penalty.plugins import surface

__getattr__ = surface(
    __name__,
    {
        "as_problem": "load",
        "measured_runs": "published",
        "open_box": "problem",
        "plausible_links": "bodies",
        "published_links": "published",
        "with_bounds": "load",
    },
)
