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
from sdp_vs_penalty.race.records import Further, Hypothesis, LogView, Number, Part
from sdp_vs_penalty.regression.evidence import standard_errors_above_zero
from sdp_vs_penalty.robot.arrays import Array

#: Newton steps by which a size is found on few rows, at most, and share of the size's
#: standard deviation below which a step is the last one.
_STEPS, _SHORT = 8, 0.2
#: Largest first step of a size, and largest step, in standard deviations beforehand.
_FIRST_STEP, _LARGEST_STEP = 0.7, 1.0
#: Rounds of reweighting at the first look.
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
    spread: float = 0.0
    #: What its freedom costs.
    occam: float = 0.0
    #: What is as likely, the likeliest first, where it was taken.
    rivals: tuple[Claim, ...] = ()

    def beside(self, before: ViewFit, fit: ViewFit) -> Claim:
        """Return the claim with its odds by these fits, without it and with it, both
        with the same number of rows worth one."""
        odds = fit.value - before.value + self.prior
        return replace(self, log_odds=odds, fit=fit, before=before)

    @property
    def is_of_all(self) -> bool:
        """Whether it is about a transform of all rows."""
        h = self.hypothesis
        return h.part is None and h.further is None and h.is_friction_real

    @property
    def prior(self) -> float:
        """Natural logarithm of its odds beforehand, and of what its freedom costs."""
        return self.hypothesis.log_prior + self.occam

    @property
    def probabilities(self) -> Array:
        """(1 + R,) probabilities of the claim and of its rivals, given that one of them is
        right.

        Log-odds of the race are too bold. They are divided so that a rival that is
        LOG_ODDS_OF_A_CLAIM behind has odds of one to twenty.
        """
        log_odds = np.array([x.log_odds for x in (self, *self.rivals)])
        overconfidence = c.LOG_ODDS_OF_A_CLAIM / float(np.log(_LEAST_ODDS))
        return np.asarray(softmax(log_odds / overconfidence))

    @property
    def is_usual(self) -> bool:
        """Whether healthy arms and loggers have such a size, up to its errors."""
        number, further = self.hypothesis.number, self.hypothesis.further
        reach = c.SIGMAS_BEYOND_USUAL * self.spread
        if further is not None and further.usual:
            return abs(self.size) <= further.usual + reach
        if number is None:
            return self.hypothesis.is_usual
        below = number.usual if number.usual_below is None else number.usual_below
        return -below - reach <= self.size <= number.usual + reach


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

    def claims_of_all(self) -> list[Claim]:
        """List the faults of the log that all its rows share."""
        return [
            claim
            for claim in self.claims
            if not (claim.hypothesis.part or claim.hypothesis.effect)
        ]

    def is_sure_of(self, claim: Claim) -> bool:
        """Whether a claim may be called likely.

        Its log-odds must be at least LIKELY: claims of such odds have been right. And the
        arm must leave little of the torques, or the claim must explain half of what was
        left. A claim that friction's sign alone shows has no second witness, nor has one of
        a motion of few directions. No claim is surer than the unit of positions before it.
        """
        first = self.claims[0]
        is_unit_open = first.hypothesis.position_unit is not None
        is_unit_open &= any(x.is_of_all for x in first.rivals)
        has_no_witness = claim.hypothesis.tells_by_friction or self.is_doubtful
        has_no_witness |= is_unit_open
        if has_no_witness or claim.log_odds < c.LIKELY:
            return False
        moving = self.fit.weights > 0.0
        before, after = (x.shares[moving] for x in (claim.before, claim.fit))
        ratio = float(after.sum() / before.sum())
        return self.is_well_explained or ratio <= 0.5

    @property
    def is_well_explained(self) -> bool:
        """Whether little is left of every joint's torque with all that was taken."""
        return not self.fit.is_badly_explained

    def differences(self) -> list[Claim]:
        """List what differs in a part of the log, by more than is usual."""
        return [x for x in self.claims if x.hypothesis.part and not x.is_usual]

    def without_usual(self, log: Likelihood) -> LogTransform:
        """Return the transform of all rows that undoes what is claimed, but for sizes that
        are usual of arms and loggers: they are no fault of the log."""
        chain = self.view.chain
        usual = {x.hypothesis.name for x in self.claims if x.is_usual}
        unusual = {x.hypothesis.name for x in self.claims if not x.is_usual}
        for name in usual - unusual:
            for fault in list_faults(log, chain):
                if fault.name == name:
                    chain = fault.without
        return chain


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
        """Hold a race, see :class:`Race`, or return the outcome of the one about the same
        rows of the same robot."""
        problem = logs[0].problem
        key = tuple(log.data.digest for log in logs), kinds, is_doubtful
        held = self._held.get(key)
        if held is None or held[0] is not problem:
            held = problem, Race(logs, kinds, is_doubtful).run()
            self._held[key] = held
        return held[1]


