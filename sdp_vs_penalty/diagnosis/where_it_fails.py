"""Where a model fails: on which quantities its residual torque depends, when it is
large, and which waves it has.

No physical effect is named here (`diagnose` does that); the error is shown joint by
joint, beside the noise. Causes are what a person sees in a log: a reversal, a
standstill, high speed, a position, a wave per turn, time, another joint; and the
model's torque, its rate and its curvature, which a wrong gain, a late channel and a
gear that yields follow. Shares are on data left out: a smooth function of the quantity
is fitted to some stretches of the motion and judged on others, so that chance explains
nothing. They are shares of what other parameters of the model would leave, fitted to
all joints at once: the rest resembles the model, whatever its cause. The worst joint is
the one whose error is the most times its noise.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from sdp_vs_penalty import formatting
from sdp_vs_penalty.arguments import checked_arguments
from sdp_vs_penalty.data.files import Source, as_measurements
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.diagnosis.causes import (
    CAUSE_COLUMNS,
    FAST,
    HIGH_SPEED,
    MODELLED_TORQUE,
    OTHER_JOINTS,
    REVERSAL,
    STANDSTILL,
    TORQUE_CURVATURE,
    TORQUE_RATE,
    CauseShares,
    JointError,
    Refit,
    SplitError,
    States,
    columns_of_causes,
    other_joint_quantity,
)
from sdp_vs_penalty.diagnosis.constants import FOLDS, SPECTRUM_NOISE_FACTOR
from sdp_vs_penalty.diagnosis.white_rows import diagnosis_rows, folds_of, model_columns
from sdp_vs_penalty.effects.effect import smooth_sign
from sdp_vs_penalty.estimation.constants import CHANGES
from sdp_vs_penalty.estimation.drive_torque import driven
from sdp_vs_penalty.estimation.estimate import Estimate, as_estimate
from sdp_vs_penalty.estimation.verdict import noise_level
from sdp_vs_penalty.formatting import plain_unit, words
from sdp_vs_penalty.records import JsonRecord
from sdp_vs_penalty.results.facts import fact
from sdp_vs_penalty.results.record import Record, Summary
from sdp_vs_penalty.robot.arrays import Array, Indices, Mask
from sdp_vs_penalty.signals.filtered import FilteredRuns
from sdp_vs_penalty.signals.noise import REPETITION
from sdp_vs_penalty.signals.preprocessing import Preprocessing
from sdp_vs_penalty.signals.reversals import since_reversal
from sdp_vs_penalty.signals.segments import SegmentedRuns, window_subsample
from sdp_vs_penalty.signals.standstill import STILL

if TYPE_CHECKING:
    import pandas

#: The rows of a heat map, in this order.
CAUSES = tuple(CAUSE_COLUMNS)
#: What a stretch is called whose cause none of these explains.
UNNAMED = "no cause seen"
#: Seconds around a velocity reversal that count as near it.
NEAR = 0.15
#: An error that is so many times as large near reversals as elsewhere is said to be,
#: whatever its causes: friction that turns round is the likeliest one.
_LARGE_LIFT = 2.0
#: The same where reversals are a cause or a stretch that is shown.
_SEEN_LIFT = 1.2
#: Share of an error from which it is said that other parameters would remove it.
_LARGE_REFIT_SHARE = 0.5
#: Factor within which the noise floors compare the noise of two joints.
_NOISE_KNOWN = 1.2
#: Causes that are seen at some instants only; all others act all the time.
_AT_INSTANTS = (STANDSTILL, HIGH_SPEED)


#: What no residual shows, because parameters of the model make it.
TAKEN_IN = (
    "Friction that differs by direction, and a load that the file does not know: the"
    " model's offsets and masses take them in. `diagnose` says how large they are."
)

#: What the shares of causes are shares of, for the heading of every table and picture.
SHARES = (
    "How much of a joint's error each cause explains on data left out, beyond a refit (of"
    " all of it where nothing stands out there). Causes overlap: do not add their shares."
)

#: What makes an error that follows a torque of the model, by the name of its cause.
MEANINGS = {
    MODELLED_TORQUE: "A wrong gain of the torque channel makes such an error.",
    TORQUE_RATE: (
        "A torque channel that is late makes such an error, and near reversals so does"
        " friction that turns round over some travel."
    ),
    TORQUE_CURVATURE: "A gear that yields, or has play, makes such an error.",
}


@dataclass(frozen=True)
class TurnWave:
    """A wave of a joint's error over the joint's turns."""

    #: Waves per revolution.
    per_revolution: int
    #: Amplitude [N m].
    amplitude: float
    #: Amplitude over the median of its neighbours in the spectrum.
    over_surroundings: float


@dataclass(frozen=True)
class FailingStretch:
    """A stretch of a run in which an error is large."""

    #: Name of the run.
    run: str
    #: Begin [s].
    start: float
    #: End [s].
    stop: float
    #: Name of the likeliest cause.
    cause: str


@dataclass(frozen=True)
class JointFailure(JsonRecord):
    """How the residual of one joint behaves."""

    #: Number of the joint, from 1.
    joint: int
    #: RMS of the residual [N m or N].
    rmse: float
    #: Noise floor [N m or N], None if it is not known.
    noise_floor: float | None
    #: Share of the residual's variance that repeats, 1 - floor^2 / rmse^2; None if the
    #: noise floor is not known.
    explainable_share: float | None
    #: By cause, the share of what a refit would leave that a function of the cause
    #: explains on data left out; causes are ranked by it.
    held_out_shares: dict[str, float]
    #: RMS within 0.15 s of velocity reversals over that elsewhere.
    #: NaN where there is no row of either kind.
    reversal_lift: float = np.nan
    #: Waves over the joint's turns, the most conspicuous first.
    orders: tuple[TurnWave, ...] = ()
    #: Stretches where the error is large, with the cause seen there.
    stretches: tuple[FailingStretch, ...] = ()
    #: By cause, the share of the whole residual that a function of the cause explains
    #: on data left out.
    shares_of_error: dict[str, float] = field(default_factory=dict)
    #: Share of the residual's variance that other parameters of the model would remove.
    refit_share: float = 0.0
    #: RMS of the measured torque [N m or N], None in older files.
    torque: float | None = None
    #: What of another joint explains most, such as "velocity of joint 2".
    other_joint: str = ""

    @property
    def goes_with_a_refit(self) -> bool:
        """Whether other values of the model's own parameters would remove half of the
        error or more."""
        return self.refit_share >= _LARGE_REFIT_SHARE

    @property
    def causes(self) -> CauseShares:
        """The shares of the error that each cause explains, on the whole error and
        beyond a refit.

        Files of older versions have the latter only, which then stands for both.
        """
        of_error = self.shares_of_error or self.held_out_shares
        return CauseShares(
            of_error=of_error,
            beyond_refit=self.held_out_shares,
            refit_share=self.refit_share,
            other_joint=self.other_joint,
        )

    @property
    def shares(self) -> Mapping[str, float]:
        """By cause the share of the error that it explains (:data:`SHARES`), the one
        that words, tables and pictures show."""
        return self.causes.likelihood

    def numbers(self) -> dict[str, float | None]:
        """Return all numbers of the joint by their labels, such as "error [N m or N]".

        Shares are in per cent of the error's variance; those of causes are ``shares``.
        None stands for an unknown number.
        """
        shares = {
            "all that repeats": self.explainable_share,
            "a refit would take": self.refit_share,
            **self.shares,
        }
        numbers = {
            "error [N m or N]": self.rmse,
            "noise floor [N m or N]": self.noise_floor,
            "near reversals over elsewhere": self.reversal_lift,
        }
        return numbers | {
            f"{name} [%]": None if share is None else 100.0 * share
            for name, share in shares.items()
        }


def dependences(failure: JointFailure, most_named: int = 3) -> list[tuple[str, float]]:
    """List the likeliest causes of an error, with the share that each explains.

    Shares are those of :attr:`JointFailure.shares`. Causes that explain less than
    CHANGES (5 %) of the error, or of the part that the shares are of, are left out.

    Parameters
    ----------
    failure
        The error of one joint.
    most_named
        Largest number of causes to return.

    Returns
    -------
    list of (str, float)
        Cause and share, the likeliest first, such as ("velocity", 0.4).
    """
    causes = failure.causes
    return [
        (name, failure.shares[name])
        for name in causes.ranking[:most_named]
        if min(causes.of_error[name], failure.shares[name]) >= CHANGES
    ]


def sentences(failure: JointFailure, unit: str) -> list[str]:
    """Describe in sentences on what one joint's error depends.

    Parameters
    ----------
    failure
        The error of the joint.

    Returns
    -------
    list of str
        On the likeliest causes, what other parameters would remove, velocity reversals,
        and waves per revolution.
    """
    strongest = dependences(failure)
    out = [*_cause_sentences(failure, strongest), *_refit_sentences(failure)]
    is_named = REVERSAL in dict(strongest)
    is_seen = any(stretch.cause == REVERSAL for stretch in failure.stretches)
    least_lift = _SEEN_LIFT if is_named or is_seen else _LARGE_LIFT
    if failure.reversal_lift > least_lift:
        out.append(
            f"Within {NEAR:g} s of the joint's reversals it is"
            f" {failure.reversal_lift:.2g} times as large as elsewhere."
        )
    if strongest and failure.causes.stands_out:
        likeliest = strongest[0][0]
        out += [MEANINGS[likeliest]] if likeliest in MEANINGS else []
    return [*out, *_wave_sentences(failure, plain_unit(unit))]


def _refit_sentences(failure: JointFailure) -> list[str]:
    """Say which share of an error other values of the model's own parameters would
    remove, where it is half or more.
    """
    if not failure.goes_with_a_refit:
        return []
    return [
        f"Other values of the model's parameters would remove"
        f" {100.0 * failure.refit_share:.0f} % of the error: `diagnose` says whether it"
        " is they, or an effect that is missing."
    ]


def _cause_sentences(
    failure: JointFailure, strongest: Sequence[tuple[str, float]]
) -> list[str]:
    """Say on what an error depends most, and which causes the data do not tell apart.

    Parameters
    ----------
    failure
        The error of the joint.
    strongest
        Its likeliest causes with their shares.
    """
    if not strongest:
        return [
            f"No function of one cause explains {100.0 * CHANGES:.0f} % of the error on"
            " data left out."
        ]
    named = []
    for name, share in strongest:
        percent = f"{100.0 * share:.0f} %"
        has_detail = name == OTHER_JOINTS and failure.other_joint
        detail = f", most on the {failure.other_joint}" if has_detail else ""
        named.append(f"{name} ({percent}{detail})")
    out = [f"The error depends most on {words(named)}."]
    equivalent = failure.causes.equivalent_causes
    if len(equivalent) > 1 and set(equivalent) & set(dict(strongest)):
        out.append(f"These data do not tell {words(equivalent)} apart.")
    return out


def _wave_sentences(failure: JointFailure, unit: str) -> list[str]:
    """Say which waves per turn a joint's error has."""
    if not failure.orders:
        return []
    waves = ", ".join(
        f"{wave.per_revolution} ({wave.amplitude:.2g} {unit},"
        f" {wave.over_surroundings:.0f}x)"
        for wave in failure.orders
    )
    return [f"Waves per revolution (amplitude, that over its surroundings): {waves}."]


