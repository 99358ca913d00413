"""What a diagnosis says: findings, verdict, and the JSON of both, there and back."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence, Set
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import chain, starmap
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Literal, TypeVar, get_args

import numpy as np

from sdp_vs_penalty import formatting
from sdp_vs_penalty.diagnosis.curves.curve import CURVE, Curve
from sdp_vs_penalty.diagnosis.doubts import NAME_IS_OPEN, SIZE_IS_OPEN, Doubt
from sdp_vs_penalty.diagnosis.notices import Notice
from sdp_vs_penalty.diagnosis.passing.cause import PassingCause, Span, spans_in_words
from sdp_vs_penalty.effects import (
    FittedEffect,
    effect_in_words,
    effect_name,
    effect_types,
    on_the_arm,
    standard_effect,
)
from sdp_vs_penalty.effects.plain_words import ON_THE_ARM, written_in_words
from sdp_vs_penalty.effects.written import WrittenEffect, read_effect
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.estimation.constants import CHANGES, NORMAL_95
from sdp_vs_penalty.estimation.outcome import OfferOutcome
from sdp_vs_penalty.estimation.shapes import ShapeEstimate
from sdp_vs_penalty.estimation.uncertainty import unit_by
from sdp_vs_penalty.estimation.verdict import ABOVE_NOISE, over_noise
from sdp_vs_penalty.files import read_json, require_format
from sdp_vs_penalty.formatting import plain_unit
from sdp_vs_penalty.records import JsonRecord
from sdp_vs_penalty.results.facts import fact
from sdp_vs_penalty.results.record import Record, Summary
from sdp_vs_penalty.results.remedy import GUESSES, Change, Rating, Remedy, one_of_rivals
from sdp_vs_penalty.results.table import Table
from sdp_vs_penalty.robot.arrays import Array, nonzero_or_one
from sdp_vs_penalty.robot.robot import STANDARD_GRAVITY
from sdp_vs_penalty.signals.noise import (
    NOISE_UNKNOWN,
    REPETITION,
    RESIDUAL,
    SPECTRUM,
    SPECTRUM_KNOWN,
)

if TYPE_CHECKING:
    import pandas


#: Of findings.json, and the oldest that is read.
FINDINGS_FORMAT = 4
_OLDEST_FORMAT = 2
#: Effects besides the main one that a cause names; more are counted.
_MOST_NAMED = 2
#: Kinds of findings that a button names; more are counted.
_MOST_ON_A_BUTTON = 3
#: What is said where the residual was taken for noise, which it then equals.
_MAY_HIDE = f"small effects may hide, since {NOISE_UNKNOWN}."
#: Doubts about the size of a torque that is there, and of no other effect.
_OF_SIZE = {"uncertain", "insignificant"}


class Rated(JsonRecord):
    """Something that is reported with its confidence: a finding or a re-estimated
    constant."""

    derived: ClassVar[tuple[str, ...]] = ("confidence", "remarks")

    #: The reasons for doubt; without any it is confident.
    doubts: tuple[Doubt, ...]
    #: Whether adding it lowers the error on data left out.
    helps: bool = False

    @property
    def confidence(self) -> str:
        """ "confident", or "weak" where there is a reason for doubt."""
        return "weak" if self.doubts else "confident"

    @property
    def remarks(self) -> tuple[str, ...]:
        """The reasons for doubt, a sentence each."""
        return tuple(doubt.sentence for doubt in self.doubts)

    @property
    def rating(self) -> Rating:
        """ "confident", "near-tie" or "weak".

        A finding whose only doubt is that something else fits as well is a near-tie:
        its torque is there, and only its name is open. All other doubts make it weak.
        """
        if not self.doubts:
            return "confident"
        reasons = {doubt.reason for doubt in self.doubts}
        return "near-tie" if reasons <= NAME_IS_OPEN else "weak"

    @property
    def badge(self) -> str:
        """The rating, or what is uncertain of a weak one whose torque is there."""
        if self.rating != "weak" or not self.torque_is_certain:
            return self.rating
        reasons = {doubt.reason for doubt in self.doubts}
        return "size uncertain" if reasons <= _OF_SIZE else "cause uncertain"

    @property
    def rating_and_why(self) -> tuple[Rating, str]:
        """The rating, and the reasons for doubt."""
        return self.rating, "; ".join(self.remarks) or "shown on data left out"

    @property
    def has_open_torque(self) -> bool:
        """Whether a doubt leaves open that the torque is there."""
        return any(doubt.leaves_torque_open for doubt in self.doubts)

    @property
    def torque_is_certain(self) -> bool:
        """Whether the torque is certainly present, though its name or size may be open:
        `add --helpful` takes it.

        True for a confident finding. Also true for a weak one if no doubt forbids to
        add it, and none leaves the torque open, or adding it helps on data left out.
        """
        if any(doubt.forbids_adding for doubt in self.doubts):
            return False
        return self.helps or not self.has_open_torque


#: A finding or a re-estimated constant.
_Rated = TypeVar("_Rated", bound=Rated)


def is_law_of(name: str, other: str) -> bool:
    """Return whether two effects, given by name, are laws (formulas) of one physical
    effect.

    They are if the names are equal, or if one effect declares that it refines the
    other, as Stribeck friction refines Coulomb friction, or has the same law.
    """
    if name == other:
        return True
    types = effect_types()
    refines = name in types[other].refines or other in types[name].refines
    return refines or has_same_law(name, other)


def has_same_law(name: str, other: str) -> bool:
    """Return whether two effects, given by name, are one law whose shape constants have
    other bounds, as stiction and pre-sliding hysteresis."""
    types = effect_types()
    return other in types[name].same_law_as or name in types[other].same_law_as


def effect_on(name: str, joints: Sequence[int]) -> WrittenEffect:
    """Return an effect, given by name, on the first of some joints (from 1), or on the
    whole robot if it acts there alone."""
    kind = effect_types().get(name)
    is_whole = kind is not None and kind.whole_robot
    return WrittenEffect(name, () if is_whole else tuple(joints[:1]))


def is_friction(name: str) -> bool:
    """Return whether an effect, by name, is friction: it says so, or refines what simulators
    call that."""
    return "friction" in name or standard_effect("friction").name in (
        effect_types()[name].refines
    )


#: Relative standard deviation of a size from which its torque is said too: a 95 %
#: interval of 20 % to either side.
_WIDE = 0.1


#: What is said of an error within ABOVE_NOISE that a finding lowers.
SOME_ERROR_IS_LEFT = "Some error is left"

#: Factor and unit in which sentences say a size, by its plain unit; gravity across the
#: base [m/s^2] is a tilt.
_SAID_IN = {
    "": (100.0, "%"),
    "rad": (np.degrees(1.0), "°"),
    "rad/(N m)": (np.degrees(1.0), "°/(N m)"),
    "m/s^2": (np.degrees(1.0) / abs(STANDARD_GRAVITY[2]), "°"),
}


def _amount(size: float, std: float, unit: str) -> str:
    """Write a size with half its 95 % interval, if that does not hold zero, in the unit
    that sentences have."""
    unit = plain_unit(unit)
    scale, unit = _SAID_IN.get(unit, (1.0, unit))
    return formatting.amount_or_open(scale * size, scale * NORMAL_95 * std, unit)


def main_joint_of(joints: Sequence[int], before: Array, after: Array) -> int:
    """Return the joint (from 1) that a finding on some joints is about, by the errors
    (n,) without and with it: the first one; of none named the one whose error falls
    most."""
    if joints:
        return joints[0]
    return int(np.argmin(after / np.maximum(before, 1e-300))) + 1  # never divide by 0


#: Errors (n,) before and after a finding joins those before it, in files of formats up
#: to 3.
_ERRORS_OF_STEP = ("held_out_rmse_before", "held_out_rmse_after")


@dataclass(frozen=True)
class Finding(Rated):
    """One missing effect."""

    derived = ("explanation", "rating", "half_width_95", *Rated.derived)

    #: Name of the effect.
    effect: str
    #: Numbers of the joints, from 1; empty for the whole robot.
    joints: tuple[int, ...]
    #: Shape constants (such as a Stribeck velocity) by name, in SI units.
    shape: Mapping[str, float]
    #: Estimate of the effect's parameter, or of the amplitude where there are several,
    #: in ``unit``.
    size: float
    #: Unit of the size.
    unit: str
    #: Standard deviation of the size, in ``unit``.
    std: float
    #: All parameters of the effect by name, in SI units.
    parameters: Mapping[str, float]
    #: Effects that fit about as well, with constants where name and joints are the
    #: finding's.
    rivals: tuple[WrittenEffect, ...]
    #: The joint (from 1) that it is about: the first of its joints; for an effect on the
    #: whole robot the joint whose error on data left out falls most.
    main_joint: int
    #: The effect's physics, in a sentence or two.
    physics: str
    #: The effect as :func:`add` takes it.
    text: str
    #: Evidence of the finding.
    gain: float
    #: Why the finding is weak, if it is.
    doubts: tuple[Doubt, ...] = ()
    #: Whether adding it lowers the error on data left out, where the joints slide, by
    #: 5 % if its torque is in doubt.
    helps: bool = False
    #: The shape constants in words, with units.
    constants: str = ""
    #: Files of `export` for a controller or a simulator without a place for it.
    no_place_in: tuple[str, ...] = ()
    #: The nearest law for which one of these files has a place, as :func:`add` takes
    #: it; "" without one. Its errors are among those of the diagnosis.
    held_law: str = ""
    #: The files that hold that law.
    held_law_in: tuple[str, ...] = ()
    #: Standard deviation of the size from the scatter over the log alone, all else
    #: being exact, in ``unit``.
    std_of_rows: float = 0.0
    #: Standard deviation of the size from the tolerated error of the effect's law, a
    #: part of ``std``, in ``unit``.
    std_of_law: float = 0.0
    #: The size that the search estimated, where ``size`` is a model's.
    size_in_search: float | None = None
    #: RMS of the effect's torque in the searched rows, on the joint where it is
    #: largest, in ``torque_unit``.
    torque_rms: float | None = None
    #: Standard deviation of ``torque_rms``, in ``torque_unit``.
    torque_std: float | None = None
    #: Unit of the torque on that joint.
    torque_unit: str = ""
    #: Number in the diagnosis, from 1, which sets it; 0 for a finding of none.
    number: int = field(default=0, compare=False)

    @classmethod
    def upgraded(cls, data: Mapping[str, Any]) -> Mapping[str, Any]:
        """Read the main joint from the errors of formats up to 3, and the rivals of
        format 2, which are texts, without joints where they act on the finding's."""
        if "main_joint" not in data and {*_ERRORS_OF_STEP} <= {*data}:
            before, after = (np.array(data[name], float) for name in _ERRORS_OF_STEP)
            joint = main_joint_of(data["joints"], before, after)
            data = {**data, "main_joint": joint}
        if "indistinguishable_from" not in data:
            return data
        texts = [text for text in data["indistinguishable_from"] if text != CURVE]
        rivals = [
            read_effect(text) if ":" in text else effect_on(text, data["joints"])
            for text in texts
        ]
        return {**data, "rivals": [vars(rival) for rival in rivals]}

    def in_unit(self, torque: str) -> Finding:
        """Return the same with its sizes in another unit of torque, such as "A"; "" leaves
        it as it is."""
        if not torque:
            return self
        has_torque = "N*m" in self.unit or self.unit.startswith("kg")
        unit = unit_by(self.unit, torque) if has_torque else self.unit
        return replace(self, unit=unit, torque_unit=torque)

    @property
    def size_text(self) -> str:
        """The size with its 95 % interval, such as "3.12 ± 0.49 N m (95 %)".

        Where the torque is known far better than the size, which follows the shape
        constants, it is said too. A size that may be zero is not said.
        """
        is_open = self.size_may_be_zero
        amount = _amount(self.size, self.std, self.unit)
        if self._torque_tells_more:
            return f"{amount}, {self.torque_text} (95 %)"
        return amount if is_open else f"{amount} (95 %)"

    @property
    def torque_text(self) -> str:
        """The torque that it makes, such as "0.21 ± 0.01 N m RMS in these runs"; ""
        if that is not known (findings.json of an older version).
        """
        if self.torque_rms is None or self.torque_std is None:
            return ""
        half = NORMAL_95 * self.torque_std
        unit = plain_unit(self.torque_unit)
        return f"{formatting.amount(self.torque_rms, half, unit)} RMS in these runs"

    @property
    def _torque_is_known(self) -> bool:
        """Whether the 95 % interval of the torque that it makes does not hold zero."""
        if self.torque_rms is None or self.torque_std is None:
            return False
        return self.torque_rms > NORMAL_95 * self.torque_std

    @property
    def _torque_tells_more(self) -> bool:
        """Whether the size is uncertain, and its relative standard deviation more than
        twice the torque's, which is not zero.
        """
        if self.torque_rms is None or self.torque_std is None:
            return False
        if not self._torque_is_known:
            return False
        of_size = self.std / abs(self.size) if self.size else np.inf
        of_torque = self.torque_std / self.torque_rms
        return of_size > _WIDE and of_size > 2.0 * of_torque

    @property
    def title(self) -> str:
        """The effect and its place, such as "Stribeck friction, joint 3"."""
        name = formatting.sentence(effect_name(self.effect))
        return f"{name}, {formatting.place(self.joints)}"

    @property
    def rivals_in_words(self) -> str:
        """What fits as well, such as "joint spring on joint 2; base tilt"; "" if
        nothing does."""
        named = [*map(written_in_words, self.short_rivals)]
        return "; ".join([*named, effect_name(CURVE)] if self.fits_a_curve else named)

    @property
    def same_law_in_words(self) -> str:
        """The name that the law has over another travel, such as "or stiction: the same
        law over a shorter travel"; "" where the travel found is outside its bounds."""
        types = effect_types()
        travel, kind = self.shape.get("d"), types.get(self.effect)
        if travel is None or kind is None:
            return ""
        for name, other in types.items():
            if name == self.effect or not has_same_law(self.effect, name):
                continue
            low, high = other.shapes["d"].bounds or (0.0, np.inf)
            if low <= travel <= high:
                is_shorter = other.shapes["d"].default < kind.shapes["d"].default
                length = "shorter" if is_shorter else "longer"
                return f"or {effect_name(name)}: the same law over a {length} travel"
        return ""

    @property
    def rival_texts(self) -> list[str]:
        """What fits as well, as it is written; a measured curve last."""
        texts = [rival.text for rival in self.short_rivals]
        return [*texts, *[CURVE] * self.fits_a_curve]

    @property
    def short_rivals(self) -> list[WrittenEffect]:
        """The effects that fit as well, as sentences say them: by name alone where that
        is another one."""
        return [
            rival if rival.name == self.effect else WrittenEffect(rival.name)
            for rival in self.rivals
        ]

    @property
    def line(self) -> str:
        """The finding in one line: title, rating unless it is confident, size, and what
        fits as well."""
        rating = "" if self.rating == "confident" else f" ({self.rating})"
        rivals = self.rivals_in_words
        fits = f"; fits as well: {rivals}" if rivals else ""
        same_law = f"; {self.same_law_in_words}" if self.same_law_in_words else ""
        return f"{self.title}{rating}: {self.size_text}{same_law}{fits}"

    @property
    def half_width_95(self) -> float:
        """Half the size's 95 % interval, in its unit."""
        return NORMAL_95 * self.std

    @property
    def size_may_be_zero(self) -> bool:
        """Whether the size's 95 % interval holds zero, or is not a number."""
        return not abs(self.size) > self.half_width_95

    @property
    def says_open_law(self) -> bool:
        """Whether :attr:`on_the_arm` says a torque alone, and the laws that may make it."""
        return bool(self.rivals) and self.size_may_be_zero and self._torque_is_known

    @property
    def size_is_open(self) -> bool:
        """Whether a doubt leaves the size open, or its interval holds zero."""
        reasons = {doubt.reason for doubt in self.doubts}
        return self.size_may_be_zero or not reasons.isdisjoint(SIZE_IS_OPEN)

    @property
    def effect_is_certain(self) -> bool:
        """Whether the effect is certainly present, though its formula or size may be
        open.

        True if nothing but its size is uncertain, and what fits as well are formulas
        of the same physical effect.
        """
        reasons = {doubt.reason for doubt in self.doubts}
        laws = [is_law_of(rival.name, self.effect) for rival in self.rivals]
        return reasons <= {"rivals", "uncertain"} and all(laws)

    @property
    def on_the_arm(self) -> str:
        """A sentence on what the effect is mechanically on the arm, with its size."""
        if self.size_may_be_zero:
            if not self._torque_is_known:
                return f"{ON_THE_ARM}these runs do not tell its size from zero."
            where = f" of {formatting.joints(self.joints)}" if self.joints else ""
            when = f"that changes with the {self.seen_against or 'motion'}{where}"
            if self.seen_against == "reversal":
                when = f"at each reversal{where}"
            text = f"{ON_THE_ARM}a torque {when}, {self.torque_text}"
            laws = [effect_name(self.effect), *map(written_in_words, self.short_rivals)]
            open_law = (
                f"; which law makes it is open: {', '.join(laws[:-1])} or {laws[-1]}"
            )
            return f"{text}{open_law * self.says_open_law}."
        fitted = FittedEffect(
            name=self.effect,
            joints=self.joints,
            size=self.size,
            unit=self.unit,
            parameters=self.parameters,
            shape=self.shape,
            digits=formatting.digits_beside(self.size, self.half_width_95),
            half_width=self.half_width_95,
            torque_unit=plain_unit(self.torque_unit),
        )
        said = on_the_arm(fitted)
        # A gain that is 1 % off makes a mass 1 % off, which its interval leaves out.
        return said if self.unit != "kg" else f"{said[:-1]}, if the gains are right."

    @property
    def seen_against(self) -> str:
        """Name of the quantity against which charts draw the effect's torque, such as
        "velocity"; "" if no single signal shows it.
        """
        return effect_types()[self.effect].seen_against

    @property
    def explanation(self) -> str:
        """The finding in a few sentences: effect, joints, size with its 95 % interval,
        constants, physics, and what fits as well.
        """
        where = "the whole robot"
        if self.joints:
            where = f"joint {'+'.join(map(str, self.joints))}"
        name = formatting.sentence(effect_name(self.effect))
        head = f"{name} on {where}: {self.size_text}"
        head += f" ({self.constants})" if self.constants else ""
        text = f"{head}. {self.physics}"
        if self.same_law_in_words:
            text += f" {formatting.sentence(self.same_law_in_words)}."
        if self.rivals:
            named = ", ".join(map(written_in_words, self.short_rivals))
            text += f" Indistinguishable in these data from {named}."
        return text

    @property
    def fits_a_curve(self) -> bool:
        """Whether a measured curve, which is no effect, explains its joint better."""
        return any(doubt.reason == "curve" for doubt in self.doubts)

    @property
    def undecided(self) -> tuple[str, ...] | None:
        """The effects that a new recording has to tell apart, as texts.

        They are the finding and its first rival, such as "backlash:3,spring:3", or a
        weak finding alone, which may not be present at all.

        None if nothing is open (a confident finding without rivals), if a measured
        curve is the rival, or if a motion cannot decide
        (:attr:`cool_down_instruction`).
        """
        if self.fits_a_curve or self.cool_down_instruction:
            return None
        if not self.joints or not self.rivals:
            return (self.text,) if self.doubts else None
        return self.text, self.rivals[0].text

    def telling_run(self, model: str) -> str:
        """Return the command that designs a recording by which an open question is
        decided.

        Parameters
        ----------
        model
            Path of the model.json for the command.

        Returns
        -------
        str
            The command; or, if no motion can decide, the instruction to let the gears
            cool down; or "" if nothing is open.
        """
        if self.undecided is None:
            instruction = self.cool_down_instruction
            return f"{instruction}." if instruction else ""
        out = f"tell{self.number}.csv"
        return formatting.command(
            "excite", model, "--separate", ",".join(self.undecided), "--out", out
        )

    def gain_sentence(self, diagnosis: Diagnosis) -> str:
        """Say how adding the finding changes its joint's RMS error on data left out
        (:meth:`Diagnosis.errors_of`).

        If the noise is known, errors are in multiples of it too.

        Parameters
        ----------
        diagnosis
            The diagnosis of the finding, for the noise and units.
        """
        j = self.main_joint - 1
        both = diagnosis.errors_of(self)
        was, now = (formatting.number(float(rmse[j])) for rmse in both)
        is_lower = both[1][j] < both[0][j] and was != now
        helped = diagnosis.helped_by(self)
        errors = both if is_lower else both[:1]
        ratios = [over_noise(rmse, diagnosis.known_floor) for rmse in errors]
        amount = formatting.errors_with_noise(
            [float(rmse[j]) for rmse in errors],
            [float(x[j]) for x in ratios if x is not None] or None,
            diagnosis.torque_unit(j + 1),
            between=" to ",
        )
        text = f"Adding it cuts joint {j + 1}'s error on data left out from {amount}"
        if not is_lower:
            text = f"Adding it does not lower joint {j + 1}'s error on data left out: {amount}"
        if helped:
            text += f"; it {helped}"
        elif not is_lower and self.torque_is_certain and len(diagnosis.helpful) > 1:
            left = float(diagnosis.held_out_rmse_with_helpful[j])
            left_in_words = formatting.quantity(left, diagnosis.torque_unit(j + 1))
            text += f"; with all that helps it is {left_in_words}"
        return f"{text}."

    @property
    def cool_down_instruction(self) -> str:
        """How to tell an effect of temperature from a rival that changes with time;
        else "".

        No motion separates the two, but a recording after the gears have cooled down
        does. A search tries only the temperature for effects that may follow either, so
        that such a rival makes the finding one of temperature.
        """
        types = effect_types()  # classes of effects by name
        is_rival_over_time = any(types[x.name].follows_clock for x in self.rivals)
        if types[self.effect].follows_clock or not is_rival_over_time:
            return ""
        return (
            "record one more run after the gears have cooled down; what follows their"
            " temperature is then as it was at first, what follows the clock is not"
        )