class _FirstLook(NamedTuple):
    """What the first look, at few rows, says of a hypothesis."""

    #: Natural logarithm of its odds against the incumbent.
    log_odds: float
    #: What is looked at.
    hypothesis: Hypothesis
    #: Change of its size to first order; 0 where it has none, or is at its size.
    step: float = 0.0


class _FoundSize(NamedTuple):
    """The best size of a hypothesis."""

    #: In its own unit.
    size: float = 0.0
    #: Its standard deviation.
    spread: float = 0.0
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
        self.all = Evidence(Likelihood.of_all_runs(logs).with_all_laws)
        self.few = self.all.of_rows(slice(None, None, c.THIN))
        #: Log-odds of changes at the first look, by key and place among those of a key.
        self.looked_at: dict[object, float] = {}
        #: Rows beside those of a run, by the run.
        self._others: dict[Part, Evidence] = {}

    def run(self) -> RaceOutcome:
        """Take the best hypothesis until none is likely."""
        taken: list[Claim] = []
        fit = self._incumbent(LogView(self.all.log.as_logged))
        while len(taken) < c.MAX_FAULTS:
            last = taken[-1].log_odds if taken else np.inf
            claim = self._best(fit, last + _MORE_ODDS)
            if claim is None:
                break
            taken.append(self._looked_ahead(claim, fit))
            fit = self._incumbent(taken[-1].fit.view)
            for place in range(len(taken) - 1):
                taken[place], fit = self._again(taken[place], fit)
        own = [x.log_odds - c.MAX_PHYSICS_LOG_ODDS for x in taken[:1]]
        is_open = max(own, default=np.inf) < c.LOG_ODDS_OF_A_CLAIM
        if is_open and fit.is_badly_explained and self._is_by_ranges(taken[0]):
            # The torques tell no unit, which is then asked for.
            none = self._incumbent(LogView(self.all.log.as_logged))
            return RaceOutcome((), none.view, none, self.is_doubtful)
        return RaceOutcome(tuple(taken), fit.view, fit, self.is_doubtful)

    def _is_by_ranges(self, claim: Claim) -> bool:
        """Whether the joints' ranges speak for a claim."""
        before, after = (self.all.of_ranges(x.view) for x in (claim.before, claim.fit))
        return before < after

    def _looked_ahead(self, claim: Claim, fit: ViewFit) -> Claim:
        """Return a claim, or the rival of it that explains more together with the next
        claim: two faults hide each other. If the joints' ranges ask for a unit of
        positions, units that are more usual count as rivals."""
        firsts = [claim, *(x for x in claim.rivals if x.is_of_all)]
        if self._is_by_ranges(claim):
            for h in position_unit.propose(self.all, fit):
                usual = Claim(h, 0.0, self.all.fit(h.applied_to(fit.view), fit.v), fit)
                is_known = any(_is_same(usual, x) for x in firsts)
                if usual.prior > claim.prior and not is_known:
                    firsts += [usual] * self._is_by_ranges(usual)
        if len(firsts) < 2 or not claim.is_of_all:
            return claim
        known = self.looked_at
        # Of each first claim: the prior of it and of the next one, and the fit with both.
        ends: list[tuple[Claim, float, ViewFit]] = []
        for first in firsts:
            self.looked_at = {}
            with_first = self._incumbent(first.fit.view)
            second = self._best(with_first, np.inf)
            if second is None:
                ends.append((first, first.prior, with_first))
            else:
                ends.append((first, first.prior + second.prior, second.fit))
        self.looked_at = known
        v = min(fit.v for _, _, fit in ends)
        odds = [prior + self.all.worth(fit, v).value for _, prior, fit in ends]
        best = ends[int(np.argmax(odds))][0]
        others = [x for x in (claim, *claim.rivals) if x is not best]
        return replace(best, rivals=tuple(others))

    def _again(self, claim: Claim, fit: ViewFit) -> tuple[Claim, ViewFit]:
        """Judge a claim and its rivals again beside the claims that were taken after it.

        Returns
        -------
        tuple of (Claim, ViewFit)
            The likeliest one, with those that are as likely as its rivals, and the fit with
            all that was taken. Another one may be the likeliest, once a fault that hid it is
            undone.
        """
        if not claim.is_of_all:
            return claim, fit
        best, others = (claim, fit), list[tuple[float, Claim, ViewFit]]()
        for rival in claim.rivals:
            if not rival.is_of_all:
                others.append((0.0, rival, fit))
                continue
            chain = rival.fit.chain.changed_alike(claim.fit.chain, fit.chain)
            with_rival = self.all.fit(fit.view.under(chain), fit.v)
            odds = with_rival.value - fit.value + rival.prior - claim.prior
            others.append((odds, rival, with_rival))
        if self._is_by_ranges(claim):
            undone = claim.before.chain.changed_alike(claim.fit.chain, fit.chain)
            without = self.all.fit(fit.view.under(undone), fit.v)
            claim = replace(claim, log_odds=fit.value - without.value + claim.prior)
            best = claim, fit
        others.append((0.0, claim, fit))
        most = max(odds for odds, _, _ in others)
        if most > 0.0:
            best = next((x, y) for odds, x, y in others if odds == most)
        rivals = tuple(
            replace(x, log_odds=best[0].log_odds + odds - most)
            for odds, x, _ in others
            if most - odds < c.LOG_ODDS_OF_A_CLAIM and x is not best[0]
        )
        found = fit if best[0] is claim else self._incumbent(best[1].view)
        return replace(best[0], rivals=rivals), found

    def _incumbent(self, view: LogView) -> ViewFit:
        """Fit the rows of a view. The residual of a first fit says how many rows are worth
        one independent row."""
        fit = self.all.fit(view, 1.0)
        return self.all.worth(fit, self.all.rows_worth_one(fit))

    def _best(self, fit: ViewFit, explained: float) -> Claim | None:
        """Return the likeliest hypothesis that parts left out confirm, with those that
        are as likely; None where nothing is."""
        ranking = self.rank(fit, explained)
        likely = [x for x in ranking if x.log_odds > c.LOG_ODDS_OF_A_CLAIM]
        witnessed = (self._witnessed(claim, fit) for claim in likely)
        best = next((claim for claim in witnessed if claim is not None), None)
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

    def rank(self, fit: ViewFit, explained: float = np.inf) -> list[Claim]:
        """List the hypotheses that may be likelier than an incumbent, the likeliest
        first: all on few rows, the best on all rows at their best size.

        Two are compared with as many rows worth one as the whitest residual says.
        """
        view = replace(fit.view, further=tuple(map(_thinned, fit.view.further)))
        few_fit = self.few.fit(view, 1.0)
        looks = self._screen(fit, few_fit, explained)
        tried = [self._exact(look, fit, few_fit) for look in looks]
        exact = [claim for claim in tried if claim is not None]
        likely = [x.fit.v for x in exact if x.log_odds > c.WORTH_A_LOOK]
        v = min([fit.v, *likely])
        incumbent = self.all.worth(fit, v)
        ranking = [x.beside(incumbent, self.all.worth(x.fit, v)) for x in exact]
        return sorted(ranking, key=lambda claim: -claim.log_odds)

    def _screen(
        self, fit: ViewFit, few_fit: ViewFit, explained: float
    ) -> list[_FirstLook]:
        """List the hypotheses that are worth a look at all rows, of each key the best.

        In ``few_fit``, the incumbent on few rows, each row counts as independent: a wrong
        incumbent leaves a residual that is correlated, the right hypothesis may leave white
        noise. Changes whose log-odds were below minus ``explained`` at an earlier look are
        not looked at again.
        """
        of_all = [h for kind in self.kinds for h in kind.propose(self.all, fit)]
        proposed = [*of_all, *self._in_parts(of_all, fit)]
        looks = self._look(proposed, fit, few_fit, explained)
        if not fit.may_be_rearranged and any(map(_is_sign_of_a_joint, looks)):
            # Several joints may count the other way, if one seems to.
            several = [*sign.patterns(self.all, fit, "joint sign")]
            looks += self._look(several, fit, few_fit, explained)
        for away in of_one_part.NEARER:
            looks += self._look_nearer(looks, away, fit, few_fit)
        return _best_of_each_key(looks)

    def _look(
        self,
        proposed: Sequence[Hypothesis],
        fit: ViewFit,
        few_fit: ViewFit,
        explained: float,
    ) -> list[_FirstLook]:
        """Look at hypotheses on few rows; see :meth:`_screen`."""
        looks: list[_FirstLook] = []
        numbers: list[Hypothesis] = []
        with_columns: list[Hypothesis] = []
        changes: dict[tuple[object, int], Hypothesis] = {}
        count: Counter[object] = Counter()
        rows_over_few = _rows_over_few(fit)
        for h in proposed:
            if h.further is not None:
                with_columns.append(h)
            elif not h.is_friction_real:
                looks.append(_FirstLook(-few_fit.physics + h.log_prior, h))
            elif h.number is not None and h.chain == (
                fit.chain if h.part is None else self.all.log.as_logged
            ):
                numbers.append(h)
            else:
                count[h.key] += 1
                key: tuple[object, int] = h.key, count[h.key]
                # A claim raises another change's log-odds by little more than it explains.
                if self.looked_at.get(key, 0.0) > -explained:
                    changes[key] = h
        looks += self._look_to_first_order(
            few_fit, numbers, with_columns, rows_over_few
        )
        views = [h.applied_to(few_fit.view) for h in changes.values()]
        values = self.few.values(views, 1.0, _ROUNDS_OF_A_LOOK)
        for (key, h), value in zip(changes.items(), values, strict=True):
            odds = float(rows_over_few * (value - few_fit.value) + h.log_prior)
            self.looked_at[key] = odds
            looks.append(_FirstLook(odds, h))
        return looks

    def _look_nearer(
        self, looks: Sequence[_FirstLook], away: Array, fit: ViewFit, few_fit: ViewFit
    ) -> list[_FirstLook]:
        """Look at loads and arms that begin near the likeliest instant, at distances
        ``away`` from it, in shares of the rows: one that begins at a wrong instant explains
        little."""
        instants = [
            (look.log_odds, part.after)
            for look in looks
            if look.hypothesis.further is not None
            and (part := look.hypothesis.part) is not None
            and part.after is not None
            and part.until is None
        ]
        if not instants or not fit.is_badly_explained:
            return []
        _, likeliest = max(instants)
        parts = of_one_part.parts_near(self.all, likeliest, away)
        n_possible = round(1.0 / float(np.diff(away)[0]))
        of_parts = of_one_part.in_parts(self.all, fit, parts, n_possible)
        return self._look_to_first_order(few_fit, [], [*of_parts], _rows_over_few(fit))

    def _in_parts(
        self, of_all: Sequence[Hypothesis], fit: ViewFit
    ) -> Iterator[Hypothesis]:
        """Yield what may be wrong with all rows as what may be wrong with a part of
        them."""
        if of_one_part not in self.kinds:
            return
        none = self.all.log.as_logged
        kinds = [kind for kind in self.kinds if kind not in NOT_OF_ONE_RUN]
        scaled = [*gain.of_all_torques(none)]
        parts = of_one_part.parts_of(self.all)
        odds = c.LOG_ODDS_AGAINST_DIFFERENCE - c.LOG_ODDS_AGAINST_FAULT
        odds += float(np.log(len(parts)))
        suspects = [part for part in parts if self._is_suspect(part, fit)]
        if fit.chain != none:
            as_logged = replace(fit, view=replace(fit.view, chain=none))
            of_all = [h for kind in kinds for h in kind.propose(self.all, as_logged)]
        others = [part for part in parts if part not in suspects]
        yield from of_one_part.confined([*of_all, *scaled], none, others, odds)
        for part in suspects:
            run = self.all.of_rows(np.flatnonzero(self.all.rows_of(part)))
            alone = run.fit(LogView(none), fit.v)
            # Kinds are proposed by what the arm of all runs leaves.
            alone = replace(alone, left=fit.shares * alone.total)
            of_run = [*scaled, *(h for kind in kinds for h in kind.propose(run, alone))]
            yield from of_one_part.confined(of_run, none, [part], odds, True)

    def _is_suspect(self, part: Part, fit: ViewFit) -> bool:
        """Whether a run may have any fault of its own: the arm of all runs leaves much, and
        an arm that is fitted to the other runs alone leaves far less of them."""
        if part.run is None or not (fit.shares > _CONTRADICTS).any():
            return False
        others = ~self.all.rows_of(part)
        if part not in self._others:
            self._others[part] = self.all.of_rows(np.flatnonzero(others))
        alone = self._others[part].fit(replace(fit.view, further=()), fit.v)
        together = np.sum(self.all.residual(fit)[:, others] ** 2, axis=1)
        is_moving = self.all.log.moving
        return bool((together > _CONFUSED * alone.left)[is_moving].any())

    def _look_to_first_order(
        self,
        few_fit: ViewFit,
        numbers: Sequence[Hypothesis],
        with_columns: Sequence[Hypothesis],
        rows_over_few: float,
    ) -> list[_FirstLook]:
        """Look at hypotheses about a number, and about further columns of torque, as
        columns beside the incumbent's on few rows."""
        about = [(h.number, h.number.size_in(h.chain)) for h in numbers if h.number]
        slopes = self.few.slopes(few_fit, numbers, [size for _, size in about])
        groups = [
            (slopes[:, :, k : k + 1], np.array([number.sd]))
            for k, (number, _) in enumerate(about)
        ]
        further = [_thinned(h.further) for h in with_columns if h.further]
        groups += [(x.columns, x.sd) for x in further]
        if not groups:
            return []
        screened = zip(*self.few.screen(few_fit, groups), strict=True)
        return [
            _FirstLook(rows_over_few * won + h.log_prior, h, float(step))
            for h, (won, step) in zip([*numbers, *with_columns], screened, strict=True)
        ]

    def _exact(self, look: _FirstLook, fit: ViewFit, few_fit: ViewFit) -> Claim | None:
        """Return a hypothesis at its best size, on all rows; None where few rows speak
        against it at that size.

        fit, few_fit : of the incumbent, to all rows and to few.
        """
        h = look.hypothesis
        best: _FoundSize | None = _FoundSize()
        if h.number is not None:
            best = self._best_size(look, h.number, fit, few_fit)
        if best is None:
            return None
        found = self.all.fit(h.applied_to(fit.view, best.size), fit.v)
        for _ in range(_ROUNDS_OF_COLUMNS if h.further_at else 0):
            assert h.further is not None
            assert h.further_at is not None
            # Sizes of further columns stand last in theta.
            first_size = float(found.theta[-len(h.further.sd)])
            h = replace(h, further=h.further_at(first_size))
            found = self.all.fit(h.applied_to(fit.view), fit.v)
        v = min(self.all.rows_worth_one(found), fit.v)
        found = self.all.worth(found, v)
        if h.further is not None:
            best = _size_of_columns(found, h.further, best.occam)
        incumbent = self.all.worth(fit, v)
        return Claim(h, 0.0, found, incumbent, *best).beside(incumbent, found)

    def _best_size(
        self, look: _FirstLook, number: Number, fit: ViewFit, few_fit: ViewFit
    ) -> _FoundSize | None:
        """Return the best size of a hypothesis about a number, a round one where it is as
        good; None where few rows speak against it at that size."""
        h = look.hypothesis
        farthest = _FIRST_STEP * number.sd
        start = number.size_in(h.chain)
        size = start + float(np.clip(look.step, -farthest, farthest))
        size, _ = self._refined(self.few, few_fit, h, size, _STEPS)
        with_size = self.few.fit(h.applied_to(few_fit.view, size), 1.0)
        won = _rows_over_few(fit) * (with_size.value - few_fit.value)
        if won + h.log_prior < c.WORTH_A_LOOK:
            return None
        size, spread = self._refined(self.all, fit, h, size, 1)
        away = size - (0.0 if h.part else number.size_in(fit.chain))
        occam = float(np.log(min(1.0, spread / number.sd)))
        reach = number.usual + c.NUMBER_SIGMAS * spread
        reach = min(reach, number.rounded_within)
        near = [x for x in number.round_sizes if abs(x - size) < reach]
        if not near:
            return _FoundSize(size, spread, occam - 0.5 * (away / number.sd) ** 2)
        # Half of the prior is shared by the round sizes.
        occam = max(occam, -float(np.log(2.0 * len(number.round_sizes))))
        return _FoundSize(min(near, key=lambda x: abs(x - size)), spread, occam)

    @staticmethod
    def _refined(
        evidence: Evidence, incumbent: ViewFit, h: Hypothesis, size: float, steps: int
    ) -> tuple[float, float]:
        """Return the best size of a hypothesis beside an incumbent, by Newton's steps from
        ``size``, and its standard deviation."""
        number = h.number
        assert number is not None
        farthest = _LARGEST_STEP * number.sd
        spread = np.inf
        for _ in range(steps):
            fit = evidence.fit(h.applied_to(incumbent.view, size), incumbent.v)
            slope = evidence.slopes(fit, [h], [size])
            sd = np.array([_LOOSE * number.sd])
            change, information = evidence.score_test(fit, slope, sd)
            spread = float(1.0 / np.sqrt(max(information[0], 1e-300)))
            better = size + float(np.clip(change[0], -farthest, farthest))
            better = float(np.clip(better, *number.limits))
            is_short = abs(better - size) < _SHORT * spread
            size = better
            if is_short:
                break
        return size, spread

    def _witnessed(self, claim: Claim, fit: ViewFit) -> Claim | None:
        """Return a claim with the spread of its size that parts of the log show, if
        this second witness speaks for it against the incumbent's fit; else None.

        The error on parts that nothing was fitted to has to fall clearly and by a
        factor. It says nothing of what fits the same, as signs that friction's power
        shows.
        """
        h = claim.hypothesis
        number = h.number
        if number is not None:
            slope = self.all.slopes(claim.fit, [h], [claim.size])[:, :, 0]
            spread = max(claim.spread, self.all.jackknifed_spread(claim.fit, slope))
            claim = replace(claim, spread=spread)
            before = 0.0 if h.part else number.size_in(fit.chain)
            is_near = abs(claim.size - before) < c.NUMBER_SIGMAS * spread
            is_at_limit = claim.size in number.limits
            if is_near or is_at_limit or 2.0 * spread > number.widest:
                return None
        return claim if self._is_confirmed(claim, fit) else None

    def _is_confirmed(self, claim: Claim, fit: ViewFit) -> bool:
        """Whether parts of the log that nothing was fitted to confirm a claim against the
        incumbent's fit."""
        h = claim.hypothesis
        ranges = [self.all.of_ranges(of.view) for of in (fit, claim.fit)]
        if ranges[0] < ranges[1] and fit.is_badly_explained:
            return True  # the joints' ranges are a witness where another fault hides the arm
        span = h.part if h.part is not None and h.part.until is not None else None
        before, after = (
            self.all.held_out(of, span=span)[0] for of in (fit, claim.fit)
        )  # (PARTS, moving joints) each
        clearness = standard_errors_above_zero(np.log(before / after).sum(axis=1))
        moving = fit.weights > 0.0
        old, new = fit.shares[moving], claim.fit.shares[moving]
        if np.all(np.abs(np.log(old / new)) < c.SAME_FIT):
            return True
        if (old - new).sum() < c.LEAST_SHARE:
            return False
        ratios = before.mean(axis=0) / after.mean(axis=0)
        has_size = h.number is not None or h.further is not None
        least = c.LEAST_RATIO_WITH_SIZE if has_size else c.LEAST_RATIO
        if self.is_doubtful:
            least = c.LEAST_RATIO_IF_DOUBTFUL
        is_large = max(float(ratios.max()), float(ratios.prod())) > least
        return bool(clearness > c.WITNESS_SIGMAS and is_large)


