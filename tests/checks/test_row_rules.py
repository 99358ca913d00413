"""Copies, freezes and skips: told where they were made, and not where a coarse sensor
looks like one."""

import json
import re
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from corruptions.kinds import corruptions
from scipy.spatial import KDTree

from sdp_vs_penalty import Measurements, load_problem
from sdp_vs_penalty.checks import mended
from sdp_vs_penalty.checks.facts import RULES
from sdp_vs_penalty.checks.facts.stuck import find_bad_torque_channels
from sdp_vs_penalty.checks.glance import RunSummary
from sdp_vs_penalty.checks.issue import mended_unasked
from sdp_vs_penalty.data.files import check_usable
from sdp_vs_penalty.errors import InputError, RepairableError

PROBLEM = load_problem("two_link")
ROBOT = PROBLEM.robot
RATE = 250
PERIOD = 8.0


def stepped(x, step):
    return np.asarray(step * np.round(x / step)) if step else x


def motion(periods=3, encoder=0.0, torque=0.0, noise=0.02):
    """Two joints whose motion repeats exactly, with dry friction; sensors in steps of
    so much."""
    t = np.arange(0.0, periods * PERIOD, 1.0 / RATE)
    w = 2.0 * np.pi * np.array([[2.0], [5.0]]) / PERIOD
    q, dq = (np.array([[0.9], [0.5]]) * f for f in (np.sin(w * t), w * np.cos(w * t)))
    rng = np.random.default_rng(7)
    tau = 6.0 * np.cos(q) + dq + 2.4 * np.sign(dq) + noise * rng.normal(size=q.shape)
    measured = dq + 0.01 * rng.normal(size=q.shape)
    q = q if encoder else q + 1e-6 * rng.normal(size=q.shape)
    return Measurements(t, stepped(q, encoder).T, stepped(tau, torque).T, measured.T)


def found(kind, run):
    """What the rules, each by itself, say of that kind of a run."""
    said = (issue for rule in RULES for issue in rule(RunSummary(run, PROBLEM)))
    return next((issue for issue in said if issue.kind == kind), None)


def told(run):
    issues, _ = mended(run, PROBLEM)
    fixed = mended_unasked(run, issues)
    return issues, fixed


#: Corruptions of rows and clocks of the bench: the kind that names them, how many rows
#: go, and by how many steps the time of those that stay is off.
DATA = Path(__file__).parents[1] / "data"
ROWS = json.loads((DATA / "spoiled_rows.json").read_text())


@pytest.mark.parametrize("name", ROWS)
def test_what_is_left_of_a_spoiled_log_is_the_clean_one(name):
    """Every row that was spoiled goes, no other, and those that stay have their time
    again."""
    (kind, gone, off), clean = ROWS[name], replace(motion(), dq=None)
    (corruption,) = (c for c in corruptions(2) if c.name == name)
    spoiled = corruption.spoil(clean)
    (issue,), summary = mended(spoiled, PROBLEM)
    fixed = mended_unasked(spoiled, [issue])
    whole = summary.run
    assert issue.kind == kind
    assert kind == "interpolated rows" or found("interpolated rows", spoiled) is None
    assert "joint 2" not in name or issue.joints in ((), (2,))
    assert issue.severity in ("error", "warning")
    clean_rows = KDTree(np.hstack([clean.q, clean.tau]))
    away, rows = clean_rows.query(np.hstack([whole.q, whole.tau]))
    assert away.max() < 1e-9
    assert np.all(np.diff(rows) > 0)
    assert len(clean.t) - len(rows) == gone
    assert np.abs(whole.t - clean.t[rows]).max() * RATE <= off + 1e-6
    np.testing.assert_array_equal((whole if issue.can_fix else spoiled).t, fixed.t)
    wrong = np.flatnonzero(
        clean_rows.query(np.hstack([spoiled.q, spoiled.tau]))[0] > 1e-9
    )
    if gone and len(wrong):  # as the user counts them, from a header in row 1
        first = int(re.search(r"rows? (\d+)", issue.where)[1])
        assert abs(first - wrong[0] - 2) <= 1  # what froze was right in its first row
        assert issue.figures["rows"] == gone
        assert issue.figures["seconds"] == pytest.approx(
            np.diff(whole.t).max() - 1.0 / RATE, abs=2.1 / RATE
        )


