"""One race of hypotheses. In each round all are screened on few rows, the best are fitted on
all rows, and the best of these is taken; claims that were taken before are judged again beside
it. A claim names the rivals that are as likely."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from types import ModuleType
from typing import NamedTuple

import numpy as np
from scipy.special import log_ndtr, softmax

from sdp_vs_penalty.problem.problem import Problem
from sdp_vs_penalty.race import constants as c
from sdp_vs_penalty.race.chain import LogTransform
from sdp_vs_penalty.race.evidence import Evidence, ViewFit
from sdp_vs_penalty.race.kinds import (
    KINDS,
    NOT_OF_ONE_RUN,
    gain,
    list_faults,
    of_one_part,
    position_unit,
    sign,
)
from sdp_vs_penalty.race.likelihood import Likelihood
from sdp_vs_penalty.race.records import ExtraTorque, Hypothesis, LogView, Number, Part
from sdp_vs_penalty.regression.evidence import standard_errors_above_zero
from sdp_vs_penalty.robot.arrays import Array

#: Newton steps by which a size is found on few rows, at most, and share of the size's
#: standard deviation below which a step is the last one.
_STEPS, _SHORT = 8, 0.2
#: Largest first step of a size, and largest step, in standard deviations beforehand.
_FIRST_STEP, _LARGEST_STEP = 0.7, 1.0
#: Rounds of reweighting at the first entry.
_ROUNDS_OF_A_LOOK = 2
#: Largest rise of a change's log-odds by a claim, beyond what the claim explains.
_MORE_ODDS = 100.0
#: Fits in which columns that depend on their size are made anew, each with the size of the
#: last one.
_ROUNDS_OF_COLUMNS = 3
#: Units of positions that differ by less are one (natural logarithm).
_NEAR_UNIT = 0.1
#: A run may have any fault of its own if the arm of all runs leaves more than the first share
#: of a torque's energy, and of the other runs more than the second number times what an arm
#: leaves that is fitted to these alone.
_CONTRADICTS, _CONFUSED = 1e-3, 3.0
#: Odds of a claim beside the least likely of its rivals.
_LEAST_ODDS = 20.0
#: Factor of a size's prior standard deviation while it is searched: the prior must not hold
#: a step towards a far size back.
_LOOSE = 10.0


@dataclass(frozen=True)
class Claim:
    """A hypothesis at its best size, beside an incumbent."""

    #: What is judged.
    hypothesis: Hypothesis
    #: Natural logarithm of its odds against the incumbent.
    log_odds: float
    #: The fit where it holds.
    fit: ViewFit
    #: The fit without it.
    before: ViewFit
    #: Its size, in its own unit; of a load its mass [kg].
    size: float = 0.0
    #: Standard deviation of the size.
    std: float = 0.0
    #: What its freedom costs.
    occam: float = 0.0
    #: What is as likely, the likeliest first, where it was taken.
    rivals: tuple[Claim, ...] = ()

    def with_fits(self, before: ViewFit, fit: ViewFit) -> Claim:
        """Return the claim with the log-odds of a fit with it against a fit ``before``
        without it. Both count as many rows as one independent row."""
        odds = fit.log_evidence - before.log_evidence + self.prior
        return replace(self, log_odds=odds, fit=fit, before=before)

    @property
    def concerns_all_rows(self) -> bool:
        """Whether it is about a transform of all rows."""
        hypothesis = self.hypothesis
        return (
            hypothesis.part is None
            and hypothesis.extra_torque is None
            and hypothesis.is_friction_dissipative
        )

    @property
    def prior(self) -> float:
        """Natural logarithm of its odds beforehand, and of what its freedom costs."""
        return self.hypothesis.log_prior + self.occam

    @property
    def probabilities(self) -> Array:
        """(1 + R,) probabilities of the claim and of its R rivals, given that one of them is
        right.

        They are the softmax of the log-odds, which are overconfident: they are divided
        first, so that a rival LOG_ODDS_OF_A_CLAIM behind has odds of one to twenty.
        """
        log_odds = np.array([x.log_odds for x in (self, *self.rivals)])
        overconfidence = c.LOG_ODDS_OF_A_CLAIM / float(np.log(_LEAST_ODDS))
        return np.asarray(softmax(log_odds / overconfidence))

    @property
    def is_usual(self) -> bool:
        """Whether healthy arms and loggers have such a size, up to its errors."""
        number, extra = self.hypothesis.number, self.hypothesis.extra_torque
        tolerance = c.SIGMAS_BEYOND_USUAL * self.std
        if extra is not None and extra.usual:
            return abs(self.size) <= extra.usual + tolerance
        if number is None:
            return self.hypothesis.is_usual
        below = number.usual if number.usual_below is None else number.usual_below
        return -below - tolerance <= self.size <= number.usual + tolerance


@dataclass(frozen=True)
class RaceOutcome:
    """What the race says of a log."""

    #: What was taken, in this order.
    claims: tuple[Claim, ...]
    #: How the rows are seen with all of it.
    view: LogView
    #: The fit to them.
    fit: ViewFit
    #: Whether the motion has few directions, in which much explains much.
    is_doubtful: bool = False

    def claims_on_all_rows(self) -> list[Claim]:
        """List the claims about faults of the log that all its rows have: no effects of
        the arm, and no differences of one part."""
        return [
            claim
            for claim in self.claims
            if not (claim.hypothesis.part or claim.hypothesis.effect)
        ]

    def is_sure_of(self, claim: Claim) -> bool:
        """Whether a claim may be called likely.

        Its log-odds must be at least LIKELY: claims of such odds have been right. And the
        arm must explain the torques well, or the claim must halve the unexplained energy.
        Three kinds of claims are never likely: those that only friction's sign shows, those
        of a motion of few directions, and all while the unit of positions has a rival.
        """
        first = self.claims[0]
        is_unit_open = first.hypothesis.position_unit is not None
        is_unit_open &= any(x.concerns_all_rows for x in first.rivals)
        has_no_witness = claim.hypothesis.tells_by_friction or self.is_doubtful
        has_no_witness |= is_unit_open
        if has_no_witness or claim.log_odds < c.LIKELY:
            return False
        moving = self.fit.weights > 0.0
        before, after = (x.shares_left[moving] for x in (claim.before, claim.fit))
        ratio = float(after.sum() / before.sum())
        return self.is_well_explained or ratio <= 0.5

    @property
    def is_well_explained(self) -> bool:
        """Whether little is left of every joint's torque with all that was taken."""
        return not self.fit.is_badly_explained

    def differences(self) -> list[Claim]:
        """List the claims about one part of the log, but for sizes that healthy arms and
        loggers have as well."""
        return [x for x in self.claims if x.hypothesis.part and not x.is_usual]

    def without_usual(self, log: Likelihood) -> LogTransform:
        """Return the transform of all rows that repairs what is claimed.

        Sizes that healthy arms and loggers have are not repaired: they are no fault.
        """
        transform = self.view.transform
        usual = {x.hypothesis.name for x in self.claims if x.is_usual}
        unusual = {x.hypothesis.name for x in self.claims if not x.is_usual}
        for name in usual - unusual:
            for fault in list_faults(log, transform):
                if fault.name == name:
                    transform = fault.without
        return transform


