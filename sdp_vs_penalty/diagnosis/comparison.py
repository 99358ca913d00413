"""Compares measured with modelled torque: the error of each joint, beside its noise."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from html import escape
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from sdp_vs_penalty import formatting
from sdp_vs_penalty.arguments import checked_arguments
from sdp_vs_penalty.colours import AFTER, model_colour
from sdp_vs_penalty.data.files import Source, as_measurements
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.data.plausibility import check_plausible
from sdp_vs_penalty.data.store import AppendableArray, iter_chunks
from sdp_vs_penalty.errors import InputError, other_robot
from sdp_vs_penalty.estimation.drive_torque import driven, plant
from sdp_vs_penalty.estimation.estimate import Estimate, Models, as_estimates
from sdp_vs_penalty.estimation.nominal import NOMINAL, as_model
from sdp_vs_penalty.estimation.verdict import (
    ABOVE_NOISE,
    MOSTLY_NEW,
    ErrorsBesideNoise,
    NoiseFloor,
    Verdict,
    doubt_of_log,
    grades_in_words,
    implausible,
    judge,
    noise_level,
)
from sdp_vs_penalty.formatting import number, plain_unit
from sdp_vs_penalty.records import NOT_STORED, stored_as
from sdp_vs_penalty.regression.evidence import (
    jackknifed,
    relative_error,
    relative_errors_without,
    student_95,
)
from sdp_vs_penalty.results.facts import fact
from sdp_vs_penalty.results.record import Record, Summary, cut_to_width
from sdp_vs_penalty.robot.arrays import Array, nonzero_or_one
from sdp_vs_penalty.signals.filtered import FilteredRuns, Rows
from sdp_vs_penalty.signals.noise import REPETITION
from sdp_vs_penalty.signals.preprocessing import Preprocessing
from sdp_vs_penalty.signals.segments import subsample_sentence, window_subsample
from sdp_vs_penalty.signals.standstill import slides_throughout
from sdp_vs_penalty.threads import on_one_thread

if TYPE_CHECKING:
    import pandas


@dataclass(frozen=True)
class Signals:
    """The filtered signals that are compared."""

    #: (M,) time [s].
    t: Array
    #: (M, n) position [rad or m].
    q: Array
    #: (M, n) velocity [rad/s or m/s].
    dq: Array
    #: (M, n) measured torque [N m or N].
    measured: Array
    #: (M, n) torque of the model [N m or N].
    modelled: Array

    @property
    def seconds(self) -> float | None:
        """Duration of the motion of all rows [s]; None for a single row."""
        if len(self.t) < 2:
            return None
        return float(len(self.t) * np.median(np.diff(self.t)))

    @property
    def residual(self) -> Array:
        """(M, n) measured minus modelled torque [N m or N]."""
        return self.measured - self.modelled

    def to_frame(self) -> pandas.DataFrame:
        """Return the signals as a pandas.DataFrame, a row an instant (index t [s]).

        Columns q1, dq1, measured1, modelled1, residual1, q2, ... The low-pass leaves
        fewer rows than were logged.
        """
        import pandas

        of_joints = {
            "q": self.q,
            "dq": self.dq,
            "measured": self.measured,
            "modelled": self.modelled,
            "residual": self.residual,
        }
        columns = {
            f"{name}{joint + 1}": values[:, joint]
            for joint in range(self.q.shape[1])
            for name, values in of_joints.items()
        }
        return pandas.DataFrame(columns, index=pandas.Index(self.t, name="t"))


@dataclass(frozen=True, repr=False)
class Comparison(Record):
    """Errors of one model on measurements, all joints behind the same low-pass."""

    derived = ("verdict", "relative_error_percent", "facts")

    #: Name of the model in the comparison.
    name: str = field(metadata=stored_as("model"))
    #: The model.
    estimate: Estimate = field(compare=False, metadata=NOT_STORED)
    #: (n,) RMS error of each joint's torque [N m or N].
    rmse: Array
    #: (n,) mean squared error of each joint's torque [(N m)^2 or N^2].
    mse: Array
    #: (n,) 1 - mse / variance of the measured torque.
    r2: Array
    #: (n,) root mean square of the measured torque [N m or N].
    torque_rms: Array
    #: (n,) noise floor of the measurements [N m or N], None where it is not known.
    noise_floor: Array | None
    #: Where the noise floor comes from, such as "repetition".
    noise_source: str
    #: Cut-off frequency of the low-pass [Hz].
    band_hz: float
    #: The filtered rows that were compared.
    signals: Signals = field(compare=False, metadata=NOT_STORED)
    #: Names of the measurements.
    runs: tuple[str, ...] = ()
    #: Share of the rows whose motion the model was not trained on (see
    #: :mod:`~sdp_vs_penalty.signals.motion`), None where its model.json does not record
    #: that.
    new_motion_share: float | None = None
    #: Share of the rows outside of a measured curve's table, where the curve is held
    #: constant, by effect.
    outside: Mapping[str, float] = field(default_factory=dict)
    #: A sentence where the recording is so long that the noise was measured in windows
    #: of it, else None.
    judged_on: str | None = None
    #: How long the arm stands still [s]; these rows are left out.
    still: float = field(default=0.0, metadata=stored_as("standstill_left_out"))

    @property
    def errors(self) -> ErrorsBesideNoise:
        """The errors beside noise and torque, joint by joint."""
        return ErrorsBesideNoise(
            rmse=self.rmse,
            floor=self.noise_floor,
            torque=self.torque_rms,
            units=self.estimate.torque_units,
            kind=self.kind_of_error,
        )

    @property
    def errors_sliding(self) -> ErrorsBesideNoise:
        """The errors in the rows in which each joint slides, beside noise and torque.

        A joint that stands or turns round is held by any torque up to its dry friction,
        which tells nothing of a model. NaN for a joint that never slides.
        """
        step = float(np.median(np.diff(self.signals.t)))
        margin = math.ceil(0.5 / (self.band_hz * step))
        slides = slides_throughout(self.signals.dq, margin)
        squares = np.sum(self.signals.residual**2, axis=0, where=slides)
        with np.errstate(invalid="ignore"):
            rmse = np.sqrt(squares / slides.sum(axis=0))
        return replace(self.errors, rmse=rmse)

    @fact("N m or N", name="error", column="error", per_joint=True)
    def joint_error(self) -> Array:
        """(n,) root mean square of measured minus modelled torque, joint by joint, behind
        the low-pass."""
        return self.rmse

    @fact("N m or N", name="noise floor", column="noise floor", per_joint=True)
    def joint_noise(self) -> Array | None:
        """(n,) standard deviation of the torque's noise behind the same low-pass."""
        return self.noise_floor

    @fact("times the noise", name="error", column="error / noise", per_joint=True)
    def error_over_noise(self) -> Array | None:
        """(n,) error of each joint over its noise floor; unknown without a floor."""
        return self.errors.over_noise

    @fact(digits=4, name="R2", column="R2", per_joint=True)
    def explained_share(self) -> Array:
        """(n,) share of the variance of each joint's torque that the model explains, 1 -
        mse / variance; unknown for a constant torque."""
        return self.r2

    @fact("% of the joint's torque", name="error beyond the noise", per_joint=True)
    def error_beyond_noise(self) -> Array:
        """(n,) root of each joint's mean squared error less that of its noise, over the
        root mean square of its torque; without a noise floor the whole error."""
        return self.errors.beyond_noise

    @fact("N m or N", name="error that 1 % of the time exceeds", per_joint=True)
    def rare_error(self) -> Array | None:
        """(n,) the 99 % quantile of the size of measured minus modelled torque, behind the
        low-pass: thresholds of a collision's detection lie above it. Unknown without the
        signals."""
        residual = self.signals.residual
        return np.quantile(np.abs(residual), 0.99, axis=0) if len(residual) else None

    @fact("times the noise")
    def largest_error_over_noise(self) -> float | None:
        """The largest of the joints' errors over noise."""
        over = self.error_over_noise
        return None if over is None else float(over.max())

    @fact("", digits=9)
    def worst_joint(self) -> int:
        """The joint (from 1) whose error is the most times its noise; without a noise
        floor the one that errs by the largest share of its torque. Of a model that is not
        to be used the joint for which it is not."""
        return self.errors.worst_joint

    @fact("%", column="arm's error [% of torque]")
    def relative_error(self) -> float:
        """100 |tau - tau_hat| / |tau| over all joints, behind the low-pass."""
        return self.errors.relative

    @fact(column="largest error / noise")
    def largest_error(self) -> str:
        """The largest error over noise, and that error with its joint; without a noise
        floor the error of the joint that errs most."""
        joint = self.errors.worst_of(range(1, len(self.rmse) + 1))
        unit = plain_unit(self.estimate.torque_units[joint - 1])
        size = formatting.quantity(float(self.rmse[joint - 1]), unit)
        error = f"{size}, joint {joint}"
        largest = self.largest_error_over_noise
        return error if largest is None else f"{number(largest)} ({error})"

    @property
    def relative_error_percent(self) -> float:
        """The relative error as a number [%]."""
        return self.errors.relative

    @fact("%", digits=2, name="relative error not ruled out")
    def highest_relative_error(self) -> float | None:
        """The upper end of the relative error's 95 % interval, by leaving out one stretch
        of a second of the judged motion after another; unknown without the signals."""
        signals = self.signals
        n_rows = len(signals.t)
        seconds = signals.seconds
        if seconds is None:
            return None
        # (M,) number of the stretch of _STRETCH seconds that each row belongs to.
        stretch = (np.arange(n_rows) * (seconds / n_rows) / _STRETCH).astype(np.intp)
        errors = np.bincount(stretch, np.sum(signals.residual**2, axis=1))
        torques = np.bincount(stretch, np.sum(signals.measured**2, axis=1))
        return upper_relative_error(errors.astype(float), torques.astype(float))

    @fact("")
    def kind_of_error(self) -> str:
        """What stands beside the errors where little of the judged motion is new: "on
        training motion"; "" for unseen motion, and where that is not recorded."""
        share = self.new_motion_share
        is_new = share is None or share >= MOSTLY_NEW
        return "" if is_new else "on training motion"

    @fact("")
    def grades(self) -> str:
        """What errors the grades stand for, in words; good ones are limited by the noise
        floor, or by a share of the torque where there is none."""
        is_known = self.noise_floor is not None
        return grades_in_words(None if is_known else 100.0 * NEGLIGIBLE)

    @fact("Hz", name="band")
    def band(self) -> float:
        """The low-pass that measured and modelled torque passed."""
        return self.band_hz

    @fact("s", digits=2)
    def standstill_left_out(self) -> float:
        """How long no joint moves in the judged runs; these rows have no part in the
        errors."""
        return self.still

    @fact("")
    def scope(self) -> str:
        """Which errors are meant: below the low-pass, and what is left out."""
        return formatting.scope_of_errors(self.band_hz, self.still)

    @fact("%", digits=2, name="new motion")
    def new_motion_percent(self) -> float | None:
        """Share of the judged motion that the model was not fitted to."""
        share = self.new_motion_share
        return None if share is None else 100.0 * share

    @fact("s", name="judged motion")
    def judged_seconds(self) -> float | None:
        """How long the judged motion lasts, behind the filters."""
        return self.signals.seconds

    @fact(column="links can exist")
    def links_can_exist(self) -> bool:
        """Whether the verdict says that the links can exist: each is physically consistent,
        up to rounding, reaches no farther than its body, and weighs something. No constraint
        demands a mass above 0: a certificate may have no violation without it."""
        return not implausible(self.estimate.certificate, *self._masses)

    @property
    def _masses(self) -> tuple[Array, Array]:
        """Masses (links,) of the model and of the nominal robot [kg]; each link has ten
        parameters in theta, its mass first."""
        indices = self.estimate.model.rigid_indices[::10]
        return self.estimate.theta[indices], self.estimate.nominal[indices]

    @fact("mm", column="thinnest link [mm]")
    def thinnest_link(self) -> float | None:
        """The least thickness of all links: zero for a rod or a sheet, negative for a
        link that cannot exist."""
        thickness = self.estimate.certificate.smallest_thickness
        return None if thickness is None else 1e3 * thickness

    @fact(digits=1, column="optimality gap")
    def distance_to_best_fit(self) -> float | None:
        """The certified gap: how far the loss can be above the best possible one, as a
        share of it."""
        return self.estimate.certificate.gap

    @property
    def is_negligible(self) -> bool:
        """Whether no noise is known, and the error of every joint is at most NEGLIGIBLE of
        its torque."""
        return self.noise_floor is None and bool(
            np.all(self.rmse <= NEGLIGIBLE * self.torque_rms)
        )

    @property
    def is_within_noise(self) -> bool:
        """Whether the error of every joint is at most ABOVE_NOISE times its noise
        floor.
        """
        largest = self.largest_error_over_noise
        return largest is not None and largest <= ABOVE_NOISE

    @property
    def verdict(self) -> Verdict:
        """The judgement of the model on these measurements."""
        return self.verdict_with()

    def verdict_with(self, forward: str = "") -> Verdict:
        """Return the verdict with what a forward simulation shows, a sentence.

        An error that is negligible beside the torque counts as noise.
        """
        masses, nominal = self._masses
        errors = self.errors
        if self.is_negligible:  # the error counts as its own noise floor
            errors = replace(errors, floor=nonzero_or_one(self.rmse))
        verdict = judge(
            errors=errors,
            r2=self.r2,
            noise_source=self.noise_source,
            new_share=self.new_motion_share,
            outside=max(self.outside.values(), default=0.0),
            certificate=self.estimate.certificate,
            masses=masses,
            nominal=nominal,
            judged_on=self.runs,
            forward=forward,
            remark=self.judged_on or "",
            seconds=self.signals.seconds,
            doubt=doubt_of_log(self.estimate.issues_by_run),
            highest=self.highest_relative_error,
            determined=(self.estimate.n_base_from_data, self.estimate.n_base),
        )
        if self.is_negligible:  # its floor was not the noise
            return replace(verdict, error_over_noise=None)
        return verdict

    def plot(
        self, joint: int | None = None, against: str = "time", axes: Any = None
    ) -> Any:
        """Plot the error of each joint beside the noise floor, or one joint's residual.

        Parameters
        ----------
        joint
            The joint (from 1) whose residual is plotted; default: errors of all joints.
        against
            "time", "position" or "velocity", for a residual.
        axes
            Axes of matplotlib to draw in; default: new ones.

        Raises
        ------
        InputError
            matplotlib is missing (extra [plot]), or there is no such joint or quantity.
        """
        if joint is None:
            return plot_errors(axes, {self.name: self.rmse}, self.noise_floor)
        if joint not in range(1, len(self.rmse) + 1):
            raise InputError(
                f"plot(joint={joint}): there is no such joint",
                f"choose one from 1 to {len(self.rmse)}",
            )
        j = joint - 1
        signals = self.signals
        values_and_labels = {
            "time": (signals.t, "time [s]"),
            "position": (signals.q[:, j], f"position of joint {joint} [rad or m]"),
            "velocity": (signals.dq[:, j], f"velocity of joint {joint} [rad/s or m/s]"),
        }
        if against not in values_and_labels:
            raise InputError(
                f"plot(against={against!r}) is unknown",
                "write time, position or velocity",
            )
        x, label = values_and_labels[against]
        axes = formatting.axes(axes)
        axes.plot(x, signals.residual[:, j], color=AFTER, lw=0.8)
        title = f"{self.name}: RMSE {self.rmse[j]:.3g}"
        axes.set(xlabel=label, ylabel="measured - modelled [N m or N]", title=title)
        return axes

    def _summary(self) -> Summary:
        """Return the printed summary: a headline, and rows of label and text."""

        def in_words(values: Array) -> str:
            """Write the numbers of all joints."""
            return ", ".join(f"{x:.3g}" for x in values)

        verdict = self.verdict
        rows = [(f"{line.about} ({line.grade})", line.text) for line in verdict.lines]
        rows.append(("RMSE", in_words(self.rmse)))
        if self.noise_floor is not None:
            rows.append(("noise floor", in_words(self.noise_floor)))
        rows.append(("band", self.scope))
        rows.append(("new motion", new_motion(self.new_motion_share)))
        return f"Comparison of {self.name}. {verdict.headline}", rows

    @property
    def noise(self) -> tuple[Array | None, str]:
        """The noise floor (n,) [N m or N], None if it is not known, and the name of its
        source.
        """
        return self.noise_floor, self.noise_source


