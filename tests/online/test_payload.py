"""Payloads from streams: picked up, weighed, put down, and no alarm without one; the
node of docs/online.md."""

import re
import runpy
import sys
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from types import ModuleType, SimpleNamespace
from xml.etree import ElementTree

import numpy as np
import pytest
from numpy.testing import assert_allclose
from unchecked import identify

from sdp_vs_penalty import (
    Estimate,
    InputError,
    Measurements,
    PayloadEstimator,
    export,
    load_problem,
)
from sdp_vs_penalty.data import save
from sdp_vs_penalty.online import PayloadChange, PayloadNow, PayloadPrior, ResidualNoise
from sdp_vs_penalty.problem import measured_runs
from sdp_vs_penalty.robot import inertia, random_trajectory
from sdp_vs_penalty.simulation import LEVELS
from sdp_vs_penalty.simulation.hidden_runs import hidden_runs

#: Samples a second.
RATE = 200.0


def thinned(run, rate):
    """A run at a lower rate, its clock from zero."""
    step = round(1.0 / (rate * float(np.median(np.diff(run.t)))))
    return Measurements(
        run.t[::step] - run.t[0], run.q[::step], run.tau[::step], names=run.names
    )


@dataclass
class SimulatedPicks:
    """An estimate of a simulated arm, the runs that it is from, a run for the noise, and
    one motion without and with a payload of ``mass`` [kg]."""

    estimate: Estimate
    training: list[Measurements]
    calibration: Measurements
    bare: Measurements
    loaded: Measurements
    mass: float
    com: np.ndarray

    def stream(self, *changes):
        """The motion, its load changed at these instants [s], bare at first."""
        t = self.bare.t
        is_loaded = np.searchsorted(changes, t, side="right") % 2 == 1
        tau = np.where(is_loaded[:, None], self.loaded.tau, self.bare.tau)
        return replace(self.bare, tau=tau)


def simulated_picks(name, mass, seed, rate=RATE):
    """Of a built-in arm, at a rate [1/s], with friction and noise of the simulator's
    own."""
    made = _at_a_thousand_hertz(name, mass, seed)
    return replace(
        made,
        training=[thinned(run, rate) for run in made.training],
        calibration=thinned(made.calibration, rate),
        bare=thinned(made.bare, rate),
        loaded=thinned(made.loaded, rate),
    )


@cache
def _at_a_thousand_hertz(name, mass, seed):
    """As it is simulated."""
    problem = load_problem(name)
    clean = hidden_runs(problem, [], seed=seed)
    load = [("payload", [])]
    small = hidden_runs(problem, load, "strong", seed, 1, clean.world)
    level = LEVELS["strong"] * mass / small.truth["effects"][0]["size"]
    heavy = hidden_runs(problem, load, level, seed, world=clean.world)
    (truth,) = heavy.truth["effects"]
    frame = problem.robot.tree[-1].link_frame  # the truth is in the joint's frame
    com = np.linalg.solve(frame, [*truth["details"]["com"], 1.0])[:3]
    *training, calibration, bare = clean.runs
    return SimulatedPicks(
        identify(problem, [thinned(run, RATE) for run in training]),
        training,
        calibration,
        bare,
        heavy.runs[3],
        truth["size"],
        com,
    )


def play(estimator, run):
    """All changes that a run brings to light."""
    changes = [
        estimator.update(t, q, tau)
        for t, q, tau in zip(run.t, run.q, run.tau, strict=True)
    ]
    return [change for change in changes if change is not None]


@cache
def carried(name, mass, seed=5):
    """A robot that picks up a mass [kg]."""
    return simulated_picks(name, mass, seed)


#: Robots, and the mass that each picks up [kg]; the second is picked up for real below.
PANDA = ("panda", 1.2)
ARMS = [
    pytest.param(PANDA, id="panda"),
    pytest.param(("ur10e", 3.0), id="ur10e", marks=pytest.mark.long),
]
#: Of what may depend on the robot; the rest is asked of the first alone.
EVERY_ARM = pytest.mark.parametrize("arm", ARMS, indirect=True, scope="module")


@pytest.fixture(scope="module")
def arm(request):
    return carried(*getattr(request, "param", PANDA))


@pytest.fixture(scope="module")
def noise(arm):
    return PayloadEstimator.calibrated(arm.estimate, arm.calibration, RATE).noise


@pytest.fixture
def estimator(arm, noise):
    return PayloadEstimator(arm.estimate, noise, RATE)