@dataclass(frozen=True)
class Group:
    """What is shown as one and added together: one finding, or those of which the runs
    show the sum alone."""

    #: The findings, in the order of the list.
    findings: tuple[Finding, ...]

    @property
    def first(self) -> Finding:
        """The finding by whose number it is shown."""
        return self.findings[0]

    @property
    def place(self) -> int:
        """Place in the list of findings (from 0)."""
        return self.first.number - 1

    @property
    def texts(self) -> tuple[str, ...]:
        """The findings as :func:`add` takes them."""
        return tuple(finding.text for finding in self.findings)

    @property
    def is_sum(self) -> bool:
        """Whether the runs show the sum of several findings alone."""
        return len(self.findings) > 1

    @property
    def title(self) -> str:
        """What it is, and its place, such as "Stribeck friction, joint 3"."""
        if self.is_sum:
            return formatting.sentence(named_on_joints(self.findings))
        return self.first.title

    @property
    def badge(self) -> str:
        """What is certain of it, or how certain it is."""
        return "sum certain" if self.is_sum else self.first.badge

    @property
    def on_the_arm(self) -> str:
        """A sentence on what it is mechanically on the arm; of a sum what its findings
        have in common."""
        if not self.is_sum:
            return self.first.on_the_arm
        seen = dict.fromkeys(finding.seen_against for finding in self.findings)
        with_what = formatting.words([f"its {name}" for name in seen if name])
        are_friction = all(is_friction(finding.effect) for finding in self.findings)
        what = "friction" if are_friction else "torque"
        changes = f"changes with {with_what}" if with_what else "is another one"
        joint = formatting.joints([self.first.main_joint])
        return f"{ON_THE_ARM}{what} of {joint} {changes}, by a law that is open."


