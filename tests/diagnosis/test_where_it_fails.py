"""What an error depends on is named: the right joint, and the right cause.

The logs are of an arm that shares no code with the library (point_mass_arm).
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from point_mass_arm import COULOMB, VISCOUS, PointMassArm, Trajectory, delayed, scaled

from sdp_vs_penalty import Measurements, identify, where_it_fails
from sdp_vs_penalty.diagnosis import (
    CauseShares,
    Failures,
    JointFailure,
    dependences,
    held_out_share,
)
from sdp_vs_penalty.render import heat_rows
from sdp_vs_penalty.render.words import describe_failures

Array = np.ndarray
Torque = Callable[[Array, Array, Array], Array]


def on(joint, torque):
    """Torque of instants, positions and velocities on one joint (from 1)."""

    def extra(t, q, dq):
        out = np.zeros_like(q)
        out[:, joint - 1] = torque(t, q, dq)
        return out

    return extra


def direction(v):
    return np.tanh(v / 0.02)


#: What the model lacks: the joint (from 1), the torque on it, and its cause.
KINDS = {
    "drift": (2, lambda t, q, dq: 0.4 * (1 - np.exp(-t / 15)), "time"),
    "drag": (3, lambda t, q, dq: 0.25 * direction(dq[:, 1]), "other joints"),
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
}


def worst_joint(problem, arm, seed):
    """The joint with most error over its noise, on a run of this seed."""
    run = arm.run(1, periods=2)
    judged = run if seed == 1 else arm.run(seed, periods=2)
    return worst_of_runs(problem, run, judged)


def worst_of_runs(problem, run, judged):
    """The joint with most error over its noise, of a model of the first run."""
    effects = ["rigid_body", "viscous_friction", "coulomb_friction", "torque_offset"]
    model = identify(problem, run, "ols", effects=effects, check=False)
    return where_it_fails(model, judged).worst_first[0]


@pytest.mark.parametrize(
    "kind",
    [
        "drag",
        pytest.param("bent shaft", marks=pytest.mark.long),
        *(
            pytest.param(x, marks=pytest.mark.slow)
            for x in ("drift", "quadratic friction", "eccentricity")
        ),
    ],
)
def test_the_joint_and_the_cause_are_named(problem, kind):
    joint, torque, cause = KINDS[kind]
    worst = worst_joint(problem, PointMassArm(extra=on(joint, torque)), 9)
    assert (worst.joint, dependences(worst)[0][0]) == (joint, cause)


#: What the torque channels do, the joint whose channel does it, and its cause.
CHANNELS = {
    "late": (delayed(np.array([0.0, 0.01, 0.0])), 2, "late torque"),
    "wrong gain": (scaled((1.0, 1.0, 1.2)), 3, "modelled torque"),
}


@pytest.mark.parametrize("kind", CHANNELS)
def test_what_a_channel_does_is_a_cause(problem, kind):
    """Judged on the run of the identification, to which the model was fitted."""
    channel, joint, cause = CHANNELS[kind]
    run = PointMassArm(channel=channel).run(1, periods=2)
    worst = worst_of_runs(problem, run, run)
    assert (worst.joint, dependences(worst)[0][0]) == (joint, cause)


def test_a_gear_that_yields_is_seen_in_the_curvature_of_its_torque(problem):
    """The encoder is on the motor: it shows the link's angle plus torque / stiffness.

    Friction of the motor does not pass through the gear."""
    stiffness = np.array([400.0, np.inf, np.inf])
    noise = 0.03 * np.random.default_rng(5).normal(size=(4000, 3))
    t = np.arange(4000) / 200.0
    trajectory = Trajectory.draw(2)
    links = PointMassArm().torque(trajectory, t) - friction(trajectory.at(t), t)
    q = trajectory.at(t) + links / stiffness
    run = Measurements(t, q + 1e-5 * noise, links + friction(q, t) + noise)
    worst = worst_of_runs(problem, run, run)
    assert (worst.joint, dependences(worst)[0][0]) == (1, "yielding gear")


def friction(q, t):
    """Friction of the arm's motors at angles (N, 3)."""
    dq = np.gradient(q, t, axis=0)
    return VISCOUS * dq + COULOMB * PointMassArm().direction(q, dq)