#: What a sensor of an arm resolves at best, as a share of the largest torque (RMS) of its
#: joints: 20 bits. Without this limit, a log without noise of a joint with next to no torque
#: would have errors of micronewton metres that are many times its noise.
RESOLUTION = 1e-6
#: Share of a joint's torque up to which an error is good if no noise is known: no arm's
#: torque gain is known better.
NEGLIGIBLE = 1e-3
#: Length [s] of the stretches that the jackknife leaves out: longer than errors of a
#: friction or a filter are correlated.
_STRETCH = 1.0


def upper_relative_error(errors: Array, torques: Array) -> float | None:
    """Return the upper end of the 95 % interval of a relative error [%], by the
    jackknife.

    The relative error is e = 100 sqrt(sum errors / sum torques). It is computed K
    times, each time without one of K stretches of time; the scatter of these values
    gives its standard deviation.

    Parameters
    ----------
    errors
        (K,) sums of squared errors of each stretch.
    torques
        (K,) sums of squared torque of each stretch.

    Returns
    -------
    float or None
        [%]; infinite for fewer than three stretches; None without any torque.
    """
    if not np.sum(torques) > 0.0:
        return None
    n = len(errors)
    if n < 3:
        return float("inf")
    if not np.all(torques.sum() - torques > 0.0):
        return float("inf")
    _, deviation = jackknifed(relative_errors_without(errors, torques))
    whole = relative_error(errors.sum(), torques.sum())
    return float(whole + student_95(n) * deviation)