class HeldRaces:
    """The races that were held in one call, for the copies of a log that it judges.

    A repaired copy often has the very rows that the log was judged by, as they would be
    repaired: its race is that of the log.
    """

    def __init__(self) -> None:
        """Begin without any race."""
        self._held: dict[object, tuple[Problem, RaceOutcome]] = {}

    def hold(
        self,
        logs: Sequence[Likelihood],
        kinds: tuple[ModuleType, ...],
        is_doubtful: bool,
    ) -> RaceOutcome:
        """Return the outcome of a :class:`Race` with these arguments; that of an earlier
        call if the rows and the robot are the same."""
        problem = logs[0].problem
        key = tuple(log.data.digest for log in logs), kinds, is_doubtful
        held = self._held.get(key)
        if held is None or held[0] is not problem:
            held = problem, Race(logs, kinds, is_doubtful).run()
            self._held[key] = held
        return held[1]


class _Screened(NamedTuple):
    """What the first look, at few rows, says of a hypothesis."""

    #: Natural logarithm of its odds against the incumbent.
    log_odds: float
    #: What is looked at.
    hypothesis: Hypothesis
    #: Change of its size to first order; 0 where it has none, or is at its size.
    step: float = 0.0

    @property
    def suggests_patterns(self) -> bool:
        """Whether several joints may have a mistake that one seems to have."""
        return self.hypothesis.suggests_patterns and self.log_odds > c.WORTH_A_LOOK


class _FoundSize(NamedTuple):
    """The best size of a hypothesis."""

    #: In its own unit.
    size: float = 0.0
    #: Its standard deviation.
    std: float = 0.0
    #: Natural logarithm of the odds that the freedom of the size costs.
    occam: float = 0.0


