"""What a diagnosis says: findings, verdict, offers, and the JSON of them, there and back."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sdp_vs_penalty.diagnosis.diagnosis_data import DiagnosisData
from sdp_vs_penalty.diagnosis.finding import Finding
from sdp_vs_penalty.diagnosis.offers import Offers
from sdp_vs_penalty.diagnosis.sentences import advice, headline
from sdp_vs_penalty.estimation.constants import NORMAL_95
from sdp_vs_penalty.files import read_json, require_format
from sdp_vs_penalty.results.record import Summary
from sdp_vs_penalty.results.remedy import Change, Remedy
from sdp_vs_penalty.results.table import Table
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.signals.noise import REPETITION

if TYPE_CHECKING:
    import pandas


#: Of findings.json, and the oldest that is read.
FINDINGS_FORMAT = 4
_OLDEST_FORMAT = 2


@dataclass(frozen=True, repr=False)
class Diagnosis(DiagnosisData):
    """What a model lacks: the missing effects, and what the recordings say of
    everything else."""

    derived = ("format", "facts", "remedies")

    def errors_of(self, finding: Finding) -> tuple[Array, Array]:
        """Return a finding's errors on data left out, (n,) before and after it [N m or N]:
        the one figure of its joint that every place says (:meth:`Offers.errors_of`)."""
        return self.offers.errors_of(finding)

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

    @cached_property
    def offers(self) -> Offers:
        """What would mend the model at once, each with the errors on data left out that
        it leaves; first what is advised."""
        return Offers(self)

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
    def headline(self) -> str:
        """A few sentences: what is missing, what acts for a part of the time, what the
        model has taken in, and how well the noise is known."""
        return headline(self)

    def _summary(self) -> Summary:
        """Return the headline, and rows of label and text for the printed summary."""

        def in_words(values: Array) -> str:
            """Write the numbers of all joints."""
            return ", ".join(f"{x:.3g}" for x in values)

        rows = [
            (f"finding {finding.number}", finding.line)
            for finding in self.worth_showing
        ]
        rows.append(("next", advice(self)))
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
    def format(self) -> int:
        """Format of findings.json."""
        return FINDINGS_FORMAT


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