@pytest.mark.parametrize("velocity", [True, False])
def test_a_motion_that_repeats_under_a_coarse_encoder_is_no_copy(velocity):
    """Many rows are equal one period later by chance; a part that is in the file twice
    still is told."""
    clean = motion(encoder=2.0 * np.pi / 4096, torque=0.1, noise=0.1)
    clean = clean if velocity else replace(clean, dq=None)
    lag = int(PERIOD * RATE)
    same = np.all(clean.q[lag:] == clean.q[:-lag], axis=1) & np.all(
        clean.tau[lag:] == clean.tau[:-lag], axis=1
    )
    assert same.sum() > 200
    assert found("repeated run", clean) is None
    rows = np.r_[0:3000, 1500:2500, 3000 : len(clean.t)]
    copied = Measurements(
        np.arange(len(rows)) / RATE,
        clean.q[rows],
        clean.tau[rows],
        clean.dq[rows] if velocity else None,
    )
    issue = found("repeated run", copied)
    assert (issue.figures["rows"], issue.figures["lag"]) == (1000, 1500)
    # The same positions and torques with other velocities are no copies.
    other = replace(copied, dq=motion(4).dq[: len(rows)])
    assert found("repeated run", other) is None


def test_packets_that_froze_for_a_few_rows_are_no_rows_lost():
    """Positions stand still bit by bit, then jump, while the stamps go on evenly: the
    clock is right."""
    clean = motion()
    rows = np.arange(len(clean.t))
    for k in range(200, 5800, 500):
        rows[k : k + 4] = k
    issues, fixed = told(
        replace(clean, q=clean.q[rows], tau=clean.tau[rows], dq=clean.dq[rows])
    )
    assert not issues
    np.testing.assert_array_equal(fixed.t, clean.t)


def alone(n_places):
    """One joint of two moves; 8 rows are lost at so many places, the clock is even."""
    run = motion(noise=0.0)
    keep = np.ones(len(run.t), bool)
    for k in np.linspace(700, 5000, n_places).astype(int):
        keep[k : k + 8] = False
    q = np.column_stack([run.q[keep, 0], np.full(keep.sum(), 0.2)])
    return Measurements(run.t[: keep.sum()], q, run.tau[keep])


@pytest.mark.parametrize("follows", [False, True])
def test_a_joint_that_is_told_to_go_beyond_its_range_lies_against_its_end_stop(follows):
    """A sine of .9 rad through a range of .7: the position stays there, or the range is
    a wrong one."""
    run = motion()
    range_ = 0.7
    narrow = replace(
        ROBOT,
        joints=(replace(ROBOT.joints[0], lower=-range_, upper=range_), ROBOT.joints[1]),
    )
    told, q = (
        np.roll(run.q, -5, axis=0),
        run.q.copy(),
    )  # it follows its command 20 ms later
    q[:, 0] = q[:, 0] if follows else np.clip(q[:, 0], -range_ - 0.01, range_ + 0.01)
    run = replace(run, q=q, commanded={"qcmd": told})
    issues, _ = mended(run, replace(PROBLEM, robot=narrow))
    fixed = mended_unasked(run, issues)
    issue = next((x for x in issues if x.kind == "end stop"), None)
    assert (issue is None) is follows
    if issue is not None:
        against = (
            np.abs(told[:, 0]) > range_ + 0.03
        )  # the position is .01 beyond: a third of that
        assert issue.figures["joints"] == [1]
        assert (
            np.count_nonzero(against)
            <= issue.figures["rows"]
            < 1.2 * np.count_nonzero(against)
        )
        assert len(fixed.t) == len(run.t) - issue.figures["rows"]


