"""The clock of a recording: where it is cut, and how channels with stamps of their own
come together at the stamps of the torque."""

from sdp_vs_penalty.plugins import lazy_exports

__getattr__ = lazy_exports(
    __name__,
    gaps=(
        "FINEST GAP PAUSE is_set_back order_of_time recorded_seconds"
        " rows_behind_gaps rows_behind_pauses usual_step"
    ),
)
