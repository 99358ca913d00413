"""Words: one function a record. Terminal, page and report lay them out and add none."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from sdp_vs_penalty import formatting
from sdp_vs_penalty.diagnosis.causes import (
    ACCELERATION,
    BY_DIRECTION,
    HIGH_SPEED,
    LOAD,
    MODELLED_TORQUE,
    OTHER_JOINTS,
    POSE,
    POSITION,
    REVERSAL,
    STANDSTILL,
    TIME,
    TORQUE_CURVATURE,
    TORQUE_RATE,
    TURN,
    VELOCITY,
    WAVES,
)
from sdp_vs_penalty.diagnosis.comparison import Comparison
from sdp_vs_penalty.diagnosis.constants import EVIDENCE_TO_DISTINGUISH, MINOR
from sdp_vs_penalty.diagnosis.doubts import Doubt
from sdp_vs_penalty.diagnosis.finding import Finding, Retune, named_on_joints
from sdp_vs_penalty.diagnosis.findings import Diagnosis
from sdp_vs_penalty.diagnosis.offers import Pair
from sdp_vs_penalty.diagnosis.sentences import advice
from sdp_vs_penalty.diagnosis.where_it_fails import (
    NEAR,
    UNNAMED,
    Failures,
    JointFailure,
    dependences,
    sentences,
)
from sdp_vs_penalty.effects import EFFECTS, effect_name, effects_in_words
from sdp_vs_penalty.effects.plain_words import ON_THE_ARM, WIDE
from sdp_vs_penalty.estimation.constants import CHANGES
from sdp_vs_penalty.estimation.estimate import Estimate
from sdp_vs_penalty.estimation.gains import limited_drives, open_torques
from sdp_vs_penalty.estimation.outcome import OfferOutcome
from sdp_vs_penalty.estimation.verdict import changes
from sdp_vs_penalty.formatting import number, plain_unit
from sdp_vs_penalty.render.diagnosis_words import errors_left, gain_sentence, helped_by
from sdp_vs_penalty.render.tables import SOURCES
from sdp_vs_penalty.results.remedy import Remedy
from sdp_vs_penalty.results.table import Table
from sdp_vs_penalty.robot.arrays import Array, Mask
from sdp_vs_penalty.signals.noise import NOISE_UNKNOWN

#: What each badge of a finding means.
BADGES = {
    "confident": "these runs show this effect, and no other that was tried fits as well"
    f" (each is {np.exp(EVIDENCE_TO_DISTINGUISH / 2.0):.0f} times less likely, or more)",
    "sum certain": "the torque is there; which of these laws makes it is open",
    "near-tie": "the torque is there; what makes it is open: something else fits as well",
    "size uncertain": "the torque is there; how much of it this effect makes is open",
    "cause uncertain": "the torque is there; something else may make a part of it",
    "weak": "it may be nothing",
}


@dataclass(frozen=True)
class FindingWords:
    """What is said of one finding, a sentence or a phrase each; "" where there is
    nothing to say."""

    #: Effect and joint, such as "Joint spring, joint 4".
    title: str
    #: Rating: confident, near-tie or weak.
    rating: str
    #: The rating in words: "size uncertain" where nothing else is.
    badge: str
    #: What the effect is in general.
    physics: str
    #: Why the finding is weak.
    doubt: str
    #: What the effect is on this arm, in a sentence with its size.
    on_the_arm: str = ""
    #: Size of the effect with its 95 % interval.
    size: str = ""
    #: Constants of the effect's law.
    constants: str = ""
    #: What adding the effect does to the error.
    gain: str = ""
    #: The same in brief: the errors of its joint without and with it.
    brief_gain: str = ""
    #: Whether it should be added: its torque is there, and its joint errs by no more
    #: with what its card adds. The badge's colour says so, its word how sure it is.
    helps: bool = False
    #: The name that its law has over another travel, and other effects that fit as well.
    rivals: str = ""
    #: Run that decides whether the effect is there.
    test: str = ""
    #: Why it is that sure: what was asked of the runs, a sentence each, and whether the
    #: answer speaks for the finding.
    evidence: tuple[tuple[str, bool], ...] = ()

    @property
    def title_with_doubt(self) -> str:
        """The title, with the rating in brackets unless it is confident."""
        is_sure = self.rating == "confident"
        return self.title if is_sure else f"{self.title} ({self.badge})"

    @property
    def size_and_constants(self) -> str:
        """Sentence part on the finding's size and its constants, whichever are
        known.
        """
        return "; ".join(filter(None, (self.size, self.constants)))

    @property
    def sentences(self) -> str:
        """Everything that is said of the finding, without its title, as one
        paragraph.
        """
        parts = (self.on_the_arm, self.gain, self.physics, self.rivals, self.doubt)
        return " ".join(filter(None, parts))


def plain_name(effect: str) -> str:
    """Return an effect's name for the beginning of a sentence.

    Returns
    -------
    str
        The name as it stands in a sentence.

    Examples
    --------
    >>> plain_name("presliding_hysteresis")
    'Pre-sliding hysteresis'
    """
    return formatting.sentence(effect_name(effect))


def describe_finding(
    finding: Finding, diagnosis: Diagnosis, model: str = "model.json"
) -> FindingWords:
    """Return the sentences about a finding.

    Parameters
    ----------
    finding : Finding
        The effect that the diagnosis found.
    diagnosis : Diagnosis
        The diagnosis that it belongs to. An effect's physics is explained only where it
        is listed first.
    model : str
        File name of the model, for the command that tests the finding.
    """
    physics = finding.physics
    earlier = diagnosis.effects[: finding.number - 1]
    if any(other.effect == finding.effect for other in earlier):
        physics = ""  # the first one of its kind explains it
    group = diagnosis.offers.group_of(finding)
    is_open_law = finding.says_open_law and not group.is_sum  # said in the headline
    rivals = "" if is_open_law else finding.rivals_in_words
    as_well = f"Fits as well: {rivals}." if rivals else ""
    same_law = _same_law(finding)
    doubt = doubt_of(finding, shared_doubts(diagnosis.effects))
    j = finding.main_joint - 1
    rmse, rmse_with = diagnosis.errors_of(finding)
    has_size = not (group.is_sum or finding.size_may_be_zero)
    size = finding.size_text if has_size else ""
    return FindingWords(
        title=group.title,
        on_the_arm=group.on_the_arm,
        rating=finding.rating,
        badge=group.badge,
        size=size,
        constants=finding.constants if size else "",
        gain=gain_sentence(finding, diagnosis),
        brief_gain=_brief_gain(finding, diagnosis),
        helps=finding.torque_is_certain
        and (
            bool(rmse_with[j] <= rmse[j])
            or diagnosis.offers.pair_of(finding) is not None
        ),
        physics=physics,
        rivals=" ".join(filter(None, (same_law, as_well))),
        doubt=doubt,
        test=finding.telling_run(model),
        evidence=(*_evidence_for(finding, diagnosis, size), *_against(doubt)),
    )


def _same_law(finding: Finding) -> str:
    """Return the sentence on the name that a finding's law has over another travel."""
    text = finding.same_law_in_words
    return f"{formatting.sentence(text)}." if text else ""


