"""Is it the same arm in every run, and the same logger?

All runs are fitted by one arm, and each by itself; what each joint's own motion makes
(friction, which warms up, and zeros of torque) is a run's own. Where one run does not
belong to the others' arm, the question is what of that run makes it theirs: a number
(a gain, a zero, the ten parameters of a load on the last link), to first order, or a
fault of its log (a sign, an order). Each is judged on parts of the run that nothing
was fitted to. A fault is claimed only where it beats the best of the numbers by the
odds against a fault.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.checks import constants as c
from sdp_vs_penalty.checks.certainty import likely
from sdp_vs_penalty.checks.faults.fault import Fault
from sdp_vs_penalty.checks.issue import (
    EXPLANATION,
    Issue,
    joints_text,
    with_rival_effects,
)
from sdp_vs_penalty.checks.likelihood import Likelihood
from sdp_vs_penalty.checks.passing_load import (
    PARAMETERS_OF_LOAD,
    fit_passing_load,
    has_load_columns,
    load_columns,
)
from sdp_vs_penalty.checks.repair import LogEvent, LogTransform
from sdp_vs_penalty.checks.rival_effects import is_clearly_worse
from sdp_vs_penalty.checks.run_log import RunLog
from sdp_vs_penalty.regression.evidence import (
    jackknifed,
    log_odds,
    standard_errors_above_zero,
)
from sdp_vs_penalty.regression.normal_equations import Normal, NormalEquations, solve
from sdp_vs_penalty.robot.arrays import Array

#: Sizes of a number that loggers differ by anyway (a gain less one [-], an angle
#: [rad]): only beyond them is a number of one run claimed.
_USUAL = {"torque gain": c.CALIBRATED_GAIN, "encoder offset": c.CALIBRATED}
#: What is different in a run, and what to do about it; x is the number, j the joint
#: from 1.
_WORDS = {
    "another load": (
        "{run} carries a {weight} load on its last link ({x:+.2g} kg)",
        "identify the runs apart, or log with the same tool",
    ),
    "torque gain": (
        "the torque of joint {j} is {x:.3g} times as large in {run}",
        "divide tau{j} of this run by {x:.3g}, or multiply the others",
    ),
    "encoder offset": (
        "the zero of joint {j} is {distance} away in {run}",
        "add {x:+.3g} {unit} to q{j} of this run, or calibrate its zero",
    ),
}
#: The kind of difference that no change of the log can undo.
NOT_REPAIRED = "another load"
#: Faults that one run's log may have, by the run's number, and the repair of each.
Proposals = Callable[[int], Sequence[tuple[Fault, LogTransform]]]
#: Log-odds (natural logarithm) that a difference of runs has to exceed: three times
#: what any fault of a log needs, since friction never repeats exactly.
_ODDS_OF_A_DIFFERENCE = 3.0 * c.LOG_ODDS_AGAINST_FAULT
#: Two arms in one run have to make the error so many times as large, more than those of two
#: runs (TIMES_BETTER): the cut is searched for, and friction changes within a run as well.
_TWO_ARMS_IN_A_RUN = 3.0**0.5
#: Another arm has many parameters, and explains much: its fall counts this share [-].
_SHARE_OF_ANOTHER_ARM = 0.5
#: A number has an interval that speaks for it as well: this share of the standard errors
#: is enough of it [-].
_SHARE_OF_SIGMAS_WITH_SIZE = 0.5
#: Step of the difference quotient by an encoder's zero [rad or m].
_ZERO_STEP = 0.01
#: Torque gains that a drive may have beside another run [-].
_POSSIBLE_GAINS = (0.2, 5.0)
#: Largest offset of a revolute encoder's zero that is claimed of one run [rad].
_LARGEST_ZERO_SHIFT_RAD = 0.5
#: Of a load's parameters, Ixx, Iyy and Izz.
_MOMENTS_OF_INERTIA = (4, 6, 9)
#: Directions of a joint's own columns below this share of the largest are noise [-].
_OWN_RANK = 1e-3
#: No load is held farther from the last joint [m].
_FARTHEST_LOAD = 2.0


@dataclass(frozen=True, kw_only=True)
class Difference:
    """A hypothesis of how one run differs from the others.

    It is one of three: a number (a gain, a zero, a load), a fault of the run's log, or,
    with neither, another arm.
    """

    #: Number of the run, from 0.
    run: int
    #: Kind of the difference, such as a number's or a fault's name.
    kind: str
    #: Joint, from 0; -1 for none.
    joint: int = -1
    #: (n, M, r) torque per unit of the number, beside the arm's; None unless it is a
    #: number.
    columns: Array | None = None
    #: Fault of the run's log; None unless it is one.
    fault: Fault | None = None
    #: Repair of that fault.
    repair: LogTransform | None = None

    @property
    def is_another_arm(self) -> bool:
        """Whether the run is taken to be of another arm: no number and no fault of its
        log is different.
        """
        return self.columns is None and self.repair is None


@dataclass(frozen=True)
class Cause:
    """A difference of one run, and how well it explains the runs."""

    #: The difference of the run.
    difference: Difference
    #: Fall of the logarithm of the squared residual on parts that nothing was fitted
    #: to, all parts and joints added.
    fall: float
    #: Mean fall, in standard errors.
    clearness: float
    #: Size of the number (a gain less one, an angle [rad], a length [m], a load [kg]);
    #: 0 for a fault.
    size: float = 0.0
    #: What explains as much, in words.
    equivalents: tuple[str, ...] = ()

    @property
    def score(self) -> float:
        """The fall by which causes are ranked: that of another arm counts half."""
        if self.difference.is_another_arm:
            return _SHARE_OF_ANOTHER_ARM * self.fall
        return self.fall

    @property
    def required_sigmas(self) -> float:
        """Standard errors that the mean fall has to reach: half as many for a number."""
        if self.difference.columns is None:
            return c.REQUIRED_SIGMAS
        return _SHARE_OF_SIGMAS_WITH_SIZE * c.REQUIRED_SIGMAS

    def log_repair(self, as_logged: LogTransform) -> LogTransform | None:
        """Return the repair that makes the log of the different run one of the others'
        arm.

        Parameters
        ----------
        as_logged : LogTransform
            The repair that changes nothing.

        Returns
        -------
        LogTransform or None
            For a torque gain: torques divided by 1 + size; for an encoder offset: the
            zero shifted by the size; for a fault: its repair. None for another load or
            another arm, which no change of the log can undo.
        """
        joints = (self.difference.joint,)
        if self.difference.kind == "torque gain" and self.size:
            return as_logged.with_entries("gain", joints, 1.0 / (1.0 + self.size))
        if self.difference.kind == "encoder offset" and self.size:
            return as_logged.with_entries("zero", joints, self.size)
        return self.difference.repair


@dataclass(frozen=True)
class JointRows:
    """Rows of one joint: its torque (M,), the columns (M, s) of what joints share, and
    the joint's own columns (M, k)."""

    torque: Array
    columns: Array
    own_columns: Array


