"""What a problem.toml may and must hold: fields, kinds, lengths; checked before anything is built.

And the names of a link's bounds in tables and files: m1, c1x, I1xx, as the paper prints them.

model.json holds a problem whole, beside its robot: what it does not narrow is written down too, so that
other defaults of a later version do not change the bounds of an old model.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from sdp_vs_penalty.effects import parse_effects
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.formatting import finite
from sdp_vs_penalty.problem.problem import CentreOfMassCone, Problem, open_box
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.body import Body
from sdp_vs_penalty.robot.robot import Robot
from sdp_vs_penalty.signals.preprocessing import Preprocessing


@dataclass(frozen=True)
class Field:
    """kind : text, whole number or number, ``several`` in a list or one; length : of the list, one a
    joint ("joints"), or as many as the hint has; needed : whether it must be there; hint : how to write
    it."""

    kind: type
    several: bool = False
    length: str = ""
    needed: bool = False
    hint: str = ""


_WORDS = {str: "text", int: "whole number", float: "number"}
_LIMIT = Field(float, True, "joints", False, "[0.0, 0.1]")
_SIDES = Field(str, True, hint='["motor"], or one word a channel: motor or joint')
#: The fields of each section; those of the top level have none.
SECTIONS: Mapping[str, Mapping[str, Field]] = {
    "": {
        "title": Field(str, needed=True),
        "torque_side": Field(str, hint='"link", "motor" or "unknown"'),
        "links": Field(int),
        "effects": Field(str, True, hint='["rigid_body", "viscous_friction"]'),
    },
    "kinematics": {
        "urdf": Field(str, hint='"robot.urdf"'),
        "convention": Field(str, needed=True, hint='"standard" or "modified"'),
        **dict.fromkeys(("a", "alpha_over_pi", "d"), replace(_LIMIT, needed=True)),
        "gravity": Field(float, True, "hint", hint="[0.0, 0.0, -9.81] in m/s^2"),
        **dict.fromkeys(("lower", "upper", "velocity", "effort"), _LIMIT),
    },
    "transmission": {
        "motors": Field(str, True, "", True, '["50 q1", "32 q5 + 32 q6"], the motors\' positions'),
        "positions": _SIDES,
        "torques": _SIDES,
    },
    "mechanism": {
        "joints": Field(str, True, "", True, '["q1", "q2", "-q2"], each joint of the tree'),
        "massless": Field(float, True, hint="[3], links without mass"),
    },
    "bounds": {
        "tables": Field(str, True, hint='["bounds.csv"]'),
        "total_mass": Field(float, True, "hint", hint="[lower, upper] in kg"),
    },
    "centre_of_mass_cone": {
        "link": Field(int, needed=True),
        "axis": Field(str, needed=True, hint='"x", "y" or "z"'),
        **dict.fromkeys(("radius", "slope"), Field(float, needed=True)),
    },
    "preprocessing": dict.fromkeys(("state_cutoff", "torque_cutoff", "standstill"), Field(float)),
    "base_parameters": {"independent": Field(str, True, hint='["Izz1", "mx2"]')},
}
#: Sections that come any number of times, [[name]].
_MANY = ("centre_of_mass_cone",)


def check_fields(data: Mapping[str, Any]) -> None:
    """InputError naming the section and the field that is unknown, missing or of the wrong kind."""
    for section, fields in SECTIONS.items():
        many, names = section in _MANY, (*fields, *(() if section else filter(None, SECTIONS)))
        where = f"[[{section}]]" if many else f"[{section}]" if section else "the top level"
        if section and section not in data:
            if section == "kinematics":
                remedy = "give the robot's DH table or its URDF"
                raise InputError("the section [kinematics] is missing", remedy)
            continue
        given = data[section] if section else data
        parts = given if many else [given]
        if not (isinstance(parts, list) and all(isinstance(x, dict) for x in parts)):
            what = f"{section} is no {'list of sections' if many else 'section'}"
            raise InputError(what, f"write {where} above its fields")
        for part in parts:
            for key in part:
                if key not in names:
                    raise InputError(f"{key!r} is unknown in {where}", f"choose from {', '.join(names)}")
            for key, field in fields.items():
                if key in part:
                    _check(where if section else "", key, field, part)
                elif field.needed and "urdf" not in part:
                    raise InputError(f"the field {key!r} is missing in {where}", "add it")


def _check(section: str, name: str, field: Field, data: Mapping[str, Any]) -> None:
    """InputError for a value of another kind or length."""
    value, label, word = data[name], f"{section} {name}".strip(), _WORDS[field.kind]
    hint = "write " + (field.hint or '["one", "two"]') if field.hint or field.several else "correct it"
    if field.several and not isinstance(value, list):
        raise InputError(f"{label} is {_shown(value)}, not a list of {word}s", hint)
    for k, entry in enumerate(value if field.several else [value], start=1):
        if type(entry) not in (field.kind, *((int,) if field.kind is float else ())):
            where, remedy = (f"{label}: entry {k}", "correct it") if field.several else (label, hint)
            raise InputError(f"{where} is {_shown(entry)}, not a {word}", remedy)
    shown = {"joints": data.get("a"), "hint": field.hint.split(",")}.get(field.length)
    if isinstance(shown, list) and len(value) != len(shown):
        needed = "one per joint, as in a" if field.length == "joints" else hint
        raise InputError(f"{label} has {len(value)} entries, {len(shown)} are needed", needed)


def _shown(value: Any) -> str:
    """A value as TOML writes it, shortened."""
    return "a section" if isinstance(value, dict) else json.dumps(value, default=str)[:40]


#: A link's ten barycentric parameters, in our order.
_BARYCENTRIC = ("m{}", "c{}x", "c{}y", "c{}z", "I{}xx", "I{}xy", "I{}yy", "I{}xz", "I{}yz", "I{}zz")


def barycentric_names(link: int) -> tuple[str, ...]:
    """The names of a link's (from 1) mass, centre of mass and inertia about it, in our order."""
    return tuple(name.format(link) for name in _BARYCENTRIC)


