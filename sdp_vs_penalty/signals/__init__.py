"""Filters, derivatives, noise: from samples to rows that every column passes like the
torque."""

from sdp_vs_penalty.plugins import lazy_exports

__getattr__ = lazy_exports(
    __name__,
    kernels="autoregressive Decimator Kernel",
    preprocessing="Preprocessing",
    filtered="FilteredRun FilteredRuns",
    noise="REPETITION SPECTRUM noise_of spectral_floor",
    phases="MotionClock",
    repetition="Repeat repeat_period",
    runs="interpolated",
    segments="segmented SegmentedRuns subsample_sentence window_subsample",
    encoder="read_again",
    motion="MotionRecord record_motion",
    standstill="is_still sliding unexplained_standstill_torque",
)
