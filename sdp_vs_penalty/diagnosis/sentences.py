"""What is said of a diagnosis as a whole, a sentence or a clause each."""

from __future__ import annotations

from collections.abc import Sequence
from typing import get_args

import numpy as np

from sdp_vs_penalty import formatting
from sdp_vs_penalty.diagnosis.diagnosis_data import DiagnosisData
from sdp_vs_penalty.diagnosis.finding import Finding, Retune, named_on_joints
from sdp_vs_penalty.estimation.verdict import ABOVE_NOISE, over_noise
from sdp_vs_penalty.results.remedy import Rating, one_of_rivals
from sdp_vs_penalty.signals.noise import (
    NOISE_UNKNOWN,
    REPETITION,
    SPECTRUM,
    SPECTRUM_KNOWN,
)

#: What is said where the residual was taken for noise, which it then equals.
_MAY_HIDE = f"small effects may hide, since {NOISE_UNKNOWN}."


def headline(diagnosis: DiagnosisData) -> str:
    """A few sentences: what is missing, what acts for a part of the time, what the
    model has taken in, and how well the noise is known.

    What acts for a part of the time comes first if it has more evidence than any
    finding.
    """
    sentences = [what_is_missing(diagnosis)]
    if diagnosis.log_faults:
        faults = "; ".join(
            x.problem.rstrip(".") for x in one_of_rivals(diagnosis.log_faults)
        )
        sentences.insert(0, f"It looks as if {faults}. Mend the log first.")
    if diagnosis.acting_for_a_time:
        acting = f"For a part of the time: {'; '.join(diagnosis.acting_for_a_time)}."
        most = max((f.gain for f in diagnosis.effects), default=0.0)
        of_causes = max((cause.evidence for cause in diagnosis.passing), default=0.0)
        sentences.insert(0 if of_causes > most else 1, acting)
    return " ".join([*sentences, *besides(diagnosis)])


def besides(diagnosis: DiagnosisData) -> tuple[str, ...]:
    """What is said besides the cause, a sentence each: what the model has taken in, and
    how well the noise is known."""
    sentences = []
    if diagnosis.notices:
        noticed = "; ".join(notice.sentence for notice in diagnosis.notices)
        sentences.append(f"Taken in by the model: {noticed}.")
    if diagnosis.noise_source == SPECTRUM:
        sentences.append(f"The noise is {SPECTRUM_KNOWN}.")  # why: a remark
    return tuple(sentences)


def what_is_missing(diagnosis: DiagnosisData) -> str:
    """What is missing, in a sentence: effects, unexplained torque, settings, or
    nothing.
    """
    # What does not lower the error on data left out is no setting to re-estimate.
    settings = [r for r in diagnosis.retuned if r.torque_is_certain]
    certain = [f for f in diagnosis.effects if f.effect_is_certain]
    named = named_on_joints(certain or diagnosis.effects)
    near_ties = [f for f in diagnosis.effects if f.rating == "near-tie"]
    open_names = [f for f in near_ties if not f.effect_is_certain]
    if certain and open_names:
        named += f"; {named_on_joints(open_names)}, or what fits as well"
    findings = "finding" if len(diagnosis.effects) == 1 else "findings"
    counted = f"{named} ({rating_counts(diagnosis.effects)} {findings})"
    unexplained = unexplained_torque(diagnosis)
    if unexplained and certain:
        return f"Missing: {counted}; also {unexplained}."
    if unexplained and diagnosis.effects:
        return f"Missing: {unexplained}; possibly {counted}."
    if unexplained:
        return f"Missing: {unexplained}."
    if diagnosis.effects:
        text = f"{'Missing' if certain else 'Possibly missing'}: {counted}."
        if settings:
            text += f" Settings to re-estimate: {named_on_joints(settings)}."
        if not diagnosis.noise_known:
            text += f" Other {_MAY_HIDE}"
        return text
    if settings:
        return (
            "No effect is missing; settings to re-estimate:"
            f" {named_on_joints(settings)}."
        )
    if diagnosis.noise_known:
        return _nothing(diagnosis)
    return f"Nothing was found to be missing; {_MAY_HIDE}"


