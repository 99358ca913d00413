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

from sdp_vs_penalty.checks import constants as c
from sdp_vs_penalty.checks.faults.fault import Fault
from sdp_vs_penalty.checks.issue import EXPLANATION, Issue, joints_text
from sdp_vs_penalty.checks.likelihood import Likelihood
from sdp_vs_penalty.checks.repair import LogEvent, LogTransform
from sdp_vs_penalty.regression.normal_equations import (
    Normal,
    NormalEquations,
    jackknifed,
    solve,
    standard_errors_above_zero,
)
from sdp_vs_penalty.robot.arrays import Array

#: What of a number is usual: beyond it the runs differ.
_USUAL = {"torque gain": c.CALIBRATED_GAIN, "encoder offset": c.CALIBRATED}
#: What is different in a run, and what to do about it; x is the number, j the joint
#: from 1.
_WORDS = {
    "another arm": (
        (
            "{run} is not of the same arm: no gain, zero or load of one run explains"
            " the difference"
        ),
        "identify from one run at a time",
    ),
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
#: Faults that one run's log may have, by the run's number, and the repair of each.
Proposals = Callable[[int], Sequence[tuple[Fault, LogTransform]]]


@dataclass(frozen=True)
class RunLog:
    """A run's rows, their repair, and the run's name."""

    log: Likelihood
    repair: LogTransform
    name: str


@dataclass(frozen=True, kw_only=True)
class Difference:
    """What may be different in one run (by number): columns (n, M, r) of what its torque
    has beside the arm's, a fault of its log and the repair, or, with neither, an arm of
    its own."""

    run: int
    kind: str
    joint: int = -1
    columns: Array | None = None
    fault: Fault | None = None
    repair: LogTransform | None = None

    @property
    def is_another_arm(self) -> bool:
        return self.columns is None and self.repair is None


@dataclass(frozen=True)
class Cause:
    """A difference of one run, and how well it explains the runs.

    gain : fall of log S on parts that nothing was fitted to, all parts and joints added.
    clearness : of the mean fall, in standard errors. size : of the number (a gain less
    one, an angle [rad], a length [m], a load [kg]), 0 for a fault. equivalents : what
    explains as much, in words.
    """

    difference: Difference
    gain: float
    clearness: float
    size: float = 0.0
    equivalents: tuple[str, ...] = ()

    def log_repair(self, as_logged: LogTransform) -> LogTransform | None:
        """Repair that makes the run's log that of the others' arm.

        Parameters
        ----------
        as_logged : LogTransform
            The repair that changes nothing.

        Returns
        -------
        LogTransform or None
            None for another load or arm, which no change of the log undoes.
        """
        joints = (self.difference.joint,)
        if self.difference.kind == "torque gain" and self.size:
            return as_logged.with_entries("gain", joints, 1.0 / (1.0 + self.size))
        if self.difference.kind == "encoder offset" and self.size:
            return as_logged.with_entries("zero", joints, self.size)
        return self.difference.repair


class RunComparison:
    """One arm for all runs, against one for each."""

    def __init__(self, runs: Sequence[RunLog]) -> None:
        # A law of one run's joint is that of the arm's.
        events = [e for run in runs for e in run.repair.events if isinstance(e.at, str)]
        laws = dict.fromkeys(events)
        self.runs = [
            replace(run, repair=_with_events(run.repair, [*laws])) for run in runs
        ]
        self.moving = np.stack([run.log.moving for run in runs])
        self.equations = [
            NormalEquations.of(*r.log.parts(r.repair, 1)) for r in self.runs
        ]

    @cached_property
    def together(self) -> tuple[Array, Array]:
        """(s,) one arm for all runs, and (runs, n) what it leaves of each joint."""
        both = NormalEquations.together(self.equations).fitted(self.moving.ravel())
        return both[0][0], both[1].reshape(self.moving.shape)

    @cached_property
    def apart(self) -> Array:
        """(runs, n) what an arm for each run leaves of each joint."""
        pairs = zip(self.equations, self.moving, strict=True)
        return np.concatenate([x.fitted(moving)[1] for x, moving in pairs])

    @cached_property
    def lost(self) -> Array:
        """(runs, n) logarithm of what one arm for all leaves over what one for each
        leaves; 0 for joints that do not move."""
        ratio = np.log(self.together[1] / self.apart)
        return np.asarray(np.where(self.moving, ratio, 0.0))

    @property
    def times(self) -> float:
        """How many times worse one arm for all runs explains a joint of a run."""
        n_moving = max(int(self.moving[0].sum()), 1)
        return float(np.exp(0.5 * self.lost.sum() / n_moving))

    @property
    def times_of_worst_joint(self) -> float:
        """The same of the joint of a run that one arm for all explains worst."""
        return float(np.exp(0.5 * self.lost.max()))

    @cached_property
    def samples(self) -> float:
        """Independent samples of a run, in the mean."""
        return float(np.mean([r.log.samples(r.log.score(r.repair)) for r in self.runs]))

    def differs(self, worse: float) -> bool:
        """Whether one arm for all is so many times worse, and clearly: friction is
        never quite the same again."""
        evidence = 0.5 * self.samples * float(self.lost.sum())
        return evidence >= 3.0 * c.ODDS and self.times >= max(worse, c.TIMES_BETTER)

    @cached_property
    def excess(self) -> Array:
        """(runs, n) logarithm of the share of each joint's energy that one arm for all
        leaves in a run, over the smallest share that an arm leaves of it in any run; 0
        for joints that do not move.

        A run whose joints contradict each other is not explained by an arm of its own
        either: the other runs tell how well it should be.
        """
        total = np.stack([equations.total[0] for equations in self.equations])
        of_one_arm = np.where(
            self.moving,
            self.together[1] / total,
            1.0,
        )
        of_own_arms = np.where(self.moving, self.apart / total, 1.0)
        smallest = np.minimum(of_one_arm, of_own_arms).min(axis=0)
        return np.asarray(
            np.where(
                self.moving,
                np.log(of_one_arm / smallest),
                0.0,
            )
        )

    @property
    def stands_out(self) -> bool:
        """Whether one arm for all explains a joint of one run far worse than an arm
        explains it in another run."""
        return float(np.exp(0.5 * self.excess.max())) >= c.TIMES

    @cached_property
    def suspects(self) -> list[int]:
        """Two runs that may be different: the one that is explained worst beside the
        others, and the one that loses the most by one arm for all.

        Of two runs it may be either.
        """
        by_excess = np.argsort(-self.excess.sum(axis=1))
        by_loss = np.argsort(-self.lost.sum(axis=1))
        order = dict.fromkeys(
            [
                int(by_excess[0]),
                *by_loss.tolist(),
            ]
        )
        return sorted([*order][:2])

    @cached_property
    def weights(self) -> Array:
        """(runs, n) of the joints' rows: each by what an arm of its run leaves."""
        return np.where(self.moving, 1.0 / self.apart, 0.0)

    @cached_property
    def normals(self) -> list[Normal]:
        """The normal equations of each run."""
        pairs = zip(self.equations, self.weights, strict=True)
        return [_first(x.normal(weights)) for x, weights in pairs]

    def arm_of_others(self, number: int) -> Array:
        """(s,) parameters of the arm of all runs but one."""
        others = _sum([x for k, x in enumerate(self.normals) if k != number])
        assert others is not None
        gram, cross = others
        return solve(gram, cross[:, None])[:, 0]

    def normal_with(self, difference: Difference) -> Normal | None:
        """The normal equations of the run that is different, its number projected out;
        None where its arm is another one."""
        if difference.is_another_arm:
            return None
        run = self.runs[difference.run]
        repair = run.repair
        if difference.repair is not None:
            repair = difference.repair.then(repair)
        equations = NormalEquations.of(*run.log.parts(repair, 1, difference.columns))
        normal = _first(equations.normal(self.weights[difference.run]))
        return _without_last(normal, len(self.normals[difference.run][1]))

    def errors(self, difference: Difference | None) -> tuple[Array, Array | None]:
        """(2 PARTS, n) what is left of the parts of the suspects, each left out in turn,
        and (PARTS, s) the arms of the run that is different."""
        normals: list[Normal | None] = [*self.normals]
        if difference is not None:
            normals[difference.run] = self.normal_with(difference)
        left = []
        arms = None
        for number in self.suspects:
            run = self.runs[number]
            others = _sum([x for k, x in enumerate(normals) if k != number])
            repair = run.repair
            columns = run.log.raw(repair)[:, :, :0]
            is_this = difference is not None and difference.run == number
            if difference is not None and is_this:
                others = None if difference.is_another_arm else others
                columns = columns if difference.columns is None else difference.columns
                if difference.repair is not None:
                    repair = difference.repair.then(repair)
            fitted, errors = run.log.jackknife_errors(
                repair,
                self.weights[number],
                columns,
                others,
            )
            arms = fitted if is_this else arms
            left.append(errors)
        return np.concatenate(left), arms

    @cached_property
    def before(self) -> Array:
        """(2 PARTS, n) what one arm for all leaves."""
        return self.errors(None)[0]

    def cause(self, difference: Difference) -> Cause | None:
        """The difference judged; None for a number that is not of a size that it may
        have."""
        log = self.runs[difference.run].log
        after, arms = self.errors(difference)
        moving = np.any(self.moving, axis=0)
        fall = np.log(self.before / after)[:, moving].sum(axis=1)
        gain = float(fall.sum())
        clearness = standard_errors_above_zero(fall.reshape(-1, c.PARTS))
        if difference.is_another_arm:
            return Cause(difference, 0.5 * gain, clearness)
        if difference.columns is None or arms is None:
            return Cause(difference, gain, clearness)
        value, spread = jackknifed(arms[:, -difference.columns.shape[2]])
        size = float(value)
        threshold = max(c.SIGMAS * float(spread), _USUAL.get(difference.kind, 0.0))
        if abs(size) <= threshold or not _can_be(log, difference, size):
            return None
        # Of a number, whose interval tells as well, half as clear a prediction is
        # enough.
        return Cause(difference, gain, 2.0 * clearness, size)

    def numbers(self) -> list[Cause]:
        """A gain, a zero or a load of one run, or another arm."""
        causes = []
        for number in self.suspects:
            run = self.runs[number]
            causes.append(self.cause(Difference(run=number, kind="another arm")))
            arm = self.arm_of_others(number)
            for kind, joint, columns in _changes(run.log, run.repair, arm):
                number_of = Difference(
                    run=number,
                    kind=kind,
                    joint=joint,
                    columns=columns,
                )
                causes.append(self.cause(number_of))
        return [cause for cause in causes if cause is not None]

    def faults(self, proposals: Proposals) -> list[Cause]:
        """Faults of one run's log alone, which are repaired before what all runs
        have in common."""
        causes = []
        for number in self.suspects:
            for fault, repair in proposals(number):
                joint = fault.joints[0] if fault.joints else -1
                difference = Difference(
                    run=number,
                    kind=fault.kind,
                    joint=joint,
                    fault=fault,
                    repair=repair,
                )
                causes.append(self.cause(difference))
        return [cause for cause in causes if cause is not None]

    def best_cause(self, proposals: Proposals | None = None) -> Cause | None:
        """What explains the difference best on parts left out; a fault of the log only
        by the odds against one, or None where nothing predicts it."""
        best = max(self.numbers(), key=lambda cause: cause.gain)
        if proposals is not None:
            odds = 2.0 * c.PARTS * c.ODDS / self.samples
            faults = [x for x in self.faults(proposals) if x.gain > best.gain + odds]
            best = _simplest(faults, odds) if faults else best
        evidence = 0.5 * self.samples * best.gain / (2.0 * c.PARTS)
        is_clear = best.clearness >= c.SIGMAS and evidence >= 3.0 * c.ODDS
        # Friction that the model lacks differs from run to run, as another arm does.
        is_unspecific = best.difference.is_another_arm and self.times < c.TIMES
        if not is_clear or is_unspecific:
            return None
        return self._of_the_heavier_run(best)

    def _of_the_heavier_run(self, cause: Cause) -> Cause:
        """Of two runs, the load that one carries more, not the one that the other lacks;
        any other cause as it is."""
        is_lack = cause.difference.kind == "another load" and cause.size < 0.0
        if not is_lack or len(self.runs) != 2:
            return cause
        of_other = replace(cause.difference, run=1 - cause.difference.run)
        return replace(cause, difference=of_other, size=-cause.size)

    @property
    def _reason(self) -> str:
        """By how much one arm for all runs is worse, in words."""
        one_arm = "one arm for all runs explains a joint"
        by_excess = float(np.exp(0.5 * self.excess.max()))
        if by_excess > self.times_of_worst_joint:
            return f"{one_arm} {by_excess:.2g} times worse in one run than in another"
        return (
            f"{one_arm} {self.times_of_worst_joint:.2g} times worse than one for each"
        )

    def issue(self, cause: Cause) -> Issue:
        """The cause in words."""
        difference = cause.difference
        run = self.runs[difference.run]
        unit = run.log.problem.robot.position_units[difference.joint]
        distance = f"{-cause.size:.2g} {unit}"
        if unit == "rad":
            distance = f"{np.degrees(-cause.size):.2g} degrees"
        x = 1.0 + cause.size if difference.kind == "torque gain" else cause.size
        names = {
            "run": run.name,
            "j": difference.joint + 1,
            "x": x,
            "weight": "lighter" if cause.size < 0.0 else "heavier",
        }
        if difference.fault is None:
            words, remedy = _WORDS[difference.kind]
            what = words.format(**names, distance=distance, unit=unit)
            remedy = remedy.format(**names, unit=unit)
            joints = [] if difference.joint < 0 else [difference.joint]
        else:
            what = f"in {run.name} only: {difference.fault.what.rstrip('.')}"
            remedy = f"{difference.fault.remedy} in this run"
            joints = [*difference.fault.joints]
        return Issue(
            kind=difference.kind,
            severity="warning",
            where=joints_text(joints) if joints else "the run",
            what=f"{what}, beside the others.",
            certainty=f"likely: {self._reason}",
            remedy=remedy,
            figures={
                "joints": [k + 1 for k in joints],
                "run": run.name,
                "size": cause.size,
                "times": self.times,
            },
            nature=EXPLANATION,
            repair=None if difference.repair is None else difference.repair.apply,
            apply="" if difference.fault is None else difference.fault.apply,
            equivalents=cause.equivalents,
        )


def _simplest(faults: Sequence[Cause], odds: float) -> Cause:
    """The fault that explains most; of those that explain the same one of the torques
    comes before one of the positions. The others are its equivalents."""
    largest = max(cause.gain for cause in faults)
    tied = [cause for cause in faults if cause.gain > largest - odds]
    tied = sorted(
        tied, key=lambda cause: not cause.difference.kind.startswith("torque")
    )
    words = tuple(
        cause.difference.fault.what for cause in tied[1:] if cause.difference.fault
    )
    return replace(tied[0], equivalents=words)


def compare_runs(
    runs: Sequence[RunLog], worse: float = 1.0
) -> Iterator[tuple[int, Issue]]:
    """Where the arm of a run is not that of the others.

    Parameters
    ----------
    runs : sequence of RunLog
        Their rows and repairs; of a single one nothing is said.
    worse : float
        Only where one arm for all explains them so many times worse than one for each.

    Returns
    -------
    iterator of (int, Issue)
        The number of the run, and what is different in it.
    """
    if len(runs) < 2:
        return
    comparison = RunComparison(runs)
    if not comparison.differs(worse):
        return
    cause = comparison.best_cause()
    if cause is not None:
        yield cause.difference.run, comparison.issue(cause)


def two_arms(log: Likelihood, repair: LogTransform) -> Iterator[Issue]:
    """Two stretches of a log that are not one arm's, as two runs: a load picked up, or
    two arms' logs in one file.

    Each stretch has offsets of its own, so that of a step in a torque alone nothing is
    left.
    """
    laws = tuple(e for e in repair.events if not isinstance(e.at, float))
    repair = replace(repair, events=laws)
    # Each of the two has parts of its own, that are left out.
    too_few = log.data.count < 4 * c.PARTS
    if laws or too_few or log.spare <= 0.0:
        return
    if log.score(repair).mean_share > c.UNRELATED:
        return
    row = _likeliest_cut(log, repair)
    t = float(log.data.motion.t[row])
    before = RunLog(log.some(slice(row)), repair, f"the part before t = {t:.4g} s")
    after = RunLog(
        log.some(slice(row, None)),
        repair,
        f"the part from t = {t:.4g} s on",
    )
    # Within a log, friction changes as well.
    for _, issue in compare_runs([before, after], c.TIMES**0.5):
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
    """The row that parts the log into two which an arm for each explains best; neither
    is short."""
    parts, n_own = log.parts(repair, 2 * c.PARTS)
    cuts = range(3, len(parts) - 2)
    sums = np.array(
        [
            [
                parts[:cut].sum(axis=0),
                parts[cut:].sum(axis=0),
            ]
            for cut in cuts
        ]
    )
    left = NormalEquations.of(sums, n_own).fitted(log.moving)[1].sum(axis=1)
    losses = np.log(left[:, log.moving]).sum(axis=1)
    return cuts[int(np.argmin(losses))] * log.data.count // len(parts)


def _with_events(repair: LogTransform, events: Sequence[LogEvent]) -> LogTransform:
    """With more events, none of them twice."""
    return replace(repair, events=tuple(dict.fromkeys((*repair.events, *events))))


def _first(normal: Normal) -> Normal:
    """The normal equations of the one part of a log (1, ...)."""
    return normal[0][0], normal[1][0]


def _sum(normals: Sequence[Normal | None]) -> Normal | None:
    """Those that there are, added; None where there is none."""
    known = [normal for normal in normals if normal is not None]
    if not known:
        return None
    gram = np.sum([normal[0] for normal in known], axis=0)
    return gram, np.sum([normal[1] for normal in known], axis=0)


def _without_last(normal: Normal, s: int) -> Normal:
    """Normal equations with all unknowns but the first s projected out."""
    gram, cross = normal
    if len(cross) == s:
        return normal
    right = np.concatenate([gram[s:, :s], cross[s:, None]], axis=1)
    taken = gram[:s, s:] @ solve(gram[s:, s:], right)
    return gram[:s, :s] - taken[:, :s], cross[:s] - taken[:, s]


def _can_be(log: Likelihood, difference: Difference, x: float) -> bool:
    """Whether a number that is different in a run is of a size that it can have: a gain
    is positive, a zero within a part of a turn, a load less than the arm."""
    if difference.kind == "torque gain":
        return 0.2 < 1.0 + x < 5.0
    if difference.kind == "encoder offset":
        joint = difference.joint
        turns = joint in log.revolute
        return abs(x) < (0.5 if turns else log.problem.robot.link_reach()[joint])
    masses = log.problem.nominal_links[:, 0]
    return bool(abs(x) < max(float(masses.sum()), 1.0))


def _changes(
    log: Likelihood,
    repair: LogTransform,
    theta: Array,
) -> Iterator[tuple[str, int, Array]]:
    """Kind, joint and columns (n, M, r) of what may be different in a run, beside an
    arm's torque; theta : (s,) the arm's parameters."""
    torque = log.raw(repair) @ theta
    residual = log.unexplained(repair, theta)
    for j in log.joints:
        only_j = np.eye(log.n)[j][:, None]
        yield "torque gain", j, (torque * only_j)[:, :, None]
        shifted = repair.with_entries(
            "zero",
            (j,),
            repair.zero[j] + 0.01,
        )
        slope = (residual - log.unexplained(shifted, theta)) / 0.01
        yield "encoder offset", j, slope[:, :, None]
    if log.data.shared is not None:
        last = log.columns(repair.of_arm)[:, :, log.data.shared.rigid_indices[-10:]]
        yield "another load", log.n - 1, log.filter_gain(repair)[:, :, None] * last
