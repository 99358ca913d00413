"""What a diagnosis says: findings, verdict, and the JSON of both, there and back."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, Self, get_args

import numpy as np

from sdp_vs_penalty import formatting
from sdp_vs_penalty.diagnosis.curves.curve import CURVE, Curve
from sdp_vs_penalty.diagnosis.events import Event
from sdp_vs_penalty.effects import (
    FittedEffect,
    effect_name,
    effect_types,
    on_the_arm,
)
from sdp_vs_penalty.errors import InputError, command_line
from sdp_vs_penalty.estimation.constants import NORMAL_95
from sdp_vs_penalty.estimation.shapes import ShapeEstimate
from sdp_vs_penalty.estimation.verdict import ABOVE_NOISE
from sdp_vs_penalty.files import JsonRecord, read_json, require_format
from sdp_vs_penalty.formatting import plain_unit
from sdp_vs_penalty.results.facts import fact
from sdp_vs_penalty.results.record import Record, Summary
from sdp_vs_penalty.results.table import Table
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.signals.noise import REPETITION, RESIDUAL, SPECTRUM, SPECTRUM_KNOWN

if TYPE_CHECKING:
    import pandas


#: Of findings.json.
FINDINGS_FORMAT = 1
#: What is said where no motion repeats: the residual was taken for noise, which it then
#: equals.
NOISE_UNKNOWN = (
    "is not known: no motion repeats, so noise and model error cannot be separated."
)
#: What is said of a weak finding, by the name of the reason; a finding with none is
#: confident.
REASONS: Mapping[str, str] = {
    "rivals": "another effect fits as well",
    "uncertain": "its size is uncertain by > 20 %",
    "insignificant": "its size is not told from zero",
    "small": "its gain is small",
    "not_held_out": "adding it lowers no joint's error on data left out by 1 %",
    "alone": "what is sure raises a held-out error with it",
    "more_left": "more error is left on its joints than it explains",
    "shared": "other findings share most of its torque: only their sum is known",
    "implausible": "its size is not plausible",
    "looks_like": "something else looks so",
    "curve": "a measured curve explains the joint better",
}


#: Reasons that leave open which of several effects makes how much of a torque, and not
#: whether it is there.
TORQUE_IS_CERTAIN = ("rivals", "uncertain", "insignificant", "more_left", "shared")

#: How far a finding is to be believed; see :attr:`Told.rating`.
Rating = Literal["confident", "near-tie", "weak"]


class Rated(JsonRecord):
    """What is told with its confidence, and why that is weak."""

    confidence: str
    remarks: tuple[str, ...]

    @property
    def rating(self) -> Rating:
        """ "near-tie" where the torque is there and only its name is open: weak for no
        other reason than that another effect fits as well."""
        if self.confidence == "confident":
            return "confident"
        only_rivals = list(self.remarks) == [REASONS["rivals"]]
        return "near-tie" if only_rivals else "weak"

    @property
    def torque_is_certain(self) -> bool:
        """Whether its torque is there, whatever its name or its size.

        It is confident, a near-tie, or weak only for what leaves open which of several
        effects makes how much of the torque.
        """
        if self.confidence == "confident":
            return True
        known = {REASONS[name] for name in TORQUE_IS_CERTAIN}
        return bool(self.remarks) and known.issuperset(self.remarks)


def is_law_of(name: str, other: str) -> bool:
    """Whether two names are of laws of one effect: one of them refines the other."""
    if name == other:
        return True
    types = effect_types()
    return name in types[other].refines or other in types[name].refines


def format_size(size: float, std: float, unit: str) -> str:
    """A size with its 95 % interval, as every place shows it.

    >>> format_size(3.1234, 0.25, "N m")
    '3.123 ± 0.49 N m (95 %)'
    """
    amount = f"{size:.4g} ± {NORMAL_95 * std:.2g} {plain_unit(unit)}".rstrip()
    return f"{amount} (95 %)"


@dataclass(frozen=True)
class Finding(Rated):
    """One missing effect.

    joints from 1, empty for the whole robot; size : of the effect's parameter (the
    amplitude where there are several) in ``unit``, with its standard deviation std;
    parameters : all of them by name; held_out_rmse_before, _after (n,) : cumulative
    along the ladder; text : how :func:`add` takes the effect; remarks : why the finding
    is weak, if it is; constants : the shape in words, with units.
    """

    effect: str
    joints: tuple[int, ...]
    shape: Mapping[str, float]
    size: float
    unit: str
    std: float
    parameters: Mapping[str, float]
    confidence: str
    indistinguishable_from: tuple[str, ...]
    held_out_rmse_before: Array
    held_out_rmse_after: Array
    explanation: str
    text: str
    gain: float
    remarks: tuple[str, ...] = ()
    constants: str = ""

    @property
    def size_text(self) -> str:
        """The size with its 95 % interval."""
        return format_size(self.size, self.std, self.unit)

    def to_dict(self) -> dict[str, Any]:
        """Plain JSON; half_width_95 : half the size's 95 % interval."""
        half = NORMAL_95 * self.std
        return super().to_dict() | {
            "rating": self.rating,
            "half_width_95": half if isfinite(half) else None,
        }

    @property
    def effect_is_certain(self) -> bool:
        """Whether the effect is there: the finding is confident, or a near-tie of laws of
        one effect, of which only the law is open."""
        if self.rating == "near-tie":
            return all(is_law_of(name, self.effect) for name in self._rival_effects)
        return self.rating == "confident"

    @property
    def _rival_effects(self) -> list[str]:
        """Names of the effects that fit as well, without joints and constants."""
        return [re.split("[:@]", name)[0] for name in self.rivals_without_curve]

    @property
    def on_the_arm(self) -> str:
        """What it is on the arm, in one sentence with its size."""
        fitted = FittedEffect(
            name=self.effect,
            joints=self.joints,
            size=self.size,
            unit=self.unit,
            parameters=self.parameters,
            shape=self.shape,
        )
        return on_the_arm(fitted)

    @property
    def physics(self) -> str:
        """What the effect is, in a sentence or two, without size and rivals."""
        text = self.explanation.partition(". ")[2]
        return text.partition(" Indistinguishable in these data from")[0]

    @property
    def rivals_without_curve(self) -> tuple[str, ...]:
        """The effects that fit as well."""
        return tuple(name for name in self.indistinguishable_from if name != CURVE)

    @property
    def undecided(self) -> str | None:
        """What a run should decide, as `excite --separate` takes it: between the
        finding and what fits as well, or whether a weak one is there at all. None for a
        confident one without rival, beside a curve, and where no motion decides
        (:attr:`cooled`)."""
        if CURVE in self.indistinguishable_from or self.cooled:
            return None
        named = self.indistinguishable_from if self.joints else ()
        if not named:
            return self.text if self.confidence == "weak" else None
        return f"{self.text},{named[0] if ':' in named[0] else f'{named[0]}:{self.joints[0]}'}"

    def telling_run(self, model: str, number: int) -> str:
        """The command that designs the run that tells what is undecided of a finding of
        a model.json, or which run does; "" where nothing is."""
        if self.undecided is None:
            return f"{self.cooled}." if self.cooled else ""
        words = [
            "excite",
            model,
            "--separate",
            self.undecided,
            "--out",
            f"tell{number}.csv",
        ]
        return command_line(["sdp-vs-penalty", *words])

    @property
    def main_joint(self) -> int:
        """The joint (from 1) that the finding is about: its first one, or of a finding
        of the whole robot the one whose error falls most."""
        if self.joints:
            return self.joints[0]
        before = np.maximum(self.held_out_rmse_before, 1e-300)
        return int(np.argmin(self.held_out_rmse_after / before)) + 1

    def explained_share(self, j: int) -> float:
        """Share of the error's variance on joint j (from 0) that it takes away."""
        before, after = self.held_out_rmse_before[j], self.held_out_rmse_after[j]
        return max(0.0, 1.0 - float(after / before) ** 2) if before > 0.0 else 0.0

    def gain_sentence(self, diagnosis: Diagnosis) -> str:
        """What adding it, after the findings before it, does to the error of its joint
        on data left out."""
        j = self.main_joint - 1
        before = float(self.held_out_rmse_before[j])
        after = float(self.held_out_rmse_after[j])
        is_lower = after < before
        errors = [before, after] if is_lower else [before]
        unit = diagnosis.torque_unit(j + 1)
        amount = f"{' to '.join(map(formatting.number, errors))} {unit}"
        if diagnosis.held_out_over_noise is not None:
            floor = float(diagnosis.noise_floor[j])
            times = [formatting.number(x / floor) for x in errors]
            amount = f"{' to '.join(times)} times the noise ({amount})"
        if is_lower:
            return (
                f"Adding it cuts joint {j + 1}'s error on data left out from {amount}."
            )
        return f"Adding it does not lower joint {j + 1}'s error on data left out: {amount}."

    @property
    def cooled(self) -> str:
        """The run that tells what follows the gears' temperature from what follows the
        clock, if that is what is open."""
        kinds = [
            effect_types()[re.split("[:@]", r)[0]]
            for r in self.indistinguishable_from
            if r != CURVE
        ]
        if effect_types()[self.effect].follows_clock or not any(
            k.follows_clock for k in kinds
        ):
            return ""
        return (
            "record one more run after the gears have cooled down; what follows their"
            " temperature is then as it was at first, what follows the clock is not"
        )


