"""Are the torques those of joints: what made them, and are they of a possible size?

The dynamics that joints share show the channels' ratios, never their common size. The size
is judged by the joints' effort limits, which bind every sample, and by the torque that an arm
of the problem's masses needs for the motion.
"""

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from sdp_vs_penalty import formatting
from sdp_vs_penalty.checks import constants as c
from sdp_vs_penalty.checks.certainty import READ, likely, possible, stated
from sdp_vs_penalty.checks.issue import Issue, Left, make_explanation
from sdp_vs_penalty.checks.residual import leaves_more_than_usual
from sdp_vs_penalty.data.hypotheses.channels import UNSAID_CURRENT
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.data.words.units import UNITS as NAMED
from sdp_vs_penalty.problem.problem import Problem
from sdp_vs_penalty.race.arm_fit import ArmFit
from sdp_vs_penalty.race.chain import LogTransform
from sdp_vs_penalty.race.evidence import Evidence
from sdp_vs_penalty.race.fault import UNITS
from sdp_vs_penalty.race.likelihood import Likelihood
from sdp_vs_penalty.regression.normal_equations import solve
from sdp_vs_penalty.results.remedy import Change
from sdp_vs_penalty.robot.arrays import Array, Mask, at_least_tiny, nonzero_or_one

#: Largest share of the joints that may have a unit of their own: if more torques are too
#: large, all are in another unit.
_SINGLE_JOINTS = 0.3
_BY_SIZE = likely("judged by size alone")
#: Units of about a tenth of a N m.
_TENTHS = {"kgf cm": NAMED["kgfcm"], "lbf in": NAMED["lbfin"]}
#: Largest ratio of motor currents in mA to an arm's torques in N m: with their gears, motors
#: make more than 3 N m of an ampere.
_OF_CURRENTS = 300.0
#: What stands for the share of effort limits where there are none.
_NO_LIMIT = -1.0
_CORRECT_MASSES = "if right, correct the robot file's masses"
#: The explanation that torques are in another unit.
of_torque_unit = partial(
    make_explanation, "torque unit", in_doubt="torque unit", is_torque_unit=True
)
#: What issues about torques that are no torques in N m have in common.
_CHANNEL_KIND: Mapping[str, Any] = {
    "kind": "torque channel kind",
    "heading": "torques that are not in N m",
    "in_doubt": "the torques' unit",
    "left": Left.RATIOS,
}


def torque_magnitude(
    log: Likelihood, repair: LogTransform, runs: Sequence[ArmFit]
) -> Iterator[Issue]:
    """Yield a warning where the torques have an impossible size.

    They may be in another unit, motor currents, torques on the motor's side of the
    gear, or what is left where a controller's model was subtracted. Or the problem's
    masses are wrong.

    Parameters
    ----------
    repair : LogTransform
        How the log is repaired.
    runs : sequence of ArmFit
        An arm fitted to each run alone: runs may carry different loads.
    """
    shares = _shares_of_effort(log, repair)
    is_too_large = shares > c.EFFORT[1]
    if is_too_large.any():
        is_too_large &= ~_is_as_nominal(log, repair)
    too_large = np.flatnonzero(is_too_large)
    if 0 < len(too_large) <= _SINGLE_JOINTS * log.n:
        times = formatting.words([f"{x:.3g}" for x in shares[too_large]])
        yield of_torque_unit(
            joints=too_large,
            what=f"the torque of {{where}} is {times} times what the joint is made for:"
            " in another unit.",
            certainty=_BY_SIZE,
            remedy=_CONVERT,
            changes=_scales(f"tau{j + 1}" for j in too_large),
        )
        return
    size = _Size.from_shares(log, repair, shares)
    yield from _issues_of_size(log, repair, runs, size)


