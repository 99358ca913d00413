"""One verdict on a model: fit against noise, prediction, what is missing; the weakest
first.

Command line, API, page, report, JSON and the headers of exports take it from here, so
that no two of them grade the same model and measurements differently. What is not known
never makes a grade better: "good" needs a noise floor that is known, errors within it
on motion that is mostly new, and links that can exist. A diagnosis names what is
missing; the grade is the same with and without it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty import formatting
from sdp_vs_penalty.estimation.certificate import Certificate
from sdp_vs_penalty.estimation.constants import CHANGES, ROUNDING
from sdp_vs_penalty.estimators.estimator import make_task
from sdp_vs_penalty.files import JsonRecord
from sdp_vs_penalty.problem.problem import Problem
from sdp_vs_penalty.regression.regression import compress
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.constraint import BarycentricBound
from sdp_vs_penalty.signals.filtered import FilteredRuns
from sdp_vs_penalty.signals.noise import RESIDUAL, SPECTRUM, SPECTRUM_KNOWN, noise_of
from sdp_vs_penalty.signals.segments import segmented, window_subsample

Grade = Literal["good", "usable", "do not use"]
GRADES: tuple[Grade, ...] = ("do not use", "usable", "good")
#: A joint's error counts as noise up to so many noise floors (standard deviations): its
#: variance is then at most four times that of the noise.
ABOVE_NOISE = 2.0
#: Relative torque error beyond the noise [%] above which a model is not to be used; up
#: to CHANGES a prediction is good. Identified models of real arms reach 0.2 to 9 %
#: (dVRK, Panda, UR10, TX40, published and ours).
NO_MODEL = 15.0
#: From this share of new motion on, errors are those of unseen motion; below, they show
#: repeatability.
MOSTLY_NEW = 0.5
#: No link of an arm weighs less than this share of it; the lightest wrists have a
#: hundredth.
_LIGHTEST = 1e-3
FIT = "fit against noise"
PREDICTION = "prediction"
MISSING = "missing"
#: What the data check leaves in doubt is a line of its own.
LOG = "the log"
#: Kinds of issues of the data check that leave order, clock, mounting, sign, unit or the
#: kind of torque in doubt: such a model is not good, whatever its error.
DOUBTS = frozenset(
    {
        "clock against velocity",
        "clock rate",
        "time reversed",
        "position order",
        "torque order",
        "joint order",
        "position sign",
        "torque sign",
        "joint sign",
        "torque magnitude",
        "gravity direction",
        "gravity of the problem",
        "gravity removed",
        "gravity model",
        "external torque",
        "torque channel kind",
        "torque in counts",
        "torque unit",
        "torque not explained",
        "units of the problem",
        "masses of the problem",
    }
)


@dataclass(frozen=True)
class Line(JsonRecord):
    """One of the three: about FIT, PREDICTION or MISSING, its grade, and why in a
    sentence."""

    about: str
    grade: Grade
    text: str

    def __str__(self) -> str:
        return f"{self.about}: {self.text}"


@dataclass(frozen=True)
class Verdict(JsonRecord):
    """lines : the three, weakest first; error_over_noise (n,) : RMSE over the noise
    floor of each joint, None where it is not known; noise_source : where the floor is
    from, "" where it is not known; judged_on : the names of the runs; remark : a
    sentence on windows of a long recording, or ""."""

    lines: tuple[Line, ...]
    error_over_noise: tuple[float, ...] | None
    noise_source: str
    judged_on: tuple[str, ...]
    remark: str = ""

    def __post_init__(self) -> None:
        if not self.lines:
            raise ValueError("verdict: no line says a grade")

    @property
    def grade(self) -> Grade:
        """That of the weakest line."""
        return self.lines[0].grade

    @property
    def headline(self) -> str:
        """The grade and its reason."""
        return f"{self.grade[0].upper()}{self.grade[1:]}. {self.lines[0].text}"

    def __str__(self) -> str:
        lines_in_words = "\n".join(f"  {line.grade:10}  {line}" for line in self.lines)
        return f"{self.headline}\n{lines_in_words}"

    def brief(self) -> str:
        """One line for the header of a file."""
        reasons = " ".join(str(line) for line in self.lines)
        return f"Verdict on {', '.join(self.judged_on)}: {self.grade}. {reasons}"

    def with_missing(self, said: str, has_open_finding: bool) -> Verdict:
        """The same with what a diagnosis says in place of what errors alone say.

        said : a sentence; has_open_finding : whether the diagnosis has found an effect
        that the model lacks, which is then at most usable.
        """
        fit = next((line for line in self.lines if line.about == FIT), None)
        over = self.error_over_noise
        alone = fit and _left(fit, None if over is None else np.array(over))
        lines = []
        for line in self.lines:
            if alone and line.about == MISSING:
                grade = line.grade
                if has_open_finding and grade == "good":
                    grade = "usable"
                text = line.text.replace(alone, said)
                lines.append(replace(line, text=text, grade=grade))
            else:
                lines.append(line)
        return replace(self, lines=_weakest_first(lines))

    def to_dict(self) -> dict[str, Any]:
        return {
            "grade": self.grade,
            "headline": self.headline,
            **super().to_dict(),
        }


#: What is said of a model without a verdict.
NOT_JUDGED = (
    "Verdict: not judged on any measurements; `sdp-vs-penalty compare` judges it."
)


def judge(
    *,
    rmse: Array,
    r2: Array,
    floor: Array | None,
    noise_source: str,
    relative: float,
    new_share: float | None,
    outside: float,
    certificate: Certificate,
    masses: Array,
    nominal: Array,
    judged_on: Sequence[str],
    missing: str = "",
    forward: str = "",
    remark: str = "",
    seconds: float | None = None,
    doubt: str = "",
    highest: float | None = None,
    units: Sequence[str] = (),
    has_open_finding: bool = False,
) -> Verdict:
    """The verdict on one model.

    rmse, r2 (n,); floor (n,) or None, and its source; relative : error over all joints
    [%]; new_share : of the rows whose motion is new to the model, None where not
    recorded; outside : largest share of rows outside of a measured curve. masses,
    nominal (links,) [kg] : of its links, identified and before; missing : what a
    diagnosis says, "" where there was none; forward : what a forward simulation says;
    remark : of long recordings; seconds : of filtered motion that errors are of; doubt :
    what the data check leaves in doubt (:func:`doubt_of_log`); highest : error [%] that
    motion of this length does not rule out; units : of the joints' torques;
    has_open_finding : whether a diagnosis has found an effect that the model lacks.
    """
    over = over_noise(rmse, floor)
    beyond = relative if floor is None else _beyond_noise(relative, rmse, floor)
    errors = JointErrors(rmse, over, tuple(units))
    fit = _fit(
        errors,
        beyond,
        relative,
        noise_source,
        np.asarray(r2) < 0.0,
    )
    what_is_missing = missing or _left(fit, over)
    if impossible := implausible(certificate, masses, nominal):
        last = Line(MISSING, "do not use", f"{impossible} {what_is_missing}")
    else:
        believed = " The links can exist." if len(masses) else ""
        is_complete = fit.grade == "good" and not has_open_finding
        grade: Grade = "good" if is_complete else "usable"
        last = Line(MISSING, grade, what_is_missing + believed)
    far = outside > CHANGES or floor is None
    end = "."
    if outside > 0.0:
        share = f"{100.0 * outside:.0f} %"
        end = f"; {share} of the rows lie outside of a measured curve's table."
    if forward:
        end = f"{end} {forward}"
    lines = [
        fit,
        _prediction(beyond, relative, new_share, far, end, seconds, highest),
        last,
    ]
    if doubt:
        lines.insert(0, Line(LOG, "usable", doubt))
    ratios, source = (
        (None, "") if over is None else (tuple(map(float, over)), noise_source)
    )
    return Verdict(
        lines=_weakest_first(lines),
        error_over_noise=ratios,
        noise_source=source,
        judged_on=tuple(judged_on),
        remark=remark,
    )


def _weakest_first(lines: Sequence[Line]) -> tuple[Line, ...]:
    """Lines by grade; those of one grade keep their order."""
    return tuple(sorted(lines, key=lambda line: GRADES.index(line.grade)))


def _beyond_noise(relative: float, rmse: Array, floor: Array) -> float:
    """The relative error [%] without what the noise (n,) explains of it."""
    if not np.isfinite(relative) or not np.any(rmse > 0.0):
        return relative
    left = np.maximum(rmse**2 - floor**2, 0.0).sum()
    return float(relative * np.sqrt(left / np.sum(rmse**2)))


def doubt_of_log(checks: Mapping[str, Sequence[Mapping[str, Any]]]) -> str:
    """Which kinds of DOUBTS the check has named of the training runs.

    Parameters
    ----------
    checks : mapping of str to sequence of mapping
        Issues as plain JSON by run, as a model keeps them.

    Returns
    -------
    str
        A sentence, or "".
    """
    kinds = [
        str(issue["kind"])
        for issues in checks.values()
        for issue in issues
        if issue.get("kind") in DOUBTS and issue.get("severity") != "note"
    ]
    if not kinds:
        return ""
    words = formatting.words(list(dict.fromkeys(kinds)))
    return f"In doubt: {words}; `check` says what to do."


@dataclass(frozen=True)
class JointErrors:
    """rmse (n,) [N m or N]; over_noise (n,) in multiples of the noise floor, None where
    that is not known; units : of the joints' torques, none: not said."""

    rmse: Array
    over_noise: Array | None
    units: tuple[str, ...]

    def words(self, joint: int) -> str:
        """The error of a joint (from 1), in multiples of its noise and in its unit."""
        unit = "N m or N"
        if self.units:
            unit = formatting.plain_unit(self.units[joint - 1])
        assert self.over_noise is not None
        return formatting.times_noise(
            float(self.over_noise[joint - 1]),
            float(self.rmse[joint - 1]),
            unit,
        )