def _brief_gain(finding: Finding, diagnosis: Diagnosis) -> str:
    """Return the errors on data left out of a finding's joint, without and with it, and
    the change: "joint 3's error: 0.0979 → 0.00376 N m, -96 %"."""
    joint = finding.main_joint
    before, after = (float(rmse[joint - 1]) for rmse in diagnosis.errors_of(finding))
    text = _fall(joint, before, after, diagnosis)
    if pair := diagnosis.offers.pair_of(finding):
        return _gain_of_pair(pair, diagnosis)
    with_all = float(diagnosis.left_error[joint - 1])
    if after > (1.0 - MINOR) * before and finding in diagnosis.helpful:
        text += f"; with all that helps {formatting.change_of(before, with_all)}"
    outcome = diagnosis.offers.outcome_between(*diagnosis.errors_of(finding))
    rising = [outcome.share_of(k) for k in outcome.rising if k != joint]
    return "; ".join([text, *rising])


@dataclass(frozen=True)
class PartOfOffer:
    """One of several that an offer adds."""

    #: Effect and joint, or the constant that is estimated again.
    title: str
    #: What it does to the error by itself, or beside which other one.
    gain: str
    #: How sure it is, in a word.
    badge: str


def parts_of(offer: Remedy, diagnosis: Diagnosis) -> list[PartOfOffer]:
    """List what an offer adds, each once, in the order of reading; the constants last."""
    texts = offer.change.arguments["effects"]
    found: list[Finding | Retune] = [
        *diagnosis.offers.in_order_of_reading,
        *diagnosis.retuned,
    ]
    return [
        PartOfOffer(x.title, _gain_of_part(x, diagnosis), x.badge)
        for x in found
        if x.text in texts
    ]