def _shares_of_effort(log: Likelihood, repair: LogTransform) -> Array:
    """Return the largest torque (n,) of each joint over its effort limit [-]; nan where
    the joint has no limit.

    The torque is low-passed: a drive may exceed its limit for an instant, as where a
    move begins.
    """
    limits = np.array([joint.effort for joint in log.problem.robot.joints], float)
    is_limit = (limits > 0.0) & np.isfinite(limits)
    largest = np.abs(log.torques(repair)).max(axis=1)
    return largest / np.where(is_limit, limits, np.nan)


def _is_as_nominal(log: Likelihood, repair: LogTransform) -> Mask:
    """Flag the joints (n,) whose torque is what the problem's links need for the motion.

    If the nominal links need more than the effort limit as well, the limit is wrong, or a
    simulator had none: the torque's unit may be right. False where the masses are unknown.
    """
    if np.all(log.problem.guessed_links):
        return np.zeros(log.n, bool)
    arm = log.torque_mask(repair) * log.nominal(repair).T
    nominal = np.linalg.norm(arm, axis=1)
    measured = np.linalg.norm(log.channels(repair), axis=1)
    return measured < c.EFFORT[1] * nominal


@dataclass(frozen=True)
class _Size:
    """How large the torques are, in two measures [-]."""

    #: Size in words.
    description: str
    #: Largest torque over its joint's effort limit; _NO_LIMIT without limits.
    over: float
    #: Torque over that of an arm with the problem's nominal links.
    measured: float
    #: Smallest possible value of ``measured``.
    smallest: float = 1e-2
    #: Largest possible value of ``measured``.
    largest: float = 1.0
    #: Whether the torques are too large.
    is_large: bool = False
    #: Whether the torques are too small.
    is_small: bool = False
    #: Whether the masses are known; without them ``measured`` is ``over``.
    is_mass_known: bool = False

    @property
    def times_nominal(self) -> float | None:
        """Torque over that of a nominal arm; None where its masses are unknown."""
        return self.measured if self.is_mass_known else None

    @property
    def is_far(self) -> bool:
        """Whether the torques are far above the joints' effort limits."""
        return self.over > c.EFFORT[1]

    @classmethod
    def from_shares(
        cls, log: Likelihood, repair: LogTransform, shares: Array
    ) -> "_Size":
        """Return the size of the torques of a repaired log; shares (n,) : largest
        torques over the effort limits."""
        over = float(np.max(shares, initial=_NO_LIMIT, where=shares > 0.0))
        problem = log.problem
        masses = float(problem.prior_links[:, 0].sum())
        if masses <= 0.0 or np.all(problem.guessed_links):
            return cls(f"{over:.3g} times what the joints are made for", over, over)
        low, high, weighs = _possible_masses(problem, masses)
        rows, evidence = log.rows(repair), Evidence(log)
        measured = _norm(log.channels(repair).T) / evidence.nominal_size(rows.raw)
        largest = high / masses * c.EFFORT[1]
        smallest = max(low, 0.1 * high) / masses / c.EFFORT[1]
        # Joints with upright axes carry no weight, and friction may be most of their
        # torque: the torque without friction has to be too large as well.
        of_links = rows.projected @ log.fit(repair).theta
        shared = _norm(of_links) / evidence.nominal_size(rows.projected)
        return cls(
            description=f"{measured:.3g} times what an arm of {weighs} kg needs",
            over=over,
            measured=measured,
            smallest=smallest,
            largest=largest,
            is_large=min(measured, shared) > largest,
            is_small=measured < smallest,
            is_mass_known=True,
        )


def _possible_masses(problem: Problem, masses: float) -> tuple[float, float, str]:
    """Return the smallest and the largest mass [kg] that the arm may have, and both in
    words: the problem's limits of the total mass, else half and twice the nominal mass.
    """
    low, high = problem.total_mass
    if np.isfinite(high):
        return low, high, f"{low:g} to {high:g}"
    return 0.5 * masses, 2.0 * masses, f"{masses:.3g}"


