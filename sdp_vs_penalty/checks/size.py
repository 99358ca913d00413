"""Torques of an impossible size: another unit, motor currents, the motor's side of the gear.

What joints share tells the channels' ratios, never their common size. Two witnesses do: the joints'
effort limits, and what an arm of the problem's masses needs on the same motion, where these are known.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from sdp_vs_penalty.checks.constants import EFFORT, MASS_SLACK
from sdp_vs_penalty.checks.issue import Issue, joints_text
from sdp_vs_penalty.checks.regression_data import under_gravity
from sdp_vs_penalty.checks.repair import Repair
from sdp_vs_penalty.checks.transformation import Scene
from sdp_vs_penalty.problem.problem import Problem
from sdp_vs_penalty.robot.arrays import Array

_SURE = "likely: judged by size alone"
_RIGHT = "if the torques are right, correct the problem's masses"
_CONVERT = "convert to N m (N for a prismatic joint): N cm times 0.01, mN m times 0.001"


def possible(problem: Problem) -> tuple[float, float] | None:
    """Least and largest ratio of measured to nominal torque; None where no masses are known."""
    masses = float(problem.nominal_links[:, 0].sum())
    low, high = problem.total_mass
    if np.all(problem.guessed_links) or masses <= 0.0:
        return None
    if not np.isfinite(high):
        low, high = 0.5 * masses, 2.0 * masses
    return max(low, 0.1 * high) / masses / MASS_SLACK, high / masses * MASS_SLACK


def find(scene: Scene, repair: Repair) -> Iterator[Issue]:
    """Issues of the channels as repaired, so that no two judge each other's."""
    problem, scale = scene.problem, possible(scene.problem)
    channels, needed = scene.judged.channels(repair).T, float(np.linalg.norm(_nominal(scene, repair)))
    effort = np.array([j.effort if 0.0 < j.effort < np.inf else np.nan for j in problem.robot.joints])
    each = np.abs(channels).max(axis=0) / effort
    odd = np.flatnonzero(each > EFFORT[1])
    if 0 < len(odd) <= 0.3 * scene.n and scale is not None:
        for j in odd.tolist():
            yield Issue(
                "torque unit", "error", joints_text([j]),
                f"the torque of joint {j + 1} is too large, {each[j]:.3g} times what the joint is made "
                "for: its unit is not that of the others.", _SURE, _CONVERT, None,
                {"joints": [j + 1], "times_effort_limit": float(each[j])},
            )  # fmt: skip
        return
    over = float(np.nanmax(each)) if np.isfinite(effort).any() else np.nan
    ratio = max(float(np.linalg.norm(channels)), 1e-300) / max(needed, 1e-300)  # of 1e-300 squares are 0
    figures = {"times_effort_limit": over, "times_nominal": ratio if scale else None}
    large, small = (False, False) if scale is None else (ratio > scale[1], ratio < scale[0])
    low, high = problem.total_mass
    arm = f"an arm of {low:g} to {high:g} kg needs"
    if not np.isfinite(high):
        arm = f"an arm of {float(problem.nominal_links[:, 0].sum()):.3g} kg needs"
    size = f"{ratio:.3g} times what {arm}" if large else f"{1.0 / ratio:.3g} times less than {arm}"
    far = over > EFFORT[1]
    if (large or small) and EFFORT[0] <= over <= EFFORT[1]:
        yield Issue(
            "masses of the problem", "error", "the problem",
            f"the torques are {size}, yet they reach {100.0 * over:.0f} % of the joints' effort "
            f"limits, as torques do: the problem's masses are wrong.", _SURE,
            "correct total_mass in problem.toml (the inertials of a URDF)", None, figures,
        )  # fmt: skip
    elif large or (far and scale is None):
        within, measured = (scale, ratio) if scale is not None else ((1e-2, 1.0), over)
        units = {"mN m": 1e-3, "N cm": 1e-2}
        name = next((u for u, f in units.items() if within[0] <= measured * f <= within[1]), None)
        factor = units[name] if name and far else None
        told = f"{over:.3g} times what the joints are made for" if far else size
        how = f"they are in {name}" if factor else "their unit is not N m"
        yield Issue(
            "torque unit", "error", "all torque channels", f"the torques are too large, {told}: {how}.",
            _SURE, f"multiply by {factor:g}" if factor else f"{_CONVERT}; {_RIGHT}",
            None if factor is None else lambda r: replace(r, tau=r.tau * factor), figures,
        )  # fmt: skip
    elif small:
        yield Issue(
            "torque channel kind", "warning", "all torque channels",
            f"the torques are {size}: they are motor currents, or torques on the motor side of the "
            "gear. A model of them is unscaled: its ratios are right, its kilograms are not.", _SURE,
            f"multiply each channel by its drive gain (N m per A, gear ratio included); {_RIGHT}",
            None, figures,
        )  # fmt: skip


def _nominal(scene: Scene, repair: Repair) -> Array:
    """(M, n) torque of the nominal links on the repaired motion, where it is asked for."""
    model = under_gravity(scene.problem.model(), repair.gravity)
    motion = scene.judged.motion(repair)
    if not len(model.rigid_indices):
        return np.zeros_like(motion.q)
    theta = np.asarray(scene.problem.nominal_links.ravel(), float)
    torque = model.robot.regressor(motion.q, motion.dq, motion.ddq) @ theta
    return np.asarray(torque * scene.judged.data.heard[:, list(repair.order)])
