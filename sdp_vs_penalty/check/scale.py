"""Torques of an impossible size: another unit, motor currents, the motor's side of the gear."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from sdp_vs_penalty.check.finding import Finding
from sdp_vs_penalty.check.physics import Physics
from sdp_vs_penalty.measurements import Measurements
from sdp_vs_penalty.problem import Problem, _plausible

#: How far torques may be from those of a nominal arm, beside what its masses allow: friction, another
#: place of the masses.
_SLACK = 4.0


def possible_scale(problem: Problem) -> tuple[float, float] | None:
    """Least and largest ratio of measured to nominal torque; None where nothing is known of the masses.

    Known are a total mass with an upper bound, or inertials that came with a URDF.
    """
    masses = problem.nominal_links[:, 0]
    low, high = problem.total_mass
    if np.isfinite(high):
        return max(low, 0.1 * high) / float(masses.sum()) / _SLACK, high / float(masses.sum()) * _SLACK
    made_up = _plausible(problem.robot, np.zeros_like(problem.nominal_links))
    if not np.allclose(problem.nominal_links, made_up):
        return 0.5 / _SLACK, 2.0 * _SLACK
    return None


def find(run: Measurements, physics: Physics, problem: Problem) -> Iterator[Finding]:
    """Torques that this arm cannot need: another unit, a motor current, the motor's side of a gear."""
    scale = possible_scale(problem)
    robot = physics.model.robot
    effort = np.array([joint.effort for joint in robot.joints])
    known = np.isfinite(effort) & (effort > 0.0)
    over = float((np.abs(run.tau).max(axis=0)[known] / effort[known]).max(initial=0.0))
    ratio = _ratio_to_nominal(physics) if scale is not None else None
    low, high = (None, None) if scale is None else scale
    too_large = over > 3.0 and (ratio is None or high is None or ratio > high)
    if ratio is not None and high is not None and ratio > high:
        too_large = True
    if too_large:
        factor, unit = _unit(ratio if ratio is not None and high is not None else None, over, low, high)
        size = f"{over:.3g} times what the joints are made for" if over > 0 else ""
        against = f"{ratio:.3g} times what an arm of this mass needs" if ratio is not None else ""
        yield Finding(
            "torque unit",
            "error",
            "all torque channels",
            f"the torques are too large, {' and '.join(x for x in (size, against) if x)}: "
            f"{f'they are in {unit}' if factor else 'their unit is not N m'}.",
            "likely: judged by the size alone",
            f"multiply them by {factor:g}"
            if factor
            else "convert them to N m (N for a prismatic joint)",
            (lambda r: replace(r, tau=r.tau * factor)) if factor else None,
            {"times_effort_limit": over, "times_nominal": ratio},
        )
    elif ratio is not None and low is not None and ratio < low:
        yield Finding(
            "torque channel kind",
            "error",
            "all torque channels",
            f"the torques are {1.0 / ratio:.0f} times too small for an arm of this mass: they are motor "
            "currents, or torques on the motor's side of the gear.",
            "likely: judged by the size alone",
            "multiply each channel by its drive gain (N m per A, gear ratio included)",
            None,
            {"times_nominal": ratio},
        )


def _unit(
    ratio: float | None, over: float, low: float | None, high: float | None
) -> tuple[float | None, str]:
    """The factor that brings torques to a possible size, and the unit's name."""
    for factor, unit in ((1e-3, "mN m"), (1e-2, "N cm")):
        if ratio is not None and low is not None and high is not None:
            if low <= ratio * factor <= high:
                return factor, unit
        elif 1e-2 < over * factor < 1.0:
            return factor, unit
    return None, ""


def _ratio_to_nominal(physics: Physics) -> float:
    """Size of the measured torque over that of the nominal arm's on the same motion."""
    modelled = np.column_stack([columns @ physics.nominal for columns in physics.columns])
    return float(np.linalg.norm(physics.channels) / max(float(np.linalg.norm(modelled)), 1e-300))