def _issues_of_size(
    log: Likelihood, repair: LogTransform, runs: Sequence[ArmFit], size: _Size
) -> Iterator[Issue]:
    """Yield the likeliest reason why the torques are too large or too small.

    In this order: wrong masses in the problem (torques of a usual size), another unit
    (too large), an external torque (small and unlike the arm's dynamics), motor
    currents (small, and explained by the arm's dynamics). None if the size may be
    right, or if the arm does not explain the torques at all.
    """
    known: dict[str, Any] = {
        "joints": range(log.n),
        "where": "all torque channels",
        "figures": {"times_nominal": size.times_nominal},
    }
    of_size = partial(make_explanation, **known)
    of_unit = partial(of_torque_unit, **known)
    are = f"the torques are {size.description}: "
    by_unit = _scales(["tau"])
    is_wrong = size.is_large or size.is_small
    smallest_share, largest_share = c.EFFORT
    if is_wrong and smallest_share <= size.over <= largest_share:
        if units := _small_units(size):
            yield of_unit(
                f"{are}they are in {' or '.join(units)}, or the robot file's masses are"
                " wrong.",
                remedy=f"say the unit; {_CORRECT_MASSES}",
                changes=by_unit,
                certainty=possible("size alone does not tell which"),
            )
            return
        yield of_size(
            "masses of the problem",
            in_doubt="masses of the problem",
            what=f"{are}the robot file's masses are wrong: the torques reach what torques do,"
            f" {100.0 * size.over:.0f} % of the joints' effort limits.",
            remedy="correct the masses of the robot's file",
            certainty=_BY_SIZE,
            where="the problem",
        )
        return
    if size.is_large or (size.is_far and not size.is_mass_known):
        yield _of_another_unit(size, of_unit, are)
        return
    if not size.is_small:
        return
    external = partial(
        of_size,
        "external torque",
        in_doubt="external torque",
        remedy="log the measured joint torque: neither masses nor inertias can be"
        " identified from this",
        left=Left.FACTS,
    )
    torques, nominal = _torques_without_friction(log, repair)
    if _resembles(torques.T, nominal.T) < c.RESEMBLES:
        yield external(
            f"{are}they do not follow the arm's weight and inertia: what is left where a"
            " model was subtracted (external torque).",
            certainty=_BY_SIZE,
        )
        return
    if all(fit.mean_unexplained_share > c.UNRELATED for fit in runs):
        return  # another issue says that the arm does not explain them
    best = min(runs, key=lambda fit: fit.unexplained)
    if leaves_more_than_usual(log, best):
        # Motor currents are small as well, but the arm's dynamics explain them.
        yield external(
            f"{are}the arm's dynamics leave {100.0 * best.unexplained**0.5:.2g} % of them,"
            " more than of a motor's current: what is left where a model was subtracted"
            " (external torque), or another channel.",
            certainty=likely("by their size, and by what the arm's dynamics leave"),
        )
        return
    gains = gains_by_size(log, repair)
    yield of_size(
        **_CHANNEL_KIND,
        what=f"{are}they are motor currents, or torques on the motor side of the gear. A model"
        " of them is unscaled: its ratios are right, its kilograms are not.",
        remedy="multiply each channel by its drive gain (N m per A, gear ratio included)"
        f"{_by_masses(log.problem, gains)}; {_CORRECT_MASSES}",
        changes=(*by_unit, *gains),
        certainty=_BY_SIZE,
    )