@dataclass(frozen=True)
class Invisible(JsonRecord):
    """An effect whose torque the model's own parameters absorb: no measurement like
    this shows it."""

    effect: str
    joints: tuple[int, ...]
    absorbed_share: float


@dataclass(frozen=True)
class Remaining(JsonRecord):
    """Something unknown on a joint (from 1), of this size [N m or N]."""

    joint: int
    rmse: float


@dataclass(frozen=True, repr=False)
class Diagnosis(Record, JsonRecord):
    """verdict : "effect_missing", "nothing_missing" or "unknown_effect"; effects in the
    order of adding; noise_floor (n,) of the filtered torque; events : what happened
    once.

    noise_source : "repetition", else "spectrum" or "residual", and abstention is
    weaker; unexplained (n,) : repeatable error left, as a share of the noise's
    variance; held_out_rmse_before, held_out_rmse (n,) : before the first effect and
    after the last, on the source that held_out_source names: "test" (a test run) or
    "folds"; band_hz : below which all errors are meant; retuned : shape constants of
    the model's own effects that should change; curves : what repeats and has no name,
    as functions of one variable or two; remarks : sentences; frozen : whether the
    model's parameters were kept, and are kept by :func:`add`; new_motion_share : of the
    test run's rows, those whose motion is not in the runs that were searched; remains :
    what repeats and is unknown; torque_units (n,) : of the joints.
    """

    verdict: Literal["effect_missing", "nothing_missing", "unknown_effect"]
    effects: tuple[Finding, ...]
    noise_floor: Array
    invisible: tuple[Invisible, ...]
    events: tuple[Event, ...]
    noise_source: str
    unexplained: Array
    held_out_rmse: Array
    band_hz: float
    remarks: tuple[str, ...]
    held_out_rmse_before: Array
    held_out_source: str
    frozen: bool
    new_motion_share: float | None = None
    retuned: tuple[Retune, ...] = ()
    curves: tuple[Curve, ...] = ()
    remains: tuple[Remaining, ...] = ()
    torque_units: tuple[str, ...] = ()

    def torque_unit(self, joint: int) -> str:
        """Unit of the torque of a joint (from 1); "N m or N" where files of older
        versions do not say it."""
        if not self.torque_units:
            return "N m or N"
        return plain_unit(self.torque_units[joint - 1])

    def selected(
        self,
        numbers: Sequence[float] | None = None,
        confident: bool = False,
    ) -> Diagnosis:
        """Only the findings of these numbers (from 1, in the order of adding), or those
        that are sure.

        Changed shape constants are not numbered: they stay, the sure ones or all.
        Curves, which were measured beside all findings, stay where all of these do.
        Raises InputError for a number that is not there, and where no finding is left.
        """
        for number in numbers or ():
            if number not in range(1, len(self.effects) + 1):
                raise InputError(
                    f"finding {number:g} does not exist, there are {len(self.effects)}",
                    "number them from 1 in the order of the list",
                )
        chosen = tuple(
            f
            for k, f in enumerate(self.effects, start=1)
            if (numbers is None or k in numbers)
            and (not confident or f.torque_is_certain)
        )
        retuned = tuple(r for r in self.retuned if not confident or r.torque_is_certain)
        is_whole = numbers is None and all(
            any(f is g for g in chosen) for f in self.effects
        )
        curves = self.curves if is_whole else ()
        if not chosen and not retuned and not curves:
            kind = "finding"
            if confident and self.effects:
                kind = "confident finding or near-tie"
            raise InputError(
                f"there is no {kind} to add",
                "name the effect itself, or leave the model as it is",
            )
        return replace(self, effects=chosen, retuned=retuned, curves=curves)

    def with_judged_errors(self, before: Array, after: Array) -> Diagnosis:
        """The same with the errors (n,) that the model and the model with all that is
        sure have on the test run, as `compare` and `add` print them.

        The search fits every step again by least squares; those errors stay where the
        sure findings are not the first of the list, and for the weak ones after them.
        """
        if self.retuned:
            return self
        if not self.effects and not self.curves:
            return replace(self, held_out_rmse_before=before, held_out_rmse=before)
        ladder = list(self.effects)
        if ladder:
            ladder[0] = replace(ladder[0], held_out_rmse_before=before)
        with_all = self.held_out_rmse
        n_sure = len([f for f in ladder if f.torque_is_certain])
        are_first = all(f.torque_is_certain for f in ladder[:n_sure])
        if n_sure and are_first and not self.curves:
            last = ladder[n_sure - 1]
            ladder[n_sure - 1] = replace(last, held_out_rmse_after=after)
            if len(ladder) > n_sure:
                ladder[n_sure] = replace(ladder[n_sure], held_out_rmse_before=after)
            else:
                with_all = after
        return replace(
            self,
            effects=tuple(ladder),
            held_out_rmse_before=before,
            held_out_rmse=with_all,
        )

    @fact("", digits=9)
    def n_confident(self) -> int:
        """Findings whose effect and size are sure."""
        return self._count("confident")

    @fact("", digits=9, name="n certain effects")
    def n_certain_effects(self) -> int:
        """Findings whose effect is sure: confident, or near-ties of laws of one effect."""
        return sum(f.effect_is_certain for f in self.effects)

    @fact("", digits=9, name="n near-tie")
    def n_near_tie(self) -> int:
        """Findings whose torque is there, while another effect fits as well."""
        return self._count("near-tie")

    @fact("", digits=9)
    def n_weak(self) -> int:
        """Findings that are not sure."""
        return self._count("weak")

    def _count(self, rating: Rating) -> int:
        return sum(f.rating == rating for f in self.effects)

    @fact("times the noise", name="error on data left out")
    def left_over_noise(self) -> Array | None:
        """(n,) error of each joint on data left out, with all that was found, over its
        noise floor; unknown where the noise is not known."""
        return self.held_out_over_noise

    @fact("N m or N", name="error on data left out in N m or N")
    def left_error(self) -> Array:
        """(n,) error of each joint on data left out, with all that was found."""
        return self.held_out_rmse_with_all

    @fact("N m or N", name="noise floor")
    def joint_noise(self) -> Array:
        """(n,) standard deviation of the torque's noise behind the same low-pass; an
        estimate where no motion repeats."""
        return self.noise_floor

    def to_frame(self) -> pandas.DataFrame:
        """One row a finding: effect, joints, size with half its 95 % interval, unit,
        rating, evidence, and the error on data left out of its first joint."""
        import pandas

        rows = []
        for number, finding in enumerate(self.effects, start=1):
            joint = finding.main_joint
            rows.append(
                {
                    "finding": number,
                    "effect": finding.effect,
                    "joints": finding.joints,
                    "size": finding.size,
                    "half of 95 % interval": NORMAL_95 * finding.std,
                    "unit": finding.unit,
                    "rating": finding.rating,
                    "evidence": finding.gain,
                    "error before [N m or N]": finding.held_out_rmse_before[joint - 1],
                    "error after [N m or N]": finding.held_out_rmse_after[joint - 1],
                }
            )
        columns = list(rows[0]) if rows else ["finding"]
        return pandas.DataFrame(rows, columns=columns).set_index("finding")

    @property
    def sure(self) -> tuple[Finding | Retune, ...]:
        """Constants and findings whose torque is sure: what to add."""
        candidates: tuple[Finding | Retune, ...] = (*self.retuned, *self.effects)
        return tuple(f for f in candidates if f.torque_is_certain)

    @property
    def texts(self) -> list[str]:
        """Every finding and re-estimated constant, as `add` takes it."""
        return [
            *(f.text for f in self.effects),
            *(r.text for r in self.retuned),
        ]

    @property
    def noise_known(self) -> bool:
        """Whether the noise is told from the error, if only within a factor of two (by
        a spectrum)."""
        return self.noise_source != RESIDUAL

    @property
    def headline(self) -> str:
        """What is missing, and what happened once, in one or two sentences."""
        text = self._missing
        if self.noise_source == SPECTRUM:
            text += f" The noise is {SPECTRUM_KNOWN}: no motion repeats."
        where = sorted({e.joint for e in self.events})
        if where:
            events = formatting.count(len(self.events), "isolated disturbance")
            text += f" Also {events} on {formatting.joints(where)}."
        return text

    @property
    def _missing(self) -> str:
        certain = [f for f in self.effects if f.effect_is_certain]
        findings = f"finding{'s' if len(self.effects) != 1 else ''}"
        counted = (
            f"{named_on_joints(certain or self.effects)}"
            f" ({rating_counts(self.effects)} {findings})"
        )
        if self.unexplained_sentence:
            if certain:
                return f"Missing: {counted}; also {self.unexplained_sentence}."
            return (
                "Missing:"
                f" {self.unexplained_sentence}{f'; possibly {counted}' if self.effects else ''}."
            )
        if self.effects:
            text = f"{'Missing' if certain else 'Possibly missing'}: {counted}."
            if self.retuned:
                text += f" Settings to re-estimate: {named_on_joints(self.retuned)}."
            return (
                text
                if self.noise_known
                else f"{text} Whether more is missing {NOISE_UNKNOWN}"
            )
        if self.retuned:
            return (
                "No effect is missing; settings to re-estimate:"
                f" {named_on_joints(self.retuned)}."
            )
        if self.noise_known:
            return self._nothing
        return f"Nothing found to be missing; whether that is so {NOISE_UNKNOWN}"

    @property
    def _nothing(self) -> str:
        """What is said where nothing was found beside a noise that is known."""
        over = self.held_out_over_noise
        if over is None or not len(over):
            return "Nothing is missing that these measurements could show."
        worst = int(np.argmax(over)) + 1
        error = formatting.times_noise(
            float(over[worst - 1]),
            float(self.held_out_rmse_with_all[worst - 1]),
            self.torque_unit(worst),
        )
        if above := self.joints_above_noise:
            return (
                "No effect of the library explains the torque beyond the noise on"
                f" {formatting.joints(above)}: joint {worst} errs {error}."
            )
        return (
            "Nothing is missing that these measurements could show: no joint errs more"
            f" than {error.removesuffix(')')} on joint {worst})."
        )

    @property
    def held_out_rmse_with_all(self) -> Array:
        """(n,) error on data left out with all findings, constants and curves
        [N m or N]."""
        errors = self.held_out_rmse.copy()
        for curve in self.curves:
            errors[curve.joint - 1] = curve.held_out_rmse_after
        return errors

    @property
    def held_out_over_noise(self) -> Array | None:
        """(n,) :attr:`held_out_rmse_with_all` over the noise floor; None where the noise
        is not known."""
        if not self.noise_known or not np.all(self.noise_floor > 0.0):
            return None
        return self.held_out_rmse_with_all / self.noise_floor

    @property
    def joints_above_noise(self) -> list[int]:
        """Joints (from 1) that err more than ABOVE_NOISE noise floors with all that was
        found."""
        over = self.held_out_over_noise
        if over is None:
            return []
        return [int(j) + 1 for j in np.flatnonzero(over > ABOVE_NOISE)]

    @property
    def left_sentence(self) -> str:
        """What error is left on data left out, joint by joint."""
        start = "Error on data left out, with everything found"
        facts = self.facts()
        errors = [
            f"{error} {self.torque_unit(joint)}"
            for joint, error in enumerate(facts["left_error"].texts, start=1)
        ]
        if self.held_out_over_noise is None:
            unit = "the noise is not known"
        else:
            times = facts["left_over_noise"].texts
            errors = [f"{x} ({error})" for x, error in zip(times, errors, strict=True)]
            unit = "in multiples of the noise"
        each = [f"j{joint} {error}" for joint, error in enumerate(errors, start=1)]
        return f"{start} ({unit}): {', '.join(each)}."

    @property
    def unexplained_sentence(self) -> str:
        """What no effect explains, with its joints and size; "" where nothing of the
        kind is left."""
        if self.verdict != "unknown_effect":
            return ""
        where = (
            f" on {formatting.joints([r.joint for r in self.remains])}"
            if self.remains
            else ""
        )
        largest = max(self.remains, key=lambda r: r.rmse, default=None)
        amount = ""
        if largest is not None:
            at_most = " at most" if len(self.remains) > 1 else ""
            unit = self.torque_unit(largest.joint)
            amount = f" ({largest.rmse:.2g} {unit} RMS{at_most})"
        return f"something{where} that no effect of the library explains{amount}"

    @property
    def advice(self) -> str:
        """What to do next, in one sentence."""
        if self.unexplained_sentence:
            return (
                "Look first at what the error that is left depends on: `compare`"
                " says it."
            )
        if self.noise_source != REPETITION:
            record = (
                "record a run with more than one period: only repetition tells noise"
                " from error."
            )
            add = f"Add {self.sure_text}; {record}"
            return add if self.sure else record.capitalize()
        if self.sure:
            return f"Add {self.sure_text}, and diagnose the model that results."
        if self.effects or self.retuned:
            return (
                "Record a run that tells the findings from what fits as well: all are"
                " weak."
            )
        if self.joints_above_noise:
            return "Look at what the error depends on: `compare` says it."
        return "Use the model, or record motion that excites more."

    @property
    def sure_text(self) -> str:
        """What :attr:`sure` holds, in words."""
        kinds = {f.rating for f in self.sure}
        names = {
            "confident": "the confident findings",
            "near-tie": "the near-ties",
            "weak": "what is weak in name or size only",
        }
        return " and ".join(text for kind, text in names.items() if kind in kinds)

    def _summary(self) -> Summary:
        rows = [("next", self.advice)]
        rows += [
            ("held-out RMSE", ", ".join(f"{x:.3g}" for x in self.held_out_rmse_before))
        ]
        if self.effects or self.retuned:
            rows.append(
                ("with the findings", ", ".join(f"{x:.3g}" for x in self.held_out_rmse))
            )
        name = "noise floor" if self.noise_source == REPETITION else "noise (estimated)"
        return self.headline, [
            *rows,
            (name, ", ".join(f"{x:.3g}" for x in self.noise_floor)),
        ]

    def _table(self) -> Table:
        rows = [
            (
                f.text,
                f.size_text,
                f.rating,
                ", ".join(f.indistinguishable_from),
            )
            for f in self.effects
        ]
        rows += [(r.text, r.explanation, r.rating, "") for r in self.retuned]
        heads = ("effect", "size", "confidence", "indistinguishable from")
        return Table(heads, rows, words=(0, 1, 2, 3))

    @property
    def beside_curves(self) -> tuple[Finding, ...]:
        """The findings that no curve stands instead of."""
        return tuple(
            f
            for f in self.effects
            if not self.curves or CURVE not in f.indistinguishable_from
        )

    def to_dict(self) -> dict[str, Any]:
        """findings.json; :meth:`from_dict` restores the same diagnosis."""
        out = {"format": FINDINGS_FORMAT, **super().to_dict()}
        for k, finding in enumerate(out["effects"], start=1):
            finding["number"] = k
        out["facts"] = self.facts_to_dict()
        return out


