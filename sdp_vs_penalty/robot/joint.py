"""A moving joint with its link, and joints that follow others."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.robot.arrays import Array


@dataclass(frozen=True)
class Joint:
    """One moving joint and the link that it carries.

    placement : (4, 4) pose of the joint frame in the parent's joint frame (the base: -1) at q = 0.
    axis : (3,) unit vector of motion in the joint frame.
    link_frame : (4, 4) pose of the link frame in the joint frame; the link's inertial parameters
        are about the link frame (identity for URDF and modified DH, Tz(d) Tx(a) Rx(alpha) for
        standard DH, whose frames sit at the far end of a link).
    lower, upper : range [rad or m]; velocity : limit [rad/s or m/s]; effort : limit [N m or N].
    """

    name: str
    kind: str  # "revolute" | "prismatic"
    parent: int
    placement: Array
    axis: Array
    link_frame: Array
    lower: float = -np.inf
    upper: float = np.inf
    velocity: float = np.inf
    effort: float = np.inf

    def __post_init__(self) -> None:
        if not (isinstance(self.name, str) and self.name):
            raise InputError(f"a joint's name is {self.name!r}", "give it as text")
        for name, shape in (("placement", (4, 4)), ("axis", (3,)), ("link_frame", (4, 4))):
            value = getattr(self, name)
            if value.shape != shape or not np.all(np.isfinite(value)):
                raise InputError(
                    f"joint {self.name}: {name} does not fit", f"give {shape} finite numbers"
                )
        if abs(np.linalg.norm(self.axis) - 1.0) > 1e-9:
            raise InputError(f"joint {self.name}: the axis is no unit vector", "divide it by its length")
        if self.kind not in ("revolute", "prismatic"):
            raise InputError(
                f"joint {self.name}: kind {self.kind!r} is unknown", "write revolute or prismatic"
            )
        if not self.lower <= self.upper:
            raise InputError(
                f"joint {self.name}: the lower limit {self.lower:g} is above the upper {self.upper:g}",
                "swap them",
            )

    def to_dict(self) -> dict[str, Any]:
        """Plain JSON; infinite limits are left out."""
        return {
            key: value.tolist() if isinstance(value, np.ndarray) else value
            for key, value in asdict(self).items()
            if not (isinstance(value, float) and np.isinf(value))
        }

    @classmethod
    def from_dict(cls, given: Mapping[str, Any]) -> Joint:
        """What :meth:`to_dict` wrote."""
        arrays = ("placement", "axis", "link_frame")
        return cls(**{**given, **{key: np.array(given[key], float) for key in arrays}})


@dataclass(frozen=True)
class Mechanism:
    """Joints that follow others: q_tree = matrix q + offset, so that tau = matrix^T tau_tree.

    tree : every moving joint (L), depth first; matrix (L, n), offset (L,) : of mimic joints and of
    closed chains whose loop is cut (a parallelogram's bars turn as its driven joints do); massless :
    places in the tree of links that are declared to have no mass, and get no parameters.
    """

    tree: tuple[Joint, ...]
    matrix: Array
    offset: Array
    massless: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        L = len(self.tree)
        if self.matrix.ndim != 2 or len(self.matrix) != L or self.offset.shape != (L,):
            raise InputError(
                f"the matrix or the offsets do not fit a mechanism of {L} joints",
                "give a row and an offset a joint",
            )
        if not (np.all(np.isfinite(self.matrix)) and np.all(np.isfinite(self.offset))):
            raise InputError("a mechanism's ratio or offset is not finite", "correct it")
        if not set(self.massless) < set(range(L)):
            raise InputError(
                "every link is declared massless", "leave those with a mass out of massless"
            )