def _is_sign_of_a_joint(look: _FirstLook) -> bool:
    """Whether a joint seems to count the other way, at the first look."""
    is_sign = look.hypothesis.kind == "joint sign"
    return is_sign and look.log_odds > c.WORTH_A_LOOK


def _best_of_each_key(looks: Sequence[_FirstLook]) -> list[_FirstLook]:
    """List the best looks, LOOKS at most, the likeliest first. Neighbours on a grid, of
    instants or of sizes, count as one: they must not crowd out another fault."""
    best: dict[object, _FirstLook] = {}
    for look in sorted(looks, key=lambda look: -look.log_odds):
        h = look.hypothesis
        is_instant = h.part is not None and h.part.after is not None
        place = "an instant" if is_instant else h.part
        if look.log_odds > c.WORTH_A_LOOK:
            best.setdefault((h.kind, h.joints, place), look)
    return [*best.values()][: c.LOOKS]


def _size_of_columns(fit: ViewFit, further: Further, occam: float) -> _FoundSize:
    """Return the first size of further columns that a fit has last, with its standard
    deviation; occam : what it costs where it may have either sign."""
    place = len(fit.theta) - len(further.sd)
    size = float(fit.theta[place])
    covariance = np.linalg.inv(fit.information)
    spread = float(np.sqrt(covariance[place, place]))
    if further.is_positive:
        occam = float(np.log(2.0) + log_ndtr(size / spread))
    return _FoundSize(size, spread, occam)


