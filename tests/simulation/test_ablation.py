"""What a rule of the search buys is counted on the same cases with and without it."""

import pytest
from challenge.ablation import (
    WITH_ALL,
    Discordance,
    WatchedRules,
    ablation_csv,
    ablation_text,
    append_record,
    doubt_lines,
    is_right,
    judgement,
    read_store,
)
from challenge.cases import Case

from sdp_vs_penalty.diagnosis import Rules


def record(found, kind="strong"):
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


def finding(effect="joint_spring"):
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
    assert right.strip().startswith("+2 -1 (p = 1,")


@pytest.mark.parametrize(
    ("mended", "spoilt", "begin"),
    [
        (9, 0, "earns its place"),
        (0, 9, "does harm"),
        (2, 1, "not judged at this n (2 answers mended, 1 spoilt)"),
    ],
)
def test_a_rule_is_judged_where_its_cases_can_tell(mended, spoilt, begin):
    counts = {"right": Discordance(mended, spoilt, n_cases=90)}
    assert judgement(counts, n_changed=mended + spoilt).startswith(begin)


def test_a_rule_that_changes_nothing_has_the_limit_of_its_cases():
    nothing = {"right": Discordance(0, 0, n_cases=90)}
    assert judgement(nothing, 0) == "changes no case: under 3.3 % of cases (95 %)"


def test_the_interval_of_what_is_mended_narrows_with_cases():
    few = Discordance(2, 0, n_cases=20).interval
    many = Discordance(20, 0, n_cases=200).interval
    assert few[0] < 0.0 < many[0]


def test_a_store_goes_on_where_it_stopped(tmp_path):
    case = Case("strong", "plain", 1, 0)
    for rule in (WITH_ALL, "exchange"):
        append_record(tmp_path / "rules.jsonl", case, rule, RIGHT)
    known = read_store(tmp_path / "rules.jsonl")
    assert known == {case.key: {WITH_ALL: RIGHT, "exchange": RIGHT}}


def test_a_rule_that_no_decision_asks_is_not_run_again():
    watched = WatchedRules()
    assert watched.simplest
    assert watched.asked == {"simplest"}


def test_every_case_and_rule_is_a_row_of_answers():
    lines = ablation_csv({"a": {WITH_ALL: RIGHT, "exchange": SILENT}}).splitlines()
    assert lines[1] == "a,exchange,1,0,1,1,1,1,1,1,1"


def test_a_reason_for_doubt_is_counted_by_what_is_hidden():
    weak = finding() | {"confidence": "weak", "doubts": [{"reason": "small"}]}
    two = {"doubts": [{"reason": "uncertain"}, {"reason": "held"}]}
    false = finding("base_tilt") | {"confidence": "weak"} | two
    lines = doubt_lines([record([weak, false])])
    assert "| its gain is small | 1 | 0 | 1 | 0 |" in lines


def test_every_rule_can_be_left_out():
    assert set(Rules.names()) >= {"exchange", "simplest", "law_misfits"}
    assert all(getattr(Rules(), name) for name in Rules.names())