@dataclass(frozen=True)
class Replay:
    """A stream that was played once: its changes, and the payload at instants [s]."""

    changes: list[PayloadChange]
    payloads: dict[float, PayloadNow]


#: Instants at which a payload is looked at, by the instant of its pick [s].
INSTANTS = {4.0: (4.5, 6.0, 8.0, 10.0), 9.5: (10.0,), 13.2: (13.7,)}
#: A stream begins so long before its first pick [s]: filters and offsets have settled.
LEAD = 3.0


@pytest.fixture(scope="module")
def picked(arm, noise):
    """Of the instant of a pick [s] the stream with it, which ends at the last instant
    at which a payload is looked at."""

    @cache
    def played(at):
        estimator = PayloadEstimator(arm.estimate, noise, RATE)
        stream = arm.stream(at)
        replay = Replay([], {})
        begin = at - LEAD
        for end in INSTANTS[at]:
            is_new = (stream.t >= begin) & (stream.t < end)
            replay.changes.extend(play(estimator, stream.rows(is_new)))
            assert estimator.payload is not None
            replay.payloads[end] = estimator.payload
            begin = end
        return replay

    return played


#: The pick that is carried for long is looked at in any run.
EVERY_PICK = pytest.mark.parametrize(
    "at", [4.0, *(pytest.param(x, marks=pytest.mark.long) for x in (9.5, 13.2))]
)


@EVERY_ARM
@EVERY_PICK
def test_a_pick_is_dated_and_weighed(picked, at):
    (change,) = picked(at).changes
    assert change.kind == "picked up"
    assert change.time == pytest.approx(at, abs=0.03)
    lower, upper = change.time_interval
    assert lower <= at + 0.02
    assert upper >= at - 0.02
    assert change.detected - at < 0.5


@EVERY_ARM
@EVERY_PICK
def test_the_mass_is_within_its_interval_half_a_second_later(arm, picked, at):
    payload = picked(at).payloads[at + 0.5]
    lower, upper = payload.mass_interval
    assert lower <= arm.mass <= upper
    assert upper - lower < 0.5 * arm.mass


def test_mass_and_centre_of_a_payload_that_is_carried_for_a_while(arm, picked):
    payload = picked(4.0).payloads[10.0]
    assert payload.mass == pytest.approx(arm.mass, rel=0.03)
    assert_allclose(payload.com, arm.com, atol=0.02)


def test_what_is_published_is_consistent_and_certified(picked):
    payload = picked(4.0).payloads[6.0]
    assert inertia.consistency_margin(payload.theta) >= 0.0
    assert payload.gap <= 1e-4


@EVERY_ARM
def test_a_payload_is_put_down(arm, estimator):
    changes = play(estimator, arm.stream(4.0, 9.0).window(4.0 - LEAD, 10.5))
    assert [x.kind for x in changes] == ["picked up", "put down"]
    assert changes[1].time == pytest.approx(9.0, abs=0.05)
    assert changes[1].mass == pytest.approx(arm.mass, rel=0.05)
    assert estimator.payload is None


@EVERY_ARM
@pytest.mark.parametrize("end", [6.0, pytest.param(np.inf, marks=pytest.mark.long)])
def test_a_motion_without_a_pick_raises_no_alarm(arm, estimator, end):
    """Its first seconds, and all of it."""
    assert play(estimator, arm.bare.rows(arm.bare.t < end)) == []
    assert estimator.payload is None


def offset_rises(arm, run):
    """An offset of 0.2 % of the torque, and a tenth of it against the motion (N, n)."""
    size = 0.002 * np.std(run.tau, axis=0)
    dq = np.gradient(run.q, run.t, axis=0)
    return size - 0.1 * size * np.tanh(dq / 0.05)


def friction_of(arm, run):
    """Friction (N, n): the part of the torque that turns round with the motion."""
    dq = np.gradient(run.q, run.t, axis=0)
    ddq = np.gradient(dq, run.t, axis=0)
    forwards = arm.estimate.predict(run.q, dq, ddq, run.t)
    backwards = arm.estimate.predict(run.q, -dq, ddq, run.t)
    return 0.5 * (forwards - backwards)


def friction_falls(arm, run):
    """A tenth of the friction less (N, n)."""
    return -0.1 * friction_of(arm, run)


def friction_rises(arm, run):
    """A tenth of the friction more (N, n)."""
    return 0.1 * friction_of(arm, run)


DRIFTS = (offset_rises, friction_falls, friction_rises)


def drifting(arm, run, drift):
    """A run over which a torque (N, n) grows from nothing to its full size."""
    share = (run.t - run.t[0]) / (run.t[-1] - run.t[0])
    return replace(run, tau=run.tau + share[:, None] * drift(arm, run))


