"""One verdict on a model: fit against noise, prediction, what is missing; the weakest
first.

Command line, API, page, report, JSON and the headers of exports take it from here, so
that no two of them grade the same model and measurements differently. What is not known
never makes a grade better: "good" needs a noise floor that is known, errors within it
on motion that is mostly new, and links that can exist. A diagnosis names what is
missing; a model that lacks a finding of it, other than a weak one, is at most usable.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from sdp_vs_penalty import formatting
from sdp_vs_penalty.estimation.certificate import Certificate
from sdp_vs_penalty.estimation.constants import CHANGES, ROUNDING
from sdp_vs_penalty.estimators.estimator import make_task
from sdp_vs_penalty.formatting import number
from sdp_vs_penalty.problem.problem import Problem
from sdp_vs_penalty.records import JsonRecord
from sdp_vs_penalty.regression.regression import compress
from sdp_vs_penalty.results.issue import IssueInWords
from sdp_vs_penalty.robot.arrays import Array, Mask
from sdp_vs_penalty.robot.constraint import BarycentricBound
from sdp_vs_penalty.signals.filtered import FilteredRuns
from sdp_vs_penalty.signals.noise import (
    NOISE_UNKNOWN,
    RESIDUAL,
    SPECTRUM,
    SPECTRUM_KNOWN,
    noise_of,
)
from sdp_vs_penalty.signals.segments import segmented, window_subsample

Grade = Literal["good", "usable", "do not use"]
GRADES: tuple[Grade, ...] = ("do not use", "usable", "good")
#: A joint's error counts as noise up to so many noise floors (standard deviations): its
#: variance is then at most four times that of the noise.
ABOVE_NOISE = 2.0
#: Torque error beyond the noise [% of the joint's torque] of one joint above which a
#: model is not to be used. Up to CHANGES, of all joints together, a prediction is good:
#: identified models of real arms reach 0.2 to 9 % (dVRK, Panda, UR10, TX40, published
#: and ours).
NO_MODEL = 15.0
#: From this share of new motion on, errors are those of unseen motion; below, they show
#: repeatability.
MOSTLY_NEW = 0.5
#: A model of which the data determine a smaller share of base parameters predicts other
#: motion by its prior; only errors on new motion can show that it does so well.
MOSTLY_DETERMINED = 0.5
#: No link of an arm weighs less than this share of it; the lightest wrists have a
#: hundredth.
_LIGHTEST = 1e-3
FIT = "fit against noise"
PREDICTION = "prediction"
MISSING = "missing"
#: What the data check leaves in doubt is a line of its own.
LOG = "the log"
#: How that line begins.
_IN_DOUBT = "In doubt: "


#: How a line ends whose noise is from the torque's spectrum.
NOISE_OF_SPECTRUM = f"; the noise is from the torque's spectrum, {SPECTRUM_KNOWN}"


@dataclass(frozen=True)
class Line(JsonRecord):
    """One of the three: about FIT, PREDICTION or MISSING, its grade, and why in a
    sentence."""

    about: str
    grade: Grade
    text: str

    def __str__(self) -> str:
        """Return the line as "subject: sentence"; a sentence on what is missing says its
        subject itself."""
        return self.text if self.about == MISSING else f"{self.about}: {self.text}"


@dataclass(frozen=True)
class Verdict(JsonRecord):
    """What a model is worth: three lines, the errors beside the noise, and whether the
    links can exist."""

    derived = ("grade", "headline")

    #: The three lines, weakest first.
    lines: tuple[Line, ...]
    #: (n,) RMSE over the noise floor of each joint; None where it is not known.
    error_over_noise: tuple[float, ...] | None
    #: Origin of the floor; "" where it is not known.
    noise_source: str
    #: Names of the runs.
    judged_on: tuple[str, ...]
    #: A sentence on windows of a long recording, or "".
    remark: str = ""
    #: A sentence on whether the links can exist; "" for a model without any.
    links: str = ""
    #: Whether the links can exist.
    links_are_possible: bool = True

    def __post_init__(self) -> None:
        """Raise ValueError for a verdict without lines, as a damaged file may hold."""
        if not self.lines:
            raise ValueError("verdict: no line says a grade")

    @property
    def grade(self) -> Grade:
        """Grade of the weakest line."""
        return self.lines[0].grade

    @property
    def reason(self) -> str:
        """The sentence of the weakest line; which joint errs comes before what is in
        doubt of the log."""
        weakest = self.lines[0]
        fit = [line.text for line in self.lines if line.about == FIT]
        return " ".join([*(fit if weakest.about == LOG else ()), weakest.text])

    @property
    def headline(self) -> str:
        """Grade and reason, as a sentence."""
        return f"{formatting.sentence(self.grade)}. {self.reason}"

    def __str__(self) -> str:
        """Return the headline, then each line with its grade."""
        lines_in_words = "\n".join(f"  {line.grade:10}  {line}" for line in self.lines)
        return f"{self.headline}\n{lines_in_words}"

    @property
    def is_lowered_by_log_alone(self) -> bool:
        """Whether nothing but what is in doubt of the log keeps the model from being
        good."""
        others = (line.grade for line in self.lines if line.about != LOG)
        return self.grade != "good" and all(grade == "good" for grade in others)

    @property
    def is_something_missing(self) -> bool:
        """Whether the line on missing effects is less than good."""
        return any(
            line.about == MISSING and line.grade != "good" for line in self.lines
        )

    def brief(self) -> str:
        """Return the verdict in one line, for the header of a file of ASCII."""
        reasons = " ".join(str(line) for line in self.lines).replace("→", "->")
        return f"Verdict on {', '.join(self.judged_on)}: {self.grade}. {reasons}"

    def with_missing(self, sentence: str, has_open_finding: bool) -> Verdict:
        """Return the verdict with a diagnosis's sentence on missing effects.

        It replaces the sentence of the line MISSING, whose grade becomes "good" only if
        the line FIT is good and no finding is open: one that the model lacks.
        """
        is_good_fit = any(
            line.about == FIT and line.grade == "good" for line in self.lines
        )
        missing = _missing_line(
            sentence,
            is_complete=is_good_fit and not has_open_finding,
            links=self.links,
            links_are_possible=self.links_are_possible,
        )
        lines = [missing if line.about == MISSING else line for line in self.lines]
        return replace(self, lines=_weakest_first(lines))


def grades_in_words(noiseless_percent: float | None = None) -> str:
    """Return what the grades stand for.

    Parameters
    ----------
    noiseless_percent
        Limit of a good model's error where no noise is known [% of the joint's torque];
        None where it is known.

    Returns
    -------
    str
        A sentence for each grade.
    """
    limit = f"{ABOVE_NOISE:g} times its noise"
    beyond = " beyond its noise"
    if noiseless_percent is not None:
        limit = f"{noiseless_percent:g} % of its torque, since no noise is known"
        beyond = ""
    return (
        f"Good: each joint errs by at most {limit}, and on motion that is new the arm by"
        f" at most {100.0 * CHANGES:g} % of its torque{beyond}; nothing of the log is in"
        " doubt, no effect is surely missing, and the links can exist. Do not use: a"
        f" joint errs by more than {NO_MODEL:g} % of its torque{beyond}. Usable: all"
        " between."
    )


#: What is said of a model without a verdict.
NOT_JUDGED = (
    "Verdict: not judged on any measurements; `sdp-vs-penalty compare` judges it."
)


def judge(
    *,
    errors: ErrorsBesideNoise,
    r2: Array,
    noise_source: str,
    new_share: float | None,
    outside: float,
    certificate: Certificate,
    masses: Array,
    nominal: Array,
    judged_on: Sequence[str],
    forward: str = "",
    remark: str = "",
    seconds: float | None = None,
    doubt: str = "",
    highest: float | None = None,
    determined: tuple[int, int] = (0, 0),
) -> Verdict:
    """Judge a model by its errors, its certificate, and identified and nominal masses
    (links,) [kg].

    Parameters
    ----------
    errors : ErrorsBesideNoise
        Error, noise and torque of each joint.
    r2 : (n,) array
        Coefficient of determination of each joint [-]; negative: worse than the mean.
    noise_source : str
        Origin of the floor: "repetition" or "spectrum".
    new_share : float or None
        Share of rows whose motion the model has not seen; None where not recorded.
    outside : float
        Largest share of rows outside of a measured curve's table.
    certificate : Certificate
        Violations and gap of the model.
    forward : str
        Sentence of a forward simulation, or "".
    remark : str
        Sentence on windows of a long recording, or "".
    seconds : float, optional
        Length of the filtered motion [s].
    doubt : str
        What the data check leaves in doubt (:func:`doubt_of_log`), or "".
    highest : float, optional
        Largest error [%] that motion of this length does not rule out.
    determined : pair of int
        Number of base parameters that the data determine, and of all; (0, 0): unknown.

    Returns
    -------
    Verdict
        Lines on fit, prediction, missing effects and doubts of the log, weakest first.
    """
    over = errors.over_noise
    fit = _fit(errors, noise_source, is_worse_than_constant=np.asarray(r2) < 0.0)
    impossible = implausible(certificate, masses, nominal)
    links = impossible or ("The links can exist." if len(masses) > 0 else "")
    missing_line = _missing_line(
        _missing_by_errors(fit, over),
        is_complete=fit.grade == "good",
        links=links,
        links_are_possible=not impossible,
    )
    end = "."
    if outside > 0.0:
        share = f"{100.0 * outside:.0f} %"
        end = f"; {share} of the rows lie outside of a measured curve's table."
    if forward:
        end = f"{end} {forward}"
    prediction = _prediction(
        errors,
        share=new_share,
        far=outside > CHANGES or over is None,
        end=end,
        seconds=seconds,
        highest=highest,
        determined=determined,
    )
    lines = [fit, prediction, missing_line]
    if doubt:
        lines.insert(0, Line(LOG, "usable", doubt))
    return Verdict(
        lines=_weakest_first(lines),
        error_over_noise=None if over is None else tuple(map(float, over)),
        noise_source="" if over is None else noise_source,
        judged_on=tuple(judged_on),
        remark=remark,
        links=links,
        links_are_possible=not impossible,
    )


def _missing_line(
    text: str, *, is_complete: bool, links: str, links_are_possible: bool
) -> Line:
    """Return the line on missing effects and on the links.

    ``text`` says what is missing; ``is_complete`` that nothing is; ``links`` is a
    sentence on the links, which comes first if they cannot exist.
    """
    if not links_are_possible:
        return Line(MISSING, "do not use", f"{links} {text}")
    grade: Grade = "good" if is_complete else "usable"
    return Line(MISSING, grade, f"{text} {links}".rstrip())


def _weakest_first(lines: Sequence[Line]) -> tuple[Line, ...]:
    """Sort lines by grade, the weakest first. Lines of one grade stand in the order
    log, fit, prediction, what is missing."""
    order = (LOG, FIT, PREDICTION, MISSING)
    return tuple(
        sorted(
            lines, key=lambda line: (GRADES.index(line.grade), order.index(line.about))
        )
    )


def doubt_of_log(issues_by_run: Mapping[str, Sequence[IssueInWords]]) -> str:
    """Return a sentence on what the data check leaves in doubt of the training runs.

    Parameters
    ----------
    issues_by_run : mapping of str to sequence of IssueInWords
        Issues by run, as a model keeps them.

    Returns
    -------
    str
        The sentence; "" without doubts.
    """
    issues = [issue for issues in issues_by_run.values() for issue in issues]
    doubts = [issue.in_doubt for issue in issues if issue.severity != "note"]
    words = [*dict.fromkeys(filter(None, doubts))]
    if not words:
        return ""
    return f"{_IN_DOUBT}{formatting.words(words)}; `check` says what to do."


def doubts_in_words(verdict: Mapping[str, Any] | None) -> str:
    """Return what a verdict, as plain JSON, says to be in doubt of the log: issues of older
    files do not say it themselves. It is all that :func:`doubt_of_log` puts together."""
    lines = (verdict or {}).get("lines", ())
    text = next((line["text"] for line in lines if line["about"] == LOG), "")
    return str(text).removeprefix(_IN_DOUBT).partition(";")[0]


@dataclass(frozen=True)
class ErrorsBesideNoise:
    """Errors of a model, joint by joint, beside noise and torque. Every multiple of a
    noise, and every share of a joint's torque, is computed here."""

    #: (n,) root mean square error [N m or N].
    rmse: Array
    #: (n,) noise floor [N m or N]; None where it is not known.
    floor: Array | None
    #: (n,) root mean square of the measured torque [N m or N].
    torque: Array
    #: Unit of each joint's torque, such as "N*m".
    units: tuple[str, ...]
    #: What stands beside an error that is not of unseen motion, such as "on training
    #: motion"; "" for unseen motion.
    kind: str = ""

    @property
    def over_noise(self) -> Array | None:
        """(n,) error over noise floor; None without a floor."""
        return over_noise(self.rmse, self.floor)

    @property
    def exceeds_noise(self) -> Mask:
        """(n,) whether an error is more than ABOVE_NOISE times its noise; without a
        floor, whether there is an error."""
        over = self.over_noise
        return np.asarray(self.rmse > 0.0 if over is None else over > ABOVE_NOISE)

    @property
    def relative(self) -> float:
        """100 |rmse| / |torque| of all joints together [%]; infinite for an error
        without any torque."""
        return _percent_of_all(self.rmse, self.torque)

    @property
    def beyond_noise(self) -> Array:
        """(n,) 100 sqrt(rmse^2 - floor^2) / torque [%], at least 0; without a floor the
        whole error counts."""
        floor = np.zeros_like(self.rmse) if self.floor is None else self.floor
        beyond = np.sqrt(np.maximum(self.rmse**2 - floor**2, 0.0))
        return _percent(beyond, self.torque)

    @property
    def beyond_noise_of_all(self) -> float:
        """The same of all joints together: root of the sum of squares over that of
        torques [%]."""
        return _percent_of_all(self.beyond_noise / 100.0 * self.torque, self.torque)

    def worst_of(self, joints: Sequence[int]) -> int:
        """Return which of these joints (from 1) errs most: by the most times its noise,
        or, without a noise floor, by the largest share of its torque."""
        return max(joints, key=lambda joint: float(self._sizes[joint - 1]))

    @property
    def _sizes(self) -> Array:
        """(n,) errors in the measure by which joints are compared."""
        over = self.over_noise
        return self.beyond_noise if over is None else over

    @property
    def worst_joint(self) -> int:
        """The joint (from 1) that errs most; where some make a model unusable, the one of
        these. Every text names that one."""
        return self.worst_of(self.unusable or range(1, len(self.rmse) + 1))

    @property
    def size(self) -> float:
        """The largest error of a joint, by which models of the same runs are compared: in
        multiples of its noise, without a noise floor in % of its torque; 0 where all
        errors count as noise."""
        return float(self._sizes.max()) if self.exceeds_noise.any() else 0.0

    @property
    def size_in_words(self) -> str:
        """The error of the joint that errs most, by the measure that it is graded by, as it
        stands beside a grade."""
        if not self.exceeds_noise.any():
            return "within noise"
        worst = self.worst_joint
        if self.over_noise is None or worst in self.unusable:
            return f"{number(float(self.beyond_noise[worst - 1]))} % of its torque"
        return f"{number(float(self._sizes[worst - 1]))} times its noise"

    @property
    def graded_share(self) -> Array:
        """(n,) what decides whether a model is to be used: the error beyond the noise
        [% of the joint's torque]; 0 within ABOVE_NOISE of the noise, which counts as
        noise."""
        return np.where(self.exceeds_noise, self.beyond_noise, 0.0)

    @property
    def unusable(self) -> list[int]:
        """The joints (from 1) whose error is over NO_MODEL of their torque."""
        is_unusable = ~(self.graded_share <= NO_MODEL)
        return (np.flatnonzero(is_unusable) + 1).tolist()

    def words(self, joint: int) -> str:
        """Return the error of a joint (from 1) in its unit, in multiples of its noise
        where that is known, and of what kind it is.
        """
        unit = formatting.plain_unit(self.units[joint - 1])
        error = float(self.rmse[joint - 1])
        over = self.over_noise
        text = formatting.quantity(error, unit)
        if over is not None:
            text = formatting.times_noise(float(over[joint - 1]), error, unit)
        return f"{text}, {self.kind}" if self.kind else text

    def joint_errs(self, joint: int) -> str:
        """Say by how much a joint (from 1) errs: by the measure that it is graded by, with
        the limit of that, and in its unit."""
        over = self.over_noise
        measures = (
            []
            if over is None
            else [f"{number(float(over[joint - 1]))} times its noise"]
        )
        limit = f"good is up to {ABOVE_NOISE:g} times"
        is_unusable = joint in self.unusable
        if over is None or is_unusable:
            share = float(self.beyond_noise[joint - 1])
            is_measured = bool(np.isfinite(share))
            of_torque = f"{number(share)} % of its torque"
            measures.append(of_torque if is_measured else "no torque was measured")
            limit = f"good or not is open, since {NOISE_UNKNOWN}"
        if is_unusable:
            limit = f"usable is up to {NO_MODEL:g} %"
        unit = formatting.plain_unit(self.units[joint - 1])
        size = formatting.quantity(float(self.rmse[joint - 1]), unit)
        size = ", ".join(filter(None, (size, self.kind)))
        most = " most" if len(self.rmse) > 1 else ""
        return f"Joint {joint} errs{most}: {', '.join(measures)} ({size}); {limit}"

    def within_noise_in_words(self, worst: int) -> str:
        """Say that no joint errs by more than joint ``worst`` (from 1), in multiples of
        its noise."""
        text = formatting.within_noise(
            float(np.asarray(self.over_noise)[worst - 1]),
            worst,
            float(self.rmse[worst - 1]),
            formatting.plain_unit(self.units[worst - 1]),
            self.kind,
        )
        return formatting.sentence(text)

    def share_in_words(self) -> str:
        """Say which joints are unusable, and by how much the worst one errs."""
        joints, worst = self.unusable, self.worst_joint
        text = self.joint_errs(worst)
        others = [joint for joint in joints if joint != worst]
        if others:
            text += f"; more than that: {formatting.joints(others)}"
        return text


