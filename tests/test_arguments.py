"""Arguments of the public verbs: of another type is one sentence, whatever the verb."""

import re
from collections.abc import Mapping, Sequence

import numpy as np
import pytest
from recorded import refusal
from small_runs import small_run

import sdp_vs_penalty as sdp
from sdp_vs_penalty.arguments import checked_arguments


@checked_arguments
def verb(
    name: str,
    *more: int,
    count: int = 3,
    size: float | None = None,
    texts: Sequence[str] = (),
    sizes: Mapping[str, float] | None = None,
    pairs: Sequence[tuple[str, float]] = (),
    seed: int = 0,
) -> str:
    return f"{name}{more}{count}{size}{texts}{sizes}{pairs}{seed}"


@pytest.mark.parametrize(
    ("arguments", "options", "sentence"),
    [
        ((3,), {}, "verb(name=3): give a text"),
        (("a", "b"), {}, "verb(more='b'): give a whole number"),
        (("a",), {"count": 2.0}, "verb(count=2.0): give a whole number"),
        (("a",), {"count": True}, "verb(count=True): give a whole number"),
        (("a",), {"count": 10**30}, "verb(count=10.*): give a whole number"),
        (("a",), {"size": "3"}, "verb(size='3'): give a number or None"),
        (("a",), {"size": np.nan}, "verb(size=nan): give a number or None"),
        (("a",), {"size": 10**400}, "verb(size=10.*): give a number or None"),
        (("a",), {"size": np.ones(2)}, "verb(size=array.*): give a number or None"),
        (("a",), {"texts": "abc"}, "verb(texts='abc'): give a list"),
        (("a",), {"texts": [1]}, "verb(texts=[1]): give a list"),
        (("a",), {"sizes": {"k": "x"}}, "verb(sizes=.*): give a mapping or None"),
        (("a",), {"pairs": [("x", 1.0, 2.0)]}, "verb(pairs=.*): give a list"),
        (("a",), {"seed": -1}, "verb(seed=-1): give a whole number from 0"),
    ],
)
def test_an_argument_of_another_type_is_refused(arguments, options, sentence):
    pattern = re.escape(sentence).replace(r"\.\*", ".*")
    assert re.fullmatch(pattern + r"\.", refusal(lambda: verb(*arguments, **options)))


@pytest.mark.parametrize(
    "options",
    [
        {"count": np.int64(2), "size": np.float64(2.0)},
        {"size": 2, "texts": ["a"], "sizes": {"k": 1}, "pairs": [("x", 1)]},
        {"size": np.inf, "texts": ()},
    ],
)
def test_arguments_of_these_types_are_taken(options):
    assert verb("a", 1, 2, **options).startswith("a(1, 2)")


@pytest.mark.parametrize(
    "options",
    [{"duration": x} for x in (np.nan, np.inf, -1.0, "x", 10**400)]
    + [{"iterations": -1}, {"seed": -1}],
)
def test_an_excitation_that_cannot_be_is_refused(options):
    (name,) = options
    assert f"excite({name}=" in refusal(lambda: sdp.excite("two_link", **options))


def test_folds_shorter_than_the_filters_are_refused(two_link):
    run = small_run(two_link)
    refusal(
        lambda: sdp.cross_validate(two_link, run, "ols", folds=100_000),
        "100000 folds of 5.99 s are shorter",
        "choose at most",
    )