def _gain_of_part(found: Finding | Retune, diagnosis: Diagnosis) -> str:
    """Return what one part of an offer does to the error: by itself, with the others of
    which the runs show the sum alone, or with the one that it needs."""
    if pair := diagnosis.offers.pair_of(found):
        _, _, gain = _gain_of_pair(pair, diagnosis).partition(", ")
        return f"with {named_on_joints([pair.other])}, {gain}"
    if isinstance(found, Retune):
        return _fall(found.joint, found.rmse_before, found.rmse_after, diagnosis)
    gain = _brief_gain(found, diagnosis)
    others = [x for x in diagnosis.offers.group_of(found).findings if x is not found]
    return f"with {named_on_joints(others)}, {gain}" if others else gain


def _gain_of_pair(pair: Pair, diagnosis: Diagnosis) -> str:
    """Return how the error of the joint that gains most changes with both of a pair."""
    j = pair.joint - 1
    before, after = float(diagnosis.held_out_rmse_before[j]), float(pair.after[j])
    return f"with both, {_fall(pair.joint, before, after, diagnosis)}"


def _fall(joint: int, before: float, after: float, diagnosis: Diagnosis) -> str:
    """Return how a joint's error changes [N m or N], as :func:`_brief_gain` says it."""
    amounts = formatting.amounts([before, after], diagnosis.torque_unit(joint))
    return f"joint {joint}'s error: {amounts}, {formatting.change_of(before, after)}"


def _against(doubt: str) -> tuple[tuple[str, bool], ...]:
    """Return a doubt as evidence against a finding; nothing without one."""
    return ((doubt, False),) if doubt else ()


#: Power of ten of odds above which their number says no more.
_MOST_ODDS = 6


def _evidence_for(
    finding: Finding, diagnosis: Diagnosis, size: str
) -> tuple[tuple[str, bool], ...]:
    """Return what the runs show of a finding, a sentence each, and whether that speaks
    for it. ``size`` is its size in words, "" where it is not known."""
    before, after = diagnosis.errors_of(finding)
    falls = bool(after[finding.main_joint - 1] < before[finding.main_joint - 1])
    evidence = [(gain_sentence(finding, diagnosis), falls)]
    if rising := _rising_joints(diagnosis, before, after):
        evidence.append((f"{rising} with it.", False))
    group = diagnosis.offers.group_of(finding)
    if group.is_sum:
        parts = group.findings
        evidence += [(_part_of_sum(part), not part.size_is_open) for part in parts]
    elif finding.size_may_be_zero:
        if finding.says_torque:  # in place of its size
            evidence += _balanced_torque(finding, diagnosis)
        elif Doubt("insignificant") not in finding.doubts:  # these say it too
            evidence.append(("Its size is not told from zero.", False))
    else:
        power = min(int(finding.gain / 2.0 / np.log(10.0)), _MOST_ODDS)
        odds = f"{10**power:,}".replace(",", " ")
        text = f"That a torque is missing: more than {odds} to 1, in the runs searched."
        evidence.append((text, True))
    if size:
        is_rough = finding.half_width_95 > WIDE * abs(finding.size)
        is_known = not (is_rough or finding.size_is_open)
        evidence.append((_size_in_words(finding, size), is_known))
    same_law = _same_law(finding)
    if same_law and not group.is_sum:
        evidence.append((same_law, False))
    if rivals := finding.rivals_in_words:
        if not finding.says_open_law or group.is_sum:  # or said in the headline
            evidence.append((f"Fits as well: {rivals}.", False))
    elif finding.rating == "confident" and not group.is_sum:
        least_odds = number(np.exp(EVIDENCE_TO_DISTINGUISH / 2.0), 2)
        name = "this law" if same_law else "this effect"
        text = f"That it is {name} and no other: {least_odds} to 1, or more."
        evidence.append((text, True))
    return tuple(evidence)


def _balanced_torque(finding: Finding, diagnosis: Diagnosis) -> list[tuple[str, bool]]:
    """Say why a torque can be larger than the error that it lowers; nothing of one that is
    not."""
    joint = finding.main_joint
    error = float(diagnosis.held_out_rmse_before[joint - 1])
    if finding.torque_rms is None or finding.torque_rms <= error:
        return []
    amount = formatting.quantity(error, diagnosis.torque_unit(joint))
    text = (
        f"Joint {joint} errs by {amount} RMS without it: the model's other parameters"
        " balance most of that torque."
    )
    return [(text, False)]


