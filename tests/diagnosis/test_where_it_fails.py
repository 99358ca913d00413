"""What an error depends on is named: the right joint, and the right cause.

The logs are of an arm that shares no code with the library (point_mass_arm).
"""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from point_mass_arm import PointMassArm, arm_problem

from sdp_vs_penalty import Problem, identify, where_it_fails
from sdp_vs_penalty.diagnosis import dependences

Array = np.ndarray
Torque = Callable[[Array, Array, Array], Array]


def on(joint: int, torque: Torque) -> Torque:
    """Torque of instants, positions and velocities on one joint (from 1)."""

    def extra(t: Array, q: Array, dq: Array) -> Array:
        out = np.zeros_like(q)
        out[:, joint - 1] = torque(t, q, dq)
        return out

    return extra


def play(t: Array, q: Array, dq: Array) -> Array:
    """What pushes through a play of 0.02 rad: it follows the travel since a reversal."""
    state = np.zeros(len(q))
    for k, step in enumerate(np.diff(q[:, 1]), start=1):
        state[k] = np.clip(state[k - 1] + step, -0.01, 0.01)
    return 60.0 * state


def direction(v: Array) -> Array:
    return np.tanh(v / 0.02)


#: What the model lacks: the joint (from 1), the torque on it, and its cause.
KINDS = {
    "drift": (2, lambda t, q, dq: 0.4 * (1 - np.exp(-t / 15)), "time"),
    "drag": (3, lambda t, q, dq: 0.25 * direction(dq[:, 1]), "other joints"),
    "hum": (2, lambda t, q, dq: 0.1 * np.sin(2 * np.pi * 4.3 * t), "hum"),
    "bent shaft": (
        2,
        lambda t, q, dq: 0.4 * q[:, 1] * direction(dq[:, 1]),
        "position and direction",
    ),
    "quadratic friction": (
        2,
        lambda t, q, dq: 0.5 * dq[:, 1] * np.abs(dq[:, 1]),
        "velocity",
    ),
    "eccentricity": (
        2,
        lambda t, q, dq: 0.5 * np.sin(3.0 * q[:, 1] + 0.3),
        "position in a turn",
    ),
    "backlash": (2, play, "reversal"),
}


#: What is not reached: the joint is right, another cause comes first.
OTHER_JOINTS = "the motion of other joints is named before the position in a turn"
ONE_POSITION = "in the training run a position of one joint takes the tilt's place"
MISSED = {"eccentricity": [pytest.mark.xfail(reason=OTHER_JOINTS)]}


@pytest.fixture(scope="module")
def problem(tmp_path_factory: pytest.TempPathFactory) -> Problem:
    return arm_problem(Path(tmp_path_factory.mktemp("arm")))


def named(problem: Problem, arm: PointMassArm, seed: int) -> tuple[int, str]:
    """The joint with most error over its noise, and the likeliest cause."""
    run = arm.run(1, periods=2)
    effects = ["rigid_body", "viscous_friction", "coulomb_friction", "torque_offset"]
    model = identify(problem, run, "ols", effects=effects, check=False)
    judged = run if seed == 1 else arm.run(seed, periods=2)
    failures = where_it_fails(model, judged)
    worst = max(failures, key=lambda f: f.rmse / (f.noise_floor or 1.0))
    return worst.joint, dependences(worst)[0][0]


@pytest.mark.parametrize(
    "kind",
    [
        "drag",
        "bent shaft",
        *(
            pytest.param(kind, marks=[pytest.mark.long, *MISSED.get(kind, [])])
            for kind in KINDS
            if kind not in ("drag", "bent shaft")
        ),
    ],
)
def test_the_joint_and_the_cause_are_named(problem, kind):
    joint, torque, cause = KINDS[kind]
    assert named(problem, PointMassArm(extra=on(joint, torque)), 9) == (joint, cause)


@pytest.mark.long
@pytest.mark.parametrize(
    "seed",
    [pytest.param(1, marks=pytest.mark.xfail(reason=ONE_POSITION)), 9],
)
def test_a_tilt_is_a_function_of_several_positions(problem, seed):
    """Also in the runs that the model was fitted to, where it has taken its part."""
    arm = PointMassArm(tilt=0.01)
    assert named(problem, arm, seed) == (1, "position of several joints")
