"""Joint states that come in parts: halves of an arm, a gripper, efforts of another
topic, messages with empty fields; each joint's numbers go to that joint."""

import numpy as np
import pytest
from recorded import refusal
from small_runs import write_joint_states

from sdp_vs_penalty.data import read_run
from sdp_vs_penalty.errors import Remark

T = np.arange(60) * 0.01
_BEGIN, _SLOPE = np.random.default_rng(5).normal(size=(2, 3, 1, 3))


def channels_at(t):
    """q, dq and tau (3, N, 3) at instants t (N,): straight lines, which interpolation
    follows."""
    return _BEGIN + _SLOPE * np.asarray(t)[:, None]


Q, DQ, TAU = channels_at(T)
JOINTS = ("a", "b", "c")
STATES = "/joint_states"
TORQUES = "/joint_torques"


def read_bag(path, messages, **how):
    """What is read of a bag with these messages, in the order of their stamps."""
    write_joint_states(path / "bag", sorted(messages, key=lambda m: m[1]))
    return read_run(path / "bag", None, how.pop("names", JOINTS), **how)


def part(names, late=0.0, topic=STATES, effort=True):
    """The messages of some joints, ``late`` seconds after the others."""
    at = [JOINTS.index(name[-1]) for name in names.split()]
    q, dq, tau = channels_at(T + late)[:, :, at]
    for k, t in enumerate(T + late):
        yield topic, t, names.split(), q[k], dq[k], tau[k] if effort else []


def efforts(late=0.001):
    for t, tau in zip(T + late, channels_at(T + late)[2], strict=True):
        yield TORQUES, t, JOINTS, [], [], tau


def test_halves_of_an_arm_come_together(tmp_path):
    with pytest.warns(Remark, match="to the torque's stamps, from samples 2 ms away"):
        run = read_bag(tmp_path, [*part("c a"), *part("b", 0.002)])
    np.testing.assert_allclose(run.q, Q)
    np.testing.assert_allclose(run.tau, TAU)


def test_halves_on_two_topics_come_together(tmp_path):
    run = read_bag(tmp_path, [*part("a b"), *part("c", 0.002, "/right/joint_states")])
    np.testing.assert_allclose(run.q, Q)


def test_efforts_may_be_on_another_topic(tmp_path):
    run = read_bag(tmp_path, [*part("c a b", effort=False), *efforts()])
    q, dq, tau = channels_at(T + 0.001)
    np.testing.assert_allclose(run.t - run.t[0], T, atol=1e-9)
    np.testing.assert_allclose(run.q, q)
    np.testing.assert_allclose(run.dq, dq)
    np.testing.assert_array_equal(run.tau, tau)


def test_messages_with_empty_fields_are_counted(tmp_path):
    messages = [*part("a b c")]
    for k in range(7):
        messages[k] = (*messages[k][:5], [])
    with pytest.warns(Remark, match="7 messages with empty fields left out"):
        run = read_bag(tmp_path, messages)
    np.testing.assert_array_equal(run.q, Q[7:])


def test_messages_without_a_partner_are_counted(tmp_path):
    messages = [*part("a b"), *list(part("c", 0.001))[:50]]
    with pytest.warns(Remark, match="10 rows without all channels"):
        run = read_bag(tmp_path, messages)
    np.testing.assert_allclose(run.q, Q[:50])


def test_a_slow_joint_that_stands_still_costs_no_row(tmp_path):
    slow = [(STATES, t, ["finger"], [0.0], [0.0], [0.0]) for t in T[::9] + 0.001]
    run = read_bag(tmp_path, [*part("a b c"), *slow], names=(*JOINTS, "finger"))
    np.testing.assert_array_equal(run.q, np.column_stack([Q, np.zeros(60)]))


def test_prefixes_are_the_robot_s(tmp_path):
    both = [*part("left_a left_b left_c"), *part("right_c right_b right_a", 0.001)]
    names = ("right_a", "right_b", "right_c")
    expected = channels_at(T + 0.001)[0]
    np.testing.assert_array_equal(read_bag(tmp_path, both, names=names).q, expected)


def test_the_states_of_one_arm_of_two_say_how_to_hold_the_other(tmp_path):
    names = (*JOINTS, "other_a", "other_b", "other_c")
    held = "--hold other_a=0,other_b=0,other_c=0"
    refusal(lambda: read_bag(tmp_path, part("c a b"), names=names), held)


def test_one_prefix_need_not_be_named(tmp_path):
    run = read_bag(tmp_path, part("arm/c arm/b arm/a"))
    np.testing.assert_array_equal(run.q, Q)


def test_two_topics_that_hold_all_joints_are_asked_for(tmp_path):
    both = [*part("a b c"), *part("a b c", 0.001, "/filtered")]
    words = "convert", "--topic /filtered", "/filtered, /joint_states"
    refusal(lambda: read_bag(tmp_path, both), *words)


def test_without_any_effort_the_bag_is_refused(tmp_path):
    refusal(lambda: read_bag(tmp_path, part("a b c", effort=False)), "has effort")


def test_joints_may_change_their_order_from_message_to_message(tmp_path):
    orders = [np.random.default_rng(k).permutation(3) for k in range(len(T))]
    messages = [
        (STATES, t, [JOINTS[j] for j in at], Q[k, at], DQ[k, at], TAU[k, at])
        for k, (t, at) in enumerate(zip(T, orders, strict=True))
    ]
    run = read_bag(tmp_path, messages)
    np.testing.assert_array_equal(run.q, Q)
    np.testing.assert_array_equal(run.dq, DQ)
    np.testing.assert_array_equal(run.tau, TAU)