def test_stamps_that_jitter_over_even_samples_are_spaced_evenly():
    clean = motion()
    rng = np.random.default_rng(2)
    even = clean.t
    jittered = even + rng.uniform(-0.4, 0.4, len(even)) / RATE
    issues, summary = mended(replace(clean, t=jittered), PROBLEM)  # likely, not certain
    (issue,) = [x for x in issues if x.kind == "jittered time stamps"]
    steps = np.diff(jittered)
    assert issue.severity == "warning"
    assert issue.figures["percent"] == pytest.approx(
        100.0 * steps.std() / steps.mean(), rel=0.05
    )
    assert issue.figures["ratio"] > 3.0
    np.testing.assert_allclose(np.diff(summary.run.t), 1.0 / RATE, rtol=0.01)
    # Samples that were taken at uneven times lie smoothly over these: nothing is wrong
    # with the stamps.
    true = np.sort(even + rng.uniform(-0.4, 0.4, len(even)) / RATE)
    q = np.column_stack([np.interp(true, even, x) for x in clean.q.T])
    uneven = replace(clean, t=true, q=q, dq=None)
    assert "jittered time stamps" not in [x.kind for x in told(uneven)[0]]


@pytest.mark.parametrize("back", [3.0, 40.0])
def test_behind_a_clock_that_was_set_back_another_motion_is_another_run(back):
    clean = motion()
    late = (np.arange(6000) > 2500)[:, None]
    q = clean.q + 0.4 * late
    t = clean.t - back * late[:, 0]
    (issue, *_), fixed = told(replace(clean, t=t, q=q))
    assert issue.figures["seconds"] == pytest.approx(back - 1.0 / RATE, abs=1e-6)
    assert issue.figures["rows"] == [2503]  # header and first row are 1 and 2
    assert "several runs are in the file" in issue.what
    assert np.diff(fixed.t).max() == pytest.approx(1.0)


def test_stamps_that_repeat_say_nothing_about_the_order_of_the_rows():
    """The reader counted them as steps backwards, the check as steps forwards."""
    clean = motion()
    coarse = np.repeat(clean.t[::2], 2)[: len(clean.t)]  # every second stamp repeats
    backwards = replace(clean, t=coarse).rows(np.arange(len(clean.t))[::-1])
    issue = found("time runs backwards", backwards)
    assert issue is not None
    assert "the last row comes first" in issue.what
    with pytest.raises(InputError, match="turn the order of the rows round"):
        check_usable("run.csv", backwards)
    with pytest.raises(InputError, match="spread coarse stamps"):
        check_usable("run.csv", replace(clean, t=coarse))


def test_a_time_that_repeats_keeps_the_first_of_its_rows():
    clean = motion()
    rows = np.insert(np.arange(len(clean.t)), [900, 1700], [899, 1699])
    issues, fixed = told(clean.rows(rows))
    (issue,) = [x for x in issues if x.kind == "repeated time"]
    assert (issue.figures["rows"], issue.figures["parts"]) == (2, 2)
    assert "are copies of the row before" in issue.what
    np.testing.assert_array_equal(fixed.t, clean.t)
    np.testing.assert_array_equal(fixed.q, clean.q)
    other = clean.rows(rows)
    other.q[900] += 0.1
    assert "differ from the row before" in told(other)[0][0].what


def silent_about_zeros(run):
    """No rule calls a zero a row that was filled in, and nothing is an error."""
    issues, _ = mended(run, PROBLEM)
    fixed = mended_unasked(run, issues)
    kinds = [x.kind for x in issues]
    is_error = any(x.severity == "error" for x in issues)
    return "zeros" not in kinds and not is_error and len(fixed.t) == len(run.t)


