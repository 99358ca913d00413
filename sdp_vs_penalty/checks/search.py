"""The search over compositions of transformations: add the best, refine its numbers, drop, exchange.

What is maximised is one posterior, L + log p(physics) - cost of the repair (see likelihood.py). A
repair that is added has to predict parts of the log that the arm was not fitted to, and its number has
to lie beyond what arms and loggers differ by themselves, with its interval.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from sdp_vs_penalty.checks.likelihood import (
    PARTS,
    Score,
    deviation,
    independent_samples,
    physics,
)
from sdp_vs_penalty.checks.repair import Repair
from sdp_vs_penalty.checks.transformations import TRANSFORMATIONS, Element, Scene
from sdp_vs_penalty.checks.transformations.transformation import ODDS

#: A repair is believed from these odds on, whatever it costs (natural logarithm): one in a thousand by
#: chance.
MIN_GAIN = 7.0
#: What the arm leaves of parts that it was not fitted to has to fall by so many standard errors.
_SIGNIFICANT = 2.5
#: Standard deviations that a number has to lie beyond what is usual (Student's t of eight parts, 99.5
#: %).
_SIGMAS = 4.0
#: ... and by so much the log-likelihood falls to either side of it, within its reach (95 %).
_CLOSED = 2.0
#: Signs that leave the torque as well explained by so much are told by physics: so many are looked at.
_LOUD, _TIED = 30.0, 8
#: Pairs are tried where one arm leaves this natural logarithm more of each joint's energy than joints
#: alone.
_CONTRADICTS = 1.0
#: Tolerances within which a round number is tried beside all others.
_NEARLY = 7.0
#: At most so many things are wrong at once; so many proposals are looked at closely.
_ROUNDS, _CLOSELY = 6, 6


@dataclass(frozen=True)
class Found:
    """repair : the net one; elements : what it does; before, after : (n,) shares left of each joint's
    torque; deviations : of the elements' numbers; gains : log-odds of each element."""

    repair: Repair
    elements: tuple[Element, ...]
    deviations: tuple[float, ...]
    gains: tuple[float, ...]
    without: tuple[Score, ...]
    before: Score
    after: Score


