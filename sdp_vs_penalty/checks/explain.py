"""What the race finds in a log, as issues of the check."""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from sdp_vs_penalty import formatting
from sdp_vs_penalty.checks.certainty import likely
from sdp_vs_penalty.checks.issue import (
    EXPLANATION,
    Issue,
    make_explanation,
    with_rival_effects,
)
from sdp_vs_penalty.checks.residual import EVENT, without_moment
from sdp_vs_penalty.race.arm_fit import text_of_share
from sdp_vs_penalty.race.chain import LogTransform
from sdp_vs_penalty.race.constants import LIKELY
from sdp_vs_penalty.race.fault import Fault, joints_text
from sdp_vs_penalty.race.kinds import list_faults
from sdp_vs_penalty.race.likelihood import Likelihood
from sdp_vs_penalty.race.race import Claim, RaceOutcome
from sdp_vs_penalty.race.records import ArmDifference
from sdp_vs_penalty.results.remedy import Change

#: Standard deviations of a 95 % interval; what the model lacks widens it (Student's t of
#: the parts of a log).
_INTERVAL = 2.4
#: What no change of the log can undo, in words with its size, and what to do.
_DIFFERENCES: dict[ArmDifference, tuple[str, str]] = {
    "load": (
        "{run} carries {weight} load on its last link ({amount}{supposed}), beside the others.",
        "identify the runs apart, or log with the same tool",
    ),
    "links": (
        "masses and inertias of other links explain {run}, beside the others.",
        "identify the runs apart, or log with the same arm",
    ),
    "friction": (
        "{joint} has {size:.2g} {unit}{supposed} {more} friction in {run} than in the others (wear,"
        " another temperature).",
        "identify the runs apart, or log them as warm",
    ),
}
#: What competes with all that leaves much unexplained.
SOMETHING_ELSE = "something that the model lacks, since much stays unexplained"
#: What competes with a claim of low odds.
LITTLE = "something that the model lacks, since the log tells little of it"
#: What competes with a claim that friction's sign alone tells.
FRICTION_ALONE = "friction that the controller subtracts, or that the model lacks"


def issues_of_all(
    log: Likelihood,
    verdict: RaceOutcome,
    net: LogTransform,
    runs: Sequence[tuple[str, Likelihood, LogTransform]],
    has_gains: bool,
) -> list[Issue]:
    """List an issue for each fault that all rows share.

    Parameters
    ----------
    log : Likelihood
        Rows of all runs.
    net : LogTransform
        What the verdict tells of all rows.
    runs : sequence of tuple
        Name and rows of each run, and how they are repaired.
    has_gains : bool
        Whether the channels have known gains. Without, no gain is a fault, and what acts
        on several joints may be each channel's own gain.
    """
    issues = []
    for fault in list_faults(log, net):
        if fault.is_gain and not has_gains:
            continue
        claims = [x for x in verdict.claims_on_all_rows() if _is_about(x, fault)]
        if fault.in_words_of_runs is not None and len(runs) > 1:
            fault = fault.in_words_of_runs(fault, runs)
        issues.append(graded(_of_fault(log, fault, claims, net), verdict, claims))
    for claim in verdict.claims:
        if claim.hypothesis.by_controller:
            issue = graded(_of_controller(claim), verdict, [claim])
            if claim.hypothesis.extra_torque is not None and not has_gains:
                issue = with_rival_effects(issue, ["each channel's own drive gain"])
            issues.append(issue)
    return issues


def _is_about(claim: Claim, fault: Fault) -> bool:
    """Whether a claim has made a fault: they are of one kind, and the joints of one are
    among those of the other, since several claims may make one fault and the other way
    round."""
    joints, others = set(claim.hypothesis.joints), set(fault.joints)
    return claim.hypothesis.kind == fault.kind and (
        joints <= others or others <= joints
    )