class RunComparison:
    """Compare one arm fitted to all R runs with one arm fitted to each run.

    All energies are squared residuals of n joints [(N m)^2, N^2], of M rows a run.
    """

    def __init__(self, runs: Sequence[RunLog]) -> None:
        """Compute the normal equations of an arm for each of R runs.

        A law of a joint's motion (a spring, drag: an event whose ``at`` is its name)
        belongs to the arm, so that the model of each run gets the laws of all runs.
        """
        # A dictionary, as a set that keeps the order.
        all_laws = {
            event: None
            for run in runs
            for event in run.repair.events
            if isinstance(event.at, str)
        }
        self.runs = [
            replace(run, repair=_with_events(run.repair, [*all_laws])) for run in runs
        ]
        # (R, n) joints that move in enough rows of a run to be judged there.
        self.moving = np.stack([_tells_of_joints(run) for run in runs])
        self.equations = []
        for run in self.runs:
            grams, n_own = run.log.gram_matrices(run.repair, 1)  # one part: all rows
            self.equations.append(NormalEquations.eliminating(grams, n_own))

    @cached_property
    def energy_left_by_one_arm(self) -> Array:
        """(R, n) squared residual of each run's joint when one arm is fitted to all
        runs.

        The R n joints are fitted as those of one long log.
        """
        stacked = NormalEquations.together(self.equations)  # R * n joints
        _, energy_left = stacked.fitted(self.moving.ravel())
        return energy_left.reshape(self.moving.shape)

    @cached_property
    def energy_left_by_own_arms(self) -> Array:
        """(R, n) squared residual of each run's joint when an arm is fitted to that run
        alone."""
        energies = []
        for equations, moving in zip(self.equations, self.moving, strict=True):
            _, energy_left = equations.fitted(moving)  # (1, n)
            energies.append(energy_left)
        return np.concatenate(energies)

    @cached_property
    def log_energy_ratios(self) -> Array:
        """(R, n) logarithm of the ratio of squared residuals: under one arm for all
        runs, over under an arm for each run. It is 0 for joints that do not move.
        """
        ratio = np.log(self.energy_left_by_one_arm / self.energy_left_by_own_arms)
        return np.asarray(np.where(self.moving, ratio, 0.0))

    @property
    def error_ratio(self) -> float:
        """By what factor one arm for all runs makes a joint's error larger, compared
        with an arm for each run.

        Errors are root mean square residuals. A joint's ratios are multiplied over the
        runs, so that a single deviating run counts in full among many good ones; the
        result is the geometric mean over the joints that move in any run.
        """
        n_moving = max(int(self.moving.any(axis=0).sum()), 1)
        return float(np.exp(0.5 * self.log_energy_ratios.sum() / n_moving))

    @property
    def worst_error_ratio(self) -> float:
        """Largest ratio, over runs and joints, of the root mean square residual under
        one arm for all runs to that under the run's own arm."""
        return float(np.exp(0.5 * self.log_energy_ratios.max()))

    @cached_property
    def samples_per_run(self) -> float:
        """Mean number of independent samples of a run's residual."""
        samples = [
            r.log.count_independent_samples(r.log.fit(r.repair)) for r in self.runs
        ]
        return float(np.mean(samples))

    def is_one_arm_worse(self, least_ratio: float) -> bool:
        """Whether one arm for all runs is clearly worse than an arm for each run.

        Two conditions: the error ratio reaches ``least_ratio`` [-] (and TIMES_BETTER),
        and the log-likelihood ratio, N / 2 times the sum of the logarithms of the
        energy ratios for N samples a run, exceeds _ODDS_OF_A_DIFFERENCE, because
        friction never repeats exactly.
        """
        odds = log_odds(
            self.energy_left_by_one_arm[self.moving],
            self.energy_left_by_own_arms[self.moving],
            self.samples_per_run,
        )
        is_large = self.error_ratio >= max(least_ratio, c.TIMES_BETTER)
        return odds >= _ODDS_OF_A_DIFFERENCE and is_large

    @cached_property
    def log_excess(self) -> Array:
        """(R, n) how much worse one arm for all explains a joint in a run than it explains
        that joint in the run where it explains it best.

        It is the logarithm of a ratio of unexplained shares (squared residual over
        squared torque), and 0 for joints that do not move.
        """
        total = np.stack([equations.total[0] for equations in self.equations])
        # A joint that does not move explains nothing: its share counts as 1.
        share = np.where(self.moving, self.energy_left_by_one_arm / total, 1.0)
        excess = np.log(share / share.min(axis=0))
        return np.asarray(np.where(self.moving, excess, 0.0))

    @property
    def largest_excess_ratio(self) -> float:
        """Largest excess, over runs r and joints j, of the error of the common model.

        e[r, j] is the RMS residual over the RMS torque of joint j in run r, with one
        arm fitted to all runs. The excess is e[r, j] / min over runs of e[:, j].
        ``log_excess`` holds the logarithms of squares, hence the factor 1/2.
        """
        return float(np.exp(0.5 * self.log_excess.max()))

    @property
    def has_outlying_run(self) -> bool:
        """Whether one arm for all runs explains some joint at least OUTLYING times worse
        in one run than in another.
        """
        return self.largest_excess_ratio >= c.OUTLYING

    @cached_property
    def suspects(self) -> list[int]:
        """Numbers (from 0, ascending) of the two runs that may be the different one.

        They are the run that is explained worst compared with the others, and the run
        that loses most by one arm for all; if these are the same run, the one that
        loses second most. Of two runs both are suspects.
        """
        by_excess = np.argsort(-self.log_excess.sum(axis=1)).tolist()
        by_loss = np.argsort(-self.log_energy_ratios.sum(axis=1)).tolist()
        ranked = dict.fromkeys([by_excess[0], *by_loss])  # none of them twice
        return sorted([*ranked][:2])

    @cached_property
    def weights(self) -> Array:
        """(R, n) weights of the joints' rows: one over the squared residual under the
        run's own arm, 0 for joints that do not move."""
        return np.where(self.moving, 1.0 / self.energy_left_by_own_arms, 0.0)

    @cached_property
    def normal_equations(self) -> list[Normal]:
        """Weighted normal equations of the arm, a pair (gram (s, s), cross (s,)) for
        each run."""
        pairs = zip(self.equations, self.weights, strict=True)
        return [_first(equations.normal(weights)) for equations, weights in pairs]

    def fit_other_runs(self, number: int) -> Array:
        """Return the parameters (s,) of one arm fitted to all runs except run
        ``number``."""
        others = [
            equations
            for run, equations in enumerate(self.normal_equations)
            if run != number
        ]
        summed = _sum_of_normal_equations(others)
        assert summed is not None
        gram, cross = summed
        return solve(gram, cross[:, None])[:, 0]

    def normal_equations_with(self, difference: Difference) -> Normal | None:
        """Return the normal equations of the different run, with the difference
        accounted for.

        A fault of the log is repaired first; a number (a gain, a zero, a load) is a
        further unknown, which is projected out again.

        Parameters
        ----------
        difference : Difference
            What is assumed to be different in one run.

        Returns
        -------
        (gram (s, s), cross (s,)) or None
            None for another arm, whose rows say nothing about the arm of the other
            runs.
        """
        if difference.is_another_arm:
            return None
        run = self.runs[difference.run]
        repair = run.repair
        if difference.repair is not None:
            repair = difference.repair.followed_by(repair)
        grams, n_own = run.log.gram_matrices(repair, 1, difference.columns)
        equations = NormalEquations.eliminating(grams, n_own)
        normal = _first(equations.normal(self.weights[difference.run]))
        n_shared = len(self.normal_equations[difference.run][1])
        return _project_out_last(normal, n_shared)

    def held_out_errors(
        self, difference: Difference | None
    ) -> tuple[Array, Array | None]:
        """Return the errors on parts of the two suspect runs, each part left out in
        turn.

        The arm is fitted to the other parts of that run and to all other runs, whose
        normal equations are added.

        Parameters
        ----------
        difference : Difference or None
            What is assumed to be different in one of the suspects; None: nothing.

        Returns
        -------
        errors : (2 PARTS, n) array
            Squared residual of each joint on the part left out, over the mean energy of
            a part.
        arms : (PARTS, s + r) array or None
            Fitted parameters of the different run: s of the arm, then the r numbers
            that differ. None if nothing differs in a suspect.
        """
        normals: list[Normal | None] = [*self.normal_equations]
        if difference is not None:
            normals[difference.run] = self.normal_equations_with(difference)
        errors_of_suspects = []
        arms = None
        for number in self.suspects:
            run = self.runs[number]
            repair = run.repair
            columns = None
            others = _sum_of_normal_equations(
                [normal for other, normal in enumerate(normals) if other != number]
            )
            is_different = difference is not None and difference.run == number
            if difference is not None and is_different:
                columns = difference.columns
                if difference.is_another_arm:
                    others = None  # the other runs say nothing about this arm
                if difference.repair is not None:
                    repair = difference.repair.followed_by(repair)
            fitted, errors = run.log.jackknife_errors(
                repair, self.weights[number], further_columns=columns, others=others
            )
            if is_different:
                arms = fitted
            errors_of_suspects.append(errors)
        return np.concatenate(errors_of_suspects), arms

    @cached_property
    def held_out_errors_of_one_arm(self) -> Array:
        """(2 PARTS, n) errors on parts of the suspects, left out in turn, if nothing
        differs between the runs."""
        return self.held_out_errors(None)[0]

    def judge(self, difference: Difference) -> Cause | None:
        """Return how well a difference of one run explains the parts that are left out.

        Parameters
        ----------
        difference : Difference
            What is assumed to be different in one run.

        Returns
        -------
        Cause or None
            The difference with its evidence (fall of the error) and its size. None for
            a number whose size is within the usual tolerance, or impossible.
        """
        after, arms = self.held_out_errors(difference)
        fall, clearness = self._fall_of(after)
        if difference.columns is None or arms is None:
            return Cause(difference, fall, clearness)
        size = self._determined_size(difference, arms)
        return None if size is None else Cause(difference, fall, clearness, size)

    def _fall_of(self, after: Array) -> tuple[float, float]:
        """Return by how much the logarithm of errors on parts left out falls, from one
        arm for all runs to ``after`` (2 PARTS, n): the sum over parts and moving joints,
        and the mean in standard errors.
        """
        counts = np.repeat(self.moving[self.suspects], c.PARTS, axis=0)
        log_falls = np.log(self.held_out_errors_of_one_arm / after)
        falls_of_parts = np.where(counts, log_falls, 0.0).sum(axis=1)  # (2 PARTS,)
        clearness = standard_errors_above_zero(falls_of_parts.reshape(-1, c.PARTS))
        return float(falls_of_parts.sum()), clearness

    def _determined_size(self, difference: Difference, arms: Array) -> float | None:
        """Return the size of a number that differs in one run; None where it is within
        the usual tolerance, or impossible.

        Parameters
        ----------
        difference : Difference
            With ``columns`` (n, M, r).
        arms : (PARTS, s + r) array
            Parameters fitted without each part in turn.

        Returns
        -------
        float or None
            A torque gain less one [-], an angle [rad], a length [m] or a load [kg].
        """
        assert difference.columns is not None
        # The numbers stand behind the arm's parameters; the first one is the size.
        values = arms[:, -difference.columns.shape[2]]
        value, spread = jackknifed(values)
        size = float(value)
        usual = _USUAL.get(difference.kind, 0.0)
        threshold = max(c.REQUIRED_SIGMAS * float(spread), usual)
        log = self.runs[difference.run].log
        if abs(size) <= threshold or not _is_possible(log, difference, size):
            return None
        if difference.kind == "torque gain" and not self._scales_friction(
            difference, size
        ):
            return None
        if difference.kind == "another load":
            loads = arms[:, -PARAMETERS_OF_LOAD:]
            if not is_a_body(loads):
                return None
        return size

    def _scales_friction(self, difference: Difference, size: float) -> bool:
        """Whether a joint's torque in the different run is nearer to 1 + size times
        that of the other suspect than to the same.

        A channel's gain scales friction with the arm's torque. Friction that the model
        lacks looks like another gain of the arm's torque alone.

        With A the arm's torque, and F the joint's own columns times what they take in
        the other suspect's rows, the residual y - g (A + F) of the different run is
        compared between g = 1 and g = 1 + size. Its mean is left out: zeros of torque
        are a run's own.
        """
        joint = difference.joint
        (other,) = {*self.suspects} - {difference.run}
        arm = self.fit_other_runs(difference.run)
        of_other = self._own_rows(other, joint)
        rows = self._own_rows(difference.run, joint)
        left = of_other.torque - of_other.columns @ arm
        own = np.linalg.lstsq(of_other.own_columns, left, rcond=_OWN_RANK)[0]
        expected = rows.columns @ arm + rows.own_columns @ own
        same = np.var(rows.torque - expected)
        scaled = np.var(rows.torque - (1.0 + size) * expected)
        return bool(scaled < same)

    def _own_rows(self, number: int, joint: int) -> JointRows:
        """Return the rows of run ``number`` in which a joint (from 0) slides."""
        log = self.runs[number].log
        repair = self.runs[number].repair
        slides = log.torque_mask(repair)[joint] > 0.0
        channel = repair.order[joint]
        return JointRows(
            torque=log.channels(repair)[joint, slides],
            columns=log.raw(repair)[joint, slides],
            own_columns=log.data.own_columns[channel, slides],
        )

    def judge_numbers(self) -> list[Cause]:
        """List the causes of the simplest kinds, judged on held-out parts.

        For each suspect run these are another arm, a torque gain or encoder zero of
        each joint, and another load on the last link. Numbers of usual or impossible
        size are left out.
        """
        causes = []
        for number in self.suspects:
            run = self.runs[number]
            causes.append(self.judge(Difference(run=number, kind="another arm")))
            arm = self.fit_other_runs(number)
            for kind, joint, columns in _list_numbers(run.log, run.repair, arm):
                is_of_joint = kind != "another load"
                if is_of_joint and not self.moving[self.suspects, joint].all():
                    continue
                difference = Difference(
                    run=number, kind=kind, joint=joint, columns=columns
                )
                causes.append(self.judge(difference))
        return [cause for cause in causes if cause is not None]

    def judge_faults(self, proposals: Proposals) -> list[Cause]:
        """List the proposed faults of a single suspect's log, with how well each
        explains the held-out parts; proposals : returns faults and their repairs for a
        run's number.
        """
        causes = []
        for number in self.suspects:
            for fault, repair in proposals(number):
                joint = fault.joints[0] if fault.joints else -1
                difference = Difference(
                    run=number, kind=fault.kind, joint=joint, fault=fault, repair=repair
                )
                causes.append(self.judge(difference))
        return [cause for cause in causes if cause is not None]

    def find_best_cause(self, proposals: Proposals | None = None) -> Cause | None:
        """Return the difference of one run that explains the held-out parts best.

        Parameters
        ----------
        proposals : callable, optional
            Returns the faults that a run's log may have, for the run's number. A fault
            is preferred to a number (a gain, a zero, a load) only if its log-likelihood
            is higher by the prior log-odds against a fault.

        Returns
        -------
        Cause or None
            None if no difference lowers the error on held-out parts clearly, or another
            arm lowers it more: friction that the model lacks does that as well.
        """
        best = max(self.judge_numbers(), key=lambda cause: cause.score)
        n_parts = 2.0 * c.PARTS  # of both suspects
        if proposals is not None:
            # The odds as a sum over parts of the logarithm of the squared residual.
            odds = n_parts * c.LOG_ODDS_AGAINST_FAULT / self.samples_per_run
            faults = [
                cause
                for cause in self.judge_faults(proposals)
                if cause.score > best.score + odds
            ]
            best = _simplest(faults, odds) if faults else best
        if best.difference.is_another_arm or not self._is_clear(best):
            return None
        return self._in_the_heavier_run(best)

    def explains_as_another_arm(self, cause: Cause) -> bool:
        """Whether a cause explains the parts left out as well as another arm does.

        Another arm contains every gain, zero and load, so that a right number explains
        as much with fewer parameters. Friction and other laws that the model lacks
        leave something that any number explains a little of, and other parameters more:
        of these nothing is claimed.

        Parameters
        ----------
        cause : Cause
            The difference that explains the parts best.

        Returns
        -------
        bool
            Whether it does; a fault of the log always.
        """
        if cause.difference.columns is None:
            return True
        arms = [
            self.judge(Difference(run=number, kind="another arm"))
            for number in self.suspects
        ]
        return cause.fall >= max(arm.fall for arm in arms if arm)

    def _is_clear(self, cause: Cause) -> bool:
        """Whether a cause lowers the error on parts left out clearly, and by the odds
        of a difference."""
        n_parts = 2.0 * c.PARTS  # of both suspects
        log_likelihood = 0.5 * self.samples_per_run * cause.score / n_parts
        is_likely = log_likelihood >= _ODDS_OF_A_DIFFERENCE
        return cause.clearness >= cause.required_sigmas and is_likely

    def effects_as_likely(self, cause: Cause) -> list[str]:
        """List, in words, what the arm does that explains the parts left out as well as
        a gain or a zero of one run.

        It is a load that the last link carries for a stretch of the suspect runs, of its
        own beginning and end, if it may be a body. It explains as much unless it is
        clearly worse (:func:`~sdp_vs_penalty.checks.rival_effects.is_clearly_worse`).

        Returns
        -------
        list of str
            Empty for a cause that is no gain and no zero.
        """
        runs = [self.runs[number] for number in self.suspects]
        if cause.difference.kind not in _USUAL or not has_load_columns(runs[0].log):
            return []
        others = _sum_of_normal_equations(
            [
                normal
                for number, normal in enumerate(self.normal_equations)
                if number not in self.suspects
            ]
        )
        load = fit_passing_load(runs, self.weights[self.suspects], others)
        errors, _ = self.held_out_errors(cause.difference)
        shape = len(runs), c.PARTS, -1
        is_worse = is_clearly_worse(
            load.errors.reshape(shape),
            errors.reshape(shape),
            self.moving[self.suspects],
        )
        return [load.what] if is_a_body(load.parameters) and not is_worse else []

    def _in_the_heavier_run(self, cause: Cause) -> Cause:
        """Return a cause with the load assigned to the run that carries more.

        Of two runs, a load that one lacks (negative size) is a load that the other
        carries. Any other cause is returned unchanged.
        """
        is_lack = cause.difference.kind == "another load" and cause.size < 0.0
        if not is_lack or len(self.runs) != 2:
            return cause
        of_other = replace(cause.difference, run=1 - cause.difference.run)
        return replace(cause, difference=of_other, size=-cause.size)

    @property
    def _reason(self) -> str:
        """By what factor one arm for all runs is worse, as a sentence."""
        one_arm = "one arm for all runs explains a joint"
        by_excess = self.largest_excess_ratio
        if by_excess > self.worst_error_ratio:
            return f"{one_arm} {by_excess:.2g} times worse in one run than in another"
        return f"{one_arm} {self.worst_error_ratio:.2g} times worse than one for each"

    def issue(self, cause: Cause) -> Issue:
        """Return the issue that tells the user what is different in one run.

        Parameters
        ----------
        cause : Cause
            The difference, and how well it explains the runs.

        Returns
        -------
        Issue
            An explanation of that run.
        """
        difference = cause.difference
        run = self.runs[difference.run]
        if difference.fault is None:
            what, remedy = self._words_of_number(cause)
            joints = [] if difference.joint < 0 else [difference.joint]
        else:
            what = f"in {run.name} only: {difference.fault.what.rstrip('.')}"
            remedy = f"{difference.fault.remedy} in this run"
            joints = [*difference.fault.joints]
        issue = Issue(
            kind=difference.kind,
            severity="warning",
            where=joints_text(joints) if joints else "the run",
            what=f"{what}, beside the others.",
            certainty=likely(self._reason),
            remedy=remedy,
            figures={
                "joints": [joint + 1 for joint in joints],
                "run": run.name,
                "size": cause.size,
                "times": self.error_ratio,
            },
            nature=EXPLANATION,
            repair=None if difference.repair is None else difference.repair.apply,
            apply="" if difference.fault is None else difference.fault.apply,
            equivalents=cause.equivalents,
        )
        return with_rival_effects(issue, self.effects_as_likely(cause))

    def _words_of_number(self, cause: Cause) -> tuple[str, str]:
        """Return the sentence and the remedy for a run whose gain, zero, load or arm
        differs."""
        difference = cause.difference
        run = self.runs[difference.run]
        unit = run.log.problem.robot.position_units[difference.joint]
        distance = f"{-cause.size:.2g} {unit}"
        if unit == "rad":
            distance = f"{np.degrees(-cause.size):.2g} degrees"
        # A gain's size counts from one.
        is_gain = difference.kind == "torque gain"
        entries = {
            "run": run.name,
            "j": difference.joint + 1,
            "x": 1.0 + cause.size if is_gain else cause.size,
            "unit": unit,
            "distance": distance,
            "weight": "lighter" if cause.size < 0.0 else "heavier",
        }
        what, remedy = _WORDS[difference.kind]
        return what.format(**entries), remedy.format(**entries)


