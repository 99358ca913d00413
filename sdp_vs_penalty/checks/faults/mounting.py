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
#: Share of gravity across an axis below which gravity is parallel to it [-].
_PARALLEL = 0.05


class Mounting(Transformation):
    """Gravity along another direction of the base: its six axes first, then around the
    assumed one."""

    name = "mounting"

    def propose(
        self, log: Likelihood, now: LogTransform, fit: ArmFit
    ) -> Iterator[LogTransform]:
        """Yield the repair ``now`` with gravity along each of the six axes of the base,
        and with the assumed gravity turned by the two angles of a first-order step.

        Parameters
        ----------
        log : Likelihood
            Rows that repairs are judged on.
        fit : ArmFit
            The arm fitted to the rows under ``now``.

        Returns
        -------
        iterator of LogTransform
            Repairs to fit arms to, with all corrections of ``now``.
        """
        gravity = np.array(now.gravity)
        size = float(np.linalg.norm(gravity))
        is_of_earth = _is_earths_gravity(size)
        if any(now.lacks):
            return  # weight that is missing has no direction
        for axis in (*np.eye(3), *-np.eye(3)):
            yield _with_gravity(now, (size if is_of_earth else _EARTH) * axis)
        if is_of_earth:
            # A Gauss-Newton step of two angles turns the assumed vector.
            perpendicular = np.linalg.svd(gravity[None, :])[2][1:]  # (2, 3)
            by_angle = [
                _repair_by_angle(now, gravity, gravity + size * direction)
                for direction in perpendicular
            ]
            angles, _ = log.on_third_of_rows.first_order_steps(
                now, by_angle, np.zeros(2), np.full(2, _DIFFERENCE)
            )
            angles = np.clip(angles, -_FIRST_ORDER, _FIRST_ORDER)
            turned = gravity + size * angles @ perpendicular
            yield _with_gravity(now, size * turned / np.linalg.norm(turned))

    def list_faults(self, log: Likelihood, repair: LogTransform) -> Iterator[Fault]:
        """Yield the fault that gravity is another vector than the problem's, if a
        repair has another one. Its words name an offset of joint 1's encoder where that
        is equivalent.

        Parameters
        ----------
        log : Likelihood
            Rows that repairs are judged on.
        repair : LogTransform
            A complete repair, with faults of any kinds.

        Returns
        -------
        iterator of Fault
            With the words for the user.
        """
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
        remedy = f"set gravity to ({x:g}, {y:g}, {z:g}) m/s^2"
        removal: LogTransform | FaultSize = _with_gravity(repair, assumed)
        if not _is_earths_gravity(size):
            kind = "gravity of the problem"
            remedy = f"{remedy}, or correct the problem's gravity"
        elif np.count_nonzero(np.abs(g) > 1e-9) > 1:
            # Not along an axis of the base: the angle is a size.
            removal = FaultSize(
                value=angle,
                repair_with=_repair_by_angle(repair, assumed, g),
                tolerance=c.CALIBRATED,
                search_radius=_FIRST_ORDER,
                in_words=_degrees,
            )
        measured_text = ", ".join(f"{float(f'{v:.3f}') + 0.0:g}" for v in g)
        assumed_text = ", ".join(f"{float(f'{v:.3f}') + 0.0:g}" for v in assumed)
        what = (
            f"the weight in the torques points along ({measured_text}) m/s^2,"
            f" {np.degrees(angle):.0f} degrees away from the assumed ({assumed_text})."
        )
        equivalents = _as_zero_of_joint_1(log, assumed, g)
        equal = ""
        if equivalents:
            equal = f" Exactly as good on this arm: {equivalents[0]}."
        figures = {"angle_degrees": float(np.degrees(angle)), "vector": [x, y, z]}
        yield Fault(
            kind=kind,
            severity="warning",
            joints=(),
            what=f"{what}{equal}",
            remedy=remedy,
            removal=removal,
            place="the base",
            is_repairable=False,
            figures=figures,
            equivalents=equivalents,
        )


def _is_earths_gravity(size: float) -> bool:
    """Whether a gravity [m/s^2] is Earth's, to within the calibration of drives."""
    return abs(size / _EARTH - 1.0) < c.CALIBRATED_GAIN


def _repair_by_angle(
    repair: LogTransform, assumed: Array, g: Array
) -> Callable[[float], LogTransform]:
    """Return the repair as a function of an angle [rad], by which gravity is turned
    from the assumed vector (3,) towards g (3,) [m/s^2]; the size stays the assumed one.
    """
    size = float(np.linalg.norm(assumed))
    along = assumed / size
    across = g - (g @ along) * along
    across = across / np.linalg.norm(across)

    def with_angle(angle: float) -> LogTransform:
        direction = np.cos(angle) * along + np.sin(angle) * across
        return _with_gravity(repair, size * direction)

    return with_angle


def _with_gravity(repair: LogTransform, g: Array) -> LogTransform:
    """Return the repair under another gravity g (3,) [m/s^2] in the base frame."""
    return replace(repair, gravity=tuple(g.tolist()))


def _as_zero_of_joint_1(log: Likelihood, assumed: Array, g: Array) -> tuple[str, ...]:
    """Describe the offset of joint 1's encoder that makes the same torques as gravity g
    (3,) instead of the assumed one (3,) [m/s^2]; return nothing where none does.

    The base is free to turn about the first joint's axis: an arm at q1 + x under a
    gravity is the arm at q1 under that gravity turned by -x about the axis. So the two
    have to agree along the axis, and have a component across it.
    """
    if 0 not in log.revolute:
        return ()
    joint = log.problem.robot.joints[0]
    axis = joint.placement[:3, :3] @ np.asarray(joint.axis)
    assumed_across = assumed - assumed @ axis * axis
    g_across = g - g @ axis * axis
    size = float(np.linalg.norm(assumed))
    difference_along = abs((assumed - g) @ axis)
    is_along_axis = np.linalg.norm(assumed_across) < _PARALLEL * size
    if difference_along > c.CALIBRATED * size or is_along_axis:
        return ()
    sine = axis @ np.cross(assumed_across, g_across)
    turned = float(np.arctan2(sine, assumed_across @ g_across))
    return (f"joint 1 counts from another zero (add {-turned:+.4g} rad to q1)",)