def graded(issue: Issue, verdict: RaceOutcome, claims: Sequence[Claim]) -> Issue:
    """Return the issue about some claims, only possible where one may not be likely."""
    if all(map(verdict.is_sure_of, claims)):
        return issue
    odds = min(claim.log_odds for claim in claims)
    other = SOMETHING_ELSE if odds >= LIKELY else LITTLE
    if any(claim.hypothesis.tells_by_friction for claim in claims):
        other = FRICTION_ALONE
    return with_rival_effects(issue, [other])


def _of_claim(claim: Claim, rivals: Sequence[str], why: str, **said: Any) -> Issue:
    """Return the issue about what a claim says, only possible where rivals do as well.

    why : what speaks for it, with {times} for how many times as much is left of some
    joint's torque without it.
    """
    times = float(np.exp(0.5 * _log_fall(claim)))
    said["certainty"] = likely(why.format(times=f"{times:.2g} times as much"))
    issue = make_explanation(**said, log_odds=float(claim.log_odds))
    return with_rival_effects(issue, [*dict.fromkeys(rivals)])


def _log_fall(claim: Claim) -> float:
    """Return the natural logarithm by which a claim lowers the squared residual of the
    joint that gains most."""
    return float(np.log(claim.before.energy_left / claim.fit.energy_left).max())


def _rivals_of(claim: Claim) -> list[str]:
    """List what is as likely, in words; the same cause elsewhere is no other one, and
    links carry a load, too."""
    h = claim.hypothesis
    others = [x.hypothesis for x in claim.rivals if x.hypothesis.name != h.name]
    if h.arm_difference == "load":
        others = [x for x in others if x.arm_difference != "links"]
    return [x.in_words for x in others]


def _of_controller(claim: Claim) -> Issue:
    """Return the issue about what a controller did to the torques."""
    why = "without it {times} of a joint's torque is left"
    if _log_fall(claim) < 0.05:
        why = "friction that drives would be none"
    return _of_claim(
        claim,
        _rivals_of(claim),
        why,
        kind=claim.hypothesis.kind,
        where="all torque channels",
        what=f"{claim.hypothesis.by_controller}.",
        remedy="log the torques before the controller's compensation",
        joints=[],
    )


def _of_fault(
    log: Likelihood, fault: Fault, claims: Sequence[Claim], net: LogTransform
) -> Issue:
    """Return the issue of one fault that the claims are about."""
    numbers, probability = {**fault.figures}, None
    what, is_known = fault.what, True
    if fault.number is not None and claims and claims[-1].std > 0.0:
        size = fault.number.size_in(net)
        reach = _INTERVAL * claims[-1].std
        ends = [size - reach, size + reach]
        is_known = reach < fault.number.known_within
        numbers["interval"] = ends
        what = f"{what.rstrip('.')} (95 %: {fault.interval_in_words(ends)})."
    hypotheses = [x.hypothesis for claim in claims for x in claim.rivals]
    effects = [h.effect for h in hypotheses if h.effect]
    of_rivals = [
        _of_rival(log, x, p, claims)
        for claim in claims
        for x, p in zip(claim.rivals, claim.probabilities[1:].tolist(), strict=True)
        if not x.hypothesis.effect
    ]
    of_rivals = [x for x in of_rivals if x.what != fault.sentence]
    as_likely = [x.what.rstrip(".") for x in of_rivals]
    if as_likely:
        what = f"{what} As likely: {'; '.join(as_likely)}."
        probability = float(np.prod([claim.probabilities[0] for claim in claims]))
        numbers["as_likely"] = [{"kind": x.kind, **x.figures} for x in of_rivals]
    is_repaired = bool(fault.apply) and is_known

    issue = Issue(
        kind=fault.kind,
        nature=EXPLANATION,
        where=fault.place or joints_text(fault.joints),
        what=what,
        certainty=likely(_reason(log, fault, net)),
        remedy=fault.remedy if is_known else f"say the size; about: {fault.remedy}",
        changes=() if is_known else _asked(fault),
        repair=keep_only(log, net, [fault]).apply if is_repaired else None,
        joints=tuple(j + 1 for j in fault.joints),
        at=fault.at,
        log_odds=float(sum(claim.log_odds for claim in claims)),
        probability=probability,
        numbers=numbers,
        gravity=fault.gravity,
        position_unit=fault.position_unit,
        of_positions=fault.of_positions,
        in_doubt=fault.in_doubt,
        is_of_columns=fault.is_of_columns,
        is_gain=fault.is_gain,
        apply=fault.apply if is_repaired else "",
        changes_positions=fault.changes_positions,
        changes_order=fault.changes_order,
        equivalents=tuple(as_likely),
        rivals=tuple(of_rivals),
    )
    return with_rival_effects(issue, effects)