@EVERY_ARM
def test_friction_that_falls_is_no_payload(arm, estimator):
    run = arm.bare.window(0.0, 10.0)
    assert play(estimator, drifting(arm, run, friction_falls)) == []


@pytest.mark.long
@pytest.mark.parametrize(("k", "drift"), [(0, friction_rises), (1, offset_rises)])
def test_slow_drift_on_other_motions_is_no_payload(arm, estimator, drift, k):
    run = arm.training[k].window(0.0, 10.0)
    assert play(estimator, drifting(arm, run, drift)) == []


@pytest.mark.parametrize(
    ("drift", "seed"),
    [
        pytest.param(drift, seed, marks=mark)
        for drift, seed, mark in zip(
            DRIFTS,
            (5, 6, 7),
            (pytest.mark.long, pytest.mark.slow, pytest.mark.slow),
            strict=True,
        )
    ],
)
def test_slow_drift_of_other_arms_is_no_payload(drift, seed):
    """Twenty seconds on four motions of each arm, that of the noise among them."""
    arm = carried("ur10e", 3.0, seed)
    noise = PayloadEstimator.calibrated(arm.estimate, arm.calibration, RATE).noise
    alarms = []
    for run in (*arm.training, arm.calibration, arm.bare):
        estimator = PayloadEstimator(arm.estimate, noise, RATE)
        alarms += play(estimator, drifting(arm, run, drift))
    assert alarms == []


def test_a_light_pick_while_friction_drifts_is_weighed(arm, estimator):
    """A third of the payload, picked up at 4 s; friction is 7 % off by then."""
    run = arm.bare.window(0.0, 6.0)
    added = (arm.loaded.tau - arm.bare.tau)[: len(run.t)] / 3.0
    picked = replace(run, tau=run.tau + (run.t >= 4.0)[:, None] * added)
    (change,) = play(estimator, drifting(arm, picked, friction_falls))
    lower, upper = estimator.payload.mass_interval
    assert change.time == pytest.approx(4.0, abs=0.05)
    assert lower <= arm.mass / 3.0 <= upper


@pytest.mark.long
def test_an_estimator_that_holds_friction_takes_its_drift_for_a_payload(arm, noise):
    """What the drift's columns prevent: the streams above are no easy ones."""
    estimator = PayloadEstimator(arm.estimate, noise, RATE, drift=0.0)
    run = arm.training[0].window(0.0, 10.0)
    assert play(estimator, drifting(arm, run, friction_falls)) != []


@pytest.mark.long
def test_late_and_missing_samples_change_little(arm, estimator, picked):
    """A loop that loses every tenth sample, its clock off by a tenth of a period."""
    run = arm.stream(4.0).window(4.0 - LEAD, 8.0)
    rng = np.random.default_rng(0)
    rows = np.flatnonzero(rng.random(len(run.t)) > 0.1)
    late = run.t + 0.1 / RATE * rng.random(len(run.t))
    q, tau = [
        np.column_stack([np.interp(late, run.t, x) for x in signal.T])
        for signal in (run.q, run.tau)
    ]
    loose = Measurements(late[rows], q[rows], tau[rows])
    play(estimator, loose)
    undisturbed = picked(4.0).payloads[8.0]
    assert estimator.payload.mass == pytest.approx(undisturbed.mass, rel=0.02)


def test_a_gap_starts_the_filters_anew(arm, estimator):
    run = arm.stream(4.0).window(4.0 - LEAD, 8.5)
    lost = (run.t > 6.0) & (run.t < 7.0)
    rest = Measurements(run.t[~lost], run.q[~lost], run.tau[~lost])
    assert [x.kind for x in play(estimator, rest)] == ["picked up"]


BAD = {
    "not finite": lambda e, t, q, tau: e.update(t, q * np.nan, tau),
    "runs back": lambda e, t, q, tau: e.update(t - 1.0, q, tau),
    "joints": lambda e, t, q, tau: e.update(t + 0.1, q[:-1], tau),
}


@pytest.mark.parametrize("what", BAD)
def test_a_sample_that_cannot_be_used_is_refused(arm, estimator, what):
    run = arm.bare
    estimator.update(run.t[0], run.q[0], run.tau[0])
    with pytest.raises(InputError, match=what):
        BAD[what](estimator, run.t[0], run.q[0], run.tau[0])


def test_a_calibration_that_is_too_short_is_refused(arm):
    with pytest.raises(InputError, match="too short"):
        PayloadEstimator.calibrated(arm.estimate, arm.bare.window(0.0, 0.5), RATE)