@pytest.mark.parametrize("step", [1e-3, 0.02, 0.1, 0.5, 1.2])
@pytest.mark.parametrize("noise", [0.0, 0.02, 0.3])
def test_a_torque_in_steps_of_its_drive_passes_zero_exactly(step, noise):
    """Coulomb's friction changes its sign within a sample or two."""
    clean = replace(motion(), dq=None)
    rng = np.random.default_rng(5)
    friction = 2.4 * np.sign(np.gradient(clean.q, axis=0))
    friction[::7] *= 0.5
    tau = friction + noise * rng.normal(size=friction.shape)
    assert silent_about_zeros(replace(clean, tau=stepped(tau, step)))


@pytest.mark.parametrize("seed", range(4))
def test_a_noisy_torque_in_few_steps_returns_to_zero_as_to_others(seed):
    clean = replace(motion(), dq=None)
    rng = np.random.default_rng(seed)
    tau = clean.tau + 0.6 * rng.standard_t(3, size=clean.tau.shape)
    assert silent_about_zeros(replace(clean, tau=stepped(tau, 0.4)))


@pytest.mark.parametrize("step", [0.0, 0.05])
@pytest.mark.parametrize(("begin", "end"), [(100, 400), (0, 500)])
def test_a_joint_at_rest_may_need_no_torque(step, begin, end):
    """Its brake is on while the other one moves: exactly zero, and back."""
    clean = replace(motion(), dq=None)
    q, tau = clean.q.copy(), stepped(clean.tau, step)
    for k in range(500, 5500, 1000):
        q[k : k + 500, 1] = q[k, 1]
        q[k + 500 :, 1] += q[k, 1] - q[k + 500, 1]
        tau[k + begin : k + end, 1] = 0.0
    issues = told(replace(clean, q=q, tau=tau))[0]
    assert not {"zeros", "drive off"} & {issue.kind for issue in issues}


def test_a_channel_that_never_changes_at_a_joint_that_rests_is_no_error():
    clean = motion()
    q, tau = clean.q.copy(), clean.tau.copy()
    q[:, 1], tau[:, 1] = 0.3, 0.0
    still = replace(clean, q=q, tau=tau, dq=None)
    (dead,) = find_bad_torque_channels(RunSummary(still, PROBLEM))
    assert (dead.kind, dead.severity) == ("dead channel", "note")


def with_a_held_joint():
    """Joint 2 is held: its servo lets it tremble by a few steps of the encoder, now and
    then by a jerk; the logged velocity comes from a finer counter inside of the drive."""
    run = motion(encoder=3.8e-4)
    rng = np.random.default_rng(11)
    n = len(run.t)
    drift = np.cumsum(rng.normal(size=n)) / RATE
    sag = 1.2e-3 * np.sin(3.0 * drift / np.std(drift))
    jerks = np.zeros(n)
    jerks[rng.choice(n - 3, 8, replace=False)] = 7.6e-4
    q = run.q.copy()
    dq = np.array(run.dq)
    q[:, 1] = stepped(sag + jerks, 3.8e-4)
    dq[:, 1] = np.gradient(sag, run.t) + 0.005 * rng.normal(size=n)
    return replace(run, q=q, dq=dq)


def with_a_joint_that_catches():
    """Joint 1 slides, and stiction catches it within one sample; joint 2 moves on.
    Returns the run and the row of the catch."""
    run = motion()
    q = run.q.copy()
    tau = run.tau.copy()
    row = 1500
    q[row - 200 : row, 0] = q[row, 0] - 8e-4 * np.arange(200, 0, -1)
    q[row : row + 300, 0] = q[row, 0]
    tau[row - 200 : row + 300, 0] = 4.0
    return replace(run, q=q, tau=tau, dq=None), row


