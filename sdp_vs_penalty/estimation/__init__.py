"""From measurements to a certified estimate, and how well the data determine it."""

from sdp_vs_penalty.plugins import lazy_exports

__getattr__ = lazy_exports(
    __name__,
    certificate="Certificate",
    excitation="Limits",
    resampling="bootstrap",
    sensitivity="free_constants prior_deviation",
    identify="verify_proof_file",
)