@dataclass(frozen=True)
class Pair:
    """What lowers no error by itself, and the other one beside which it does: shown as one
    and added together."""

    #: What helps only beside the other one.
    found: Finding | Retune
    #: The other one.
    other: Finding | Retune
    #: Whether the other one lowers no error by itself either, and needs this one.
    is_mutual: bool
    #: The joint (from 1) that gains most.
    joint: int
    #: (n,) RMS errors on data left out with both [N m or N].
    after: Array
    #: Both, and their places.
    title: str
    #: What adds both.
    change: Change

    @property
    def texts(self) -> list[str]:
        """Both as :func:`add` takes them."""
        return [self.found.text, self.other.text]


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
class Diagnosis(Record, JsonRecord):
    """What a model lacks: the missing effects, and what the recordings say of
    everything else."""

    derived = ("format", "facts", "remedies")

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
        errors = [*(f[_ERRORS_OF_STEP[0]] for f in findings), data["held_out_rmse"]]
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

    def beside_faults_of_log(self, faults: Sequence[Remedy]) -> Diagnosis:
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
    ) -> Diagnosis:
        """Return the diagnosis of a log of which the check explains the torque of some
        joints (from 1; empty: of all): a rival of each finding there. What has a name
        is no curve.
        """
        told = sentence[:1].lower() + sentence[1:].rstrip(".")
        cause = f"the check explains its torque as well, by a {kind}: {told}"
        curves = [c for c in self.curves if joints and c.joint not in joints]
        doubted = self._with_doubt(Doubt("explained", cause), joints)
        return replace(doubted, curves=tuple(curves))

    def _with_doubt(self, doubt: Doubt, joints: Sequence[int] = ()) -> Diagnosis:
        """Return the diagnosis with one more doubt of the findings and constants on some
        joints (from 1; none named: on all), and of those on the whole robot."""

        def with_doubt(found: _Rated, on: Sequence[int]) -> _Rated:
            """Return a finding or a constant, with the doubt if it is on the joints."""
            is_elsewhere = joints and on and set(joints).isdisjoint(on)
            if is_elsewhere:
                return found
            doubts = *found.doubts, doubt
            return replace(found, doubts=doubts)  # type: ignore

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
    ) -> Diagnosis:
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
        Diagnosis
            The same diagnosis with fewer findings.

        Raises
        ------
        InputError
            A number does not exist, or nothing is left.
        """
        self._refuse_unknown(numbers or ())

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

    def _refuse_unknown(self, numbers: Sequence[float]) -> None:
        """Raise InputError if one of the numbers is not that of a finding, counted from
        1.
        """
        n_findings = len(self.effects)
        for number in numbers:
            if number not in range(1, n_findings + 1):
                raise InputError(
                    f"finding {number:g} does not exist, there are {n_findings}",
                    "number them from 1 in the order of the list",
                )

    def with_judged_errors(self, before: Array, after: Array | None) -> Diagnosis:
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
        with_helpful = self.held_out_rmse_with_helpful
        if after is None:
            after = scale * with_helpful
        of_helpful = _ratio(after, with_helpful)
        judged = {
            x.effects: x.rmse * (of_helpful if {*helpful} <= {*x.effects} else scale)
            for x in self.errors_with
        }
        judged[helpful] = after
        return replace(self, held_out_rmse_before=before).with_errors(judged)

    def with_errors(self, errors: Mapping[tuple[str, ...], Array]) -> Diagnosis:
        """Return the diagnosis with errors on data left out (n,), by the texts of what is
        added [N m or N]; those of a constant are of the model with it alone."""
        found = replace(self, errors_with=tuple(starmap(ErrorWith, errors.items())))
        constants = []
        for constant in self.retuned:
            after = found.error_with((constant,))
            if after is not None:
                j = constant.joint - 1
                was, now = float(self.held_out_rmse_before[j]), float(after[j])
                constant = replace(constant, rmse_before=was, rmse_after=now)
            constants.append(constant)
        return replace(found, retuned=tuple(constants))

    def error_with(self, found: Sequence[Finding | Retune]) -> Array | None:
        """Return the errors (n,) on data left out of the model with some of what was found,
        and nothing else [N m or N]; None where they were not computed."""
        return self._error_with_texts({f.text for f in found})

    def _error_with_texts(self, texts: Set[str]) -> Array | None:
        """Return the errors (n,) of :meth:`error_with` by the texts of what is added."""
        return next((x.rmse for x in self.errors_with if {*x.effects} == texts), None)

    @cached_property
    def ladder(self) -> tuple[Array, ...]:
        """The errors (n,) on data left out with all re-estimated constants and the first
        0, 1, ... findings of the list [N m or N]; where they were not computed, those of
        the step before."""
        steps = [self.held_out_rmse_before]
        for k in range(len(self.effects) + 1):
            errors = self.error_with((*self.retuned, *self.effects[:k]))
            steps.append(steps[-1] if errors is None else errors)
        return tuple(steps[1:])

    def files_without_place(self, texts: Collection[str]) -> tuple[str, ...]:
        """The files of `export` that have no place for one of the findings with these
        texts."""
        lacking = (f.no_place_in for f in self.effects if f.text in texts)
        return tuple(dict.fromkeys(chain.from_iterable(lacking)))

    def place_in_files(self, texts: Collection[str]) -> str:
        """Say which files of `export` have no place for one of the findings with these
        texts, and what the nearest law does that such a file holds; "" where all files
        have a place for all of them."""
        files = self.files_without_place(texts)
        if not files:
            return ""
        lacking = dict[tuple[str, ...], list[Finding]]()
        for finding in self.effects:
            if finding.text in texts and finding.no_place_in:
                lacking.setdefault(finding.no_place_in, []).append(finding)
        clauses = [
            f"{formatting.words(names)} {'has' if len(names) == 1 else 'have'} no place"
            f" for {named_on_joints(those)}"
            for names, those in lacking.items()
        ]
        laws = [self._held_law_in_words(f) for f in self.effects if f.text in texts]
        return f"{'; '.join([*clauses, *filter(None, laws)])}."

    def held_law_remedy(self, finding: Finding) -> Remedy | None:
        """Return the remedy that adds, in place of a finding, the nearest law that a file
        holds which has no place for the finding; None without one that lowers the error
        of its joint."""
        j = finding.main_joint - 1
        before, _ = self.errors_of(finding)
        after = self._error_with_texts({finding.held_law})
        if after is None or after[j] > (1.0 - CHANGES) * before[j]:
            return None
        name = effect_in_words(finding.held_law)
        change = Change("add", f"add {name}", {"effects": [finding.held_law]})
        errors = tuple(before.tolist()), tuple(after.tolist())
        return Remedy(finding.title, *finding.rating_and_why, change, *errors)

    def _held_law_in_words(self, finding: Finding) -> str:
        """Say what :meth:`held_law_remedy` adds and what error it leaves; "" without it."""
        remedy = self.held_law_remedy(finding)
        if remedy is None:
            return ""
        assert remedy.after is not None  # this remedy has it
        j, files = finding.main_joint - 1, finding.held_law_in
        unit = self.torque_unit(j + 1)
        _, after = self.errors_of(finding)
        errors = [formatting.quantity(float(x[j]), unit) for x in (remedy.after, after)]
        return (
            f"{formatting.words(files)} {'holds' if len(files) == 1 else 'hold'}"
            f" {effect_in_words(finding.held_law)}, which gives {errors[0]} there instead"
            f" of {errors[1]}"
        )

    def errors_of(self, finding: Finding) -> tuple[Array, Array]:
        """Return a finding's errors on data left out, (n,) before and after it [N m or N]:
        the one figure of its joint that every place says, and what its remedy gives.

        They are those of the model, and of the model with this finding alone, or with
        those of which the runs show the sum alone. Where these were not computed, they
        are those of the ladder, after the findings before it in the list.
        """
        after = self.error_with(self.group_of(finding).findings)
        if after is None:
            return self.ladder[finding.number - 1], self.ladder[finding.number]
        return self.held_out_rmse_before, after

    @property
    def selections_of_one(self) -> list[tuple[Finding | Retune, ...]]:
        """What is added by itself: each constant, each group of findings."""
        constants = [(constant,) for constant in self.retuned]
        return [*constants, *(group.findings for group in self.groups)]

    @property
    def selections_of_several(self) -> list[tuple[Finding | Retune, ...]]:
        """What is added together, by the errors of what is added by itself: all that
        helps, what is sure, and what helps and lowers no error by itself with each other
        one that helps."""
        pairs = [
            (found, other)
            for found in self.helpful
            if not self._helps_alone(found)
            for other in self.helpful
            if other is not found
        ]
        return [*filter(None, (self.helpful, self._sure)), *pairs]

    def _helps_alone(self, found: Finding | Retune) -> bool:
        """Whether something, or a sum that it belongs to, lowers the error of a joint by
        CHANGES without all others; True where that was not computed."""
        if self._is_in_sum(found):
            return True
        after = self.error_with((found,))
        before = self.held_out_rmse_before
        return after is None or bool(np.any(after < (1.0 - CHANGES) * before))

    def helped_by(self, found: Finding | Retune) -> str:
        """Say beside what else something helps that lowers no error by itself, and the
        errors of the joint that gains most; "" where no single other one is known."""
        other, joint = self._companion(found)
        if other is None:
            return ""
        both, without = (self.error_with(x) for x in ((found, other), (other,)))
        assert both is not None  # or it would be no companion
        assert without is not None
        unit = self.torque_unit(joint)
        errors = [
            formatting.quantity(float(x[joint - 1]), unit) for x in (both, without)
        ]
        return (
            f"{self.companion_in_words(found)}: with both joint {joint}'s error is"
            f" {errors[0]}, and {errors[1]} without it"
        )

    def companion_in_words(self, found: Finding | Retune) -> str:
        """Name beside what something helps that lowers no error by itself; "" where no
        single other one is known."""
        other, _ = self._companion(found)
        if other is None:
            return ""
        name = named_on_joints([other])
        again = ", estimated again" if isinstance(other, Retune) else ""
        return f"helps beside {name}{again}, not by itself"

    def pair_of(self, found: Finding | Retune) -> Pair | None:
        """Return something that lowers no error by itself, with the one other beside which
        it does; None where it helps by itself, or no single other one is known."""
        other, joint = self._companion(found)
        if other is None:
            return None
        after = self.error_with((found, other))
        assert after is not None  # or it would be no companion
        mutual, _ = self._companion(other)
        pair = found, other
        names = formatting.sentence(named_on_joints(pair))
        arguments: dict[str, Any] = {"effects": [x.text for x in pair]}
        if isinstance(found, Finding) and isinstance(other, Finding):
            arguments["findings"] = [found.number, other.number]
        change = Change("add", f"add {named_on_joints(pair)}", arguments)
        return Pair(found, other, mutual is found, joint, after, names, change)

    def _companion(
        self, found: Finding | Retune
    ) -> tuple[Finding | Retune | None, int]:
        """Return which other one that helps something needs, which lowers no error by
        itself, and the joint (from 1) that gains most: the error with both is lower than
        that of the model and that with the other alone. None, 0 without one."""
        before = self.held_out_rmse_before
        scale = before if self.known_floor is None else self.known_floor
        largest, companion, joint = 0.0, None, 0
        for other in () if self._helps_alone(found) else self.helpful:
            both, alone = (self.error_with(x) for x in ((found, other), (other,)))
            if other is found or both is None or alone is None:
                continue
            least = np.minimum(before, alone)
            does_gain = both < (1.0 - CHANGES) * least
            falls = np.where(does_gain, least - both, 0.0) / nonzero_or_one(scale)
            if falls.max() > largest:
                largest, companion = float(falls.max()), other
                joint = int(falls.argmax()) + 1
        return companion, joint

    @cached_property
    def groups(self) -> tuple[Group, ...]:
        """The findings as they are shown and added, in the order of the list: each by
        itself, or with those of which the runs show the sum alone."""
        sums = [self._sum_on(joint) for joint in {f.main_joint for f in self.effects}]
        sum_by_number = {f.number: findings for findings in sums for f in findings}
        groups = [sum_by_number.get(f.number, (f,)) for f in self.effects]
        return tuple({those[0].number: Group(those) for those in groups}.values())

    def _sum_on(self, joint: int) -> tuple[Finding, ...]:
        """Return the findings on a joint (from 1) of which the runs show the sum alone.

        They are sure, while the size of one or more is open and its torque larger than
        the joint's error: it cancels with that of the others.
        """
        error = self.held_out_rmse_before[joint - 1]
        of_joint = [f for f in self.effects if f.main_joint == joint]
        sure = [f for f in of_joint if f.torque_is_certain]
        cancelling = [
            f for f in sure if f.size_is_open and (f.torque_rms or 0.0) > error
        ]
        # A single one cancels with all that helps there.
        group = cancelling if len(cancelling) > 1 else sure
        return tuple(group) if cancelling and len(group) > 1 else ()

    def group_of(self, finding: Finding) -> Group:
        """Return the group that a finding of the diagnosis belongs to."""
        return next(group for group in self.groups if finding.text in group.texts)

    def _is_in_sum(self, found: Finding | Retune) -> bool:
        """Return whether the runs show something in a sum alone."""
        return isinstance(found, Finding) and self.group_of(found).is_sum

    @fact("times the noise", name="error on data left out")
    def left_over_noise(self) -> Array | None:
        """(n,) error of each joint on data left out, with all that helps, over its
        noise floor; unknown where the noise is not known."""
        return self.held_out_over_noise

    @fact("N m or N", name="error on data left out in N m or N")
    def left_error(self) -> Array:
        """(n,) error of each joint on data left out, with all that helps."""
        return self.held_out_rmse_with_helpful

    @fact("N m or N", name="noise floor")
    def joint_noise(self) -> Array:
        """(n,) standard deviation of the torque's noise behind the same low-pass; an
        estimate where no motion repeats."""
        return self.noise_floor

    def to_frame(self) -> pandas.DataFrame:
        """Return a table (data frame) with one row for each finding.

        Columns: effect, joints, size with half its 95 % interval, unit, rating,
        evidence, and the RMS error of its main joint on data left out, before and after
        adding it.
        """
        import pandas

        rows = []
        for finding in self.effects:
            joint = finding.main_joint
            before, after = self.errors_of(finding)
            rows.append(
                {
                    "finding": finding.number,
                    "effect": finding.effect,
                    "joints": finding.joints,
                    "size": finding.size,
                    "half of 95 % interval": NORMAL_95 * finding.std,
                    "unit": finding.unit,
                    "rating": finding.rating,
                    "evidence": finding.gain,
                    "error before [N m or N]": before[joint - 1],
                    "error after [N m or N]": after[joint - 1],
                }
            )
        columns = list(rows[0]) if rows else ["finding"]
        return pandas.DataFrame(rows, columns=columns).set_index("finding")

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

    @cached_property
    def offers(self) -> tuple[Remedy, ...]:
        """What would mend the model at once, each with the errors on data left out that
        it leaves: first what is advised (:attr:`main_offer`), then all that helps, what is
        sure together, each re-estimated constant, and each group of findings."""
        adds_curves = bool(self.curves) and not self.leaves_curves_out
        leaves_spans_out = bool(self.left_out) and not self.frozen
        offers = [self.main_offer] if self.main_offer else []
        if self.helpful or adds_curves or leaves_spans_out:
            offers.append(self._offer_of_all)
        if self._sure_together not in ((), self.helpful):
            offers.append(self._offer_of_sure)
        offers += [constant.remedy for constant in self.retuned]
        offers += [self.offer_of(group.first) for group in self.groups]
        return tuple({str(offer.change.arguments): offer for offer in offers}.values())

    @cached_property
    def main_offer(self) -> Remedy | None:
        """The offer that page, terminal and report advise: of those that raise no joint's
        error beyond its noise the one that leaves the lowest errors; of two that do as
        much what is sure together, then what is read first. None where nothing helps."""
        if not self.helpful:
            return None
        main = self.main_finding
        choices = [self._offer_of_sure] if self._sure_together else []
        if main is not None and main.rating not in GUESSES and len(self.helpful) > 1:
            choices.append(self.offer_of(main))
        outcomes = [
            (offer, outcome)
            for offer in [*choices, self._offer_of_all]
            if (outcome := self.outcome_of(offer)) is not None
        ]
        harmless = [x for x in outcomes if not x[1].rising] or outcomes
        _, best = min(harmless, key=lambda x: x[1].size)
        return next(x for x, outcome in harmless if outcome.does_as_much_as(best))

    @property
    def choices(self) -> tuple[Remedy, ...]:
        """What is advised to add, and the other choice beside it: all that helps, or what is
        read first, with what it needs. Empty where nothing helps."""
        if self.main_offer is None:
            return ()
        others = [self._offer_of_all]
        if self.main_finding is not None:
            others.append(self.offer_with_companion(self.main_finding))
        advised = {*self.main_offer.change.arguments["effects"]}
        others = [x for x in others if {*x.change.arguments["effects"]} != advised]
        return self.main_offer, *others[:1]

    def offer_with_companion(self, finding: Finding) -> Remedy:
        """Return the offer of a finding; of one that lowers no error by itself that of both,
        it and the one beside which it does."""
        offer, pair = self.offer_of(finding), self.pair_of(finding)
        if pair is None:
            return offer
        return replace(
            offer,
            problem=pair.title,
            change=pair.change,
            before=tuple(self.held_out_rmse_before.tolist()),
            after=tuple(pair.after.tolist()),
        )

    def outcome_of(self, offer: Remedy) -> OfferOutcome | None:
        """Return what an offer does to the errors on data left out; None where they were
        not computed."""
        if offer.before is None or offer.after is None:
            return None
        return self.outcome_between(np.array(offer.before), np.array(offer.after))

    def outcome_between(self, before: Array, after: Array) -> OfferOutcome:
        """Return what a change does that leads from errors (n,) on data left out to others
        [N m or N]."""
        units = [self.torque_unit(j + 1) for j in range(len(before))]
        return OfferOutcome(before, after, self.known_floor, units)

    def offer_of(self, finding: Finding) -> Remedy:
        """Return the offer that adds a finding of the diagnosis, with those of which the
        runs show the sum alone; the effects that fit as well are its rivals."""
        group = self.group_of(finding)
        before, after = self.errors_of(finding)
        rivals = tuple(
            Change("add", f"add {written_in_words(rival)}", {"effects": [rival.text]})
            for rival in finding.rivals
        )
        arguments = {
            "effects": [*group.texts],
            "findings": [f.number for f in group.findings],
        }
        return Remedy(
            group.title,
            *finding.rating_and_why,
            Change("add", f"add {named_on_joints(group.findings)}", arguments),
            tuple(before.tolist()),
            tuple(after.tolist()),
            rivals,
        )

    @property
    def _sure(self) -> tuple[Finding | Retune, ...]:
        """What helps and surely is the effect that it is called, in whatever law of it.
        Left out is what lowers no error by itself, what is of open size where the rest is
        not, and constants where not all that helps is sure, since these have no number.
        """
        sure = [
            f
            for f in self.helpful
            if f.rating == "confident"
            or (isinstance(f, Finding) and f.effect_is_certain)
            if not self._is_in_sum(f)
            if isinstance(f, Retune) or max(self._falls(f)) > 0.0
        ]
        of_known_size = [f for f in sure if isinstance(f, Retune) or not f.size_is_open]
        sure = of_known_size or sure
        is_all = len(sure) == len(self.helpful)
        return tuple(f for f in sure if is_all or isinstance(f, Finding))

    @property
    def _sure_together(self) -> tuple[Finding | Retune, ...]:
        """What is sure, where that is several, the main finding among them, or all that
        helps where all but the main one is confident; none where its errors were not
        computed."""
        main, together = self.main_finding, self._sure
        others = [f for f in self.helpful if f is not main]
        if main not in together and all(f.rating == "confident" for f in others):
            together = self.helpful
        has_errors = self.error_with(together) is not None
        is_several = main in together and len(together) > 1
        return together if has_errors and is_several else ()

    @property
    def _offer_of_sure(self) -> Remedy:
        """The offer that adds what is sure together."""
        together = self._sure_together
        if together == self.helpful:
            return self._offer_of_all
        findings = [f for f in self.in_order_of_reading if f in together]
        after = self.error_with(together)
        assert after is not None  # or they would not be together
        named, numbers = named_on_joints(findings), [f.number for f in findings]
        return self._offer_of_several(together, named, "surest", numbers, after)

    @property
    def _offer_of_all(self) -> Remedy:
        """The offer that adds what helps, with the curves where these stay."""
        takes_all = bool(self.curves) and not self.leaves_curves_out
        which = "all" if takes_all else "helpful"
        after = self.held_out_rmse_with_helpful
        offer = self._offer_of_several(
            self.helpful, self._missing, "that help", which, after
        )
        if self.helpful:
            return offer
        words = "add what was measured and has no name"
        if not takes_all:
            words = "leave out the spans in which something passes"
        return replace(offer, change=replace(offer.change, words=words))

    def _offer_of_several(
        self,
        found: Sequence[Finding | Retune],
        problem: str,
        counted: str,
        which: str | list[int],
        after: Array,
    ) -> Remedy:
        """Return the offer that adds several together, with the errors ``after`` (n,) that
        this leaves [N m or N]. A button names few kinds, and counts more, which are
        ``counted``."""
        arguments = {"effects": [f.text for f in found], "findings": which}
        is_confident = all(f.rating == "confident" for f in found)
        names = _names_on_joints([f for f in self.in_order_of_reading if f in found])
        constants = [f for f in found if isinstance(f, Retune)]
        if len(found) == 1:
            names = _names_on_joints(found)
        elif constants:
            names.append(constants_in_words(constants))
        words = f"the {len(found)} {counted}"
        if 0 < len(names) <= _MOST_ON_A_BUTTON:
            words = formatting.words(names)
        return Remedy(
            problem,
            "confident" if is_confident else "near-tie",
            "judged on data left out",
            Change("add", f"add {words}", arguments),
            tuple(self.held_out_rmse_before.tolist()),
            tuple(after.tolist()),
        )

    @property
    def remedies(self) -> tuple[Remedy, ...]:
        """What would mend the log or the model, the most useful first: repairs of the log,
        what is offered, then the runs that decide what is open.
        """
        remedies = [*self.log_faults, *self.offers]
        for finding in self.effects:
            if finding.undecided is not None:
                change = Change(
                    "record",
                    f"record a motion that shows whether it is {finding.title}",
                    {"separate": [*finding.undecided]},
                )
                what = f"{finding.title}: these runs do not decide it"
                remedies.append(Remedy(what, *finding.rating_and_why, change))
        if self.is_undetermined:
            change = Change("record", "record a motion that moves all joints more")
            what = "These runs leave values of the model open"
            why = "the model explains the runs that it is from"
            remedies.append(Remedy(what, "confident", why, change))
        return tuple(remedies)

    @property
    def noise_known(self) -> bool:
        """Whether the noise was measured separately from the model's error.

        True for noise from repetitions, and from a spectrum, which shows it roughly
        (SPECTRUM_KNOWN). False if it was taken from the residual itself.
        """
        return self.noise_source != RESIDUAL

    @property
    def headline(self) -> str:
        """A few sentences: what is missing, what acts for a part of the time, what the
        model has taken in, and how well the noise is known.

        What acts for a part of the time comes first if it has more evidence than any
        finding.
        """
        sentences = [self._missing]
        if self.log_faults:
            faults = "; ".join(
                x.problem.rstrip(".") for x in one_of_rivals(self.log_faults)
            )
            sentences.insert(0, f"It looks as if {faults}. Mend the log first.")
        if self.acting_for_a_time:
            acting = f"For a part of the time: {'; '.join(self.acting_for_a_time)}."
            most = max((f.gain for f in self.effects), default=0.0)
            of_causes = max((cause.evidence for cause in self.passing), default=0.0)
            sentences.insert(0 if of_causes > most else 1, acting)
        return " ".join([*sentences, *self.besides])

    @property
    def besides(self) -> tuple[str, ...]:
        """What is said besides the cause, a sentence each: what the model has taken in, and
        how well the noise is known."""
        sentences = []
        if self.notices:
            noticed = "; ".join(notice.sentence for notice in self.notices)
            sentences.append(f"Taken in by the model: {noticed}.")
        if self.noise_source == SPECTRUM:
            sentences.append(f"The noise is {SPECTRUM_KNOWN}.")  # why: a remark
        return tuple(sentences)

    @property
    def in_order_of_reading(self) -> list[Finding]:
        """The findings as they are read: of those whose torque is certain first what
        lowers the error of the joint that errs most; after that what has no size, and what
        explains an error within the noise, by rating and evidence."""
        ratings = get_args(Rating)
        return sorted(
            self.effects,
            key=lambda f: (
                not f.torque_is_certain,
                self.is_within_noise(f),
                f.size_may_be_zero and not self._is_in_sum(f),
                *(-fall for fall in self._falls(f) if not self.is_within_noise(f)),
                ratings.index(f.rating),
                -f.gain,
            ),
        )

    @property
    def groups_in_order_of_reading(self) -> list[Group]:
        """The groups of findings as they are read, each where its first finding is."""
        groups = ((f, self.group_of(f)) for f in self.in_order_of_reading)
        return [group for finding, group in groups if finding is group.first]

    def _falls(self, finding: Finding) -> list[float]:
        """Return by how much a finding alone lowers the error of each joint, from the one
        that errs most on, in multiples of its noise where that is known; a change of
        less than CHANGES is none."""
        before, after = errors = np.stack(self.errors_of(finding))
        over = over_noise(errors, self.known_floor)
        was, now = errors if over is None else over
        falls = np.where(after < (1.0 - CHANGES) * before, was - now, 0.0)
        return list(map(float, falls[np.argsort(-was, kind="stable")]))

    def is_within_noise(self, finding: Finding) -> bool:
        """Whether no joint of a finding errs by more than ABOVE_NOISE times its noise as
        the model is: little is to be won."""
        over = over_noise(self.errors_of(finding)[0], self.known_floor)
        joints = [joint - 1 for joint in finding.joints]
        return (
            over is not None and float(over[joints or slice(None)].max()) <= ABOVE_NOISE
        )

    @property
    def main_finding(self) -> Finding | None:
        """The first of the findings whose torque is certain, as they are read; None
        without one."""
        return next((f for f in self.in_order_of_reading if f.torque_is_certain), None)

    @property
    def is_open(self) -> bool:
        """Whether something is left of which nothing is sure: weak findings, or torque
        without a name."""
        return not self.helpful and bool(self.effects or self.unexplained_sentence)

    @property
    def cause(self) -> str:
        """The main cause in a few words, its place first: "Joint 3 errs: joint spring
        (confident)", or "The robot errs: base tilt (confident)"."""
        main = self.main_finding
        if main is not None:
            group = self.group_of(main)
            together, badge = group.findings, group.badge
            names = formatting.words([effect_name(f.effect) for f in together])
            likeness = ""
            if main.rivals and not main.effect_is_certain:
                names = f"{names} or {written_in_words(main.short_rivals[0])}"
            elif not main.effect_is_certain:
                likeness = "something like "
            where = f"Joint {main.main_joint}" if main.joints else "The robot"
            text = f"{where} errs: {likeness}{names} ({badge})"
            if self.is_within_noise(main):
                named = named_on_joints(together)
                text = f"{SOME_ERROR_IS_LEFT}: {likeness}{named} ({badge})"
                text = f"{self.good_already} {text}".lstrip()
            others = [found for found in self.helpful if found not in together]
            if len(others) > _MOST_NAMED:
                return f"{text}, and {len(others)} more."
            return f"{text}; also {named_on_joints(others)}." if others else f"{text}."
        if unexplained := self.unexplained_sentence:
            return f"Left: {unexplained}."
        if self.is_open:
            findings = "finding" if len(self.effects) == 1 else "findings"
            return f"No effect is sure beside the model's: {rating_counts(self.effects)} {findings}."
        return self._missing

    @property
    def _missing(self) -> str:
        """What is missing, in a sentence: effects, unexplained torque, settings, or
        nothing.
        """
        # What does not lower the error on data left out is no setting to re-estimate.
        settings = [r for r in self.retuned if r.torque_is_certain]
        certain = [f for f in self.effects if f.effect_is_certain]
        named = named_on_joints(certain or self.effects)
        near_ties = [f for f in self.effects if f.rating == "near-tie"]
        open_names = [f for f in near_ties if not f.effect_is_certain]
        if certain and open_names:
            named += f"; {named_on_joints(open_names)}, or what fits as well"
        findings = "finding" if len(self.effects) == 1 else "findings"
        counted = f"{named} ({rating_counts(self.effects)} {findings})"
        unexplained = self.unexplained_sentence
        if unexplained and certain:
            return f"Missing: {counted}; also {unexplained}."
        if unexplained and self.effects:
            return f"Missing: {unexplained}; possibly {counted}."
        if unexplained:
            return f"Missing: {unexplained}."
        if self.effects:
            text = f"{'Missing' if certain else 'Possibly missing'}: {counted}."
            if settings:
                text += f" Settings to re-estimate: {named_on_joints(settings)}."
            if not self.noise_known:
                text += f" Other {_MAY_HIDE}"
            return text
        if settings:
            return (
                "No effect is missing; settings to re-estimate:"
                f" {named_on_joints(settings)}."
            )
        if self.noise_known:
            return self._nothing
        return f"Nothing was found to be missing; {_MAY_HIDE}"

    @property
    def _nothing(self) -> str:
        """The headline of a diagnosis without findings if the noise is known.

        It names the joint with the largest error over noise, and joints with torque
        that no effect explains.
        """
        over = over_noise(self.held_out_rmse_before, self.known_floor)
        if over is None or not len(over):
            return "Nothing is missing that these measurements could show."
        worst = int(np.argmax(over)) + 1
        left = float(self.held_out_rmse_before[worst - 1])
        unit = self.torque_unit(worst)
        error = formatting.times_noise(float(over[worst - 1]), left, unit)
        above_noise = self.joints_above_noise
        if above_noise:
            is_open = (
                "; these runs leave values of the model open" * self.is_undetermined
            )
            return (
                "No effect of the library explains the torque beyond the noise on"
                f" {formatting.joints(above_noise)}: joint {worst} errs by {error}, on data"
                f" left out{is_open}."
            )
        return (
            "Nothing is missing that these measurements could show:"
            f" {self._within_noise}."
        )

    @property
    def _within_noise(self) -> str:
        """A clause on errors within the noise of every joint; "" where one is larger, or
        the noise is not known."""
        over = over_noise(self.held_out_rmse_before, self.known_floor)
        if over is None or not np.all(over <= ABOVE_NOISE):
            return ""
        j = int(np.argmax(over))
        return formatting.within_noise(
            float(over[j]),
            j + 1,
            float(self.held_out_rmse_before[j]),
            self.torque_unit(j + 1),
            "on data left out",
        )

    @property
    def good_already(self) -> str:
        """A sentence on errors that are within the noise; "" where they are not."""
        return f"Good already: {self._within_noise}." if self._within_noise else ""

    @property
    def held_out_rmse_with_all(self) -> Array:
        """(n,) errors on data left out with all findings, constants and curves [N m or
        N].
        """
        errors = self.ladder[-1].copy()
        for curve in self.curves:
            errors[curve.joint - 1] = curve.held_out_rmse_after
        return errors

    @property
    def held_out_rmse_with_helpful(self) -> Array:
        """(n,) errors on data left out with all that helps, and with the curves where
        these stay: of the model that the next step makes [N m or N]."""
        if self.curves and not self.leaves_curves_out:
            return self.held_out_rmse_with_all
        if not self.helpful:
            return self.held_out_rmse_before
        errors = self.error_with(self.helpful)
        return self.held_out_rmse_with_all if errors is None else errors

    @property
    def held_out_over_noise(self) -> Array | None:
        """(n,) the same over the noise floor; None where the noise is not known."""
        return over_noise(self.held_out_rmse_with_helpful, self.known_floor)

    @property
    def known_floor(self) -> Array | None:
        """(n,) noise floor [N m or N]; None where the residual was taken for noise."""
        return self.noise_floor if self.noise_known else None

    @property
    def joints_above_noise(self) -> list[int]:
        """Joints (from 1) whose error, with all that helps added, exceeds ABOVE_NOISE
        times the noise floor; empty if the noise is not known.
        """
        over = self.held_out_over_noise
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
    def left_sentence(self) -> str:
        """A sentence with the RMS error of each joint on data left out, with all that is
        sure added.
        """
        start = "Error on data left out"
        if self.helpful:
            start += ", with all that helps"
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
        by_joint = [f"j{joint} {error}" for joint, error in enumerate(errors, start=1)]
        still = formatting.left_out_still(self.standstill_left_out)
        unit = "; ".join(filter(None, (unit, still)))
        return f"{start} ({unit}): {', '.join(by_joint)}."

    @property
    def unexplained_sentence(self) -> str:
        """A clause on the torque that no effect explains, with joints and RMS; "" if
        there is none.
        """
        if self.verdict != "unknown_effect":
            return ""
        where = ""
        amount = ""
        if self.remains:
            where = f" on {formatting.joints([r.joint for r in self.remains])}"
            largest = max(self.remains, key=lambda r: r.rmse)
            at_most = " at most" if len(self.remains) > 1 else ""
            unit = self.torque_unit(largest.joint)
            amount = f" ({formatting.quantity(largest.rmse, unit, 2)} RMS{at_most})"
        return f"something{where} that no effect of the library explains{amount}"

    @property
    def advice(self) -> str:
        """What to do next, in one sentence."""
        if self.unexplained_sentence:
            return "Look first at what the error that is left depends on."
        if self.noise_source != REPETITION:
            record = (
                "record a run with more than one period: only repetition tells noise"
                " from error."
            )
            add = f"Add what helps; {record}"
            return add if self.helpful else record.capitalize()
        if self.helpful:
            return "Add what helps, and diagnose the model that results."
        if self.effects or self.retuned:
            return (
                "Record a run that tells the findings from what fits as well: all are"
                " weak."
            )
        if self.joints_above_noise and not self.is_undetermined:
            return "Look at what the error depends on."
        return "Use the model, or record motion that excites more."

    @property
    def weak_companions(self) -> list[str]:
        """What :meth:`selected` with ``helpful`` takes although it is weak, a line
        each with the reasons, such as "joint spring on joint 2 is weak (its size is
        uncertain by > 20 %)".
        """
        return [
            f"{named_on_joints([f])} is weak ({'; '.join(f.remarks)})"
            for f in self.helpful
            if f.rating == "weak"
        ]

    def _summary(self) -> Summary:
        """Return the headline, and rows of label and text for the printed summary."""

        def in_words(values: Array) -> str:
            """Write the numbers of all joints."""
            return ", ".join(f"{x:.3g}" for x in values)

        rows = [
            (f"finding {finding.number}", finding.line)
            for finding in self.worth_showing
        ]
        rows.append(("next", self.advice))
        rows.append(("held-out RMSE", in_words(self.held_out_rmse_before)))
        if self.effects or self.retuned:
            rows.append(("with the findings", in_words(self.ladder[-1])))
        name = "noise floor" if self.noise_source == REPETITION else "noise (estimated)"
        rows.append((name, in_words(self.noise_floor)))
        return self.headline, rows

    @property
    def worth_showing(self) -> tuple[Finding, ...]:
        """The findings without the weak ones at their end, except for two of these."""
        certain = [f.number for f in self.effects if f.torque_is_certain]
        return self.effects[: (certain[-1] if certain else 0) + 2]

    def _table(self) -> Table:
        """Return the table of findings and re-estimated constants for display."""
        rows = []
        for finding in self.effects:
            rivals = ", ".join(finding.rival_texts)
            rows.append((finding.text, finding.size_text, finding.rating, rivals))
        rows += [(r.text, r.in_words, r.rating, "") for r in self.retuned]
        heads = ("effect", "size", "confidence", "indistinguishable from")
        return Table(heads, rows, words=(0, 1, 2, 3))

    @property
    def beside_curves(self) -> tuple[Finding, ...]:
        """The findings that no measured curve replaces."""
        return tuple(f for f in self.effects if not (self.curves and f.fits_a_curve))

    @property
    def format(self) -> int:
        """Format of findings.json."""
        return FINDINGS_FORMAT