def creeping(rows_doubled=0, seed=3):
    """Two joints that creep for half of the time: then their encoders and torques, both
    coarse, often change in no channel from row to row. Some rows are doubled, with the
    clock made again."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, 24.0, 1.0 / RATE)
    speed = np.where(np.sin(2.0 * np.pi * t / PERIOD) > 0.0, 0.8, 0.02)
    way = np.cumsum(speed[:, None] * [1.0, 0.7], axis=0) / RATE
    q = stepped(np.abs((way + np.array([0.0, 0.4])) % 2.0 - 1.0), 1e-4)
    tau = 6.0 * np.cos(q) + 0.02 * rng.normal(size=q.shape) * speed[:, None]
    rows = np.sort(
        np.append(np.arange(len(t)), rng.choice(len(t), rows_doubled, False))
    )
    return Measurements(np.arange(len(rows)) / RATE, q[rows], stepped(tau, 2e-3)[rows])


def with_tau(run, rows, by):
    """The run with other torques of joint 1 in some rows."""
    tau = run.tau.copy()
    tau[rows, 0] += by
    return replace(run, tau=tau)


def dry(seed, step):
    """A slow load and Coulomb's friction, in steps of so much: at one level for long,
    then a jump."""
    clean = motion(2)
    noise = 0.02 * np.random.default_rng(seed).normal(size=clean.q.shape)
    load = 1.5 * np.sin(2.6 * np.pi * clean.t / clean.t[-1] + seed)[:, None]
    tau = 2.4 * np.sign(clean.dq) + 0.2 * clean.dq + load + noise
    return replace(clean, tau=stepped(tau, step))


def resting():
    """The arm rests for a time; the controller's model of gravity is constant then."""
    clean = motion()
    rows = np.arange(len(clean.t))
    rows[1000:1400] = 1000
    return replace(clean, q=clean.q[rows], tau=clean.tau[rows])


def accelerating():
    """It began at rest: its last rows are judged by those before them alone."""
    row = np.arange(600.0)
    q = np.outer(np.exp(0.1 * (row - 600.0)), np.linspace(0.3, 0.5, ROBOT.n))
    return Measurements(row / RATE, q, np.cos(q))


def waiting():
    """A servo answers steps within a tenth of a second, and rests under a coarse
    encoder until the next one."""
    t = np.arange(0.0, 24.0, 1.0 / RATE)
    step = np.floor(t / 1.5).astype(int)
    goals = np.random.default_rng(0).uniform(-0.6, 0.6, (step[-1] + 2, 2))
    since = (t % 1.5)[:, None]
    share = 1.0 - np.exp(-since / 0.05) * (1.0 + since / 0.05)
    q = goals[step] + share * (goals[step + 1] - goals[step])
    groups = {"q": stepped(q, 2.0 * np.pi / 2**14), "qcmd": goals[step + 1]}
    return Measurements.from_channels(t, groups, ("run",))


def from_pose_to_pose():
    """Moves and rests, a coarse torque with noise."""
    rng = np.random.default_rng(0)
    share = np.concatenate([np.linspace(0.0, 1.0, 300), np.ones(150)])
    share = share**3 * (10.0 - 15.0 * share + 6.0 * share**2)
    poses = rng.uniform(-1.0, 1.0, (14, 2))
    moves = [a + share[:, None] * (b - a) for a, b in pairwise(poses)]
    q = np.concatenate(moves).round(9)
    tau = 6.0 * np.cos(q) + 0.02 * rng.normal(size=q.shape)
    return Measurements(np.arange(len(q)) / 200.0, q, stepped(tau.T, 1.0).T)