@pytest.mark.long
@pytest.mark.parametrize("seed", [1, pytest.param(9, marks=pytest.mark.slow)])
def test_a_tilt_shows_as_a_function_of_positions(problem, seed):
    """Also in the runs that the model was fitted to, where it has taken its part. The
    levers of this arm hardly change, so that the tilt is nearly a wave of joint 1."""
    worst = worst_joint(problem, PointMassArm(tilt=0.01), seed)
    assert worst.joint == 1
    of_positions = {"position", "position in a turn", "position of several joints"}
    assert {*worst.causes.equivalent_causes} <= of_positions


#: By cause: shares of the error, and of what a refit would leave of it.
SHARES = {
    "reversal": (0.1, 0.5),
    "load": (0.4, 0.2),
    "time": (0.2, 0.49),
    "other joints": (0.3, 0.6),
}


@pytest.fixture
def causes():
    return CauseShares(
        of_error={name: error for name, (error, _) in SHARES.items()},
        beyond_refit={name: beyond for name, (_, beyond) in SHARES.items()},
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


def failure(joint, rmse, **fields):
    """A failure of a joint with a known error, whose noise floor is not known."""
    return JointFailure(joint, rmse, None, None, {}, 1.0, (), **fields)


#: Two joints' failures, the second of which is the worst: an error and what is known.
NAMED = {"held_out_shares": {"load": 0.5}, "shares_of_error": {"load": 0.5}}
SECOND_IS_WORST = {
    "by the torques, without a noise": (
        (2.0, {"torque": 100.0}),
        (0.5, {"torque": 1.0}),
    ),
    "about as bad, with a cause": (
        (5.0, {"noise_floor": 1.0, "held_out_shares": {"load": 0.0}}),
        (4.9, {"noise_floor": 1.0, **NAMED}),
    ),
}


@pytest.mark.parametrize("case", SECOND_IS_WORST)
def test_the_worst_joint_is_that_of_the_largest_error(case):
    both = [
        replace(failure(joint, error), **known)
        for joint, (error, known) in enumerate(SECOND_IS_WORST[case], start=1)
    ]
    assert Failures(both, ["N m", "N m"]).worst_first[0].joint == 2


def test_an_error_that_is_large_near_reversals_is_said_to_be():
    usual = replace(
        failure(1, 5.0), held_out_shares={"position": 0.4}, reversal_lift=4.0
    )
    text = Failures([usual], ["N m"])._repr_html_()
    assert "4 times as large as elsewhere" in " ".join(text.split())


@pytest.mark.parametrize(("share", "is_said"), [(0.3, False), (0.73, True)])
def test_an_error_that_other_parameters_would_remove_is_said_to_be(share, is_said):
    """More motion may help such a model before any effect does."""
    none = {"load": 0.0}
    one = replace(failure(1, 5.0), refit_share=share, held_out_shares=none)
    text = " ".join(describe_failures(Failures([one], ["N m"]), np.ones(1, bool)))
    said = "Other values of the model's parameters would remove 73 % of the error"
    assert (said in text) == is_said


def test_a_model_of_little_motion_errs_where_its_parameters_do(problem):
    """Identified on a second and a half, it errs by its parameters elsewhere."""
    arm = PointMassArm()
    run = arm.run(1, periods=2)
    first_seconds = run.rows(run.t < run.t[0] + 1.5)
    worst = worst_of_runs(problem, first_seconds, arm.run(2, periods=2))
    assert worst.goes_with_a_refit


def test_joints_that_differ_by_less_than_their_noise_is_known_are_a_tie():
    errors = [1.0, 5.0, 4.6]
    failures = [failure(k, e) for k, e in enumerate(errors, start=1)]
    assert Failures(failures, ["N m"] * 3).equally_bad == [2, 3]


@pytest.mark.parametrize("beyond", [0.004, 0.2], ids=["of the error", "beyond a refit"])
def test_words_map_and_table_show_the_same_share(beyond):
    """ "Depends most on position in a turn (25 %)" stood beside a blank map (0.4 %)."""
    one = replace(
        failure(1, 5.0),
        shares_of_error={"position in a turn": 0.25},
        held_out_shares={"position in a turn": beyond},
    )
    shown = one.shares["position in a turn"]
    assert shown == (0.25 if beyond < 0.05 else 0.2)
    (line,) = describe_failures(Failures([one], ["N m"]), np.ones(1, bool))
    assert f"position in a turn ({100.0 * shown:.0f} %)" in line
    assert heat_rows([one], {}) == [("position in a turn", [shown])]
    assert one.numbers()["position in a turn [%]"] == 100.0 * shown