class Race:
    """The race of all hypotheses about one log.

    logs : rows of each run; kinds : those that the log's motion shows;
    is_doubtful : whether its motion has few directions, in which much explains much.
    """

    def __init__(
        self,
        logs: Sequence[Likelihood],
        kinds: tuple[ModuleType, ...] = KINDS,
        is_doubtful: bool = False,
    ) -> None:
        """Take the rows of all runs, thinned to as many as one run has."""
        self.kinds = kinds
        self.is_doubtful = is_doubtful
        self.all_rows = Evidence(Likelihood.of_all_runs(logs).with_all_laws)
        self.few_rows = self.all_rows.of_rows(slice(None, None, c.THIN))
        #: Log-odds of changes at the first look, by key and place among those of a key.
        self.first_looks: dict[object, float] = {}
        #: Rows beside those of a run, by the run.
        self._others: dict[Part, Evidence] = {}

    def run(self) -> RaceOutcome:
        """Take the best hypothesis until none is likely.

        After each, the claims that were taken before are judged again beside it.
        """
        taken: list[Claim] = []
        fit = self._fit_incumbent(LogView(self.all_rows.log.as_logged))
        while len(taken) < c.MAX_FAULTS:
            last = taken[-1].log_odds if taken else np.inf
            claim = self._best_claim(fit, last + _MORE_ODDS)
            if claim is None:
                break
            taken.append(self._choose_by_looking_ahead(claim, fit))
            fit = self._fit_incumbent(taken[-1].fit.view)
            for place in range(len(taken) - 1):
                taken[place], fit = self._rejudge(taken[place], fit)
        if taken and self._must_ask_for_unit(taken[0], fit):
            as_logged = self._fit_incumbent(LogView(self.all_rows.log.as_logged))
            return RaceOutcome((), as_logged.view, as_logged, self.is_doubtful)
        return RaceOutcome(tuple(taken), fit.view, fit, self.is_doubtful)

    def _must_ask_for_unit(self, claim: Claim, fit: ViewFit) -> bool:
        """Whether only the joints' ranges, and not the torques, speak for the first claim,
        a unit of positions: the user is then asked for it."""
        without_ranges = claim.log_odds - c.MAX_PHYSICS_LOG_ODDS
        is_open = without_ranges < c.LOG_ODDS_OF_A_CLAIM
        return is_open and fit.is_badly_explained and self._is_by_ranges(claim)

    def _is_by_ranges(self, claim: Claim) -> bool:
        """Whether the joints' ranges speak for a claim."""
        before, after = (
            self.all_rows.range_evidence(x.view) for x in (claim.before, claim.fit)
        )
        return before < after

    def _choose_by_looking_ahead(self, claim: Claim, fit: ViewFit) -> Claim:
        """Return a claim, or the rival of it that explains more together with the next
        claim: two faults hide each other.

        ``fit`` is that of the incumbent, without the claim.
        """
        firsts = [claim, *(x for x in claim.rivals if x.concerns_all_rows)]
        if self._is_by_ranges(claim):
            firsts += self._likelier_units(claim, fit, firsts)
        if len(firsts) < 2 or not claim.concerns_all_rows:
            return claim
        log_odds = self._log_odds_with_next_claims(firsts)
        best = firsts[int(np.argmax(log_odds))]
        others = [x for x in (claim, *claim.rivals) if x is not best]
        return replace(best, rivals=tuple(others))

    def _likelier_units(
        self, claim: Claim, fit: ViewFit, known: Sequence[Claim]
    ) -> list[Claim]:
        """List the units of positions for which the joints' ranges speak as well, and
        whose prior is larger than that of a claim; those ``known`` are left out."""
        units: list[Claim] = []
        for hypothesis in position_unit.propose(self.all_rows, fit):
            view = hypothesis.applied_to(fit.view)
            unit = Claim(
                hypothesis, 0.0, self.all_rows.fit(view, fit.rows_worth_one), before=fit
            )
            is_known = any(_is_same(unit, x) for x in (*known, *units))
            if unit.prior > claim.prior and not is_known and self._is_by_ranges(unit):
                units.append(unit)
        return units

    def _log_odds_with_next_claims(self, firsts: Sequence[Claim]) -> list[float]:
        """Return for each claim the log evidence plus log prior of the claim and of the
        best claim after it, both together."""
        remembered = self.first_looks
        ends: list[tuple[float, ViewFit]] = []  # prior and fit of both claims
        for first in firsts:
            self.first_looks = {}
            with_first = self._fit_incumbent(first.fit.view)
            second = self._best_claim(with_first, np.inf)
            if second is None:
                ends.append((first.prior, with_first))
            else:
                ends.append((first.prior + second.prior, second.fit))
        self.first_looks = remembered
        rows_worth_one = min(fit.rows_worth_one for _, fit in ends)
        return [
            prior + self.all_rows.with_rows_worth_one(fit, rows_worth_one).log_evidence
            for prior, fit in ends
        ]

    def _rejudge(self, claim: Claim, fit: ViewFit) -> tuple[Claim, ViewFit]:
        """Judge a claim and its rivals again beside the claims that were taken after it:
        a rival may be likelier, once a fault that hid it is undone.

        Parameters
        ----------
        fit : ViewFit
            With all claims that were taken.

        Returns
        -------
        tuple of (Claim, ViewFit)
            The likeliest one, with its rivals, and the fit with it and all other claims.
        """
        if not claim.concerns_all_rows:
            return claim, fit
        # Log-odds of each against the claim, and the fit with it in the claim's place.
        judged = [self._in_place_of(claim, rival, fit) for rival in claim.rivals]
        if self._is_by_ranges(claim):
            undone = claim.before.transform.with_change(
                claim.fit.transform, fit.transform
            )
            without = self._refit(fit, undone)
            log_odds = fit.log_evidence - without.log_evidence + claim.prior
            claim = replace(claim, log_odds=log_odds)
        judged.append((0.0, claim, fit))
        highest = max(log_odds for log_odds, _, _ in judged)
        best, best_fit = claim, fit
        if highest > 0.0:
            best, best_fit = next((x, y) for odds, x, y in judged if odds == highest)
        rivals = tuple(
            replace(x, log_odds=best.log_odds + odds - highest)
            for odds, x, _ in judged
            if highest - odds < c.LOG_ODDS_OF_A_CLAIM and x is not best
        )
        if best is not claim:
            fit = self._fit_incumbent(best_fit.view)
        return replace(best, rivals=rivals), fit

    def _in_place_of(
        self, claim: Claim, rival: Claim, fit: ViewFit
    ) -> tuple[float, Claim, ViewFit]:
        """Return the log-odds of a rival against a claim, the rival, and the fit with the
        rival in the claim's place; ``fit`` has the claim. A rival about a part of the rows
        counts as equally likely."""
        if not rival.concerns_all_rows:
            return 0.0, rival, fit
        transform = rival.fit.transform.with_change(claim.fit.transform, fit.transform)
        with_rival = self._refit(fit, transform)
        rise = with_rival.log_evidence - fit.log_evidence
        return rise + rival.prior - claim.prior, rival, with_rival

    def _refit(self, fit: ViewFit, transform: LogTransform) -> ViewFit:
        """Return the fit to the same view under another transform of all rows."""
        view = fit.view.with_transform(transform)
        return self.all_rows.fit(view, fit.rows_worth_one)

    def _fit_incumbent(self, view: LogView) -> ViewFit:
        """Return the fit to all rows of a view, with the number of correlated rows worth
        one independent row that the residual of a first fit shows."""
        fit = self.all_rows.fit(view, 1.0)
        return self.all_rows.with_rows_worth_one(
            fit, self.all_rows.estimate_rows_worth_one(fit)
        )

    def _best_claim(self, fit: ViewFit, max_rise: float) -> Claim | None:
        """Return the likeliest claim beside an incumbent's fit that held-out parts of the
        log confirm, with its rivals; None where there is none.

        max_rise : see :meth:`_screen`.
        """
        ranking = self.rank(fit, max_rise)
        likely = [x for x in ranking if x.log_odds > c.LOG_ODDS_OF_A_CLAIM]
        confirmed = (self.confirmed_claim(claim, fit) for claim in likely)
        best = next((claim for claim in confirmed if claim is not None), None)
        if best is None:
            return None
        rivals: dict[object, Claim] = {}
        for claim in likely:
            is_as_likely = best.log_odds - claim.log_odds < c.LOG_ODDS_OF_A_CLAIM
            is_rival = is_as_likely or _fits_as_well(claim, best)
            if is_rival and not _is_same(claim, best):
                rivals.setdefault(claim.hypothesis.key, claim)
        rivals.pop(best.hypothesis.key, None)
        return replace(best, rivals=tuple(rivals.values()))

    def rank(self, fit: ViewFit, max_rise: float = np.inf) -> list[Claim]:
        """List claims beside an incumbent's fit, the likeliest first.

        All hypotheses are screened on few rows; the best of them are fitted to all rows at
        their best size. All are compared with one number of rows worth one independent
        row, that of the whitest residual. max_rise : see :meth:`_screen`.
        """
        view = replace(
            fit.view, extra_torques=tuple(map(_thinned, fit.view.extra_torques))
        )
        few_fit = self.few_rows.fit(view, 1.0)
        screened = self._screen(fit, few_fit, max_rise)
        tried = [self._fit_on_all_rows(entry, fit, few_fit) for entry in screened]
        claims = [claim for claim in tried if claim is not None]
        likely = [x.fit.rows_worth_one for x in claims if x.log_odds > c.WORTH_A_LOOK]
        rows_worth_one = min([fit.rows_worth_one, *likely])
        incumbent = self.all_rows.with_rows_worth_one(fit, rows_worth_one)
        ranking = [
            x.with_fits(
                incumbent, self.all_rows.with_rows_worth_one(x.fit, rows_worth_one)
            )
            for x in claims
        ]
        return sorted(ranking, key=lambda claim: -claim.log_odds)

    def _screen(
        self, fit: ViewFit, few_fit: ViewFit, max_rise: float
    ) -> list[_Screened]:
        """List the hypotheses that are worth a fit to all rows, of each key the best.

        Parameters
        ----------
        fit, few_fit : ViewFit
            The incumbent's, to all rows and to few. Each of the few counts as
            independent: a wrong incumbent leaves a correlated residual, but the right
            hypothesis may leave white noise.
        max_rise : float
            By how much a claim may raise another one's log-odds: hypotheses that were
            below minus this number when they were screened before are left out.
        """
        about_all_rows = _propose(self.kinds, self.all_rows, fit)
        proposed = [*about_all_rows, *self._propose_for_parts(about_all_rows, fit)]
        screened = self._screen_on_few_rows(proposed, fit, few_fit, max_rise)
        suggesting = [x.hypothesis.kind for x in screened if x.suggests_patterns]
        if suggesting and not fit.may_be_rearranged:
            several = [*sign.patterns(self.all_rows, fit, suggesting[0])]
            screened += self._screen_on_few_rows(several, fit, few_fit, max_rise)
        for distances in of_one_part.NEARER:
            screened += self._screen_near_likeliest_onset(
                screened, distances, fit, few_fit
            )
        return _best_of_each_key(screened)

    def _screen_on_few_rows(
        self,
        proposed: Sequence[Hypothesis],
        fit: ViewFit,
        few_fit: ViewFit,
        max_rise: float,
    ) -> list[_Screened]:
        """Return the log-odds of each hypothesis beside the incumbent, by few rows.

        Small changes of a number, and extra columns of torque, are screened to first order;
        other changes of the log are fitted. Parameters: see :meth:`_screen`.
        """
        screened: list[_Screened] = []
        with_number: list[Hypothesis] = []
        with_columns: list[Hypothesis] = []
        changes: dict[tuple[object, int], Hypothesis] = {}
        count: Counter[object] = Counter()
        for hypothesis in proposed:
            if hypothesis.extra_torque is not None:
                with_columns.append(hypothesis)
            elif not hypothesis.is_friction_dissipative:
                odds = -few_fit.friction_evidence + hypothesis.log_prior
                screened.append(_Screened(odds, hypothesis))
            elif self._begins_at_incumbent(hypothesis, fit):
                with_number.append(hypothesis)
            else:
                count[hypothesis.key] += 1
                key: tuple[object, int] = hypothesis.key, count[hypothesis.key]
                if self.first_looks.get(key, 0.0) > -max_rise:
                    changes[key] = hypothesis
        rows_over_few = _rows_over_few(fit)
        screened += self._screen_to_first_order(
            few_fit, with_number, with_columns, rows_over_few
        )
        views = [hypothesis.applied_to(few_fit.view) for hypothesis in changes.values()]
        values = self.few_rows.values(views, 1.0, _ROUNDS_OF_A_LOOK)
        for (key, hypothesis), value in zip(changes.items(), values, strict=True):
            rise = value - few_fit.log_evidence
            odds = float(rows_over_few * rise + hypothesis.log_prior)
            self.first_looks[key] = odds
            screened.append(_Screened(odds, hypothesis))
        return screened

    def _begins_at_incumbent(self, hypothesis: Hypothesis, fit: ViewFit) -> bool:
        """Whether a hypothesis changes a number of the incumbent's transform, or of a
        part's rows as logged, from the size that it has there."""
        begin = fit.transform
        if hypothesis.part is not None:
            begin = self.all_rows.log.as_logged
        return hypothesis.number is not None and hypothesis.transform == begin

    def _screen_near_likeliest_onset(
        self,
        screened: Sequence[_Screened],
        distances: Array,
        fit: ViewFit,
        few_fit: ViewFit,
    ) -> list[_Screened]:
        """Screen loads and other arms that begin near the likeliest instant so far: one
        that begins at a wrong instant explains little.

        Parameters
        ----------
        screened : sequence of _Screened
            Hypotheses with their log-odds, from which the likeliest instant is taken.
        distances : (k,) array
            Distances of the new instants from it, evenly spaced, as shares of the rows.
        """
        instants = [
            (entry.log_odds, part.after)
            for entry in screened
            if entry.hypothesis.extra_torque is not None
            and (part := entry.hypothesis.part) is not None
            and part.after is not None
            and part.until is None
        ]
        if not instants or not fit.is_badly_explained:
            return []
        _, likeliest = max(instants)
        parts = of_one_part.parts_near(self.all_rows, likeliest, distances)
        n_possible = round(1.0 / float(np.diff(distances)[0]))
        of_parts = of_one_part.in_parts(self.all_rows, fit, parts, n_possible)
        return self._screen_to_first_order(
            few_fit, [], [*of_parts], _rows_over_few(fit)
        )

    def _propose_for_parts(
        self, about_all_rows: Sequence[Hypothesis], fit: ViewFit
    ) -> Iterator[Hypothesis]:
        """Yield the hypotheses about all rows again, each confined to one part of them: a
        run, or what follows an instant.

        Of suspect parts any fault is proposed, as if they were a log of their own.
        """
        if of_one_part not in self.kinds:
            return
        as_logged = self.all_rows.log.as_logged
        kinds = [kind for kind in self.kinds if kind not in NOT_OF_ONE_RUN]
        scaled = [*gain.of_all_torques(as_logged)]
        parts = of_one_part.parts_of(self.all_rows)
        odds = c.LOG_ODDS_AGAINST_DIFFERENCE - c.LOG_ODDS_AGAINST_FAULT
        odds += float(np.log(len(parts)))
        suspects = [part for part in parts if self._is_suspect(part, fit)]
        if fit.transform != as_logged:
            unrepaired = replace(fit, view=replace(fit.view, transform=as_logged))
            about_all_rows = _propose(kinds, self.all_rows, unrepaired)
        others = [part for part in parts if part not in suspects]
        proposed = [*about_all_rows, *scaled]
        yield from of_one_part.confined(proposed, as_logged, others, odds)
        for part in suspects:
            run = self.all_rows.of_rows(np.flatnonzero(self.all_rows.rows_of(part)))
            run_fit = run.fit(LogView(as_logged), fit.rows_worth_one)
            # Kinds are proposed by what the arm of all runs leaves.
            run_fit = replace(run_fit, energy_left=fit.shares_left * run_fit.total)
            proposed = [*scaled, *_propose(kinds, run, run_fit)]
            yield from of_one_part.confined(proposed, as_logged, [part], odds, True)

    def _is_suspect(self, part: Part, fit: ViewFit) -> bool:
        """Whether a run may have any fault of its own.

        That is so if the arm of all runs leaves much of a torque, and of the other runs far
        more than an arm that is fitted to these alone.
        """
        if part.run is None or not (fit.shares_left > _CONTRADICTS).any():
            return False
        others = ~self.all_rows.rows_of(part)
        if part not in self._others:
            self._others[part] = self.all_rows.of_rows(np.flatnonzero(others))
        others_fit = self._others[part].fit(
            replace(fit.view, extra_torques=()), fit.rows_worth_one
        )
        left_by_all = np.sum(self.all_rows.residual(fit)[:, others] ** 2, axis=1)
        is_confused = left_by_all > _CONFUSED * others_fit.energy_left  # (n,)
        return bool(is_confused[self.all_rows.log.moving].any())

    def _screen_to_first_order(
        self,
        few_fit: ViewFit,
        with_number: Sequence[Hypothesis],
        with_columns: Sequence[Hypothesis],
        rows_over_few: float,
    ) -> list[_Screened]:
        """Return the log-odds of hypotheses about a number, and about extra torque, each
        as columns added to the incumbent's regression on few rows.

        The column of a number is the torque's derivative by it. ``rows_over_few`` is the
        ratio of the evidence of all rows to that of the few.
        """
        numbers = [x.number for x in with_number if x.number]
        sizes = [
            number.size_in(x.transform)
            for number, x in zip(numbers, with_number, strict=True)
        ]
        slopes = self.few_rows.slopes(few_fit, with_number, sizes)
        groups = [
            (slopes[:, :, k : k + 1], np.array([number.sd]))
            for k, number in enumerate(numbers)
        ]
        extra = [_thinned(x.extra_torque) for x in with_columns if x.extra_torque]
        groups += [(x.columns, x.sd) for x in extra]
        if not groups:
            return []
        rises, steps = self.few_rows.screen(few_fit, groups)
        return [
            _Screened(
                rows_over_few * rise + hypothesis.log_prior, hypothesis, float(step)
            )
            for hypothesis, rise, step in zip(
                [*with_number, *with_columns], rises, steps, strict=True
            )
        ]

    def _fit_on_all_rows(
        self, entry: _Screened, fit: ViewFit, few_fit: ViewFit
    ) -> Claim | None:
        """Return a hypothesis at its best size as a claim, by a fit to all rows; None if
        few rows speak against it at that size.

        fit, few_fit : the incumbent's, to all rows and to few.
        """
        hypothesis = entry.hypothesis
        best: _FoundSize | None = _FoundSize()
        if hypothesis.number is not None:
            best = self._best_size(entry, hypothesis.number, fit, few_fit)
        if best is None:
            return None
        with_hypothesis = self.all_rows.fit(
            hypothesis.applied_to(fit.view, best.size), fit.rows_worth_one
        )
        for _ in range(_ROUNDS_OF_COLUMNS if hypothesis.extra_torque_at else 0):
            assert hypothesis.extra_torque is not None
            assert hypothesis.extra_torque_at is not None
            # Sizes of extra columns stand last in theta.
            first_size = float(with_hypothesis.theta[-len(hypothesis.extra_torque.sd)])
            hypothesis = replace(
                hypothesis, extra_torque=hypothesis.extra_torque_at(first_size)
            )
            with_hypothesis = self.all_rows.fit(
                hypothesis.applied_to(fit.view), fit.rows_worth_one
            )
        rows_worth_one = min(
            self.all_rows.estimate_rows_worth_one(with_hypothesis), fit.rows_worth_one
        )
        with_hypothesis = self.all_rows.with_rows_worth_one(
            with_hypothesis, rows_worth_one
        )
        if hypothesis.extra_torque is not None:
            best = _size_of_columns(
                with_hypothesis, hypothesis.extra_torque, best.occam
            )
        incumbent = self.all_rows.with_rows_worth_one(fit, rows_worth_one)
        return Claim(hypothesis, 0.0, with_hypothesis, incumbent, *best).with_fits(
            incumbent, with_hypothesis
        )

    def _best_size(
        self, entry: _Screened, number: Number, fit: ViewFit, few_fit: ViewFit
    ) -> _FoundSize | None:
        """Return the best size of a hypothesis about a number; None if few rows speak
        against it at that size.

        The size is sought on few rows and refined on all. It is rounded to a round size
        (a quarter turn, a factor of ten) within its error. Its price is the Occam factor:
        posterior over prior width, and the prior's density there.
        """
        hypothesis = entry.hypothesis
        farthest = _FIRST_STEP * number.sd
        start = number.size_in(hypothesis.transform)
        size = start + float(np.clip(entry.step, -farthest, farthest))
        size, _ = self._newton_size(self.few_rows, few_fit, hypothesis, size, _STEPS)
        with_size = self.few_rows.fit(hypothesis.applied_to(few_fit.view, size), 1.0)
        rise = _rows_over_few(fit) * (with_size.log_evidence - few_fit.log_evidence)
        if rise + hypothesis.log_prior < c.WORTH_A_LOOK:
            return None
        size, std = self._newton_size(self.all_rows, fit, hypothesis, size, 1)
        change = size - (0.0 if hypothesis.part else number.size_in(fit.transform))
        occam = float(np.log(min(1.0, std / number.sd)))
        tolerance = number.usual + c.NUMBER_SIGMAS * std
        tolerance = min(tolerance, number.rounded_within)
        near = [x for x in number.round_sizes if abs(x - size) < tolerance]
        if not near:
            return _FoundSize(size, std, occam - 0.5 * (change / number.sd) ** 2)
        # Half of the prior is shared by the round sizes.
        occam = max(occam, -float(np.log(2.0 * len(number.round_sizes))))
        return _FoundSize(min(near, key=lambda x: abs(x - size)), std, occam)

    @staticmethod
    def _newton_size(
        evidence: Evidence,
        incumbent: ViewFit,
        hypothesis: Hypothesis,
        size: float,
        steps: int,
    ) -> tuple[float, float]:
        """Return the likeliest size of a hypothesis beside an incumbent, and its standard
        deviation, by at most so many Newton ``steps`` from ``size``."""
        number = hypothesis.number
        assert number is not None
        largest_step = _LARGEST_STEP * number.sd
        std = np.inf
        for _ in range(steps):
            fit = evidence.fit(
                hypothesis.applied_to(incumbent.view, size), incumbent.rows_worth_one
            )
            slope = evidence.slopes(fit, [hypothesis], [size])
            sd = np.array([_LOOSE * number.sd])
            change, information = evidence.score_test(fit, slope, sd)
            std = float(1.0 / np.sqrt(max(information[0], 1e-300)))
            new_size = size + float(np.clip(change[0], -largest_step, largest_step))
            new_size = float(np.clip(new_size, *number.limits))
            is_converged = abs(new_size - size) < _SHORT * std
            size = new_size
            if is_converged:
                break
        return size, std

    def confirmed_claim(self, claim: Claim, fit: ViewFit) -> Claim | None:
        """Return a claim if held-out parts of the log confirm it against the incumbent's
        fit, with the larger, jackknifed standard deviation of its size; else None.

        A size that differs little from the incumbent's, is at a limit, or is known too
        poorly is not confirmed.
        """
        hypothesis = claim.hypothesis
        number = hypothesis.number
        if number is not None:
            slope = self.all_rows.slopes(claim.fit, [hypothesis], [claim.size])[:, :, 0]
            std = max(claim.std, self.all_rows.jackknifed_std(claim.fit, slope))
            claim = replace(claim, std=std)
            before = 0.0 if hypothesis.part else number.size_in(fit.transform)
            is_near = abs(claim.size - before) < c.NUMBER_SIGMAS * std
            is_at_limit = claim.size in number.limits
            if is_near or is_at_limit or 2.0 * std > number.widest:
                return None
        return claim if self._is_confirmed(claim, fit) else None

    def _is_confirmed(self, claim: Claim, fit: ViewFit) -> bool:
        """Whether a second witness confirms a claim against the incumbent's fit.

        It is the joints' ranges where the arm is badly explained, or the error on held-out
        parts of the log. The latter says nothing where both fit the same, as signs do that
        only friction's power shows.
        """
        if self._is_by_ranges(replace(claim, before=fit)) and fit.is_badly_explained:
            return True
        moving = fit.weights > 0.0
        old, new = fit.shares_left[moving], claim.fit.shares_left[moving]
        if np.all(np.abs(np.log(old / new)) < c.SAME_FIT):
            return True
        if (old - new).sum() < c.LEAST_SHARE:
            return False
        return self._is_held_out_error_lower(claim, fit)

    def _is_held_out_error_lower(self, claim: Claim, fit: ViewFit) -> bool:
        """Whether the error on held-out parts of the log falls clearly, in standard errors,
        and by a large factor from the incumbent's fit to the claim's."""
        hypothesis = claim.hypothesis
        span = hypothesis.part
        if span is not None and span.until is None:
            span = None
        before, after = (
            self.all_rows.held_out(x, span=span)[0] for x in (fit, claim.fit)
        )  # (PARTS, moving joints) each
        fall = standard_errors_above_zero(np.log(before / after).sum(axis=1))
        ratios = before.mean(axis=0) / after.mean(axis=0)
        has_size = hypothesis.number is not None or hypothesis.extra_torque is not None
        least_ratio = c.LEAST_RATIO_WITH_SIZE if has_size else c.LEAST_RATIO
        if self.is_doubtful:
            least_ratio = c.LEAST_RATIO_IF_DOUBTFUL
        is_large = max(float(ratios.max()), float(ratios.prod())) > least_ratio
        return bool(fall > c.WITNESS_SIGMAS and is_large)