def _percent(part: Array, whole: Array) -> Array:
    """Return 100 part / whole (n,); 0 where both are zero, infinite where only the
    whole is."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(part > 0.0, 100.0 * part / whole, 0.0)


def _percent_of_all(part: Array, whole: Array) -> float:
    """Return 100 |part| / |whole| of all joints together."""
    norms = [np.atleast_1d(np.linalg.norm(x)) for x in (part, whole)]
    return float(_percent(*norms)[0])


def _fit(errors: ErrorsBesideNoise, source: str, is_worse_than_constant: Mask) -> Line:
    """Return the verdict's line on how well the model fits the torque.

    ``errors`` of the joints; ``source``: origin of the noise; ``is_worse_than_constant``
    (n,): joints for which a constant torque fits better (R^2 < 0).
    """
    over = errors.over_noise
    unusable = errors.unusable
    grade: Grade = "do not use" if unusable else "usable"
    if unusable:
        sentence = errors.share_in_words()
        sentence += f"; {NOISE_UNKNOWN}" if over is None else ""
    else:
        worst = errors.worst_joint
        sentence = errors.joint_errs(worst)
        if over is not None and over[worst - 1] <= ABOVE_NOISE:
            grade = "good"
            sentence = errors.within_noise_in_words(worst)
        if grade == "good" and not source:  # it is negligible, whatever the noise
            share = number(float(np.max(100.0 * errors.rmse / errors.torque)))
            known = "the torque of no arm is known better"
            sentence = f"No joint errs by more than {share} % of its torque; {known}"
    if over is not None and source == SPECTRUM:
        sentence += NOISE_OF_SPECTRUM
    # Within the noise, a bad fit of a joint's torque is no fault.
    is_worse_than_constant = is_worse_than_constant & errors.exceeds_noise
    if is_worse_than_constant.any():
        grade = min(grade, "usable", key=GRADES.index)
        joints = (np.flatnonzero(is_worse_than_constant) + 1).tolist()
        sentence += f"; {formatting.joints(joints)}: worse than a constant torque"
    return Line(FIT, grade, f"{sentence}.")


def _prediction(
    errors: ErrorsBesideNoise,
    share: float | None,
    far: bool,
    end: str,
    seconds: float | None,
    highest: float | None,
    determined: tuple[int, int],
) -> Line:
    """Return the verdict's line on the prediction of motion that was not fitted; where
    hardly any of the motion is new, it says that nothing is known of that.

    - ``errors``: those of the joints.
    - ``share``: share of new motion; None if the model does not record its own.
    - ``far``: whether rows lie outside of a measured curve's table, or the noise is
      unknown.
    - ``end``: end of the sentence.
    - ``seconds``: length of the motion [s].
    - ``highest``: largest error [%] that motion of this length does not rule out.
    - ``determined``: number of base parameters that the data determine, and of all.
    """
    if share is None or share < MOSTLY_NEW:
        how_new = "the model does not record its own motion"
        if share is not None:
            how_new = f"{formatting.percent(share, 2)} of this motion is new"
        return _prediction_unknown(errors, how_new, end, determined)
    # "good" needs a small error and enough motion to know it.
    grade: Grade = "usable"
    length = "" if seconds is None else f": {seconds:.3g} s"
    sentence = (
        f"the whole arm errs by {errors.relative:.3g} % of its torque on motion not used"
        f" for fitting{length}, {formatting.percent(share, 2)} of it new"
    )
    limit = 100.0 * CHANGES
    if errors.unusable:
        grade = "do not use"
        sentence = f"{errors.share_in_words()}; {sentence}"
    elif errors.beyond_noise_of_all <= limit and not far:
        if highest is None or highest <= limit:
            grade = "good"
        else:
            sentence = f"too short to tell: {sentence}"
            if np.isfinite(highest):
                sentence += f"; so little does not rule out {highest:.2g} %"
    return Line(PREDICTION, grade, formatting.sentence(sentence + end))


def _prediction_unknown(
    errors: ErrorsBesideNoise, how_new: str, end: str, determined: tuple[int, int]
) -> Line:
    """Return the line of a model that was scored on motion like that of its training.

    ``how_new`` says how much of the motion is new; the rest as :func:`_prediction`
    takes it.
    """
    begin = f"{errors.share_in_words()}; scored on" if errors.unusable else "Scored on"
    sentence = (
        f"{begin} motion like that of training ({how_new}); run `compare` on a new"
        " recording"
    )
    n_determined, n_base = determined
    is_open = n_determined < MOSTLY_DETERMINED * n_base
    if is_open:
        sentence = (
            f"The data determine {n_determined} of {n_base} base parameters: other"
            f" motion is predicted by what was known before. {sentence}"
        )
    grade: Grade = "do not use" if errors.unusable or is_open else "usable"
    return Line(PREDICTION, grade, sentence + end)


def _missing_by_errors(fit: Line, over: Array | None) -> str:
    """Return the sentence on missing effects that follows from the torque errors alone.

    ``fit`` is the verdict's line on the fit; ``over`` (n,) the error of each joint over
    its noise, None if the noise is unknown.
    """
    if fit.grade == "good":
        return "Nothing beyond the noise; `diagnose` looks below it."
    if over is None:
        return "Not known without a noise floor; `diagnose` names causes."
    above = (np.flatnonzero(over > ABOVE_NOISE) + 1).tolist()
    where = f" on {formatting.joints(above)}" if above else ""
    return f"Torque beyond the noise{where}; `diagnose` names causes."


def implausible(certificate: Certificate, masses: Array, nominal: Array) -> str:
    """Return the reason why the links are not physically plausible, "" if they are.

    Identified ``masses`` and ``nominal`` are (links,) [kg].

    Parameters
    ----------
    certificate : Certificate
        Violations and gap of the model.

    Returns
    -------
    str
        A sentence for the first of: optimum not found, violated constraints, a radius
        of gyration beyond the body, a link that weighs next to nothing.
    """
    if certificate.not_found:
        return certificate.not_found
    # 1. Constraints are violated; bounds on barycentric inertias are not convex, so
    # that most methods do not impose them.
    violation_by_family = {
        k: v for k, v in certificate.violations.items() if k != BarycentricBound.family
    }
    family = max(
        violation_by_family, key=lambda name: violation_by_family[name], default=""
    )
    if violation_by_family.get(family, 0.0) > ROUNDING:
        return (
            f"No robot is like this: constraints are violated ({family} by"
            f" {violation_by_family[family]:.2g})."
        )
    # 2. A radius of gyration exceeds the link's body.
    if certificate.body_share is not None and certificate.body_share > 1.0 + 1e-6:
        return "A link's mass lies farther out than its body reaches."
    # 3. A link weighs next to nothing, though its nominal mass says otherwise.
    lightest = _LIGHTEST * float(np.sum(masses))
    light = [i + 1 for i, m in enumerate(masses) if m < lightest < 10.0 * nominal[i]]
    if light:
        words = "Links {} weigh" if len(light) > 1 else "Link {} weighs"
        share = f"less than a thousandth of the arm ({float(np.sum(masses)):.3g} kg)"
        allowed = "constraints allow that, but no arm is built so"
        return f"{words.format(formatting.words(light))} {share}: {allowed}."
    return ""


def changes(
    before: Array, after: Array, floor: Array | None, units: Sequence[str] = ()
) -> str:
    """Describe the changes of the joints' errors, the largest fall first.

    Joints that got worse by more than 5 % come last. Errors are in multiples of the
    noise where it is known, and in N m or N.

    Parameters
    ----------
    before : (n,) array
        Errors of the model [N m or N].
    after : (n,) array
        Errors of the extended model [N m or N].
    floor : (n,) array or None
        Noise floor [N m or N].
    units : sequence of str
        Torque unit of each joint; empty: "N m or N".

    Returns
    -------
    str
        A sentence; "" if no error changed by more than 5 %.
    """
    # Relative changes (n,); infinite where an error begins at zero.
    with np.errstate(divide="ignore", invalid="ignore"):
        share = np.where(
            before > 0.0, after / before - 1.0, np.where(after > 0.0, np.inf, 0.0)
        )
    ratios = over_noise(np.stack([before, after]), floor)

    def words(j: int) -> str:
        """Return one joint's errors before and after, and the change in per cent."""
        amount = formatting.errors_with_noise(
            [float(before[j]), float(after[j])],
            None if ratios is None else ratios[:, j].tolist(),
            formatting.plain_unit(units[j]) if units else "N m or N",
            " -> ",
        )
        if not np.isfinite(share[j]):
            return amount
        return f"{amount} ({100.0 * float(share[j]):+.0f} %)"

    order = np.argsort(share)
    better = [f"joint {j + 1}: {words(j)}" for j in order if share[j] < -CHANGES]
    worse = [
        f"joint {j + 1} worse: {words(j)}" for j in order[::-1] if share[j] > CHANGES
    ]
    return f"{'; '.join([*better, *worse])}." if better or worse else ""