def _tells_of_joints(run: RunLog) -> NDArray[np.bool_]:
    """Return the joints (n,) that a run tells something of: they move, and slide in
    twice as many rows as they have columns of their own, and shares of the arm's.

    Friction of a joint at rest may have any value. In fewer rows its columns explain
    whatever is there, so that any other arm seems to explain them worse.
    """
    log = run.log
    n_slides = log.torque_mask(run.repair).sum(axis=1)
    n_own = log.data.own_columns.shape[2]
    n_shared = len(log.fit(run.repair).theta) / max(len(log.joints), 1)
    return np.asarray(log.moving & (n_slides >= 2.0 * (n_own + n_shared)))


def is_a_body(loads: Array) -> bool:
    """Whether a load, added or missing, may be a body: no moment of inertia is clearly
    larger, in size, than that of its mass at _FARTHEST_LOAD.

    loads (PARTS, 10) : parameters of the load from all parts but one. A motion that the
    model explains badly looks like a load too, of any moments. Their signs say little:
    rotors and friction share them.
    """
    mass = abs(float(np.mean(loads[:, 0])))
    for k in _MOMENTS_OF_INERTIA:
        value, spread = jackknifed(loads[:, k])
        if abs(value) - c.REQUIRED_SIGMAS * spread > mass * _FARTHEST_LOAD**2:
            return False
    return True


