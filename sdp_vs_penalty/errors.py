"""Errors that a user is meant to see: data, of which one sentence is made."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any


class InputError(ValueError):
    """What the user gave cannot be used.

    what : is wrong; remedy : what to do about it; where : the file, row, field or option. Its text is
    one sentence, "where: what: remedy.", which the command line prints before it exits with code 2.

    >>> str(InputError("row 3 is empty", "delete it", "run.csv"))
    'run.csv: row 3 is empty: delete it.'
    """

    def __init__(self, what: str, remedy: str = "", where: Any = None) -> None:
        self.what, self.remedy, self.where = what, remedy, where
        place = "" if where is None else f"{where}: "
        super().__init__(f"{place}{what}" + (f": {remedy}." if remedy else ""))

    def within(self, where: Any) -> InputError:
        """The same error of a place that holds this one's: a file that holds the field."""
        place = where if self.where is None else f"{where}: {self.where}"
        return type(self)(self.what, self.remedy, place)


class Infeasible(InputError):  # noqa: N818 (the field's word)
    """The constraints admit no parameters.

    families : those that exclude each other; proof : the constraints and multipliers that prove it
    (Farkas), where they do: then nothing satisfies all constraints; without, they leave no room at best.
    """

    def __init__(
        self,
        what: str,
        remedy: str = "",
        where: Any = None,
        families: Sequence[str] = (),
        proof: tuple[Any, Any] | None = None,
    ) -> None:
        super().__init__(what, remedy, where)
        self.families, self.proof = tuple(families), proof


def install_command(extra: str) -> str:
    """What installs an optional part, for those who have the package and for those with a checkout."""
    return f"pip install 'sdp-vs-penalty[{extra}]' (in a checkout: pip install '.[{extra}]')"


def missing_extra(what: str, extra: str) -> InputError:
    """The error of a verb whose optional part is not installed; ``what`` needs it."""
    return InputError(f"{what} the extra [{extra}]: {install_command(extra)}.")


def given(value: object) -> str:
    """A value as a message shows it: short, on one line."""
    text = " ".join(repr(value).split())
    return text if len(text) <= 60 else f"{text[:57]}..."
