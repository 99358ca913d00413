"""What a rule of the search buys is counted on the same cases with and without it."""

from typing import Any

import pytest
from challenge.ablation import WITH_ALL, ablation_text, is_right

from sdp_vs_penalty.diagnosis import Rules


def record(found: list[dict[str, Any]], kind: str = "strong") -> dict[str, Any]:
    """Of a robot that lacks a spring on joint 1; of a clean one nothing."""
    hidden = {"effect": "joint_spring", "joints": [1], "shape": {}, "size": 1.0}
    return {
        "class": kind,
        "truth": [] if kind == "clean" else [hidden],
        "deviation": [0.0],
        "energy": [100.0],
        "fair": [],
        "abstains": False,
        "found": found,
        "retuned": [],
        "events": [],
        "verdict": "effect_missing" if found else "nothing_missing",
        "held_out": [1.0, 1.0] if found else [1.0, 1.1],
        "seconds": 1.0,
    }


def finding(effect: str = "joint_spring") -> dict[str, Any]:
    return {
        "effect": effect,
        "text": f"{effect}:1",
        "joints": [1],
        "shape": {},
        "size": 1.0,
        "std": 0.1,
        "confidence": "confident",
        "indistinguishable_from": [],
    }


RIGHT = record([finding()])
SILENT = record([])


@pytest.mark.parametrize(
    ("case", "right"),
    [
        (RIGHT, True),
        (SILENT, False),
        (record([], "clean"), True),
        (record([finding()], "clean"), False),
    ],
)
def test_a_case_is_right_where_what_is_hidden_is_named_and_nothing_else(case, right):
    assert is_right(case) == right


def test_mended_and_spoilt_cases_are_counted_in_pairs():
    known = {
        "a": {WITH_ALL: RIGHT, "exchange": SILENT},
        "b": {WITH_ALL: RIGHT, "exchange": RIGHT},
        "c": {WITH_ALL: SILENT, "exchange": RIGHT},
        "d": {WITH_ALL: RIGHT, "exchange": SILENT},
    }
    (row,) = [
        x for x in ablation_text(known).splitlines() if x.startswith("| exchange")
    ]
    _, _, cases, right, *_ = row.split("|")
    assert cases.strip() == "4"
    assert right.strip() == "+2 -1 (1)"


def test_every_rule_can_be_left_out():
    assert set(Rules.names()) >= {"exchange", "simplest", "law_misfits"}
    assert all(getattr(Rules(), name) for name in Rules.names())