@dataclass(frozen=True, repr=False)
class Failures(Record, JsonRecord):
    """Where a model fails, joint by joint; it is a sequence of these."""

    #: How each joint's residual behaves, in the order of the joints.
    joints: tuple[JointFailure, ...]
    #: Unit of each joint's torque.
    units: tuple[str, ...]

    def __len__(self) -> int:
        """Return the number of joints."""
        return len(self.joints)

    def __iter__(self) -> Iterator[JointFailure]:
        """Iterate over the joints."""
        return iter(self.joints)

    def __getitem__(self, index: int) -> JointFailure:
        """Return the failure of a joint, from 0."""
        return self.joints[index]

    @fact("times", name="error near reversals over elsewhere")
    def reversal_lift(self) -> Array:
        """(n,) RMS error within 0.15 s of a joint's reversals over that elsewhere."""
        return np.array([f.reversal_lift for f in self])

    @fact("")
    def strongest_cause(self) -> str:
        """Of the worst joint: the cause that explains most of its error on data left
        out."""
        worst = self.worst_first[0]
        strongest = dependences(worst, 1)
        return strongest[0][0] if strongest else UNNAMED

    @property
    def badness(self) -> Array:
        """(n,) error of each joint as a multiple of its noise.

        Errors are RMS, over the noise floors, and over the RMS torques where a floor is
        unknown.
        """
        units = [f.torque for f in self]
        if all(f.noise_floor for f in self):
            units = [f.noise_floor for f in self]
        return np.array([f.rmse for f in self]) / [unit or 1.0 for unit in units]

    @property
    def worst_first(self) -> list[JointFailure]:
        """The joints sorted by their ``badness``, the largest first.

        Of the worst joints that are about as bad, those come first whose error has a
        cause that stands out.
        """
        order = np.argsort(self.badness)[::-1].tolist()
        equally_bad = self.equally_bad
        tied = [k for k in order if k + 1 in equally_bad]
        tied.sort(key=lambda k: not self[k].causes.stands_out)
        others = [k for k in order if k not in tied]
        return [self[k] for k in [*tied, *others]]

    @property
    def equally_bad(self) -> list[int]:
        """The worst joints (from 1) that differ by less than their noise is known."""
        badness = self.badness
        return (np.flatnonzero(badness * _NOISE_KNOWN >= badness.max()) + 1).tolist()

    def to_frame(self) -> pandas.DataFrame:
        """Return the numbers of each joint (from 1), a row each, as
        :meth:`JointFailure.numbers` names them."""
        import pandas

        rows = {failure.joint: failure.numbers() for failure in self}
        frame = pandas.DataFrame.from_dict(rows, orient="index", dtype=float)
        return frame.rename_axis("joint")

    def _summary(self) -> Summary:
        """Return the printed summary: a headline, for each joint its label and
        sentences, and what cannot be seen.
        """
        rows = [
            (f"joint {f.joint}", " ".join(sentences(f, self.units[f.joint - 1])))
            for f in self.worst_first
        ]
        rows.append(("not shown", TAKEN_IN))
        title = "Where the model fails, the worst joints first"
        if len(self.equally_bad) > 1:
            title += f" ({formatting.joints(self.equally_bad)} are about as bad)"
        return title, rows


