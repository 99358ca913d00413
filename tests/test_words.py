"""What users write in a word, what they read in one, and plain data there and back."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any, Literal

import numpy as np
import pytest
from drawn import given, st
from numpy.typing import NDArray
from recorded import refusal

from sdp_vs_penalty import InputError, errors, formatting, plugins
from sdp_vs_penalty.data import parsing
from sdp_vs_penalty.files import JsonRecord

finite = st.floats(-1e6, 1e6)


@given(st.lists(finite, min_size=1, max_size=4))
def test_numbers_are_read_as_they_are_written(values):
    text = ",".join(map(repr, values))
    assert (
        parsing.numbers("--x", text)
        == parsing.numbers("--x", text, len(values))
        == values
    )
    for wrong, count in (
        (text, len(values) + 1),
        (f"{text},", None),
        ("", None),
        ("a", None),
    ):
        said = "--x ", str(count or ""), "numbers separated by commas"
        refusal(
            lambda wrong=wrong, count=count: parsing.numbers("--x", wrong, count), *said
        )


@pytest.mark.parametrize(
    ("text", "windows"),
    [
        (None, [(0.0, np.inf)]),
        ("2:", [(2.0, np.inf)]),
        (":3.5", [(0.0, 3.5)]),
        (":", [(0.0, np.inf)]),
        ("0:1,1:2", [(0.0, 1.0), (1.0, 2.0)]),
        ("0:14,20:", [(0.0, 14.0), (20.0, np.inf)]),
        ("3", None),
        ("-1:2", None),
        ("2:2", None),
        ("1:2,0:1", None),
        ("0:2,1:3", None),
        ("a:b", None),
    ],
)
def test_windows_of_time_are_in_order(text, windows):
    if windows is None:
        refusal(lambda: parsing.time_windows(text), "START:STOP")
    else:
        assert parsing.time_windows(text) == windows


def test_pairs_are_ours_and_theirs():
    assert parsing.pairs("--rename", None) is None
    assert parsing.pairs("--rename", " t = time,q=q m") == {"t": "time", "q": "q m"}
    for wrong in ("t", "t=", "=x", "t=x,"):
        refusal(lambda wrong=wrong: parsing.pairs("--rename", wrong), "OURS=THEIRS")


@dataclass(frozen=True)
class Inner(JsonRecord):
    size: float
    kind: Literal["a", "b"] = "a"


@dataclass(frozen=True)
class Outer(JsonRecord):
    name: str
    few: tuple[int, str]
    many: tuple[Inner, ...]
    rows: NDArray[np.float64]
    by_name: Mapping[str, float]
    far: float = np.inf
    more: Inner | None = None


@given(
    st.lists(finite, max_size=3),
    st.sampled_from(["a", "b"]),
    st.text(max_size=5),
    finite,
)
def test_plain_data_come_back(sizes, kind, name, far):
    inner = tuple(Inner(x, kind) for x in sizes)
    made = Outer(
        name,
        (3, "x"),
        inner,
        np.array([sizes, sizes]),
        {"k": far},
        far,
        next(iter(inner), None),
    )
    back = Outer.from_dict(json.loads(json.dumps(made.to_dict())))
    assert back.to_dict() == made.to_dict()
    assert (back.few, back.many, back.more, back.far) == (
        made.few,
        made.many,
        made.more,
        made.far,
    )
    np.testing.assert_array_equal(back.rows, made.rows)


def test_plain_data_of_another_kind_are_refused():
    sound: dict[str, Any] = {
        "name": "n",
        "few": [1, "x"],
        "many": [],
        "rows": [1.0],
        "by_name": {},
    }
    assert Outer.from_dict(sound | {"far": None, "more": None}).far == np.inf
    assert Outer("n", (1, "x"), (), np.ones(1), {}).to_dict()["far"] is None
    for key, value in (
        ("name", 3),
        ("name", None),
        ("few", [1]),
        ("few", "ab"),
        ("many", "x"),
        ("many", [{"kind": "a"}]),
        ("many", [{"size": 1.0, "kind": "c"}]),
        ("rows", "x"),
        ("by_name", 3),
        ("more", 3),
    ):
        with pytest.raises((KeyError, TypeError, ValueError, AttributeError)):
            Outer.from_dict(sound | {key: value})
    with pytest.raises(KeyError, match="few"):
        Outer.from_dict({k: x for k, x in sound.items() if k != "few"})


def test_an_error_is_one_line_that_can_be_printed():
    inner = InputError("a\nb\x1bc", "mend it", "row 3")
    assert str(inner) == "row 3: a\\nb\\x1bc: mend it."
    assert str(inner.within("run.csv")) == "run.csv: row 3: a\\nb\\x1bc: mend it."
    assert str(InputError("a").within("run.csv")) == "run.csv: a"
    assert len(str(InputError("x" * 1500))) == 1500
    assert str(InputError("x" * 1501)) == "x" * 1500 + " ..."
    with pytest.raises(
        InputError, match=r"^method 'zzz' is unknown: there are: ols\.$"
    ):
        errors.require_known("method", "zzz", ["ols"])
    assert [len(errors.given("x" * k)) for k in (58, 59)] == [60, 60]
    assert errors.given("x" * 59).endswith("...")
    assert "(No such file)" in str(errors.unreadable(OSError(2, "No such file"), "x"))
    assert "[formats]" in str(errors.missing_extra("Bags need", "formats"))


def test_figures_in_words():
    assert [
        formatting.change_of(*x)
        for x in ((2.0, 1.0), (1.0, 1.02), (1.0, 1.004), (0.0, 1.0))
    ] == [
        "-50 %",
        "+2 %",
        "0 %",
        "-",
    ]
    assert [formatting.number(x) for x in (np.nan, 1e6, 999_999.0, -0.0123456)] == [
        "-",
        "1e+06",
        "999999",
        "-0.0123",
    ]
    units = {"-": "", "kg*m^2": "kg m²", "N*m": "N m", "m^3": "m³"}
    assert {x: formatting.plain_unit(x) for x in units} == units
    assert (formatting.finite(np.inf), formatting.finite(2)) == (None, 2.0)
    assert [formatting.count(k, "run") for k in (0, 1, 2)] == [
        "0 runs",
        "1 run",
        "2 runs",
    ]
    head, rows = formatting.error_table(
        ["a", "b"], [[1.0, 2.0], [0.5, 2.0]], [0.1, 0.2], ["rad", "N*m"]
    )
    assert head == ["joint", "a", "b", "change", "noise floor"]
    assert rows == [
        ["1 [rad]", "1", "0.5", "-50 %", "0.1"],
        ["2 [N m]", "2", "2", "0 %", "0.2"],
    ]
    head, rows = formatting.error_table(["a"], [[1.0]], None, ["N"], [0.98765])
    assert (head, rows) == (
        ["joint", "a", "R2", "noise floor"],
        [["1 [N]", "1", "0.9877", "-"]],
    )
    assert formatting.markdown_table("ab", ["cd"]) == [
        "| a | b |",
        "| --- | --- |",
        "| c | d |",
    ]


def test_a_result_shows_itself_in_five_lines():
    class Result(formatting.Shown):
        def _summary(self) -> formatting.Summary:
            return "A <title>", [(f"name {k}", "x" * 98 + "y" * k) for k in range(6)]

    lines = repr(Result()).splitlines()
    assert lines[0] == "A <title>"
    assert [len(line) for line in lines[1:]] == [108, 109, 110, 110]
    assert lines[4].endswith("...")
    html = Result()._repr_html_()
    assert html.startswith("<p><b>A &lt;title&gt;</b></p><table><tr><td>name 0</td>")
    assert html.count("<tr>") == 6


def test_a_name_is_registered_once():
    a, b = (SimpleNamespace(name=x, __name__=f"home of {x}") for x in "ab")
    assert list(plugins.by_word([("b", b), ("a", a), ("b", b)])) == ["a", "b"]
    said = "home of a and home of b have the same name, 'a'"
    refusal(lambda: plugins.by_word([("a", a), ("a", b)]), said)
    said = "int and str have the same table_place, 3"
    refusal(lambda: plugins.by_word([(3, int), (3, str)], "table_place"), said)
    with pytest.raises(AttributeError, match="'p' has no attribute 'x'"):
        plugins.lazy_exports("p")("x")