def entries(links: int) -> dict[str, tuple[int, int]]:
    """Where each name stands in a problem's box: link (from 0) and entry."""
    names = (barycentric_names(link + 1) for link in range(links))
    return {name: (link, k) for link, own in enumerate(names) for k, name in enumerate(own)}


def problem_to_dict(problem: Problem) -> dict[str, Any]:
    """Plain JSON; a bound that is infinite is null, a parameter without bounds is left out.

    bounds : [lower, upper] by the names of a bounds.csv (m1 [kg], c1x [m], I1xx [kg m^2]);
    link_defaults : a link's largest mass [kg] and radius [m] where these bounds leave it open;
    bodies : the ellipsoid in which a link's mass lies, in its frame [m], and what it is known from;
    nominal_from : the same of the nominal links; gains : of the torque channels, where they are known.
    """
    bounds = {name: _pair(problem.box[place]) for name, place in entries(problem.robot.links).items()}
    return {
        "name": problem.name,
        "title": problem.title,
        "torque_side": problem.torque_side,
        "effects": list(problem.default_effects),
        "bounds": {name: pair for name, pair in bounds.items() if pair != [None, None]},
        "total_mass": _pair(problem.total_mass),
        "centre_of_mass_cones": [cone.to_dict() for cone in problem.cones],
        "link_defaults": [{"mass": m, "radius": r} for m, r in problem.link_defaults.tolist()],
        "bodies": [body.to_dict() for body in problem.link_bodies],
        "nominal_links": problem.nominal_links.tolist(),
        "nominal_from": None if problem.nominal_from is None else list(problem.nominal_from),
        "gains": None if problem.gains is None else list(problem.gains),
        "preprocessing": asdict(problem.preprocessing),
        "base_parameters": None if problem.independent is None else list(problem.independent),
    }


def problem_from_dict(data: Mapping[str, Any], robot: Robot) -> Problem:
    """The same problem to the last bit of its constraints; its folder, if it had one, is not known.

    Raises InputError for bounds that contradict themselves or the robot, KeyError, TypeError or
    ValueError for a field that is missing or of another kind.
    """
    places, box = entries(robot.links), open_box(robot.links, -np.inf)
    for name, pair in data["bounds"].items():
        if name not in places:
            what = f"bounds: {name!r} is no parameter of a link of this robot"
            raise InputError(what, "write the file anew")
        box[places[name]] = _ends(pair)
    texts, base, drawn = _texts(data["effects"]), data["base_parameters"], data["nominal_from"]
    parse_effects(texts, robot)
    defaults = _finite("link_defaults", [[d["mass"], d["radius"]] for d in data["link_defaults"]])
    if not np.all(defaults > 0.0):
        what = "link_defaults: a mass or a radius is not above 0"
        raise InputError(what, "correct it, or write the file anew")
    name, title = _texts([data["name"], data["title"]])
    return Problem(
        name,
        title,
        robot,
        box,
        _finite("nominal_links", data["nominal_links"]),
        _ends(data["total_mass"]),
        tuple(map(CentreOfMassCone.from_dict, data["centre_of_mass_cones"])),
        data["torque_side"],
        Preprocessing(**data["preprocessing"]),
        None if base is None else _texts(base),
        effects=texts,
        defaults=defaults,
        bodies=tuple(map(Body.from_dict, data["bodies"])),
        nominal_from=None if drawn is None else _texts(drawn),
        gains=tuple(_finite("gains", data["gains"]).tolist()) if data.get("gains") else None,
    )


def _pair(ends: Sequence[float] | Array) -> list[float | None]:
    return [finite(x) for x in ends]


def _ends(pair: Sequence[float | None]) -> tuple[float, float]:
    low, high = pair
    return -np.inf if low is None else float(low), np.inf if high is None else float(high)


def _finite(what: str, rows: Any) -> Array:
    values = np.array(rows, float)
    if not np.all(np.isfinite(values)):
        raise InputError("a number is not finite", "write the file anew", what)
    return values


def _texts(values: Sequence[Any]) -> tuple[str, ...]:
    if isinstance(values, str) or not all(isinstance(v, str) for v in values):
        raise TypeError(f"{values!r} is no list of texts")
    return tuple(values)
