"""One model of a session's history, judged."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from sdp_vs_penalty import formatting
from sdp_vs_penalty.diagnosis.findings import Diagnosis
from sdp_vs_penalty.diagnosis.where_it_fails import Failures
from sdp_vs_penalty.effects.written import read_effect
from sdp_vs_penalty.estimation.constants import CHANGES
from sdp_vs_penalty.estimation.verdict import (
    NOISE_OF_SPECTRUM,
    Grade,
    Verdict,
    over_noise,
)
from sdp_vs_penalty.page.spoken import spoken
from sdp_vs_penalty.records import JsonRecord
from sdp_vs_penalty.render.tables import facts_from_json
from sdp_vs_penalty.results.facts import Fact
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.signals.noise import said_before

#: Colours of grades that are not called like these.
_LEVELS = {"do not use": "bad"}
#: So many times the error of the runs that a model is from: something has changed since.
CHANGED = 5.0


def level_of(grade: Grade) -> str:
    """Return the colour of a grade: "good", "usable" or "bad"."""
    return _LEVELS.get(grade, grade)


def joints_of(text: str) -> set[int]:
    """Return the joints (from 1) of an effect, as `add` writes it; none: of all."""
    return {*read_effect(text).joints}


def is_among(text: str, effects: Iterable[str]) -> bool:
    """Whether a model has an effect, as `add` writes it, whatever its constants."""
    one = read_effect(text)
    return any(
        other.name == one.name
        and (not other.joints or {*one.joints} <= {*other.joints})
        for other in map(read_effect, effects)
    )


@dataclass(frozen=True)
class ModelStep(JsonRecord):
    """One model of a session's history, judged: what ``summary`` of jobs.py says."""

    #: Its model.json, beside it the .npz of each run's torques.
    file: str
    #: Names of the runs in these files, training runs first, a part of a run by its
    #: seconds.
    runs: list[str]
    #: Names of the runs behind comparison and failures.
    judged_on: list[str]
    #: Name of the estimator.
    method: str
    #: Effects of the model.
    effects: list[str]
    #: Comparison with the judging runs, as `compare --json` writes it.
    comparison: dict[str, Any]
    #: Where and why the model fails, an entry a joint, with sentences for the page;
    #: empty if the judged runs are too short to tell.
    failures: list[dict[str, Any]]
    #: Facts of the model for the page (``about`` of jobs.py).
    about: dict[str, Any]
    #: Bounds that decide in place of the data, and bodies that the data enlarged, a line
    #: each.
    on_bounds: list[str]
    #: Time that the estimate took [s].
    seconds: float
    #: (n,) error of each joint [N m, N] in each run alone, by the run's name, where some
    #: are for training and others for testing; empty for very long ones.
    errors_of_runs: dict[str, list[float]] = field(default_factory=dict)
    #: The same of a test run in the motion that training runs reach too; without those
    #: that hardly hold any.
    errors_in_reach: dict[str, list[float]] = field(default_factory=dict)
    #: Name of the step.
    label: str = ""
    #: Effects added to the step below.
    added: tuple[str, ...] = ()
    #: Which findings these were: their numbers, "helpful" or "all"; None for effects
    #: by their names.
    findings_added: str | list[int] | None = None
    #: Names of the test runs whose errors chose what was added, in this step or before.
    chosen_on: tuple[str, ...] = ()
    #: Whether the others were held when effects were added.
    frozen: bool = False
    #: The largest error of a joint ("size", in multiples of its noise or % of its torque),
    #: that of the joint that errs most beside a grade ("error"), and in a sentence
    #: ("worst").
    errors: dict[str, Any] = field(default_factory=dict)
    #: The same of the robot as its file states it; empty for servos.
    factory: dict[str, Any] = field(default_factory=dict)
    #: By file of `export` that cannot hold all of it, what is known of that file: the
    #: same, "lost" effects in words, their number "n_lost", and how they are written
    #: ("left_out"), which joints err more for that in a sentence ("loss") and in brief
    #: ("losses", "" where none does), "effects" that it holds as `identify` takes them,
    #: "verdict" as the file says it; the "model" that was identified again for it, ""
    #: where that errs no less, and the laws in words that this has "in_place" of what
    #: is lost.
    exported: dict[str, dict[str, Any]] = field(default_factory=dict)
    #: File that a person brought; "" for none.
    opened: str = ""
    #: Whether it knows the servos of a log without torque.
    servo: bool = False
    #: What it lacks, if it was diagnosed.
    findings: Diagnosis | None = None
    #: Names that `add` has for the curves of the findings.
    curve_texts: tuple[str, ...] = ()
    #: File of what the cards of its diagnosis draw.
    pictures: str = ""

    @cached_property
    def facts(self) -> dict[str, Fact]:
        """The facts of the comparison with the judging runs."""
        return facts_from_json(self.comparison)

    @property
    def verdict(self) -> Verdict:
        """The verdict on the model."""
        return Verdict.from_dict(self.comparison["verdict"])

    def verdict_on(self, file: str) -> Verdict:
        """The verdict that stands in a file of `export`: on what that holds."""
        record = self.exported.get(file)
        return self.verdict if record is None else Verdict.from_dict(record["verdict"])

    def model_of(self, file: str) -> str:
        """The model.json that a file is made of."""
        name = self.exported.get(file, {}).get("model", "")
        return str(Path(self.file).with_name(name)) if name else self.file

    def identified_without(self, file: str) -> list[str]:
        """The effects, as they are written, that the model of a file was identified again
        without."""
        record = self.exported.get(file, {})
        return record.get("left_out", []) if record.get("model") else []

    def worse_than(self, errors: Mapping[str, Any], first: ModelStep) -> str:
        """Say of what a model, or a file of it, with these ``errors`` errs more: of the
        robot as its file states it, or of the first model; "" for neither."""
        known = {"the robot's own file as it came": self.factory}
        if first is not self:
            known["the model that you began with"] = first.errors
        limit = errors.get("size", 0.0) / (1.0 + CHANGES)
        for name, other in known.items():
            if other.get("size", np.inf) < limit:  # none in files of older versions
                return f"Worse than {name} ({other['error']})."
        return ""

    def lesser_files(self, names: Collection[str]) -> str:
        """Say which of these files of `export` err more than the model, since they cannot
        hold all of it; "" where none does."""
        losses = {x: self.exported.get(x, {}).get("losses", "") for x in names}
        errors = [f"{name} ({text})" for name, text in losses.items() if text]
        lacks = "Files that cannot hold all of it err more"
        return f"{lacks}: {formatting.words(errors)}." if errors else ""

    @property
    def noise_floor(self) -> Array | None:
        """(n,) noise floor of each joint [N m, N]; None where one is not known."""
        floor = self.comparison["noise_floor"]
        return None if floor is None or None in floor else np.array(floor, float)

    @property
    def headline(self) -> str:
        """Which joint errs most, and by how much, in a sentence."""
        return spoken(said_before(self.verdict.reason.replace(NOISE_OF_SPECTRUM, "")))

    @property
    def noise_in_words(self) -> str:
        """Where the noise of :attr:`headline` is from, in a sentence; "" where it was
        measured."""
        is_of_spectrum = NOISE_OF_SPECTRUM in self.verdict.reason
        noise = spoken(said_before(NOISE_OF_SPECTRUM.removeprefix("; ")))
        return formatting.sentence(noise) if is_of_spectrum else ""

    @property
    def worst_joint(self) -> int:
        """The joint (from 1) that errs most, by the measure that it is graded by."""
        return int(self.facts["worst_joint"].value)

    @property
    def where_it_fails(self) -> Failures:
        """Where and why the model fails, joint by joint."""
        return Failures.from_dict({"units": (), "joints": self.failures})

    @property
    def differing_tests(self) -> dict[str, int]:
        """The runs that the model was not identified from, and in which a joint errs far
        more than in those that it is from. Of each the joint (from 0) that errs most of
        those, as the bars show it."""
        floor = self.comparison["noise_floor"]
        differing = {}
        for name in self.errors_of_runs:
            errors = np.array(self.errors_of_runs[name])
            times = errors / self.usual_error
            if name in self.judged_on and times.max() > CHANGED:
                over = over_noise(errors, floor)
                size = times if over is None else over
                differing[name] = int(np.where(times > CHANGED, size, 0.0).argmax())
        return differing

    @property
    def changed_runs(self) -> dict[str, int]:
        """Those of :attr:`differing_tests` in which a joint errs as much in motion that the
        training runs reach too: something has changed since. In other motion an effect
        may show that the model lacks."""
        usual = self.usual_error if self.errors_in_reach else np.empty(0)
        return {
            name: joint
            for name, joint in self.differing_tests.items()
            if name in self.errors_in_reach
            and np.max(np.array(self.errors_in_reach[name]) / usual) > CHANGED
        }

    @property
    def usual_error(self) -> Array:
        """(n,) largest error of each joint in the runs that the model is from [N m, N]."""
        runs = self.errors_of_runs.items()
        return np.max([e for x, e in runs if x not in self.judged_on], axis=0)

    def error_in(self, run: str) -> str:
        """Say how far the model errs in one run alone, by the measure that it is graded by."""
        alone = self.errors_of_runs.get(run)
        floor = self.comparison["noise_floor"] if alone else None
        over = over_noise(np.array(alone), floor)
        if over is None:
            return "its error is in that of all tests."
        joint, most = int(over.argmax()) + 1, formatting.number(float(over.max()))
        return f"there alone joint {joint} errs most, {most} times its noise."

    def change_in_words(self, units: Sequence[str]) -> str:
        """Say how the first of the changed runs differs; "" without one."""
        for name, j in self.changed_runs.items():
            there, before = self.errors_of_runs[name][j], self.usual_error[j]
            unit = formatting.plain_unit(units[j])
            amounts = [formatting.quantity(x, unit) for x in (there, before)]
            return (
                f"Joint {j + 1} errs by {amounts[0]} in {name}, and by {amounts[1]} in the"
                " runs that the model is from."
            )
        return ""

    @property
    def scope(self) -> str:
        """What the errors are of: "on unseen motion (test.csv)"."""
        known = self.facts.get("kind_of_error")  # none in files of older versions
        is_recorded = self.facts["new_motion_percent"].value is not None
        kind = (known.text if known else "") or "on unseen motion" * is_recorded
        fitted = {*self.runs[: len(self.runs) - len(self.judged_on)]}
        if known and known.text and fitted:
            kind = f"{kind}, in other runs"
        names = [*dict.fromkeys(name.partition(", ")[0] for name in self.judged_on)]
        if not {*self.chosen_on}.isdisjoint(self.judged_on):
            kind = f"{kind}, which helped to choose what was added"
        runs = formatting.words(names)
        runs = runs if len(names) <= 3 else f"{len(names)} runs"
        parts = "parts of " if len(names) < len(self.judged_on) else ""
        together = ", together" if len(names) > 1 else ""
        kind = spoken(kind).rstrip(".")
        return f"{kind} ({parts}{runs}{together})".lstrip()
