"""Records come back from JSON as they went, and others are refused."""

import json
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import pytest
from drawn import given, st
from numpy.typing import NDArray

import sdp_vs_penalty
from sdp_vs_penalty import InputError
from sdp_vs_penalty.diagnosis import load_diagnosis
from sdp_vs_penalty.estimation.estimate import estimate_of_file, load_estimate
from sdp_vs_penalty.estimation.verdict import doubt_of_log
from sdp_vs_penalty.records import JsonRecord
from sdp_vs_penalty.results import Certainty, StoredIssue

finite = st.floats(-1e6, 1e6)


@dataclass(frozen=True)
class Inner(JsonRecord):
    size: float
    kind: Literal["a", "b"] = "a"

    def __post_init__(self):
        if self.size < 0.0:
            raise InputError("a size is below 0", "give another")


@dataclass(frozen=True)
class Outer(JsonRecord):
    derived = ("total",)

    name: str
    few: tuple[int, str]
    many: tuple[Inner, ...]
    rows: NDArray[np.float64]
    by_name: Mapping[str, float]
    far: float = np.inf
    more: Inner | None = None

    def total(self):
        return float(self.rows.sum())


@given(
    st.lists(finite, max_size=3),
    st.sampled_from(["a", "b"]),
    st.text('aé\n"\\', max_size=5),
    finite,
)
def test_records_come_back(sizes, kind, name, far):
    inner = tuple(Inner(abs(size), kind) for size in sizes)
    record = Outer(
        name=name,
        few=(3, "x"),
        many=inner,
        rows=np.array([sizes, sizes]),
        by_name={"k": far},
        far=far,
        more=next(iter(inner), None),
    )
    text = json.dumps(record.to_dict())
    back = Outer.from_dict(json.loads(text))
    assert back.to_dict() == record.to_dict()
    assert back.few == record.few
    assert back.many == record.many
    assert back.more == record.more
    assert back.far == record.far
    np.testing.assert_array_equal(back.rows, record.rows)


SOUND = {"name": "n", "few": [1, "x"], "many": [], "rows": [1.0], "by_name": {}}


def test_none_is_infinity_where_a_number_may_be_infinite():
    assert Outer.from_dict(SOUND | {"far": None, "more": None}).far == np.inf


def test_infinity_is_none_in_json():
    record = Outer("n", (1, "x"), (), np.ones(1), {})
    assert record.to_dict()["far"] is None


@pytest.mark.parametrize(
    ("key", "value", "sentence"),
    [
        ("name", 3, "field name: expected a text, got a whole number"),
        ("name", None, "field name: expected a text, got null"),
        ("few", [1], "field few: expected a list of length 2, got 1"),
        ("few", "ab", "field few: expected a list, got a text"),
        ("few", [1.5, "x"], "field few[0]: expected a whole number, got a number"),
        ("many", "x", "field many: expected a list, got a text"),
        ("many", [{"kind": "a"}], "field many[0]: the field 'size' is missing"),
        ("many", [{"size": "1"}], "field many[0].size: expected a number, got a text"),
        ("many", [{"size": 1.0, "kind": "c"}], "field many[0].kind: .*'c'"),
        ("many", [{"size": -1.0}], "field many[0]: a size is below 0: give another"),
        ("rows", "x", "field rows: expected a list"),
        ("rows", [[1.0], [1.0, 2.0]], "field rows: expected rows of one length"),
        ("rows", ["1.0"], "field rows: expected numbers alone"),
        ("rows", [True], "field rows: expected numbers alone"),
        ("by_name", 3, "field by_name: expected an object, got a whole number"),
        ("by_name", {"k": "x"}, "field by_name.*: expected a number, got a text"),
        ("more", 3, "field more: expected an object or null, got a whole number"),
    ],
)
def test_a_field_of_another_type_is_refused_by_its_path(key, value, sentence):
    with pytest.raises(InputError) as refusal:
        Outer.from_dict(SOUND | {key: value})
    pattern = re.escape(sentence).replace(r"\.\*", ".*")
    assert re.match(pattern, str(refusal.value))


def test_a_missing_field_is_named():
    without = dict(SOUND)
    del without["few"]
    with pytest.raises(InputError, match="the field 'few' is missing"):
        Outer.from_dict(without)


def test_what_is_no_field_is_ignored():
    assert Outer.from_dict(SOUND | {"newer": 3}).name == "n"


