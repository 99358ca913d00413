"""Gravity along another direction of the base."""

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from sdp_vs_penalty.checks import constants as c
from sdp_vs_penalty.checks.arm_fit import ArmFit
from sdp_vs_penalty.checks.faults.fault import (
    Fault,
    FaultSize,
    Transformation,
    _degrees,
)
from sdp_vs_penalty.checks.likelihood import Likelihood
from sdp_vs_penalty.checks.repair import LogTransform
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.robot import STANDARD_GRAVITY

#: Gravity on Earth [m/s^2]; a problem whose gravity is of another size is corrected.
_EARTH = max(map(abs, STANDARD_GRAVITY))
#: Step of the difference quotient by an angle [rad].
_DIFFERENCE = 0.02
#: Largest angle for which a first-order step is trusted [rad].
_FIRST_ORDER = 0.5


class Mounting(Transformation):
    """Gravity along another direction of the base: its six axes first, then around the
    assumed one."""

    name = "mounting"

    def proposals(
        self,
        log: Likelihood,
        now: LogTransform,
        score: ArmFit,
    ) -> Iterator[LogTransform]:
        """Propose repairs that correct one more fault of this kind than ``now`` does."""
        gravity = np.array(now.gravity)
        size = float(np.linalg.norm(gravity))
        known = _earthly(size)
        if any(now.lacks):
            return
        for axis in (*np.eye(3), *-np.eye(3)):
            yield _under(now, (size if known else _EARTH) * axis)
        if known:
            # A Gauss-Newton step of two angles turns the assumed vector.
            perpendicular = np.linalg.svd(gravity[None, :])[2][1:]  # (2, 3)
            by_angle = [
                _turned(now, gravity, gravity + size * x) for x in perpendicular
            ]
            angles, _ = log.screen.first_order_steps(
                now,
                by_angle,
                np.zeros(2),
                np.full(2, _DIFFERENCE),
            )
            angles = np.clip(angles, -_FIRST_ORDER, _FIRST_ORDER)
            turned = gravity + size * angles @ perpendicular
            yield _under(now, size * turned / np.linalg.norm(turned))

    def elements(self, log: Likelihood, repair: LogTransform) -> Iterator[Fault]:
        """Yield the faults of this kind that a repair corrects."""
        assumed = np.array(log.problem.robot.gravity)
        g = np.array(repair.gravity)
        if np.allclose(assumed, g, rtol=0.0, atol=1e-6):
            return
        size = float(np.linalg.norm(assumed))
        cosine = assumed @ g / max(size * float(np.linalg.norm(g)), 1e-300)
        angle = float(np.arccos(np.clip(cosine, -1.0, 1.0)))
        rounded = [float(round(v, 2)) + 0.0 for v in g]  # no negative zero
        x, y, z = rounded
        kind = "gravity direction"
        remedy = f"identify with --gravity {x:g},{y:g},{z:g}"
        of: LogTransform | FaultSize = _under(repair, assumed)
        if not _earthly(size):
            kind = "gravity of the problem"
            remedy = f"{remedy}, or correct the problem's gravity"
        elif np.count_nonzero(np.abs(g) > 1e-9) > 1:
            of = FaultSize(
                angle,
                _turned(repair, assumed, g),
                c.CALIBRATED,
                0.5,
                _degrees,
            )
        measured_text = ", ".join(f"{float(f'{v:.3f}') + 0.0:g}" for v in g)
        assumed_text = ", ".join(f"{float(f'{v:.3f}') + 0.0:g}" for v in assumed)
        what = (
            f"the weight in the torques points along ({measured_text}) m/s^2,"
            f" {np.degrees(angle):.0f} degrees away from the assumed ({assumed_text})."
        )
        zero = _as_zero_of_joint_1(log, assumed, g)
        equal = f" Exactly as good on this arm: {zero[0]}." if zero else ""
        figures = {
            "angle_degrees": float(np.degrees(angle)),
            "vector": [x, y, z],
        }
        yield Fault(
            kind=kind,
            severity="warning",
            joints=(),
            what=f"{what}{equal}",
            remedy=remedy,
            of=of,
            place="the base",
            mends=False,
            figures=figures,
            equivalents=zero,
        )


def _earthly(size: float) -> bool:
    return abs(size / _EARTH - 1.0) < c.CALIBRATED_GAIN


def _turned(
    repair: LogTransform,
    assumed: Array,
    g: Array,
) -> Callable[[float], LogTransform]:
    """The repair with gravity turned by an angle from the assumed vector towards g."""
    size = float(np.linalg.norm(assumed))
    a = assumed / size
    across = g - (g @ a) * a
    across = across / np.linalg.norm(across)
    return lambda v: _under(repair, size * (np.cos(v) * a + np.sin(v) * across))


def _under(repair: LogTransform, g: Array) -> LogTransform:
    return replace(repair, gravity=tuple(g.tolist()))


def _as_zero_of_joint_1(
    log: Likelihood,
    assumed: Array,
    g: Array,
) -> tuple[str, ...]:
    """In words the zero of the first joint that makes the same torques as a gravity g
    instead of the assumed one; empty where none does.

    The base is free to turn about the first joint's axis: an arm at q1 + x under a
    gravity is the arm at q1 under that gravity turned by -x about the axis.
    """
    if 0 not in log.revolute:
        return ()
    joint = log.problem.robot.joints[0]
    axis = joint.placement[:3, :3] @ np.asarray(joint.axis)
    a = assumed - assumed @ axis * axis
    b = g - g @ axis * axis
    size = float(np.linalg.norm(assumed))
    along = abs((assumed - g) @ axis)
    if along > c.CALIBRATED * size or np.linalg.norm(a) < 0.05 * size:
        return ()
    turned = float(np.arctan2(axis @ np.cross(a, b), a @ b))
    return (f"joint 1 counts from another zero (add {-turned:+.4g} rad to q1)",)
