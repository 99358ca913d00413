"""What a diagnosis has found that a model still lacks."""

from __future__ import annotations

from sdp_vs_penalty.diagnosis.comparison import Comparison
from sdp_vs_penalty.diagnosis.finding import Finding, named_on_joints
from sdp_vs_penalty.diagnosis.findings import Diagnosis
from sdp_vs_penalty.estimation.estimate import Estimate
from sdp_vs_penalty.estimation.outcome import OfferOutcome
from sdp_vs_penalty.estimation.verdict import FIT, Verdict


def findings_not_added(diagnosis: Diagnosis, estimate: Estimate) -> list[Finding]:
    """List the findings of a diagnosis that a model does not have.

    A finding counts as missing if the model lacks its effect on one of its joints.

    Parameters
    ----------
    diagnosis : Diagnosis
        Of the model, or of one that it grew from.

    Returns
    -------
    list of Finding
        In the order of the diagnosis.
    """
    effects = estimate.model.effects
    of_whole_robot = {e.name for e in effects if e.whole_robot}
    on_joints = {(e.name, j + 1) for e in effects for j in e.joints}
    missing = []
    for finding in diagnosis.effects:
        keys = {(finding.effect, joint) for joint in finding.joints}
        is_on_its_joints = bool(keys) and keys <= on_joints
        if finding.effect not in of_whole_robot and not is_on_its_joints:
            missing.append(finding)
    return missing


def has_open_finding(diagnosis: Diagnosis, estimate: Estimate) -> bool:
    """Return whether a model lacks a finding that is confident or a near-tie."""
    missing = findings_not_added(diagnosis, estimate)
    return any(finding.rating != "weak" for finding in missing)


def still_missing(diagnosis: Diagnosis, estimate: Estimate) -> str:
    """Say in a sentence which findings of a diagnosis a model does not have.

    Parameters
    ----------
    diagnosis
        The diagnosis of this model, or of one that it was extended from.
    """
    if not diagnosis.effects:
        return diagnosis.headline
    missing = findings_not_added(diagnosis, estimate)
    if not missing:
        return "All effects that `diagnose` found are in the model."
    open_findings = [finding for finding in missing if finding.rating != "weak"]
    if open_findings:
        return f"The model lacks {named_on_joints(open_findings)}, found and not added."
    return f"Weak and not added: {named_on_joints(missing)}."


def verdict_beside(
    diagnosis: Diagnosis | None, compared: Comparison, forward: str = ""
) -> Verdict:
    """Return the verdict on a model, with what a diagnosis, if there is one, found that
    it lacks, and with the sentence on a forward simulation."""
    verdict = compared.verdict_with(forward)
    if diagnosis is None:
        return verdict
    return with_findings(verdict, diagnosis, compared.estimate)


def with_findings(
    verdict: Verdict, diagnosis: Diagnosis, estimate: Estimate
) -> Verdict:
    """Return the verdict on a model with what a diagnosis found that it lacks. A fit that
    is good stays good: more can be won, and nothing is wrong."""
    is_good_fit = any(x.about == FIT and x.grade == "good" for x in verdict.lines)
    is_open = not is_good_fit and has_open_finding(diagnosis, estimate)
    return verdict.with_missing(still_missing(diagnosis, estimate), is_open)


def verdict_on_file(
    verdict: Verdict, loss: str, diagnosis: Diagnosis | None, whole: Estimate
) -> Verdict:
    """Return the verdict on a file that cannot hold all of a model.

    Parameters
    ----------
    verdict : Verdict
        That of its errors.
    loss : str
        What it costs that the file cannot hold all of it (:func:`describe_loss`).
    diagnosis : Diagnosis or None
        Of the whole model, or of one that this grew from: what that lacks, the file
        lacks too. What it leaves open of the whole model's errors is not of the file.
    whole : Estimate
        The whole model.
    """
    lacking = ""
    if diagnosis is not None and findings_not_added(diagnosis, whole):
        lacking = still_missing(diagnosis, whole)
    sentence = f"{loss} {lacking}".rstrip()
    return verdict.with_missing(sentence, has_open_finding=False)


def describe_loss(outcome: OfferOutcome) -> str:
    """Say what the effects that a file leaves out cost, joint by joint, in a sentence;
    ``outcome``: the errors of the whole model, and those of the file."""
    if losses := outcome.losses():
        return f"Without what this file leaves out, {'; '.join(losses)}."
    return "No joint errs more without what this file leaves out."