def _part_of_sum(finding: Finding) -> str:
    """Say what is known of one of the findings that show their sum alone."""
    size = finding.size_text
    if finding.size_may_be_zero:
        size = "its size is not told from zero"
    return f"{plain_name(finding.effect)}: {size}."


def _size_in_words(finding: Finding, size: str) -> str:
    """Say a finding's size with its interval, also relative, and of a mass what that
    interval leaves out."""
    share = formatting.percent(abs(finding.half_width_95 / finding.size), 2)
    kind = EFFECTS.find(finding.effect)
    is_half = kind is not None and "{twice}" in kind.on_the_arm
    text = f"{'Half of that' if is_half else 'Size'} {size}: known to {share}."
    if plain_unit(finding.unit).startswith("kg"):
        text += (
            " That leaves out the scale of the torques: gains that are 1 % off make the"
            " mass 1 % off."
        )
    return text


def _rising_joints(diagnosis: Diagnosis, before: Array, after: Array) -> str:
    """Say which joints' errors (n,) [N m or N] rise beyond the noise, and by how much;
    "" if none does."""
    rising = diagnosis.offers.outcome_between(before, after).rising
    texts = [
        f"joint {joint}'s error rises from "
        + formatting.amounts(
            [before[joint - 1], after[joint - 1]],
            diagnosis.torque_unit(joint),
            between=" to ",
        )
        for joint in rising
    ]
    return formatting.sentence(formatting.words(texts)) if texts else ""


def weak_title(n_weak: int, n_added: int) -> str:
    """Return the heading above the weak findings, which are folded; the model that is
    shown has ``n_added`` of them."""
    count = formatting.count(n_weak, "weak finding")
    if n_added == 0:
        return f"Not worth adding yet: {count}"
    added = "added" if n_added == n_weak else f"{n_added} of them added"
    return f"{count}, {added}"


def doubt_of(rated: Finding | Retune, shared: Collection[Doubt] = ()) -> str:
    """Say why a finding or a re-estimated constant is not confident; "" if it is.

    Doubts that are shown elsewhere are left out: those ``shared`` with other findings,
    that another effect fits as well if that effect is named, and that the size is
    uncertain if the badge says so, or if the torque is said in its place.
    """
    is_named = isinstance(rated, Finding) and bool(rated.rivals_in_words)
    left_out = {*shared, *([Doubt("rivals")] if is_named else [])}
    says_torque = isinstance(rated, Finding) and rated.says_torque
    if rated.badge == "size uncertain" or says_torque:
        left_out |= {Doubt("uncertain"), Doubt("insignificant")}
    return _in_words([doubt for doubt in rated.doubts if doubt not in left_out])


def _in_words(doubts: Sequence[Doubt]) -> str:
    """Return doubts as one sentence; "" without any."""
    text = "; ".join(doubt.sentence for doubt in doubts)
    return f"{formatting.sentence(text)}." if text else ""


def shared_doubts(findings: Sequence[Finding]) -> dict[Doubt, list[int]]:
    """Return the doubts that several uncertain findings have, with their numbers; that
    another effect fits as well is said of each, with the effect's name."""
    numbers: dict[Doubt, list[int]] = {}
    for finding in findings:
        for doubt in () if finding.torque_is_certain else finding.doubts:
            numbers.setdefault(doubt, []).append(finding.number)
    numbers.pop(Doubt("rivals"), None)
    return {doubt: those for doubt, those in numbers.items() if len(those) > 1}


def describe_constant(constant: Retune, diagnosis: Diagnosis) -> FindingWords:
    """Return the sentences about a constant of the model that should be
    re-estimated.
    """
    doubt = doubt_of(constant)
    errors = constant.rmse_before, constant.rmse_after
    gain = _fall(constant.joint, *errors, diagnosis)
    physics = f"Re-estimated constant: {constant.in_words}."
    if helped := helped_by(diagnosis, constant):
        pair = diagnosis.offers.pair_of(constant)
        assert pair is not None  # it is helped by the other one of it
        gain = _gain_of_pair(pair, diagnosis)
        physics = f"{physics} It {helped}."
    return FindingWords(
        title=f"{plain_name(constant.effect)} of joint {constant.joint}, estimated again",
        rating=constant.rating,
        badge=constant.badge,
        brief_gain=gain,
        helps=constant.torque_is_certain
        and (constant.rmse_after <= constant.rmse_before or bool(helped)),
        physics=physics,
        doubt=doubt,
        evidence=_against(doubt),
    )


