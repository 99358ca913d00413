"""One model of a session's history, judged."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

from sdp_vs_penalty.diagnosis.findings import Diagnosis
from sdp_vs_penalty.records import JsonRecord
from sdp_vs_penalty.render.tables import facts_from_json
from sdp_vs_penalty.results.facts import Fact


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
    #: Name of the step.
    label: str = ""
    #: Effects added to the step below.
    added: tuple[str, ...] = ()
    #: Which findings these were: their numbers, "confident" or "all"; None for effects
    #: by their names.
    findings_added: str | list[int] | None = None
    #: Whether the others were held when effects were added.
    frozen: bool = False
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
    def error(self) -> str:
        """ "Error", with what stands beside it where it is not of unseen motion."""
        kind = self.facts.get("kind_of_error")  # none in files of older versions
        return f"Error {kind.text}".rstrip() if kind else "Error"
