"""Words of a diagnosis: its main cause, what is offered, and what is left."""

from __future__ import annotations

from collections.abc import Collection

from sdp_vs_penalty import formatting
from sdp_vs_penalty.diagnosis.finding import Finding, Retune, named_on_joints
from sdp_vs_penalty.diagnosis.findings import Diagnosis
from sdp_vs_penalty.diagnosis.sentences import (
    good_already,
    rating_counts,
    unexplained_torque,
    what_is_missing,
)
from sdp_vs_penalty.effects import effect_in_words, effect_name
from sdp_vs_penalty.effects.plain_words import written_in_words
from sdp_vs_penalty.estimation.verdict import over_noise

#: Effects besides the main one that a cause names; more are counted.
_MOST_NAMED = 2


#: What is said of an error within ABOVE_NOISE that a finding lowers.
SOME_ERROR_IS_LEFT = "Some error is left"


def place_in_files(diagnosis: Diagnosis, texts: Collection[str]) -> str:
    """Say which files of `export` have no place for one of the findings with these
    texts, and what the nearest law does that such a file holds; "" where all files
    have a place for all of them."""
    files = diagnosis.offers.files_lacking(texts)
    if not files:
        return ""
    lacking = dict[tuple[str, ...], list[Finding]]()
    for finding in diagnosis.effects:
        if finding.text in texts and finding.no_place_in:
            lacking.setdefault(finding.no_place_in, []).append(finding)
    clauses = [
        f"{formatting.words(names)} {'has' if len(names) == 1 else 'have'} no place"
        f" for {named_on_joints(those)}"
        for names, those in lacking.items()
    ]
    laws = [
        _held_law_in_words(diagnosis, f) for f in diagnosis.effects if f.text in texts
    ]
    return f"{'; '.join([*clauses, *filter(None, laws)])}."


def _held_law_in_words(diagnosis: Diagnosis, finding: Finding) -> str:
    """Say what :meth:`Offers.offer_of_held_law` adds and what error it leaves; "" without it."""
    remedy = diagnosis.offers.offer_of_held_law(finding)
    if remedy is None:
        return ""
    assert remedy.after is not None  # this remedy has it
    j, files = finding.main_joint - 1, finding.held_law_in
    unit = diagnosis.torque_unit(j + 1)
    _, after = diagnosis.errors_of(finding)
    errors = [formatting.quantity(float(x[j]), unit) for x in (remedy.after, after)]
    return (
        f"{formatting.words(files)} {'holds' if len(files) == 1 else 'hold'}"
        f" {effect_in_words(finding.held_law)}, which gives {errors[0]} there instead"
        f" of {errors[1]}"
    )


def helped_by(diagnosis: Diagnosis, found: Finding | Retune) -> str:
    """Say beside what else something helps that lowers no error by itself, and the
    errors of the joint that gains most; "" where no single other one is known."""
    other, joint = diagnosis.offers.companion(found)
    if other is None:
        return ""
    both, without = (diagnosis.offers.error_with(x) for x in ((found, other), (other,)))
    assert both is not None  # or it would be no companion
    assert without is not None
    unit = diagnosis.torque_unit(joint)
    errors = [formatting.quantity(float(x[joint - 1]), unit) for x in (both, without)]
    return (
        f"{companion_in_words(diagnosis, found)}: with both joint {joint}'s error is"
        f" {errors[0]}, and {errors[1]} without it"
    )


def companion_in_words(diagnosis: Diagnosis, found: Finding | Retune) -> str:
    """Name beside what something helps that lowers no error by itself; "" where no
    single other one is known."""
    other, _ = diagnosis.offers.companion(found)
    if other is None:
        return ""
    name = named_on_joints([other])
    again = ", estimated again" if isinstance(other, Retune) else ""
    return f"helps beside {name}{again}, not by itself"


def _is_open(diagnosis: Diagnosis) -> bool:
    """Whether something is left of which nothing is sure: weak findings, or torque
    without a name."""
    return not diagnosis.helpful and bool(
        diagnosis.effects or unexplained_torque(diagnosis)
    )