def _asked(fault: Fault) -> tuple[Change, ...]:
    """Return the reading of the file in a unit that only the user knows, of a fault of
    positions."""
    if fault.number is None or fault.number.field != "scale":
        return ()
    words = "read q by its radians a unit, 2 pi over the counts a turn"
    return (Change("read", words, {"scale": {"q": None}}),)


def _of_rival(
    log: Likelihood, rival: Claim, probability: float, claims: Sequence[Claim]
) -> Issue:
    """Return what else explains a log as well as claims do: the faults that a rival adds
    to those before the claims, with one repair of all of them."""
    h = rival.hypothesis
    of_kind = partial(
        make_explanation,
        kind=h.kind,
        where=joints_text(h.joints) if h.joints else "all rows",
        joints=h.joints,
        certainty=likely("as likely"),
        probability=probability,
    )
    faults = list[Fault]()
    if h.part is None:
        before = {x.sentence for x in list_faults(log, claims[0].before.transform)}
        of_rival = list_faults(log, rival.fit.transform)
        faults = [x for x in of_rival if x.sentence not in before]
    if not faults:
        whose = f" of {joints_text(h.joints)}" if h.joints else ""
        return of_kind(what=f"{h.kind}{whose} in a part of the log", remedy="")
    issue = of_kind(
        what=f"{', and '.join(x.sentence.rstrip('.') for x in faults)}.",
        remedy=", ".join(x.remedy for x in faults),
    )
    if all(x.apply for x in faults):
        repair = keep_only(log, rival.fit.transform, faults).apply
        return replace(
            issue,
            repair=repair,
            apply=" ".join(x.apply for x in faults),
            changes_order=any(x.changes_order for x in faults),
        )
    return replace(issue, gravity=faults[0].gravity) if len(faults) == 1 else issue


def keep_only(
    log: Likelihood, net: LogTransform, faults: Sequence[Fault]
) -> LogTransform:
    """Return the transform that corrects some of its faults alone."""
    names = {x.name for x in faults}
    for _ in list_faults(log, net):
        # Without one fault the transforms of the others are other ones.
        others = [x for x in list_faults(log, net) if x.name not in names]
        if not others:
            break
        net = others[0].without
    return net


def _reason(log: Likelihood, fault: Fault, net: LogTransform) -> str:
    """Say in a sentence what speaks for a fault: by how much less is left of the joint
    that gains most, in percent of the torque's root mean square; or physics, where the
    fit is the same without."""
    after = log.fit(net).unexplained_shares  # (n,) of the torques' energies
    without = log.fit(fault.without).unexplained_shares
    change = np.log(without / after)
    j = int(np.argmax(change))
    if change[j] < 0.05:
        return "as recorded, friction would drive the motion, or inertia be negative"
    return (
        f"what the arm's dynamics leave unexplained of joint {j + 1}'s torque falls"
        f" from {text_of_share(without[j])} to {text_of_share(after[j])}"
    )


def repair_of(claim: Claim) -> LogTransform | None:
    """Return what makes the rows of a part those of the others' arm; None for another
    load, which no change of the log can undo."""
    h = claim.hypothesis
    if h.extra_torque is not None:
        return None
    return h.transform if h.number is None else h.number.at(h.transform, claim.size)