#: What the runs from which a model was identified cannot show.
LOAD_IN_ALL_RUNS = "a load that all runs carry, which is part of the last link"


@dataclass(frozen=True)
class DiagnosisWords:
    """What is said of a diagnosis."""

    #: What is missing.
    verdict: str
    #: What to do next.
    advice: str
    #: Words of each finding.
    findings: tuple[FindingWords, ...]
    #: What makes several findings uncertain, a sentence each; "" for nothing.
    shared_doubt: str
    #: Words of each constant that was re-estimated.
    constants: tuple[FindingWords, ...]
    #: A sentence for each curve of missing torque.
    curves: tuple[str, ...]
    #: Error that is left, in a sentence.
    left: str
    #: What acts for a part of the time, a line each.
    events: tuple[str, ...]
    #: Effects that these runs cannot show, each with its joints.
    invisible: tuple[str, ...]
    #: Remarks, a sentence each.
    remarks: tuple[str, ...]


def describe_diagnosis(
    diagnosis: Diagnosis, units: Sequence[str], model: str = "model.json"
) -> DiagnosisWords:
    """Return every sentence about a diagnosis.

    Parameters
    ----------
    units : sequence of str
        Torque unit of each joint.
    model : str
        File name of the diagnosed model, for the commands that test a finding.
    """
    findings = [describe_finding(f, diagnosis, model) for f in diagnosis.effects]
    invisible: dict[str, set[int]] = {}
    for item in diagnosis.invisible:
        invisible.setdefault(item.effect, set()).update(item.joints)
    doubts_by_findings: dict[tuple[int, ...], list[str]] = {}
    for doubt, numbers in shared_doubts(diagnosis.effects).items():
        doubts_by_findings.setdefault((*numbers,), []).append(doubt.sentence)
    return DiagnosisWords(
        verdict=diagnosis.headline,
        advice=describe_harm(diagnosis) or advice(diagnosis),
        findings=tuple(findings),
        shared_doubt=" ".join(
            f"Findings {formatting.words(numbers)}, each: {'; '.join(doubts)}."
            for numbers, doubts in doubts_by_findings.items()
        ),
        constants=tuple(describe_constant(x, diagnosis) for x in diagnosis.retuned),
        curves=tuple(curve.sentence(units) for curve in diagnosis.curves),
        left=errors_left(diagnosis),
        events=diagnosis.acting_for_a_time,
        invisible=tuple(
            f"{effect_name(effect)} on {formatting.joints(sorted(joints))}"
            if joints
            else effect_name(effect)
            for effect, joints in invisible.items()
        )
        + (() if diagnosis.frozen else (LOAD_IN_ALL_RUNS,)),
        remarks=diagnosis.remarks,
    )


def finding_table(
    diagnosis: Diagnosis, shown: Sequence[Finding], units: Sequence[str]
) -> Table:
    """Table of each joint's error on held-out data, as findings are added one after
    another.

    Parameters
    ----------
    shown : sequence of Finding
        Findings that get a row.
    units : sequence of str
        Torque unit of each joint.

    Returns
    -------
    Table
        Rows: the model, the model with re-estimated constants, each finding added to
        those before, and the noise floor. Columns: joints.
    """
    rows = [("model", diagnosis.held_out_rmse_before)]
    if diagnosis.retuned and shown:
        rows.append(("re-estimated", diagnosis.ladder[0]))
    for finding in shown:
        mark = "" if finding.rating == "confident" else f" {finding.rating}"
        rows.append((f"+ {finding.number}.{mark}", diagnosis.ladder[finding.number]))
    noise = "noise" if diagnosis.noise_known else "noise?"
    rows.append((noise, diagnosis.noise_floor))
    kinds = ", ".join(dict.fromkeys(map(plain_unit, units)))
    return Table(
        headings=("with", *(str(j) for j, _ in enumerate(units, start=1))),
        rows=[(name, *map(number, errors)) for name, errors in rows],
        title=(
            f"Error (RMS) [{kinds}] of each joint on data not used for fitting,"
            f" {diagnosis.scope}"
        ),
    )