def _simplest(faults: Sequence[Cause], odds: float) -> Cause:
    """Return the fault to report out of several that explain the runs.

    Faults whose score is within ``odds`` (on the same scale) of the largest explain the
    same. Of these a fault of torques is preferred to one of positions; the
    others are named as equivalents.
    """
    largest = max(cause.score for cause in faults)
    tied = [cause for cause in faults if cause.score > largest - odds]
    of_torques = [x for x in tied if x.difference.kind.startswith("torque")]
    of_others = [x for x in tied if not x.difference.kind.startswith("torque")]
    first, *others = of_torques + of_others
    words = tuple(x.difference.fault.what for x in others if x.difference.fault)
    return replace(first, equivalents=words)


def compare_runs(
    runs: Sequence[RunLog], worse: float = 1.0
) -> Iterator[tuple[int, Issue]]:
    """Yield an issue if the arm of one run is not that of the other runs.

    Parameters
    ----------
    runs : sequence of RunLog
        Rows and repair of each run; nothing is yielded for a single run.
    worse : float
        Smallest ratio of errors, under one arm for all runs over under an arm for each
        run, that counts [-].

    Returns
    -------
    iterator of (int, Issue)
        The number of the run from 0, and what is different in it; one pair at most.
    """
    if len(runs) < 2:
        return
    comparison = RunComparison(runs)
    if not comparison.is_one_arm_worse(worse):
        return
    cause = comparison.find_best_cause()
    if cause is not None and comparison.explains_as_another_arm(cause):
        yield cause.difference.run, comparison.issue(cause)


