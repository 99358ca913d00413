"""Base parameters by name: the standard parameter each one leads with, and its whole symbol."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.inertia import parameter_names
from sdp_vs_penalty.problem import Problem
from sdp_vs_penalty.regression import base_parameters

Array = NDArray[np.float64]


def base_parameter_names(problem: Problem) -> tuple[str, ...]:
    """The independent standard parameter (Izz1, mx2, ...) that leads each base parameter."""
    _, kept = base_parameters(problem.model("rigid_body"), problem.independent)
    rigid = _rigid_names(problem.robot.n)
    return tuple(rigid[k] for k in kept)


def base_parameter_symbols(problem: Problem) -> tuple[str, ...]:
    """Each base parameter written out in standard parameters: "Izz2 - 0.64 m2"."""
    base, kept = base_parameters(problem.model("rigid_body"), problem.independent)
    rigid = _rigid_names(problem.robot.n)
    out = []
    for row, lead in zip(base, kept, strict=True):
        terms = [(1.0, rigid[lead])]
        terms += [
            (v, name) for k, (v, name) in enumerate(zip(row, rigid, strict=True)) if v and k != lead
        ]
        out.append(_written(terms))
    return tuple(out)


def _rigid_names(links: int) -> list[str]:
    return [name for link in range(1, links + 1) for name in parameter_names(link)]


def _written(terms: list[tuple[float, str]]) -> str:
    out = ""
    for value, name in terms:
        size = "" if abs(abs(value) - 1.0) < 1e-9 else f"{abs(value):.4g} "
        sign = " + " if value > 0.0 else " - "
        out += f"{sign if out else sign.strip().replace('+', '')}{size}{name}"
    return out