@checked_arguments
def where_it_fails(
    estimate: Estimate | str | Path,
    measurements: Source,
    preprocessing: Preprocessing | None = None,
    *,
    noise: tuple[Array | None, str] | None = None,
) -> Failures:
    """Find what each joint's residual depends on, and when it is large.

    Of a long recording windows are judged (:mod:`~sdp_vs_penalty.signals.segments`).

    Parameters
    ----------
    estimate : Estimate, str or Path
        The model, or its model.json.
    measurements : path, arrays, DataFrame, Measurements, list of these
        The runs to judge on.
    preprocessing : Preprocessing, optional
        Filter settings; default: the model's.
    noise : tuple of (n,) array or None, and str, optional
        Noise floor of each joint [N m or N], and its source, as a comparison with these
        measurements has them. Default: it is measured.

    Returns
    -------
    Failures
        One JointFailure a joint.

    Raises
    ------
    InputError
        Where the measurements are not of this robot.
    """
    estimate = as_estimate(estimate, "where_it_fails(estimate=...)")
    measurements = as_measurements(
        measurements,
        names=estimate.problem.channel_names,
        what="where_it_fails(measurements=...)",
    )
    estimate.require_joints(measurements)
    estimate, measurements = driven(estimate, measurements)
    settings = (preprocessing or estimate.preprocessing).resolve(measurements)
    searched = window_subsample(measurements, settings)
    rows = diagnosis_rows(searched, estimate, settings)
    residual = rows.residual
    folds = folds_of(rows, FOLDS)
    floors, source = noise or noise_level(
        estimate.problem, FilteredRuns.filtering(measurements, settings)
    )
    judge = _Judge(
        estimate=estimate,
        rows=rows,
        searched=searched,
        states=States.from_rows(rows),
        folds=folds,
        keep=np.asarray(rows.keep.all(axis=1), bool),
        repeats=source == REPETITION,
    )
    joints = []
    for j in range(rows.n):
        floor = None if floors is None else float(floors[j])
        joints.append(judge.failure_of(j, residual[:, j], floor))
    return Failures(tuple(joints), estimate.torque_units)