STAYS = replace(
    motion(), dq=None, q=np.repeat(motion().q[:3000], [*2999 * [1], 3001], axis=0)
)
#: The last sample but two of a jerk at an end has no three samples behind it.
JERK = np.array([0.0, 9.0, 18.0, 28.0, 43.0, 78.0, 101.0, 97.0])
CATCHES, ROW = with_a_joint_that_catches()
#: A log in order, and the kind of fact that it is none of.
IN_ORDER = {
    **{
        f"dry friction {k}, in steps of {x}": ("frozen torque", dry(k, x))
        for k in range(3)
        for x in (0.8, 1.2)
    },
    "an arm at rest": ("frozen torque", resting()),
    "a held joint, frozen": ("frozen position", with_a_held_joint()),
    "a held joint, spiky": ("spikes", with_a_held_joint()),
    "a jerk at the end": ("spikes", with_tau(motion(), slice(-8, None), JERK)),
    "a jerk at the begin": ("spikes", with_tau(motion(), slice(7, None, -1), JERK)),
    "a controller answers a joint that stops": (
        "spikes",
        with_tau(CATCHES, ROW, -30.0),
    ),
    "one skip of a joint that moves alone": ("lost rows", alone(1)),
    "acceleration at the end": ("lost rows", accelerating()),
    **{f"creeping {k}": ("doubled rows", creeping(seed=k)) for k in range(3)},
    "from pose to pose": ("doubled rows", from_pose_to_pose()),
    "steps of a command, packets": ("frozen packets", waiting()),
    "steps of a command, copies": ("repeated run", waiting()),
    "a position that stays until the end": ("frozen position", STAYS),
    "no motion": ("time unit", replace(motion(), q=np.zeros_like(motion().q))),
}


@pytest.mark.parametrize("name", IN_ORDER)
def test_of_a_log_in_order_nothing_is_said(name):
    kind, run = IN_ORDER[name]
    assert found(kind, run) is None


def with_rows(run, rows, **names):
    """The run in which some of its channels hold one row: their first."""
    first = np.arange(len(run.t))[rows][0]
    held = {name: getattr(run, name).copy() for name in names}
    for name, values in held.items():
        values[rows, names[name]] = values[first, names[name]]
    return replace(run, **held)


def doubled(share):
    """Two channels of one joint that moves are enough to tell chance from copies."""
    clean = replace(motion(encoder=1e-4, torque=0.01), dq=None)
    count = round(share * len(clean.t))
    rows = np.random.default_rng(1).choice(len(clean.t), count, replace=False)
    rows = np.sort(np.append(np.arange(len(clean.t)), rows))
    return replace(clean.rows(rows), t=np.arange(len(rows)) / RATE)