def new_motion(new_share: float | None) -> str:
    """Write the share of the judged motion that the model was not trained on."""
    return "not recorded" if new_share is None else formatting.percent(new_share, 2)


def plot_errors(axes: Any, errors: Mapping[str, Array], floor: Array | None) -> Any:
    """Plot the RMS error of each joint as bars, models side by side, and the noise as
    steps.

    Parameters
    ----------
    axes
        Axes of matplotlib to draw in; None for new ones.
    errors
        (n,) RMS errors [N m or N] by the model's name.
    floor
        (n,) noise floor [N m or N], or None.
    """
    axes = formatting.axes(axes)
    width = 0.8 / len(errors)
    for k, (name, rmse) in enumerate(errors.items()):
        offset = (k - 0.5 * (len(errors) - 1)) * width
        axes.bar(
            np.arange(1, len(rmse) + 1) + offset,
            rmse,
            width,
            color=model_colour(k, len(errors)),
            label=name,
        )
    if floor is not None:
        axes.step(
            np.arange(1, len(floor) + 1),
            floor,
            where="mid",
            color="black",
            label="noise floor",
        )
    # Logarithmic: one joint's large error would hide all others.
    axes.set(xlabel="joint", ylabel="RMSE [N m or N]", yscale="log")
    axes.set_xticks(np.arange(1, 1 + max(map(len, errors.values()))))
    axes.legend()
    return axes