@dataclass(frozen=True)
class _Judge:
    """All that decides how a joint fails."""

    #: The model.
    estimate: Estimate
    #: The filtered rows.
    rows: SegmentedRuns
    #: The recordings.
    searched: Measurements
    #: Motion and torque of every row.
    states: States
    #: (M,) folds of the rows, by phase of the motion.
    folds: Indices
    #: (M,) flags of the rows that count.
    keep: Mask
    #: Whether repetition shows the noise.
    repeats: bool

    def failure_of(self, j: int, residual: Array, floor: float | None) -> JointFailure:
        """Judge the error of one joint: its size, causes, waves per turn and bad
        stretches.

        ``j`` counts from 0.

        Parameters
        ----------
        residual
            (M,) measured minus modelled torque [N m or N].
        floor
            Noise floor of the joint [N m or N]; None if it is not known.

        Returns
        -------
        JointFailure
            The joint counts from 1 there.
        """
        keep = self.keep
        error = residual - residual[keep].mean()
        rmse = float(np.sqrt(np.mean(residual[keep] ** 2)))
        explainable = None
        if floor is not None and self.repeats and rmse > 0.0:
            explainable = max(0.0, 1.0 - (floor / rmse) ** 2)
        series = _full_rate(self.runs, self.rows, j)
        orders = self.orders(j, series)
        waves_per_turn = [wave.per_revolution for wave in orders]
        shares = self.shares(JointError(j, error, waves_per_turn))
        velocity = self.states.dq[:, j]
        still = self.rows.still[:, j]
        return JointFailure(
            joint=j + 1,
            rmse=rmse,
            noise_floor=floor,
            explainable_share=explainable,
            held_out_shares=dict(shares.beyond_refit),
            shares_of_error=dict(shares.of_error),
            refit_share=shares.refit_share,
            other_joint=shares.other_joint,
            reversal_lift=_reversal_lift(velocity, error, self.rows, keep),
            orders=orders,
            torque=float(np.sqrt(np.mean(self.states.torque[keep, j] ** 2))),
            stretches=failing_stretches(
                error, floor, velocity, still, self.rows, shares
            ),
        )

    def orders(self, j: int, series: Sequence[_FullRate]) -> tuple[TurnWave, ...]:
        """Find the waves per turn in the residual of joint j (from 0).

        Parameters
        ----------
        series
            Its angle, velocity and residual at the rate of the log, for each segment.

        Returns
        -------
        tuple of TurnWave
            Empty for a prismatic joint.
        """
        if self.estimate.robot.joints[j].kind != "revolute":
            return ()
        return _orders(series)

    def shares(self, error: JointError) -> CauseShares:
        """Compute the share of a joint's error that each cause explains on data left
        out.

        The columns of a cause are functions of what it depends on. They are fitted to
        some folds of the rows, and judged on the others.
        """
        keep = self.keep
        errors = SplitError(
            error=error.error[keep] / self.refit.scale[error.joint],
            refit=self.refit,
            joint=error.joint,
            fold=self.folds[keep],
        )
        of_error = dict[str, float]()
        beyond_refit = dict[str, float]()
        other_joint = ""
        for name, alternatives in columns_of_causes(self.states, error).items():
            explained = errors.explained_shares([x[keep] for x in alternatives])
            of_error[name] = explained.of_error
            beyond_refit[name] = explained.beyond_refit
            if name == OTHER_JOINTS and explained.beyond_refit > 0.0:
                other_joint = other_joint_quantity(
                    self.states, error.joint, explained.best_alternative
                )
        return CauseShares(
            of_error=of_error,
            beyond_refit=beyond_refit,
            refit_share=errors.refit_share,
            other_joint=other_joint,
        )

    @cached_property
    def runs(self) -> Sequence[Measurements]:
        """The recordings, one by one."""
        return self.searched.runs()

    @cached_property
    def refit(self) -> Refit:
        """The model's parameters, fitted to what the model leaves of all joints'
        torques.
        """
        error = self.rows.residual[self.keep]
        return Refit.from_columns(
            columns=model_columns(self.rows, self.estimate)[:, self.keep],
            error=(error - error.mean(axis=0)).T,
        )


