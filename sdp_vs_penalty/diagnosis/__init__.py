"""Which physical effect a model misses: `diagnose.diagnose` finds it, `adding.add` adds
it."""

from sdp_vs_penalty.plugins import lazy_exports

__getattr__ = lazy_exports(
    __name__,
    findings="Diagnosis Finding Invisible load_diagnosis Retune",
    whitening="diagnosis_rows whiten_rows",
    candidates="Batch Candidate Library list_candidates",
    comparison="compare predicted",
    conclude="reasons_for_doubt size_of",
    held_out="HeldOut",
    nuisances="Nuisance",
    remaining="least_squares_refit remainder spectral_lines",
    score="EvidenceScorer WhiteFit ScoredEffect",
    search="Search",
    **{
        "curves.curve": "Curve",
        "curves.bases": "CurveColumns",
        "curves.measure": "measured_curves",
    },
)