def two_arms(log: Likelihood, repair: LogTransform) -> Iterator[Issue]:
    """Yield an issue if the log begins with one arm and ends with another: a load was
    picked up, or the file holds the logs of two arms.

    The log is cut at the likeliest row, and both stretches are compared as two runs.
    Each has separate torque offsets, so that a mere step of a torque makes no
    difference. Nothing is judged if a joint has a law or a drift that the model lacks,
    if there are too few rows, or if the arm does not explain the torques at all.

    Parameters
    ----------
    repair : LogTransform
        The repair that all runs have in common.

    Returns
    -------
    iterator of Issue
        At most one, at the instant of the cut.
    """
    # A step of a torque (an event at an instant) would hide the change: it is no longer
    # corrected. Laws and drifts remain.
    others = tuple(event for event in repair.events if not isinstance(event.at, float))
    repair = replace(repair, events=others)
    # Each of the two stretches needs PARTS parts, to be left out in turn.
    has_too_few_rows = log.data.count < 4 * c.PARTS
    if others or has_too_few_rows or log.spare_share <= 0.0:
        return
    if log.fit(repair).mean_unexplained_share > c.UNRELATED:
        return
    row = _likeliest_cut(log, repair)
    t = float(log.data.motion.t[row])
    before = RunLog(
        log.select_rows(slice(row)),
        repair,
        f"the part before t = {t:.4g} s",
        is_part=True,
    )
    after = RunLog(
        log.select_rows(slice(row, None)),
        repair,
        f"the part from t = {t:.4g} s on",
        is_part=True,
    )
    # Within a log friction changes as well: the arms have to differ by more than
    # those of two runs.
    for _, issue in compare_runs([before, after], _TWO_ARMS_IN_A_RUN):
        place = f"t = {t:.4g} s"
        if issue.figures["joints"]:
            place = f"{issue.where}, {place}"
        yield replace(
            issue,
            kind="two arms",
            where=place,
            remedy="cut the run there and use each part by itself (--window)",
            figures={**issue.figures, "t": t},
        )