class Comparisons(list[Comparison]):
    """A list of comparisons of several models with the same measurements, for
    display.
    """

    def to_frame(self) -> pandas.DataFrame:
        """Return the facts of each model as a data frame, one row for each model and
        joint (from 1).
        """
        import pandas

        frames = {comparison.name: comparison.to_frame() for comparison in self}
        return pandas.concat(frames, names=["model"])

    def plot(self, axes: Any = None) -> Any:
        """Plot the RMS errors of all models joint by joint, with the noise floor.

        Parameters
        ----------
        axes
            Axes of matplotlib to draw in; default: new ones.

        Raises
        ------
        InputError
            matplotlib is missing (extra [plot]).
        """
        errors = {c.name: c.rmse for c in self}
        return plot_errors(axes, errors, self[0].noise_floor)

    def __repr__(self) -> str:
        """Return the single comparison's text, or the first five lines of what is
        printed, which fit a terminal.
        """
        if len(self) == 1:
            return repr(self[0])
        return "\n".join(map(cut_to_width, str(self).splitlines()[:5]))

    def __str__(self) -> str:
        """Return the single comparison's text, or each model's headline, and the errors
        of all models on each joint that is the worst of one of them.
        """
        if len(self) == 1:
            return str(self[0])
        headlines = [f"{c.name}: {c.verdict.headline}" for c in self]
        joints = sorted({c.worst_joint for c in self})
        errors = [f"joint {joint}: {self._errors_on(joint)}" for joint in joints]
        lines = [f"  {line}" for line in (*headlines, *errors)]
        return "\n".join(["Comparisons", *lines])

    def _errors_on(self, joint: int) -> str:
        """Write the errors of all models on one joint (from 1), in order, and in
        multiples of the noise if it is known.
        """
        first = self[0]
        ratios = [c.error_over_noise for c in self]
        return formatting.errors_with_noise(
            [float(c.rmse[joint - 1]) for c in self],
            [float(x[joint - 1]) for x in ratios if x is not None] or None,
            plain_unit(first.estimate.torque_units[joint - 1]),
            between=" -> ",
        )

    def _repr_html_(self) -> str:
        """Show headlines and the table of errors in a notebook."""
        headlines = [escape(f"{c.name}: {c.verdict.headline}") for c in self]
        paragraphs = "".join(f"<p>{text}</p>" for text in headlines)
        return paragraphs + self.to_frame().to_html()


