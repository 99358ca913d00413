"""A cylinder or cone about an axis of a link in which its centre of mass lies."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.constraints import constraint as build
from sdp_vs_penalty.constraints.constraint import Constraint
from sdp_vs_penalty.errors import InputError, unknown


@dataclass(frozen=True)
class CentreOfMassCone:
    """|c perpendicular to axis| <= radius + slope (c along axis), in the link frame [m]."""

    link: int  # from 0
    axis: int
    radius: float
    slope: float

    def __post_init__(self) -> None:
        if self.axis not in (0, 1, 2) or not np.all(np.isfinite([self.radius, self.slope])):
            raise InputError(f"the centre_of_mass_cone of link {self.link + 1}", "correct its numbers")

    def constraint(self, indices: NDArray[np.intp]) -> Constraint:
        """The demand on the link's ten parameters, which sit at ``indices`` of theta."""
        across = [a for a in range(3) if a != self.axis]
        coefficients = np.zeros((4, 3))
        coefficients[0, 0], coefficients[1 + self.axis, 0] = self.radius, self.slope
        coefficients[1 + across[0], 1] = coefficients[1 + across[1], 2] = 1.0
        return build.second_order(
            "centre of mass cone", f"link {self.link + 1}", indices[:4], coefficients, np.zeros(3)
        )

    def to_dict(self) -> dict[str, Any]:
        """Plain JSON, as :meth:`from_dict` reads it: link from 1, axis by its letter."""
        return {**asdict(self), "link": self.link + 1, "axis": "xyz"[self.axis]}

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Self:
        """As in problem.toml and model.json: link from 1, axis "x", "y" or "z", radius [m], slope."""
        axis, link = data["axis"], int(data["link"]) - 1
        if axis not in ("x", "y", "z"):
            raise unknown("centre_of_mass_cone axis", axis, ("x", "y", "z"))
        return cls(link, "xyz".index(axis), float(data["radius"]), float(data["slope"]))