def main_cause(diagnosis: Diagnosis) -> str:
    """The main cause in a few words, its place first: "Joint 3 errs: joint spring
    (confident)", or "The robot errs: base tilt (confident)"."""
    main = diagnosis.offers.main_finding
    if main is not None:
        group = diagnosis.offers.group_of(main)
        together, badge = group.findings, group.badge
        names = formatting.words([effect_name(f.effect) for f in together])
        likeness = ""
        if main.rivals and not main.effect_is_certain:
            names = f"{names} or {written_in_words(main.short_rivals[0])}"
        elif not main.effect_is_certain:
            likeness = "something like "
        where = f"Joint {main.main_joint}" if main.joints else "The robot"
        text = f"{where} errs: {likeness}{names} ({badge})"
        if diagnosis.offers.is_within_noise(main):
            named = named_on_joints(together)
            text = f"{SOME_ERROR_IS_LEFT}: {likeness}{named} ({badge})"
            text = f"{good_already(diagnosis)} {text}".lstrip()
        others = [x for x in diagnosis.offers.helping if x not in together]
        if len(others) > _MOST_NAMED:
            return f"{text}, and {len(others)} more."
        return f"{text}; also {named_on_joints(others)}." if others else f"{text}."
    if unexplained := unexplained_torque(diagnosis):
        return f"Left: {unexplained}."
    if _is_open(diagnosis):
        findings = "finding" if len(diagnosis.effects) == 1 else "findings"
        return f"No effect is sure beside the model's: {rating_counts(diagnosis.effects)} {findings}."
    return what_is_missing(diagnosis)


def errors_left(diagnosis: Diagnosis) -> str:
    """A sentence with the RMS error of each joint on data left out, with all that is
    sure added.
    """
    start = "Error on data left out"
    if diagnosis.helpful:
        start += ", with all that helps"
    facts = diagnosis.facts()
    errors = [
        f"{error} {diagnosis.torque_unit(joint)}"
        for joint, error in enumerate(facts["left_error"].texts, start=1)
    ]
    if diagnosis.left_over_noise is None:
        unit = "the noise is not known"
    else:
        times = facts["left_over_noise"].texts
        errors = [f"{x} ({error})" for x, error in zip(times, errors, strict=True)]
        unit = "in multiples of the noise"
    by_joint = [f"j{joint} {error}" for joint, error in enumerate(errors, start=1)]
    still = formatting.left_out_still(diagnosis.standstill_left_out)
    unit = "; ".join(filter(None, (unit, still)))
    return f"{start} ({unit}): {', '.join(by_joint)}."


def weak_companions(diagnosis: Diagnosis) -> list[str]:
    """What :meth:`Diagnosis.selected` with ``helpful`` takes although it is weak, a line
    each with the reasons, such as "joint spring on joint 2 is weak (its size is
    uncertain by > 20 %)".
    """
    return [
        f"{named_on_joints([f])} is weak ({'; '.join(f.remarks)})"
        for f in diagnosis.helpful
        if f.rating == "weak"
    ]


def gain_sentence(finding: Finding, diagnosis: Diagnosis) -> str:
    """Say how adding the finding changes its joint's RMS error on data left out
    (:meth:`Diagnosis.errors_of`).

    If the noise is known, errors are in multiples of it too.

    Parameters
    ----------
    diagnosis
        The diagnosis of the finding, for the noise and units.
    """
    j = finding.main_joint - 1
    both = diagnosis.errors_of(finding)
    was, now = (formatting.number(float(rmse[j])) for rmse in both)
    is_lower = both[1][j] < both[0][j] and was != now
    helped = helped_by(diagnosis, finding)
    errors = both if is_lower else both[:1]
    ratios = [over_noise(rmse, diagnosis.known_floor) for rmse in errors]
    amount = formatting.errors_with_noise(
        [float(rmse[j]) for rmse in errors],
        [float(x[j]) for x in ratios if x is not None] or None,
        diagnosis.torque_unit(j + 1),
        between=" to ",
    )
    text = f"Adding it cuts joint {j + 1}'s error on data left out from {amount}"
    if not is_lower:
        text = (
            f"Adding it does not lower joint {j + 1}'s error on data left out: {amount}"
        )
    if helped:
        text += f"; it {helped}"
    elif not is_lower and finding.torque_is_certain and len(diagnosis.helpful) > 1:
        left = float(diagnosis.left_error[j])
        left_in_words = formatting.quantity(left, diagnosis.torque_unit(j + 1))
        text += f"; with all that helps it is {left_in_words}"
    return f"{text}."