@on_one_thread
@checked_arguments
def compare(
    models: Models,
    measurements: Source | FilteredRuns,
    preprocessing: Preprocessing | None = None,
    *,
    noise_from: Source | None = None,
) -> Comparisons:
    """Compare one or several models with the same measurements.

    All models are judged behind the same filters and beside the same noise floor.

    Parameters
    ----------
    models : Estimate, Problem, path, sequence of these, or mapping of names to these
        A path is that of a model.json. A robot's file (.urdf, .xml, ...), a built-in
        name or a Problem is judged as it states its links, damping and friction.
    measurements : path, arrays, DataFrame, Measurements, list of these, FilteredRuns
        The runs to judge on. The filters of FilteredRuns hold.
    preprocessing : Preprocessing, optional
        Filter settings; default: those of the first model that was identified.
    noise_from : the same as measurements, optional
        The recordings of which the measurements are windows: their repetition shows the
        noise floor. Default: those that they were cut from. Where they do not repeat, the floor is
        that of the first model's own recordings, if these did.

    Returns
    -------
    Comparisons
        One :class:`Comparison` a model, in a list with ``plot()`` and ``to_frame()``.

    Raises
    ------
    InputError
        Where a model and the measurements have different numbers of joints.
    """
    models = as_estimates(models, "compare(models=...)", as_model)
    first = first_identified(models)
    runs = measurements
    if not isinstance(runs, FilteredRuns):
        names = first.robot.joint_names
        data = as_measurements(
            measurements, names=names, what="compare(measurements=...)"
        )
        settings = preprocessing or first.preprocessing
        runs = FilteredRuns.filtering(data, settings.resolve(data))
    for name, model in models.items():
        if model.robot.n != runs.measurements.n:
            what = f"measurements for {name}"
            raise other_robot(runs.measurements.n, model.robot.n, what, "model")
        check_plausible(model.robot, runs.measurements)
    return compare_filtered(models, runs, noise_from)


