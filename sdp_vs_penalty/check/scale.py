"""Torques of an impossible size: another unit, motor currents, the motor's side of the gear."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from sdp_vs_penalty.check.issue import Issue, joints_text
from sdp_vs_penalty.check.physics import Physics
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.problem.problem import Problem
from sdp_vs_penalty.robot.arrays import Array

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
    if np.all(problem.guessed_links):
        return None
    return 0.5 / _SLACK, 2.0 * _SLACK


def find(run: Measurements, physics: Physics, problem: Problem) -> Iterator[Issue]:
    """Torques that this arm cannot need, and which of file and problem is wrong.

    Two witnesses: the joints' effort limits, and what an arm of the problem's masses needs on the same
    motion. Where the limits say that the size is right, the problem's masses are not.
    """
    single = list(_single_channels(run, physics))
    if single:
        yield from single
        return
    over = _times_limit(run, physics)
    scale = possible_scale(problem)
    if scale is None:
        if over is not None and over > _FAR_OVER:
            yield _too_large(None, over, _unit(over, (1e-2, 1.0)))
        return
    ratio = _ratio_to_nominal(physics)
    small, large = ratio < scale[0], ratio > scale[1]
    if over is not None and over > _FAR_OVER and large:
        yield _too_large(ratio, over, _unit(ratio, scale))
    elif over is not None and _USED <= over <= _FAR_OVER and (small or large):
        yield _wrong_masses(ratio, over, problem)
    elif large:
        yield _too_large(ratio, over, _unit(ratio, scale), _masses(problem))
    elif small:
        yield Issue(
            "torque channel kind", "error", "all torque channels",
            f"the torques are {1.0 / ratio:.3g} times too small for an arm of {_masses(problem)}: "
            "they are motor currents, or torques on the motor side of the gear.",
            "likely: judged by size alone",
            "multiply each channel by its drive gain (N m per A, gear ratio included); if the torques "
            "are right, correct the problem's masses", None,
            {"times_nominal": ratio, "times_effort_limit": over},
        )  # fmt: skip


#: Torques above so many times the effort limits are no torques of these joints.
_FAR_OVER = 3.0
#: Torques that use at least this share of the effort limits have the right unit: a current of the same
#: joint, in A, is an order of magnitude smaller.
_USED = 0.2


#: A channel so many times larger against the nominal arm than the others are has another unit.
_ALONE = 40.0


def _single_channels(run: Measurements, physics: Physics) -> Iterator[Issue]:
    """Channels in another unit than the others, where no other joint's torque tells their gain."""
    effort = np.array([joint.effort for joint in physics.model.robot.joints])
    over = np.abs(run.tau).max(axis=0) / np.where(effort > 0.0, effort, np.inf)
    modelled = _modelled(physics)
    ratio = np.linalg.norm(physics.channels, axis=0) / np.maximum(
        np.linalg.norm(modelled, axis=0), 1e-3 * np.linalg.norm(modelled) + 1e-300
    )
    middle = float(np.median(ratio))
    unlimited = ~np.isfinite(effort) | (effort <= 0.0)
    odd = (over > _FAR_OVER) | ((ratio > _ALONE * middle) & (unlimited | (over > _USED)))
    if not odd.any() or odd.sum() > 0.3 * len(odd):
        return
    for j in np.flatnonzero(odd):
        size = f"{ratio[j] / middle:.0f} times what the other joints' torques let expect"
        if over[j] > _FAR_OVER:
            size = f"{over[j]:.3g} times what the joint is made for"
        yield Issue(
            "torque unit", "error", joints_text([j]),
            f"the torque of joint {j + 1} is too large, {size}: its unit is not that of the others.",
            "likely: judged by size alone",
            "convert it to N m (N for a prismatic joint): N cm times 0.01, mN m times 0.001",
            None, {"joints": [int(j) + 1], "times_effort_limit": float(over[j])},
        )  # fmt: skip


def _times_limit(run: Measurements, physics: Physics) -> float | None:
    """The largest torque over its joint's effort limit; None where no limit is known."""
    effort = np.array([joint.effort for joint in physics.model.robot.joints])
    known = np.isfinite(effort) & (effort > 0.0)
    return float((np.abs(run.tau).max(axis=0)[known] / effort[known]).max()) if known.any() else None


def _masses(problem: Problem) -> str:
    low, high = problem.total_mass
    if np.isfinite(high):
        return f"{low:g} to {high:g} kg"
    return f"{float(problem.nominal_links[:, 0].sum()):.3g} kg"


def _too_large(
    ratio: float | None, over: float | None, unit: tuple[float, str] | None, masses: str | None = None
) -> Issue:
    """masses : of the problem, where they may be wrong instead: mending torques is not safe then."""
    parts = [] if over is None or masses else [f"{over:.3g} times what the joints are made for"]
    if ratio is not None:
        parts.append(f"{ratio:.3g} times what an arm of {masses or 'this mass'} needs")
    factor = None if unit is None or masses else unit[0]
    remedy = (
        "convert them to N m (N for a prismatic joint)" if unit is None else f"multiply by {unit[0]:g}"
    )
    return Issue(
        "torque unit", "error", "all torque channels",
        f"the torques are too large, {' and '.join(parts)}: "
        f"{'their unit is not N m' if unit is None else f'they are in {unit[1]}'}.",
        "likely: judged by size alone",
        remedy + ("; if the torques are right, correct the problem's masses" if masses else ""),
        None if factor is None else (lambda r: replace(r, tau=r.tau * factor)),
        {"times_effort_limit": over, "times_nominal": ratio},
    )  # fmt: skip


def _wrong_masses(ratio: float, over: float, problem: Problem) -> Issue:
    size = f"{ratio:.3g} times what" if ratio > 1.0 else f"{1.0 / ratio:.3g} times less than"
    return Issue(
        "masses of the problem", "error", "the problem",
        f"the torques are {size} an arm of {_masses(problem)} needs, yet they reach {100.0 * over:.0f} "
        "% of the joints' effort limits, as torques do: the problem's masses are wrong.",
        "likely: judged by size alone",
        "correct total_mass in problem.toml (the inertials of a URDF)", None,
        {"times_effort_limit": over, "times_nominal": ratio},
    )  # fmt: skip


def _unit(size: float, possible: tuple[float, float]) -> tuple[float, str] | None:
    """The factor that brings a size into its possible range, and the unit's name."""
    for factor, unit in ((1e-3, "mN m"), (1e-2, "N cm")):
        if possible[0] <= size * factor <= possible[1]:
            return factor, unit
    return None


def _ratio_to_nominal(physics: Physics) -> float:
    """Size of the measured torque over that of the nominal arm's on the same motion."""
    modelled = float(np.linalg.norm(_modelled(physics)))
    return float(np.linalg.norm(physics.channels) / max(modelled, 1e-300))


def _modelled(physics: Physics) -> Array:
    """(M, n) torque of the nominal arm on the same motion."""
    known = len(physics.nominal)
    return np.column_stack([columns[:, :known] @ physics.nominal for columns in physics.columns])
