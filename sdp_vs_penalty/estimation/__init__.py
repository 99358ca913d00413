"""From measurements to a certified estimate, and how well the data determine it."""

from sdp_vs_penalty.plugins import surface

__getattr__ = surface(
    __name__,
    {
        "Certificate": "certificate",
        "Limits": "excitation",
        "bootstrap": "resampling",
        "free_constants": "sensitivity",
        "prior_deviation": "sensitivity",
        "verify_proof_file": "identify",
    },
)