def rating_counts(found: Sequence[Finding | Retune]) -> str:
    """How many there are of each rating: "2 confident, 1 near-tie and 1 weak"."""
    ratings = [f.rating for f in found]
    counts = [
        f"{ratings.count(kind)} {kind}" for kind in get_args(Rating) if kind in ratings
    ]
    return formatting.words(counts) if counts else ""


def named_on_joints(findings: Sequence[Finding | Retune]) -> str:
    """Effects in words, with the joints that each is found on."""
    joints: dict[str, set[int]] = {}
    for f in findings:
        joints.setdefault(f.effect, set()).update(f.joints)
    return "; ".join(
        f"{effect_name(effect)} on {formatting.joints(sorted(where))}"
        if where
        else effect_name(effect)
        for effect, where in joints.items()
    )


def load_diagnosis(path: str | Path) -> Diagnosis:
    """The diagnosis of a findings.json, as `diagnose --json` writes it.

    Raises InputError for a file that is not one, lacks a field or is of another format.
    """
    return read_json(path, "findings.json", "verdict", _diagnosis_of)


def _diagnosis_of(data: Mapping[str, Any]) -> Diagnosis:
    # The first versions did not name the format.
    require_format(data, FINDINGS_FORMAT, unmarked=1)
    return Diagnosis.from_dict(data)