def gains_by_size(
    log: Likelihood, repair: LogTransform, unit: str = "A"
) -> tuple[Change, ...]:
    """Return the reading of all torques by the gains with which they have the size that an
    arm of the problem's masses needs, friction apart.

    The channels' ratios are those of the repair; the common size is the masses'. Empty where
    the masses are unknown, or the torques do not follow the arm's dynamics.
    """
    problem = log.problem
    if problem.prior_links[:, 0].sum() <= 0.0 or np.all(problem.guessed_links):
        return ()
    torques, needed = _torques_without_friction(log, repair)
    size = float(np.sum(torques * needed) / at_least_tiny(np.sum(torques**2)))
    if size <= 0.0 or _resembles(torques.T, needed.T) < c.RESEMBLES:
        return ()
    gains = np.empty(log.n)
    gains[list(repair.tau_order)] = size * np.abs(repair.torque_factors)
    texts = [f"{gain:.3g}" for gain in gains]
    listed = formatting.words(texts if len({*texts}) > 1 else texts[:1])
    factors = f"{listed} {_unit_of_gains(problem, unit)}"
    words = f"multiply tau by {factors} (estimated from the robot's masses)"
    arguments = {"scale": {"tau": ":".join(texts)}, "by_size": factors}
    return (Change("read", words, arguments),)


def _unit_of_gains(problem: Problem, unit: str) -> str:
    """Return the unit of drive gains which make torques of columns in ``unit``."""
    is_slide = [joint.kind == "prismatic" for joint in problem.robot.joints]
    units = ["N" if slides else "N m" for slides in is_slide]
    return f"{' or '.join(dict.fromkeys(units))} per {unit or 'A'}"


def _by_masses(problem: Problem, changes: Sequence[Change], unit: str = "A") -> str:
    """Say what is done where no drive gain is known: what the changes of
    :func:`gains_by_size` multiply torques in ``unit`` by; "" where there are none."""
    if not changes:
        return ""
    factors = changes[0].arguments["scale"]["tau"].split(":")
    per = _unit_of_gains(problem, unit)
    return (
        "; where these are unknown, by gains that fit the robot's masses, about"
        f" {_gains_in_words([*map(float, factors)], per)}: the model's kilograms are then"
        " no surer than those"
    )


def _gains_in_words(gains: Sequence[float], per: str) -> str:
    """Say gains (n,), which are no surer than the masses, with two digits, and what they
    share; ``per`` is their unit.

    >>> _gains_in_words([9.51, 11.6, 9.51], "N m per A")
    "9.5 N m per A, one for all joints but joint 2 (12, by the torques' ratio)"
    """
    texts = [f"{gain:.2g}" for gain in gains]
    ((usual, count),) = Counter(texts).most_common(1)
    if count == 1:
        by_ratio = ", each by the torques' ratios" if len(texts) > 1 else ""
        return f"{formatting.words(texts)} {per}{by_ratio}"
    others = [(j, x) for j, x in enumerate(texts, 1) if x != usual]
    if not others:
        return f"{usual} {per}, one for all joints"
    joints = formatting.joints([j for j, _ in others])
    sizes = formatting.words([x for _, x in others])
    ratio = "ratio" if len(others) == 1 else "ratios"
    return f"{usual} {per}, one for all joints but {joints} ({sizes}, by the torques' {ratio})"


def gains_are_by_size(gains: str) -> Issue:
    """Return the warning about a run whose torques are in N m by :func:`gains_by_size`,
    with the gains in words."""
    of_masses = "no surer than the masses of the robot file"
    multiplied = f"multiplied by {gains}, estimated from these"
    return make_explanation(
        kind="gains by size",
        heading=f"N m are {of_masses} ({multiplied})",
        in_doubt=f"N m, {of_masses} ({multiplied})",
        what="nobody has stated the drive gains.",
        certainty=stated("the gains were taken from the robot's masses"),
        remedy="type the drive gains if you know them",
        where="all torque channels",
        changes=_scales(["tau"]),
    )


def _torques_without_friction(
    log: Likelihood, repair: LogTransform
) -> tuple[Array, Array]:
    """Return the torques (n, M) and those of a nominal arm, where joints slide, without the
    friction that can be most of them."""
    nominal = log.torque_mask(repair) * log.nominal(repair).T
    pair = np.stack([log.channels(repair), nominal], axis=2)
    torques, needed = np.moveaxis(log.rows(repair).project_out_own(pair), 2, 0)
    return torques, needed