def _ratio(after: Array, before: Array) -> Array:
    """Return the ratio of errors (n,); 1 where there was none before."""
    return np.divide(after, before, out=np.ones(len(after)), where=before > 0.0)


def rating_counts(findings: Sequence[Finding | Retune]) -> str:
    """Count findings by rating in words: "2 confident, 1 near-tie and 1 weak"."""
    ratings = [f.rating for f in findings]
    counts = [
        f"{ratings.count(kind)} {kind}" for kind in get_args(Rating) if kind in ratings
    ]
    return formatting.words(counts) if counts else ""


def named_on_joints(findings: Sequence[Finding | Retune]) -> str:
    """Name the effects of findings in words, each once with all of its joints.

    For example "backlash on joints 2 and 3; payload".
    """
    return "; ".join(_names_on_joints(findings))


def _names_on_joints(findings: Sequence[Finding | Retune]) -> list[str]:
    """Name the effects of findings in words, each with all of its joints."""
    joints_by_effect: dict[str, set[int]] = {}
    for finding in findings:
        joints_by_effect.setdefault(finding.effect, set()).update(finding.joints)
    names = []
    for effect, joints in joints_by_effect.items():
        name = effect_name(effect)
        if joints:
            name += f" on {formatting.joints(sorted(joints))}"
        names.append(name)
    return names


