"""An error is one sentence that can be printed."""

import pytest

from sdp_vs_penalty import InputError, errors
from sdp_vs_penalty.errors import quote_value

EMPTY = InputError("it is empty", "delete it", "row 3")


@pytest.mark.parametrize(
    ("error", "sentence"),
    [
        (InputError("a\nb\x1bc", "mend it", "row 3"), "row 3: a\\nb\\x1bc: mend it."),
        (EMPTY.within("run.csv"), "run.csv: row 3: it is empty: delete it."),
        (InputError("a").within("run.csv"), "run.csv: a"),
        (InputError("x" * 1500), "x" * 1500),
        (InputError("x" * 1501), "x" * 1500 + " ..."),
    ],
    ids=["printable", "placed in its file", "without a place", "long", "too long"],
)
def test_an_error_is_one_line_that_says_where_it_is(error, sentence):
    assert str(error) == sentence


def test_an_unknown_name_is_told_what_there_is():
    words = r"^method 'zzz' is unknown: there are: ols\.$"
    with pytest.raises(InputError, match=words):
        errors.require_known("method", "zzz", ["ols"])


@pytest.mark.parametrize("length", [58, 59])
def test_what_was_given_is_shown_in_sixty_characters(length):
    assert len(quote_value("x" * length)) == 60
    assert quote_value("x" * length).endswith("...") == (length == 59)


def test_a_file_that_cannot_be_read_and_a_missing_extra_say_why():
    error = errors.unreadable(OSError(2, "No such file"), "x")
    assert "(No such file)" in str(error)
    assert "[formats]" in str(errors.missing_extra("Bags need", "formats"))
