"""Are these measurements of this robot, and in SI units? Refused before anything is
fitted to them.

A model fitted to degrees looks like a model: the least-squares fit absorbs the factor.
Two facts give the unit away without any guess about the motion:

- A joint cannot be outside its mechanical range. Zero offsets and encoder wraps move a position by up
  to one turn, so only what lies farther outside is refused; recorded in degrees, an excitation of more
  than some ten degrees does.
- Where a velocity is recorded too, it is the derivative of the position: positions that change 180 / pi
  times as fast are in degrees.
"""

import math

import numpy as np

from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.data.store import column_range, iter_chunks
from sdp_vs_penalty.data.stretches import usual_step
from sdp_vs_penalty.data.words.units import LARGEST_PERCENT
from sdp_vs_penalty.errors import InputError, RepairableError
from sdp_vs_penalty.robot.joint import Joint
from sdp_vs_penalty.robot.robot import Robot

#: How far outside its range an encoder's zero may put a joint [rad, m].
ENCODER_ZERO = 0.2
#: Geometric mean of 180 / pi, of degrees, and 60, of a clock in minutes.
_BETWEEN_DEGREES_AND_MINUTES = math.sqrt(60.0 * 180.0 / math.pi)
#: What else large angles may be.
_MOTORS = ", or motors' angles to joints' (`convert --motors`)"


def check_plausible(robot: Robot, measurements: Measurements) -> None:
    """Refuse positions that cannot be this robot's, or are not in radians and metres.

    Each run is checked for a torque that is zero, velocities that are not the
    derivative of the positions, and positions far outside of the ranges.

    Raises
    ------
    InputError
        Naming the run, row and column; for angles a RepairableError.
    """
    for run in measurements.cut_at_pauses.runs():
        _check_derivative(robot, run)
    for run in measurements.runs():
        check_torque(run)
        for j in far_outside(robot, run.q):
            raise _outside_its_range(robot, run, j)


def _outside_its_range(robot: Robot, run: Measurements, j: int) -> InputError:
    """Return the error of joint j (from 0), whose positions are far outside its
    range."""
    joint = robot.joints[j]
    q = run.q[:, j]
    worst = int(np.argmax(_beyond_range(joint, q)))
    is_angle = joint.kind == "revolute"
    unit = "rad" if is_angle else "m"
    limits = f"{joint.lower:.4g} to {joint.upper:.4g} {unit}"
    what = (
        f"{_place(run, worst)}, column q{j + 1}: {q[worst]:.6g} is far outside the range"
        f" of joint {j + 1} ({limits})"
    )
    robot_of_file = "or choose the problem that belongs to this file"
    if _has_possible_unit(run):
        command = f"`{run.unit_command}`"
        return InputError(what, f"convert it, {robot_of_file}", command=command)
    if not is_angle:
        if np.all(_beyond_range(joint, 1e-3 * q) <= 0.0):
            what = f"{what}, and inside it as millimetres"
        remedy = f"convert millimetres to metres, {robot_of_file}"
        return InputError(what, remedy)
    is_known = radians_per_percent(robot, run.q) is None
    percent = ", or per cent of each joint's range as LeRobot writes them,"
    units = "degrees" if is_known else f"degrees{percent}"
    remedy = f"convert {units} to radians{_MOTORS}, {robot_of_file}"
    return RepairableError(what, remedy, is_known=is_known)


def _has_possible_unit(run: Measurements) -> bool:
    """Return whether the reader has found a unit, and the command that states it."""
    return bool(run.unit_command) and "UNIT" not in run.unit_command


def _beyond_range(joint: Joint, q: np.ndarray) -> np.ndarray:
    """Return by how much positions q (N,) are outside a joint's range [rad, m]; negative
    inside."""
    return np.maximum(joint.lower - q, q - joint.upper)


def find_idle_joints(robot: Robot, measurements: Measurements) -> dict[str, float]:
    """Find joints that stand still in all runs and whose torque channel reads exactly
    zero, such as a gripper's or a wheel's.

    A joint of the arm that stands still has a torque; a broken channel of a joint that
    moves is no idle joint. Returns positions [rad, m] by name, none without torques.
    """
    has_one_robot = measurements.n == robot.n
    if not (measurements.torque_logged and has_one_robot and measurements.samples):
        return {}
    ranges = [column_range(run.q) for run in measurements.runs() if run.samples]
    travels = np.max([largest - smallest for smallest, largest in ranges], axis=0)
    # An encoder's last digit [rad, m].
    is_still = travels <= 1e-4
    is_silent = ~np.any(column_range(measurements.tau), axis=0)
    idle = {
        robot.joints[k].name: float(np.mean(measurements.q[:, k]))
        for k in np.flatnonzero(is_still & is_silent).tolist()
    }
    return idle if len(idle) < robot.n else {}


def far_outside(robot: Robot, q: np.ndarray) -> tuple[int, ...]:
    """Find joints that are farther outside their ranges than a wrong zero or a lost
    turn explains.

    That is one turn of a revolute joint, and twice the travel of a prismatic one. Of
    positions q (N, n) [rad, m] it returns the places of the joints, from 0.
    """
    largest = [
        math.tau if j.kind == "revolute" else 2.0 * (j.upper - j.lower)
        for j in robot.joints
    ]
    return tuple(np.flatnonzero(_beyond(robot, q) > largest).tolist())


