"""Records to JSON and back, by the types of their fields.

A record is a frozen dataclass of numbers, texts, arrays, other records, and tuples and
mappings of these. docs/decisions.md says what its JSON is, and what older files may
lack.
"""

from __future__ import annotations

import collections.abc
import re
import types
from collections.abc import Mapping
from dataclasses import MISSING, Field, fields, is_dataclass
from functools import cache
from typing import (
    TYPE_CHECKING,
    Any,
    ClassVar,
    Self,
    TypeVar,
    get_args,
    get_origin,
    get_type_hints,
)

from sdp_vs_penalty.errors import InputError

if TYPE_CHECKING:
    from numpy.typing import NDArray

T = TypeVar("T")

#: The types in a message of msgspec, in words.
_WORDS = {
    "float": "a number",
    "int": "a whole number",
    "str": "a text",
    "bool": "true or false",
    "array": "a list",
    "object": "an object",
    "null": "null",
}
#: What a message of msgspec consists of: what is wrong, and the place from "$" on.
_MESSAGE = re.compile(r"(?s)(.*?)(?: - at `\$\.?(.*)`)?")


#: Metadata of a field that files do not hold.
NOT_STORED: Mapping[str, Any] = {"json": None}


def stored_as(name: str) -> Mapping[str, Any]:
    """Return the metadata of a field that has another name in files."""
    return {"json": name}


class WritesJson:
    """A dataclass that becomes JSON, which people and other programs read."""

    #: Attributes and methods without arguments that its JSON holds beside the fields;
    #: they are never read back.
    derived: ClassVar[tuple[str, ...]] = ()
    #: Whether fields without a value, such as infinite limits, are left out.
    skips_null: ClassVar[bool] = False

    def as_written(self) -> Any:
        """Return what stands for this record in JSON: most records themselves."""
        return self

    def to_dict(self) -> dict[str, Any]:
        """Return the fields, and what is derived from them, as JSON; a number that is
        not finite becomes null.
        """
        written = self.as_written()
        if written is not self:
            return to_json(written)  # type: ignore[no-any-return]
        out = {
            name: to_json(getattr(self, field.name))
            for name, field in _stored_fields(type(self)).items()  # type: ignore[arg-type]
        }
        for name in self.derived:
            value = getattr(self, name)
            out[name] = to_json(value() if callable(value) else value)
        return {k: x for k, x in out.items() if x is not None or not self.skips_null}


class JsonRecord(WritesJson):
    """A dataclass that becomes JSON and back, by the types of its fields."""

    @classmethod
    def upgraded(cls, data: Mapping[str, Any]) -> Mapping[str, Any]:
        """Bring the JSON of an older file to today's fields; most records have none."""
        return data

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Self:
        """Make a record from the JSON of :meth:`to_dict`.

        Parameters
        ----------
        data : mapping
            Fields by name; null stands for a field's default, if it has one. What is no
            field is ignored.

        Raises
        ------
        InputError
            If a field is missing, of another type, or refused by the record; it names
            the field's path.
        """
        return from_json(cls, data)


