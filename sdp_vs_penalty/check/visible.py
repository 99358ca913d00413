"""How large a wrong zero, or a wrong gain, has to be to be seen in a motion."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.check.channels import gain_number
from sdp_vs_penalty.check.hypothesis import Number
from sdp_vs_penalty.check.issue import Issue
from sdp_vs_penalty.check.physics import Physics

#: Smaller ones are no matter of a file but of calibration [rad].
_SMALL = np.radians(2.0)


def find(physics: Physics, moving: NDArray[np.bool_]) -> Iterator[Issue]:
    """One note: from which size on a zero or a gain would be named, joint by joint."""
    robot, same = physics.model.robot, np.arange(physics.n)

    def turned(j: int) -> Callable[[float], Callable[[Physics], Physics]]:
        return lambda x: partial(
            Physics.with_motion, scale=np.ones(physics.n), order=same, offset=x * (same == j)
        )

    revolute = [j for j in np.flatnonzero(moving).tolist() if robot.joints[j].kind == "revolute"]
    zeros = {j + 1: Number(0.0, turned(j)).smallest(physics) for j in revolute}
    gains = {j + 1: gain_number(j, physics.n).smallest(physics) for j in np.flatnonzero(moving).tolist()}
    hidden = [
        f"joint {j}{'' if x > np.pi else f' below {np.degrees(x):.2g} degrees'}"
        for j, x in zeros.items()
        if x > _SMALL
    ]
    weak = [
        f"joint {j}" + ("" if x > np.log(10.0) else f" below {100.0 * np.expm1(x):.2g} %")
        for j, x in gains.items()
    ]
    if not hidden:
        return
    yield Issue(
        "not visible", "note", "the motion",
        f"errors of these joints' zeros could not be seen in this motion: {', '.join(hidden)}; of the "
        f"gains of their torques: {', '.join(weak)}.",
        "likely: to first order, from what the arm leaves unexplained",
        "move these joints farther, and in other poses of the joints before them",
        None, {"zeros": zeros, "gains": gains},
    )  # fmt: skip
