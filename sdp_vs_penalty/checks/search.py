"""The search over compositions of transformations: add the best, refine its numbers.

What is maximised is one posterior, L + log p(physics) - cost of the repair (see
likelihood.py). A repair that is added has to predict parts of the log that the arm was
not fitted to, and its number has to lie beyond what arms and loggers differ by
themselves, with its interval.
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from itertools import permutations
from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from sdp_vs_penalty.checks import constants as c
from sdp_vs_penalty.checks.arm_fit import ArmFit, text_of_share
from sdp_vs_penalty.checks.certainty import likely
from sdp_vs_penalty.checks.faults import FAULTS
from sdp_vs_penalty.checks.faults.fault import Fault, FaultSize, Transformation
from sdp_vs_penalty.checks.issue import (
    EXPLANATION,
    Issue,
    joints_text,
    with_rival_effects,
)
from sdp_vs_penalty.checks.likelihood import Likelihood
from sdp_vs_penalty.checks.repair import LogTransform
from sdp_vs_penalty.checks.report import Report
from sdp_vs_penalty.checks.rival_effects import (
    RivalEffect,
    is_clearly_worse,
    rival_effects,
)
from sdp_vs_penalty.checks.run_log import RunLog
from sdp_vs_penalty.checks.torque_size import far_from_nominal
from sdp_vs_penalty.regression.evidence import (
    log_odds,
    standard_errors_above_zero,
    student_95,
)
from sdp_vs_penalty.robot.arrays import Array

#: Faults that a motion shows whose directions are half as many as its joints.
SHOWN_BY_A_POOR_MOTION = "degrees", "sign", "mounting", "events"


#: Additional prior odds (natural logarithm) against a size that is no round value.
_ODDS_AGAINST_UNEVEN = 0.5 * c.LOG_ODDS_AGAINST_FAULT
#: A fall of the logarithm of the squared residual below this is no change of the fit.
_SAME_FIT_FALL = 0.05
#: A run speaks against a fault where it raises the logarithm of the squared residual on
#: held-out parts by more than this, in the mean over the joints.
_RISE_THAT_OBJECTS = 0.1
#: A rise of some joints' errors is costly, unless the others gain so many times as much in
#: log-likelihood: a right repair moves some of the error from joint to joint.
_GAIN_OVER_RISE = 3.0
#: Rounds of the bounded search for the best size, and its precision in tolerances [-].
_ROUNDS_OF_SIZE_SEARCH = 14
_PRECISION_OF_SIZE = 0.3


class Rival(NamedTuple):
    """What explains a log as well as a fault does."""

    #: Kind of its issue.
    kind: str
    #: Joints of the issue, from 0.
    joints: tuple[int, ...]
    #: What is wrong, in one sentence.
    what: str


class RepairSearch:
    """Search for the repair of the largest posterior, one fault after the other.

    log : rows of all runs together; logs : of each run, in which each fault has to hold
    as well; reports : of each run, with its facts.
    """

    def __init__(
        self,
        log: Likelihood,
        logs: Sequence[Likelihood] = (),
        reports: Sequence[Report] = (),
    ) -> None:
        """Prepare a search for the likeliest repair of the log of one or several runs.

        log : rows of all runs together; logs : rows of each run, in which each fault
        has to hold as well; empty: one run alone. reports : of each run, with the joints
        that move in lockstep; empty: none do.
        """
        self.log = log
        self.logs = logs or [log]
        self.independent_samples = log.count_independent_samples(log.fit(log.as_logged))
        self.has_lockstep = any(report.lockstep is not None for report in reports)
        self.has_few_directions = bool(reports) and all(
            report.has_poor_motion for report in reports
        )
        self.list_faults = lru_cache(99)(self._list_faults)
        self.posterior = lru_cache(99)(self._posterior)
        self.is_confirmed = lru_cache(99)(self._is_confirmed)
        self.gauss_newton_step = lru_cache(99)(self._make_gauss_newton_step)
        self._held_out_errors = lru_cache(99)(self._make_held_out_errors)
        self._rival_effects = lru_cache(99)(self._make_rival_effects)
        #: Repairs (without laws of friction) that fit so badly that no law can help.
        self.hopeless_repairs: set[LogTransform] = set()
        #: By the name of a fault that was added, the faults that explain as much.
        self.rivals_by_fault: dict[tuple[str, tuple[int, ...]], tuple[Fault, ...]] = {}

    def _list_faults(self, repair: LogTransform) -> tuple[Fault, ...]:
        """List the faults of all kinds that a repair corrects; call it as
        :attr:`list_faults`, which caches the result.
        """
        faults: list[Fault] = []
        for kind in FAULTS:
            faults += kind.list_faults(self.log, repair)
        return tuple(faults)

    @property
    def kinds_of_fault(self) -> list[Transformation]:
        """Kinds of fault that the search may propose for this log.

        All kinds in FAULTS, with two exceptions. Where the motion of every run covers few
        directions (at most half as many as moving joints), only units, signs, the mounting and
        events show in the torques. Where joints move in lockstep, their channels look
        the same, so that an exchanged order is not proposed.
        """
        if self.has_few_directions:
            return [kind for kind in FAULTS if kind.name in SHOWN_BY_A_POOR_MOTION]
        if self.has_lockstep:
            return [kind for kind in FAULTS if kind.name != "order"]
        return list(FAULTS)

    # -- the posterior

    def likelihood(self, score: ArmFit, repair: LogTransform) -> float:
        """Return the log-likelihood of a repair plus the logarithm of its prior odds.

        It is L = -N / 2 sum_j log(S_j / |tau_j|^2) - sum of the costs of the corrected
        faults, with N independent samples and S_j the squared residual of joint j. A
        fault costs its prior log-odds; a size that is no round value costs more.

        Parameters
        ----------
        score : ArmFit
            One arm fitted to the rows under the repair.
        repair : LogTransform
            How the log is repaired.
        """
        cost = sum(
            e.log_odds_against + _ODDS_AGAINST_UNEVEN * e.has_uneven_size
            for e in self.list_faults(repair)
        )
        return score.log_likelihood(self.independent_samples) - cost

    def _posterior(self, repair: LogTransform) -> float:
        """Compute the log-posterior (natural logarithm) of a repair.

        It is likelihood times prior odds times the probability of physics (friction
        takes power, inertia is positive). Call it as :attr:`posterior`, which caches
        the result.
        """
        score = self.log.fit(repair)
        physics = self.log.physics(score, repair, self.independent_samples)
        return self.likelihood(score, repair) + physics

    def _learn_samples(self, scores: Sequence[ArmFit]) -> None:
        """Raise ``independent_samples`` to the largest number of any of these fits.

        A wrong repair leaves a residual that is correlated over more rows than noise
        is, so that the best fit has the most independent samples. Posteriors, and what
        is confirmed, depend on the number: their caches are emptied.
        """
        counts = [self.log.count_independent_samples(score) for score in scores]
        self.independent_samples = max([self.independent_samples, *counts])
        self.posterior.cache_clear()
        self.is_confirmed.cache_clear()

    def new_faults(self, repair: LogTransform, now: LogTransform) -> list[Fault]:
        """List the faults that ``repair`` corrects and ``now`` does not.

        Faults are compared by name (kind and joints). If no name is new, the faults are
        listed whose size differs between the two repairs; a fault without a size (an
        order of three channels) differs in its sentence. None is listed where
        ``repair`` only takes corrections of ``now`` back.

        Parameters
        ----------
        repair : LogTransform
            The repair with one more correction.
        now : LogTransform
            The repair that it extends.
        """
        known = {fault.name: _extent(fault) for fault in self.list_faults(now)}
        faults = self.list_faults(repair)
        added = [fault for fault in faults if fault.name not in known]
        if added:
            return added
        return [fault for fault in faults if _extent(fault) != known[fault.name]]

    # -- adding one fault after the other

    def run(self) -> LogTransform:
        """Find the repair of all faults: add the best fault until none is confirmed.

        The search starts at the log as recorded. It stops at MAX_FAULTS faults. After
        each fault sizes are rounded where the data allow it; at the end signs are
        settled by physics.

        Returns
        -------
        LogTransform
            One repair that corrects all faults found; unchanged where there are none.
        """
        now = self.log.as_logged
        for _ in range(c.MAX_FAULTS):
            better = self.add_best_fault(now)
            if better is None:
                break
            before = now
            now = self.round_sizes(better)
            if now.without_laws != before.without_laws:
                self.hopeless_repairs.clear()
        return self.with_settled_signs(now)

    def add_best_fault(self, now: LogTransform) -> LogTransform | None:
        """Return the likeliest repair with one more fault that held-out parts confirm.

        Of repairs that are as likely, the one with the most plausible size is returned,
        and the others are recorded as rivals.

        Parameters
        ----------
        now : LogTransform
            The repair that is extended.

        Returns
        -------
        LogTransform or None
            ``now`` with one more fault corrected; None if no further fault is
            confirmed.
        """
        refined = []
        fits = []
        for repair in self.proposals(now):
            if self._may_be_determined(repair, now):
                repair = self.refine(repair, now)
                refined.append(repair)
            fits.append(self.log.fit(repair))
        self._learn_samples(fits)
        threshold = self.posterior(now) + c.LOG_ODDS_OF_A_CLAIM
        # Physics only takes from the likelihood, and takes long to compute.
        likely = [
            repair
            for repair in refined
            if self.likelihood(self.log.fit(repair), repair) >= threshold
            and self.posterior(repair) >= threshold
        ]

        def rank(repair: LogTransform) -> int:
            """Sort key: the larger posterior first; a law of friction or a spring
            (severity "note"), which arms have, before a fault that is as likely."""
            is_law = _is_law(self.new_faults(repair, now))
            return -round(self.posterior(repair) + c.LOG_ODDS_AGAINST_FAULT * is_law)

        for repair in sorted(likely, key=rank):
            if self.is_confirmed(repair, now):
                tied = [repair, *self._as_likely(repair, now, likely)]
                best = self._of_most_plausible_size(tied, now)
                self._note_rivals(best, tied, now)
                return best
        return None

    def _as_likely(
        self, repair: LogTransform, now: LogTransform, likely: Sequence[LogTransform]
    ) -> list[LogTransform]:
        """List the repairs that are about as likely as a confirmed one, ``repair``, and
        that parts left out confirm, or do not tell from it.

        "About as likely": the log-posterior is lower by less than the prior log-odds
        against a fault. Examples: two joints about one line have one zero; of two
        joints either may have the wrong gain. ``likely`` : candidates, whose
        log-posterior exceeds that of ``now`` by these odds. Repairs of the same faults,
        repairs that only take a correction back, and laws of friction are left out.
        """
        faults = self.new_faults(repair, now)
        names = {fault.name for fault in faults}
        is_fault = any(fault.severity != "note" for fault in faults)
        lowest_posterior = self.posterior(repair) - c.LOG_ODDS_AGAINST_FAULT
        tied = []
        for other in likely:
            new = self.new_faults(other, now)
            is_same = names == {fault.name for fault in new}
            if (
                not new
                or is_same
                or _is_law(new)
                or self.posterior(other) < lowest_posterior
            ):
                continue
            is_as_good = is_fault and self._is_as_good(other, repair, now)
            if is_as_good or self.is_confirmed(other, now):
                tied.append(other)
        return tied

    def _is_as_good(
        self, other: LogTransform, repair: LogTransform, now: LogTransform
    ) -> bool:
        """Whether parts of the log that were left out do not tell a confirmed repair
        from another one.

        They do where the other one's error is clearly larger, or where they do not
        determine its sizes. A wrong sign may be confirmed by physics, and the error
        then say nothing.
        """
        sizes = [fault.size for fault in self.new_faults(other, now) if fault.size]
        if not all(self._is_determined(size) for size in sizes):
            return False
        clearness = self.log.clearness_of_fall(
            self._held_out_errors(other), self._held_out_errors(repair)
        )
        return clearness < c.REQUIRED_SIGMAS

    def _of_most_plausible_size(
        self, tied: Sequence[LogTransform], now: LogTransform
    ) -> LogTransform:
        """Return the repair to take out of several that are about as likely.

        It is the first one, with one exception: if the first corrects a torque gain and
        the masses of some links are known, it is the torque gain under which the
        torques come nearest to those of the known masses.
        """
        gains = [
            repair
            for repair in tied
            if _are_of_kind(self.new_faults(repair, now), "torque gain")
        ]
        if tied[0] not in gains or np.all(self.log.problem.guessed_links):
            return tied[0]
        return min(gains, key=lambda repair: far_from_nominal(self.log, repair))

    def _note_rivals(
        self, best: LogTransform, tied: Sequence[LogTransform], now: LogTransform
    ) -> None:
        """Record, for the report, the faults that explain the log as well as the one
        that is added.

        ``best`` is the repair taken out of ``tied`` ones. Only repairs of a single new
        fault can be rivals.
        """
        new = self.new_faults(best, now)
        others = [self.new_faults(repair, now) for repair in tied if repair != best]
        single = tuple(faults[0] for faults in others if len(faults) == 1)
        if len(new) == 1 and single:
            self.rivals_by_fault[new[0].name] = single

    def proposals(self, now: LogTransform) -> list[LogTransform]:
        """List repairs with one more fault that are worth a fit to all rows.

        They are judged on a third of the rows.

        Parameters
        ----------
        now : LogTransform
            The repair that is extended.

        Returns
        -------
        list of LogTransform
            The likeliest first: of each fault the best size, MAX_FAULTS faults at most,
            ranked with physics where physics speaks against ``now``. Then up to
            MAX_FAULTS repairs that fit exactly as ``now`` does (signs alone differ),
            which physics decides later.
        """
        gains = self._gains_on_few_rows(self._one_fault_more(now), now)
        likeliest = sorted(gains, key=lambda repair: -round(gains[repair]))
        same_fit = [repair for repair in likeliest if _same_fit(repair, now)]
        # A grid's neighbours must not crowd out another fault.
        best_of_fault: dict[frozenset[object], LogTransform] = {}
        for repair in likeliest:
            names = frozenset(fault.name for fault in self.list_faults(repair))
            best_of_fault.setdefault(names, repair)
        best = [*best_of_fault.values()]
        if self._taken_by_physics(now) > c.LOG_ODDS_OF_A_CLAIM:
            # Friction drives a joint, or a mass is negative: what mends that may fit
            # no better. A position's sign, say, stands behind a torque's otherwise.
            best.sort(
                key=lambda repair: -gains[repair] - self._physics_on_few_rows(repair)
            )
        return list(dict.fromkeys(best[: c.MAX_FAULTS] + same_fit[: c.MAX_FAULTS]))

    def _taken_by_physics(self, repair: LogTransform) -> float:
        """Return by how much physics (friction takes power, masses are positive) lowers
        the log-likelihood of a repair; from 0 on."""
        return self.likelihood(self.log.fit(repair), repair) - self.posterior(repair)

    def _physics_on_few_rows(self, repair: LogTransform) -> float:
        """Return the log-probability of physics of a repair on a third of the rows."""
        screen = self.log.on_third_of_rows
        return screen.physics(screen.fit(repair), repair, self.independent_samples)

    def _one_fault_more(self, now: LogTransform) -> list[LogTransform]:
        """List the repairs, of all kinds of fault, that correct one more fault than
        ``now``.

        Repairs that an earlier round found hopeless are left out.
        """
        score = self.log.fit(now)
        repairs: list[LogTransform] = []
        for kind in self.kinds_of_fault:
            repairs += kind.propose(self.log, now, score)
        return [
            repair
            for repair in dict.fromkeys(repairs)
            if repair != now and repair.without_laws not in self.hopeless_repairs
        ]

    def _gains_on_few_rows(
        self, repairs: Sequence[LogTransform], now: LogTransform
    ) -> dict[LogTransform, float]:
        """Return the gain in log-likelihood of each repair over ``now``, on a third of
        the rows.

        Repairs that cannot reach the prior log-odds against a fault are left out: those
        whose gain is too small even if it doubles, because the best size explains at
        most twice what a rough one does. Physics gives back at most what it takes from
        ``now``. Repairs that fit far worse than ``now`` are remembered as hopeless.
        """
        fits = self.log.on_third_of_rows.fit_all(repairs)
        fit_now = self.log.on_third_of_rows.fit(now)
        self._learn_samples(sorted(fits, key=lambda fit: fit.log_unexplained)[:1])
        smallest_gain = c.LOG_ODDS_OF_A_CLAIM - self._taken_by_physics(now)
        before = self.likelihood(fit_now, now)
        likelihood_now = fit_now.log_likelihood(self.independent_samples)
        gains = {}
        for repair, fit in zip(repairs, fits, strict=True):
            fall = fit.log_likelihood(self.independent_samples) - likelihood_now
            further_gain_of_best_size = max(fall, 0.0)
            if fall < -c.HOPELESS_LOSS:
                self.hopeless_repairs.add(repair.without_laws)
            # Before the repair's cost, which takes longer to work out.
            if fall + further_gain_of_best_size <= smallest_gain:
                continue
            gain = self.likelihood(fit, repair) - before
            if gain + further_gain_of_best_size > smallest_gain:
                gains[repair] = gain
        return gains

    # -- what is believed

    def _is_confirmed(self, repair: LogTransform, now: LogTransform) -> bool:
        """Whether parts of the log that the fit has not used confirm one more fault;
        call it as :attr:`is_confirmed`, which caches the result.

        The data have to determine the fault's size. The repair has to lower the error
        on held-out parts by several standard errors (clearness), and has to beat the
        laws of friction and position that arms may have. Two exceptions: repairs that
        fit exactly as well are decided by physics; a wrong sign only must not raise the
        error. A repair that only takes corrections back claims nothing, and is judged
        by :meth:`_may_be_taken_back`.

        Parameters
        ----------
        repair : LogTransform
            The repair with one more fault corrected.
        now : LogTransform
            The repair without that correction.

        Returns
        -------
        bool
            Whether the fault is confirmed.
        """
        new = self.new_faults(repair, now)
        if not new:
            return self._may_be_taken_back(repair, now)
        sizes = [fault.size for fault in new if fault.size]
        if not all(self._is_determined(size) for size in sizes):
            return False
        clearness = self.log.clearness_of_fall(
            self._held_out_errors(now), self._held_out_errors(repair)
        )
        threshold = self._least_clearness(new)
        if _same_fit(repair, now):
            return clearness > -threshold and self._is_decided_by_physics(repair, now)
        if not self.has_few_directions and _are_of_kind(new, "torque sign"):
            # Friction that drives its joint shows a wrong sign, whatever the fit.
            return clearness > -0.5 * threshold
        if clearness <= threshold:
            return False
        return _is_law(new) or self.beats_physics(self.log, repair, now)

    def _may_be_taken_back(self, repair: LogTransform, now: LogTransform) -> bool:
        """Whether ``repair`` may leave uncorrected a fault that ``now`` corrects.

        Its posterior is larger already. The error on held-out parts must not rise
        clearly, by half of REQUIRED_SIGMAS; where both fit the same, physics decides.
        """
        if _same_fit(repair, now):
            return self._is_decided_by_physics(repair, now)
        rise = self.log.clearness_of_fall(
            self._held_out_errors(repair), self._held_out_errors(now)
        )
        return rise < 0.5 * c.REQUIRED_SIGMAS

    def _least_clearness(self, new: Sequence[Fault]) -> float:
        """Return the number of standard errors by which new faults have to lower the
        error on held-out parts.

        It is REQUIRED_SIGMAS. Half of it is enough where there are new faults, each has
        a size, whose confidence interval has to exclude 0 as well, and several joints
        move; not for a single channel's delay, since friction with memory looks like
        one.
        """
        is_late = any(e.kind in ("channel delay", "channel filter") for e in new)
        are_numbers = bool(new) and all(fault.size for fault in new) and not is_late
        is_enough = are_numbers and len(self.log.joints) > 1
        return 0.5 * c.REQUIRED_SIGMAS if is_enough else c.REQUIRED_SIGMAS

    def _is_decided_by_physics(self, repair: LogTransform, now: LogTransform) -> bool:
        """Whether physics alone clearly prefers ``repair`` to ``now``, where both fit
        the same.

        Physics: inertia is positive and friction takes power. The log-posterior has to
        rise by more than inertia alone may contribute.
        """
        gain = self.posterior(repair) - self.posterior(now)
        return not self.has_few_directions and gain > c.MAX_INERTIA_LOG_ODDS

    def _make_held_out_errors(self, repair: LogTransform) -> Array:
        """Compute the errors (PARTS, n) of n joints on parts of the log left out in
        turn; call it as :attr:`_held_out_errors`, which caches the result.

        An error is a dimensionless squared residual: of a part, over the mean energy
        (squared torque) of a part.
        """
        weights = self.log.fit(repair).weights
        return self.log.jackknife_errors(repair, weights)[1]

    def beats_physics(
        self,
        log: Likelihood,
        repair: LogTransform,
        now: LogTransform,
        strict: bool = False,
    ) -> bool:
        """Whether a fault explains held-out parts of a log better than friction and
        springs can.

        Two models are compared that both have every law of friction and position that
        joints may have: one with the fault corrected, and one without.

        Parameters
        ----------
        repair : LogTransform
            The repair with the fault corrected.
        now : LogTransform
            The repair without that correction.
        strict : bool
            If true, no single joint's error may rise clearly, with all laws and
            without; if false, the geometric mean of the joints' errors must not rise.

        Returns
        -------
        bool
            Whether the log-odds of the fault exceed those against any fault, the error
            of some joint falls by a large factor, and no joint objects.
        """
        before = self._errors_beside_physics(log, now)
        after = self._errors_beside_physics(log, repair)
        # By how much each joint's error is divided, (K,).
        ratio = before.mean(axis=0) / after.mean(axis=0)
        is_harmless = np.exp(np.mean(np.log(ratio))) > 1.0
        if strict:
            objects = self._speaks_against(before, after)
            # Laws have many parameters: of a short log their errors alone say little.
            objects &= self._rises_without_laws(log, repair, now)
            is_harmless = not objects.any()
        odds = log_odds(
            before.mean(axis=0), after.mean(axis=0), self.independent_samples
        )
        is_likely = odds > c.LOG_ODDS_AGAINST_FAULT
        # Of one joint, or of all together: an arm's parameters spread what is wrong
        # with one channel over its neighbours.
        largest_ratio = max(ratio.max(), np.prod(ratio))
        is_large = largest_ratio > self._least_ratio(repair, now)
        is_everywhere = self._shows_where_it_acts(np.log(ratio), repair, now)
        return bool(is_likely and is_large and is_harmless and is_everywhere)

    def _shows_where_it_acts(
        self, falls: Array, repair: LogTransform, now: LogTransform
    ) -> bool:
        """Whether a fault with a size that all torques share (a delay, a filter)
        explains more than one joint.

        Parameters
        ----------
        falls : (K,) array
            Falls of the logarithm of each moving joint's error on parts left out.

        Returns
        -------
        bool
            Whether the errors still fall together without the joint that gains most.
            True for any other fault, and for arms of one or two moving joints.
        """
        all_joints = tuple(range(self.log.n))
        faults = self.new_faults(repair, now)
        is_shared = any(fault.size and fault.joints == all_joints for fault in faults)
        if not is_shared or len(falls) < 3:
            return True
        return bool(falls.sum() > falls.max())

    @staticmethod
    def _speaks_against(before: Array, after: Array) -> NDArray[np.bool_]:
        """Return which joints' errors rise so much that they speak against a fault.

        Parameters
        ----------
        before, after : (PARTS, K) array
            Errors of K joints on parts left out, without and with the fault corrected.

        Returns
        -------
        (K,) array of bool
            Whether all three hold: the mean error rises by more than
            LARGEST_ERROR_RISE; it rises by more than its scatter over the parts, so
            that a single odd part does not count; and the rise costs at least a third
            (1 / _GAIN_OVER_RISE) of the log-likelihood that the falling errors of other joints
            gain.
        """
        rises = np.log(after / before)
        clearness = np.array([standard_errors_above_zero(x) for x in rises.T])
        ratio = after.mean(axis=0) / before.mean(axis=0)
        gained = float(-np.log(ratio)[ratio < 1.0].sum())
        is_costly = _GAIN_OVER_RISE * np.log(ratio) > gained
        is_clear = clearness > 0.5 * c.REQUIRED_SIGMAS
        return np.asarray((ratio > c.LARGEST_ERROR_RISE) & is_clear & is_costly)

    def _errors_beside_physics(self, log: Likelihood, repair: LogTransform) -> Array:
        """Return the errors (PARTS, K) of the K moving joints on parts left out in
        turn, by a model that has all laws of friction and position as further columns
        of each joint.
        """
        log_with_laws = log.with_all_laws
        weights = log_with_laws.fit(repair).weights
        _, errors = log_with_laws.jackknife_errors(repair, weights)
        return errors[:, log.moving]

    def _rises_without_laws(
        self, log: Likelihood, repair: LogTransform, now: LogTransform
    ) -> NDArray[np.bool_]:
        """Return which of the K moving joints' errors on parts left out rise by a
        repair, where the arm has no further laws of friction and position."""
        errors = [
            log.jackknife_errors(one, log.fit(one).weights)[1].mean(axis=0)
            for one in (now, repair)
        ]
        return np.asarray(errors[1] > errors[0])[log.moving]

    def _least_ratio(self, repair: LogTransform, now: LogTransform) -> float:
        """Return the factor by which new faults have to divide the error of some joint
        on held-out parts.

        It is larger for a fault with an arbitrary size, which adapts to whatever the
        model lacks, and largest for motions of few directions.
        """
        new = self.new_faults(repair, now)
        if self.has_few_directions:
            return c.LEAST_RATIO_IF_DOUBTFUL
        has_uneven_size = any(fault.has_uneven_size for fault in new)
        return (
            c.LEAST_RATIO_WITH_SIZE if has_uneven_size else c.LEAST_RATIO_WITHOUT_SIZE
        )

    def drop_unconfirmed(self, net: LogTransform) -> LogTransform:
        """Return the repair without the faults that do not hold in every run.

        All faults here belong to the logger (order, signs, units, gains, clock,
        mounting), so that all runs share them. Each is judged beside the faults that
        were kept before it. A fault stays without this test if it is a note (a law of
        friction), or if the fit is the same without it and physics alone decides. A
        wrong sign of a torque need not beat the laws of friction, as friction that
        drives its joint shows it, but it has to hold in every run.

        Parameters
        ----------
        net : LogTransform
            The repair of all faults.

        Returns
        -------
        LogTransform
            The repair of the confirmed faults.
        """
        several = self.logs if len(self.logs) > 1 else []
        for fault in self.list_faults(net):
            without = self._without(net, fault)
            if fault.severity == "note" or _same_fit(net, without):
                continue
            is_confirmed = fault.kind == "torque sign" or self.beats_physics(
                self.log, net, without, strict=True
            )
            holds = is_confirmed and all(
                self._holds(log, net, without) for log in several
            )
            if not holds:
                net = without
        return net

    def _without(self, net: LogTransform, fault: Fault) -> LogTransform:
        """Return the repair ``net`` without its correction of ``fault``.

        The fault is found by its name (kind and joints), because its size may have
        changed since; ``net`` itself is returned where it corrects no such fault.
        """
        for present in self.list_faults(net):
            if present.name == fault.name:
                return present.repair_without
        return net

    def _holds(self, log: Likelihood, net: LogTransform, without: LogTransform) -> bool:
        """Whether one run is consistent with a fault that all runs share.

        It is unless the repair ``net`` raises the error on held-out parts of this run's
        ``log`` clearly above the error ``without`` the fault corrected: the mean over
        its moving joints of the logarithm of the error.
        """
        errors = [
            log.jackknife_errors(repair, log.fit(repair).weights)[1]
            for repair in (without, net)
        ]
        fall = np.mean(np.log(errors[0]) - np.log(errors[1]), axis=0)
        return bool(np.mean(fall[log.moving]) > -_RISE_THAT_OBJECTS)

    # -- numbers

    def _is_determined(self, number: FaultSize) -> bool:
        """Whether the data determine the size of a fault, and the size is no usual
        tolerance.

        Three conditions: the size exceeds its tolerance by REQUIRED_SIGMAS standard
        deviations; its 95 % interval is narrow; and sizes far below and far above it
        fit clearly worse.
        """
        spread = self.gauss_newton_step(number)[1]
        margin = c.REQUIRED_SIGMAS * spread
        if abs(number.value) <= number.tolerance + margin:
            return False
        if 2.0 * spread > max(number.tolerance, number.widest):
            return False
        # A unit may be wrong by 100 where any factor about that fits alike.
        far = max(number.search_radius, margin, 0.5 * abs(number.value))
        repairs = [number.repair_with(number.value + x) for x in (0.0, -far, far)]
        at_value, below, above = self.log.fit_all(repairs)
        samples = self.independent_samples
        nearest = max(below.log_likelihood(samples), above.log_likelihood(samples))
        # Twice the log-likelihood ratio is the square of a standard normal variable.
        rise = 2.0 * (at_value.log_likelihood(samples) - nearest)
        return rise >= (0.5 * c.REQUIRED_SIGMAS) ** 2

    def _may_be_determined(self, repair: LogTransform, now: LogTransform) -> bool:
        """Whether the data may determine the sizes that a repair has and ``now`` lacks.

        False where a Gauss-Newton step, short enough to be trusted, ends within the
        tolerance and half of the standard deviations that a claim needs. Such a size is
        not determined (:meth:`_is_determined`): it is neither refined nor judged.
        """
        known = self.sizes_by_name(now)
        for name, size in self.sizes_by_name(repair).items():
            if name in known:
                continue
            change, spread = self.gauss_newton_step(size)
            is_trusted = abs(change) < size.first_order_reach
            margin = 0.5 * c.REQUIRED_SIGMAS * spread
            if is_trusted and abs(size.value + change) <= size.tolerance + margin:
                return False
        return True

    def _make_gauss_newton_step(self, number: FaultSize) -> tuple[float, float]:
        """Linearise the fit about a fault's size, to find the best size and its
        uncertainty; call it as :attr:`gauss_newton_step`, which caches the result.

        Parameters
        ----------
        number : FaultSize
            The size with its present value, in its own unit (rad, s, log of a factor
            ...).

        Returns
        -------
        change : float
            Change of the size to its best value, in that unit.
        spread : float
            Standard deviation of the size, in that unit.
        """
        value = np.array([number.value])
        h = np.array([0.3 * number.tolerance])
        now = number.repair_with(number.value)
        change, spread = self.log.first_order_steps(now, [number.repair_with], value, h)
        return float(change[0]), float(spread[0])

    def sizes_by_name(
        self, repair: LogTransform
    ) -> dict[tuple[str, tuple[int, ...]], FaultSize]:
        """Return the sizes of the faults that a repair corrects, by kind and joints
        (from 0).

        Example: {("torque gain", (2,)): <size 0.69>}. Faults without a size are left
        out.
        """
        faults = self.list_faults(repair)
        return {fault.name: fault.size for fault in faults if fault.size}

    def refine(self, repair: LogTransform, now: LogTransform) -> LogTransform:
        """Return the repair with the best sizes of its faults.

        A size from which a Gauss-Newton step is short is the best one already. Another
        is searched for on a third of the rows; a Gauss-Newton step on all rows follows.
        A round value (90 degrees, a factor 1000) is taken if it lies
        within the tolerance. Sizes that ``now`` lacks come first.

        Parameters
        ----------
        repair : LogTransform
            The repair with rough sizes.
        now : LogTransform
            The repair that it extends.

        Returns
        -------
        LogTransform
            The repair with the best sizes; ``repair`` itself if it has no size that
            ``now`` lacks.
        """
        known = self.sizes_by_name(now)
        names = self.sizes_by_name(repair)
        if names.keys() <= known.keys():
            return repair
        for name in sorted(names, key=lambda name: name in known):
            number = self.sizes_by_name(repair)[name]
            best = number.value
            change = self.gauss_newton_step(number)[0]
            if abs(change) > _PRECISION_OF_SIZE * number.tolerance:
                best = self._best_on_few_rows(number)
                change = self.gauss_newton_step(replace(number, value=best))[0]
            far = number.first_order_reach
            better = best + float(np.clip(change, -far, far))
            near = replace(number, value=better).round_values_within(number.tolerance)
            tried = [number.repair_with(x) for x in near or (best, better)]
            repair = max(tried, key=lambda r: self.likelihood(self.log.fit(r), r))
        return repair

    def _best_on_few_rows(self, number: FaultSize) -> float:
        """Return the size of the largest likelihood on a third of the rows, by a
        bounded search within the search radius; the present size if no other one is
        better.
        """

        def score(x: float) -> float:
            repair = number.repair_with(float(x))
            return self.log.on_third_of_rows.fit(repair).log_unexplained

        low = number.value - number.search_radius
        high = number.value + number.search_radius
        settings = {
            "xatol": _PRECISION_OF_SIZE * number.tolerance,
            "maxiter": _ROUNDS_OF_SIZE_SEARCH,
        }
        minimum = scipy.optimize.minimize_scalar(
            score, bounds=(low, high), method="bounded", options=settings
        )
        is_better = minimum.fun < score(number.value)
        return float(minimum.x) if is_better else number.value

    def round_sizes(self, repair: LogTransform) -> LogTransform:
        """Return the repair with sizes rounded where the data allow it.

        A size becomes the nearest round value if the two differ by less than the
        tolerance plus REQUIRED_SIGMAS standard deviations.

        Parameters
        ----------
        repair : LogTransform
            How the log is repaired.

        Returns
        -------
        LogTransform
            The repair with round sizes where they fit.
        """
        names = [
            name for name, x in self.sizes_by_name(repair).items() if x.round_values
        ]
        for name in names:
            number = self.sizes_by_name(repair)[name]
            reach = (
                number.tolerance + c.REQUIRED_SIGMAS * self.gauss_newton_step(number)[1]
            )
            for x in number.round_values_within(reach):
                repair = number.repair_with(x)
        return repair

    # -- words

    def keep_only(self, net: LogTransform, fault: Fault) -> LogTransform:
        """Return the repair that corrects a single fault of the net repair.

        Parameters
        ----------
        net : LogTransform
            The repair of all faults.
        fault : Fault
            The fault that stays corrected; ``net`` corrects it.

        Returns
        -------
        LogTransform
            ``net`` without the corrections of all other faults.
        """
        for other in self.list_faults(net):
            if other.name != fault.name:
                net = self._without(net, other)
        return net

    def describe_faults(self, net: LogTransform) -> list[Issue]:
        """List an issue for each fault that the net repair corrects, with its interval
        and by how much it lowers the residual.

        Parameters
        ----------
        net : LogTransform
            The repair of all faults.

        Returns
        -------
        list of Issue
            In the order of the kinds of fault.
        """
        faults = self.list_faults(net)
        effects = self._effects_by_fault(faults, net)
        return [self.describe(fault, net, effects[fault.name]) for fault in faults]

    def describe(
        self, fault: Fault, net: LogTransform, effects: Sequence[str] = ()
    ) -> Issue:
        """Return the issue by which the user learns of one fault of the net repair.

        Parameters
        ----------
        fault : Fault
            A fault that ``net`` corrects.
        net : LogTransform
            The repair of all faults.
        effects : sequence of str
            Effects of the arm that explain the log as well, in words.

        Returns
        -------
        Issue
            An explanation, with the 95 % interval of the fault's size, the log-odds,
            what would explain the log as well, and the function that repairs the log.
        """
        odds = self.posterior(net) - self.posterior(fault.repair_without)

        def by_clock(at: float) -> Issue:
            """Return the issue with its instant by another clock [s]."""
            assert fault.by_clock is not None
            return self.describe(fault.by_clock(at), net, effects)

        def by_run(runs: Sequence[RunLog]) -> Issue:
            """Return the issue in the words of several runs."""
            assert fault.by_run is not None
            return self.describe(fault.by_run(runs), net, effects)

        what = fault.what
        figures = {
            "joints": [j + 1 for j in fault.joints],
            **fault.figures,
            "log_odds": odds,
        }
        if fault.size is not None:
            reach = student_95(c.PARTS) * abs(self.gauss_newton_step(fault.size)[1])
            ends = [fault.size.value - reach, fault.size.value + reach]
            figures["interval"] = ends
            what = f"{what.rstrip('.')} (95 %: {fault.size.interval_in_words(ends)})."
        equivalents = fault.equivalents
        rivals = self._rivals_of(fault, net)
        if rivals:
            words = [rival.what.rstrip(".") for rival in rivals]
            what = f"{what} As likely: {'; '.join(words)}."
            equivalents = (*equivalents, *words)
            figures["as_likely"] = [
                {"kind": x.kind, "joints": [j + 1 for j in x.joints]} for x in rivals
            ]
        issue = Issue(
            kind=fault.kind,
            nature=EXPLANATION,
            severity=fault.severity,
            where=fault.place or joints_text(fault.joints),
            what=what,
            certainty=likely(self._reason(fault, net)),
            remedy=fault.remedy,
            repair=self.keep_only(net, fault).apply if fault.is_repairable else None,
            figures=figures,
            gravity=_measured_gravity(net) if fault.is_of_gravity else None,
            apply=fault.apply,
            equivalents=equivalents,
            by_clock=by_clock if fault.by_clock else None,
            by_run=by_run if fault.by_run else None,
        )
        return with_rival_effects(issue, effects)

    def _reason(self, fault: Fault, net: LogTransform) -> str:
        """Say in a sentence what speaks for a fault.

        It is by how much the repair lowers the residual of the joint that gains most,
        in percent of the torque's root mean square; or physics, where the fit is the
        same without.
        """
        after = self.log.fit(net).unexplained_shares  # (n,) of the torques' energies
        without = self.log.fit(fault.repair_without).unexplained_shares
        change = np.log(without / after)
        j = int(np.argmax(change))
        if change[j] < _SAME_FIT_FALL:
            return (
                "as recorded, friction would drive the motion, or inertia be negative"
            )
        return (
            f"what the arm's dynamics leave unexplained of joint {j + 1}'s torque falls"
            f" from {text_of_share(without[j])} to {text_of_share(after[j])}"
        )

    def _effects_as_likely(self, fault: Fault, net: LogTransform) -> list[str]:
        """List, in words, the effects of the arm that explain a log as well as a fault.

        They stand in for this fault alone, or for all faults of the net repair: one
        force may look like a clock and a tilt. An effect is left out where it does not
        lower the error on held-out parts itself, and where it is clearly worse than the
        net repair: by REQUIRED_SIGMAS standard errors, and by a factor of
        LEAST_RATIO_WITH_SIZE (the product over the joints). A law of friction
        (severity "note") has no rivals here, nor has a fault that the fit does not show
        and physics decides.
        """
        if fault.severity == "note" or self.has_few_directions:
            return []
        after = self._held_out_errors(net)
        rivals = dict[str, None]()
        for without in dict.fromkeys([fault.repair_without, self.log.as_logged]):
            if _same_fit(net, without):
                continue
            before = self._held_out_errors(without)
            for effect in self._rival_effects(without, net):
                if fault.is_of_gravity and effect.is_of_gravity:
                    continue
                own_fall = self.log.clearness_of_fall(before, effect.errors)
                explains = own_fall > 0.5 * c.REQUIRED_SIGMAS
                if explains and not self._is_clearly_worse(effect.errors, after):
                    rivals[effect.what] = None
        return list(rivals)

    def _make_rival_effects(
        self, without: LogTransform, net: LogTransform
    ) -> tuple[RivalEffect, ...]:
        """List the effects of the arm beside a repair, weighted as the net repair is;
        call it as :attr:`_rival_effects`, which caches the result: several faults ask
        for the effects beside one repair.
        """
        weights = self.log.fit(net).weights
        return tuple(rival_effects(self.log, without, weights))

    def _effects_by_fault(
        self, faults: Sequence[Fault], net: LogTransform
    ) -> dict[tuple[str, tuple[int, ...]], list[str]]:
        """Return, by the name of a fault of the net repair, the effects of the arm that
        explain a log as well.

        Where an effect takes the place of one fault, it may take that of another one as
        well, which was found beside it: of each two faults the second one has to be
        needed beside the effect, too.
        """
        effects = {fault.name: self._effects_as_likely(fault, net) for fault in faults}
        found = {name: list(names) for name, names in effects.items()}
        for doubtful, fault in permutations(faults, 2):
            others = set(effects[doubtful.name]) - set(found[fault.name])
            if fault.severity == "note" or not others:
                continue
            left = doubtful.repair_without
            beside = self._rival_effects(left, net)
            alone = self._rival_effects(self._without(left, fault), net)
            for with_fault, without in zip(beside, alone, strict=True):
                if fault.is_of_gravity and without.is_of_gravity:
                    continue  # it is the fault itself
                is_needed = self._is_clearly_worse(without.errors, with_fault.errors)
                if without.what in others and not is_needed:
                    found[fault.name].append(without.what)
        return {name: [*dict.fromkeys(names)] for name, names in found.items()}

    def _is_clearly_worse(self, errors: Array, than: Array) -> bool:
        """Whether errors (PARTS, n) on parts left out are clearly larger than others."""
        return is_clearly_worse(errors[None], than[None], self.log.moving[None])

    def _rivals_of(self, fault: Fault, net: LogTransform) -> list[Rival]:
        """List what explains the log as well as one fault of the net repair.

        These are the faults that were as likely when this one was added and, for a
        wrong sign, other sets of torques whose signs may be wrong instead.
        """
        rivals = [
            Rival(other.kind, other.joints, other.what)
            for other in self.rivals_by_fault.get(fault.name, ())
        ]
        if fault.kind == "torque sign":
            rivals += self._signs_as_likely(net, fault.joints)
        return rivals

    def _signs_as_likely(self, net: LogTransform, turned: Sequence[int]) -> list[Rival]:
        """List other sets of joints whose torques may have the wrong sign instead.

        A set differs from ``turned`` by one joint, more or less. It is listed if
        neither physics nor the error on held-out parts speaks against it. Torques that
        are never negative are a further candidate: the logger may have written
        magnitudes.

        Parameters
        ----------
        net : LogTransform
            The repair of all faults.
        turned : sequence of int
            Joints (from 0) whose torque has the wrong sign under ``net``.

        Returns
        -------
        list of Rival
            One for each set, with its sentence.
        """
        others = []
        for j in self.log.joints:
            joints = tuple(sorted({*turned} ^ {j}))
            if not joints:  # no sign would be wrong
                continue
            objection, clearness = self._against_turning(net, j)
            if (
                objection < c.MAX_INERTIA_LOG_ODDS
                and clearness < 0.5 * c.REQUIRED_SIGMAS
            ):
                what = f"the torque of {joints_text(joints)} has the wrong sign"
                others.append(Rival("torque sign", joints, what))
        unsigned = tuple(j for j in turned if self._is_unsigned(net.tau_order[j]))
        if unsigned:
            what = f"the logger wrote magnitudes of {joints_text(unsigned)}"
            others.append(Rival("torque magnitude", unsigned, what))
        return others

    def _is_unsigned(self, channel: int) -> bool:
        """Whether a torque channel (from 0) is never negative."""
        torque = self.log.data.torque(self.log.data.motion.t)[:, channel]
        return bool(np.all(torque >= 0.0))

    def with_settled_signs(self, net: LogTransform) -> LogTransform:
        """Return the repair with further signs of torques changed where physics demands
        it.

        Nothing changes unless some torque has a wrong sign already. Then a joint's sign
        is turned if friction would otherwise drive the joint, and if the error on
        held-out parts does not rise clearly. The likelihood alone cannot show the sign
        of a joint that hardly moves the others.

        Parameters
        ----------
        net : LogTransform
            The repair of all faults.

        Returns
        -------
        LogTransform
            The repair with the signs that physics demands.
        """
        if not any(fault.kind == "torque sign" for fault in self.list_faults(net)):
            return net
        for j in self.log.joints:
            objection, clearness = self._against_turning(net, j)
            if objection < -c.MAX_INERTIA_LOG_ODDS and clearness <= c.REQUIRED_SIGMAS:
                net = net.with_multiplied("gain", (j,), -1.0)
        return net

    def _against_turning(self, net: LogTransform, j: int) -> tuple[float, float]:
        """Return what speaks against turning the sign of joint j's torque (j from 0).

        Returns
        -------
        objection : float
            Log-odds of physics for the present sign over the other sign (positive
            inertia, friction that takes power); negative: physics prefers the other
            sign.
        clearness : float
            Rise of the error on held-out parts under the other sign, in standard
            errors.
        """
        other = net.with_multiplied("gain", (j,), -1.0)
        fits = self.log.fit_all([net, other])
        physics_now = self.log.physics(fits[0], net, self.independent_samples)
        physics_turned = self.log.physics(fits[1], other, self.independent_samples)
        clearness = self.log.clearness_of_fall(
            self._held_out_errors(other), self._held_out_errors(net)
        )
        return physics_now - physics_turned, clearness


def _extent(fault: Fault) -> float | str:
    """Return in what two faults of one name differ: the size, or the sentence of a fault
    without a size. A sentence rounds a size."""
    return fault.what if fault.size is None else fault.size.value


def _is_law(faults: Sequence[Fault]) -> bool:
    """Whether all of one fault or more are laws of friction or springs (severity
    "note"), which arms have."""
    return bool(faults) and all(fault.severity == "note" for fault in faults)


def _are_of_kind(faults: Sequence[Fault], kind: str) -> bool:
    """Whether all of one fault or more are of this kind."""
    return bool(faults) and all(fault.kind == kind for fault in faults)


def _measured_gravity(net: LogTransform) -> tuple[float, ...]:
    """Return the gravity vector [m/s^2] whose weight the measured torques hold.

    It is the gravity of the repair times 1 - s, if all torques lack the same share s of
    the weight (a controller compensates it); otherwise the gravity as it is.
    """
    share = 1.0 - net.lacks[0] if len(set(net.lacks)) == 1 else 1.0
    return tuple(float(round(share * g, 3)) + 0.0 for g in net.gravity)


def _same_fit(a: LogTransform, b: LogTransform) -> bool:
    """Whether two repairs fit a log equally well by construction.

    They do if they differ only in the signs of torques, of gravity, or of the direction
    of time: an arm with negative parameters then fits as well. Only physics can decide.
    """

    def unsigned(repair: LogTransform) -> LogTransform:
        gravity = max(repair.gravity, tuple(-g for g in repair.gravity))
        gain = tuple(map(abs, repair.gain))
        return replace(repair, reversed=False, gain=gain, gravity=gravity)

    return unsigned(a) == unsigned(b)
