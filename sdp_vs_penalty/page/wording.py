"""How numbers, units and names are written on the page."""

from __future__ import annotations

from collections.abc import Sequence

from sdp_vs_penalty import formatting
from sdp_vs_penalty.diagnosis.findings import Finding
from sdp_vs_penalty.formatting import number as figure
from sdp_vs_penalty.formatting import plain_unit


def spoken(text: str) -> str:
    """A sentence of the command line's for the page, where a stage stands for the command.

    >>> spoken("Torque beyond the noise; `diagnose` names causes.")
    'Torque beyond the noise; Diagnose names causes.'
    """
    return text.replace("`diagnose`", "Diagnose").replace("`", "")


def with_unit(value: float | None, unit: str) -> str:
    return f"{figure(value)} {plain_unit(unit)}".strip()


def plain_name(effect: str) -> str:
    """presliding_hysteresis as Presliding hysteresis."""
    return effect.replace("_", " ").capitalize()


def where(joints: Sequence[int]) -> str:
    return formatting.joints(joints) if joints else "whole robot"


def physics(finding: Finding) -> str:
    """The sentences of a finding that say what it is, without its size and its rivals."""
    text = finding.explanation.partition(". ")[2]
    return text.partition(" Indistinguishable in these data from")[0]