def errors_that_rise(diagnosis: Diagnosis, shown: Sequence[Finding]) -> str:
    """Say which of the first findings, which are ``shown``, raise a joint's error on data
    left out by 1 % or more, beside those before them, and why they stay; "" if none does.

    A finding is dropped for what it does to the errors of all joints together, beside
    all other findings (:func:`~sdp_vs_penalty.diagnosis.explanation.drop_harmful`).
    """
    steps = pairwise(diagnosis.ladder[: len(shown) + 1])
    rising = [
        number
        for number, (before, after) in enumerate(steps, start=1)
        if np.any(after > (1.0 + MINOR) * before)
    ]
    if not rising:
        return ""
    names = formatting.words(rising)
    return (
        f"A joint's error rises with {'finding' if len(rising) == 1 else 'findings'}"
        f" {names}. Findings stay by their evidence in the training runs, unless they"
        " raise the errors of all joints together."
    )


def describe_failures(failures: Failures, exceeds_noise: Mask) -> list[str]:
    """Say where a model's error is large, in a line for each joint with something to
    say, such as a cause.

    Joints whose error is their noise (``exceeds_noise`` (n,) is False) share one
    line, and so do those without a cause.
    """
    failing = [f for f in failures if exceeds_noise[f.joint - 1]]
    explained = [
        f for f in failing if dependences(f) or f.orders or f.goes_with_a_refit
    ]
    lines = [
        f"joint {f.joint}: {' '.join(sentences(f, failures.units[f.joint - 1]))}"
        for f in explained
    ]
    others = [f for f in failing if f not in explained]
    if others:
        where = formatting.joints([f.joint for f in others])
        lines.append(f"{where}: {sentences(others[0], '')[0]}")
    if quiet := [f.joint for f in failures if f not in failing]:
        where = formatting.joints(quiet)
        lines.append(f"{where}: less than twice the noise, nothing to explain.")
    return lines


def describe_change(before: Comparison, after: Comparison) -> str:
    """Say how each joint's error changed from one model to another."""
    units = after.estimate.torque_units
    sentence = changes(before.rmse, after.rmse, after.noise_floor, units)
    return sentence or "no joint's error changed by more than 5 %."


#: When an error is large, in words, by its cause.
_WHEN = {
    REVERSAL: f"most of all within {NEAR:g} s of its reversals",
    STANDSTILL: "most of all at standstill",
    HIGH_SPEED: "most of all at high speed",
    VELOCITY: "by an amount that depends on its velocity",
    POSITION: "by an amount that depends on its position",
    TURN: "by an amount that depends on where in a turn it is",
    BY_DIRECTION: "by an amount that depends on its position and direction",
    POSE: "by an amount that depends on the positions of several joints",
    WAVES: "in waves of its angle",
    ACCELERATION: "by an amount that depends on its acceleration",
    LOAD: "by an amount that depends on its load",
    TIME: "by an amount that changes over time",
    OTHER_JOINTS: "most of all when other joints move",
    MODELLED_TORQUE: "in proportion to the modelled torque",
    TORQUE_RATE: "in proportion to the rate of the torque",
    TORQUE_CURVATURE: "in proportion to the second derivative of the torque",
}


def describe_unexplained(failures: Failures, joint: int, is_found: bool | None) -> str:
    """Say what the error of a joint (from 1) depends on, and that nothing sure explains
    it.

    is_found : whether something was found that may explain it. None before a diagnosis:
    then only what the error depends on is said.
    """
    when = _WHEN.get(shown_cause(None, failures, joint))
    if is_found is None:
        return f" It errs {when}." if when else ""
    why = "no effect of the library explains it"
    if is_found:
        why = "what was found does not surely explain it"
    return f"Joint {joint} errs {when or 'most'}; {why}."


def noise_unknown(compared: Comparison) -> str:
    """Say that no noise floor is known; "" where it is."""
    if compared.noise_floor is not None:
        return ""
    return f"In these runs {NOISE_UNKNOWN}."