def _propose(
    kinds: Sequence[ModuleType], evidence: Evidence, fit: ViewFit
) -> list[Hypothesis]:
    """List what each kind of fault proposes beside an incumbent's fit."""
    return [x for kind in kinds for x in kind.propose(evidence, fit)]


def _best_of_each_key(screened: Sequence[_Screened]) -> list[_Screened]:
    """List the likeliest hypotheses, at most LOOKS, in falling order of their odds.

    Of neighbours on a grid of instants or of sizes only the best counts: they must not
    crowd out another fault.
    """
    best: dict[object, _Screened] = {}
    for entry in sorted(screened, key=lambda entry: -entry.log_odds):
        hypothesis = entry.hypothesis
        is_instant = hypothesis.part is not None and hypothesis.part.after is not None
        place = "an instant" if is_instant else hypothesis.part
        if entry.log_odds > c.WORTH_A_LOOK:
            best.setdefault((hypothesis.kind, hypothesis.joints, place), entry)
    return [*best.values()][: c.LOOKS]


def _size_of_columns(fit: ViewFit, extra: ExtraTorque, occam: float) -> _FoundSize:
    """Return the first size of an extra torque, whose sizes stand last in a fit's
    parameters. ``occam`` is its price if it may have either sign."""
    place = len(fit.theta) - len(extra.sd)
    size = float(fit.theta[place])
    covariance = np.linalg.inv(fit.information)
    std = float(np.sqrt(covariance[place, place]))
    if extra.is_positive:
        occam = float(np.log(2.0) + log_ndtr(size / std))
    return _FoundSize(size, std, occam)