def to_json(value: Any) -> Any:
    """Return a value as JSON: records become objects, arrays and tuples lists; a number
    that is not finite becomes null.
    """
    import numpy as np  # which `--help` does not pay for

    if isinstance(value, WritesJson):
        return value.to_dict()
    if is_dataclass(value) and not isinstance(value, type):
        return {f.name: to_json(getattr(value, f.name)) for f in fields(value)}
    if isinstance(value, Mapping):
        return {str(name): to_json(x) for name, x in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        if value.dtype.kind != "f" or np.all(np.isfinite(value)):
            return value.tolist()
        return to_json(value.tolist())
    if isinstance(value, list | tuple | range):
        return [to_json(x) for x in value]
    return None if isinstance(value, float) and not np.isfinite(value) else value


def from_json(kind: type[T], data: Any) -> T:
    """Make a value of a type from its JSON, as msgspec checks it: nothing is converted
    but lists to arrays and tuples, and whole numbers to numbers.

    Parameters
    ----------
    kind : type
        A record, or any type that a field of a record may have.

    Raises
    ------
    InputError
        For JSON of another type; it names the field's path.
    """
    import msgspec

    try:
        return msgspec.convert(_with_defaults(kind, data), kind, dec_hook=_array)
    except msgspec.ValidationError as error:
        raise _refusal(error) from error


def _refusal(error: Exception) -> InputError:
    """Return the sentence about JSON of another type, with the field's path.

    What a record says itself of its fields (InputError) keeps its words.
    """
    message = _MESSAGE.fullmatch(str(error))
    assert message is not None  # it matches every text
    what, path = message.groups()
    where = f"field {path}" if path else None
    if isinstance(error.__cause__, InputError):
        return error.__cause__.within(where) if where else error.__cause__
    missing = re.fullmatch("Object missing required field `(.*)`", what)
    if missing:
        what = f"the field {missing[1]!r} is missing"
    words = re.sub(r"`([^`]*)`", _type_in_words, what)
    words = words[:1].lower() + words[1:]
    return InputError(words, "correct it, or write the file anew", where)


def _type_in_words(quoted: re.Match[str]) -> str:
    """Write a type of a message in words, "float | null" as "a number or null"."""
    return " or ".join(_WORDS.get(word, word) for word in quoted[1].split(" | "))


def _array(kind: Any, value: Any) -> NDArray[Any]:
    """Return a list of numbers, or of such lists, as an array; null becomes NaN.

    Raises TypeError for anything else.
    """
    import numpy as np

    if get_origin(kind) is not np.ndarray:
        raise TypeError(f"a record cannot hold {kind}")
    if isinstance(value, np.ndarray):
        return value
    if not isinstance(value, list | tuple):
        raise TypeError("expected `array`")
    try:
        numbers = np.array(value)
    except ValueError:  # lists of different lengths
        raise TypeError("expected rows of one length") from None
    if numbers.size and numbers.dtype.kind not in "iuf":
        flat = numbers.ravel().tolist()
        if not all(x is None or type(x) in (int, float) for x in flat):
            raise TypeError("expected numbers alone")
    try:
        return numbers.astype(float)
    except (OverflowError, TypeError):
        raise TypeError("expected numbers that a double can hold") from None


#: The types of a class's fields, which cost more to look up than a field to read.
_kinds = cache(get_type_hints)


@cache
def _stored_fields(kind: Any) -> Mapping[str, Field[Any]]:
    """Return the fields of a dataclass that files hold, by their names in files."""
    named = {field.metadata.get("json", field.name): field for field in fields(kind)}
    return {name: field for name, field in named.items() if name}


def _with_defaults(kind: Any, value: Any) -> Any:
    """Bring older records to today's fields, leave out their fields that are null and
    have a default, and make NaN of null in a list of numbers: JSON has no number that
    is not finite.
    """
    if get_origin(kind) is types.UnionType:
        arms = [arm for arm in get_args(kind) if arm is not types.NoneType]
        if value is None or len(arms) > 1:
            return value
        (kind,) = arms
    if isinstance(value, Mapping):
        if is_dataclass(kind):
            return _fields_with_defaults(kind, value)
        if get_origin(kind) in (collections.abc.Mapping, dict):
            kind_of_values = get_args(kind)[1]
            return {k: _with_defaults(kind_of_values, x) for k, x in value.items()}
    is_list = get_origin(kind) in (tuple, list, collections.abc.Sequence)
    if is_list and isinstance(value, list | tuple):
        kinds = get_args(kind)
        is_fixed = get_origin(kind) is tuple and kinds[-1] is not Ellipsis
        if not is_fixed:
            kinds = kinds[:1] * len(value)
        elif len(kinds) != len(value):
            return value
        return [
            float("nan") if x is None and item is float else _with_defaults(item, x)
            for item, x in zip(kinds, value, strict=True)
        ]
    return value


def _fields_with_defaults(kind: Any, data: Mapping[str, Any]) -> dict[str, Any]:
    """Return the JSON fields ``data`` of a record by today's names, each treated by
    :func:`_with_defaults`; fields that are null and have a default are left out."""
    if issubclass(kind, JsonRecord):
        data = kind.upgraded(data)
    kinds = _kinds(kind)
    return {
        field.name: _with_defaults(kinds[field.name], data[name])
        for name, field in _stored_fields(kind).items()
        if name in data and not (data[name] is None and _has_default(field))
    }


def _has_default(field: Field[Any]) -> bool:
    """Return whether a field may be left out."""
    return field.default is not MISSING or field.default_factory is not MISSING
