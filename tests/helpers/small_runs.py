"""Small simulated measurements, sound and absurd, and as files: for tests of readers
and of verbs."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from sdp_vs_penalty import Measurements, identify, load_problem
from sdp_vs_penalty.data import save
from sdp_vs_penalty.effects import Motion
from sdp_vs_penalty.signals import Preprocessing


def small_run(problem, seconds=6.0, seed=0, rate=100.0, reach=1.0, noise=0.05):
    """A run of sums of sines by the problem's nominal robot with some friction and
    noise; reach : factor of the amplitudes; noise : its standard deviation [N m]."""
    rng = np.random.default_rng(seed)
    n = problem.robot.n
    t = np.arange(0.0, seconds, 1.0 / rate)
    q, dq, ddq = (np.zeros((len(t), n)) for _ in range(3))
    for frequency in (0.3, 0.5, 0.8):
        amplitude = reach * rng.uniform(0.1, 0.3, n)
        phase = rng.uniform(-np.pi, np.pi, n)
        w = 2.0 * np.pi * frequency
        q += amplitude * np.sin(w * t[:, None] + phase)
        dq += amplitude * w * np.cos(w * t[:, None] + phase)
        ddq -= amplitude * w**2 * np.sin(w * t[:, None] + phase)
    model = problem.model()
    theta = problem.nominal(model)
    theta[len(model.rigid_indices) :] = 0.5
    tau = model.torque(theta, Motion(t, q, dq, ddq))
    return Measurements(t, q, tau + noise * rng.normal(size=tau.shape), dq)


def thinned(made, step=10):
    """Simulated runs of which every so many of a thousand samples a second are kept:
    few tests need more."""
    runs = tuple(run.rows(slice(None, None, step)) for run in made.runs)
    return replace(made, runs=runs)


@cache
def small_model(method="lmi-sdp"):
    """The model of a small run of the two links: made once, and nobody changes it."""
    problem = load_problem("two_link")
    return identify(problem, small_run(problem), method, check=False)


def write_run(path, problem, seconds=6.0, seed=0):
    save(small_run(problem, seconds, seed), path)
    return path


def write_bag(
    path,
    run,
    *,
    mcap=False,
    no_stamps=False,
    no_effort=False,
    names=("c", "a", "b"),
    topics=("/joint_states",),
):
    """A ROS 2 bag as a driver records it: joints in its own order, a gripper on the
    same topic. Of several topics the k-th one's positions are larger by k."""
    order = np.roll(np.arange(run.n), 1)
    messages = []
    for k, t in enumerate(run.t):
        velocity = () if run.dq is None else run.dq[k, order]
        effort = () if no_effort else run.tau[k, order]
        for number, topic in enumerate(topics):
            position = run.q[k, order] + number
            messages.append((topic, t, ["finger"], [0.0], [0.0], [0.0]))
            messages.append((topic, t, names, position, velocity, effort))
    write_joint_states(path, messages, mcap, no_stamps)


#: Numbers that overflow, underflow or are none; and odd ones that a reader lets pass.
WILD = (
    0.0,
    -0.0,
    5e-324,
    1e-300,
    1e-160,
    1e16,
    1e100,
    1e160,
    1e300,
    np.inf,
    -np.inf,
    np.nan,
)
ODD = (0.0, -0.0, 5e-324, 1e-160, 1e-31, 1e-29, 1e-15, 1e3, 1e6, 9e8, -9e8)


@np.errstate(all="ignore")
def hostile_log(seed):
    """A small run in which one to four things are absurd: numbers, stamps, gaps,
    constant channels."""
    rng = np.random.default_rng(seed)
    run = small_run(
        load_problem("two_link"), seconds=float(rng.uniform(1.0, 6.0)), seed=seed % 7
    )
    wild = rng.random() < 0.5
    for _ in range(int(rng.integers(1, 5))):
        name = str(rng.choice(["t", "q", "dq", "tau"]))
        values = getattr(run, name)
        if values is None:
            continue
        values = values.copy()
        begin = int(rng.integers(len(values)))
        rows = slice(begin, begin + int(rng.choice([1, 1, 3, 50, len(values)])))
        deed = int(rng.integers(5))
        if deed == 0:
            values[rows] = rng.choice(WILD if wild else ODD)
        elif deed == 1:
            factors = (
                [0.0, 1e-300, 1e-12, 1e12, 1e150, 1e300]
                if wild
                else [0.0, 1e-29, 1e-9, 1e3, 1e7]
            )
            values *= float(rng.choice(factors))
        elif deed == 2:
            values[rows] = values[begin]
        elif deed == 3:
            values[rows] = np.sort(values[rows], axis=0)[::-1]
        else:
            values = values + rng.choice(
                [1e9, 1e15, -1e300] if wild else [1e-12, 1.0, -1e8]
            )
        run = replace(run, **{name: values})
    return run


SETTINGS = Preprocessing(5.0, 8.0)
JOINTS = 4


def periodic(rng, t, period, joints=3):
    """Five harmonics a joint (N, joints)."""
    w = 2.0 * np.pi / period * np.arange(1, 6)
    a, b = rng.normal(size=(2, joints, 5)) / np.arange(1, 6)
    return np.sin(np.outer(t, w)) @ a.T + np.cos(np.outer(t, w)) @ b.T


def run_of(seed, seconds, first=0.0, period=9.63, dt=4e-3, still=0.0):
    """Five harmonics a joint in other units each, encoder noise; it stands ``still``
    seconds at first.

    The motion depends on the seed's tens only, the noise on all of it. The last joint
    does not move.
    """
    t = np.arange(0.0, still + seconds, dt)
    clock = np.maximum(t - still, 0.0) + first
    q = periodic(np.random.default_rng(seed // 10), clock, period, JOINTS)
    q = q * [1.0, 0.3, 2.0, 0.0] + [0.0, 1.0, -3.0, 0.7]
    q += 1e-4 * np.random.default_rng(seed).normal(size=q.shape)
    return Measurements(t, q, np.ones_like(q), names=(f"run {seed}",))


def write_joint_states(path, messages, mcap=False, no_stamps=False):
    """A ROS 2 bag of messages (topic, t [s], names, position, velocity, effort), each
    of the last three perhaps empty; the recorder is late by another time each, where
    stamps tell."""
    pytest.importorskip("rosbags")
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    kind = "sensor_msgs/msg/JointState"
    state = store.types[kind]
    header = store.types["std_msgs/msg/Header"]
    stamp = store.types["builtin_interfaces/msg/Time"]
    plugin = StoragePlugin.MCAP if mcap else StoragePlugin.SQLITE3
    with Writer(path, version=9, storage_plugin=plugin) as writer:
        connections = {}
        for number, (topic, t, names, *fields) in enumerate(messages):
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=store)
            at = round(t * 1e9) + 1_700_000_000 * 10**9
            stated = 0 if no_stamps else at
            head = header(stamp(sec=stated // 10**9, nanosec=stated % 10**9), "")
            message = state(head, list(names), *(np.array(x, float) for x in fields))
            late = 0 if no_stamps else 1000 * (number // 2 % 3)
            raw = store.serialize_cdr(message, kind)
            writer.write(connections[topic], at + late, raw)