def first_identified(models: Mapping[str, Estimate]) -> Estimate:
    """Return the first model that was identified; the first one where none was.

    Its filters and its noise are those that all models are judged by.
    """
    identified = (model for model in models.values() if model.method != NOMINAL)
    return next(identified, next(iter(models.values())))


def compare_filtered(
    models: Mapping[str, Estimate],
    runs: FilteredRuns,
    noise_from: Source | None = None,
    noise: tuple[Array | None, str] | None = None,
) -> Comparisons:
    """Compare models on filtered runs that were checked to be possible for the robot.

    Parameters
    ----------
    runs
        Filtered runs to judge on.
    noise_from
        Recordings of which the runs are windows, for the noise floor.
    noise
        What :func:`noise_floor` says of these recordings, where that is known.

    Returns
    -------
    Comparisons
        One comparison for each model.
    """
    first = first_identified(models)
    settings = runs.settings
    _, measurements = driven(first, runs.measurements)
    if measurements is not runs.measurements:
        runs = FilteredRuns.filtering(measurements, settings)
    all_measurements = measurements
    runs_of_noise = runs
    if noise_from is not None:
        _, all_measurements = driven(first, as_measurements(noise_from))
        if all_measurements is not measurements:
            runs_of_noise = FilteredRuns.filtering(all_measurements, settings)
    floor = noise or _noise_floor(first, runs_of_noise)
    remark = subsample_sentence(
        window_subsample(all_measurements, settings),
        all_measurements,
        "errors are those of all samples, noise and dependences of",
    )
    judged = Comparisons()
    for name, model in models.items():
        # Joint torque is compared: a model of drives is compared without them.
        at_the_joints = plant(model) if model.model.drives.any() else model
        comparison = _compare_one(name, at_the_joints, runs, floor)
        judged.append(replace(comparison, judged_on=remark))
    return judged


