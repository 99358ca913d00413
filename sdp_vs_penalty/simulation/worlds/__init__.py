"""Simulated robots that share nothing with the library that is judged by them.

Equations are taken from the literature, dynamics from Pinocchio. Nothing here imports
effects, signals or regression; ``tests/simulation/test_challenge.py`` looks.
"""

from sdp_vs_penalty.plugins import lazy_exports

__getattr__ = lazy_exports(
    __name__,
    hidden="at_joint Hidden LEVELS log_uniform MAKERS shifted torques",
    world="bristles DryFriction misplaced TrueMotion World",
)