def _place(run: Measurements, k: int) -> str:
    """Name sample k (from 0) of a run as the user finds it: "run.csv: row 7" in a CSV
    file, whose header is row 1, else "run.npz: sample 6"."""
    name = run.names[0]
    row = f"row {run.rows_of_file(k)}" if name.endswith(".csv") else f"sample {k + 1}"
    return f"{name}: {row}"


def check_torque(run: Measurements) -> None:
    """Refuse torque channels that hold no torque: zeros, or less than any arm needs.

    Raises
    ------
    InputError
        No channel exceeds a millionth of a newton metre.
    """
    if not run.torque_logged:
        return
    # No sensor resolves the first, and no arm of a gram and a centimetre needs as little
    # as the second [N m, N].
    zero = 1e-12
    threshold = 1e-6
    largest = 0.0
    has_numbers = False
    for _, part in iter_chunks(run.tau):
        sizes = np.abs(part)
        # What is no number is named row by row elsewhere.
        largest = max(largest, float(np.fmax.reduce(sizes, axis=None, initial=0.0)))
        has_numbers = has_numbers or not np.isnan(sizes).all()
    if run.samples and not has_numbers:
        return
    if not largest > zero:
        raise InputError(
            "every torque is zero", "log the torque, or the current", run.names[0]
        )
    if largest < threshold:
        what = f"no torque exceeds {largest:.2g} N m, less than any arm needs"
        raise InputError(what, "write torques in N m", run.names[0])


def is_in_ranges(robot: Robot, q: np.ndarray) -> bool:
    """Whether positions (N, n) [rad, m] lie in the joints' ranges, but for an encoder's
    zero."""
    return bool(np.all(_beyond(robot, q) <= ENCODER_ZERO))


def _beyond(robot: Robot, q: np.ndarray) -> np.ndarray:
    """Return how far positions (N, n) leave each joint's range (n,) [rad, m]; negative
    inside."""
    low, high = np.transpose([(j.lower, j.upper) for j in robot.joints])
    smallest, largest = column_range(q)
    return np.maximum(low - smallest, largest - high)


def radians_per_percent(
    robot: Robot, q: np.ndarray
) -> dict[int, tuple[float, float]] | None:
    """Return how positions (N, n) in per cent of each joint's range, -100 to 100, become
    radians.

    By the place of each revolute joint, from 0, it is radians per cent and the middle of
    the range [rad]; None where a position is beyond 100, or a joint has no range.
    """
    smallest, largest = column_range(q)
    farthest = np.maximum(largest, -smallest)
    out = dict[int, tuple[float, float]]()
    for j, joint in enumerate(robot.joints):
        if joint.kind != "revolute":
            continue
        half = 0.5 * (joint.upper - joint.lower)
        if not np.isfinite(half) or farthest[j] > LARGEST_PERCENT:
            return None
        out[j] = half / 100.0, 0.5 * (joint.upper + joint.lower)
    return out


def beside_range(robot: Robot, q: np.ndarray) -> tuple[int, ...]:
    """Find joints with a wrong zero: outside their ranges, but travelling no farther
    than these are long.

    Empty where more than half of the joints are outside, or one travels too far: then
    something else is wrong with all of them, such as the unit. Of positions q (N, n)
    [rad, m] it returns the places of the joints, from 0.
    """
    outside = np.flatnonzero(_beyond(robot, q) > ENCODER_ZERO)
    lengths = [joint.upper - joint.lower for joint in robot.joints]
    smallest, largest = column_range(q)
    fits = largest - smallest <= np.add(lengths, ENCODER_ZERO)
    are_few = len(outside) <= max(1, robot.n // 2)
    return tuple(outside.tolist()) if are_few and np.all(fits) else ()


def _check_derivative(robot: Robot, run: Measurements) -> None:
    """Raise RepairableError where q is 180 / pi times what dq says: it is in degrees, or,
    near 60, the clock is in minutes. Velocities in degrees do no harm: they are taken from
    the positions."""
    if run.dq is None or _has_possible_unit(run):
        return
    from sdp_vs_penalty.data.hypotheses.weighing import rate_from_velocities

    step = usual_step(run.t)
    for j in range(robot.n):
        rate = rate_from_velocities(run.q[:, [j]], run.dq[:, [j]])
        if rate is None or robot.joints[j].kind != "revolute" or not step > 0.0:
            continue  # noise, or a coarse encoder: nothing to conclude from
        ratio = 1.0 / (rate * step)
        if 2.0 / 3.0 < math.radians(ratio) < 1.5:  # within a factor of 1.5 of 180 / pi
            what = f"columns q{j + 1} and dq{j + 1} differ by a factor of {ratio:.3g}"
            change = "q from degrees to radians"
            if ratio > _BETWEEN_DEGREES_AND_MINUTES:
                change = f"t from minutes to seconds, or {change}"
            raise RepairableError(what, f"convert {change}", run.names[0])