def _reversal_lift(
    velocity: Array, error: Array, rows: SegmentedRuns, keep: Mask
) -> float:
    """Return how many times as large the RMS error is near velocity reversals as
    elsewhere.

    Near is within NEAR (0.15 s). NaN if no row is near one, or if there is no error
    elsewhere.

    Parameters
    ----------
    velocity, error
        (M,) velocity and torque error of the joint.
    rows
        The rows with their times.
    keep
        (M,) flags the rows that count.
    """
    seconds, _ = since_reversal(rows.t, velocity, rows.segment)
    is_near = np.abs(seconds) <= NEAR
    error_near = error[keep & is_near]
    error_elsewhere = error[keep & ~is_near]
    if not len(error_near) or not np.any(error_elsewhere):
        return float("nan")
    ratio = np.mean(error_near**2) / np.mean(error_elsewhere**2)
    return float(np.sqrt(ratio))


class _FullRate(NamedTuple):
    """One joint in one segment at the rate of the log, before the filters."""

    #: (N,) position [rad or m].
    angle: Array
    #: (N,) velocity [rad/s or m/s].
    velocity: Array
    #: (N,) measured minus modelled torque [N m or N].
    residual: Array


def _full_rate(
    runs: Sequence[Measurements], rows: SegmentedRuns, joint: int
) -> list[_FullRate]:
    """Return a joint's angle, velocity and residual at the rate of the log, for each
    segment.

    Velocity and modelled torque are interpolated linearly from the filtered motion.

    ``joint`` counts from 0.

    Parameters
    ----------
    rows
        The filtered rows of these recordings, with the torque of a model.
    """
    out = []
    for segment in rows.segments:
        run = runs[segment.run]
        motion = segment.motion
        is_inside = (run.t >= motion.t[0]) & (run.t <= motion.t[-1])
        t = run.t[is_inside]
        modelled = np.interp(t, motion.t, motion.modelled[:, joint])
        velocity = np.interp(t, motion.t, motion.dq[:, joint])
        angle = run.q[is_inside, joint]
        residual = run.tau[is_inside, joint] - modelled
        out.append(_FullRate(angle, velocity, residual))
    return out


