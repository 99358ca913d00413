"""Which physical effect a model misses: `diagnose.diagnose` finds it, `adding.add` adds
it."""

from sdp_vs_penalty.plugins import lazy_exports

__getattr__ = lazy_exports(
    __name__,
    findings="Diagnosis load_diagnosis",
    whitening="diagnosis_rows",
    **{"curves.curve": "Curve"},
)
