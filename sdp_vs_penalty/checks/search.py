"""The search over compositions of transformations: add the best, refine its numbers.

What is maximised is one posterior, L + log p(physics) - cost of the repair (see
likelihood.py). A repair that is added has to predict parts of the log that the arm was
not fitted to, and its number has to lie beyond what arms and loggers differ by
themselves, with its interval.
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np

from sdp_vs_penalty.checks import constants as c
from sdp_vs_penalty.checks.faults import FAULTS
from sdp_vs_penalty.checks.faults.fault import Fault, FaultSize, Transformation
from sdp_vs_penalty.checks.issue import EXPLANATION, Issue, joints_text
from sdp_vs_penalty.checks.likelihood import ArmFit, Likelihood
from sdp_vs_penalty.checks.repair import LogTransform

#: Faults that a motion shows whose directions are half as many as its joints.
TOLD_BY_A_POOR_MOTION = "degrees", "sign", "mounting", "events"


class RepairSearch:
    """Of the rows of all runs together; logs : of each run, in which what is found has
    to hold as well; facts : what is known of each run already."""

    def __init__(
        self,
        log: Likelihood,
        logs: Sequence[Likelihood] = (),
        facts: Sequence[Sequence[Issue]] = (),
    ) -> None:
        self.log, self.samples = log, log.score(log.none).samples
        self.logs = logs or [log]
        every = [issue for issues in facts for issue in issues]
        self.known = {issue.kind for issue in every}
        ranks = [f.figures["rank"] for f in every if f.kind == "lockstep motion"]
        same = len(ranks) == len(self.logs)
        self.is_poor = same and 2 * max(ranks, default=0) <= len(log.joints)
        self.elements = lru_cache(99)(self._elements)
        self.posterior = lru_cache(99)(self._posterior)

    def _elements(self, repair: LogTransform) -> tuple[Fault, ...]:
        return tuple(e for t in FAULTS for e in t.elements(self.log, repair))

    @property
    def faults(self) -> list[Transformation]:
        """What is tried: joints in lockstep cannot tell an order; a motion of few
        directions tells signs and the mounting alone."""
        if self.is_poor:
            return [fault for fault in FAULTS if fault.name in TOLD_BY_A_POOR_MOTION]
        barred = {"order"} if "lockstep motion" in self.known else set()
        return [fault for fault in FAULTS if fault.name not in barred]

    def likelihood(self, score: ArmFit, repair: LogTransform) -> float:
        """Log-likelihood less the repair's cost; round numbers come first."""
        cost = sum(e.cost + 0.5 * c.ODDS * e.odd for e in self.elements(repair))
        return -0.5 * self.samples * score.score - cost

    def _posterior(self, repair: LogTransform) -> float:
        score = self.log.score(repair)
        return self.likelihood(score, repair) + score.physics(repair, self.samples)

    def new(self, repair: LogTransform, now: LogTransform) -> list[Fault]:
        """What it does beyond another one; where that is the same by name, what it does
        otherwise."""
        known = {e.name: e.what for e in self.elements(now)}
        more = [e for e in self.elements(repair) if e.name not in known]
        return more or [e for e in self.elements(repair) if e.what != known[e.name]]

    def run(self) -> LogTransform:
        """The net repair."""
        now = self.log.none
        for _ in range(c.MOST):
            if (better := self.add_best_fault(now)) is None:
                break
            now = self.rounded(better)
        return now

    def proposals(self, now: LogTransform) -> list[LogTransform]:
        """One more thing that may be believed, the best first.

        A number's best value explains at most twice what a rough one does, and physics
        gives back at most what it takes of ``now``: what does not reach the odds so is
        not looked at."""
        score = self.log.score(now)
        screen = self.log.screen
        proposed = (t.proposals(self.log, now, score) for t in self.faults)
        new_repairs = [
            r for r in dict.fromkeys(r for some in proposed for r in some) if r != now
        ]
        score_now = screen.score(now)
        scores = dict(zip(new_repairs, screen.scores(new_repairs), strict=True))
        self._known_of(sorted(scores.values(), key=lambda s: s.score)[:1])
        threshold = c.ODDS - self.likelihood(score, now) + self.posterior(now)
        gain = {
            r: 0.5 * self.samples * (score_now.score - s.score)
            for r, s in scores.items()
        }
        more = {r: max(x, 0.0) for r, x in gain.items()}
        before = self.likelihood(score_now, now)
        near = [
            r for r in new_repairs if gain[r] + more[r] > threshold
        ]  # before its cost
        value = {r: self.likelihood(scores[r], r) - before for r in near}
        order = sorted(
            (r for r in near if value[r] + more[r] > threshold),
            key=lambda r: -round(value[r]),
        )
        tied = [r for r in order if _same_fit(r, now)]
        # Of each thing its best number: a grid's neighbours must not crowd out another
        # thing.
        best: dict[frozenset[object], LogTransform] = {}
        for r in order:
            best.setdefault(frozenset(e.name for e in self.elements(r)), r)
        return list(dict.fromkeys([*best.values()][: c.MOST] + tied[: c.MOST]))

    def add_best_fault(self, now: LogTransform) -> LogTransform | None:
        """The best composition with one thing more, or None where none is believed."""
        refined = [self.refined(r, now) for r in self.proposals(now)]
        self._known_of([self.log.score(r) for r in refined])
        threshold = self.posterior(now) + c.ODDS
        likely = [r for r in refined if self.posterior(r) >= threshold]

        def rank(repair: LogTransform) -> int:
            """What explains as much by a law, which arms have, comes before a fault."""
            law = all(e.severity == "note" for e in self.new(repair, now))
            return -round(self.posterior(repair) + c.ODDS * law)

        return next(
            (r for r in sorted(likely, key=rank) if self.is_confirmed(r, now)), None
        )

    def _known_of(self, scores: Sequence[ArmFit]) -> None:
        """The error of a wrong arm lasts longer than noise does: of that the best one
        knows most."""
        self.samples = max([self.samples, *(s.samples for s in scores)])
        self.posterior.cache_clear()

    def is_confirmed(self, repair: LogTransform, now: LogTransform) -> bool:
        """Whether it predicts what the arm was not fitted to, better than physics does,
        and its numbers are beyond what is usual.
        Of a number, whose interval tells as well, half as clear a prediction of several
        joints is enough."""
        fits = self.log
        new = self.new(repair, now)
        if not all(self._determined(e.number) for e in new if e.number):
            return False
        before = fits.jackknife_errors(now, fits.score(now).weights)[1]
        after = fits.jackknife_errors(repair, fits.score(repair).weights)[1]
        threshold = c.SIGMAS * (
            0.5 if len(fits.joints) > 1 and all(e.number for e in new) else 1.0
        )
        # Where the fit is the same, physics alone may tell.
        if _same_fit(repair, now):
            gain = self.posterior(repair) - self.posterior(now)
            told = not self.is_poor and gain > c.LOUDEST_INERTIA
            return told and fits.predicts(before, after) > -threshold
        if self._signs_alone(new) and not self.is_poor:
            # Friction that drives its joint tells, whatever the fit.
            return fits.predicts(before, after) > -0.5 * threshold
        is_law = all(e.severity == "note" for e in new)
        return fits.predicts(before, after) > threshold and (
            is_law or self.beats_physics(fits, repair, now)
        )

    def _signs_alone(self, new: Sequence[Fault]) -> bool:
        """Whether all that is new are signs of torques, which no effect explains."""
        return all(e.kind == "torque sign" for e in new)

    def beats_physics(
        self,
        log: Likelihood,
        repair: LogTransform,
        now: LogTransform,
        strict: bool = False,
    ) -> bool:
        """Whether a fault makes the error on parts left out of a log smaller in some
        joint, where every law that its joints may have is free to
        explain the same, with the fault and without."""
        rich = log.beside_physics
        errors = [
            np.mean(rich.jackknife_errors(r, rich.score(r).weights)[1], axis=0)
            for r in (now, repair)
        ]
        ratio = (errors[0] / errors[1])[log.moving]
        new = self.new(repair, now)
        has_number = any(e.odd for e in new)
        least = c.WITH_A_NUMBER if has_number else c.ONE_OF_FEW
        # Friction with memory looks like a delay of its joint.
        is_late = any(e.kind in ("channel delay", "channel filter") for e in new)
        least = c.MUCH if self.is_poor or is_late else least
        harmless = np.exp(np.mean(np.log(ratio))) > 1.0
        if strict:
            harmless = ratio.min() > 1.0 / c.WORSE
        return bool(ratio.max() > least and harmless)

    def confirmed(self, net: LogTransform) -> LogTransform:
        """Without what does not hold in every run: order, signs, units, gains, clock and
        mounting are those of the logger."""
        for e in self.elements(net):
            if e.severity == "note" or _same_fit(net, e.without):
                continue
            several = self.logs if len(self.logs) > 1 else []
            stands = e.kind == "torque sign" or self.beats_physics(
                self.log, net, e.without, strict=True
            )
            if not stands or not all(self._holds(x, net, e.without) for x in several):
                known = [x for x in self.elements(net) if x.name == e.name]
                net = known[0].without if known else net
        return net

    def _holds(self, log: Likelihood, net: LogTransform, without: LogTransform) -> bool:
        """Whether a run does not speak against what is said of all: its error on parts
        left out is no larger, where its joints move."""
        before = np.mean(
            np.log(log.jackknife_errors(without, log.score(without).weights)[1]), axis=0
        )
        after = np.mean(
            np.log(log.jackknife_errors(net, log.score(net).weights)[1]), axis=0
        )
        return bool(np.mean((before - after)[log.moving]) > -0.1)

    def _determined(self, number: FaultSize) -> bool:
        """Beyond what is usual by more than its interval, which is closed: as far as
        the best value is looked for, to either side, it explains less."""
        spread = self.step(number)[1]
        reach = c.SIGMAS * spread
        if abs(number.value) <= number.tolerance + reach:
            return False
        if 2.0 * spread > max(number.tolerance, number.widest):
            return False
        far = max(number.search_radius, reach)
        score_now, *sides = self.log.scores(
            [number.at(number.value + x) for x in (0.0, -far, far)]
        )
        return (
            self.samples * (min(s.score for s in sides) - score_now.score)
            >= (0.5 * c.SIGMAS) ** 2
        )

    def step(self, number: FaultSize) -> tuple[float, float]:
        """To first order, what a number lacks of its best value, and its standard
        deviation."""
        value, h = np.array([[number.value], [0.3 * number.tolerance]])
        (change,), (spread,) = self.log.first_order_steps(
            number.at(number.value), [number.at], value, h
        )
        return float(change), float(spread)

    def numbers(
        self, repair: LogTransform
    ) -> dict[tuple[str, tuple[int, ...]], FaultSize]:
        """The numbers of a repair, by the names of their elements."""
        return {e.name: e.number for e in self.elements(repair) if e.number}

    def refined(self, repair: LogTransform, now: LogTransform) -> LogTransform:
        """With the best values of its numbers, of those first that ``now`` does not
        have, and itself where these are none: looked for on few rows, then one step to
        first order on all; round ones where arms differ as much."""
        from scipy.optimize import minimize_scalar

        known = self.numbers(now)
        sizes = self.numbers(repair)
        if sizes.keys() <= known.keys():
            return repair
        for name in sorted(sizes, key=lambda name: name in known):
            number = self.numbers(repair)[name]
            ends = (
                number.value - number.search_radius,
                number.value + number.search_radius,
            )
            screened_score = lambda x, at=number.at: (  # noqa: E731
                self.log.screen.score(at(float(x))).score
            )
            settings = {"xatol": 0.3 * number.tolerance, "maxiter": 14}
            minimum = minimize_scalar(
                screened_score, bounds=ends, method="bounded", options=settings
            )
            best = (
                float(minimum.x)
                if minimum.fun < screened_score(number.value)
                else number.value
            )
            change = self.step(replace(number, value=best))[0]
            far = 0.9 * number.tolerance
            better = best + float(np.clip(change, -far, far))
            near = replace(number, value=better).round_within(number.tolerance)
            tried = [number.at(x) for x in near or (best, better)]
            repair = max(tried, key=lambda r: self.likelihood(self.log.score(r), r))
        return repair

    def rounded(self, repair: LogTransform) -> LogTransform:
        """A number that is believed becomes the round one from which it is not told as
        it is from none: by more than arms differ, and its standard errors."""
        for name in [
            name for name, number in self.numbers(repair).items() if number.round_values
        ]:
            number = self.numbers(repair)[name]
            for x in number.round_within(
                number.tolerance + c.SIGMAS * self.step(number)[1]
            ):
                repair = number.at(x)
        return repair

    def alone(self, net: LogTransform, element: Fault) -> LogTransform:
        """The repair that does one thing of the net repair, and no other."""
        for other in self.elements(net):
            if other.name != element.name:
                here = [x for x in self.elements(net) if x.name == other.name]
                net = here[0].without if here else net
        return net

    def describe_faults(self, net: LogTransform) -> list[Issue]:
        """An issue for each element of the net repair, with its interval and what it
        explains."""
        out = list[Issue]()
        after = self.log.score(net).shares
        for e in self.elements(net):
            gain = self.posterior(net) - self.posterior(e.without)
            change = np.log(self.log.score(e.without).shares / after)
            j = int(np.argmax(change))
            before = 100.0 * np.sqrt(after[j] * np.exp(change[j]))
            now = 100.0 * np.sqrt(after[j] * 1.0)
            why = (
                f"what the arm's dynamics leave unexplained of joint {j + 1}'s torque"
                f" falls from {before:.3g} % to {now:.3g} %"
            )
            if change[j] < 0.05:  # the fit is the same: physics alone tells
                why = (
                    "as recorded, friction would drive the motion, or inertia be"
                    " negative"
                )
            figures = {
                "joints": [j + 1 for j in e.joints],
                **e.figures,
                "log_odds": gain,
            }
            what = e.what
            gravity = None
            if (number := e.number) is not None:
                reach = 2.0 * abs(self.step(number)[1])
                figures["interval"] = ends = [
                    number.value - reach,
                    number.value + reach,
                ]
                low, high = map(number.text, ends)
                what = f"{what.rstrip('.')} (95 %: {low} to {high})."
            if e.kind.startswith("gravity"):
                share = 1.0 - net.lacks[0] if len(set(net.lacks)) == 1 else 1.0
                gravity = tuple(float(round(share * g, 3)) + 0.0 for g in net.gravity)
            equivalents = e.equivalents
            if e.kind == "torque sign":
                equivalents = self.signs_as_likely(net, e.joints)
                if equivalents:
                    what = f"{what} As likely: {'; '.join(equivalents)}."
            mend = self.alone(net, e).apply if e.mends else None
            issue = Issue(
                kind=e.kind,
                nature=EXPLANATION,
                severity=e.severity,
                where=e.place or joints_text(e.joints),
                what=what,
                certainty=f"likely: {why}",
                remedy=e.remedy,
                repair=mend,
                figures=figures,
                gravity=gravity,
                apply=e.apply,
                equivalents=equivalents,
            )
            out.append(issue)
        return out

    def signs_as_likely(
        self, net: LogTransform, turned: Sequence[int]
    ) -> tuple[str, ...]:
        """Sets of torques whose sign may as well be the wrong ones: one joint more, or
        one less, at posterior odds below those against a fault."""
        others = []
        for j in self.log.joints:
            joints = sorted({*turned} ^ {j})
            other = net.times("gain", (j,), -1.0)
            if joints and self.posterior(other) > self.posterior(net) - c.ODDS:
                others.append(f"the torque of {joints_text(joints)} has the wrong sign")
        return tuple(others)


def _same_fit(a: LogTransform, b: LogTransform) -> bool:
    """Whether two repairs differ in signs alone: of torques, of gravity, of the
    direction of time."""

    def unsigned(r: LogTransform) -> LogTransform:
        gravity = max(r.gravity, tuple(-g for g in r.gravity))
        return replace(r, reversed=False, gain=tuple(map(abs, r.gain)), gravity=gravity)

    return unsigned(a) == unsigned(b)
