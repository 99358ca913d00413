"""What data and physical consistency allow, whatever the prior: least and greatest
values with a proof of each end, bands of torque, and samples of consistent models."""

from sdp_vs_penalty.plugins import lazy_exports

__getattr__ = lazy_exports(
    __name__,
    allowed="AllowedSet allowed_set",
    ends="End EndSearch",
    band="Band torque_band",
    samples="Samples find_samples sample_models",
    worth="Worth what_to_measure worth_table",
    shortening="ShorteningRun shortening_runs",
    table="Range Ranges find_end find_ranges",
)
