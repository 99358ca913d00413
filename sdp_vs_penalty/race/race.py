"""One race: screen, exact, take, again; then what is left beside the others is what is
claimed, with what is as likely."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import chain as chained
from types import ModuleType

import numpy as np
from scipy.special import log_ndtr

from sdp_vs_penalty.problem.problem import Problem
from sdp_vs_penalty.race import constants as c
from sdp_vs_penalty.race.chain import LogTransform
from sdp_vs_penalty.race.evidence import Evidence, ViewFit
from sdp_vs_penalty.race.kinds import KINDS, list_faults
from sdp_vs_penalty.race.likelihood import Likelihood, keep_recent
from sdp_vs_penalty.race.records import Further, Hypothesis, LogView
from sdp_vs_penalty.regression.evidence import standard_errors_above_zero

#: Steps of Newton by which a size is found on few rows, and share of its standard
#: deviation below which a step ends it.
_STEPS, _SHORT = 8, 0.2
#: Largest first step of a size, and largest step, in standard deviations beforehand.
_FIRST_STEP, _LARGEST_STEP = 0.7, 1.0
#: Rounds of reweighting at the first look.
_ROUNDS_OF_A_LOOK = 2
#: A change's log-odds rise by at most so much more than a claim explains.
_MORE_ODDS = 100.0
#: Fits after which columns that depend on their size are those of it.
_ROUNDS_OF_COLUMNS = 3
#: Units of positions that differ by less are one (natural logarithm).
_NEAR_UNIT = 0.1
#: Races whose outcomes are kept: of a log, and of its copy.
_RACES_KEPT = 2
#: A step that looks for a size far off is not held back by its prior.
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
        """Return it with its odds beside another fit of the incumbent, both with the
        same number of rows worth one."""
        odds = fit.value - before.value + self.hypothesis.log_prior + self.occam
        return replace(self, log_odds=odds, fit=fit, before=before)

    @property
    def is_usual(self) -> bool:
        """Whether its size is one that arms and loggers differ by themselves."""
        number = self.hypothesis.number
        if number is None:
            return self.hypothesis.is_usual
        reach = c.SIGMAS_BEYOND_USUAL * self.spread
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

    def claims_of_all(self) -> list[Claim]:
        """List the faults of the log that all its rows share."""
        return [
            claim
            for claim in self.claims
            if not (claim.hypothesis.part or claim.hypothesis.effect)
        ]

    def is_sure_of(self, claim: Claim) -> bool:
        """Whether a claim may be likely: claims of its odds have been right, and what is
        left is small, or it explains half of what was left. An arm that leaves much tells
        no sign by its friction.

        Friction of the wrong sign has no second witness.
        """
        if claim.hypothesis.tells_by_friction or claim.log_odds < c.LIKELY:
            return False
        moving = self.fit.weights > 0.0
        before, after = (x.shares[moving] for x in (claim.before, claim.fit))
        is_well_explained = self.fit.shares[moving].max() < c.BADLY
        ratio = float(after.sum() / before.sum())
        return is_well_explained or ratio <= 0.5

    def differences(self) -> list[Claim]:
        """List what differs in a part of the log, by more than is usual."""
        return [x for x in self.claims if x.hypothesis.part and not x.is_usual]

    def told(self, log: Likelihood) -> LogTransform:
        """Return the transform of all rows that undoes what is claimed, without numbers
        that are usual."""
        chain = self.view.chain
        usual = {claim.hypothesis.key[:2] for claim in self.claims if claim.is_usual}
        beyond = {
            claim.hypothesis.key[:2] for claim in self.claims if not claim.is_usual
        }
        for name in usual - beyond:
            for fault in list_faults(log, chain):
                if fault.name == name:
                    chain = fault.without
        return chain


#: Races that were held last, by their rows: the robot, and what the race said.
_held: dict[object, tuple[Problem, RaceOutcome]] = {}


def hold_race(
    logs: Sequence[Likelihood], kinds: tuple[ModuleType, ...], is_doubtful: bool
) -> RaceOutcome:
    """Hold a race, see :class:`Race`, or return what it said last of the same rows: those
    of a repaired copy are the ones that were judged as they would be repaired."""
    problem = logs[0].problem
    key = tuple(log.data.digest for log in logs), kinds, is_doubtful
    held = _held.get(key)
    if held is None or held[0] is not problem:
        held = problem, Race(logs, kinds, is_doubtful).run()
    return keep_recent(_held, key, held, _RACES_KEPT)[1]


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
        self.few = self.all.thinned(c.THIN)
        #: Log-odds of changes at the first look, by key and place among those of a key.
        self.looked_at: dict[object, float] = {}

    def run(self) -> RaceOutcome:
        """Take the best hypothesis until none is likely."""
        taken: list[Claim] = []
        view = LogView(self.all.log.as_logged)
        fit = self._incumbent(view)
        while len(taken) < c.MAX_FAULTS:
            last = taken[-1].log_odds if taken else np.inf
            claim = self._best(fit, last + _MORE_ODDS)
            if claim is None:
                break
            taken.append(claim)
            view = claim.fit.view
            fit = self._incumbent(view)
        return RaceOutcome(tuple(taken), view, fit)

    def _incumbent(self, view: LogView) -> ViewFit:
        """Fit the rows as they are seen. How many of them are worth one is what the
        residual of a first fit says."""
        fit = self.all.fit(view, 1.0)
        return self.all.worth(fit, self.all.rows_worth_one(fit))

    def _best(self, fit: ViewFit, explained: float) -> Claim | None:
        """Return the likeliest hypothesis that parts left out confirm, with those that
        are as likely; None where nothing is."""
        ranking = self.rank(fit, explained)
        likely = [x for x in ranking if x.log_odds > c.LOG_ODDS_OF_A_CLAIM]
        witnessed = (self._witnessed(x, fit) for x in likely)
        best = next((x for x in witnessed if x is not None), None)
        if best is None:
            return None
        rivals: dict[object, Claim] = {}
        for x in likely:
            if best.log_odds - x.log_odds < c.LOG_ODDS_OF_A_CLAIM and not _is_same(
                x, best
            ):
                rivals.setdefault(x.hypothesis.key, x)
        rivals.pop(best.hypothesis.key, None)
        return replace(best, rivals=tuple(rivals.values()))

    def rank(self, fit: ViewFit, explained: float = np.inf) -> list[Claim]:
        """List the hypotheses that may be likelier than an incumbent, the likeliest
        first: all on few rows, the best on all rows at their best size.

        Two are compared with as many rows worth one as the whitest residual says.
        """
        view = replace(fit.view, further=tuple(map(_thinned, fit.view.further)))
        few = self.few.fit(view, 1.0)
        looks = self._screen(fit, few, explained)
        tried = [self._exact(h, size, fit, few) for h, size in looks]
        exact = [x for x in tried if x is not None]
        likely = [x.fit.v for x in exact if x.log_odds > c.WORTH_A_LOOK]
        v = min([fit.v, *likely])
        base = self.all.worth(fit, v)
        ranking = [x.beside(base, self.all.worth(x.fit, v)) for x in exact]
        return sorted(ranking, key=lambda x: -x.log_odds)

    def _screen(
        self, fit: ViewFit, base: ViewFit, explained: float
    ) -> list[tuple[Hypothesis, float]]:
        """List the hypotheses that are worth a look at all rows, of each key the best,
        with the change of its size to first order.

        What a wrong incumbent leaves errs slowly, and what is right may leave white
        noise: here each row is worth one (the fit base). Changes that were less likely than by
        ``explained`` [log-odds] before are not looked at again.
        """
        few, chain, view = self.few, fit.chain, base.view
        of_all = _of_all(fit)
        scored: list[tuple[float, Hypothesis, float]] = []
        numbers: list[Hypothesis] = []
        columns: list[Hypothesis] = []
        changed: dict[object, Hypothesis] = {}
        count: Counter[object] = Counter()
        for h in chained.from_iterable(x.propose(self.all, fit) for x in self.kinds):
            if h.further is not None:
                columns.append(h)
            elif not h.is_friction_real:
                scored.append((-base.physics + h.log_prior, h, 0.0))
            elif h.number is not None and (h.part is not None or h.chain == chain):
                numbers.append(h)
            else:
                count[h.key] += 1
                # What a claim explains, another cannot lack, nor much more.
                if self.looked_at.get((h.key, count[h.key]), 0.0) > -explained:
                    changed[h.key, count[h.key]] = h
        sizes = [h.number.size_in(h.chain) for h in numbers if h.number]
        slopes = few.slopes(base, numbers, sizes)
        groups = [
            (slopes[:, :, k : k + 1], np.array([h.number.sd]))
            for k, h in enumerate(numbers)
            if h.number
        ]
        further = [_thinned(h.further) for h in columns if h.further]
        groups += [(x.columns, x.sd) for x in further]
        if groups:
            found = zip([*numbers, *columns], *few.screen(base, groups), strict=True)
            for h, gain, step in found:
                scored.append((of_all * gain + h.log_prior, h, float(step)))
        views = [h.seen(view) for h in changed.values()]
        values = few.values(views, 1.0, _ROUNDS_OF_A_LOOK)
        for (key, h), value in zip(changed.items(), values, strict=True):
            odds = float(of_all * (value - base.value) + h.log_prior)
            self.looked_at[key] = odds
            scored.append((odds, h, 0.0))
        # A grid's neighbours, of instants or of sizes, must not crowd out another fault.
        looks: dict[object, tuple[Hypothesis, float]] = {}
        for odds, h, step in sorted(scored, key=lambda x: -x[0]):
            is_instant = h.part is not None and h.part.after is not None
            place = "an instant" if is_instant else h.part
            if odds > c.WORTH_A_LOOK:
                looks.setdefault((h.kind, h.joints, place), (h, step))
        return [*looks.values()][: c.LOOKS]

    def _exact(
        self, h: Hypothesis, step: float, fit: ViewFit, few: ViewFit
    ) -> Claim | None:
        """Return a hypothesis at its best size, on all rows; None where few rows, of which
        the incumbent's fit is ``few``, speak against it at that size."""
        number, size, spread, occam = h.number, 0.0, 0.0, 0.0
        if number is not None:
            farthest = _FIRST_STEP * number.sd
            start = number.size_in(h.chain)
            size = start + float(np.clip(step, -farthest, farthest))
            size, _ = self._refined(self.few, few.view, h, size, 1.0, _STEPS)
            seen = self.few.fit(h.seen(few.view, size), 1.0)
            gain = _of_all(fit) * (seen.value - few.value)
            if gain + h.log_prior < c.WORTH_A_LOOK:
                return None
            size, spread = self._refined(self.all, fit.view, h, size, fit.v, 1)
            away = size - (start if h.part else number.size_in(fit.chain))
            occam = float(np.log(min(1.0, spread / number.sd)))
            reach = number.usual + c.NUMBER_SIGMAS * spread
            reach = min(reach, number.rounded_within)
            near = [x for x in number.round_sizes if abs(x - size) < reach]
            size = min(near, key=lambda x: abs(x - size), default=size)
            occam -= 0.5 * (0.0 if near else away / number.sd) ** 2
            if near:  # a size that has half of the prior with its like
                occam = max(occam, -float(np.log(2.0 * len(number.round_sizes))))
        found = self.all.fit(h.seen(fit.view, size), fit.v)
        for _ in range(_ROUNDS_OF_COLUMNS if h.further_at else 0):
            assert h.further is not None
            assert h.further_at is not None
            # Sizes of further columns stand last in theta.
            first_size = float(found.theta[-len(h.further.sd)])
            h = replace(h, further=h.further_at(first_size))
            found = self.all.fit(h.seen(fit.view), fit.v)
        v = min(self.all.rows_worth_one(found), fit.v)
        found = self.all.worth(found, v)
        if h.further is not None:
            place = len(found.theta) - len(h.further.sd)
            size = float(found.theta[place])
            covariance = np.linalg.inv(found.information)
            spread = float(np.sqrt(covariance[place, place]))
            if h.further.is_positive:
                occam = float(np.log(2.0) + log_ndtr(size / spread))
        base = self.all.worth(fit, v)
        return Claim(h, 0.0, found, base, size, spread, occam).beside(base, found)

    @staticmethod
    def _refined(
        evidence: Evidence,
        view: LogView,
        h: Hypothesis,
        size: float,
        v: float,
        steps: int,
    ) -> tuple[float, float]:
        """Return the best size of a hypothesis, by Newton's steps from ``size``, and its
        standard deviation; v : rows worth one."""
        number = h.number
        assert number is not None
        spread = np.inf
        for _ in range(steps):
            fit = evidence.fit(h.seen(view, size), v)
            slope = evidence.slopes(fit, [h], [size])
            sd = np.array([_LOOSE * number.sd])
            change, information = evidence.score_test(fit, slope, sd)
            spread = float(1.0 / np.sqrt(max(information[0], 1e-300)))
            far = _LARGEST_STEP * number.sd
            better = size + float(np.clip(change[0], -far, far))
            better = float(np.clip(better, *number.limits))
            is_short = abs(better - size) < _SHORT * spread
            size = better
            if is_short:
                break
        return size, spread

    def _witnessed(self, x: Claim, fit: ViewFit) -> Claim | None:
        """Return a hypothesis with the spread of its size that parts of the log show, if
        this second witness speaks for it; else None.

        The error on parts that nothing was fitted to has to fall clearly and by a
        factor. It says nothing of what fits the same, and little of signs, which
        friction's power shows.
        """
        number = x.hypothesis.number
        if number is not None:
            slope = self.all.slopes(x.fit, [x.hypothesis], [x.size])[:, :, 0]
            spread = max(x.spread, self.all.jackknifed_spread(x.fit, slope))
            x = replace(x, spread=spread)
            before = x.hypothesis.chain if x.hypothesis.part else fit.chain
            is_near = abs(x.size - number.size_in(before)) < c.NUMBER_SIGMAS * spread
            is_at_limit = x.size in number.limits
            if is_near or is_at_limit or 2.0 * spread > number.widest:
                return None
        return x if self._is_confirmed(x, fit) else None

    def _is_confirmed(self, x: Claim, fit: ViewFit) -> bool:
        """Whether parts of the log that nothing was fitted to confirm a hypothesis."""
        number = x.hypothesis.number
        part = x.hypothesis.part
        span = part if part is not None and part.until is not None else None
        before, after = (self.all.held_out(y, span=span)[0] for y in (fit, x.fit))
        falls = np.log(before / after)
        clearness = standard_errors_above_zero(falls.sum(axis=1))
        moving = fit.weights > 0.0
        old, new = fit.shares[moving], x.fit.shares[moving]
        if np.all(np.abs(np.log(old / new)) < c.SAME_FIT):
            return True
        if x.hypothesis.kind == "torque sign":
            return bool(clearness > -c.WITNESS_SIGMAS)
        if (old - new).sum() < c.LEAST_SHARE:
            return False
        ratios = before.mean(axis=0) / after.mean(axis=0)
        has_size = number is not None or x.hypothesis.further is not None
        least = c.LEAST_RATIO_WITH_SIZE if has_size else c.LEAST_RATIO
        if self.is_doubtful:
            least = c.LEAST_RATIO_IF_DOUBTFUL
        is_large = max(float(ratios.max()), float(ratios.prod())) > least
        return bool(clearness > c.WITNESS_SIGMAS and is_large)


def _is_same(x: Claim, other: Claim) -> bool:
    """Whether two hypotheses do the same to the log, but for a tenth of the positions'
    unit: counts of an encoder may be thousandths of a degree."""
    chains = x.fit.chain, other.fit.chain
    ratios = np.divide(*(np.array(chain.scale) for chain in chains))
    is_near = bool(np.all(np.abs(np.log(np.abs(ratios))) < _NEAR_UNIT))
    return is_near and replace(chains[0], scale=chains[1].scale) == chains[1]


def _of_all(fit: ViewFit) -> float:
    """Return the evidence of all rows over that of few."""
    return c.THIN / min(fit.v, c.THIN)


def _thinned(further: Further) -> Further:
    """Return further columns at the rows that are looked at first."""
    columns, under = further.columns[:, :: c.THIN], further.under
    thinned = under and (lambda chain: _thinned(under(chain)))
    return replace(further, columns=columns, under=thinned)