def _fit(
    errors: JointErrors,
    beyond: float,
    relative: float,
    source: str,
    none: NDArray[np.bool_],
) -> Line:
    """Of errors over noise; none (n,) : joints whose mean torque does better."""
    grade: Grade = "usable" if beyond <= NO_MODEL else "do not use"
    over = errors.over_noise
    if over is None:
        sentence = (
            f"{relative:.3g} % error; the noise floor is unknown: no motion repeats"
        )
    else:
        none = none & (over > ABOVE_NOISE)
        sentence = _worst_in_words(errors, over)
        if source == SPECTRUM:
            sentence += f"; the noise is from the torque's spectrum, {SPECTRUM_KNOWN}"
        if grade == "do not use":
            sentence = f"{beyond:.3g} % error beyond the noise. {sentence}"
        elif np.all(over <= ABOVE_NOISE):
            grade = "good"
    if none.any():
        grade = min(grade, "usable", key=GRADES.index)
        where = formatting.joints((np.flatnonzero(none) + 1).tolist())
        sentence += f"; {where}: worse than a constant torque"
    return Line(FIT, grade, f"{sentence}.")


def _worst_in_words(errors: JointErrors, over: Array) -> str:
    """The joint that errs most, in multiples of its noise (over (n,)) and in its unit."""
    worst = int(np.argmax(over)) + 1
    if over[worst - 1] <= ABOVE_NOISE:
        words = errors.words(worst).removesuffix(")")
        return f"No joint errs more than {words} on joint {worst})"
    return f"Joint {worst} errs {errors.words(worst)}"


