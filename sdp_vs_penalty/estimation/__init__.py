"""From measurements to a certified estimate, and how well the data determine it."""

from sdp_vs_penalty.plugins import lazy_exports

__getattr__ = lazy_exports(
    __name__,
    certificate="Certificate",
    excitation="Limits Regressor",
    sensitivity="free_constants prior_deviation fit_constants_jointly ShapeSensitivity",
    identify="certify on_bounds",
    proofs="verify_proof_file",
    sources="is_data_determined",
    build_problem="PoseOptions",
    drive_torque="driven",
    link_figures="consistent positive_definite_share",
    shapes="ShapeEstimate",
    uncertainty="Interval NOT_SEEN Sandwich Uncertainty counts regression_uncertainty",
    verdict="GRADES ErrorsBesideNoise MISSING PREDICTION Verdict changes judge over_noise",
    constants="LEVEL NORMAL_95",
)
