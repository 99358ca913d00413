"""What a diagnosis consists of: findings, verdict, noise, and errors on data left out."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal, Self, TypeVar

import numpy as np

from sdp_vs_penalty import formatting
from sdp_vs_penalty.diagnosis.curves.curve import Curve
from sdp_vs_penalty.diagnosis.doubts import Doubt
from sdp_vs_penalty.diagnosis.finding import ERRORS_OF_STEP, Finding, Retune
from sdp_vs_penalty.diagnosis.notices import Notice
from sdp_vs_penalty.diagnosis.passing.cause import PassingCause, Span, spans_in_words
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.estimation.verdict import ABOVE_NOISE, over_noise
from sdp_vs_penalty.formatting import plain_unit
from sdp_vs_penalty.records import JsonRecord
from sdp_vs_penalty.results.facts import fact
from sdp_vs_penalty.results.record import Record
from sdp_vs_penalty.results.remedy import Remedy
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.signals.noise import RESIDUAL

#: A finding or a re-estimated constant.
_Found = TypeVar("_Found", Finding, Retune)


@dataclass(frozen=True)
class Invisible(JsonRecord):
    """An effect whose torque the model's own parameters absorb: no such recording shows
    it."""

    #: Name of the effect.
    effect: str
    #: Numbers of the joints, from 1.
    joints: tuple[int, ...]
    #: Share of the squares of the effect's white torque that the parameters absorb.
    absorbed_share: float


@dataclass(frozen=True)
class Remaining(JsonRecord):
    """Unexplained torque on a joint."""

    #: Number of the joint, from 1.
    joint: int
    #: RMS of the unexplained torque [N m or N].
    rmse: float


@dataclass(frozen=True)
class ErrorWith(JsonRecord):
    """Errors on data left out of the model with some of what was found, as `add` takes
    it together."""

    #: What is added, as `add` writes it.
    effects: tuple[str, ...]
    #: (n,) RMS errors [N m or N].
    rmse: Array


@dataclass(frozen=True, repr=False)
class DiagnosisData(Record, JsonRecord):
    """What was found of a model, with its errors on data left out: all that words and
    offers are made of."""

    #: Whether an effect is missing, nothing is, or what is missing is unknown.
    verdict: Literal["effect_missing", "nothing_missing", "unknown_effect"]
    #: The findings in the order in which they are added.
    effects: tuple[Finding, ...]
    #: (n,) noise floor of the filtered torque [N m or N].
    noise_floor: Array
    #: Effects that no such recording shows.
    invisible: tuple[Invisible, ...]
    #: "repetition"; else "spectrum" or "residual", and abstention is weaker.
    noise_source: str
    #: (n,) repeatable error that is left, as a share of the noise's variance.
    unexplained: Array
    #: Frequency below which all errors are meant [Hz].
    band_hz: float
    #: Remarks on the diagnosis, a sentence each.
    remarks: tuple[str, ...]
    #: (n,) RMS errors on data left out of the model as it is [N m or N].
    held_out_rmse_before: Array
    #: Data of the held-out errors: "test" (a test run) or "folds" of the searched runs.
    held_out_source: str
    #: Whether the model's parameters were kept; :func:`add` keeps them then.
    frozen: bool
    #: Share of the test run's rows whose motion is not in the runs that were searched;
    #: None if unknown.
    new_motion_share: float | None = None
    #: Shape constants of the model's own effects that should change.
    retuned: tuple[Retune, ...] = ()
    #: What repeats and has no name, as functions of one variable or two.
    curves: tuple[Curve, ...] = ()
    #: What repeats and is unknown.
    remains: tuple[Remaining, ...] = ()
    #: (n,) units of the joints' torque.
    torque_units: tuple[str, ...] = ()
    #: Facts that the model's own parameters hold, such as a load that its file does not
    #: know.
    notices: tuple[Notice, ...] = ()
    #: What acts for a part of the runs only, such as a load that is carried.
    passing: tuple[PassingCause, ...] = ()
    #: Spans of the runs in which the check says that something acts.
    named_by_check: tuple[Span, ...] = ()
    #: Spans of the test run in which something does.
    left_out_of_test: tuple[Span, ...] = ()
    #: How long the arm stands still in the runs of the errors [s]; these rows are left
    #: out.
    standstill_left_out: float = 0.0
    #: What the check calls likely of the log, with the repair; nothing is sure beside
    #: it. None where a finding states the same.
    log_faults: tuple[Remedy, ...] = ()
    #: The errors with what each remedy adds, with the first findings of the list, with
    #: pairs of what helps, and with each law that a file holds in place of a finding.
    #: Files of format 2 have those of the first findings alone.
    errors_with: tuple[ErrorWith, ...] = ()

    @classmethod
    def upgraded(cls, data: Mapping[str, Any]) -> Mapping[str, Any]:
        """Read the errors with the first findings of the list of formats up to 3, where
        each finding has them."""
        if "held_out_rmse" not in data:
            return data
        findings = data["effects"]
        texts = [found["text"] for found in (*data.get("retuned", ()), *findings)]
        errors = [*(f[ERRORS_OF_STEP[0]] for f in findings), data["held_out_rmse"]]
        n_constants = len(texts) - len(findings)
        steps = [
            {"effects": texts[: n_constants + k], "rmse": rmse}
            for k, rmse in enumerate(errors)
        ]
        return {**data, "errors_with": [*steps, *data.get("errors_with", ())]}

    def __post_init__(self) -> None:
        """Number the findings."""
        numbered = (replace(f, number=k) for k, f in enumerate(self.effects, start=1))
        object.__setattr__(self, "effects", tuple(numbered))

    @property
    def scope(self) -> str:
        """Which errors are meant: below the low-pass, and what is left out."""
        return formatting.scope_of_errors(self.band_hz, self.standstill_left_out)

    def torque_unit(self, joint: int) -> str:
        """Unit of the torque of a joint (from 1); "N m or N" where files of older
        versions do not say it."""
        if not self.torque_units:
            return "N m or N"
        return plain_unit(self.torque_units[joint - 1])

    def beside_faults_of_log(self, faults: Sequence[Remedy]) -> Self:
        """Return the diagnosis of a log that is likely wrong: every finding is weak, and
        neither curves nor spans are drawn. Without any fault it is the diagnosis itself.
        """
        if not faults:
            return self
        return replace(
            self._with_doubt(Doubt("log")),
            log_faults=tuple(faults),
            curves=(),
            passing=(),
            named_by_check=(),
            left_out_of_test=(),
        )

    def beside_explanation_of_log(
        self, kind: str, sentence: str, joints: Sequence[int]
    ) -> Self:
        """Return the diagnosis of a log of which the check explains the torque of some
        joints (from 1; none named: of all) by a fault of the log.

        Each finding there becomes doubtful, for the fault explains the same torque.
        Curves there are left out: they show torque that nothing explains.

        kind : of the fault, in words, "torque step"; sentence : what the check says of it.
        """
        explanation = sentence[:1].lower() + sentence[1:].rstrip(".")
        cause = f"the check explains its torque as well, by a {kind}: {explanation}"
        doubted = self._with_doubt(Doubt("explained", cause), joints)
        unexplained = [c for c in self.curves if joints and c.joint not in joints]
        return replace(doubted, curves=tuple(unexplained))

    def _with_doubt(self, doubt: Doubt, joints: Sequence[int] = ()) -> Self:
        """Return the diagnosis with one more doubt of the findings and constants on some
        joints (from 1; none named: on all), and of those on the whole robot."""

        def with_doubt(found: _Found, on: Sequence[int]) -> _Found:
            """Return a finding or a constant, with the doubt if it is on the joints."""
            is_elsewhere = joints and on and set(joints).isdisjoint(on)
            if is_elsewhere:
                return found
            doubts = *found.doubts, doubt
            return replace(found, doubts=doubts)

        return replace(
            self,
            effects=tuple(with_doubt(f, f.joints) for f in self.effects),
            retuned=tuple(with_doubt(r, r.joints) for r in self.retuned),
        )

    def selected(
        self,
        numbers: Sequence[float] | None = None,
        helpful: bool = False,
        confident: bool = False,
    ) -> Self:
        """Return the diagnosis with some of its findings only.

        Re-estimated constants have no number: none stays beside numbers, since nothing is
        added that was not chosen. Measured curves stay only with all findings, beside
        which they were measured.

        Parameters
        ----------
        numbers
            Numbers of the findings (from 1, in the order of the list); default: all.
        helpful
            True: only findings whose torque is certain.
        confident
            True: of these only those whose name is confident.

        Returns
        -------
        Self
            The same diagnosis with fewer findings.

        Raises
        ------
        InputError
            A number does not exist, or nothing is left.
        """
        _refuse_unknown(numbers or (), len(self.effects))

        def is_wanted(found: Finding | Retune) -> bool:
            """Return whether it helps, and has a confident name, where that is asked."""
            helps = found.torque_is_certain or not (helpful or confident)
            return helps and (found.rating == "confident" or not confident)

        chosen = [
            finding
            for finding in self.effects
            if (numbers is None or finding.number in numbers) and is_wanted(finding)
        ]
        retuned = [r for r in self.retuned if numbers is None and is_wanted(r)]
        has_all = numbers is None and len(chosen) == len(self.effects)
        curves = self.curves if has_all else ()
        if not (chosen or retuned or curves or self.left_out):
            kind = "finding"
            if (helpful or confident) and self.effects:
                kind = "confident finding" if confident else "finding that helps"
            raise InputError(
                f"there is no {kind} to add",
                "name the effect itself, or leave the model as it is",
            )
        return replace(
            self, effects=tuple(chosen), retuned=tuple(retuned), curves=curves
        )

    def with_judged_errors(self, before: Array, after: Array | None) -> Self:
        """Replace the errors of the search on the test run by those of the final
        models.

        The search fits by least squares; `compare` and `add` fit by the model's own
        method, and print slightly different numbers. The errors of other selections
        change by the same share: of those that hold all that helps as its error, of
        others as the model's.

        Parameters
        ----------
        before
            (n,) errors of the model [N m or N].
        after
            (n,) errors of the model with all findings whose torque is certain; None where
            no such model is made, and its errors change as the model's.
        """
        helpful = tuple(f.text for f in self.helpful)
        scale = _ratio(before, self.held_out_rmse_before)
        with_helpful = self.left_error
        if after is None:
            after = scale * with_helpful
        of_helpful = _ratio(after, with_helpful)
        judged = {
            x.effects: x.rmse * (of_helpful if {*helpful} <= {*x.effects} else scale)
            for x in self.errors_with
        }
        judged[helpful] = after
        return replace(self, held_out_rmse_before=before).with_errors(judged)

    def with_errors(self, errors: Mapping[tuple[str, ...], Array]) -> Self:
        """Return the diagnosis with further errors on data left out (n,), by the texts of
        what is added [N m or N], in whatever order; those of a constant are of the model
        with it alone. Errors of what has some already take their place."""
        by_set = {frozenset(x.effects): x for x in self.errors_with}
        by_set |= {frozenset(x): ErrorWith(x, error) for x, error in errors.items()}
        found = replace(self, errors_with=tuple(by_set.values()))
        constants = []
        for constant in self.retuned:
            after = found.error_with([constant.text])
            if after is not None:
                j = constant.joint - 1
                was, now = float(self.held_out_rmse_before[j]), float(after[j])
                constant = replace(constant, rmse_before=was, rmse_after=now)
            constants.append(constant)
        return replace(found, retuned=tuple(constants))

    def error_with(self, texts: Collection[str]) -> Array | None:
        """Return the errors (n,) on data left out of the model with some of what was found,
        as :func:`add` takes it, and nothing else [N m or N]; None where they were not
        computed."""
        added = {*texts}
        return next((x.rmse for x in self.errors_with if {*x.effects} == added), None)

    @cached_property
    def ladder(self) -> tuple[Array, ...]:
        """The errors (n,) on data left out with all re-estimated constants and the first
        0, 1, ... findings of the list [N m or N]; where they were not computed, those of
        the step before."""
        texts = [*(r.text for r in self.retuned), *(f.text for f in self.effects)]
        steps = [self.held_out_rmse_before]
        for k in range(len(self.effects) + 1):
            errors = self.error_with(texts[: len(self.retuned) + k])
            steps.append(steps[-1] if errors is None else errors)
        return tuple(steps[1:])

    @fact("times the noise", name="error on data left out")
    def left_over_noise(self) -> Array | None:
        """(n,) error of each joint on data left out, with all that helps, over its
        noise floor; unknown where the noise is not known."""
        return over_noise(self.left_error, self.known_floor)

    @fact("N m or N", name="error on data left out in N m or N")
    def left_error(self) -> Array:
        """(n,) error of each joint on data left out, with all that helps."""
        # Of the model that the next step makes: with the curves where these stay.
        takes_curves = bool(self.curves) and not self.leaves_curves_out
        if not (self.helpful or takes_curves):
            return self.held_out_rmse_before
        errors = self.error_with([found.text for found in self.helpful])
        if errors is None or takes_curves:
            errors = self.ladder[-1].copy()
            for curve in self.curves:
                errors[curve.joint - 1] = curve.held_out_rmse_after
        return errors

    @fact("N m or N", name="noise floor")
    def joint_noise(self) -> Array:
        """(n,) standard deviation of the torque's noise behind the same low-pass; an
        estimate where no motion repeats."""
        return self.noise_floor

    @property
    def left_out(self) -> tuple[Span, ...]:
        """The spans of the runs in which something acts for a time, which no model is
        identified from."""
        of_causes = (span for cause in self.passing for span in cause.spans)
        return (*of_causes, *self.named_by_check)

    @property
    def acting_for_a_time(self) -> tuple[str, ...]:
        """What acts for a part of the time, a clause each."""
        sentences = [cause.sentence for cause in self.passing]
        if self.named_by_check:
            named = spans_in_words(self.named_by_check)
            sentences.append(f"what `check` names {named}")
        return tuple(sentences)

    @property
    def helpful(self) -> tuple[Finding | Retune, ...]:
        """The re-estimated constants and findings whose torque is certain: what should
        be added.
        """
        candidates: tuple[Finding | Retune, ...] = (*self.retuned, *self.effects)
        return tuple(f for f in candidates if f.torque_is_certain)

    @property
    def leaves_curves_out(self) -> bool:
        """Whether what helps is added without the measured curves: these were measured
        beside weak findings, which would be added as well.
        """
        are_certain = [f.torque_is_certain for f in self.beside_curves]
        return bool(self.curves) and not all(are_certain)

    @property
    def noise_known(self) -> bool:
        """Whether the noise was measured separately from the model's error.

        True for noise from repetitions, and from a spectrum, which shows it roughly
        (SPECTRUM_KNOWN). False if it was taken from the residual itself.
        """
        return self.noise_source != RESIDUAL

    @property
    def known_floor(self) -> Array | None:
        """(n,) noise floor [N m or N]; None where the residual was taken for noise."""
        return self.noise_floor if self.noise_known else None

    @property
    def joints_above_noise(self) -> list[int]:
        """Joints (from 1) whose error, with all that helps added, exceeds ABOVE_NOISE
        times the noise floor; empty if the noise is not known.
        """
        over = self.left_over_noise
        if over is None:
            return []
        return [int(j) + 1 for j in np.flatnonzero(over > ABOVE_NOISE)]

    @property
    def is_undetermined(self) -> bool:
        """Whether joints err above their noise on data left out alone: the model fitted
        to all of the data explains them."""
        joints = [joint - 1 for joint in self.joints_above_noise]
        left = 1.0 + self.unexplained[joints]
        return bool(joints) and bool(np.all(left <= ABOVE_NOISE**2))

    @property
    def beside_curves(self) -> tuple[Finding, ...]:
        """The findings that no measured curve replaces."""
        return tuple(f for f in self.effects if not (self.curves and f.fits_a_curve))


def _refuse_unknown(numbers: Sequence[float], n_findings: int) -> None:
    """Raise InputError if one of the numbers is not that of a finding, counted from 1."""
    for number in numbers:
        if number not in range(1, n_findings + 1):
            raise InputError(
                f"finding {number:g} does not exist, there are {n_findings}",
                "number them from 1 in the order of the list",
            )


def _ratio(after: Array, before: Array) -> Array:
    """Return the ratio of errors (n,); 1 where there was none before."""
    return np.divide(after, before, out=np.ones(len(after)), where=before > 0.0)
