"""What an error depends on is named: the right joint, and the right cause.

The logs are of an arm that shares no code with the library (point_mass_arm).
"""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from point_mass_arm import PointMassArm, arm_problem

from sdp_vs_penalty import Problem, identify, where_it_fails
from sdp_vs_penalty.diagnosis import (
    CauseShares,
    JointFailure,
    dependences,
    held_out_share,
)

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
        state[k] = np.clip(
            state[k - 1] + step,
            -0.01,
            0.01,
        )
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


@pytest.fixture(scope="module")
def problem(tmp_path_factory: pytest.TempPathFactory) -> Problem:
    return arm_problem(Path(tmp_path_factory.mktemp("arm")))


def worst_joint(problem: Problem, arm: PointMassArm, seed: int) -> JointFailure:
    """The joint with most error over its noise, on a run of this seed."""
    run = arm.run(1, periods=2)
    effects = ["rigid_body", "viscous_friction", "coulomb_friction", "torque_offset"]
    model = identify(problem, run, "ols", effects=effects, check=False)
    judged = run if seed == 1 else arm.run(seed, periods=2)
    return where_it_fails(model, judged).worst_first[0]


@pytest.mark.parametrize(
    "kind",
    [
        "drag",
        "bent shaft",
        *(
            pytest.param(kind, marks=pytest.mark.long)
            for kind in KINDS
            if kind not in ("drag", "bent shaft")
        ),
    ],
)
def test_the_joint_and_the_cause_are_named(problem, kind):
    joint, torque, cause = KINDS[kind]
    worst = worst_joint(
        problem,
        PointMassArm(extra=on(joint, torque)),
        9,
    )
    assert (worst.joint, dependences(worst)[0][0]) == (joint, cause)


@pytest.mark.long
@pytest.mark.parametrize("seed", [1, 9])
def test_a_tilt_is_among_the_causes_that_data_do_not_tell_apart(problem, seed):
    """Also in the runs that the model was fitted to, where it has taken its part. The
    levers of this arm hardly change, so that the tilt is nearly a wave of joint 1."""
    worst = worst_joint(problem, PointMassArm(tilt=0.01), seed)
    assert worst.joint == 1
    assert "position of several joints" in worst.causes.equivalent_causes


#: By cause: shares of the error, and of what a refit would leave of it.
SHARES = {
    "reversal": (0.1, 0.5),
    "load": (0.4, 0.2),
    "time": (0.2, 0.49),
    "other joints": (0.3, 0.6),
}


@pytest.fixture
def causes() -> CauseShares:
    return CauseShares(
        of_error={name: error for name, (error, _) in SHARES.items()},
        beyond_model={name: beyond for name, (_, beyond) in SHARES.items()},
    )


def test_what_a_refit_would_take_ranks_no_cause(causes):
    assert causes.ranking[-1] == "load"


def test_causes_that_explain_the_same_are_one_set(causes):
    assert set(causes.equivalent_causes) == {"reversal", "time", "other joints"}


def test_the_whole_error_ranks_what_explains_the_same(causes):
    assert causes.ranking[:3] == ["other joints", "time", "reversal"]


def test_few_reversals_show_what_follows_them():
    """Columns that the data hardly determine predict with a ridge that fits them."""
    rng = np.random.default_rng(3)
    columns = rng.normal(size=(400, 30)) * np.geomspace(1.0, 1e-2, 30)
    error = columns[:, 0] + rng.normal(size=400)
    assert held_out_share(columns, error, np.arange(400) // 80) > 0.3