def describe_worst(compared: Comparison, cause: str, is_past: bool = False) -> str:
    """Say which joint has the largest error, how large it is, and when it occurs.

    ``cause`` is what the error depends on (:func:`shown_cause`); ``is_past``: a later
    model has another error.
    """
    errs = "erred" if is_past else "errs"
    joint = compared.worst_joint
    error = compared.errors.words(joint)
    if compared.error_over_noise is None:
        size = f"Joint {joint} {errs} by {error}, the largest share of a joint's torque"
    elif compared.is_within_noise:
        return f"{compared.errors.within_noise_in_words(joint)}."
    else:
        size = f"Joint {joint} {errs} by {error}"
    when = _WHEN.get(cause)
    return f"{size}, {when}." if when else f"{size}."


def describe_addition(before: Comparison, after: Comparison) -> str:
    """Say which effects were added, and how large the worst joint's error is with them.

    The worst joint is the one with the largest error before. "" if nothing was added.
    """
    new = new_effects(before.estimate, after.estimate)
    if not new:
        return ""
    joint = before.worst_joint
    error = after.errors.words(joint)
    change = f"Now, with {effects_in_words(new)}, joint {joint} errs by {error}."
    return f"{change} {describe_worse(before, after)}".rstrip()


def new_effects(before: Estimate | None, after: Estimate) -> list[str]:
    """Return the effects of a model, as `add` writes them, that the model before it
    lacks; all of them without a model before it. An effect that only has other constants
    is not new."""
    known = before.model.effects if before else ()
    places = [(effect.name, (*effect.joints,)) for effect in known]
    effects = after.model.effects
    return [x.text for x in effects if (x.name, (*x.joints,)) not in places]


def describe_remedy(remedy: Remedy, outcome: OfferOutcome | None = None) -> str:
    """Say what would be done, how sure that is, and what it does to the errors
    (``outcome``), in one line."""
    text = f"{formatting.sentence(remedy.change.words)} ({remedy.certainty}:"
    text += f" {remedy.why})"
    if outcome is not None:
        text += f": {outcome.in_words(outcome.errs_most)}, on data left out"
    return f"{text}."


def describe_advice(diagnosis: Diagnosis) -> str:
    """Say what is advised to add, and what it does to the errors; "" for nothing, and where
    the errors were not computed."""
    offer = diagnosis.offers.main
    outcome = None if offer is None else diagnosis.offers.outcome_of(offer)
    if offer is None or outcome is None:
        return ""
    words = formatting.sentence(offer.change.words)
    return f"{words}: {outcome.in_words(outcome.errs_most)}, on data left out."


def describe_harm(diagnosis: Diagnosis) -> str:
    """Say which errors rise with what was found, where that is why nothing is advised to
    add; "" else."""
    offer = diagnosis.offers.harmful
    outcome = None if offer is None else diagnosis.offers.outcome_of(offer)
    if offer is None or outcome is None:
        return ""
    rises = formatting.words([outcome.share_of(joint) for joint in outcome.rising])
    what = offer.change.words.removeprefix("add ")
    return (
        f"Nothing found is advised to be added: with {what} errors rise on data left out,"
        f" {rises}. A repair of the log, another motion or a measured curve may help."
    )


#: Files that a controller or a simulator takes, as people call them.
_FILES_IN_WORDS = {
    "model.h": "C code",
    "robot.urdf": "a URDF",
    "robot.xml": "MuJoCo's XML",
}


def describe_files(diagnosis: Diagnosis) -> str:
    """Say how much of what is advised the files for controllers and simulators hold; ""
    where they hold all of it."""
    offer = diagnosis.offers.main
    texts = offer.change.arguments["effects"] if offer else ()
    names_by_count = dict[int, list[str]]()
    for name, words in _FILES_IN_WORDS.items():
        lost = [
            f for f in diagnosis.effects if f.text in texts and name in f.no_place_in
        ]
        names_by_count.setdefault(len(texts) - len(lost), []).append(words)
    names_by_count.pop(len(texts), None)
    clauses = []
    for n_held, names in names_by_count.items():
        what = f"{n_held} of the {len(texts)}" if n_held else "none of it"
        verb = "holds" if len(names) == 1 else "hold"
        clauses.append(f"{formatting.words(names)} {verb} {what}")
    return f"In files: {'; '.join(clauses)}." if clauses else ""


def describe_worse(before: Comparison, after: Comparison) -> str:
    """Say which joints have a larger error (by more than 5 %) with the later model.

    "" if there are none.
    """
    joints = [
        j
        for j, (old, new) in enumerate(
            zip(before.rmse, after.rmse, strict=True), start=1
        )
        if new > (1.0 + CHANGES) * old
    ]
    if not joints:
        return ""
    verb = "errs" if len(joints) == 1 else "err"
    return f"{formatting.sentence(formatting.joints(joints))} {verb} more than before."


