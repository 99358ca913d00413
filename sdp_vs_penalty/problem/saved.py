"""A problem as model.json holds it: everything that was known of the robot before its measurements.

The robot itself stands beside it in that file. What is not narrowed by the problem is written down too,
so that other defaults of a later version do not change the bounds of an old model.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from sdp_vs_penalty.effects import parse_effects
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.problem.fields import entries
from sdp_vs_penalty.problem.problem import CentreOfMassCone, Problem
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.body import Body
from sdp_vs_penalty.robot.robot import Robot
from sdp_vs_penalty.show import finite
from sdp_vs_penalty.signals.preprocessing import Preprocessing


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
        "link_defaults": [
            {"mass": mass, "radius": radius} for mass, radius in problem.link_defaults.tolist()
        ],
        "bodies": [body.to_dict() for body in problem.link_bodies],
        "nominal_links": problem.nominal_links.tolist(),
        "nominal_from": None if problem.nominal_from is None else list(problem.nominal_from),
        "gains": None if problem.gains is None else list(problem.gains),
        "preprocessing": dataclasses.asdict(problem.preprocessing),
        "base_parameters": None if problem.independent is None else list(problem.independent),
    }


def problem_from_dict(data: Mapping[str, Any], robot: Robot) -> Problem:
    """The same problem to the last bit of its constraints; its folder, if it had one, is not known.

    Raises InputError for bounds that contradict themselves or the robot, KeyError, TypeError or
    ValueError for a field that is missing or of another kind.
    """
    places = entries(robot.links)
    box = np.full((robot.links, 10, 2), (-np.inf, np.inf))
    for name, pair in data["bounds"].items():
        if name not in places:
            raise InputError(
                f"bounds: {name!r} is no parameter of a link of this robot", "write the file anew"
            )
        box[places[name]] = _ends(pair)
    texts = _texts(data["effects"])
    parse_effects(texts, robot)
    base = data["base_parameters"]
    defaults = _finite("link_defaults", [[d["mass"], d["radius"]] for d in data["link_defaults"]])
    if not np.all(defaults > 0.0):
        raise InputError(
            "link_defaults: a mass or a radius is not above 0", "correct it, or write the file anew"
        )
    (name, title) = _texts([data["name"], data["title"]])
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
        # Files of earlier versions have neither: bodies are then those of the bounds and kinematics.
        bodies=tuple(map(Body.from_dict, data["bodies"])) if "bodies" in data else None,
        nominal_from=_texts(data["nominal_from"]) if data.get("nominal_from") else None,
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