def _prediction(
    beyond: float,
    relative: float,
    share: float | None,
    far: bool,
    end: str,
    seconds: float | None,
    highest: float | None,
) -> Line:
    """far : rows lie outside of a measured curve, or the noise is not known; end : of
    the sentence; highest : the error [%] that the judged motion does not rule out, None
    where that is not known."""
    grade: Grade = "usable" if beyond <= NO_MODEL else "do not use"
    percent = "" if share is None else formatting.percent(share, 2)
    if share is None or share < MOSTLY_NEW:
        known = "the model does not record its own motion"
        if percent:
            known = f"{percent} of this motion is new"
        sentence = (
            f"Scored on training data ({known}); run `compare` on a new recording"
        )
        if grade == "do not use":
            sentence = f"{beyond:.3g} % error even on training data. {sentence}"
        return Line(PREDICTION, grade, sentence + end)
    length = "" if seconds is None else f": {seconds:.3g} s"
    sentence = (
        f"{relative:.3g} % error on motion not used for fitting{length}, {percent} of it"
        " new"
    )
    limit = 100.0 * CHANGES
    if beyond <= limit and not far:
        if highest is not None and highest > limit:
            sentence = f"Too short to tell: {sentence}"
            if np.isfinite(highest):
                sentence += f"; so little does not rule out {highest:.2g} %"
        else:
            grade = "good"
    return Line(PREDICTION, grade, sentence + end)


def _left(fit: Line, over: Array | None) -> str:
    """What errors alone say of what is missing."""
    if fit.grade == "good":
        return "Nothing that these measurements show."
    if over is None:
        return "Not known without a noise floor; `diagnose` names causes."
    above = (np.flatnonzero(over > ABOVE_NOISE) + 1).tolist()
    where = f" on {formatting.joints(above)}" if above else ""
    return f"Torque beyond the noise{where}; `diagnose` names causes."


def implausible(certificate: Certificate, masses: Array, nominal: Array) -> str:
    """Why the links are not to be believed, in a sentence; "" where they are.

    Parameters
    ----------
    certificate : Certificate
        Of the model.
    masses : (links,) array
        Identified [kg].
    nominal : (links,) array
        Before [kg].

    Returns
    -------
    str
        A sentence, or "".
    """
    if certificate.not_found:
        return certificate.not_found
    sentences = {
        k: v for k, v in certificate.violations.items() if k != BarycentricBound.family
    }
    family = max(
        sentences,
        key=lambda name: sentences[name],
        default="",
    )
    if sentences.get(family, 0.0) > ROUNDING:
        return (
            f"No robot is like this: constraints are violated ({family} by"
            f" {sentences[family]:.2g})."
        )
    if certificate.body_share is not None and certificate.body_share > 1.0 + 1e-6:
        return "A link's mass lies farther out than its body reaches."
    lightest = _LIGHTEST * float(np.sum(masses))
    light = [i + 1 for i, m in enumerate(masses) if m < lightest < 10.0 * nominal[i]]
    if light:
        words = "Links {} weigh" if len(light) > 1 else "Link {} weighs"
        share = f"less than a thousandth of the arm ({float(np.sum(masses)):.3g} kg)"
        return f"{words.format(formatting.words(light))} {share}."
    return ""


