"""Figures in words, and tables of errors."""

import numpy as np
import pytest

from sdp_vs_penalty import formatting
from sdp_vs_penalty.results import Shown, markdown_lines


@pytest.mark.parametrize(
    ("before", "after", "words"),
    [(2.0, 1.0, "-50 %"), (1.0, 1.02, "+2 %"), (1.0, 1.004, "0 %"), (0.0, 1.0, "-")],
)
def test_a_change_is_in_per_cent(before, after, words):
    assert formatting.change_of(before, after) == words


@pytest.mark.parametrize(
    ("value", "words"),
    [(np.nan, "-"), (1e6, "1e+06"), (999_999.0, "999999"), (-0.0123456, "-0.0123")],
)
def test_a_number_has_three_digits(value, words):
    assert formatting.number(value) == words


def test_what_happens_once_has_a_word():
    assert [formatting.times(k) for k in (1, 2)] == ["once", "2 times"]


@pytest.mark.parametrize(
    ("unit", "words"), [("-", ""), ("kg*m^2", "kg m²"), ("N*m", "N m"), ("m^3", "m³")]
)
def test_a_unit_is_written_as_people_write_it(unit, words):
    assert formatting.plain_unit(unit) == words


def test_what_is_not_finite_is_none():
    assert formatting.finite(np.inf) is None


def test_what_is_finite_is_a_number():
    assert formatting.finite(2) == 2.0


@pytest.mark.parametrize(
    ("count", "words"), [(0, "0 runs"), (1, "1 run"), (2, "2 runs")]
)
def test_a_count_has_its_plural(count, words):
    assert formatting.count(count, "run") == words


def test_a_markdown_table_has_a_head_and_rows():
    lines = markdown_lines("ab", ["cd"])
    assert lines == ["| a | b |", "| --- | --- |", "| c | d |"]


class Result(Shown):
    """A result with more lines, and longer ones, than are shown."""

    def _summary(self):
        entries = [(f"name {k}", "x" * 98 + "y" * k) for k in range(6)]
        return "A <title>", entries


def test_a_result_shows_itself_in_five_lines():
    title, *lines = repr(Result()).splitlines()
    assert title == "A <title>"
    assert [len(line) for line in lines] == [108, 109, 110, 110]
    assert lines[-1].endswith("...")


def test_a_result_shows_itself_in_html():
    html = Result()._repr_html_()
    assert html.startswith(
        "<p><b>A &lt;title&gt;</b></p><table><tbody><tr><td>name 0</td>"
    )
    assert html.count("<tr>") == 6
