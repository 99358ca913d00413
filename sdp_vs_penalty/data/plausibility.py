"""Are these measurements of this robot, and in SI units? Refused before anything is
fitted to them.

A model fitted to degrees looks like a model: the least-squares fit absorbs the factor.
Two facts give the unit away without any guess about the motion:

- A joint cannot be outside its mechanical range. Zero offsets and encoder wraps move a position by up
  to one turn, so only what lies farther outside is refused; recorded in degrees, an excitation of more
  than some ten degrees does.
- Where a velocity is recorded too, it is the derivative of the position: a ratio near 180 / pi between
  the two means that one of them is in degrees.
"""

import math

import numpy as np

from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.data.store import iter_chunks
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.robot.robot import Robot

#: How far outside its range an encoder's zero may put a joint [rad, m].
_ZERO = 0.2
#: What else large angles may be.
_MOTORS = ", or motors' angles to joints' (`convert --motors`)"


def check_plausible(robot: Robot, measurements: Measurements) -> None:
    """InputError where positions cannot be this robot's, or are not in radians and
    metres."""
    for run in measurements.runs():
        check_torque(run)
        _check_derivative(robot, run)
        _check_side(robot, run)
        far = far_outside(robot, run.q)
        for j, (joint, travel) in enumerate(
            zip(robot.joints, np.ptp(run.q, axis=0), strict=True)
        ):
            q = run.q[:, j]
            turns = joint.kind == "revolute"
            motors = _MOTORS if turns else ""
            if j in far:
                worst = int(np.argmax(np.maximum(joint.lower - q, q - joint.upper)))
                unit, units = (
                    ("rad", "degrees to radians")
                    if turns
                    else ("m", "millimetres to metres")
                )
                span = f"joint {j + 1} ({joint.lower:.4g} to {joint.upper:.4g} {unit})"
                what = (
                    f"column q{j + 1}: {q[worst]:.6g} is far outside the range of"
                    f" {span}"
                )
                remedy = (
                    f"convert {units}{motors}, or choose the problem that belongs to"
                    " this file"
                )
                raise InputError(f"{_place(run, worst)}, {what}", remedy)
            # A motion to and fro over many turns, not a shaft that goes on turning.
            free = turns and not np.isfinite(joint.upper - joint.lower)
            if free and travel > 8.0 * math.tau and abs(q[-1] - q[0]) < 0.5 * travel:
                where = f"{_place(run, int(np.argmax(np.abs(q))))}, column q{j + 1}"
                what = f"joint {j + 1} swings through {travel / math.tau:.0f} turns"
                what += ": positions look like degrees"
                raise InputError(what, f"convert to radians{motors}", where)


def find_idle_joints(robot: Robot, measurements: Measurements) -> dict[str, float]:
    """Joints that stand still in all runs while their torque channel reads exactly
    nothing, and where [rad, m]: a gripper's, a wheel's. None where no torque is logged.

    An arm's joint that stands still needs a torque, and a broken channel of one that
    moves is no idle joint.
    """
    found: dict[str, float] = {}
    if not measurements.torque_logged or measurements.n != robot.n:
        return found
    for k, joint in enumerate(robot.joints):
        # An encoder's last digit [rad, m].
        is_still = all(
            np.ptp(run.q[:, k]) <= 1e-4 for run in measurements.runs() if run.samples
        )
        is_silent = is_still and not np.any(measurements.tau[:, k])
        if is_silent and measurements.samples:
            found[joint.name] = float(np.mean(measurements.q[:, k]))
    return found if len(found) < robot.n else {}


def far_outside(robot: Robot, q: np.ndarray) -> tuple[int, ...]:
    """Joints farther outside their ranges than an encoder's zero or a turn brings them:
    twice their travel on a straight axis."""
    largest = [
        math.tau if j.kind == "revolute" else 2.0 * (j.upper - j.lower)
        for j in robot.joints
    ]
    return tuple(np.flatnonzero(_beyond(robot, q) > largest).tolist())


