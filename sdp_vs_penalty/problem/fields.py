"""What a problem.toml may and must hold: fields, kinds, lengths; checked before anything is built.

And the names of a link's bounds in tables and files: m1, c1x, I1xx, as the paper prints them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from sdp_vs_penalty.errors import InputError


@dataclass(frozen=True)
class Field:
    """kind : "text", "texts", "whole", "number" or "numbers"; length : of numbers, or "joints" for one
    a joint; needed : whether it must be there; hint : how to write it.
    """

    kind: str
    length: int | str | None = None
    needed: bool = False
    hint: str = ""


_LIMIT = Field("numbers", "joints")
_DH = Field("numbers", "joints", needed=True)
TOP = {
    "title": Field("text", needed=True),
    "torque_side": Field("text", hint='"link" or "motor"'),
    "links": Field("whole"),
    "effects": Field("texts", hint='["rigid_body", "viscous_friction"]'),
}
SECTIONS: Mapping[str, Mapping[str, Field]] = {
    "kinematics": {
        "urdf": Field("text", hint='"robot.urdf"'),
        "convention": Field("text", needed=True, hint='"standard" or "modified"'),
        "a": _DH,
        "alpha_over_pi": _DH,
        "d": _DH,
        "gravity": Field("numbers", 3, hint="[0.0, 0.0, -9.81] in m/s^2"),
        "lower": _LIMIT,
        "upper": _LIMIT,
        "velocity": _LIMIT,
        "effort": _LIMIT,
    },
    "transmission": {
        "motors": Field("texts", needed=True, hint='["50 q1", "32 q5 + 32 q6"], the motors\' positions'),
        "positions": Field("texts", hint='["motor"], or one word a channel: motor or joint'),
        "torques": Field("texts", hint='["motor"], or one word a channel: motor or joint'),
    },
    "mechanism": {
        "joints": Field("texts", needed=True, hint='["q1", "q2", "-q2"], each joint of the tree'),
        "massless": Field("numbers", hint="[3], links without mass"),
    },
    "bounds": {
        "tables": Field("texts", hint='["bounds.csv"]'),
        "total_mass": Field("numbers", 2, hint="[lower, upper] in kg"),
    },
    "centre_of_mass_cone": {
        "link": Field("whole", needed=True),
        "axis": Field("text", needed=True, hint='"x", "y" or "z"'),
        "radius": Field("number", needed=True),
        "slope": Field("number", needed=True),
    },
    "preprocessing": {
        "state_cutoff": Field("number"),
        "torque_cutoff": Field("number"),
        "standstill": Field("number"),
    },
    "base_parameters": {"independent": Field("texts", hint='["Izz1", "mx2"]')},
}
#: Sections that come any number of times, [[name]].
_MANY = ("centre_of_mass_cone",)


def check_fields(data: Mapping[str, Any]) -> None:
    """InputError naming the section and the field that is unknown, missing or of the wrong kind."""
    _table("", data, {**TOP, **{name: Field("table") for name in SECTIONS}})
    if "kinematics" not in data:
        raise InputError("the section [kinematics] is missing", "give the robot's DH table or its URDF")
    for section, fields in SECTIONS.items():
        if section not in data:
            continue
        many = section in _MANY
        brackets = f"[[{section}]]" if many else f"[{section}]"
        parts = data[section] if many else [data[section]]
        if not (isinstance(parts, list) and all(isinstance(x, dict) for x in parts)):
            what = f"{section} is no {'list of sections' if many else 'section'}"
            raise InputError(what, f"write {brackets} above its fields")
        for part in parts:
            _table(brackets, part, fields, section == "kinematics" and "urdf" in part)


def _table(
    section: str, data: Mapping[str, Any], fields: Mapping[str, Field], optional: bool = False
) -> None:
    where = section or "the top level"
    for key in data:
        if key not in fields:
            raise InputError(f"{key!r} is unknown in {where}", f"choose from {', '.join(fields)}")
    for key, field in fields.items():
        if field.needed and not optional and key not in data:
            raise InputError(f"the field {key!r} is missing in {where}", "add it")
    joints = data.get("a")
    for name, value in data.items():
        field = fields[name]
        if field.kind == "table":
            continue
        label = f"{section} {name}".strip()
        _kind(label, value, field)
        length = field.length
        if length == "joints":
            length = len(joints) if isinstance(joints, list) else None
        if length is not None and len(value) != length:
            needed = "one per joint, as in a" if field.length == "joints" else f"write {field.hint}"
            raise InputError(f"{label} has {len(value)} entries, {length} are needed", needed)


#: What a value of each kind is, in Python and in words.
_KINDS: dict[str, tuple[tuple[type, ...], str]] = {
    "text": ((str,), "a text"),
    "whole": ((int,), "a whole number"),
    "number": ((int, float), "a number"),
}


def _kind(label: str, value: Any, field: Field) -> None:
    hint = f"write {field.hint}" if field.hint else ""
    several, one = field.kind in ("texts", "numbers"), field.kind.removesuffix("s")
    if several and not isinstance(value, list):
        what = f"{label} is {_shown(value)}, not a list of {field.kind}"
        raise InputError(what, hint or _EXAMPLE[field.kind])
    types, name = _KINDS[one]
    for k, entry in enumerate(value if several else [value], start=1):
        if not isinstance(entry, types) or isinstance(entry, bool):
            if several:
                raise InputError(f"entry {k} is {_shown(entry)}, not {name}", "correct it", label)
            raise InputError(f"{label} is {_shown(entry)}, not {name}", hint or "correct it")


_EXAMPLE = {"numbers": "write [0.0, 0.1]", "texts": 'write ["one", "two"]'}


def _shown(value: Any) -> str:
    """A value as TOML writes it, shortened."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return f'"{value[:40]}"'
    if isinstance(value, dict):
        return "a section"
    return str(value)[:40]


#: A link's ten barycentric parameters, in our order.
_BARYCENTRIC = ("m{}", "c{}x", "c{}y", "c{}z", "I{}xx", "I{}xy", "I{}yy", "I{}xz", "I{}yz", "I{}zz")


def barycentric_names(link: int) -> tuple[str, ...]:
    """The names of a link's (from 1) mass, centre of mass and inertia about it, in our order."""
    return tuple(name.format(link) for name in _BARYCENTRIC)


def entries(links: int) -> dict[str, tuple[int, int]]:
    """Where each name stands in a problem's box: link (from 0) and entry."""
    return {
        name: (link, entry)
        for link in range(links)
        for entry, name in enumerate(barycentric_names(link + 1))
    }
