"""Which physical effect a model misses: `diagnose.diagnose` finds it, `adding.add` adds
it."""

from sdp_vs_penalty.plugins import lazy_exports

__getattr__ = lazy_exports(
    __name__,
    candidates="list_candidates",
    causes="CauseShares held_out_share",
    comparison="compare predicted upper_relative_error",
    conclude="Conclusion",
    confidence="Judged reasons_for_doubt",
    evidence="EvidenceScorer",
    explanation="Explanation",
    finding="Finding Retune",
    diagnosis_data="Invisible",
    findings="Diagnosis load_diagnosis",
    held_out="HeldOut",
    late_torque="refer_columns_to_current_model",
    library="Batch Candidate Library Nuisance white_candidate",
    linear_fit="ColumnProducts ScoredEffect WhiteFit",
    notices="find_notices Notice",
    search="Search",
    sizes="Size largest_sums size_of size_with_interval sizes_with_intervals",
    sizes_in_model="effect_of size_in_model std_of_both",
    where_it_fails="dependences Failures JointFailure",
    refit="least_squares_refit",
    unexplained="remainder unexplained_error",
    white_rows="diagnosis_rows mask_unsettled_rows whiten_rows WhiteData",
    constants="COARSENING_ROWS EVIDENCE_TO_DISTINGUISH LAW_TOLERANCE",
    **{
        "curves.curve": "Curve",
        "curves.bases": "CurveColumns",
        "curves.measure": "accept_curves measure_curves",
        "passing.cause": "PassingCause",
        "passing.search": "passing_causes",
    },
)