def over_noise(
    rmse: Array, floor: Array | Sequence[float | None] | None
) -> Array | None:
    """Return the ratio of each joint's error and its noise floor: the one place where
    multiples of a noise are computed.

    Parameters
    ----------
    rmse : (n,) or (models, n) array
        Errors [N m or N].
    floor : (n,) array or sequence, or None
        Noise floor [N m or N]; None where it is not known.

    Returns
    -------
    array of the same shape, or None
        Ratios; 1 where error and noise are both zero. None without a floor, or where
        the floor of a joint with an error is zero: that is no noise.
    """
    if floor is None or any(noise is None for noise in floor):
        return None
    noise = np.asarray(floor, float)
    is_zero = ~(noise > 0.0)
    if np.any((rmse > 0.0) & is_zero):
        return None
    return np.where(is_zero, 1.0, rmse / np.where(is_zero, 1.0, noise))


@dataclass(frozen=True)
class NoiseFloor(JsonRecord):
    """What :func:`noise_level` says of measurements with this hash."""

    floor: Array | None
    source: str
    data_hash: str


def noise_level(
    problem: Problem, filtered_runs: FilteredRuns
) -> tuple[Array | None, str]:
    """Estimate the standard deviation of the torque noise below the cut-off.

    Where motion repeats with period T, from differences r(t) - r(t + T) of the residual
    r of unconstrained least squares in the problem's effects; so the floor does not
    depend on the model that is judged. Elsewhere from the torque's spectrum above the
    motion's band (:mod:`~signals.noise`), at most that residual. Windows of a
    recording have the noise of all of it; of long recordings windows are used.

    Returns
    -------
    (n,) array or None
        Noise floor [N m or N]; None if the logs do not show it.
    str
        "repetition" or "spectrum"; "" without a floor.
    """
    settings = filtered_runs.settings
    windows = window_subsample(filtered_runs.measurements.recording, settings)
    filtered = (
        filtered_runs
        if windows is filtered_runs.measurements
        else FilteredRuns.filtering(windows, settings)
    )
    runs = segmented(windows, settings)
    if not runs.segments:
        return None, ""
    model = problem.model().reference_free
    theta = make_task(
        problem, model, regression=compress(filtered, model), weighting="none"
    ).ols
    noise = noise_of(
        runs.with_model(lambda m: model.seen_along(theta, m), gains=model.gains)
    )
    return (None, "") if noise.source == RESIDUAL else (noise.floor, noise.source)