def test_nulls_of_an_array_are_not_finite():
    record = Outer.from_dict(SOUND | {"rows": [1.0, None]})
    assert np.isnan(record.rows[1])
    assert record.to_dict()["rows"] == [1.0, None]


def test_derived_figures_are_written_and_not_read():
    record = Outer.from_dict(SOUND | {"total": "not read"})
    assert record.to_dict()["total"] == 1.0


OLD = Path(__file__).parent / "data" / "written_by_0_1"


def test_an_issue_that_0_1_wrote_is_as_todays():
    """Its certainty was a text, and kind and remedy alone said what has fields today."""
    issue = {
        "kind": "positions in mm",
        "severity": "note",
        "where": "joint 1",
        "what": "it reaches 300.",
        "certainty": "likely: seen: twice",
        "remedy": "no action needed: that is the torque",
    }
    written = json.loads((OLD / "model.json").read_text())
    written["provenance"]["checks"] = {"hash": [issue]}
    (read,) = estimate_of_file(written).issues_by_run["hash"]
    assert read.certainty == Certainty("likely", "seen: twice")
    assert (read.position_unit, read.needs_action, read.title) == (
        "mm",
        False,
        "positions in mm",
    )
    assert not read.is_another_arm
    assert StoredIssue.from_dict(read.to_dict()) == read


def test_what_the_verdict_of_an_older_file_says_to_be_in_doubt_stays():
    """Its issues do not say it themselves; a note leaves nothing in doubt."""
    written = json.loads((OLD / "model.json").read_text())
    kinds = {"torque sign": "warning", "idle joints": "note"}
    words = {"where": "", "what": "", "certainty": "likely: seen", "remedy": ""}
    issues = [{"kind": k, "severity": x, **words} for k, x in kinds.items()]
    text = "In doubt: torque sign; `check` says what to do."
    verdict = written["provenance"]["verdict"]
    verdict["lines"].append({"about": "the log", "grade": "usable", "text": text})
    written["provenance"]["checks"] = {"hash": issues}
    assert doubt_of_log(estimate_of_file(written).issues_by_run) == text
    verdict["lines"].pop()
    assert doubt_of_log(estimate_of_file(written).issues_by_run) == ""


@pytest.mark.parametrize(
    ("name", "load"), [("model.json", load_estimate), ("findings.json", load_diagnosis)]
)
def test_a_file_of_version_0_1_loads_and_is_written_as_it_was(name, load):
    written = json.loads((OLD / name).read_text())
    again = json.loads(json.dumps(load(OLD / name).to_dict()))
    if name == "model.json":  # what a later version writes besides
        assert again["problem"].pop("nominal_values") == {}
        assert again["problem"].pop("source") is None
        assert all(b.pop("enlarged") == 1.0 for b in again["problem"]["bodies"])
        assert again["certificate"].pop("certifies")
        assert again.pop("known") == {}
    else:
        for later in ("log_faults", "named_by_check", "left_out_of_test"):
            assert again.pop(later) == []
        assert written.pop("events") == []  # what is no longer judged
        assert (written.pop("format"), again.pop("format")) == (2, 4)
        # The errors with the first findings of the list, which each of them had.
        errors = [finding.pop("held_out_rmse_before") for finding in written["effects"]]
        errors.append(written.pop("held_out_rmse"))
        assert [x["rmse"] for x in again.pop("errors_with")] == errors
        for finding in written["effects"]:
            finding.pop("held_out_rmse_after")
            for gone in ("is_shown_beside_all", "n_splits", "n_splits_showing"):
                finding.pop(gone)
            finding["rivals"] = [
                {
                    "name": name,
                    "joints": [1] if name == "torque_offset" else [],
                    "constants": {},
                }
                for name in finding.pop("indistinguishable_from")
            ]
        for finding in again["effects"]:
            assert not finding.pop("helps")
            assert finding.pop("main_joint") == finding["joints"][0]
            later = ("no_place_in", "held_law", "held_law_in")
            assert not any([finding.pop(name) for name in later])
        for finding in (*written["effects"], *again["effects"]):  # derived: a sentence
            finding.pop("explanation")
    for content in (again, written):  # derived: later versions may write more
        content.pop("facts", None)
        content.pop("remedies", None)
    assert again == written


def test_no_conversion_is_written_by_hand():
    package = Path(sdp_vs_penalty.__file__).parent
    by_hand = [
        path.relative_to(package)
        for path in package.rglob("*.py")
        if re.search(r"def (to|from)_dict\(", path.read_text())
    ]
    assert by_hand == [Path("records.py")]