def _noise_floor(first: Estimate, runs: FilteredRuns) -> tuple[Array | None, str]:
    """Return the noise floor (n,) [N m or N] that models are judged by, and its source.

    It depends only on the first model's problem and on the recordings, so that all
    commands show the same one. The floor stored with the model is used if it was
    measured in the same recordings. It is also used if it comes from repetition and
    these recordings do not repeat, since it is the same arm behind the same filters.
    None if it is not known.
    """
    stored = _stored_noise(first, runs.settings)
    recording = runs.measurements.recording
    if stored is not None and stored.data_hash == recording.data_hash:
        floor, source = stored.floor, stored.source
    else:
        floor, source = noise_level(first.problem, runs)
        if stored is not None and stored.source == REPETITION and source != REPETITION:
            floor, source = stored.floor, stored.source
    if floor is None:
        return None, source
    return np.maximum(floor, resolution(runs.measurements.tau, first)), source


def resolution(tau: Array, model: Estimate) -> Array:
    """Return the smallest torque (n,) that a joint's sensor may resolve [N m or N]:
    RESOLUTION times the largest torque (RMS) of the joints with the same unit; tau (M, n)."""
    torque = np.sqrt(np.mean(tau**2, axis=0))
    units = np.array(model.torque_units)
    return RESOLUTION * np.array([torque[units == unit].max() for unit in units])


def _stored_noise(model: Estimate, settings: Preprocessing) -> NoiseFloor | None:
    """Return the noise floor stored with a model, from the recordings it was identified
    from.

    Parameters
    ----------
    settings
        Filters of the recordings that are judged: a noise floor is one behind filters.

    Returns
    -------
    NoiseFloor or None
        None if the model stores none, or if its filters differ from ``settings``.
    """
    if model.preprocessing != settings or model.provenance.get("noise") is None:
        return None
    return NoiseFloor.from_dict(model.provenance["noise"])


def noise_floor(model: Estimate, recordings: Measurements) -> tuple[Array | None, str]:
    """Return the noise floor by which :func:`compare` judges a model, and its source.

    Parameters
    ----------
    model
        The model, which names the filters.
    recordings
        The recordings, with their repetitions if there are any.

    Returns
    -------
    (n,) array or None
        Floor of each joint [N m or N]; None if it is not known.
    str
        Source: repetition, a spectrum, or the residual.
    """
    _, with_joint_torque = driven(model, recordings)
    return _noise_floor(
        model, FilteredRuns.filtering(with_joint_torque, model.preprocessing)
    )


def keep_noise_floor(estimate: Estimate, recordings: Measurements) -> None:
    """Store the noise floor of a model's own recordings in its provenance."""
    level = noise_floor(estimate, recordings)
    floor = NoiseFloor(*level, recordings.recording.data_hash)
    estimate.provenance["noise"] = floor.to_dict()