def _small_units(size: _Size) -> list[str]:
    """List the units of about a tenth of a N m in which torques have the size that an arm of
    the problem's masses needs."""
    return [
        name
        for name, factor in _TENTHS.items()
        if size.is_large and 0.5 < size.measured * factor < 2.0
    ]


def not_in_newton_metres(
    problem: Problem, run: Measurements, gains: Sequence[Change]
) -> Issue:
    """Return the warning that torques are in the unit that their columns say, "A" or
    "%", and that only the user knows how many N m it is; ``gains`` : :func:`gains_by_size`."""
    unit, said, sure = run.torque_unit, "as their columns say", READ
    if UNSAID_CURRENT in run.reading:
        said = "or raw: their names say a current, and no unit"
        sure = likely("by their names")
    return make_explanation(
        **_CHANNEL_KIND,
        what=f"the torques are in {unit}, {said}. A model of them is"
        " unscaled: its ratios are right where all channels have one factor, its"
        " kilograms are not.",
        certainty=sure,
        remedy=f"multiply each channel by its N m per {unit}, gear ratio included"
        f"{_by_masses(problem, gains, unit)}",
        where="all torque channels",
        changes=(*_scales(["tau"]), *gains),
    )


def with_one_unit(run: str, issues: Sequence[Issue], n: int) -> tuple[Issue, ...]:
    """Return the issues of a run of n joints. If the torques of more than _SINGLE_JOINTS of
    the joints are all larger, or all smaller, than in the other runs, their issues become
    one: this run has another unit."""
    gains = [issue for issue in issues if issue.is_gain and issue.size is not None]
    sizes = [issue.size for issue in gains if issue.size is not None]
    joints = sorted(j - 1 for issue in gains for j in issue.joints)
    if len(joints) <= _SINGLE_JOINTS * n or len({size > 0.0 for size in sizes}) > 1:
        return tuple(issues)
    times = sorted(max(1.0 + size, 1.0 / (1.0 + size)) for size in sizes)
    how = "large" if sizes[0] > 0.0 else "small"
    words = f"read the torque of {run} in another unit, or by its drive gains"
    one = of_torque_unit(
        joints=joints,
        what=f"in {run} only: the torques of {{where}} are {times[0]:.3g} to"
        f" {times[-1]:.3g} times too {how} beside those of the other runs: they are in"
        " another unit, or currents.",
        certainty=gains[0].certainty,
        remedy="say the unit of this run, or the drive gain of each joint",
        changes=(Change("read", words, {"run": run, "scale": {"tau": None}}),),
        run=run,
        figures={"times": times},
    )
    first = issues.index(gains[0])
    others = [x for x in issues if x not in gains]
    return (*others[:first], one, *others[first:])


def _of_another_unit(size: _Size, of_unit: Callable[..., Issue], are: str) -> Issue:
    """Return the issue that torques too large for N m are in another unit. It names the unit
    that makes their size possible; currents in mA are named beside it if they do as well."""
    for factor, name in UNITS.items():
        fits = size.smallest <= size.measured * factor <= size.largest
        if not (size.is_far and factor < 0.1 and fits):
            continue
        if size.measured < _OF_CURRENTS:
            unit = {"scale": {"tau": name.replace(" ", "").lower()}}
            return of_unit(
                f"{are}they are in {name}, or motor currents in mA: size does not tell"
                " which.",
                remedy=f"say which: {name}, or mA by each joint's N m per mA, gear ratio"
                " included",
                changes=(
                    Change("read", f"read tau in {name}", unit),
                    *_scales(["tau"]),
                ),
                certainty=possible("judged by size alone"),
            )
        return of_unit(
            f"{are}they are in {name}.",
            remedy=f"multiply by {factor:g}",
            certainty=_BY_SIZE,
            repair=partial(_scaled, factor=factor),
            apply="unit:tau",
        )
    return of_unit(
        f"{are}their unit is not N m.",
        remedy=f"{_CONVERT}; {_CORRECT_MASSES}",
        changes=_scales(["tau"]),
        certainty=_BY_SIZE,
    )


