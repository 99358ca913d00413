"""An error is one sentence that can be printed."""

import pytest

from sdp_vs_penalty import InputError, errors


def test_an_error_is_one_line_that_can_be_printed():
    error = InputError("a\nb\x1bc", "mend it", "row 3")
    assert str(error) == "row 3: a\\nb\\x1bc: mend it."


def test_an_error_is_placed_in_its_file():
    error = InputError("it is empty", "delete it", "row 3")
    assert str(error.within("run.csv")) == "run.csv: row 3: it is empty: delete it."


def test_an_error_without_a_place_is_placed():
    assert str(InputError("a").within("run.csv")) == "run.csv: a"


def test_a_long_error_is_whole():
    assert str(InputError("x" * 1500)) == "x" * 1500


def test_a_longer_error_is_cut():
    assert str(InputError("x" * 1501)) == "x" * 1500 + " ..."


def test_an_unknown_name_is_told_what_there_is():
    words = r"^method 'zzz' is unknown: there are: ols\.$"
    with pytest.raises(InputError, match=words):
        errors.require_known("method", "zzz", ["ols"])


@pytest.mark.parametrize("length", [58, 59])
def test_what_was_given_is_shown_in_sixty_characters(length):
    assert len(errors.given("x" * length)) == 60


def test_what_is_left_out_of_it_is_marked():
    assert errors.given("x" * 59).endswith("...")


def test_a_file_that_cannot_be_read_says_why():
    error = errors.unreadable(OSError(2, "No such file"), "x")
    assert "(No such file)" in str(error)


def test_a_missing_extra_is_named():
    assert "[formats]" in str(errors.missing_extra("Bags need", "formats"))
