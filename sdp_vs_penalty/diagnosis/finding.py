"""One finding of a diagnosis, one constant to re-estimate, and how sure each is."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

import numpy as np

from sdp_vs_penalty import formatting
from sdp_vs_penalty.diagnosis.curves.curve import CURVE
from sdp_vs_penalty.diagnosis.doubts import Doubt
from sdp_vs_penalty.effects import (
    FittedEffect,
    effect_name,
    effect_types,
    on_the_arm,
    standard_effect,
)
from sdp_vs_penalty.effects.plain_words import ON_THE_ARM, written_in_words
from sdp_vs_penalty.effects.written import WrittenEffect, read_effect
from sdp_vs_penalty.estimation.constants import NORMAL_95
from sdp_vs_penalty.estimation.shapes import ShapeEstimate
from sdp_vs_penalty.estimation.uncertainty import unit_by
from sdp_vs_penalty.formatting import plain_unit
from sdp_vs_penalty.records import JsonRecord
from sdp_vs_penalty.results.remedy import Change, Rating, Remedy
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.robot import STANDARD_GRAVITY

#: Relative standard deviation of a size from which its torque is said too: a 95 %
#: interval of 20 % to either side.
_WIDE = 0.1


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
    def _open_parts(self) -> set[str]:
        """What the doubts leave open: "name", "size", "torque" or "cause"."""
        return {doubt.meaning.leaves_open for doubt in self.doubts}

    @property
    def rating(self) -> Rating:
        """ "confident", "near-tie" or "weak".

        A finding whose only doubt is that something else fits as well is a near-tie:
        its torque is there, and only its name is open. All other doubts make it weak.
        """
        if not self.doubts:
            return "confident"
        return "near-tie" if self._open_parts == {"name"} else "weak"

    @property
    def badge(self) -> str:
        """The rating, or what is uncertain of a weak one whose torque is there."""
        if self.rating != "weak" or not self.torque_is_certain:
            return self.rating
        return "size uncertain" if self._open_parts == {"size"} else "cause uncertain"

    @property
    def rating_and_why(self) -> tuple[Rating, str]:
        """The rating, and the reasons for doubt."""
        return self.rating, "; ".join(self.remarks) or "shown on data left out"

    @property
    def has_open_torque(self) -> bool:
        """Whether a doubt leaves open that the torque is there."""
        return "torque" in self._open_parts

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


def is_law_of(name: str, other: str) -> bool:
    """Return whether two effects, given by name, are laws (formulas) of one physical
    effect.

    They are if the names are equal, or if one effect declares that it refines the
    other, as Stribeck friction refines Coulomb friction, or has the same law; or if that
    holds for other names of their laws.
    """
    types = effect_types()
    names, others = (
        [x for x in types if x == law or travel_of_law(x, law)] for law in (name, other)
    )
    return name == other or any(
        x == y or x in types[y].refines or y in types[x].refines
        for x in names
        for y in others
    )


def travel_of_law(name: str, other: str) -> str:
    """Return the name of the shape constant whose bounds alone tell two effects, given by
    name, as stiction and pre-sliding hysteresis; "" where they have other laws."""
    types = effect_types()
    there = types[other].same_law_as.get(name, "")
    return types[name].same_law_as.get(other, there)


def other_names_of_law(name: str, shape: Mapping[str, float]) -> list[str]:
    """Return the other names that the law of an effect has over its travel: the effects
    with the same law whose bounds hold that, as stiction those of a short travel."""
    types = effect_types()
    names = list[str]()
    for other, kind in types.items() if name in types else ():
        travel = travel_of_law(name, other)
        if travel in shape:
            low, high = kind.shapes[travel].bounds or (0.0, np.inf)
            names += [other] * (low <= shape[travel] <= high)
    return names


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
ERRORS_OF_STEP = ("held_out_rmse_before", "held_out_rmse_after")


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
        if "main_joint" not in data and {*ERRORS_OF_STEP} <= {*data}:
            before, after = (np.array(data[name], float) for name in ERRORS_OF_STEP)
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
        """The torque that it makes, such as "0.21 ± 0.01 N m RMS over these runs"; ""
        if that is not known (findings.json of an older version).
        """
        if self.torque_rms is None or self.torque_std is None:
            return ""
        half = NORMAL_95 * self.torque_std
        unit = plain_unit(self.torque_unit)
        return f"{formatting.amount(self.torque_rms, half, unit)} RMS over these runs"

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
        for name in other_names_of_law(self.effect, self.shape):
            travel = travel_of_law(self.effect, name)
            default, other = (
                types[x].shapes[travel].default for x in (self.effect, name)
            )
            length = "shorter" if other < default else "longer"
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
    def says_torque(self) -> bool:
        """Whether :attr:`on_the_arm` says how large the torque is in place of a size that
        may be zero."""
        return self.size_may_be_zero and self._torque_is_known

    @property
    def says_open_law(self) -> bool:
        """Whether :attr:`on_the_arm` says a torque alone, and the laws that may make it."""
        is_open = self.size_may_be_zero or bool(self.family_in_words)
        return bool(self.rivals) and is_open and self._torque_is_known

    @property
    def family_in_words(self) -> str:
        """What is certain where the laws that fit as well are all those of friction at
        reversals: "joint 4 sticks or gives way at reversals"; else ""."""
        types = effect_types()
        names = [self.effect, *(rival.name for rival in self.rivals)]
        are_at_reversals = all(
            name in types
            and types[name].seen_against == "reversal"
            and is_law_of(name, self.effect)
            for name in names
        )
        if len(names) == 1 or self.fits_a_curve or not are_at_reversals:
            return ""
        return f"joint {self.main_joint} sticks or gives way at reversals"

    @property
    def size_is_open(self) -> bool:
        """Whether a doubt leaves the size open, or its interval holds zero."""
        return self.size_may_be_zero or "size" in self._open_parts

    @property
    def effect_is_certain(self) -> bool:
        """Whether the effect is certainly present, though its formula or size may be
        open.

        True if nothing but its size is uncertain, and what fits as well are formulas
        of the same physical effect.
        """
        laws = [is_law_of(rival.name, self.effect) for rival in self.rivals]
        doubts = [doubt.meaning.leaves_effect_certain for doubt in self.doubts]
        return all(doubts) and all(laws)

    @property
    def on_the_arm(self) -> str:
        """A sentence on what the effect is mechanically on the arm, with its size."""
        names = [self.effect, *other_names_of_law(self.effect, self.shape)]
        rivals = [written_in_words(x) for x in self.short_rivals]
        laws = [*dict.fromkeys([*map(effect_name, names), *rivals])]
        open_law = f"; which law makes it is open: {', '.join(laws[:-1])} or {laws[-1]}"
        if self.family_in_words and self.says_open_law:
            return f"{ON_THE_ARM}{self.family_in_words}, {self.torque_text}{open_law}."
        if self.size_may_be_zero:
            if not self._torque_is_known:
                return f"{ON_THE_ARM}these runs do not tell its size from zero."
            where = f" of {formatting.joints(self.joints)}" if self.joints else ""
            when = f"that changes with the {self.seen_against or 'motion'}{where}"
            if self.seen_against == "reversal":
                when = f"at each reversal{where}"
            text = f"{ON_THE_ARM}a torque {when}, {self.torque_text}"
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
        if self.family_in_words:
            text += f" {formatting.sentence(self.family_in_words)}."
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
        """The effects that a motion has to tell apart, as texts: the finding and its first
        rival, ("backlash:3", "spring:3"). A weak finding without rivals is to be told
        from no effect, and is alone, as is one of the whole robot.

        None where nothing is open: a confident finding without rivals. None where no
        motion can decide: a measured curve is the rival, which is no effect, or the
        arm has to cool down (:attr:`cool_down_instruction`).
        """
        can_motion_decide = not (self.fits_a_curve or self.cool_down_instruction)
        if not can_motion_decide:
            return None
        if self.joints and self.rivals:
            return self.text, self.rivals[0].text
        return (self.text,) if self.doubts else None

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


def named_on_joints(findings: Sequence[Finding | Retune]) -> str:
    """Name the effects of findings in words, each once with all of its joints.

    For example "backlash on joints 2 and 3; payload".
    """
    return "; ".join(names_on_joints(findings))


def names_on_joints(findings: Sequence[Finding | Retune]) -> list[str]:
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