class Search:
    """Of one scene."""

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        self.samples = scene.samples
        self._posteriors: dict[Repair, float] = {}

    def elements(self, repair: Repair) -> list[Element]:
        return [e for t in TRANSFORMATIONS for e in t.elements(self.scene, repair)]

    def likelihood(self, score: Score, repair: Repair) -> float:
        """Log-likelihood less the repair's cost."""
        cost = sum(e.cost for e in self.elements(repair)) + ODDS * self.scene.outside(repair)
        return -0.5 * self.samples * score.score - cost

    def posterior(self, repair: Repair) -> float:
        if repair not in self._posteriors:
            (score,) = self.scene.tried.scores([repair])
            value = self.likelihood(score, repair) + physics(score, repair, self.samples)
            self._posteriors[repair] = value
        return self._posteriors[repair]

    def run(self) -> Found:
        now = self.scene.none
        for _ in range(_ROUNDS):
            better = self.added(now)
            if better is None and self._contradicts(now):
                better = self.added(now, last=True)
            if better is None:
                break
            now = self.dropped(better)
            self._resample(now)
        now = self.exchanged(now)
        return self.found(self.polished(now))

    def _resample(self, now: Repair) -> None:
        """What is left of a better arm is less alike from row to row: more samples count."""
        (score,) = self.scene.tried.scores([now])
        self.samples = max(self.samples, independent_samples(score.residual, self.scene.moving))
        self._posteriors.clear()

    def _contradicts(self, now: Repair) -> bool:
        """Whether joints by themselves explain far more than one arm does: two things may be wrong at
        once of which neither explains anything alone."""
        (score,) = self.scene.tried.scores([now])
        return bool(np.log(score.shares / score.alone)[self.scene.moving].mean() > _CONTRADICTS)

    def proposals(self, now: Repair, last: bool = False) -> list[tuple[float, Repair]]:
        """One more thing, the best first; those that only physics can tell are always looked at."""
        (score,) = self.scene.tried.scores([now])
        made = (
            t.pairs(self.scene, now) if last else t.proposals(self.scene, now, score)
            for t in TRANSFORMATIONS
        )
        asked = [r for some in made for r in some if r != now]
        asked = list(dict.fromkeys(asked))
        values = [self.likelihood(s, r) for s, r in zip(self._scored(asked), asked, strict=True)]
        found = sorted(zip(values, asked, strict=True), key=lambda f: -f[0])
        level = self.likelihood(score, now)
        tied = [f for f in found if f[0] > level - 2.0 * _LOUD and _same_fit(f[1], now)][:_TIED]
        return found[:_CLOSELY] + [f for f in tied if f not in found[:_CLOSELY]]

    def _scored(self, asked: Sequence[Repair]) -> Iterable[Score]:
        return self.scene.tried.scores(asked)

    def added(self, now: Repair, last: bool = False) -> Repair | None:
        """The best composition with one thing more, or None where none is believed."""
        level = self.posterior(now)
        close = [
            (self.posterior(r), r) for value, r in self.proposals(now, last) if value > level - 40.0
        ]
        # Rough numbers first: a coarse grid may miss most of what its best value explains.
        best: dict[frozenset[object], Repair] = {}
        for _, r in sorted(close, key=lambda c: -c[0]):
            best.setdefault(frozenset((e.kind, e.joints) for e in self.elements(r)), r)
        refined = [self.refined(r, now) for r in list(best.values())[:_CLOSELY]]
        close = [(self.posterior(r), r) for r in refined]
        for value, repair in sorted(close, key=lambda c: -c[0]):
            if value < level + MIN_GAIN:
                break
            if self.believed(repair, now):
                return repair
        return None

    def believed(self, repair: Repair, now: Repair) -> bool:
        """Whether it predicts what the arm was not fitted to, and its numbers are beyond what is
        usual.
        """
        known = {(e.kind, e.joints): e for e in self.elements(now)}
        new = [e for e in self.elements(repair) if (e.kind, e.joints) not in known]
        judged = self.scene.judged
        for e in new:
            if e.number is not None and e.number.value not in e.number.snaps and not self._determined(e):
                return False
        change = np.log(judged.left_out(now) / judged.left_out(repair))[:, self.scene.moving].sum(axis=1)
        error = float(np.std(change)) / np.sqrt(PARTS)
        if _same_fit(repair, now):  # physics alone may tell
            if self.scene.coarse:
                return False
            return bool(np.mean(change) >= -_SIGNIFICANT * error)
        return bool(np.mean(change) > _SIGNIFICANT * error and np.median(change) > 0.0)

    def _determined(self, e: Element) -> bool:
        """Beyond what is usual, and its interval is closed: far to either side it explains less."""
        assert e.number is not None
        here, *sides = self.scene.judged.scores(
            [e.number.at(e.number.value + d * e.number.reach) for d in (0.0, -1.0, 1.0)]
        )
        if 0.5 * self.samples * (min(s.misfit for s in sides) - here.misfit) < _CLOSED:
            return False
        spread = deviation(self.scene.judged, e.number.at, e.number.value, e.number.tolerance)
        return abs(e.number.value) > e.number.tolerance + _SIGMAS * spread

    def refined(self, repair: Repair, now: Repair) -> Repair:
        """With the best values of the numbers that ``now`` does not have; round ones where as likely."""
        from scipy.optimize import minimize_scalar

        known = {(e.kind, e.joints) for e in self.elements(now)}
        for e in self.elements(repair):
            number = e.number
            if number is None or (e.kind, e.joints) in known:
                continue

            def left(x: float, at=number.at) -> float:  # type: ignore[no-untyped-def]
                return self.scene.tried.scores([at(float(x))])[0].misfit

            ends = number.value - number.reach, number.value + number.reach
            best = minimize_scalar(
                left,
                bounds=ends,
                method="bounded",
                options={"xatol": 0.05 * number.tolerance, "maxiter": 14},
            )
            near = [x for x in number.snaps if abs(x - best.x) < number.tolerance]
            tried = [number.at(x) for x in near] or [repair, number.at(float(best.x))]
            repair = max(tried, key=self.posterior)
        return repair

    def polished(self, repair: Repair) -> Repair:
        """All numbers beside each other once more."""
        if len(self.elements(repair)) < 2:
            return repair
        repair = self.refined(repair, self.scene.none)
        # One round number beside another that is not yet round looks a few tolerances away from it.
        round_ = repair
        for e in self.elements(repair):
            for x in e.number.snaps if e.number is not None else ():
                if abs(x - e.number.value) < _NEARLY * e.number.tolerance:  # type: ignore[union-attr]
                    now = {(o.kind, o.joints): o for o in self.elements(round_)}[e.kind, e.joints]
                    round_ = now.number.at(x)  # type: ignore[union-attr]
        return max(repair, round_, key=self.posterior)

    def dropped(self, repair: Repair) -> Repair:
        """Without whatever it does better without."""
        while True:
            level = self.posterior(repair)
            others = [e.without for e in self.elements(repair)]
            better = max(others, key=self.posterior, default=repair)
            if better is repair or self.posterior(better) < level - MIN_GAIN:
                return repair
            if better == self.scene.none:
                return repair
            repair = better

    def exchanged(self, now: Repair) -> Repair:
        """One thing against another, where that is better."""
        elements = self.elements(now)
        if len(elements) < 2:
            return now
        for e in elements:
            other = self.added(e.without)
            if other is not None and self.posterior(other) > self.posterior(now) + MIN_GAIN:
                return self.dropped(other)
        return now

    def found(self, repair: Repair) -> Found:
        judged, elements = self.scene.judged, tuple(self.elements(repair))
        spreads = tuple(
            np.nan if e.number is None
            else deviation(judged, e.number.at, e.number.value, e.number.tolerance)
            for e in elements
        )  # fmt: skip
        before, after = judged.scores([self.scene.none, repair])
        gains = tuple(self.posterior(repair) - self.posterior(e.without) for e in elements)
        without = tuple(judged.scores([e.without for e in elements]))
        return Found(repair, elements, spreads, gains, without, before, after)


def _same_fit(a: Repair, b: Repair) -> bool:
    """Whether two repairs differ in signs alone: of torques, of gravity, of the direction of time."""
    one, other = (
        replace(r, reversed=False, gain=tuple(map(abs, r.gain)), gravity=_unsigned(r.gravity))
        for r in (a, b)
    )
    return one == other


def _unsigned(gravity: tuple[float, float, float]) -> tuple[float, float, float]:
    """The same or the opposite vector, whichever is larger in the first place where they differ."""
    x, y, z = gravity
    return max(gravity, (-x, -y, -z))
