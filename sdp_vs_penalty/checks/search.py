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
import scipy
from numpy.typing import NDArray

from sdp_vs_penalty.checks import constants as c
from sdp_vs_penalty.checks.arm_fit import ArmFit
from sdp_vs_penalty.checks.faults import FAULTS
from sdp_vs_penalty.checks.faults.fault import Fault, FaultSize, Transformation
from sdp_vs_penalty.checks.issue import EXPLANATION, Issue, joints_text
from sdp_vs_penalty.checks.likelihood import Likelihood
from sdp_vs_penalty.checks.repair import LogTransform
from sdp_vs_penalty.regression.normal_equations import standard_errors_above_zero
from sdp_vs_penalty.robot.arrays import Array

#: Faults that a motion shows whose directions are half as many as its joints.
SHOWN_BY_A_POOR_MOTION = "degrees", "sign", "mounting", "events"


class RepairSearch:
    """Of the rows of all runs together.

    log : these rows; logs : of each run, in which what is found has to hold as well;
    facts : what is known of each run already.
    """

    def __init__(
        self,
        log: Likelihood,
        logs: Sequence[Likelihood] = (),
        facts: Sequence[Sequence[Issue]] = (),
    ) -> None:
        self.log = log
        self.logs = logs or [log]
        self.samples = log.samples(log.score(log.as_logged))
        issues = [issue for of_run in facts for issue in of_run]
        self.known = {issue.kind for issue in issues}
        ranks = [f.figures["rank"] for f in issues if f.kind == "lockstep motion"]
        in_all_runs = len(ranks) == len(self.logs)
        is_low = 2 * max(ranks, default=0) <= len(log.joints)
        self.is_poor = in_all_runs and is_low
        self.elements = lru_cache(99)(self._elements)
        self.posterior = lru_cache(99)(self._posterior)
        #: Repairs, laws apart, that no law makes likely.
        self.hopeless: set[LogTransform] = set()

    def _elements(self, repair: LogTransform) -> tuple[Fault, ...]:
        return tuple(e for kind in FAULTS for e in kind.elements(self.log, repair))

    @property
    def faults(self) -> list[Transformation]:
        """What is tried: joints in lockstep cannot tell an order; a motion of few
        directions tells signs and the mounting alone."""
        if self.is_poor:
            return [kind for kind in FAULTS if kind.name in SHOWN_BY_A_POOR_MOTION]
        barred = {"order"} if "lockstep motion" in self.known else set()
        return [kind for kind in FAULTS if kind.name not in barred]

    # -- the posterior

    def likelihood(self, score: ArmFit, repair: LogTransform) -> float:
        """Log-likelihood less the repair's cost; round numbers come first."""
        cost = sum(e.cost + 0.5 * c.ODDS * e.odd for e in self.elements(repair))
        return -0.5 * self.samples * score.score - cost

    def _posterior(self, repair: LogTransform) -> float:
        score = self.log.score(repair)
        physics = self.log.physics(score, repair, self.samples)
        return self.likelihood(score, repair) + physics

    def _learn_samples(self, scores: Sequence[ArmFit]) -> None:
        """The error of a wrong arm lasts longer than noise does: of that the best fit
        knows most."""
        known = [self.log.samples(score) for score in scores]
        self.samples = max([self.samples, *known])
        self.posterior.cache_clear()

    def new(self, repair: LogTransform, now: LogTransform) -> list[Fault]:
        """What it does beyond another one; where that is the same by name, what it does
        otherwise."""
        known = {e.name: e.what for e in self.elements(now)}
        more = [e for e in self.elements(repair) if e.name not in known]
        changed = [e for e in self.elements(repair) if e.what != known.get(e.name)]
        return more or changed

    # -- adding one fault after the other

    def run(self) -> LogTransform:
        """The net repair."""
        now = self.log.as_logged
        for _ in range(c.MOST):
            better = self.add_best_fault(now)
            if better is None:
                break
            before = now
            now = self.rounded(better)
            if now.without_laws != before.without_laws:
                self.hopeless.clear()
        return self.with_settled_signs(now)

    def add_best_fault(self, now: LogTransform) -> LogTransform | None:
        """The best composition with one thing more, or None where none is believed."""
        refined = [self.refined(repair, now) for repair in self.proposals(now)]
        self._learn_samples([self.log.score(repair) for repair in refined])
        threshold = self.posterior(now) + c.ODDS
        likely = [r for r in refined if self.posterior(r) >= threshold]

        def rank(repair: LogTransform) -> int:
            """What explains as much by a law, which arms have, comes before a fault."""
            is_law = all(e.severity == "note" for e in self.new(repair, now))
            return -round(self.posterior(repair) + c.ODDS * is_law)

        for repair in sorted(likely, key=rank):
            if self.is_confirmed(repair, now):
                return repair
        return None

    def proposals(self, now: LogTransform) -> list[LogTransform]:
        """Repairs with one more fault that may be believed, the likeliest first.

        Parameters
        ----------
        now : LogTransform
            The repair that is extended.

        Returns
        -------
        list of LogTransform
            Of each fault the best number, MOST faults in all; and those of the same fit
            as ``now``, which physics alone tells apart.
        """
        gains = self._gains_on_few_rows(self._one_fault_more(now), now)
        likeliest = sorted(gains, key=lambda repair: -round(gains[repair]))
        same_fit = [repair for repair in likeliest if _same_fit(repair, now)]
        # A grid's neighbours must not crowd out another fault.
        best_of_fault: dict[frozenset[object], LogTransform] = {}
        for repair in likeliest:
            names = frozenset(fault.name for fault in self.elements(repair))
            best_of_fault.setdefault(names, repair)
        best = [*best_of_fault.values()]
        return list(dict.fromkeys(best[: c.MOST] + same_fit[: c.MOST]))

    def _one_fault_more(self, now: LogTransform) -> list[LogTransform]:
        """What each kind of fault proposes beside a repair."""
        score = self.log.score(now)
        repairs: list[LogTransform] = []
        for kind in self.faults:
            repairs += kind.proposals(self.log, now, score)
        return [
            repair
            for repair in dict.fromkeys(repairs)
            if repair != now and repair.without_laws not in self.hopeless
        ]

    def _gains_on_few_rows(
        self,
        repairs: Sequence[LogTransform],
        now: LogTransform,
    ) -> dict[LogTransform, float]:
        """By how much each repair raises the log-likelihood, on a third of the rows; of
        those alone that may reach the odds.

        A number's best value explains at most twice what a rough one does, and physics
        gives back at most what it takes of ``now``.
        """
        fits = self.log.screen.scores(repairs)
        fit_now = self.log.screen.score(now)
        self._learn_samples(sorted(fits, key=lambda fit: fit.score)[:1])
        taken_by_physics = self.likelihood(self.log.score(now), now)
        taken_by_physics -= self.posterior(now)
        least = c.ODDS - taken_by_physics
        before = self.likelihood(fit_now, now)
        gains = {}
        for repair, fit in zip(repairs, fits, strict=True):
            fall = 0.5 * self.samples * (fit_now.score - fit.score)
            at_best_number = max(fall, 0.0)
            if fall < -c.HOPELESS:
                self.hopeless.add(repair.without_laws)
            # Before the repair's cost, which takes longer to work out.
            if fall + at_best_number <= least:
                continue
            gain = self.likelihood(fit, repair) - before
            if gain + at_best_number > least:
                gains[repair] = gain
        return gains

    # -- what is believed

    def is_confirmed(self, repair: LogTransform, now: LogTransform) -> bool:
        """Whether a repair predicts what the arm was not fitted to, better than physics
        does, and its numbers are beyond what is usual.

        Parameters
        ----------
        repair : LogTransform
            With one more fault.
        now : LogTransform
            Without it.

        Returns
        -------
        bool
            Whether the fault is believed.
        """
        new = self.new(repair, now)
        if not all(self._is_determined(fault.number) for fault in new if fault.number):
            return False
        clearness = self.log.predicts(self._left_out(now), self._left_out(repair))
        threshold = self._least_clearness(new)
        if _same_fit(repair, now):
            return clearness > -threshold and self._is_told_by_physics(repair, now)
        if not self.is_poor and all(fault.kind == "torque sign" for fault in new):
            # Friction that drives its joint tells, whatever the fit.
            return clearness > -0.5 * threshold
        if clearness <= threshold:
            return False
        is_law = all(fault.severity == "note" for fault in new)
        return is_law or self.beats_physics(self.log, repair, now)

    def _least_clearness(self, new: Sequence[Fault]) -> float:
        """Standard errors by which new faults have to predict.

        Of a number, whose interval tells as well, half as clear a prediction of several
        joints is enough.
        """
        are_numbers = all(fault.number for fault in new)
        is_enough = are_numbers and len(self.log.joints) > 1
        return 0.5 * c.SIGMAS if is_enough else c.SIGMAS

    def _is_told_by_physics(self, repair: LogTransform, now: LogTransform) -> bool:
        """Whether positive inertia and friction tell two repairs of the same fit apart."""
        gain = self.posterior(repair) - self.posterior(now)
        return not self.is_poor and gain > c.LOUDEST_INERTIA

    def _left_out(self, repair: LogTransform) -> Array:
        """(PARTS, n) errors on the parts left out in turn."""
        weights = self.log.score(repair).weights
        return self.log.jackknife_errors(repair, weights)[1]

    def beats_physics(
        self,
        log: Likelihood,
        repair: LogTransform,
        now: LogTransform,
        strict: bool = False,
    ) -> bool:
        """Whether a fault explains parts left out of a log better than physics does.

        Every law that its joints may have is free to explain the same, with the fault
        and without. The odds of the fault have to exceed those against any, and the
        error of some joint has to fall by far.

        strict : no joint may speak against the fault.
        """
        before = self._errors_beside_physics(log, now)
        after = self._errors_beside_physics(log, repair)
        ratio = before.mean(axis=0) / after.mean(axis=0)
        is_harmless = np.exp(np.mean(np.log(ratio))) > 1.0
        if strict:
            is_harmless = not self._speaks_against(before, after).any()
        is_likely = 0.5 * self.samples * np.log(ratio).sum() > c.ODDS
        is_large = ratio.max() > self._least_ratio(repair, now)
        is_everywhere = self._shows_where_it_acts(np.log(ratio), repair, now)
        return bool(is_likely and is_large and is_harmless and is_everywhere)

    def _shows_where_it_acts(
        self,
        falls: Array,
        repair: LogTransform,
        now: LogTransform,
    ) -> bool:
        """Whether a number that all torques have in common (a delay, a filter) explains
        more than one joint.

        Parameters
        ----------
        falls : (K,) array
            Falls of the logarithm of each moving joint's error on parts left out.
        repair : LogTransform
            With one more fault.
        now : LogTransform
            Without it.

        Returns
        -------
        bool
            Whether the errors still fall together without the joint that gains most.
            True for any other fault, and for arms of one or two moving joints.
        """
        all_joints = tuple(range(self.log.n))
        faults = self.new(repair, now)
        is_shared = any(fault.number and fault.joints == all_joints for fault in faults)
        if not is_shared or len(falls) < 3:
            return True
        return bool(falls.sum() > falls.max())

    @staticmethod
    def _speaks_against(before: Array, after: Array) -> NDArray[np.bool_]:
        """Joints whose rising error speaks against a fault.

        Parameters
        ----------
        before, after : (PARTS, K) array
            Errors of K joints on parts left out, without the fault and with it.

        Returns
        -------
        (K,) array
            Whether the error rises by more than WORSE, by more than its scatter over the
            parts (one odd part is no rise), and by so much that it costs a third of the
            likelihood that the falling errors gain.
        """
        rises = np.log(after / before)
        clearness = np.array([standard_errors_above_zero(x) for x in rises.T])
        ratio = after.mean(axis=0) / before.mean(axis=0)
        gained = float(-np.log(ratio)[ratio < 1.0].sum())
        is_costly = c.TIMES * np.log(ratio) > gained
        is_clear = clearness > 0.5 * c.SIGMAS
        return np.asarray((ratio > c.WORSE) & is_clear & is_costly)

    def _errors_beside_physics(self, log: Likelihood, repair: LogTransform) -> Array:
        """(PARTS, K) energy that is left of each moving joint on parts left out, beside
        all laws of friction and position."""
        rich = log.beside_physics
        weights = rich.score(repair).weights
        return rich.jackknife_errors(repair, weights)[1][:, log.moving]

    def _least_ratio(self, repair: LogTransform, now: LogTransform) -> float:
        """By how much what is new has to divide what is left of some joint."""
        new = self.new(repair, now)
        # Friction with memory looks like a delay of its joint.
        is_late = any(e.kind in ("channel delay", "channel filter") for e in new)
        if self.is_poor or is_late:
            return c.MUCH
        return c.WITH_A_NUMBER if any(e.odd for e in new) else c.ONE_OF_FEW

    def confirmed(self, net: LogTransform) -> LogTransform:
        """Without what does not hold in every run: order, signs, units, gains, clock and
        mounting are those of the logger."""
        several = self.logs if len(self.logs) > 1 else []
        for fault in self.elements(net):
            if fault.severity == "note" or _same_fit(net, fault.without):
                continue
            stands = fault.kind == "torque sign" or self.beats_physics(
                self.log,
                net,
                fault.without,
                strict=True,
            )
            if not stands or not all(
                self._holds(log, net, fault.without) for log in several
            ):
                net = self._without(net, fault)
        return net

    def _without(self, net: LogTransform, fault: Fault) -> LogTransform:
        """The repair without a fault of that name, as it is now."""
        for element in self.elements(net):
            if element.name == fault.name:
                return element.without
        return net

    def _holds(
        self,
        log: Likelihood,
        net: LogTransform,
        without: LogTransform,
    ) -> bool:
        """Whether a run does not speak against what is said of all: its error on parts
        left out is no larger, where its joints move."""
        errors = [
            log.jackknife_errors(repair, log.score(repair).weights)[1]
            for repair in (without, net)
        ]
        fall = np.mean(np.log(errors[0]) - np.log(errors[1]), axis=0)
        return bool(np.mean(fall[log.moving]) > -0.1)

    # -- numbers

    def _is_determined(self, number: FaultSize) -> bool:
        """Beyond what is usual by more than its interval, which is closed: as far as
        the best value is looked for, to either side, it explains less."""
        spread = self.step(number)[1]
        reach = c.SIGMAS * spread
        if abs(number.value) <= number.tolerance + reach:
            return False
        if 2.0 * spread > max(number.tolerance, number.widest):
            return False
        far = max(number.search_radius, reach)
        repairs = [number.at(number.value + x) for x in (0.0, -far, far)]
        at_value, below, above = self.log.scores(repairs)
        fall = min(below.score, above.score) - at_value.score
        return self.samples * fall >= (0.5 * c.SIGMAS) ** 2

    def step(self, number: FaultSize) -> tuple[float, float]:
        """To first order, what a number lacks of its best value, and its standard
        deviation."""
        value = np.array([number.value])
        h = np.array([0.3 * number.tolerance])
        now = number.at(number.value)
        change, spread = self.log.first_order_steps(
            now,
            [number.at],
            value,
            h,
        )
        return float(change[0]), float(spread[0])

    def numbers(
        self, repair: LogTransform
    ) -> dict[tuple[str, tuple[int, ...]], FaultSize]:
        """The numbers of a repair, by the names of their elements."""
        return {e.name: e.number for e in self.elements(repair) if e.number}

    def refined(self, repair: LogTransform, now: LogTransform) -> LogTransform:
        """With the best values of its numbers, of those first that ``now`` does not
        have, and itself where these are none: looked for on few rows, then one step to
        first order on all; round ones where arms differ as much."""
        known = self.numbers(now)
        names = self.numbers(repair)
        if names.keys() <= known.keys():
            return repair
        for name in sorted(names, key=lambda name: name in known):
            number = self.numbers(repair)[name]
            best = self._best_on_few_rows(number)
            far = 0.9 * number.tolerance
            change = self.step(replace(number, value=best))[0]
            better = best + float(np.clip(change, -far, far))
            near = replace(number, value=better).round_within(number.tolerance)
            tried = [number.at(x) for x in near or (best, better)]
            repair = max(tried, key=lambda r: self.likelihood(self.log.score(r), r))
        return repair

    def _best_on_few_rows(self, number: FaultSize) -> float:
        """The number's value of the largest likelihood, or its own where none near is
        better."""

        def score(x: float) -> float:
            return self.log.screen.score(number.at(float(x))).score

        low = number.value - number.search_radius
        high = number.value + number.search_radius
        settings = {"xatol": 0.3 * number.tolerance, "maxiter": 14}
        minimum = scipy.optimize.minimize_scalar(
            score,
            bounds=(low, high),
            method="bounded",
            options=settings,
        )
        is_better = minimum.fun < score(number.value)
        return float(minimum.x) if is_better else number.value

    def rounded(self, repair: LogTransform) -> LogTransform:
        """A number that is believed becomes the round one from which it is not told as
        it is from none: by more than arms differ, and its standard errors."""
        names = [name for name, x in self.numbers(repair).items() if x.round_values]
        for name in names:
            number = self.numbers(repair)[name]
            reach = number.tolerance + c.SIGMAS * self.step(number)[1]
            for x in number.round_within(reach):
                repair = number.at(x)
        return repair

    # -- words

    def alone(self, net: LogTransform, element: Fault) -> LogTransform:
        """The repair that does one thing of the net repair, and no other."""
        for other in self.elements(net):
            if other.name != element.name:
                net = self._without(net, other)
        return net

    def describe_faults(self, net: LogTransform) -> list[Issue]:
        """An issue for each element of the net repair, with its interval and what it
        explains."""
        return [self.describe(fault, net) for fault in self.elements(net)]

    def describe(self, fault: Fault, net: LogTransform) -> Issue:
        """One element of the net repair as an issue."""
        odds = self.posterior(net) - self.posterior(fault.without)
        what = fault.what
        figures = {
            "joints": [j + 1 for j in fault.joints],
            **fault.figures,
            "log_odds": odds,
        }
        if fault.number is not None:
            reach = 2.0 * abs(self.step(fault.number)[1])
            ends = [fault.number.value - reach, fault.number.value + reach]
            figures["interval"] = ends
            low, high = map(fault.number.text, ends)
            what = f"{what.rstrip('.')} (95 %: {low} to {high})."
        equivalents = fault.equivalents
        if fault.kind == "torque sign":
            equivalents = self.signs_as_likely(net, fault.joints)
            if equivalents:
                what = f"{what} As likely: {'; '.join(equivalents)}."
        return Issue(
            kind=fault.kind,
            nature=EXPLANATION,
            severity=fault.severity,
            where=fault.place or joints_text(fault.joints),
            what=what,
            certainty=f"likely: {self._reason(fault, net)}",
            remedy=fault.remedy,
            repair=self.alone(net, fault).apply if fault.mends else None,
            figures=figures,
            gravity=_measured_gravity(net) if fault.is_of_gravity else None,
            apply=fault.apply,
            equivalents=equivalents,
        )

    def _reason(self, fault: Fault, net: LogTransform) -> str:
        """What speaks for a fault, in words."""
        after = self.log.score(net).shares
        change = np.log(self.log.score(fault.without).shares / after)
        j = int(np.argmax(change))
        if change[j] < 0.05:  # the fit is the same: physics alone tells
            return (
                "as recorded, friction would drive the motion, or inertia be negative"
            )
        before = 100.0 * np.sqrt(after[j] * np.exp(change[j]))
        return (
            f"what the arm's dynamics leave unexplained of joint {j + 1}'s torque falls"
            f" from {before:.3g} % to {100.0 * np.sqrt(after[j]):.3g} %"
        )

    def signs_as_likely(
        self,
        net: LogTransform,
        turned: Sequence[int],
    ) -> tuple[str, ...]:
        """Sets of torques whose sign may as well be the wrong ones: one joint more, or
        one less, to which neither physics nor the error on parts left out objects."""
        others = []
        for j in self.log.joints:
            joints = sorted({*turned} ^ {j})
            if not joints:
                continue
            objection, clearness = self._against_turning(net, j)
            if objection < c.LOUDEST_INERTIA and clearness < 0.5 * c.SIGMAS:
                others.append(f"the torque of {joints_text(joints)} has the wrong sign")
        unsigned = [j for j in turned if self._is_unsigned(net.tau_order[j])]
        if unsigned:
            others.append(f"the logger wrote magnitudes of {joints_text(unsigned)}")
        return tuple(others)

    def _is_unsigned(self, channel: int) -> bool:
        """Whether a torque channel (from 0) is never negative."""
        torque = self.log.data.torque(self.log.data.motion.t)[:, channel]
        return bool(np.all(torque >= 0.0))

    def with_settled_signs(self, net: LogTransform) -> LogTransform:
        """Where some torques count the other way: one joint more, or one less, if
        friction drives that joint otherwise and the fit on parts left out is no worse.

        The likelihood alone does not tell the sign of a joint that hardly moves the
        others.
        """
        if not any(fault.kind == "torque sign" for fault in self.elements(net)):
            return net
        for j in self.log.joints:
            objection, clearness = self._against_turning(net, j)
            if objection < -c.LOUDEST_INERTIA and clearness <= c.SIGMAS:
                net = net.times("gain", (j,), -1.0)
        return net

    def _against_turning(
        self,
        net: LogTransform,
        j: int,
    ) -> tuple[float, float]:
        """What speaks against another sign of one torque: the log-odds of physics, and
        the rise of the error on parts left out in standard errors."""
        other = net.times("gain", (j,), -1.0)
        fits = self.log.scores([net, other])
        physics_now = self.log.physics(fits[0], net, self.samples)
        physics_turned = self.log.physics(fits[1], other, self.samples)
        clearness = self.log.predicts(self._left_out(other), self._left_out(net))
        return physics_now - physics_turned, clearness


def _measured_gravity(net: LogTransform) -> tuple[float, ...]:
    """Gravity [m/s^2] that the torques hold, where a share of it is missing from all."""
    share = 1.0 - net.lacks[0] if len(set(net.lacks)) == 1 else 1.0
    return tuple(float(round(share * g, 3)) + 0.0 for g in net.gravity)


def _same_fit(a: LogTransform, b: LogTransform) -> bool:
    """Whether two repairs differ in signs alone: of torques, of gravity, of the
    direction of time."""

    def unsigned(repair: LogTransform) -> LogTransform:
        gravity = max(repair.gravity, tuple(-g for g in repair.gravity))
        gain = tuple(map(abs, repair.gain))
        return replace(repair, reversed=False, gain=gain, gravity=gravity)

    return unsigned(a) == unsigned(b)
