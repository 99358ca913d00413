"""What is known of a robot before anything is measured: bounds, nominal links,
published values."""

from sdp_vs_penalty.plugins import lazy_exports

__getattr__ = lazy_exports(
    __name__,
    load=(
        "EXAMPLE as_problem check_fields load_problem problems_folder with_bounds "
        "with_filters"
    ),
    published="measured_runs published_cell published_links published_values",
    problem="CentreOfMassCone ProblemFields open_box",
    bodies="link_bodies plausible_links",
)
