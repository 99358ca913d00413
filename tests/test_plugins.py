"""A name is registered once, and exports are found when they are asked for."""

from types import ModuleType

import pytest
from recorded import refusal

from sdp_vs_penalty import plugins


def home_of(name):
    """A module that registers a name."""
    module = ModuleType(f"home of {name}")
    module.name = name
    return module


def test_registered_names_are_sorted():
    a = home_of("a")
    b = home_of("b")
    assert list(plugins.by_word([("b", b), ("a", a), ("b", b)])) == ["a", "b"]


def test_a_name_of_two_modules_is_refused():
    entries = [("a", home_of("a")), ("a", home_of("b"))]
    words = "home of a and home of b have the same name, 'a'"
    refusal(lambda: plugins.by_word(entries), words)


def test_a_number_of_two_classes_is_refused():
    entries = [(3, int), (3, str)]
    words = "int of builtins and str of builtins have the same table_place, 3"
    refusal(lambda: plugins.by_word(entries, "table_place"), words)


def test_what_is_not_exported_is_no_attribute():
    exports = plugins.lazy_exports("p")
    with pytest.raises(AttributeError, match="'p' has no attribute 'x'"):
        exports("x")
