"""The search over compositions of transformations: add the best, refine its numbers.

What is maximised is one posterior, L + log p(physics) - cost of the repair (see likelihood.py). A
repair that is added has to predict parts of the log that the arm was not fitted to, and its number has
to lie beyond what arms and loggers differ by themselves, with its interval.
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np

from sdp_vs_penalty.checks import constants as c
from sdp_vs_penalty.checks.issue import Issue, joints_text
from sdp_vs_penalty.checks.likelihood import Likelihood, Score
from sdp_vs_penalty.checks.repair import Repair
from sdp_vs_penalty.checks.transformation import Element, Number, Transformation
from sdp_vs_penalty.checks.transformations import motion, torque

#: What is tried, in the order of the words; of what explains alike the first.
TRANSFORMATIONS: tuple[Transformation, ...] = (
    motion.Degrees(), motion.Clock(), motion.Sign(), motion.Exchange(), motion.Mounting(),
    torque.Weight(), torque.Law(), torque.Gain(), torque.Delay(), torque.Change(), motion.Length(),
    motion.Zero(), torque.Saturation(),
)  # fmt: skip


class Search:
    """Of one log."""

    def __init__(self, log: Likelihood) -> None:
        self.log = log
        self.samples = log.score(log.none).samples
        self._posteriors: dict[Repair, float] = {}
        self.elements = lru_cache(99)(self._elements)

    def _elements(self, repair: Repair) -> tuple[Element, ...]:
        return tuple(e for t in TRANSFORMATIONS for e in t.elements(self.log, repair))

    def likelihood(self, score: Score, repair: Repair) -> float:
        """Log-likelihood less the repair's cost."""
        told = self.elements(repair)
        odd = sum(
            e.number is not None and not np.isclose(e.number.value, e.number.snaps).any() for e in told
        )
        cost = sum(e.cost for e in told) + 0.5 * c.ODDS * odd  # round numbers come first
        return -0.5 * self.samples * score.score - cost

    def posterior(self, repair: Repair) -> float:
        if repair not in self._posteriors:
            score = self.log.score(repair)
            value = self.likelihood(score, repair) + score.physics(repair, self.samples)
            self._posteriors[repair] = value
        return self._posteriors[repair]

    def run(self) -> Repair:
        """The net repair."""
        now = self.log.none
        for _ in range(c.MOST):
            if (better := self.added(now)) is None:
                break
            now = better
        return now

    def proposals(self, now: Repair) -> list[Repair]:
        """One more thing that may be believed, the best first.

        A number's best value explains at most twice what a rough one does, and physics gives back at
        most what it takes of ``now``: what does not reach the odds so is not looked at."""
        score, screen = self.log.score(now), self.log.screen
        made = (t.proposals(self.log, now, score) for t in TRANSFORMATIONS)
        asked = [r for r in dict.fromkeys(r for some in made for r in some) if r != now]
        here, scores = screen.score(now), screen.scores(asked)
        self._known_of([min(scores, key=lambda s: s.score)] if scores else [])
        least = c.ODDS - self.likelihood(score, now) + self.posterior(now)
        gains = [0.5 * self.samples * (here.score - s.score) for s in scores]
        near = [i for i, gain in enumerate(gains) if gain + max(gain, 0.0) > least]  # before its cost
        before = self.likelihood(here, now)
        value = {i: self.likelihood(scores[i], asked[i]) - before for i in near}
        order = sorted(
            (i for i in near if value[i] + max(gains[i], 0.0) > least), key=lambda i: -round(value[i])
        )
        tied = [i for i in order if _same_fit(asked[i], now)]
        # Of each thing its best number: a grid's neighbours must not crowd out another thing.
        best: dict[frozenset[object], int] = {}
        for i in order:
            best.setdefault(frozenset(e.name for e in self.elements(asked[i])), i)
        return [asked[i] for i in dict.fromkeys([*best.values()][: c.MOST] + tied[: c.MOST])]

    def added(self, now: Repair) -> Repair | None:
        """The best composition with one thing more, or None where none is believed."""
        refined = [self.refined(r, now) for r in self.proposals(now)]
        self._known_of([self.log.score(r) for r in refined])
        known, least = {e.name for e in self.elements(now)}, self.posterior(now) + c.ODDS

        def rank(repair: Repair) -> int:
            """What explains as much by a law, which arms have, comes before a fault."""
            law = all(e.severity == "note" for e in self.elements(repair) if e.name not in known)
            return -round(self.posterior(repair) + c.ODDS * law)

        likely = [
            r
            for r in refined  # physics, which takes longer, only lowers it
            if self.likelihood(self.log.score(r), r) >= least and self.posterior(r) >= least
        ]
        return next((r for r in sorted(likely, key=rank) if self.believed(r, now)), None)

    def _known_of(self, scores: Sequence[Score]) -> None:
        """The error of a wrong arm lasts longer than noise does: of that the best one knows most."""
        self.samples = max([self.samples, *(s.samples for s in scores)])
        self._posteriors.clear()

    def believed(self, repair: Repair, now: Repair) -> bool:
        """Whether it predicts what the arm was not fitted to, and its numbers are beyond what is
        usual."""
        fits, known = self.log, {e.name for e in self.elements(now)}
        numbers = [e.number for e in self.elements(repair) if e.name not in known and e.number]
        if not all(map(self._determined, numbers)):
            return False
        before, after = (fits.left_out(r, fits.score(r).weights)[1] for r in (now, repair))
        # Where the fit is the same, physics alone may tell.
        return fits.predicts(before, after) > (-c.SIGMAS if _same_fit(repair, now) else c.SIGMAS)

    def _determined(self, number: Number) -> bool:
        """Beyond what is usual by more than its interval, which is closed: at either of its ends, and as
        far as the best value is looked for, it explains less."""
        reach = c.SIGMAS * self.deviation(number)
        if abs(number.value) <= number.tolerance + reach:
            return False
        far = max(number.reach, reach)
        values = [number.value + d * far for d in (0.0, -1.0, 1.0)]
        here, *sides = self.log.scores([number.at(x) for x in values])
        return 0.5 * self.samples * (min(s.score for s in sides) - here.score) >= 0.5 * c.SIGMAS**2

    def deviation(self, number: Number) -> float:
        """A number's standard deviation."""
        now, h = number.at(number.value), 0.3 * number.tolerance
        return float(self.log.steps(now, [number.at], np.array([number.value]), h)[1][0])

    def refined(self, repair: Repair, now: Repair) -> Repair:
        """With the best values of the numbers that ``now`` does not have: looked for on few rows, then
        one step of Newton's on all; round ones where as likely."""
        from scipy.optimize import minimize_scalar

        known = {e.name for e in self.elements(now)}
        for name in [e.name for e in self.elements(repair) if e.number and e.name not in known]:
            number = next(e.number for e in self.elements(repair) if e.name == name)
            assert number is not None
            ends = number.value - number.reach, number.value + number.reach
            few = lambda x, at=number.at: self.log.screen.score(at(float(x))).score  # noqa: E731
            settings = {"xatol": 0.3 * number.tolerance, "maxiter": 14}
            found = minimize_scalar(few, bounds=ends, method="bounded", options=settings)
            best = float(found.x) if found.fun < few(number.value) else number.value
            h = 0.3 * number.tolerance
            around = self.log.scores([number.at(best + d * h) for d in (-1.0, 0.0, 1.0)])
            # Of the joints' weights here, what is left is a parabola.
            low, here, high = (float(around[1].weights @ s.left) for s in around)
            bend = max(low - 2.0 * here + high, 1e-300)
            better = best + h * float(np.clip(0.5 * (low - high) / bend, -3.0, 3.0))
            near = [x for x in number.snaps if abs(x - better) < number.tolerance]
            tried = [number.at(x) for x in near or (best, better)]
            repair = max(tried, key=lambda r: self.likelihood(self.log.score(r), r))
        return repair

    def told(self, net: Repair) -> tuple[list[Issue], Repair]:
        """An issue for each element of the net repair, with its interval and what it explains; the
        repair without what is only likely."""
        certain, out, after = net, list[Issue](), self.log.score(net).shares
        for e in self.elements(net):
            gain = self.posterior(net) - self.posterior(e.without)
            change = np.log(self.log.score(e.without).shares / after)
            j, word = int(np.argmax(change)), "certain" if gain > c.LOUDEST else "likely"
            before, now = (100.0 * np.sqrt(after[j] * x) for x in (np.exp(change[j]), 1.0))
            why = (
                f"what the arm's dynamics leave unexplained of joint {j + 1}'s torque falls from "
                f"{before:.3g} % to {now:.3g} %"
            )
            if change[j] < 0.05:  # the fit is the same: physics alone tells
                why = "as recorded, friction would drive the motion, or inertia be negative"
            figures = {"joints": [j + 1 for j in e.joints], **e.figures, "log_odds": gain}
            what, gravity = e.what, None
            if (number := e.number) is not None:
                reach = 2.0 * self.deviation(number)
                figures["interval"] = ends = [number.value - reach, number.value + reach]
                low, high = map(number.text, ends)
                what = f"{what.rstrip('.')} (95 %: {low} to {high})."
            if e.kind.startswith("gravity"):
                share = 1.0 - net.lacks[0] if len(set(net.lacks)) == 1 else 1.0
                gravity = tuple(float(round(share * g, 3)) + 0.0 for g in net.gravity)
            mend = net.apply if e.mends else None
            sure, where = f"{word}: {why}", e.place or joints_text(e.joints)
            out.append(Issue(e.kind, e.severity, where, what, sure, e.remedy, mend, figures, gravity))
            if not out[-1].mends:
                certain = next((x.without for x in self.elements(certain) if x.name == e.name), certain)
        return out, certain


def _same_fit(a: Repair, b: Repair) -> bool:
    """Whether two repairs differ in signs alone: of torques, of gravity, of the direction of time."""

    def unsigned(r: Repair) -> Repair:
        gravity = max(r.gravity, (-r.gravity[0], -r.gravity[1], -r.gravity[2]))
        return replace(r, reversed=False, gain=tuple(map(abs, r.gain)), gravity=gravity)

    return unsigned(a) == unsigned(b)