def _likeliest_cut(log: Likelihood, repair: LogTransform) -> int:
    """Return the row that cuts a log into two stretches best explained by an arm each.

    The log is divided into 2 PARTS = 16 equal parts; cuts between parts are tried, with
    three parts at least on either side. The best cut minimises the sum over moving
    joints of the logarithm of the squared residual.
    """
    grams, n_own = log.gram_matrices(repair, 2 * c.PARTS)  # (16, n, w, w)
    n_parts = len(grams)
    cuts = range(3, n_parts - 2)
    # Gram matrices add: those of a stretch are the sum over its parts.
    stretches = [[grams[:k].sum(axis=0), grams[k:].sum(axis=0)] for k in cuts]
    equations = NormalEquations.eliminating(np.array(stretches), n_own)
    _, energy_left = equations.fitted(log.moving)  # (cuts, 2, n)
    of_cuts = energy_left.sum(axis=1)
    losses = np.log(of_cuts[:, log.moving]).sum(axis=1)
    best = cuts[int(np.argmin(losses))]
    return best * log.data.count // n_parts


def _with_events(repair: LogTransform, events: Sequence[LogEvent]) -> LogTransform:
    """Return a repair with additional events, without duplicates."""
    all_events = dict.fromkeys((*repair.events, *events))
    return replace(repair, events=tuple(all_events))


