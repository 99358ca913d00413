"""The record of a cause that acts for a part of the runs only."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from sdp_vs_penalty import formatting
from sdp_vs_penalty.data.files import without_spans as leave_out
from sdp_vs_penalty.data.measurements import Measurements, concatenate
from sdp_vs_penalty.estimation.constants import NORMAL_95
from sdp_vs_penalty.records import JsonRecord

#: Share of the samples that has to be left without the spans in which something acts.
ENOUGH = 1.0 / 3.0
#: Of a law of :mod:`~sdp_vs_penalty.diagnosis.passing`: what it is in words, and
#: whether it acts on a link or on a joint.
_IN_WORDS = {
    "load": ("a load", "link"),
    "force": ("a constant force", "link"),
    "torque": ("a constant torque", "joint"),
    "friction": ("a change of dry friction", "joint"),
    "gain": ("a change of the torque channel's gain", "joint"),
}


@dataclass(frozen=True)
class Span(JsonRecord):
    """A span of time of one run."""

    #: Name of the run; empty where there is one run only.
    run: str
    #: Begin [s] on the run's clock.
    t_start: float
    #: End [s] on the run's clock.
    t_end: float

    def covers(self, t: float) -> bool:
        """Return whether an instant [s], of any run, is within the span."""
        return self.t_start <= t <= self.t_end


@dataclass(frozen=True)
class PassingLaw(JsonRecord):
    """What kind of cause acts where."""

    #: "load", "force", "torque" or "friction", as :class:`PassingCause` says; "gain" in
    #: older files.
    kind: str
    #: Number of the link or joint, from 1.
    place: int

    @property
    def in_words(self) -> str:
        """What acts where, such as "a constant force on link 3"."""
        what, part = _IN_WORDS[self.kind]
        return f"{what} on {part} {self.place}"


@dataclass(frozen=True)
class PassingCause(JsonRecord):
    """What acts for a part of the runs only."""

    #: "load" (carried by the last link), "force" (constant in the world), "torque"
    #: (constant, on one joint) or "friction" (a change of it, on one joint); "gain" in
    #: older files.
    kind: str
    #: Number of the link or joint, from 1.
    place: int
    #: Mass [kg], force [N], torque [N m or N], or gain [-], in ``unit``; a negative mass is that
    #: of a load that is missing.
    size: float
    #: Standard deviation of the size, in ``unit``.
    std: float
    #: Unit of the size.
    unit: str
    #: Of a load its mass [kg] and first moments [kg m] in the link's frame, of a force
    #: its components [N] in the world, of a torque the torque itself.
    parameters: tuple[float, ...]
    #: (3,) where a force acts, in the link's frame [m].
    point: tuple[float, ...]
    #: The spans of time in which the cause acts.
    spans: tuple[Span, ...]
    #: Share of the error in these spans that the cause explains.
    share: float
    #: Evidence of the cause, as of findings.
    evidence: float
    #: Laws that explain about as much.
    rivals: tuple[PassingLaw, ...] = ()

    @classmethod
    def upgraded(cls, data: Mapping[str, Any]) -> Mapping[str, Any]:
        """Read the rivals of older findings, which are texts such as "force:3"."""
        rivals = [
            {"kind": x.split(":")[0], "place": int(x.split(":")[1])}
            if isinstance(x, str)
            else x
            for x in data.get("rivals", ())
        ]
        return {**data, "rivals": rivals}

    @property
    def sentence(self) -> str:
        """What it is, how large, where, when, and how much it explains; its rivals."""
        what, part = _IN_WORDS[self.kind]
        unit = formatting.plain_unit(self.unit)
        size = abs(self.size) if self.kind == "load" else self.size
        sized = formatting.amount(size, NORMAL_95 * self.std, unit)
        amount = f" of {sized} (95 %)"
        text = f"{what}{amount} on {part} {self.place}"
        if self.is_lack:
            text = f"{what}{amount} is missing on {part} {self.place}"
        text += (
            f" {self.when} (explains {formatting.percent(self.share, 2)} of the error"
        )
        text += " then)"
        if self.rivals:
            named = formatting.words([law.in_words for law in self.rivals])
            text += f"; {named} would explain as much"
        return text

    @property
    def is_lack(self) -> bool:
        """Whether a load is missing that acts the rest of the time."""
        return self.kind == "load" and self.size < 0.0

    @property
    def when(self) -> str:
        """The spans in words."""
        return spans_in_words(self.spans)


def spans_in_words(spans: Sequence[Span]) -> str:
    """Write spans, such as "from 8.0 s to 15.2 s of run2"."""
    texts = []
    for span in spans:
        text = f"from {span.t_start:.1f} s to {span.t_end:.1f} s"
        texts.append(f"{text} of {span.run}" if span.run else text)
    return formatting.words(texts)


def beside_spans(runs: Measurements, spans: Sequence[Span]) -> Measurements:
    """Return runs without spans in which something acts; the same object if nothing is
    left out.

    A model that is identified from the spans too would take in what acts there. They
    stay in where less than ENOUGH of the samples would be left, and where the spans
    name no run and there are several.
    """
    several = len(runs.names) > 1
    spans = [s for s in spans if s.run in runs.names or not (several or s.run)]
    rest = without_spans(runs, spans)
    is_enough = ENOUGH * runs.samples <= rest.samples < runs.samples
    return rest if is_enough else runs


def without_spans(runs: Measurements, spans: Sequence[Span]) -> Measurements:
    """Return runs without the samples in some spans of time, and a margin beside them.

    Parameters
    ----------
    spans
        Spans, each with the name of its run; without a name of any run.

    Returns
    -------
    Measurements
        Runs with gaps. One that a span covers altogether is left out.
    """
    kept = []
    for run in runs.runs():
        of_run = [s for s in spans if s.run in ("", run.names[0])]
        rest = leave_out(run, [(s.t_start, s.t_end) for s in of_run])
        if rest.samples:
            kept.append(rest)
    return concatenate(kept) if kept else runs.rows(slice(0, 0))
