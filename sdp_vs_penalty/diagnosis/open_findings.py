"""What a diagnosis has found that a model still lacks."""

from __future__ import annotations

from sdp_vs_penalty.diagnosis.findings import Diagnosis, Finding, named_on_joints
from sdp_vs_penalty.estimation.estimate import Estimate


def findings_not_added(diagnosis: Diagnosis, estimate: Estimate) -> list[Finding]:
    """Findings of a diagnosis whose effect a model lacks on one of their joints.

    Parameters
    ----------
    diagnosis : Diagnosis
        Of the model, or of one that it grew from.
    estimate : Estimate
        The model.

    Returns
    -------
    list of Finding
        In the order of adding.
    """
    held = {(e.name, j + 1) for e in estimate.model.effects for j in e.joints}
    whole_robot_effects = {e.name for e in estimate.model.effects if e.whole_robot}
    return [
        f
        for f in diagnosis.effects
        if f.effect not in whole_robot_effects
        and not (f.joints and {(f.effect, j) for j in f.joints} <= held)
    ]


def has_open_finding(diagnosis: Diagnosis, estimate: Estimate) -> bool:
    """Whether a model lacks an effect that a diagnosis has found and calls more than
    weak."""
    missing = findings_not_added(diagnosis, estimate)
    return any(finding.rating != "weak" for finding in missing)


def still_missing(diagnosis: Diagnosis, estimate: Estimate) -> str:
    """What a diagnosis of this model, or of one that it grew from, has found that the
    model lacks."""
    if not diagnosis.effects:
        return diagnosis.headline
    missing = findings_not_added(diagnosis, estimate)
    if not missing:
        return "All effects that `diagnose` found are in the model."
    open_findings = [finding for finding in missing if finding.rating != "weak"]
    if open_findings:
        return f"Found and not added: {named_on_joints(open_findings)}."
    return f"Weak and not added: {named_on_joints(missing)}."