def constants_in_words(constants: Sequence[Retune]) -> str:
    """Count constants of the model's own effects that should have other values."""
    count = formatting.count(len(constants), "constant")
    return f"{count} of the model at {'another value' if len(constants) == 1 else 'other values'}"


def load_diagnosis(path: str | Path) -> Diagnosis:
    """Load a diagnosis from a findings.json, as `diagnose --json` writes it.

    Raises
    ------
    InputError
        The file is no findings.json, lacks a field, or has another format.
    """
    return read_json(path, "findings.json", "verdict", _diagnosis_of)


def _diagnosis_of(data: Mapping[str, Any]) -> Diagnosis:
    """Make a diagnosis of the content of a findings.json, after a check of its
    format.
    """
    require_format(data, FINDINGS_FORMAT, _OLDEST_FORMAT, remedy="diagnose again")
    return Diagnosis.from_dict(data)


@dataclass(frozen=True, kw_only=True)
class Retune(ShapeEstimate, Rated):
    """A shape constant of one of the model's own effects that should change on one
    joint."""

    derived = ("kind", "text", *Rated.derived)
    #: What tells it from a finding in files.
    kind: ClassVar[str] = "retune"

    #: Error of the joint on data left out, of the model as it is [N m or N].
    rmse_before: float
    #: The same, with the new value and nothing else.
    rmse_after: float
    #: Both values, in a sentence.
    explanation: str
    #: Reasons for doubt.
    doubts: tuple[Doubt, ...] = ()

    @property
    def joints(self) -> tuple[int, ...]:
        """The joint (from 1) as a tuple, as a finding has its joints."""
        return (self.joint,)

    @property
    def title(self) -> str:
        """The constant and its place, such as "Coulomb friction, joint 7: v_s"."""
        name = formatting.sentence(effect_name(self.effect))
        return f"{name}, joint {self.joint}: {self.shape}"

    @property
    def in_words(self) -> str:
        """Both values, and what the new one does to the error, in a clause."""
        change = formatting.change_of(self.rmse_before, self.rmse_after)
        return f"{self.explanation}; error on data left out: {change}"

    @property
    def remedy(self) -> Remedy:
        """What would mend the model: this constant at its new value."""
        arguments = {"effects": [self.text]}
        change = Change("reset", f"re-estimate {self.title}", arguments)
        return Remedy(self.explanation, *self.rating_and_why, change)

    @property
    def text(self) -> str:
        """The written form with the new value, such as "coulomb_friction:7@v_s=0.08",
        which :func:`~sdp_vs_penalty.add` takes.
        """
        return f"{self.effect}:{self.joint}@{self.shape}={self.after:.6g}"