def _is_same(one: Claim, other: Claim) -> bool:
    """Whether two claims do the same to the log, beside the same further torque, but for a
    tenth of the positions' unit: counts of an encoder may be thousandths of a degree."""
    first, second = one.fit.chain, other.fit.chain
    if one.fit.view.parts != other.fit.view.parts:
        return False
    if one.hypothesis.further is not other.hypothesis.further:
        return False
    ratios = np.divide(np.array(first.scale), np.array(second.scale))
    is_near = bool(np.all(np.abs(np.log(np.abs(ratios))) < _NEAR_UNIT))
    return is_near and replace(first, scale=second.scale) == second


def _fits_as_well(claim: Claim, best: Claim) -> bool:
    """Whether a claim about the same joints of the same part leaves as little of every
    joint's torque as the best one, though one is a change of the log and one of the arm:
    what has fewer numbers is likelier, and not the only remedy."""
    one, other = claim.hypothesis, best.hypothesis
    is_same_remedy = (one.further is None) == (other.further is None)
    if one.key[1:] != other.key[1:] or one.part is None or is_same_remedy:
        return False
    moving = best.fit.weights > 0.0
    more = np.log(claim.fit.shares[moving] / best.fit.shares[moving])
    return bool(np.all(more < c.SAME_FIT))


def _rows_over_few(fit: ViewFit) -> float:
    """Return how many times the evidence of few rows all rows have: few are every
    THIN-th, and of the rows that are worth one a single one counts."""
    return c.THIN / min(fit.v, c.THIN)


def _thinned(further: Further) -> Further:
    """Return further columns at the rows that are looked at first."""
    under = further.under
    return replace(
        further,
        columns=further.columns[:, :: c.THIN],
        under=None if under is None else lambda chain: _thinned(under(chain)),
    )
