"""A fault of calibration is likely only where no effect of the arm explains as much.

The logs are of an arm that shares no code with the library (point_mass_arm).
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from point_mass_arm import (
    PERIOD,
    RATE,
    Kinematics,
    PointMassArm,
    Trajectory,
    arm_problem,
    scaled,
)

from sdp_vs_penalty import Measurements
from sdp_vs_penalty.checks import EXPLANATION, check

Array = np.ndarray
#: What a fault of calibration is called: what is left unexplained is no fault.
NO_FAULT = ("unexplained torque", "poor excitation")
SEEDS = pytest.mark.parametrize("seed", [3, pytest.param(4, marks=pytest.mark.slow)])


@pytest.fixture(scope="module")
def problem(tmp_path_factory):
    return arm_problem(Path(tmp_path_factory.mktemp("arm")))


def faults_of(problem, run):
    """The faults of calibration that the check names."""
    [report] = check(problem, run)
    return [
        issue
        for issue in report.issues
        if issue.nature == EXPLANATION
        and issue.severity == "warning"
        and issue.kind not in NO_FAULT
    ]


def fast_run(arm, seed):
    """A log of a motion three times as fast: on a slow one the weight is nearly all,
    and a gain of joint 3 is the same as a coupling with joint 2."""
    drawn = Trajectory.draw(seed)
    trajectory = replace(drawn, harmonics=3 * drawn.harmonics)
    t = np.arange(round(2.0 * PERIOD * RATE)) / RATE
    torque = arm.channel(t, arm.torque(trajectory, t))
    rng = np.random.default_rng(seed)
    q = trajectory.at(t) + 1e-6 * rng.normal(size=torque.shape)
    return Measurements(t, q, torque + 0.05 * rng.normal(size=torque.shape))


def belt(ratio):
    """Motor 3 turns with joint 2 by a ratio: motor 2 lacks so much of its torque."""

    def channel(t, torque):
        out = torque.copy()
        out[:, 1] -= ratio * torque[:, 2]
        return out

    return channel


def friction_of_the_belts_motor(ratio):
    """Motor 3 turns by q3 + ratio q2, and so does its friction; motor 2 has none of it.

    It adds to the torques of the joints, by virtual work, what :func:`belt` makes
    friction of motor 3 alone.
    """

    def extra(t, q, dq):
        speed = dq[:, 2] + ratio * dq[:, 1]
        friction = 0.8 * speed + 1.5 * np.tanh(speed / 0.01)
        return np.column_stack([0.0 * friction, ratio * friction, friction])

    return extra


def pull(force, point):
    """Torque (N, 3) that holds a force [N] at a point of the last link [m]."""

    def extra(t, q, dq):
        arm = Kinematics.of(q)
        place = arm.place(2, point)
        return np.column_stack(
            [
                -np.cross(axis, place - origin) @ force
                for axis, origin in zip(arm.axis, arm.origin, strict=True)
            ]
        )

    return extra


@SEEDS
@pytest.mark.parametrize("ratio", [0.6, pytest.param(-0.7, marks=pytest.mark.long)])
@pytest.mark.parametrize("has_own_friction", [False, True])
def test_a_coupling_of_joints_makes_no_likely_fault(
    problem, ratio, has_own_friction, seed
):
    """Also with friction that no joint has by itself."""
    arm = PointMassArm(channel=belt(ratio))
    if has_own_friction:
        arm = replace(arm, extra=friction_of_the_belts_motor(ratio))
    faults = faults_of(problem, fast_run(arm, seed))
    assert not [f.what for f in faults if f.certainty.grade == "likely"]
    named = [name for f in faults for name in f.equivalents]
    assert not faults or "gears that couple joints 2 and 3" in named


@pytest.mark.long
@SEEDS
@pytest.mark.parametrize("force", [(15.0, 5.0, -10.0), (-4.0, 20.0, 6.0)])
def test_a_constant_force_makes_no_likely_fault(problem, force, seed):
    arm = PointMassArm(extra=pull(np.array(force), (0.3, 0.0, 0.0)))
    faults = faults_of(problem, fast_run(arm, seed))
    assert not [f.what for f in faults if f.certainty.grade == "likely"]


@SEEDS
@pytest.mark.parametrize("joint", [pytest.param(2, marks=pytest.mark.long), 3])
def test_a_wrong_gain_stays_likely(problem, joint, seed):
    gains = tuple(1.6 if k == joint else 1.0 for k in (1, 2, 3))
    faults = faults_of(problem, fast_run(PointMassArm(channel=scaled(gains)), seed))
    [fault] = faults
    assert (fault.kind, fault.figures["joints"]) == ("torque gain", [joint])
    assert fault.certainty.grade == "likely"


@SEEDS
def test_a_wrong_zero_is_never_a_coupling(problem, seed):
    run = fast_run(PointMassArm(), seed)
    q = run.q - np.array([0.0, 0.3, 0.0])
    [fault] = faults_of(problem, Measurements(run.t, q, run.tau))
    assert (fault.kind, fault.figures["joints"]) == ("encoder offset", [2])
    assert not [name for name in fault.equivalents if "gears" in name]