def _first(normal: Normal) -> Normal:
    """Return normal equations (s, s), (s,) from a stack of a single one, (1, s, s), (1,
    s)."""
    gram, cross = normal
    return gram[0], cross[0]


def _sum_of_normal_equations(normals: Sequence[Normal | None]) -> Normal | None:
    """Return the sum of the normal equations (s, s), (s,) of several runs; None stands
    for a run that is left out. The sum is None if all runs are left out.
    """
    known = [normal for normal in normals if normal is not None]
    if not known:
        return None
    gram = np.sum([gram for gram, _ in known], axis=0)
    cross = np.sum([cross for _, cross in known], axis=0)
    return gram, cross


def _project_out_last(normal: Normal, n_first: int) -> Normal:
    """Project all unknowns after the first ``n_first`` out of normal equations G x = c.

    With blocks 1 (first) and 2 (last), the result is the Schur complement: G11 - G12
    G22^-1 G21 and c1 - G12 G22^-1 c2.
    """
    gram, cross = normal
    s = n_first
    if len(cross) == s:
        return normal
    last_block = gram[s:, s:]
    right = np.concatenate([gram[s:, :s], cross[s:, None]], axis=1)
    taken = gram[:s, s:] @ solve(last_block, right)
    return gram[:s, :s] - taken[:, :s], cross[:s] - taken[:, s]


