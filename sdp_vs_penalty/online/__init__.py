"""A payload in the control loop: mass, centre of mass and inertia from a stream."""

from sdp_vs_penalty.plugins import lazy_exports

__getattr__ = lazy_exports(
    __name__,
    arm="ArmModel",
    change="ChangeDetector",
    information="PayloadPrior",
    noise="ResidualNoise",
    payload="PayloadChange PayloadEstimator PayloadNow",
    projection="ConeProjection",
    smoothing="SmoothingFilter",
)