def _is_same(one: Claim, other: Claim) -> bool:
    """Whether two claims repair the log in the same way and have the same extra torque.

    Units of positions within a tenth of each other are the same: counts of an encoder may
    be thousandths of a degree.
    """
    first, second = one.fit.transform, other.fit.transform
    if one.fit.view.parts != other.fit.view.parts:
        return False
    if one.hypothesis.extra_torque is not other.hypothesis.extra_torque:
        return False
    ratios = np.divide(np.array(first.scale), np.array(second.scale))
    is_near = bool(np.all(np.abs(np.log(np.abs(ratios))) < _NEAR_UNIT))
    return is_near and replace(first, scale=second.scale) == second


def _fits_as_well(claim: Claim, best: Claim) -> bool:
    """Whether a claim leaves as little of every joint's torque as the best claim, about
    the same joints of the same part, though one changes the log and the other the arm.

    The one with fewer numbers is then likelier, but not the only remedy.
    """
    hypothesis, best_hypothesis = claim.hypothesis, best.hypothesis
    is_same_remedy = (hypothesis.extra_torque is None) == (
        best_hypothesis.extra_torque is None
    )
    is_same_place = (hypothesis.joints, hypothesis.part) == (
        best_hypothesis.joints,
        best_hypothesis.part,
    )
    if not is_same_place or hypothesis.part is None or is_same_remedy:
        return False
    moving = best.fit.weights > 0.0
    rise = np.log(claim.fit.shares_left[moving] / best.fit.shares_left[moving])
    return bool(np.all(rise < c.SAME_FIT))


def _rows_over_few(fit: ViewFit) -> float:
    """Return the ratio of the evidence of all rows to that of few, every THIN-th row.

    It is THIN for independent rows, and less for correlated ones: of those that are worth
    one row a single one counts.
    """
    return c.THIN / min(fit.rows_worth_one, c.THIN)


def _thinned(extra: ExtraTorque) -> ExtraTorque:
    """Return an extra torque at the few rows of the screening, every THIN-th."""
    recompute = extra.recompute
    return replace(
        extra,
        columns=extra.columns[:, :: c.THIN],
        recompute=None
        if recompute is None
        else lambda transform: _thinned(recompute(transform)),
    )