def _is_possible(log: Likelihood, difference: Difference, size: float) -> bool:
    """Whether a number that differs in one run has a physically possible size.

    size : of a torque gain the factor less one [-], which a drive may have; of an
    encoder offset [rad, m], below half a radian or below the reach of a prismatic
    joint; of a load [kg], lighter than the arm.
    """
    if difference.kind == "torque gain":
        smallest, largest = _POSSIBLE_GAINS
        return smallest < 1.0 + size < largest
    if difference.kind == "encoder offset":
        joint = difference.joint
        if joint in log.revolute:
            return abs(size) < _LARGEST_ZERO_SHIFT_RAD
        return bool(abs(size) < log.problem.robot.link_reach()[joint])
    masses = log.problem.nominal_links[:, 0]
    heaviest = max(float(masses.sum()), 1.0)  # a kilogram where masses are unknown
    return bool(abs(size) < heaviest)


def _list_numbers(
    log: Likelihood, repair: LogTransform, theta: Array
) -> Iterator[tuple[str, int, Array]]:
    """Yield the numbers that may differ in one run, each with the torque per unit of
    it.

    Parameters
    ----------
    repair : LogTransform
        The repair of the run.
    theta : (s,) array
        Parameters of the arm fitted to the other runs.

    Returns
    -------
    iterator of (kind, joint, columns)
        kind: "torque gain" (unit: factor less one), "encoder offset" [rad, m] or
        "another load"; joint from 0; columns: (n, M, r) torque of the run's joints per
        unit of the number, with r = 10 for the parameters of the load and else 1.
    """
    torque = log.raw(repair) @ theta  # (n, M), of the arm
    residual = log.unexplained(repair, theta)
    for joint in log.joints:
        is_joint = np.eye(log.n)[joint][:, None]
        yield "torque gain", joint, (torque * is_joint)[:, :, None]
        shifted = repair.with_entries("zero", (joint,), repair.zero[joint] + _ZERO_STEP)
        slope = (residual - log.unexplained(shifted, theta)) / _ZERO_STEP
        yield "encoder offset", joint, slope[:, :, None]
    if log.data.shared is not None:
        yield "another load", log.n - 1, load_columns(log, repair)