#: Times the median of its neighbours from which an order is a wave. Of white noise one
#: of 2^16 orders has four times, and one of 2^36 has six; real errors have heavier tails.
_WAVE = 6.0
#: Orders of whose amplitudes the median is taken, the order itself in the middle.
_NEIGHBOURS = 31
#: Waves that are looked for in a joint's residual.
_MOST_WAVES = 5


def _orders(full: Sequence[_FullRate], bins: int = 4096) -> tuple[TurnWave, ...]:
    """Find waves per turn in residuals, by their amplitude over that of neighbouring
    orders.

    One wave after another is taken: the order that stands out most. All waves so far,
    beside what other errors make (an offset of each segment, gravity and friction), are
    fitted to the residuals by least squares, and the next order is looked for in what
    they leave. So neither speed nor the log's rate changes an amplitude. A wave is at
    least _WAVE times the median of its 31 neighbours in what is left.

    Parameters
    ----------
    full
        The joint's angle and residual at the rate of the log, for each segment.
    bins
        Bins of one revolution; orders up to an eighth of it are looked at.

    Returns
    -------
    tuple of TurnWave
        Up to five, the largest amplitude first.
    """
    turn = 2.0 * np.pi
    angle = np.concatenate([series.angle for series in full])
    torque = np.concatenate([series.residual for series in full])
    velocity = np.concatenate([series.velocity for series in full])
    segment = np.repeat(np.arange(len(full)), [len(series.angle) for series in full])
    # Rounding may put an angle at a full turn, hence the last modulo.
    bin_of_row = np.floor((angle % turn) / turn * bins).astype(np.intp) % bins
    count = np.fft.fft(np.bincount(bin_of_row, minlength=bins))
    offsets = (segment[:, None] == np.arange(len(full))).astype(float)
    smooth = [np.cos(angle), np.sin(angle), velocity, smooth_sign(velocity)]
    columns = np.column_stack([offsets, *smooth])
    n_smooth = columns.shape[1]
    # Fewer than two periods within the joint's range are no wave, but any bend.
    lowest = max(2, int(np.ceil(2.0 * turn / max(float(np.ptp(angle)), 1e-6))))

    def fitted(waves_and_others: Array) -> tuple[Array, Array]:
        """Return the sizes (k,) of columns (N, k), and the amplitudes of orders in the
        residual of their fit."""
        sizes = np.linalg.lstsq(waves_and_others, torque, rcond=1e-10)[0]
        residual = torque - waves_and_others @ sizes
        pull = np.fft.fft(np.bincount(bin_of_row, residual, bins))
        return sizes, _amplitudes(pull, count, bins // 8)

    waves = dict[int, float]()  # order, amplitude over its surroundings
    sizes, amplitude = fitted(columns)
    while len(waves) < _MOST_WAVES:
        is_maximum = amplitude == scipy.ndimage.maximum_filter(amplitude, 3)
        is_maximum[:lowest] = False
        order = int(np.argmax(np.where(is_maximum, amplitude, 0.0)))
        if not is_maximum[order] or order in waves:
            break
        wave = [np.cos(order * angle), np.sin(order * angle)]
        with_wave = np.column_stack([columns, *wave])
        sizes_with, amplitude_with = fitted(with_wave)
        median = scipy.ndimage.median_filter(amplitude_with, _NEIGHBOURS)[order]
        over = np.hypot(*sizes_with[-2:]) / max(median, 1e-300)  # of cosine and sine
        if over <= _WAVE:
            break
        waves[order] = float(over)
        columns, sizes, amplitude = with_wave, sizes_with, amplitude_with
    # Of each wave the sizes of its cosine and sine, behind those of all else.
    of_waves = sizes[n_smooth:].reshape(-1, 2)
    found = [
        TurnWave(order, float(np.hypot(*size)), over)
        for (order, over), size in zip(waves.items(), of_waves, strict=True)
    ]
    return tuple(sorted(found, key=lambda wave: -wave.amplitude))


def _amplitudes(
    pull: NDArray[np.complex128], count: NDArray[np.complex128], highest: int
) -> Array:
    """Return the amplitude of each order k = 0 ... K, fitted by least squares alone.

    pull (bins,) : sums of r exp(-i k q) over the rows; count (bins,) : sums of
    exp(-i k q), which are those of cos and sin that the normal equations need: of
    cos^2 k q = (1 + cos 2 k q) / 2 and so on. Zero where the rows do not show an order.
    """
    k = np.arange(highest + 1)
    double = count[2 * k]
    n_rows = float(count[0].real)
    cc = 0.5 * (n_rows + double.real)
    ss = 0.5 * (n_rows - double.real)
    cs = -0.5 * double.imag
    normal = np.stack([cc, cs, cs, ss], axis=1).reshape(-1, 2, 2)
    right = np.stack([pull[k].real, -pull[k].imag], axis=1)
    is_seen = np.linalg.det(normal) > 1e-6 * n_rows**2
    normal[~is_seen] = np.eye(2)
    sizes = np.linalg.solve(normal, right[:, :, None])[:, :, 0]
    return np.where(is_seen, np.hypot(sizes[:, 0], sizes[:, 1]), 0.0)


def failing_stretches(
    error: Array,
    floor: float | None,
    velocity: Array,
    still: Array,
    rows: SegmentedRuns,
    shares: CauseShares,
) -> tuple[FailingStretch, ...]:
    """List the stretches in which a joint's error is large, with the cause seen there.

    Large: its RMS over 2 NEAR (0.3 s) is more than SPECTRUM_NOISE_FACTOR times the
    noise floor, or times the error's own RMS without a floor, and among the largest
    tenth. Stretches shorter than NEAR are left out. ``velocity`` (M,) is the joint's.

    Parameters
    ----------
    error
        (M,) error of the joint [N m or N].
    floor
        Its noise floor [N m or N], or None.
    still
        (M,) share of standstill in each filtered row.
    rows
        The rows, with their times, runs and segments.
    shares
        What each cause explains of the error.
    """
    width = max(1, round(2.0 * NEAR * rows.rate))
    window = np.ones(width) / width
    rms_nearby = np.sqrt(np.convolve(error**2, window, mode="same"))
    usual = floor or float(np.sqrt(np.mean(error**2)))
    names = _causes_of_rows(velocity, still, rows, shares)
    largest_tenth = float(np.quantile(rms_nearby, 0.9))
    names[rms_nearby <= max(SPECTRUM_NOISE_FACTOR * usual, largest_tenth)] = ""
    # A stretch ends where the name or the segment changes.
    has_new_name = names[1:] != names[:-1]
    is_new_segment = rows.segment[1:] != rows.segment[:-1]
    changes = np.flatnonzero(has_new_name | is_new_segment) + 1
    out = []
    for first, end in pairwise([0, *changes.tolist(), len(names)]):
        t_start = float(rows.t[first])
        t_stop = float(rows.t[end - 1])
        if names[first] and t_stop - t_start >= NEAR:
            run = rows.names[rows.run[first]]
            cause = str(names[first])
            out.append(FailingStretch(run, t_start, t_stop, cause))
    return tuple(out)


def _causes_of_rows(
    velocity: Array, still: Array, rows: SegmentedRuns, shares: CauseShares
) -> NDArray[np.object_]:
    """Name for each of M rows the cause that is seen there.

    It is the joint's likeliest cause, if that explains CHANGES (5 %) of the error, else
    UNNAMED. Rows at standstill have that name, and so have rows of high speed if it
    explains more. Without a likely cause, rows near a velocity reversal are named after it.

    Parameters
    ----------
    velocity
        (M,) velocity of the joint.
    still
        (M,) share of standstill in each filtered row.
    rows
        The rows with their times.
    shares
        The share of the error that each cause explains.
    """
    best = next(name for name in shares.ranking if name not in _AT_INSTANTS)
    share_of_best = shares.likelihood[best]
    is_known = min(shares.of_error[best], share_of_best) >= CHANGES
    usual_name = best if is_known else UNNAMED
    names = np.array([usual_name], dtype=object).repeat(len(velocity))
    speed = np.abs(velocity)
    rows_of_cause = {HIGH_SPEED: speed > FAST * speed.max(), STANDSTILL: still > STILL}
    if not is_known:
        seconds, _ = since_reversal(rows.t, velocity, rows.segment)
        rows_of_cause[REVERSAL] = np.abs(seconds) <= NEAR
    # Later causes overwrite earlier ones where both are seen.
    for name, its_rows in rows_of_cause.items():
        explains_more = shares.likelihood.get(name, 0.0) > share_of_best
        if name == STANDSTILL or not is_known or explains_more:
            names[its_rows] = name
    return names