#: What is done with torques in an unknown unit.
_CONVERT = (
    "convert to N m (N for a prismatic joint), by the unit's name or factor: N cm times"
    " 0.01, mN m times 0.001"
)


def _scales(columns: Iterable[str]) -> tuple[Change, ...]:
    """Return the readings of torque columns (tau, or tau7 ...) by a unit or by factors
    that the user has to name."""
    words = "read {} in another unit, or by its drive gains"
    return tuple(
        Change("read", words.format(column), {"scale": {column: None}})
        for column in columns
    )


def _scaled(run: Measurements, factor: float) -> Measurements:
    """Return the run with all torques multiplied by a factor."""
    return replace(run, tau=run.tau * factor)


def kind_of_torque(log: Likelihood) -> Iterator[Issue]:
    """Yield a warning where the torques are those of a controller's gravity model: the
    weight of an arm alone, without inertia and friction.

    Nothing else can be learned from such torques.
    """
    if (
        log.data.shared is None
        or not any(log.as_logged.gravity)
        or log.spare_share <= 0.0
    ):
        return
    shares = _left_by_weight(log)
    # A joint that moves one way only has friction that looks like an offset: only joints
    # that turn round show that there is none.
    speeds = log.data.motion.dq * log.torque_mask(log.as_logged).T
    turns_round = speeds.max(axis=0) * speeds.min(axis=0) < 0.0
    is_weight = shares[log.moving].max() < c.MODEL_OF_WEIGHT
    if is_weight and turns_round[log.moving].all():
        yield make_explanation(
            kind="gravity model",
            in_doubt="gravity model",
            what="the torques are the weight of an arm alone: no inertia, and no"
            f" friction of any joint ({100.0 * shares.max() ** 0.5:.2g} % is left).",
            certainty=likely("every motor bears friction"),
            remedy="log the measured torque or current: this is the controller's model"
            " of gravity, from which friction and inertia cannot be identified",
            where="all torque channels",
        )


def _left_by_weight(log: Likelihood) -> Array:
    """Return the share (n,) of each torque's energy that the arm's weight and an offset
    of each joint leave, by one least-squares fit to all joints of equal weight."""
    fit = log.fit(log.as_logged)
    mask = log.torque_mask(log.as_logged)[:, :, None]
    weight = mask * log.shared(log.as_logged, is_still=True)  # (n, M, s)
    offsets = np.eye(log.n)[:, None, :] * mask
    # Each joint's torque is scaled to energy 1, so that residuals are shares.
    size = np.sqrt(np.maximum(fit.energy, 1e-280))[:, None]
    columns = np.concatenate([weight, offsets], axis=2) / size[:, :, None]
    columns = columns.reshape(log.n * log.data.count, -1)
    torque = (fit.channels / size).reshape(-1)
    fitted = solve(columns.T @ columns, columns.T @ torque[:, None])[:, 0]
    left = torque - columns @ fitted
    return np.sum(left.reshape(log.n, -1) ** 2, axis=1)


def _norm(torques: Array) -> float:
    """Return the Euclidean norm of torques of any shape, above 0, so that it may
    divide."""
    return float(at_least_tiny(np.linalg.norm(torques)))


def _resembles(torques: Array, nominal: Array) -> float:
    """Return the largest squared correlation, over the joints, of the torques (N, n)
    with those of a nominal arm (N, n)."""
    x = torques - torques.mean(axis=0)
    y = nominal - nominal.mean(axis=0)
    common = np.sum(x * y, axis=0) ** 2
    sizes = np.sum(x**2, axis=0) * np.sum(y**2, axis=0)
    return float(np.max(common / nonzero_or_one(sizes)))
