"""The <transmission> elements of a URDF: simple, differential and four-bar (ros_control's three).

With motor (actuator) reductions n_a, joint reductions n_j, as ros_control's transmission_interface:
simple: q_m = n q; differential: q_m1,2 = n_a1,2 (n_j1 q_1 +- n_j2 q_2); four-bar: q_m1 = n_a1 n_j1 q_1,
q_m2 = n_a2 (n_j2 q_2 + q_1).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from sdp_vs_penalty.robot.transmission import Transmission

_PAIRS = ("DifferentialTransmission", "FourBarLinkageTransmission")


def urdf_transmission(
    root: Any, names: Sequence[str], fail: Callable[[str], Exception]
) -> Transmission | None:
    """How the motors turn with the joints ``names``; None where the file says nothing of it.

    A joint of which nothing is said has a motor that turns with it. Channels are those of joints, as
    every ROS log has them. Raises what ``fail`` makes of a sentence where numbers are missing.
    """
    elements = root.findall("transmission")
    matrix, named = np.eye(len(names)), False
    for element in elements:
        joints, actuators = element.findall("joint"), element.findall("actuator")
        places = [names.index(j.get("name")) for j in joints if j.get("name") in names]
        if not places or len(places) != len(joints) or len(joints) != len(actuators):
            continue  # of a fixed or following joint, or of no motor
        kind = (element.findtext("type") or element.get("type") or "").rpartition("/")[2]
        n_j, n_a = ([_reduction(e, fail) for e in part] for part in (joints, actuators))
        if kind in _PAIRS and len(places) == 2:
            block = np.array([[n_j[0], n_j[1]], [n_j[0], -n_j[1]]])
            if kind == _PAIRS[1]:
                block = np.array([[n_j[0], 0.0], [1.0, n_j[1]]])
            matrix[np.ix_(places, places)] = np.array(n_a)[:, None] * block
        else:
            for place, a, j in zip(places, n_a, n_j, strict=True):
                matrix[place, place] = a * j
        named = True
    if not named:
        return None
    sides = ("joint",) * len(names)
    return Transmission(matrix, np.zeros(len(names)), sides, sides)


def _reduction(element: Any, fail: Callable[[str], Exception]) -> float:
    text = element.findtext("mechanicalReduction")
    try:
        value = 1.0 if text is None else float(text)
    except ValueError:
        value = np.nan
    if not np.isfinite(value) or value == 0.0:
        raise fail(f"line {element.sourceline}, <mechanicalReduction> must hold a number other than 0")
    return value