SMOOTH = replace(motion(), dq=None)
DERIVED = replace(motion(), dq=np.gradient(motion().q, motion().t, axis=0))
BACKWARDS = SMOOTH.rows(np.arange(len(SMOOTH.t))[::-1])
HALF = slice(len(SMOOTH.t) // 2, None)
#: A log, the kind of fact that it is, and what is said of it: words of a sentence, or
#: figures.
TOLD = {
    "last row first": (
        BACKWARDS,
        "time runs backwards",
        {"what": "last row comes first"},
    ),
    **{
        f"a clock in {unit}": (
            replace(SMOOTH, t=SMOOTH.t / seconds),
            "time unit",
            {"what": f"time is in {unit}", "factor": seconds, "severity": "error"},
        )
        for unit, seconds in (("hours", 3600.0), ("milliseconds", 1e-3))
    },
    # A tenth of the rows refuse a log: less is a warning, which `--fix` repairs.
    **{
        f"{count} rows held": (
            with_rows(
                SMOOTH, slice(2000, 2000 + count), q=slice(None), tau=slice(None)
            ),
            "frozen packets",
            {"severity": severity},
        )
        for count, severity in ((60, "warning"), (900, "error"))
    },
    # A log may end before the channel changes again.
    "a torque frozen until the end": (
        with_rows(motion(), slice(2000, None), tau=0),
        "frozen torque",
        {"severity": "error", "where": "tau1,"},
    ),
    "a position frozen while the logged velocity goes on": (
        with_rows(motion(), HALF, q=1),
        "frozen position",
        {},
    ),
    # A velocity of the controller is no measurement: it comes all the same.
    **{
        f"{count} rows wait while the velocity goes on": (
            with_rows(
                motion(), slice(1000, 1000 + count), q=slice(None), tau=slice(None)
            ),
            "frozen packets",
            {"rows": count - 1, "what": "positions and torques"},
        )
        for count in (12, 40)
    },
    # One of them where the joint stops is deleted with those in steady motion.
    "packets torn": (with_tau(CATCHES, [ROW, ROW - 60], -30.0), "spikes", {"rows": 2}),
    "lost rows of a joint that moves alone": (alone(6), "lost rows", {}),
    **{f"doubled {x:g}": (doubled(x), "doubled rows", {}) for x in (0.05, 0.3, 0.5)},
}


@pytest.mark.parametrize("name", TOLD)
def test_what_is_wrong_with_rows_is_told(name):
    run, kind, said = TOLD[name]
    issue = found(kind, run)
    assert issue is not None
    for key, value in said.items():
        told = issue.figures.get(key, getattr(issue, key, None))
        assert value in told if isinstance(value, str) else value == told
    if "doubled" in name:
        assert issue.figures["rows"] >= 0.9 * float(name.split()[1]) * 6000
    if name in ("last row first", "minutes, by velocities"):
        clean = SMOOTH if "last" in name else DERIVED
        np.testing.assert_allclose(issue.repair(run).t, clean.t)
        np.testing.assert_array_equal(issue.repair(run).tau, clean.tau)


def test_amounts_are_written_as_a_person_writes_them():
    """ "1 rows" and "3.05e+03 s" stood there."""
    run = motion(periods=2)
    half = len(run.t) // 2
    late = run.rows(np.r_[:half, half + 500 : len(run.t)])
    late = replace(late, t=late.t + 3050.0 * (np.arange(len(late.t)) >= half))
    assert "1 gap of up to 3052 s (the usual" in found("gap in time", late).what
    tau = run.tau.copy()
    tau[half, 0] = np.nan
    missing = found("missing numbers", replace(run, tau=tau))
    assert missing.what.startswith("1 row with values that are not finite")


def test_a_step_that_the_reader_made_is_no_fact_of_the_file():
    run = motion(periods=2)
    half = len(run.t) // 2
    number = (np.arange(len(run.t)) >= half).astype(int)
    apart = replace(run, t=run.t + number)
    assert found("clock step", apart)
    assert not found("clock step", replace(apart, episode=number))
    assert not found("gap in time", replace(apart, episode=number))


def test_a_few_rows_of_another_clock_are_to_be_deleted():
    """Rows behind a pause that is shorter than the run are samples, however few."""
    run = motion(periods=2)
    first = np.arange(len(run.t)) < 3
    apart = replace(run, t=run.t + np.where(first, 0.0, 3048.0))
    issue = found("stray rows", apart)
    assert issue.what.startswith("the time of 3 rows is up to 3048 s")
    np.testing.assert_array_equal(issue.repair(apart).tau, run.tau[3:])
    issues, _ = told(apart)
    assert not {"gap in time", "clock step"} & {issue.kind for issue in issues}
    paused = replace(run, t=run.t + np.where(first, 0.0, 5.0))
    assert not found("stray rows", paused)
    assert found("gap in time", paused) or found("clock step", paused)
    half = np.arange(len(run.t)) < len(run.t) // 2
    two = replace(run, t=run.t + np.where(half, 0.0, 3048.0))
    assert not found("stray rows", two)


@pytest.mark.parametrize("is_clock", [True, False])
def test_no_repair_is_offered_that_would_drop_most_of_the_rows(is_clock):
    """`check --fix` was offered, and refused to write."""
    clean = motion()
    tau = clean.tau.copy()
    tau[::2, 0] = np.nan
    spoiled = replace(clean, t=0.0 * clean.t) if is_clock else replace(clean, tau=tau)
    issues, _ = mended(spoiled, PROBLEM)
    errors = [issue for issue in issues if issue.severity == "error"]
    assert errors
    assert not any(issue.offers_fix or issue.remedies for issue in errors)
    assert "log it again" in errors[0].remedy
    with pytest.raises(InputError) as refused:
        check_usable("run.csv", spoiled)
    assert not isinstance(refused.value, RepairableError)