def test_a_calibration_in_which_a_joint_hardly_moves_is_refused(arm):
    """Half a second of motion gives no correlation time of its residuals."""
    run = arm.bare
    middle = len(run.t) // 2
    is_moving = np.abs(run.t - run.t[middle]) < 0.25
    q = run.q.copy()
    q[~is_moving, 0] = q[middle, 0]
    with pytest.raises(InputError, match="joint 1"):
        PayloadEstimator.calibrated(arm.estimate, replace(run, q=q), RATE)


def test_an_update_keeps_no_memory(arm, estimator):
    """A hundred updates of a carried payload leave nothing behind."""
    import tracemalloc

    run = arm.stream(4.0).window(4.0 - LEAD, 5.5)
    rows = list(zip(run.t.tolist(), run.q, run.tau, strict=True))
    for row in rows[:750]:
        estimator.update(*row)
    tracemalloc.start()
    before, _ = tracemalloc.get_traced_memory()
    tracemalloc.reset_peak()
    for row in rows[750:850]:
        estimator.update(*row)
    after, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert after - before < 4096
    assert peak - before < 16384


def with_ball(path, mass, com, radius):
    """Hang a ball on the last body of a MuJoCo file."""
    tree = ElementTree.parse(path)
    *_, last = tree.getroot().iter("body")
    body = ElementTree.SubElement(last, "body", name="ball")
    body.set("pos", " ".join(map(str, com)))
    moment = 0.4 * mass * radius**2
    ElementTree.SubElement(
        body,
        "inertial",
        pos="0 0 0",
        mass=str(mass),
        diaginertia=f"{moment} {moment} {moment}",
    )
    tree.write(path)


@pytest.fixture(scope="module")
def exact():
    """Of the Panda's frictionless arm; MuJoCo's file has its links."""
    return carried("panda", 1.2).estimate


def mujoco_torque(path, estimate, states):
    from dynamics_files import by_mujoco

    return by_mujoco(path, estimate.robot, *states)


def test_torques_of_mujoco_are_weighed_as_well(exact, tmp_path):
    """The pick's torque is MuJoCo's own inverse dynamics of a body that hangs on the
    last link: nothing of it is ours."""
    pytest.importorskip("mujoco", minversion="3.0")
    path = tmp_path / "arm.xml"
    export(exact, path)
    t = np.arange(0.0, 6.0, 1.0 / RATE)
    states = random_trajectory(exact.robot, 11, 6.0).states(t)
    bare = mujoco_torque(path, exact, states)
    mass = 1.2
    com = np.array([0.02, -0.03, 0.15])
    with_ball(path, mass, com, 0.05)
    added = mujoco_torque(path, exact, states) - bare
    noise = ResidualNoise(
        0.01 * np.abs(bare).max(axis=0), 0.1, 1.0, np.abs(states[2]).max(axis=0)
    )
    own = exact.predict(*states, t)
    rng = np.random.default_rng(0)
    tau = own + (t > 2.0)[:, None] * added + rng.normal(size=own.shape) * noise.std
    estimator = PayloadEstimator(exact, noise, RATE, drift=0.0)
    (change,) = play(estimator, Measurements(t, states[0], tau))
    payload = estimator.payload
    assert change.time == pytest.approx(2.0, abs=0.05)
    assert payload.mass == pytest.approx(mass, abs=3.0 * payload.mass_std)
    assert payload.mass == pytest.approx(mass, rel=0.03)
    assert_allclose(payload.com, com, atol=0.01)
    assert (np.abs(payload.com - com) <= 3.0 * payload.com_std).all()
    assert (payload.com_std < 0.02).all()


@pytest.fixture(scope="module")
def ur10e_runs(data_folder):
    return {run.names[0][9:]: run for run in measured_runs("ur10e").values()}


@pytest.fixture(scope="module")
def ur10e(ur10e_runs):
    """Estimators of the arm and gains of one trajectory, with the noise of another."""
    loads = [(ur10e_runs["19_14harm50secLoad"], 2.805)]
    run = ur10e_runs["19_14harm50sec"]
    estimate = identify("ur10e", run, known_loads=loads)
    noise = PayloadEstimator.calibrated(
        estimate, ur10e_runs["12-50sec_12harm"], 100.0
    ).noise
    return lambda: PayloadEstimator(estimate, noise, 100.0)


