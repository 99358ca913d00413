"""Torques of an impossible size: another unit, motor currents, the motor's side of the gear.

What joints share tells the channels' ratios, never their common size. Two witnesses do: the joints'
effort limits, and what an arm of the problem's masses needs on the same motion, where these are known.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from sdp_vs_penalty.checks.issue import Issue, joints_text
from sdp_vs_penalty.checks.repair import Repair
from sdp_vs_penalty.checks.transformations import Scene
from sdp_vs_penalty.problem.problem import Problem
from sdp_vs_penalty.robot.arrays import Array

#: How far torques may be from those of a nominal arm, beside what its masses allow: friction, another
#: place of the masses, a gear that was left out.
_SLACK = 4.0
#: Torques above so many times the effort limits are no torques of these joints; those that use at
#: least the second share have the right unit: a current is an order of magnitude smaller.
_FAR_OVER, _USED = 3.0, 0.2
#: A channel so many times larger against the nominal arm than the others are has another unit.
_ALONE = 40.0


def possible(problem: Problem) -> tuple[float, float] | None:
    """Least and largest ratio of measured to nominal torque; None where nothing is known of the
    masses.
    """
    masses = float(problem.nominal_links[:, 0].sum())
    low, high = problem.total_mass
    if np.all(problem.guessed_links) or masses <= 0.0:
        return None
    if np.isfinite(high):
        return max(low, 0.1 * high) / masses / _SLACK, high / masses * _SLACK
    return 0.5 / _SLACK, 2.0 * _SLACK


def find(scene: Scene, repair: Repair) -> Iterator[Issue]:
    """Issues of the channels as repaired, so that no two judge each other's."""
    problem, data = scene.problem, scene.judged
    channels = data.channels(repair)
    effort = np.array([j.effort if j.effort > 0.0 else np.inf for j in problem.robot.joints])
    over = np.abs(channels).max(axis=0) / effort
    nominal = _nominal(scene, repair)
    size, expected = np.linalg.norm(channels, axis=0), np.linalg.norm(nominal, axis=0)
    each = size / np.maximum(expected, 1e-3 * np.linalg.norm(nominal) + 1e-300)
    middle = float(np.median(each))
    known = np.isfinite(effort)
    odd = (over > _FAR_OVER) | ((each > _ALONE * middle) & (~known | (over > _USED)))
    scale = possible(problem)
    if odd.any() and odd.sum() <= 0.3 * len(odd) and scale is not None:
        for j in np.flatnonzero(odd).tolist():
            told = f"{over[j]:.3g} times what the joint is made for"
            if over[j] <= _FAR_OVER:
                told = f"{each[j] / middle:.0f} times what the other joints' torques let expect"
            yield Issue(
                "torque unit", "error", joints_text([j]),
                f"the torque of joint {j + 1} is too large, {told}: its unit is not that of the others.",
                "likely: judged by size alone",
                "convert it to N m (N for a prismatic joint): N cm times 0.01, mN m times 0.001", None,
                {"joints": [j + 1], "times_effort_limit": float(over[j])},
            )  # fmt: skip
        return
    most = float(over[known].max()) if known.any() else None
    ratio = float(np.linalg.norm(channels) / max(float(np.linalg.norm(nominal)), 1e-300))
    yield from _common(problem, scale, most, ratio)


def _common(
    problem: Problem, scale: tuple[float, float] | None, over: float | None, ratio: float
) -> Iterator[Issue]:
    figures = {"times_effort_limit": over, "times_nominal": ratio if scale else None}
    large = scale is not None and ratio > scale[1]
    far = over is not None and over > _FAR_OVER
    masses = _masses(problem)
    if far and (large or scale is None):
        unit = _unit(ratio, scale) if scale is not None else _unit(over or 1.0, (1e-2, 1.0))
        told = f"{over:.3g} times what the joints are made for"
        told += f" and {ratio:.3g} times what an arm of {masses} needs" if scale else ""
        factor = None if unit is None else unit[0]
        yield Issue(
            "torque unit", "error", "all torque channels",
            f"the torques are too large, {told}: "
            f"{'their unit is not N m' if unit is None else f'they are in {unit[1]}'}.",
            "likely: judged by size alone",
            "convert them to N m (N for a prismatic joint)" if factor is None else f"multiply by "
            f"{factor:g}",
            None if factor is None else lambda r: replace(r, tau=r.tau * factor), figures,
        )  # fmt: skip
        return
    if scale is None or scale[0] <= ratio <= scale[1]:
        return
    size = f"{ratio:.3g} times what" if ratio > 1.0 else f"{1.0 / ratio:.3g} times less than"
    if over is not None and _USED <= over <= _FAR_OVER:
        yield Issue(
            "masses of the problem", "error", "the problem",
            f"the torques are {size} an arm of {masses} needs, yet they reach {100.0 * over:.0f} % "
            f"of the "
            "joints' effort limits, as torques do: the problem's masses are wrong.",
            "likely: judged by size alone", "correct total_mass in problem.toml (the inertials of a "
            "URDF)",
            None, figures,
        )  # fmt: skip
    elif large:
        yield Issue(
            "torque unit", "error", "all torque channels",
            f"the torques are too large, {size} an arm of {masses} needs: their unit is not N m.",
            "likely: judged by size alone", "convert them to N m (N for a prismatic joint); if the "
            "torques "
            "are right, correct the problem's masses", None, figures,
        )  # fmt: skip
    else:
        yield Issue(
            "torque channel kind", "warning", "all torque channels",
            f"the torques are {1.0 / ratio:.3g} times too small for an arm of {masses}: they are motor "
            "currents, or torques on the motor side of the gear. A model of them is unscaled: its "
            "ratios "
            "are right, its kilograms are not.",
            "likely: judged by size alone",
            "multiply each channel by its drive gain (N m per A, gear ratio included); if the "
            "torques are "
            "right, correct the problem's masses", None, figures,
        )  # fmt: skip


def _masses(problem: Problem) -> str:
    low, high = problem.total_mass
    if np.isfinite(high):
        return f"{low:g} to {high:g} kg"
    return f"{float(problem.nominal_links[:, 0].sum()):.3g} kg"


def _unit(size: float, within: tuple[float, float]) -> tuple[float, str] | None:
    """The factor that brings a size into its possible range, and the unit's name."""
    units = ((1e-3, "mN m"), (1e-2, "N cm"))
    return next(((f, u) for f, u in units if within[0] <= size * f <= within[1]), None)


def _nominal(scene: Scene, repair: Repair) -> Array:
    """(M, n) torque of the nominal links on the repaired motion, where it is asked for."""
    from sdp_vs_penalty.checks.columns import under_gravity

    model = under_gravity(scene.problem.model(), repair.gravity)
    motion, links = scene.judged.motion(repair), model.rigid_indices
    if not len(links):
        return np.zeros_like(motion.q)
    theta = np.asarray(scene.problem.nominal_links.ravel(), float)
    torque = model.robot.regressor(motion.q, motion.dq, motion.ddq) @ theta
    return np.asarray(torque * scene.judged.data.heard[:, list(repair.order)])