def _compare_one(
    name: str, model: Estimate, runs: FilteredRuns, floor: tuple[Array | None, str]
) -> Comparison:
    """Compute the errors of one model on filtered runs.

    Parameters
    ----------
    model
        The model of joint torque.
    floor
        Noise floor (n,) [N m or N], None if it is not known, and its source.
    """
    signals, outside_shares = _predict_runs(model, runs)
    statistics = _ErrorStatistics.from_signals(signals)
    band = runs.settings.torque_cutoff
    assert band is not None
    record = model.training_motion
    new_share = None if record is None else record.new_share(runs)
    if model.method == NOMINAL:
        new_share = 1.0  # it was fitted to no motion
    noise, noise_source = floor
    return Comparison(
        name=name,
        estimate=model,
        rmse=np.sqrt(statistics.mean_squared_error),
        mse=statistics.mean_squared_error,
        r2=statistics.r2,
        torque_rms=statistics.torque_rms,
        noise_floor=noise,
        noise_source=noise_source,
        band_hz=band,
        signals=signals,
        runs=runs.measurements.names,
        new_motion_share=new_share,
        outside=outside_shares,
        still=runs.still_seconds,
    )


def _predict_runs(
    model: Estimate, runs: FilteredRuns
) -> tuple[Signals, dict[str, float]]:
    """Predict the torque of all rows of filtered runs.

    Returns
    -------
    Signals
        Measured and modelled torque with the motion.
    dict of str to float
        For effects that are known in a limited range only (such as a measured curve):
        share of rows outside, by the name of the effect's first parameter. Zeros are
        left out.
    """
    columns = {
        name: AppendableArray() for name in ("t", "q", "dq", "measured", "modelled")
    }
    n_outside = dict[str, float]()
    for run in runs.runs:
        for rows in run.rows(model.model):
            motion = rows.motion
            modelled = predicted(rows, model.theta)
            columns["t"].append(motion.t)
            columns["q"].append(motion.q)
            columns["dq"].append(motion.dq)
            columns["measured"].append(rows.torque)
            columns["modelled"].append(modelled)
            # An effect's range may be one of torque: the modelled torque is judged.
            motion_with_torque = replace(motion, torque=modelled)
            for effect in model.model.effects:
                is_outside = effect.outside(motion_with_torque)
                first = effect.parameters[0].name
                n_outside[first] = n_outside.get(first, 0.0) + float(is_outside.sum())
    signals = Signals(**{name: x.array() for name, x in columns.items()})
    n_rows = len(signals.t)
    shares = {name: n / n_rows for name, n in n_outside.items() if n > 0.0}
    return signals, shares


@dataclass(frozen=True)
class _ErrorStatistics:
    """Errors of a model."""

    #: (n,) mean squared error of each joint's torque [(N m)^2 or N^2].
    mean_squared_error: Array
    #: (n,) coefficient of determination, NaN for a constant torque.
    r2: Array
    #: (n,) root mean square of the measured torque [N m or N].
    torque_rms: Array

    @classmethod
    def from_signals(cls, signals: Signals) -> Self:
        """Compute mean squared error and r2 of a model's torque.

        With e = measured - modelled: mse = mean e^2 and r2 = 1 - mse / variance of each
        joint. Sums run over chunks of rows, so that long logs need little memory.
        """
        # All sums are over rows, (n,) each.
        pairs = zip(
            iter_chunks(signals.measured), iter_chunks(signals.modelled), strict=True
        )
        squared_error = sum(
            np.sum((measured - modelled) ** 2, axis=0)
            for (_, measured), (_, modelled) in pairs
        )
        n_rows = len(signals.t)
        error = squared_error / n_rows
        total = sum(chunk.sum(axis=0) for _, chunk in iter_chunks(signals.measured))
        mean = total / n_rows
        scatter = sum(
            np.sum((chunk - mean) ** 2, axis=0)
            for _, chunk in iter_chunks(signals.measured)
        )
        variance = scatter / n_rows
        with np.errstate(divide="ignore", invalid="ignore"):
            r2 = np.where(variance > 0.0, 1.0 - error / variance, np.nan)
        return cls(error, r2, np.sqrt(variance + mean**2))


def predicted(rows: Rows, theta: Array) -> Array:
    """Return the modelled torque (M, n) [N m or N] of M filtered rows, regressor times
    theta (p,) in SI units; the columns passed the same filter as the torque."""
    return np.column_stack([c.columns @ theta[c.indices] for c in rows.columns])
