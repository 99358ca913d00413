"""Functions of a model's parameters by name: what ranges can be asked of.

Linear ones g^T theta are standard parameters ("m4", "mx4", "Ixx4", "f_v2"), "total mass", and
base parameters ("Izz1 + ..."). Entries about the centre of mass are functions of one link:
"c4x" = mx4 / m4, "I4xx" = Ixx4 - (my4^2 + mz4^2) / m4, named as the paper's tables name them.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from sdp_vs_penalty.effects.model import Model
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.formatting import plain_unit
from sdp_vs_penalty.problem.problem import Problem, entries
from sdp_vs_penalty.regression.base_parameters import base_rows
from sdp_vs_penalty.robot import inertia
from sdp_vs_penalty.robot.arrays import Array, Indices

TOTAL = "total mass"
#: Words for sets of functions.
GROUPS = ("masses", "centres", "inertias", "moments", "parameters", "base")


@dataclass(frozen=True)
class Function:
    """A function of theta with a name."""

    #: Name, as a user writes it.
    name: str
    #: Unit of the value.
    unit: str
    #: (p,) coefficients of a linear function; None for an entry about the centre of
    #: mass.
    g: Array | None = None
    #: Link, and place among (m, cx, cy, cz, Ixx, Ixy, Iyy, Ixz, Iyz, Izz), both from 0,
    #: of an entry about the centre of mass.
    place: tuple[int, int] | None = None

    def value(self, theta: Array, links: Indices) -> float:
        """Return the value at theta (p,), with the links' places (n, 10) in it; NaN for
        the centre of a link without mass."""
        if self.g is not None:
            return float(self.g @ theta)
        assert self.place is not None
        link, entry = self.place
        with np.errstate(divide="ignore", invalid="ignore"):
            return float(inertia.barycentric_from_standard(theta[links[link]])[entry])


def functions_by_name(
    problem: Problem, model: Model, names: Iterable[str]
) -> list[Function]:
    """Return functions by name; a word of GROUPS stands for all of a kind.

    Raises
    ------
    InputError
        For a name that the model does not have.
    """
    known = {f.name: f for f in all_functions(problem, model)}
    by_name = dict[str, Function]()
    for name in names:
        chosen = [known[name]] if name in known else _group(name, known)
        if not chosen:
            remedy = (
                f"write m1, c1x, I1xx, {TOTAL!r}, a parameter, or {', '.join(GROUPS)}"
            )
            raise InputError(f"{name!r} is no parameter of this model", remedy)
        by_name |= {f.name: f for f in chosen}
    return list(by_name.values())


def coefficients(problem: Problem, model: Model, name: str) -> Array:
    """Return the coefficients g (p,) of a linear function.

    Raises
    ------
    InputError
        For another function, and for a name that the model does not have.
    """
    (chosen,) = functions_by_name(problem, model, [name])
    if chosen.g is None:
        what = f"{name} is not linear in the parameters"
        raise InputError(what, "name a standard parameter, such as m4 or mx4")
    return chosen.g


def all_functions(problem: Problem, model: Model) -> list[Function]:
    """Return every function of a model that has a name: standard parameters, the total
    mass, base parameters that combine several, and entries about centres of mass."""
    unit = np.eye(len(model.parameters))
    links = model.rigid_indices.reshape(-1, 10)
    functions = [
        Function(q.name, plain_unit(q.unit), unit[k])
        for k, q in enumerate(model.parameters)
    ]
    if len(links):
        functions.append(Function(TOTAL, "kg", unit[links[:, 0]].sum(axis=0)))
    base = base_rows(model, problem.independent)
    functions += [
        Function(name, plain_unit(model.parameters[leading].unit), row)
        for name, row, leading in zip(base.names, base.rows, base.leading, strict=True)
        if name.endswith("...")  # a combination is named by its first parameter
    ]
    # A link's entries about its centre of mass: m, c (3), and six inertias. The mass is
    # a standard parameter already.
    units = ["kg", *["m"] * 3, *["kg m^2"] * 6]
    functions += [
        Function(name, units[entry], place=(link, entry))
        for name, (link, entry) in entries(len(links)).items()
        if entry
    ]
    return functions


def _group(word: str, known: dict[str, Function]) -> list[Function]:
    """List the known functions that a word of GROUPS stands for; none for another word.

    "inertias" are those about a link's frame (Ixx4), "moments" those about its centre of
    mass (I4xx).
    """
    functions = list(known.values())
    # A standard parameter is a linear function with one coefficient.
    standard = [f for f in functions if f.g is not None and np.sum(f.g != 0) == 1]
    total = [known[TOTAL]] if TOTAL in known else []
    # A mass is "m4"; the rotor of a slide, "I_a4", has the unit kg as well.
    masses = [f for f in standard if f.unit == "kg" and f.name[1:].isdigit()]
    about_centre = [f for f in functions if f.place is not None]
    # A link's parameters are m, m c (3), and six inertias.
    inertia_names = inertia.PARAMETERS[4:]
    groups = {
        "masses": [*masses, *total],
        "centres": [f for f in about_centre if f.unit == "m"],
        "moments": [f for f in about_centre if f.unit == "kg m^2"],
        "inertias": [f for f in standard if f.name[:3] in inertia_names],
        "parameters": standard,
        # A combination is named by its first parameter: "Izz1 + ...".
        "base": [f for f in functions if f.name.endswith("...")],
    }
    return groups.get(word, [])
