"""Named facts: a number that a person may read, computed by one method of one record.

A fact knows its unit, its digits and its definition. Terminal, JSON, page and report
print a fact by its ``text``, so that none of them rounds or scales it again. A fact with
a ``column`` is a column of every table of such records, and of their data frame.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cache
from typing import Any, Generic, Self, TypeVar, overload

import numpy as np

from sdp_vs_penalty.formatting import number, plain_unit
from sdp_vs_penalty.records import JsonRecord

T = TypeVar("T")


@dataclass(frozen=True)
class Fact(JsonRecord):
    """One fact of one record."""

    derived = ("texts",)

    #: Name of the method that computes the fact, in words.
    name: str
    #: A number, (n,) a number a joint, a text, or None where it is not known.
    value: Any
    #: Unit as it is printed.
    unit: str
    #: Significant digits of the printed value.
    digits: int
    #: What the fact is, in a sentence or two.
    definition: str
    #: Heading of the fact's column in tables; "" for a fact that has none.
    column: str = ""
    #: Whether it is a number a joint: such columns are in tables with a row a joint,
    #: all others in tables with a row a record.
    per_joint: bool = False

    @property
    def texts(self) -> list[str]:
        """The printed numbers without unit: one for each joint, or a single one.

        "-" stands for an unknown value; a value that is a text is printed unchanged.
        """
        if self.value is None:
            return ["-"]
        if isinstance(self.value, bool):
            return ["yes" if self.value else "no"]
        if isinstance(self.value, str):
            return [self.value]
        values = np.atleast_1d(np.asarray(self.value, float))
        return [number(float(x), self.digits) for x in values]

    @property
    def text(self) -> str:
        """The numbers as they are printed, with their unit."""
        return f"{', '.join(self.texts)} {plain_unit(self.unit)}".rstrip()

    def of_joint(self, joint: int) -> str:
        """Return the printed number of one joint (from 1), without unit; "-" if it is
        unknown.
        """
        return self.texts[joint - 1] if self.value is not None else "-"


class FactMethod(Generic[T]):
    """A property of a record that is one of its facts."""

    def __init__(self, method: Callable[[Any], T], stated: Fact) -> None:
        """Wrap the method that computes a fact; ``stated`` is all but its value."""
        self.method = method
        self.stated = stated
        self.__doc__ = method.__doc__

    # Types of the descriptor: of the class it is itself, of a record the fact's value.
    @overload
    def __get__(self, record: None, owner: type) -> Self: ...  # of the class: itself
    @overload
    def __get__(self, record: object, owner: type) -> T: ...  # of a record: the value
    def __get__(self, record: object | None, owner: type) -> Self | T:
        """Return the fact's value for a record; for the class, this descriptor."""
        return self if record is None else self.method(record)


def fact(
    unit: str = "",
    digits: int = 3,
    name: str = "",
    column: str = "",
    per_joint: bool = False,
) -> Callable[[Callable[[Any], T]], FactMethod[T]]:
    """Decorate a method of a record that computes one of its facts, as a property.

    The method's docstring is the definition that people read.

    Parameters
    ----------
    unit : str
        Unit of the value, such as "N m or N", "%" or "s".
    digits : int
        Significant digits of the printed text.
    name : str
        Name in words; by default that of the method.
    column : str
        Heading of its column in tables; by default the fact is in no table.
    per_joint : bool
        Whether the value is (n,), a number a joint.
    """

    def decorate(method: Callable[[Any], T]) -> FactMethod[T]:
        stated = Fact(
            name=name or method.__name__.replace("_", " "),
            value=None,
            unit=unit,
            digits=digits,
            definition=" ".join((inspect.getdoc(method) or "").split()),
            column=column,
            per_joint=per_joint,
        )
        return FactMethod(method, stated)

    return decorate


@cache
def _fact_methods(kind: Any) -> Mapping[str, FactMethod[Any]]:
    """Collect the fact methods of a class by name, those of its base classes first.

    A subclass replaces a method of the same name.
    """
    methods: dict[str, FactMethod[Any]] = {}
    for base in reversed(kind.__mro__):
        methods |= {
            name: member
            for name, member in vars(base).items()
            if isinstance(member, FactMethod)
        }
    return methods


def facts_of(record: object) -> dict[str, Fact]:
    """Compute all facts of a record, by the name of the method that computes each."""
    kind: type = type(record)
    methods = _fact_methods(kind)
    return {
        name: replace(one.stated, value=one.method(record))
        for name, one in methods.items()
    }


def columns_of(facts: Iterable[Fact], per_joint: bool) -> list[Fact]:
    """Return the facts that are columns of a table with a row a joint, or else of one
    with a row a record."""
    return [one for one in facts if one.column and one.per_joint == per_joint]
