"""What each joint's own motion makes of its torque: friction, zeros, a rotor."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.effects.effect import JointEffect
from sdp_vs_penalty.effects.model import Model
from sdp_vs_penalty.robot.arrays import Array


@dataclass(frozen=True)
class Own:
    """Columns that each joint's own motion makes (friction, offset, rotor), low-passed as the torque is.

    Friction is far sharper at reversals than low-passed states. columns (n, M, k); indices (n, k) where
    their parameters sit in theta, those of what the model may lack (see beyond.py) behind the model's;
    offered() (n, M, l) what it may lack; rivals() what more a rival is offered: made when asked for.
    To exchange joints or turn them round exchanges or turns columns.
    """

    columns: Array
    indices: NDArray[np.intp]
    offered: Callable[[], Array]
    rivals: Callable[[], Array]

    def _each(self, change: Callable[[Array], Array]) -> Own:
        late = (lambda: change(self.offered()), lambda: change(self.rivals()))
        return replace(self, columns=change(self.columns), offered=late[0], rivals=late[1])

    def part(self, rows: slice | NDArray[np.intp]) -> Own:
        return self._each(lambda x: x[:, rows])

    def moved(self, scale: Array, order: NDArray[np.intp]) -> Own:
        sign = np.sign(scale)[:, None, None]
        return self._each(lambda x: sign * x[order])

    def first(self, parameters: int) -> Own:
        """Those of so many parameters."""
        k = int(np.sum(self.indices[0] < parameters))
        return replace(self, columns=self.columns[:, :, :k], indices=self.indices[:, :k])


def own_effects(model: Model) -> list[int]:
    """Which of the model's effects have one column on every joint, made by that joint's motion."""
    every = list(range(model.robot.n))
    return [
        k for k, e in enumerate(model.effects) if isinstance(e, JointEffect) and list(e.joints) == every
    ]
