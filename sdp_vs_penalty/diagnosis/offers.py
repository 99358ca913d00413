"""What a diagnosis offers to add: which findings are shown as one, what goes together,
and which offer is advised."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import chain
from typing import Any, get_args

import numpy as np

from sdp_vs_penalty import formatting
from sdp_vs_penalty.diagnosis.diagnosis_data import DiagnosisData
from sdp_vs_penalty.diagnosis.finding import (
    Finding,
    Retune,
    constants_in_words,
    is_friction,
    named_on_joints,
    names_on_joints,
)
from sdp_vs_penalty.diagnosis.sentences import what_is_missing
from sdp_vs_penalty.effects import effect_in_words
from sdp_vs_penalty.effects.plain_words import ON_THE_ARM, written_in_words
from sdp_vs_penalty.estimation.constants import CHANGES
from sdp_vs_penalty.estimation.outcome import OfferOutcome
from sdp_vs_penalty.estimation.verdict import ABOVE_NOISE, over_noise
from sdp_vs_penalty.results.remedy import GUESSES, Change, Rating, Remedy
from sdp_vs_penalty.robot.arrays import Array, nonzero_or_one

#: Kinds of findings that a button names; more are counted.
_MOST_ON_A_BUTTON = 3


@dataclass(frozen=True)
class Group:
    """What is shown as one and added together: one finding, or those of which the runs
    show the sum alone."""

    #: The findings, in the order of the list.
    findings: tuple[Finding, ...]

    @property
    def first(self) -> Finding:
        """The finding by whose number it is shown."""
        return self.findings[0]

    @property
    def place(self) -> int:
        """Place in the list of findings (from 0)."""
        return self.first.number - 1

    @property
    def texts(self) -> tuple[str, ...]:
        """The findings as :func:`add` takes them."""
        return tuple(finding.text for finding in self.findings)

    @property
    def is_sum(self) -> bool:
        """Whether the runs show the sum of several findings alone."""
        return len(self.findings) > 1

    @property
    def title(self) -> str:
        """What it is, and its place, such as "Stribeck friction, joint 3"."""
        if self.is_sum:
            return formatting.sentence(named_on_joints(self.findings))
        return self.first.title

    @property
    def badge(self) -> str:
        """What is certain of it, or how certain it is."""
        return "sum certain" if self.is_sum else self.first.badge

    @property
    def on_the_arm(self) -> str:
        """A sentence on what it is mechanically on the arm; of a sum what its findings
        have in common."""
        if not self.is_sum:
            return self.first.on_the_arm
        seen = dict.fromkeys(finding.seen_against for finding in self.findings)
        with_what = formatting.words([f"its {name}" for name in seen if name])
        are_friction = all(is_friction(finding.effect) for finding in self.findings)
        what = "friction" if are_friction else "torque"
        changes = f"changes with {with_what}" if with_what else "is another one"
        joint = formatting.joints([self.first.main_joint])
        return f"{ON_THE_ARM}{what} of {joint} {changes}, by a law that is open."


@dataclass(frozen=True)
class Pair:
    """What lowers no error by itself, and the other one beside which it does: shown as one
    and added together."""

    #: What helps only beside the other one.
    found: Finding | Retune
    #: The other one.
    other: Finding | Retune
    #: Whether the other one lowers no error by itself either, and needs this one.
    is_mutual: bool
    #: The joint (from 1) that gains most.
    joint: int
    #: (n,) RMS errors on data left out with both [N m or N].
    after: Array
    #: Both, and their places.
    title: str
    #: What adds both.
    change: Change

    @property
    def texts(self) -> list[str]:
        """Both as :func:`add` takes them."""
        return [self.found.text, self.other.text]


@dataclass(frozen=True, eq=False)
class Offers(Sequence[Remedy]):
    """What a diagnosis offers to add: the offers in their order, which of them is advised,
    what is shown as one, and what goes together."""

    #: What was found, with its errors on data left out.
    diagnosis: DiagnosisData

    def __getitem__(self, place: Any) -> Any:
        """Return the offer at a place (from 0), or those of a slice."""
        return self._all[place]

    def __len__(self) -> int:
        """Return the number of offers."""
        return len(self._all)

    def error_with(self, found: Sequence[Finding | Retune]) -> Array | None:
        """Return the errors (n,) on data left out of the model with some of what was found,
        and nothing else [N m or N]; None where they were not computed."""
        return self.diagnosis.error_with([x.text for x in found])

    def errors_of(self, finding: Finding) -> tuple[Array, Array]:
        """Return a finding's errors on data left out, (n,) before and after it [N m or N]:
        the one figure of its joint that every place says, and what its remedy gives.

        They are those of the model, and of the model with this finding alone, or with
        those of which the runs show the sum alone. Where these were not computed, they
        are those of the ladder, after the findings before it in the list.
        """
        after = self.diagnosis.error_with(self.group_of(finding).texts)
        if after is None:
            ladder = self.diagnosis.ladder
            return ladder[finding.number - 1], ladder[finding.number]
        return self.diagnosis.held_out_rmse_before, after

    def files_lacking(self, texts: Collection[str]) -> tuple[str, ...]:
        """The files of `export` that have no place for one of the findings with these
        texts."""
        lacking = (f.no_place_in for f in self.diagnosis.effects if f.text in texts)
        return tuple(dict.fromkeys(chain.from_iterable(lacking)))

    def offer_of_held_law(self, finding: Finding) -> Remedy | None:
        """Return the offer that adds, in place of a finding, the nearest law that a file
        holds which has no place for the finding; None without one that lowers the error
        of its joint."""
        j = finding.main_joint - 1
        before, _ = self.errors_of(finding)
        after = self.diagnosis.error_with({finding.held_law})
        if after is None or after[j] > (1.0 - CHANGES) * before[j]:
            return None
        name = effect_in_words(finding.held_law)
        change = Change("add", f"add {name}", {"effects": [finding.held_law]})
        errors = tuple(before.tolist()), tuple(after.tolist())
        rating, why = finding.rating_and_why
        verb = "holds" if len(finding.held_law_in) == 1 else "hold"
        why = f"{why}; {formatting.words(finding.held_law_in)} {verb} this law"
        return Remedy(finding.title, rating, why, change, *errors)

    @property
    def selections_of_one(self) -> list[tuple[Finding | Retune, ...]]:
        """What is added by itself: each constant, each group of findings."""
        constants = [(constant,) for constant in self.diagnosis.retuned]
        return [*constants, *(group.findings for group in self.groups)]

    @property
    def selections_of_several(self) -> list[tuple[Finding | Retune, ...]]:
        """What is added together, by the errors of what is added by itself: all that
        helps, what is sure, and what helps and lowers no error by itself with each other
        one that helps."""
        pairs = [
            (found, other)
            for found in self.diagnosis.helpful
            if not self._helps_alone(found)
            for other in self.diagnosis.helpful
            if other is not found
        ]
        return [*filter(None, (self.diagnosis.helpful, self._sure)), *pairs]

    @property
    def selections_of_shown(self) -> list[tuple[Finding | Retune, ...]]:
        """What shows that it helps, by the errors of what is added by itself and in
        pairs; empty where that is all that helps."""
        shown = self._shown
        return [shown] if shown not in ((), self.diagnosis.helpful) else []

    @property
    def _shown(self) -> tuple[Finding | Retune, ...]:
        """What lowers the error of a joint by itself, in its sum, or beside one other."""
        return tuple(
            found
            for found in self.diagnosis.helpful
            if self._helps_alone(found) or self.companion(found)[0] is not None
        )

    @cached_property
    def helping(self) -> tuple[Finding | Retune, ...]:
        """What is offered as a help: what shows that it helps, where that does as much as
        all that helps, and else all of it, since the others help beside it."""
        shown, everything = self._shown, self.diagnosis.helpful
        after = self.error_with(shown) if shown else None
        if after is None or self._takes_curves:
            return everything
        before = self.diagnosis.held_out_rmse_before
        with_all = self.outcome_between(before, self.diagnosis.left_error)
        does_as_much = self.outcome_between(before, after).does_as_much_as(with_all)
        return shown if does_as_much else everything

    @property
    def _takes_curves(self) -> bool:
        """Whether what helps is added with the measured curves."""
        return bool(self.diagnosis.curves) and not self.diagnosis.leaves_curves_out

    def _helps_alone(self, found: Finding | Retune) -> bool:
        """Whether something, or a sum that it belongs to, lowers the error of a joint by
        CHANGES without all others; True where that was not computed."""
        if self.is_in_sum(found):
            return True
        after = self.error_with((found,))
        before = self.diagnosis.held_out_rmse_before
        return after is None or bool(np.any(after < (1.0 - CHANGES) * before))

    def pair_of(self, found: Finding | Retune) -> Pair | None:
        """Return something that lowers no error by itself, with the one other beside which
        it does; None where it helps by itself, or no single other one is known."""
        other, joint = self.companion(found)
        if other is None:
            return None
        after = self.error_with((found, other))
        assert after is not None  # or it would be no companion
        mutual, _ = self.companion(other)
        pair = found, other
        names = formatting.sentence(named_on_joints(pair))
        arguments: dict[str, Any] = {"effects": [x.text for x in pair]}
        if isinstance(found, Finding) and isinstance(other, Finding):
            arguments["findings"] = [found.number, other.number]
        change = Change("add", f"add {named_on_joints(pair)}", arguments)
        return Pair(found, other, mutual is found, joint, after, names, change)

    def shown_of(self, found: Finding | Retune) -> tuple[int, Finding | None]:
        """Return the joint (from 1) whose error the card of something shows, which is the
        one that its number is of, and the finding that acts there; None of a constant."""
        pair = self.pair_of(found)
        both = [found] if pair is None else [pair.found, pair.other]
        acts = [(x.main_joint if isinstance(x, Finding) else x.joint, x) for x in both]
        joint = acts[0][0] if pair is None else pair.joint
        at_joint = [x for j, x in acts if j == joint and isinstance(x, Finding)]
        return joint, next(iter(at_joint), None)

    def companion(self, found: Finding | Retune) -> tuple[Finding | Retune | None, int]:
        """Return which other one that helps something needs, which lowers no error by
        itself, and the joint (from 1) that gains most: the error with both is lower than
        that of the model and that with the other alone. None, 0 without one."""
        before = self.diagnosis.held_out_rmse_before
        scale = (
            before if self.diagnosis.known_floor is None else self.diagnosis.known_floor
        )
        largest, companion, joint = 0.0, None, 0
        for other in () if self._helps_alone(found) else self.diagnosis.helpful:
            both, alone = (self.error_with(x) for x in ((found, other), (other,)))
            if other is found or both is None or alone is None:
                continue
            least = np.minimum(before, alone)
            does_gain = both < (1.0 - CHANGES) * least
            falls = np.where(does_gain, least - both, 0.0) / nonzero_or_one(scale)
            if falls.max() > largest:
                largest, companion = float(falls.max()), other
                joint = int(falls.argmax()) + 1
        return companion, joint

    @cached_property
    def groups(self) -> tuple[Group, ...]:
        """The findings as they are shown and added, in the order of the list: each by
        itself, or with those of which the runs show the sum alone."""
        sums = [
            self._sum_on(joint)
            for joint in {f.main_joint for f in self.diagnosis.effects}
        ]
        sum_by_number = {f.number: findings for findings in sums for f in findings}
        groups = [sum_by_number.get(f.number, (f,)) for f in self.diagnosis.effects]
        return tuple({those[0].number: Group(those) for those in groups}.values())

    def _sum_on(self, joint: int) -> tuple[Finding, ...]:
        """Return the findings on a joint (from 1) of which the runs show the sum alone.

        They are sure, while the size of one or more is open and its torque larger than
        the joint's error: it cancels with that of the others.
        """
        error = self.diagnosis.held_out_rmse_before[joint - 1]
        of_joint = [f for f in self.diagnosis.effects if f.main_joint == joint]
        sure = [f for f in of_joint if f.torque_is_certain]
        cancelling = [
            f for f in sure if f.size_is_open and (f.torque_rms or 0.0) > error
        ]
        # A single one cancels with all that helps there.
        group = cancelling if len(cancelling) > 1 else sure
        return tuple(group) if cancelling and len(group) > 1 else ()

    def group_of(self, finding: Finding) -> Group:
        """Return the group that a finding of the diagnosis belongs to."""
        return next(group for group in self.groups if finding.text in group.texts)

    def is_in_sum(self, found: Finding | Retune) -> bool:
        """Return whether the runs show something in a sum alone."""
        return isinstance(found, Finding) and self.group_of(found).is_sum

    @cached_property
    def _all(self) -> tuple[Remedy, ...]:
        """What would mend the model at once, each with the errors on data left out that
        it leaves: first what is advised (:attr:`main`), then all that helps, what is
        sure together, each re-estimated constant, each group of findings, and each
        nearest law that a file holds in place of one."""
        leaves_spans_out = bool(self.diagnosis.left_out) and not self.diagnosis.frozen
        offers = [self.main] if self.main else []
        if self.diagnosis.helpful or self._takes_curves or leaves_spans_out:
            offers.append(self._offer_of_all)
        if self._sure_together not in ((), self.helping):
            offers.append(self._offer_of_sure)
        offers += [constant.remedy for constant in self.diagnosis.retuned]
        offers += [self.offer_of(group.first) for group in self.groups]
        held_laws = map(self.offer_of_held_law, self.diagnosis.effects)
        offers += [offer for offer in held_laws if offer is not None]
        # Where all that may be advised raises an error, no trifle stands in for it.
        nothing_helps = self.harmful is not None
        offers = [
            replace(x, is_advisable=not (nothing_helps or self._is_harmful(x)))
            for x in offers
        ]
        first_of_each = dict[str, Remedy]()
        for offer in offers:
            first_of_each.setdefault(str(offer.change.arguments), offer)
        return tuple(first_of_each.values())

    def _is_harmful(self, offer: Remedy) -> bool:
        """Whether an offer raises a joint's error on data left out beyond the noise."""
        outcome = self.outcome_of(offer)
        return outcome is not None and bool(outcome.rising)

    def _lowers_an_error(self, offer: Remedy) -> bool:
        """Whether an offer lowers a joint's error on data left out by CHANGES."""
        outcome = self.outcome_of(offer)
        return outcome is not None and outcome.falls(outcome.gains_most)

    @cached_property
    def main(self) -> Remedy | None:
        """The offer that page, terminal and report advise: of those that raise no joint's
        error beyond its noise the one that leaves the lowest errors; of two that do as
        much what is sure together, then what is read first. None where nothing helps, or
        all of it raises an error (:attr:`harmful`)."""
        return self._lowest([x for x in self._candidates if not self._is_harmful(x)])

    @property
    def harmful(self) -> Remedy | None:
        """What would be advised, but raises a joint's error beyond its noise, where nothing
        else helps; None where something is advised, or nothing was found."""
        return self._lowest(self._candidates) if self.main is None else None

    @cached_property
    def _candidates(self) -> tuple[Remedy, ...]:
        """What may be advised: what is sure together, what is read first, all that helps;
        where each of these raises a joint's error any other finding that lowers one and
        is no guess."""
        if not self.diagnosis.helpful:
            return ()
        main = self.main_finding
        choices = [self._offer_of_sure] if self._sure_together else []
        if main is not None and main.rating not in GUESSES:
            alone, together = self.offer_of(main), self._offer_of_all
            choices += [alone] * (alone.change.words != together.change.words)
        choices.append(self._offer_of_all)
        if all(map(self._is_harmful, choices)):
            others = [self.offer_of(group.first) for group in self.groups]
            others = [x for x in others if x.certainty not in GUESSES]
            choices += filter(self._lowers_an_error, others)
        return tuple(choices)

    def _lowest(self, offers: Sequence[Remedy]) -> Remedy | None:
        """Return the first of the offers that does as much as the one which leaves the
        lowest errors; None where their errors were not computed."""
        outcomes = [
            (offer, outcome)
            for offer in offers
            if (outcome := self.outcome_of(offer)) is not None
        ]
        if not outcomes:
            return None
        _, best = min(outcomes, key=lambda x: x[1].size)
        return next(x for x, outcome in outcomes if outcome.does_as_much_as(best))

    @property
    def choices(self) -> tuple[Remedy, ...]:
        """What is advised to add, and the other choice beside it: all that helps, or what is
        read first, with what it needs, where that raises no error. Empty where nothing is
        advised."""
        if self.main is None:
            return ()
        others = [self._offer_of_all]
        if self.main_finding is not None:
            others.append(self.offer_with_companion(self.main_finding))
        others = [x for x in others if x.change.words != self.main.change.words]
        others = [x for x in others if not self._is_harmful(x)]
        return self.main, *others[:1]

    def offer_with_companion(self, finding: Finding) -> Remedy:
        """Return the offer of a finding; of one that lowers no error by itself that of both,
        it and the one beside which it does."""
        offer, pair = self.offer_of(finding), self.pair_of(finding)
        if pair is None:
            return offer
        return replace(
            offer,
            problem=pair.title,
            change=pair.change,
            before=tuple(self.diagnosis.held_out_rmse_before.tolist()),
            after=tuple(pair.after.tolist()),
        )

    def outcome_of(self, offer: Remedy) -> OfferOutcome | None:
        """Return what an offer does to the errors on data left out; None where they were
        not computed."""
        if offer.before is None or offer.after is None:
            return None
        return self.outcome_between(np.array(offer.before), np.array(offer.after))

    def outcome_between(self, before: Array, after: Array) -> OfferOutcome:
        """Return what a change does that leads from errors (n,) on data left out to others
        [N m or N]."""
        units = [self.diagnosis.torque_unit(j + 1) for j in range(len(before))]
        return OfferOutcome(before, after, self.diagnosis.known_floor, units)

    def offer_of(self, finding: Finding) -> Remedy:
        """Return the offer that adds a finding of the diagnosis, with those of which the
        runs show the sum alone; the effects that fit as well are its rivals."""
        group = self.group_of(finding)
        before, after = self.errors_of(finding)
        rivals = tuple(
            Change("add", f"add {written_in_words(rival)}", {"effects": [rival.text]})
            for rival in finding.rivals
        )
        arguments = {
            "effects": [*group.texts],
            "findings": [f.number for f in group.findings],
        }
        return Remedy(
            group.title,
            *finding.rating_and_why,
            Change("add", f"add {named_on_joints(group.findings)}", arguments),
            tuple(before.tolist()),
            tuple(after.tolist()),
            rivals,
        )

    @property
    def _sure(self) -> tuple[Finding | Retune, ...]:
        """What helps and surely is the effect that it is called, in whatever law of it.
        Left out is what lowers no error by itself, what is of open size where the rest is
        not, and constants where not all that helps is sure, since these have no number.
        """
        sure = [
            f
            for f in self.helping
            if f.rating == "confident"
            or (isinstance(f, Finding) and f.effect_is_certain)
            if not self.is_in_sum(f)
            if isinstance(f, Retune) or max(self._falls(f)) > 0.0
        ]
        of_known_size = [f for f in sure if isinstance(f, Retune) or not f.size_is_open]
        sure = of_known_size or sure
        is_all = len(sure) == len(self.helping)
        return tuple(f for f in sure if is_all or isinstance(f, Finding))

    @property
    def _sure_together(self) -> tuple[Finding | Retune, ...]:
        """What is sure, where that is several, the main finding among them, or all that
        helps where all but the main one is confident; none where its errors were not
        computed."""
        main, together = self.main_finding, self._sure
        others = [f for f in self.helping if f is not main]
        if main not in together and all(f.rating == "confident" for f in others):
            together = self.helping
        has_errors = self.error_with(together) is not None
        is_several = main in together and len(together) > 1
        return together if has_errors and is_several else ()

    @property
    def _offer_of_sure(self) -> Remedy:
        """The offer that adds what is sure together."""
        together = self._sure_together
        if together == self.helping:
            return self._offer_of_all
        findings = [f for f in self.in_order_of_reading if f in together]
        after = self.error_with(together)
        assert after is not None  # or they would not be together
        named, numbers = named_on_joints(findings), [f.number for f in findings]
        return self._offer_of_several(together, named, "surest", numbers, after)

    @property
    def _offer_of_all(self) -> Remedy:
        """The offer that adds what helps, with the curves where these stay."""
        which: str | list[int] | None = "all" if self._takes_curves else "helpful"
        after = self.diagnosis.left_error
        if self.helping != self.diagnosis.helpful:
            if len(self.helping) == 1 and isinstance(self.helping[0], Finding):
                return self.offer_of(self.helping[0])
            numbers = [f.number for f in self.helping if isinstance(f, Finding)]
            which = numbers if len(numbers) == len(self.helping) else None
            shown = self.error_with(self.helping)
            assert shown is not None  # or all that helps would be offered
            after = shown
        offer = self._offer_of_several(
            self.helping, what_is_missing(self.diagnosis), "that help", which, after
        )
        words = offer.change.words
        if self._takes_curves:
            on = formatting.joints([curve.joint for curve in self.diagnosis.curves])
            begin = f"{words} and" if self.diagnosis.helpful else "add"
            words = f"{begin} the measured curve of {on}"
        elif not self.diagnosis.helpful:
            words = "leave out the spans in which something passes"
        return replace(offer, change=replace(offer.change, words=words))

    def _offer_of_several(
        self,
        found: Sequence[Finding | Retune],
        problem: str,
        counted: str,
        which: str | list[int] | None,
        after: Array,
    ) -> Remedy:
        """Return the offer that adds several together, with the errors ``after`` (n,) that
        this leaves [N m or N]. A button names few kinds, and counts more, which are
        ``counted``; ``which`` is None of constants beside findings, which have no number."""
        arguments: dict[str, Any] = {"effects": [f.text for f in found]}
        if which is not None:
            arguments["findings"] = which
        is_confident = all(f.rating == "confident" for f in found)
        names = names_on_joints([f for f in self.in_order_of_reading if f in found])
        constants = [f for f in found if isinstance(f, Retune)]
        if len(found) == 1:
            names = names_on_joints(found)
        elif constants:
            names.append(constants_in_words(constants))
        words = f"the {len(found)} {counted}"
        if 0 < len(names) <= _MOST_ON_A_BUTTON:
            words = formatting.words(names)
        return Remedy(
            problem,
            "confident" if is_confident else "near-tie",
            "judged on data left out",
            Change("add", f"add {words}", arguments),
            tuple(self.diagnosis.held_out_rmse_before.tolist()),
            tuple(after.tolist()),
        )

    @property
    def in_order_of_reading(self) -> list[Finding]:
        """The findings as they are read: of those whose torque is certain first what
        lowers the error of the joint that errs most; after that what has no size, and what
        explains an error within the noise, by rating and evidence."""
        ratings = get_args(Rating)
        return sorted(
            self.diagnosis.effects,
            key=lambda f: (
                not f.torque_is_certain,
                self.is_within_noise(f),
                f.size_may_be_zero and not self.is_in_sum(f),
                *(-fall for fall in self._falls(f) if not self.is_within_noise(f)),
                ratings.index(f.rating),
                -f.gain,
            ),
        )

    @property
    def groups_in_order_of_reading(self) -> list[Group]:
        """The groups of findings as they are read, each where its first finding is."""
        groups = ((f, self.group_of(f)) for f in self.in_order_of_reading)
        return [group for finding, group in groups if finding is group.first]

    def _falls(self, finding: Finding) -> list[float]:
        """Return by how much a finding alone lowers the error of each joint, from the one
        that errs most on, in multiples of its noise where that is known; a change of
        less than CHANGES is none."""
        before, after = errors = np.stack(self.errors_of(finding))
        over = over_noise(errors, self.diagnosis.known_floor)
        was, now = errors if over is None else over
        falls = np.where(after < (1.0 - CHANGES) * before, was - now, 0.0)
        return list(map(float, falls[np.argsort(-was, kind="stable")]))

    def is_within_noise(self, finding: Finding) -> bool:
        """Whether no joint of a finding errs by more than ABOVE_NOISE times its noise as
        the model is: little is to be won."""
        over = over_noise(self.errors_of(finding)[0], self.diagnosis.known_floor)
        joints = [joint - 1 for joint in finding.joints]
        return (
            over is not None and float(over[joints or slice(None)].max()) <= ABOVE_NOISE
        )

    @property
    def main_finding(self) -> Finding | None:
        """The first of the findings whose torque is certain, as they are read; None
        without one."""
        return next((f for f in self.in_order_of_reading if f.torque_is_certain), None)