def changes(
    before: Array,
    after: Array,
    floor: Array | None,
    units: Sequence[str] = (),
) -> str:
    """What became of each joint's error (n,), largest fall first, and of every joint
    that got worse by more than 5 %: in multiples of the noise where it is known, and in
    N m or N; "" where nothing changed.

    Parameters
    ----------
    before : (n,) array
        Errors of the model [N m or N].
    after : (n,) array
        Of the extended one.
    floor : (n,) array or None
        Of the noise.
    units : sequence of str
        Torque unit of each joint; none: "N m or N".

    Returns
    -------
    str
        A sentence, or "".
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        share = np.where(
            before > 0.0,
            after / before - 1.0,
            np.where(after > 0.0, np.inf, 0.0),
        )
    known = floor is not None and bool(np.all(floor > 0.0))

    def words(j: int) -> str:
        unit = formatting.plain_unit(units[j]) if units else "N m or N"
        errors = [formatting.number(float(x[j])) for x in (before, after)]
        more = [f"{100.0 * share[j]:+.0f} %"] if np.isfinite(share[j]) else []
        if known and floor is not None:
            more.insert(0, f"{errors[0]} -> {errors[1]} {unit}")
            times = [formatting.number(float(x[j] / floor[j])) for x in (before, after)]
            amount = f"{times[0]} -> {times[1]} times the noise"
        else:
            amount = f"{errors[0]} -> {errors[1]} {unit}"
        return f"{amount} ({', '.join(more)})" if more else amount

    order = np.argsort(share)
    better = [f"joint {j + 1}: {words(j)}" for j in order if share[j] < -CHANGES]
    worse = [
        f"joint {j + 1} worse: {words(j)}" for j in order[::-1] if share[j] > CHANGES
    ]
    if not better and not worse:
        return ""
    return f"{'; '.join([*better, *worse])}."


def over_noise(rmse: Array, floor: Array | None) -> Array | None:
    """(n,) errors over the noise floor; infinite where the noise is zero and the error
    is not; None without a floor.

    Parameters
    ----------
    rmse : (n,) array
        Errors [N m or N].
    floor : (n,) array or None
        Of the noise.

    Returns
    -------
    (n,) array or None
        Ratios.
    """
    if floor is None:
        return None
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = rmse / floor
    return np.where(
        floor > 0.0,
        ratio,
        np.where(rmse > 0.0, np.inf, 1.0),
    )


@dataclass(frozen=True)
class NoiseFloor(JsonRecord):
    """What :func:`noise_level` says of measurements with this hash."""

    floor: Array | None
    source: str
    data_hash: str


def noise_level(
    problem: Problem, filtered_runs: FilteredRuns
) -> tuple[Array | None, str]:
    """Standard deviation of the torque noise below the cut-off, and its source.

    From repetition: r(t) - r(t + T) of a residual r. The residual is that of
    unconstrained least squares of the problem's own effects on these measurements, so
    that the floor does not depend on which models are judged beside it. Where nothing
    repeats, from the torque's spectrum above the motion's band (:mod:`~signals.noise`),
    at most that residual. Of long recordings windows are looked at.

    Parameters
    ----------
    problem : Problem
        With its own effects.
    filtered_runs : FilteredRuns
        To measure it in.

    Returns
    -------
    (n,) array or None
        [N m or N]; None where the logs hold nothing there.
    str
        "repetition" or "spectrum"; "" without a floor.
    """
    settings = filtered_runs.settings
    shown = window_subsample(filtered_runs.measurements, filtered_runs.settings)
    filtered = (
        filtered_runs
        if shown is filtered_runs.measurements
        else FilteredRuns.of(shown, settings)
    )
    runs = segmented(shown, settings)
    if not runs.segments:
        return None, ""
    model = problem.model().reference_free
    theta = make_task(problem, model, compress(filtered, model), "none").ols
    noise = noise_of(
        runs.with_model(lambda m: model.seen_along(theta, m), gains=model.gains)
    )
    return (None, "") if noise.source == RESIDUAL else (noise.floor, noise.source)