def _nothing(diagnosis: DiagnosisData) -> str:
    """The headline of a diagnosis without findings if the noise is known.

    It names the joint with the largest error over noise, and joints with torque
    that no effect explains.
    """
    over = over_noise(diagnosis.held_out_rmse_before, diagnosis.known_floor)
    if over is None or not len(over):
        return "Nothing is missing that these measurements could show."
    worst = int(np.argmax(over)) + 1
    left = float(diagnosis.held_out_rmse_before[worst - 1])
    unit = diagnosis.torque_unit(worst)
    error = formatting.times_noise(float(over[worst - 1]), left, unit)
    above_noise = diagnosis.joints_above_noise
    if above_noise:
        is_open = (
            "; these runs leave values of the model open" * diagnosis.is_undetermined
        )
        return (
            "No effect of the library explains the torque beyond the noise on"
            f" {formatting.joints(above_noise)}: joint {worst} errs by {error}, on data"
            f" left out{is_open}."
        )
    return (
        "Nothing is missing that these measurements could show:"
        f" {_within_noise(diagnosis)}."
    )


def _within_noise(diagnosis: DiagnosisData) -> str:
    """A clause on errors within the noise of every joint; "" where one is larger, or
    the noise is not known."""
    over = over_noise(diagnosis.held_out_rmse_before, diagnosis.known_floor)
    if over is None or not np.all(over <= ABOVE_NOISE):
        return ""
    j = int(np.argmax(over))
    return formatting.within_noise(
        float(over[j]),
        j + 1,
        float(diagnosis.held_out_rmse_before[j]),
        diagnosis.torque_unit(j + 1),
        "on data left out",
    )


def good_already(diagnosis: DiagnosisData) -> str:
    """A sentence on errors that are within the noise; "" where they are not."""
    return (
        f"Good already: {_within_noise(diagnosis)}." if _within_noise(diagnosis) else ""
    )


def unexplained_torque(diagnosis: DiagnosisData) -> str:
    """A clause on the torque that no effect explains, with joints and RMS; "" if
    there is none.
    """
    if diagnosis.verdict != "unknown_effect":
        return ""
    where = ""
    amount = ""
    if diagnosis.remains:
        where = f" on {formatting.joints([r.joint for r in diagnosis.remains])}"
        largest = max(diagnosis.remains, key=lambda r: r.rmse)
        at_most = " at most" if len(diagnosis.remains) > 1 else ""
        unit = diagnosis.torque_unit(largest.joint)
        amount = f" ({formatting.quantity(largest.rmse, unit, 2)} RMS{at_most})"
    return f"something{where} that no effect of the library explains{amount}"


def advice(diagnosis: DiagnosisData) -> str:
    """What to do next, in one sentence."""
    if unexplained_torque(diagnosis):
        return "Look first at what the error that is left depends on."
    if diagnosis.noise_source != REPETITION:
        record = (
            "record a run with more than one period: only repetition tells noise"
            " from error."
        )
        add = f"Add what helps; {record}"
        return add if diagnosis.helpful else record.capitalize()
    if diagnosis.helpful:
        return "Add what helps, and diagnose the model that results."
    if diagnosis.effects or diagnosis.retuned:
        return (
            "Record a run that tells the findings from what fits as well: all are weak."
        )
    if diagnosis.joints_above_noise and not diagnosis.is_undetermined:
        return "Look at what the error depends on."
    return "Use the model, or record motion that excites more."


def rating_counts(findings: Sequence[Finding | Retune]) -> str:
    """Count findings by rating in words: "2 confident, 1 near-tie and 1 weak"."""
    ratings = [f.rating for f in findings]
    counts = [
        f"{ratings.count(kind)} {kind}" for kind in get_args(Rating) if kind in ratings
    ]
    return formatting.words(counts) if counts else ""