@dataclass(frozen=True)
class Retune(Rated):
    """A shape constant of the model's own effect on one joint, as it explains most
    beside the findings.

    rmse_before, rmse_after : held-out error of the joint, with the model's constants
    and with the new ones; remarks : why it is weak, if it is.
    """

    estimate: ShapeEstimate
    confidence: str
    rmse_before: float
    rmse_after: float
    explanation: str
    remarks: tuple[str, ...] = ()

    @property
    def effect(self) -> str:
        """The name of the effect."""
        return self.estimate.effect

    @property
    def joint(self) -> int:
        """From 1."""
        return self.estimate.joint + 1

    @property
    def joints(self) -> tuple[int, ...]:
        """Its one joint, as a finding has them."""
        return (self.joint,)

    @property
    def text(self) -> str:
        """How :func:`~sdp_vs_penalty.diagnosis.add` takes it."""
        s = self.estimate
        return f"{s.effect}:{self.joint}@{s.shape}={s.after:.6g}"

    def to_dict(self) -> dict[str, Any]:
        """std is null where the data bound the constant on one side only."""
        fields_of_retune = super().to_dict()
        return {
            **fields_of_retune.pop("estimate"),
            **fields_of_retune,
            "kind": "retune",
            "text": self.text,
        }

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Self:
        """What :meth:`to_dict` wrote."""
        return super().from_dict(
            {
                **data,
                "estimate": {"at_end": False, **data},
            }
        )


def event_lines(
    events: Sequence[Any],
    show_all: bool = False,
    most_lines: int = 3,
) -> list[str]:
    """A line an event; one for all of them where they are more than ``most_lines``, unless
    ``show_all``.

    events : with ``joint`` (from 1), ``t_start``, ``t_end`` [s] and ``frequency`` [Hz]
    or None.
    """
    if len(events) > most_lines and not show_all:
        where = formatting.joints(sorted({e.joint for e in events}))
        hums = sum(e.frequency is not None for e in events)
        hum = f", {hums} of them a hum" if hums else ""
        first = min(e.t_start for e in events)
        last = max(e.t_end for e in events)
        return [f"{len(events)} events on {where}, {first:.2f} s to {last:.2f} s{hum}"]
    kinds = (
        "isolated disturbance"
        if e.frequency is None
        else f"a hum of {e.frequency:.3g} Hz"
        for e in events
    )
    return [
        f"{kind} on joint {e.joint}: {e.t_start:.2f} s to {e.t_end:.2f} s"
        for kind, e in zip(kinds, events, strict=True)
    ]
