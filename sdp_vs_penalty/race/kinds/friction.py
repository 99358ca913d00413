"""Friction that a controller has compensated: what is left of it may drive its joint."""

from collections.abc import Iterator

from sdp_vs_penalty.race.evidence import Evidence, ViewFit
from sdp_vs_penalty.race.fault import prior_of_one_of
from sdp_vs_penalty.race.records import Hypothesis


def propose(evidence: Evidence, fit: ViewFit) -> Iterator[Hypothesis]:
    """Yield friction of either sign, which is little."""
    yield Hypothesis(
        kind="friction compensated",
        joints=(),
        log_prior=prior_of_one_of(1),
        transform=fit.transform,
        is_friction_dissipative=False,
        tells_by_friction=True,
        effect="friction that the controller compensated, by more than there is",
        by_controller="friction drives the joints a little: the controller subtracted"
        " more friction than there is (friction compensated)",
    )