def on_the_arm_of(diagnosis: Diagnosis | None) -> list[str]:
    """Return a sentence for each finding, unless weak, on what the effect is on a
    real arm, with the rating of the finding ("confident", "near-tie").
    """
    if diagnosis is None:
        return []
    lines = []
    for group in diagnosis.offers.groups:
        finding = group.first
        if finding.rating != "weak" and not group.is_sum:
            text = formatting.sentence(finding.on_the_arm.removeprefix(ON_THE_ARM))
            lines.append(f"{text} ({formatting.sentence(finding.rating)}.)")
    return lines


def shown_finding(diagnosis: Diagnosis | None, joint: int) -> Finding | None:
    """Return the first finding on a joint (from 1) that is not weak, which the chart of
    its error shows; None without one.
    """
    for finding in () if diagnosis is None else diagnosis.effects:
        if finding.main_joint == joint and finding.rating != "weak":
            return finding
    return None


def shown_cause(finding: Finding | None, failures: Failures, joint: int) -> str:
    """Return the cause that the chart of a joint's error (from 1) is drawn against.

    That is the one which shows the joint's ``finding``, or else the cause that the
    error depends on most; UNNAMED if none is known.
    """
    if finding is not None and finding.seen_against:
        return finding.seen_against
    strongest = dependences(failures[joint - 1], 1)
    return strongest[0][0] if strongest else UNNAMED


def shown_waves(failure: JointFailure, finding: Finding | None = None) -> float:
    """Return how many waves in 2 pi of the position a chart shows one of: those of the
    finding, or else the largest ones of the error; 1 without any.
    """
    if finding is not None and "k" in finding.shape:
        return finding.shape["k"]
    return float(failure.orders[0].per_revolution) if failure.orders else 1.0


def picture_title(before: Comparison, after: Comparison, joint: int, cause: str) -> str:
    """Return the caption of the chart of a joint's error against its cause.

    It gives the error before and after in multiples of the noise, if that is known.
    """
    against = "time" if cause == UNNAMED else cause
    text = f"Error of joint {joint} against {against}"
    if before is after:
        return f"{text}: {before.name}."
    if (before.name, after.name) == ("before", "after"):
        return f"{text}, before and after."
    return f"{text}: {before.name} (before), {after.name} (after)."


#: Heading of the certificate.
PROOF = "Proof: the limits are kept, and the estimate is optimal for its objective"
#: What the certificate says, and who computed it.
CERTIFICATE = (
    "How far each kind of limit is violated, also those that a method was not given, and"
    " how far the fit can be from the best possible one. Both are computed here, whatever"
    " the solver says."
)


def drive_torque_sentence(estimate: Estimate) -> str:
    """Say what a log without torque leaves open: viscous friction, the gains of drives
    at their limit, and the torque of some joints.
    """
    text = (
        "Encoders do not tell a servo's damping gain kd from viscous friction: kd is"
        " their sum."
    )
    if limited := limited_drives(estimate):
        joints = formatting.words([f"joint {joint}" for joint in limited])
        text += (
            f" Drives at their torque limit: {joints}. There a drive does not follow its"
            " law, and these gains are not determined: command smaller or slower steps."
        )
    widths = open_torques(estimate)
    if not widths:
        return text
    named = [
        f"joint {joint} by {formatting.percent(width)}"
        if width < 1.0
        else f"joint {joint} (not determined)"
        for joint, width in widths.items()
    ]
    return f"{text} The gains leave the drives' torque open: {formatting.words(named)}."


def caveats(estimate: Estimate) -> list[str]:
    """Return what to know before reading parameters, a sentence for each caveat.

    One says that no torque was logged, another how many parameters the data leave open.
    """
    sources = estimate.sources
    lines = []
    if law := estimate.report.servo:
        lines.append(
            f"No torque was logged: the servos' law ({law.law}) stands for it."
            f" Scale: {law.scale}."
        )
        lines.append(drive_torque_sentence(estimate))
    others = [source for source in sources if source not in ("data", "given")]
    if others:  # of the prior or of bounds
        lines.append(
            f"{len(others)} of {estimate.n_parameters} parameters are"
            f" {SOURCES[others[0]]}, not from the data: do not read them one by one."
        )
    return lines