def issue_of_difference(
    log: Likelihood, claim: Claim, name: str, supposed: str
) -> Issue:
    """Return the issue about what is different in one part of a log; what the arm itself
    may do as well is not repaired.

    Parameters
    ----------
    log : Likelihood
        Rows of the part's run.
    name : str
        Of the run, or of the part in words.
    supposed : str
        Of torques that are in no known unit: what a size supposes of them.
    """
    h = claim.hypothesis
    repair = repair_of(claim)
    size = claim.size
    is_gain = h.number is not None and h.number.is_gain
    if is_gain:  # by how much the torque is larger there
        size = float(np.exp(-size)) - 1.0
    heading, fault, only_fault = "", None, None
    if h.arm_difference is not None:
        heading = f"{h.kind} than in the other runs"
        what, remedy = _DIFFERENCES[h.arm_difference]
        more, weight = ("less", "a lighter") if size < 0.0 else ("more", "a heavier")
        unit = log.torque_unit(h.joints[0]) if h.joints else "kg"
        half = _INTERVAL * claim.std
        amount = formatting.amount_or_open(size, half, unit)
        what = what.format(
            run=name,
            amount=f"+{amount}" if size > half else amount,
            weight=weight if abs(size) > half else "another",
            size=abs(size),
            more=more,
            unit=unit,
            supposed=supposed,
            joint=joints_text(h.joints) if h.joints else "",
        )
    else:
        assert repair is not None  # what is no other arm changes the log
        faults = list_faults(log, repair)
        what = f"in {name} only: {' '.join(fault.what for fault in faults)}"
        remedy = f"{', '.join(fault.remedy for fault in faults)} in this run"
        only_fault = faults[0] if len(faults) == 1 else None
        fault = next((fault for fault in faults if fault.kind == h.kind), None)
    of_positions = None if fault is None else fault.of_positions
    rivals = _rivals_of(claim)
    if of_positions == "zero" and h.joints == (log.n - 1,):
        # A load is put on anew from run to run, and a zero is not set.
        rivals.insert(0, "what that joint carries, turned as much about its axis")
    if repair is not None and any(repair_of(rival) is None for rival in claim.rivals):
        repair, only_fault, remedy = None, None, "identify the runs apart"
    return _of_claim(
        claim,
        rivals,
        "one arm for all leaves of a joint's torque {times}",
        kind=h.kind,
        heading=heading,
        in_doubt="" if fault is None else fault.in_doubt,
        is_of_columns=fault is not None and fault.is_of_columns,
        of_positions=of_positions,
        where=joints_text(h.joints) if h.joints else "the run",
        what=what,
        remedy=remedy,
        repair=None if repair is None else repair.apply,
        apply="" if only_fault is None else only_fault.apply,
        changes_positions=only_fault is not None and only_fault.changes_positions,
        changes_order=only_fault is not None and only_fault.changes_order,
        position_unit=h.position_unit,
        is_gain=is_gain,
        is_another_arm=h.arm_difference is not None,
        arm_difference=h.arm_difference,
        joints=h.joints,
        run=name,
        size=size,
    )


def issue_of_span(log: Likelihood, claim: Claim, begin: float, end: float) -> Issue:
    """Return the issue that something pushed the last link from one instant to another
    [s]."""
    # Rows are filtered: what they hold began before them and ends after them.
    begin, end = begin - 1.0 / log.data.cutoff, end + 1.0 / log.data.cutoff
    middle, width = 0.5 * (begin + end), end - begin
    return _of_claim(
        claim,
        _rivals_of(claim),
        "without it one arm leaves of a joint's torque {times}",
        kind=EVENT,
        where=f"t = {begin:.3g} to {end:.3g} s",
        what=f"a force on the last link from t = {begin:.3g} to {end:.3g} s (a contact, a"
        " push) explains what all joints together leave there.",
        remedy=f"exclude {begin:.3g} to {end:.3g} s",
        repair=partial(without_moment, at=middle, width=width),
        at=middle,
        span=(begin, end),
    )