def _place(run: Measurements, k: int) -> str:
    """The k-th sample of a run as the user finds it: below the header of a CSV file."""
    name = run.names[0]
    return (
        f"{name}: row {k + 2}" if name.endswith(".csv") else f"{name}: sample {k + 1}"
    )


def check_torque(run: Measurements) -> None:
    """InputError where no channel holds anything: zeros, or less than an arm needs."""
    if not run.torque_logged:
        return
    # No sensor resolves the first, and no arm of a gram and a centimetre needs as little
    # as the second [N m, N].
    zero = 1e-12
    least = 1e-6
    most = 0.0
    has_numbers = False
    for _, part in iter_chunks(run.tau):
        sizes = np.abs(part)
        # What is no number is named row by row elsewhere.
        most = max(most, float(np.fmax.reduce(sizes, axis=None, initial=0.0)))
        has_numbers = has_numbers or not np.isnan(sizes).all()
    if run.samples and not has_numbers:
        return
    if not most > zero:
        raise InputError(
            "every torque is zero", "log the torque, or the current", run.names[0]
        )
    if most < least:
        what = f"no torque exceeds {most:.2g} N m, less than any arm needs"
        raise InputError(what, "write torques in N m", run.names[0])


def _check_side(robot: Robot, run: Measurements) -> None:
    """Positions of motors, where the robot's transmission is known and brings them into
    the ranges."""
    gears = robot.transmission
    if (
        gears is None
        or np.all(_beyond(robot, run.q) <= _ZERO)
        or beside_range(robot, run.q)
    ):
        return
    joints = np.linalg.solve(gears.matrix, (run.q - gears.offset).T).T
    if np.all(_beyond(robot, joints) <= _ZERO):
        what = (
            "the positions are those of the motors: through the transmission they are"
            " in the ranges"
        )
        raise InputError(
            what, "convert the log with `convert --motor-side`", run.names[0]
        )


def _beyond(robot: Robot, q: np.ndarray) -> np.ndarray:
    """(n,) how far positions (N, n) come beyond each joint's range; negative inside it."""
    low, high = np.transpose([(j.lower, j.upper) for j in robot.joints])
    return np.maximum(low - q.min(axis=0), q.max(axis=0) - high)


def beside_range(robot: Robot, q: np.ndarray) -> tuple[int, ...]:
    """Joints outside their ranges, if they are few and their travel would fit: their
    zero is wrong.

    Where many joints are outside, or travel farther than they can, something else is
    wrong with all.
    """
    outside = np.flatnonzero(_beyond(robot, q) > _ZERO)
    fits = np.ptp(q, axis=0) <= [j.upper - j.lower + _ZERO for j in robot.joints]
    return (
        tuple(outside.tolist())
        if len(outside) <= max(1, robot.n // 2) and np.all(fits)
        else ()
    )


def _check_derivative(robot: Robot, run: Measurements) -> None:
    """Position and velocity of revolute joints in the same unit of angle."""
    if run.dq is None:
        return
    sums = np.zeros((3, run.n))
    channels = (iter_chunks(x, overlap=1) for x in (run.t, run.q, run.dq))
    with np.errstate(over="ignore", invalid="ignore"):  # of 1e300 nothing is concluded
        for (_, t), (_, q), (_, dq) in zip(*channels, strict=True):
            way = np.diff(q, axis=0)
            logged = 0.5 * (dq[1:] + dq[:-1]) * np.diff(t)[:, None]
            sums += [
                np.sum(x * y, axis=0)
                for x, y in ((logged, logged), (way, way), (way, logged))
            ]
    for j, (energy, way, common) in enumerate(sums.T.tolist()):
        if robot.joints[j].kind != "revolute" or not 0.0 < energy * way < np.inf:
            continue
        if common * common < 0.5 * energy * way:
            continue  # noise, or a coarse encoder: nothing to conclude from
        ratio = common / energy
        for name, value in (("q", ratio), ("dq", 1.0 / ratio)):
            if 2.0 / 3.0 < math.radians(value) < 1.5:
                what = (
                    f"columns q{j + 1} and dq{j + 1} differ by a factor of {value:.3g}"
                )
                raise InputError(
                    what, f"convert {name} from degrees to radians", run.names[0]
                )