@pytest.mark.long
@pytest.mark.real_data
def test_the_real_load_is_picked_up(ur10e, ur10e_runs):
    """Ten picks in a trajectory that nothing was made from: each is dated, and 95 %
    intervals half a second later hold the mass at least eight times."""
    from picks.pick_runs import splice

    bare = ur10e_runs["19_15harm50sec"]
    loaded = ur10e_runs["19_15harm50secLoad"]
    n_within = 0
    for at in range(6, 46, 4):
        estimator = ur10e()
        run = splice(bare, loaded, at).window(at - LEAD, at + 0.5)
        (change,) = play(estimator, run)
        assert change.kind == "picked up"
        assert change.time == pytest.approx(at, abs=0.05)
        lower, upper = estimator.payload.mass_interval
        n_within += lower <= 2.805 <= upper
    assert n_within >= 8


#: Real motion of the bare arm: along harmonics, of one joint, from point to point.
MOTIONS = ("19_15harm50sec", "12-50sec_12harm", "22-joint_2", "17-ptp_10_points")


@pytest.mark.real_data
@pytest.mark.parametrize(
    "name",
    [MOTIONS[0], *(pytest.param(x, marks=pytest.mark.long) for x in MOTIONS[1:])],
)
def test_real_motion_without_a_load_raises_no_alarm(ur10e, ur10e_runs, name):
    assert play(ur10e(), ur10e_runs[name].window(0.0, 10.0)) == []


@pytest.mark.real_data
@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=pytest.mark.slow if k else pytest.mark.long)
        for k, name in enumerate(MOTIONS)
    ],
)
def test_fifty_seconds_without_a_load_raise_no_alarm(ur10e, ur10e_runs, name):
    assert play(ur10e(), ur10e_runs[name]) == []


def test_the_prior_says_how_heavy_a_payload_may_be():
    prior = PayloadPrior(mass=10.0, reach=0.5)
    assert prior.information[0, 0] == pytest.approx(0.01)


#: What online.md shows, and its node.
DOCS = Path(__file__).parents[2] / "docs"


class PlayedNode:
    """What the page's node uses of rclpy's."""

    def __init__(self, name):
        self.said = []
        self.messages = []

    def create_publisher(self, kind, topic, depth):
        return SimpleNamespace(publish=self.messages.append)

    def create_subscription(self, kind, topic, callback, depth):
        assert topic == "joint_states"

    def get_logger(self):
        return SimpleNamespace(info=self.said.append)


def inertia_message(header):
    inertia = SimpleNamespace(m=0.0, com=SimpleNamespace())
    return SimpleNamespace(header=header, inertia=inertia)


def play_ros(monkeypatch):
    modules = {
        "rclpy": {},
        "rclpy.node": {"Node": PlayedNode},
        "geometry_msgs": {},
        "geometry_msgs.msg": {"InertiaStamped": inertia_message},
        "sensor_msgs": {},
        "sensor_msgs.msg": {"JointState": SimpleNamespace},
    }
    for name, content in modules.items():
        module = ModuleType(name)
        vars(module).update(content)
        monkeypatch.setitem(sys.modules, name, module)


def test_the_node_of_the_page_publishes_the_payload(tmp_path, monkeypatch, capsys):
    """ROS's modules are played by ours."""
    play_ros(monkeypatch)
    monkeypatch.chdir(tmp_path)
    arm = simulated_picks("panda", 1.2, seed=5, rate=1000.0)
    arm.estimate.save("model.json")
    save(arm.calibration, "without_load.csv")
    names = runpy.run_path(str(DOCS / "payload_node.py"), run_name="node")
    node = names["PayloadNode"]()
    run = arm.stream(2.0).window(0.5, 3.0)
    for t, q, tau in zip(run.t, run.q[:, ::-1], run.tau[:, ::-1], strict=True):
        stamp = SimpleNamespace(sec=int(t), nanosec=round(1e9 * (t % 1.0)))
        node.take(
            SimpleNamespace(
                name=list(node.names[::-1]),
                position=q.tolist(),
                effort=tau.tolist(),
                header=SimpleNamespace(stamp=stamp),
            )
        )
    assert len(node.said) == 1
    assert node.said[0].startswith("picked up")
    last = node.messages[-1].inertia
    assert last.m == pytest.approx(arm.mass, rel=0.1)
    assert last.ixx > 0.0
    save(run, "stream.csv")
    text = (DOCS / "online.md").read_text(encoding="utf-8")
    (loop,) = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    exec(compile(loop, "online.md", "exec"), {})
    picked, up, mass, *_ = capsys.readouterr().out.split()
    assert (picked, up) == ("picked", "up")
    assert float(mass) == pytest.approx(arm.mass, rel=0.1)
