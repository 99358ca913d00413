"""Data spoiled in many ways, each named; silence on clean data, measured and simulated."""

import json
import re
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from arms import ELBOW, SHOULDER, TURN, write_urdf
from commands import run_cli
from corruptions.bench import contradicts
from judged import report_of_run
from recorded import refusal
from small_runs import small_run

from sdp_vs_penalty import (
    InputError,
    Measurements,
    identify,
    load_estimate,
    load_problem,
)
from sdp_vs_penalty.checks import Issue, check, mended
from sdp_vs_penalty.checks.certainty import likely
from sdp_vs_penalty.checks.fixing import fix_runs
from sdp_vs_penalty.checks.gate import consented, needs_check
from sdp_vs_penalty.checks.torque_size import _gains_in_words
from sdp_vs_penalty.data import load_measurements, save
from sdp_vs_penalty.effects.effect import Motion
from sdp_vs_penalty.problem import measured_runs
from sdp_vs_penalty.simulation import experiment

Spoil = Callable[[Measurements], Measurements]


@pytest.fixture(scope="module")
def simulated(panda):
    """The Panda's exciting trajectory, simulated with the real arm's noise, jitter and
    quantisation."""
    return panda, experiment(panda).training_run(0).window(0.0, 16.0).runs()[0]


@pytest.fixture(scope="module")
def small(two_link):
    """The same of two joints, for what a clock or a file shows whatever the arm."""
    return two_link, experiment(two_link).training_run(0)


@pytest.fixture(scope="module")
def three_joints(tmp_path_factory):
    """An arm of a file, and a run of it."""
    path = tmp_path_factory.mktemp("arm") / "arm.urdf"
    problem = load_problem(write_urdf(path, "arm", (TURN, SHOULDER, ELBOW)))
    return problem, small_run(problem, seconds=10.0)


def changed(name, j, change, of=slice(None)):
    """One channel (joint j counted from 1), in some of its rows."""

    def spoil(run):
        values = getattr(run, name).copy()
        values[of, j - 1] = change(values[of, j - 1])
        return replace(run, **{name: values})

    return spoil


def repeated(run):
    return run.rows(np.sort(np.concatenate([np.arange(len(run.t)), [500, 4000]])))


def knocked(run):
    bump = np.exp(-0.5 * ((run.t - run.t[0] - 12.0) / 0.05) ** 2)
    return replace(run, tau=run.tau + bump[:, None] * 0.7 * run.tau.std(axis=0))


def still(run):
    return replace(run, q=run.q[0] + 1e-6 * NOISE[: run.q.size].reshape(run.q.shape))


def sparse(run):
    return run.rows(slice(None, None, 250))


NOISE = np.random.default_rng(0).normal(size=200_000)
FLIPPED = changed("tau", 2, lambda x: -x)

#: name : (how the data are spoiled, the kind of the finding, what it must name, its
#: severity)
SPOILED = {
    "missing samples": (
        lambda run: run.rows(np.r_[:7500, 8300 : len(run.t)]),
        "gap in time",
        "0.8",
        "warning",
    ),
    "rows twice": (repeated, "repeated time", "copies", "error"),
    "not a number": (
        changed("tau", 2, lambda x: np.nan, [70, 900]),
        "missing numbers",
        "2 rows",
        "error",
    ),
    "quantisation": (
        changed("q", 2, lambda x: np.round(x / 0.01) * 0.01),
        "quantisation",
        "q2",
        "warning",
    ),
    "a knock": (knocked, "one-off event", "t = 12", "warning"),
    "no motion": (still, "no motion", "no joint moves", "error"),
    "an idle joint": (
        changed("q", 7, lambda x: x[0] + 1e-6 * NOISE[: len(x)]),
        "idle joints",
        "joint 7",
        "warning",
    ),
    "few samples": (sparse, "low sample rate", "too few", "warning"),
    "another arm's torque": (
        lambda run: replace(
            run, tau=NOISE[: run.tau.size].reshape(run.tau.shape).cumsum(axis=0) / 50.0
        ),
        "torque not explained",
        "No inertia and friction",
        "warning",
    ),
    "microseconds": (
        lambda run: replace(run, t=1e6 * run.t),
        "time unit",
        "microseconds",
        "error",
    ),
    "days, as spreadsheets count them": (
        lambda run: replace(run, t=46_000.0 + run.t / 86_400.0),
        "time unit",
        "days",
        "error",
    ),
    "a dead channel": (
        changed("tau", 2, lambda x: 0.25),
        "dead channel",
        "tau2 is 0.25",
        "error",
    ),
}


#: A remedy that this program can carry out: it is a button and a command.
CHANGES_THE_LOG = re.compile(
    "(multiply|divide|flip|set|add|leave|exclude|delete|cut|shift|rename|unwrap|space|put) "
)


@pytest.mark.parametrize("name", SPOILED)
def test_what_is_wrong_is_named(name, simulated, small):
    """On two joints; where the others' weight has to tell it, on seven."""
    spoil, kind, words, severity = SPOILED[name]
    problem, run = (
        simulated if name in ("another arm's torque", "an idle joint") else small
    )
    (report,) = check(problem, spoil(run))
    found = {f.kind: f for f in report.errors_and_warnings}
    assert kind in found, [f.kind for f in report.errors_and_warnings]
    assert not contradicts(report)
    finding = found[kind]
    assert words in finding.what, finding.what
    assert finding.severity == severity
    assert finding.certainty.grade in ("certain", "likely", "possible")
    assert finding.remedy
    assert finding.remedies or not CHANGES_THE_LOG.match(finding.remedy)
    assert name != "a dead channel" or finding.where == "tau2"
    assert report.meaningless == (severity == "error")
    # No other gross mistake is invented beside it.
    gross = {
        "torque sign",
        "torque order",
        "gravity direction",
        "position sign",
        "positions in degrees",
    }
    assert {f.kind for f in report.errors_and_warnings} & gross <= {kind}


@pytest.mark.long
def test_torques_tell_per_cent_of_the_ranges_from_degrees(simulated):
    problem, run = simulated
    joints = problem.robot.joints
    middles = np.array([0.5 * (x.upper + x.lower) for x in joints])
    radians_per_cent = np.array([x.upper - x.lower for x in joints]) / 200.0
    logged = replace(run, q=(run.q - middles) / radians_per_cent, dq=None)
    report = report_of_run(problem, logged)
    (issue,) = [f for f in report.issues if f.kind == "positions in per cent"]
    assert (issue.severity, issue.certainty.grade) == ("error", "likely")
    assert not issue.can_fix
    np.testing.assert_allclose(report.repaired_all.q, run.q, atol=0.01)


@pytest.mark.parametrize(
    ("word", "scale", "middle"),
    [
        ("turns", 2.0 * np.pi, 0.0),
        pytest.param("mrad", 1e-3, 0.0, marks=pytest.mark.long),
        pytest.param("mdeg", np.pi / 180000.0, 0.0, marks=pytest.mark.long),
        pytest.param("counts", 2.0 * np.pi / 4096, 0.0, marks=pytest.mark.long),
        pytest.param("counts", 2.0 * np.pi / 2**17, 0.0, marks=pytest.mark.long),
        ("counts", 2.0 * np.pi / 4096, -np.pi),
        ("shares", 5.0, -2.5),
        ("counts", 2.0 * np.pi / 36000, 0.0),
    ],
)
def test_torques_tell_the_unit_of_positions(word, scale, middle, three_joints):
    """Such a log is refused with the repair that reads it, whether or not the positions
    would be possible as radians."""
    problem, run = three_joints
    logged = replace(run, q=(run.q - middle) / scale, dq=None)
    report = report_of_run(problem, logged)
    (issue,) = [f for f in report.issues if f.severity == "error"]
    assert issue.kind == f"positions in {word}"
    if "interval" in issue.figures:  # of counts that are no power of two
        first, last = issue.figures["interval"]
        assert first < np.log(scale) < last
        assert not issue.apply
        return
    assert issue.apply.split(":")[0] == word
    (fixed,) = fix_runs(problem, [logged], [report], [issue.apply]).runs
    np.testing.assert_allclose(fixed.q, run.q, atol=1e-9)
    if word == "turns":
        with pytest.raises(InputError, match=r"in turns|far outside"):
            identify(problem, logged)


def test_a_unit_that_nothing_says_nor_the_arm_tells_is_asked_for(tmp_path):
    """Two joints without gravity, which move little: any unit explains their torques.
    What has our names is in radians, and asks nothing, nor does an arm that would be
    more than a turn away from its zero."""
    problem = load_problem("two_link").with_gravity((0.0, 0.0, 0.0))
    small = replace(small_run(problem, seconds=10.0, reach=0.01), dq=None)
    asks = replace(small, unit_command="convert pos.csv --scale q=UNIT --out run.csv")
    far = replace(asks, q=asks.q + 1.5)
    kinds = [{f.kind for f in check(problem, x)[0].issues} for x in (small, asks, far)]
    assert ["position unit not said" in x for x in kinds] == [False, True, False]
    (issue,) = [f for f in check(problem, asks)[0].issues if "not said" in f.kind]
    units = [change.arguments["scale"]["q"] for change in issue.changes]
    assert units == ["rad", "turns"]
    said = refusal(lambda: identify(problem, asks), "or name the unit (")
    assert f"(`{asks.unit_command}`)" in said


@pytest.mark.parametrize(
    "per_cent", [True, pytest.param(False, marks=pytest.mark.long)]
)
def test_where_torques_do_not_tell_degrees_from_per_cent_both_are_named(
    per_cent, three_joints
):
    problem, run = three_joints
    logged = replace(run, q=run.q / (0.025 if per_cent else np.radians(1.0)), dq=None)
    report = report_of_run(problem, logged)
    (issue,) = [f for f in report.issues if f.kind.startswith("positions in")]
    said = f"{issue.what} {issue.certainty} {issue.remedy}"
    assert issue.severity == "error"
    assert issue.certainty.grade in ("likely", "possible")
    assert "degrees" in said
    assert "per cent of each joint's range" in said
    (other,) = issue.changes
    assert other.arguments["scale"]["q"] in ("deg", "0.025:0.025:0.025")
    (fixed,) = fix_runs(problem, [logged], [report], [issue.apply]).runs
    assert np.abs(fixed.q).max() < 2.5
    with pytest.raises(InputError, match="degrees, or per cent of each joint's range"):
        identify(problem, logged)


def _degrees(run, joints):
    q = run.q.copy()
    q[:, joints] = np.degrees(q[:, joints])
    return replace(run, q=q, dq=None)


def _slower_clock(run):
    dq = np.gradient(run.q, run.t, axis=0)
    return replace(run, t=run.t[0] + 1.4 * (run.t - run.t[0]), dq=dq)


@pytest.mark.parametrize(
    ("spoil", "kind"),
    [
        (lambda run: _degrees(run, [0]), "position unit"),
        (lambda run: _degrees(run, [0, 1, 2]), "positions in degrees"),
        (_slower_clock, "clock against velocity"),
    ],
)
def test_what_is_certain_is_fixed_whatever_tells_it(spoil, kind, three_joints):
    """Joints' ranges or an arm: their repairs were not made, and the copy was then refused
    since it was no better. A clock that velocities and a usual rate contradict is likely:
    its word mends it."""
    problem, run = three_joints
    # The first axis is upright; its angle is beyond 100 degrees, which are no per cent.
    run = replace(run, q=run.q + np.array([2.3 - run.q[:, 0].max(), 0.0, 0.0]))
    report = report_of_run(problem, spoil(run))
    (issue,) = report.errors_and_warnings
    assert (issue.kind, issue.can_fix) == (kind, spoil is not _slower_clock)
    words = [] if issue.can_fix else [issue.apply]
    (fixed,) = fix_runs(problem, [spoil(run)], [report], words).runs
    np.testing.assert_allclose(fixed.q, run.q, atol=1e-9)
    np.testing.assert_allclose(fixed.t, run.t, rtol=2e-3, atol=0.02)


@pytest.mark.long
def test_a_sign_beside_degrees_hides_neither(three_joints):
    """Neither alone explains much: the race begins again from what the range demands."""
    problem, run = three_joints
    turned = replace(run, q=run.q * np.array([1.0, -1.0, 1.0]))
    report = report_of_run(problem, _degrees(turned, [0]))
    issues = report.errors_and_warnings
    assert [issue.kind for issue in issues] == ["position unit", "position sign"]
    assert [issue.figures["joints"] for issue in issues] == [[1], [2]]


@pytest.mark.long
def test_four_faults_at_once_are_each_named(panda):
    """What hides behind another fault is told beside it, and one command mends them."""
    run = replace(small_run(panda, seconds=8.0), dq=None)
    order = [0, 3, 2, 1, 4, 5, 6]
    q = np.degrees(run.q) * np.where(np.arange(7) == 4, -1.0, 1.0)
    log = replace(run, q=q, tau=100.0 * run.tau[:, order])
    report = report_of_run(panda, log)
    issues = report.errors_and_warnings
    kinds = ["positions in degrees", "position sign", "torque order", "torque unit"]
    assert [issue.kind for issue in issues] == kinds
    words = [issue.apply for issue in issues if issue.apply]
    (fixed,) = fix_runs(panda, [log], [report], words).runs
    np.testing.assert_allclose(fixed.q, run.q, atol=1e-9)
    np.testing.assert_allclose(fixed.tau, 100.0 * run.tau, rtol=1e-9)


@pytest.mark.parametrize("turn", [1.0, pytest.param(-1.0, marks=pytest.mark.long)])
def test_a_motor_on_the_base_is_named_and_mended(turn, three_joints):
    """A parallelogram or a crossed belt: it was a gear ratio."""
    problem, run = three_joints
    model = problem.model()
    friction = np.full(len(model.parameters), 0.5)
    friction[model.rigid_indices] = 0.0
    motors = np.eye(3)
    motors[2, 1] = turn

    def rubs(states):
        return model.torque(friction, Motion(run.t, *states))

    joints = [run.q, run.dq, np.gradient(run.dq, run.t, axis=0)]
    of_links = (run.tau - rubs(joints)) @ np.linalg.inv(motors)
    angles = [x @ motors.T for x in joints]
    logged = replace(run, q=angles[0], tau=of_links + rubs(angles), dq=None)
    report = report_of_run(problem, logged)
    (issue,) = report.errors_and_warnings
    assert (issue.kind, issue.certainty.grade) == ("motor on the base", "likely")
    assert issue.apply == "motor:joint3"
    np.testing.assert_allclose(report.repaired_all.q, run.q, atol=1e-12)
    repaired = report.repaired_all.tau
    np.testing.assert_allclose(repaired, logged.tau @ motors, atol=1e-12)


@pytest.mark.long
def test_only_what_is_certain_is_fixed(simulated):
    """A knock is likely, a clock that is read from the file certain: the first is left
    to the user."""
    problem, run = simulated
    (report,) = check(problem, knocked(SPOILED["rows twice"][0](run)))
    assert {f.kind for f in report.errors_and_warnings} >= {"one-off event"}
    assert len(report.repaired_all.t) < len(report.repaired_unasked.t) <= len(run.t)
    repaired = [f for f in report.issues if f.can_fix]
    done, left = report.changes("run.csv", repaired).split("Not repaired:")
    assert "Done: " in done
    assert "one-off event" not in done
    assert "one-off event" in left


@pytest.mark.parametrize(
    ("far", "kind"), [(-2.0 * np.pi, "position range"), (0.45, "encoder offset")]
)
def test_positions_beyond_a_straight_axis_name_it(far, kind):
    t = np.arange(0.0, 3.0, 0.005)
    q = 0.15 + 0.1 * np.sin(5.0 * t)[:, None]
    tau = -250.0 * np.sin(5.0 * t)[:, None] + 20.0 * np.sign(np.cos(5.0 * t))[:, None]
    (report,) = check("emps", Measurements(t, q + far, tau))
    assert [f.where for f in report.errors_and_warnings if f.kind == kind] == [
        "joint 1"
    ]


@pytest.fixture(scope="module")
def run(small):
    """The same at 250 samples a second: files of a quarter."""
    return small[1].rows(slice(None, None, 4))


#: Of the UR10e's eight runs: exciting, exciting with a knock, one joint alone.
SOME = ("12-50sec_12harm", "15harm50secLoad", "joint_2")


@pytest.mark.real_data
@pytest.mark.parametrize(
    ("which", "count"),
    [
        ("some of the UR10e", 3),
        pytest.param("others of the UR10e", 5, marks=pytest.mark.slow),
        pytest.param("EMPS and Panda", 3, marks=pytest.mark.long),
    ],
)
def test_silence_on_real_arms(which, count, panda_run):
    if which == "EMPS and Panda":
        runs = [("emps", run) for run in measured_runs("emps").values()]
        runs.append(("panda", panda_run))
    else:
        runs = [
            ("ur10e", run)
            for run in measured_runs("ur10e").values()
            if run.names[0].endswith(SOME) == (which == "some of the UR10e")
        ]
    assert len(runs) == count
    for name, run in runs:
        report = check(load_problem(name), run)[0]
        if (
            "joint_" in run.names[0]
        ):  # one joint moves alone: that, and nothing else, is a problem
            assert {f.kind for f in report.errors_and_warnings} == {
                "idle joints",
                "poor excitation",
            }
        else:
            # At 3062.75 s of this run joint 2's torque falls from 101 to 52 N m while
            # it moves smoothly.
            knocked = "15harm50secLoad" in run.names[0]
            found = [(f.kind, f.severity) for f in report.errors_and_warnings]
            assert found == knocked * [("one-off event", "warning")], (run.names, found)


def test_a_log_without_torque_is_checked_for_rows_clock_and_positions(two_link, run):
    groups = {"q": run.q, "qcmd": run.q}
    assert not check(two_link, Measurements.from_channels(run.t, groups, ("run",)))[
        0
    ].errors_and_warnings
    q = run.q.copy()
    q[2000:2600, 1] = q[2000, 1]
    (report,) = check(
        two_link, Measurements.from_channels(run.t, {**groups, "q": q}, ("run",))
    )
    assert [f.kind for f in report.errors_and_warnings] == ["frozen position"]
    assert "no torque was logged" in report.verdict


def test_a_joint_that_rests_between_two_moves_is_not_frozen(two_link):
    """From point to point, with an encoder that counts one by one."""
    t = np.arange(0.0, 16.0, 0.002)
    into = np.clip(t / 3.0, 0.0, 1.0)
    later = np.maximum(t - 4.2, 0.0)
    slow = 0.6 * (10.0 * into**3 - 15.0 * into**4 + 6.0 * into**5) - 0.3 * (
        1.0 - np.cos(1.5 * later)
    )
    slow = np.round(slow * 2**15) / 2**15
    q, tau = (
        np.column_stack([np.sin(3.0 * t), slow]),
        np.column_stack([np.cos(t), np.sin(t)]),
    )
    run = Measurements(t, q, tau)
    assert "frozen position" not in [issue.kind for issue in mended(run, two_link)[0]]


@pytest.mark.parametrize("samples", [1, 2, 5, 40])
def test_short_runs_are_findings(samples, simulated):
    problem, run = simulated
    report = check(problem, run.rows(np.arange(5000, 5000 + samples)))[0]
    assert report.meaningless
    assert {f.kind for f in report.errors_and_warnings} <= {
        "too little data",
        "no motion",
    }


def test_the_verb(tmp_path, two_link, capsys, run):
    """A fact: exit code 1, and a mended copy that is clean; the original stays as it
    was."""
    good, bad, mended = (tmp_path / f"{name}.csv" for name in ("good", "bad", "mended"))
    save(run, good)
    save(spiked(run), bad)
    before = bad.read_bytes()
    two = ("check", "two_link", "--data")
    assert run_cli(*two, bad, "--fix", mended) == 1
    shown = capsys.readouterr().out
    assert "How sure: likely" in shown
    assert "What to do: delete these rows (--fix does it)" in shown
    assert bad.read_bytes() == before
    assert len(load_measurements(mended).t) == len(run.t) - len(SPIKES)
    note = (tmp_path / "mended_changes.txt").read_text()
    assert "Done: delete these rows" in note
    assert run_cli(*two, mended) == 0
    assert run_cli(*two, bad, "--fix", bad) == 2
    assert run_cli(*two, good, bad, "--fix", tmp_path / "all") == 1
    assert sorted(p.name for p in (tmp_path / "all").iterdir()) == [
        "bad.csv",
        "bad_changes.txt",
        "good.csv",
        "good_changes.txt",
    ]


def test_the_verdict_says_what_is_corrected_before_the_share_is_taken(two_link, run):
    """A sign that is turned leaves much as logged, and little when it is turned back."""
    good = report_of_run(two_link, run)
    bad = report_of_run(two_link, FLIPPED(run))
    assert "corrected" not in good.verdict
    assert ": 1 problem; with torque sign corrected, the arm's dynamics leave" in (
        bad.verdict
    )
    assert bad.unexplained == pytest.approx(good.unexplained, rel=0.1)
    assert bad.to_dict()["corrected"] == ["torque sign"]


def test_the_verdict_names_facts_that_are_corrected(two_link, run):
    report = report_of_run(two_link, spiked(run))
    assert "; with spikes corrected, the arm's" in report.verdict


SPIKES = [700, 1900, 2600]


def spiked(run):
    tau = run.tau.copy()
    tau[SPIKES, 1] += 1e4
    return replace(run, tau=tau)


def test_an_explanation_is_a_warning_and_no_repair(tmp_path, two_link, capsys, run):
    """What a model says of a log is said, and neither refused nor written."""
    bad = tmp_path / "bad.csv"
    mended = tmp_path / "mended.csv"
    out = tmp_path / "out.json"
    save(FLIPPED(run), bad)
    two = "check", "two_link", "--data"
    assert run_cli(*two, bad, "--json", out, "--fix", mended) == 2
    shown, said = capsys.readouterr()
    assert "flip the sign of tau2" in shown
    assert "name it with --apply sign:tau2; nothing was written." in said
    assert not mended.exists()
    report = json.loads(out.read_text())["runs"][0]
    assert report["meaningless"] is False
    issue = report["findings"][0]
    assert issue["kind"] == "torque sign"
    assert (issue["nature"], issue["severity"]) == ("explanation", "warning")
    assert issue["figures"]["joints"] == [2]
    assert issue["can_fix"] is False


def test_no_copy_is_written_of_a_log_that_is_not_repaired(
    tmp_path, two_link, capsys, run
):
    """One without a problem, and one with a gap, which nothing mends."""
    good, gap, copy = (tmp_path / name for name in ("good.csv", "gap.csv", "copy.csv"))
    save(run, good)
    is_kept = (run.t < 4.0) | (run.t > 5.0)
    save(run.rows(is_kept), gap)
    two = "check", "two_link", "--fix", copy, "--data"
    assert run_cli(*two, good) == 0
    assert "Nothing was to be repaired. No copy was written." in capsys.readouterr().out
    assert run_cli(*two, gap) == 2
    assert "cannot repair this (gap in time)" in capsys.readouterr().err
    assert not copy.exists()


def test_an_explanation_is_never_an_error():
    words = dict(kind="k", where="w", what="x", certainty=likely("x"), remedy="r")
    with pytest.raises(ValueError, match="never an error"):
        Issue(**words, severity="error", nature="explanation")
    assert Issue(**words, severity="error").nature == "fact"


def test_identify_goes_on_where_an_explanation_is_given(
    tmp_path, two_link, capsys, run
):
    """It says so in one line that names what it looks like."""
    bad = tmp_path / "bad.csv"
    model = tmp_path / "model.json"
    save(FLIPPED(run), bad)
    to = ("--method", "ols", "--out", model)
    assert run_cli("identify", "two_link", "--data", bad, *to) == 0
    assert model.exists()
    said = " ".join(capsys.readouterr().err.split())
    assert said.count("warning:") == 1
    assert "the torque of joint 2 has the wrong sign" in said
    assert "--apply sign:tau2" in said


def test_identify_refuses_meaningless_data_by_itself(tmp_path, two_link, capsys, run):
    """In one sentence and without a model, unless it is told not to check."""
    bad = tmp_path / "bad.csv"
    good = tmp_path / "good.csv"
    model = tmp_path / "model.json"
    save(spiked(run), bad)
    save(run, good)
    to = ("--method", "ols", "--out", model)
    assert run_cli("identify", "two_link", "--data", bad, *to) == 2
    said = capsys.readouterr().err
    assert not model.exists()
    assert len(said.splitlines()) == 1
    for words in (
        "bad.csv: tau2 is far from the samples on both sides in 3 rows",
        "--fix",
        "--no-check",
    ):
        assert words in said
    assert run_cli("identify", "two_link", "--data", bad, "--no-check", *to) == 0
    assert model.exists()
    # Whoever wanted that model is not asked again about the same runs; about others
    # they are.
    consents = [
        consented(load_estimate(model), load_measurements(path)) for path in (bad, good)
    ]
    assert consents == [True, False]
    assert run_cli("identify", "two_link", "--data", good, *to) == 0
    assert not consented(load_estimate(model), load_measurements(good))


@pytest.fixture(scope="module")
def clean_model(small):
    """A model of runs in which the check finds nothing."""
    return identify(*small, "ols")


#: An issue as files have it.
WARNING = {
    "kind": "torque sign",
    "severity": "warning",
    "where": "joint 1",
    "what": "it counts the other way",
    "certainty": {"grade": "likely", "why": "an arm leaves less"},
    "remedy": "flip it",
}


@pytest.mark.parametrize(
    ("provenance", "is_asked"),
    [
        ({}, False),
        ({"versions": {"sdp_vs_penalty": "0.0"}}, True),
        ({"checks": {}}, True),
        ({"checks": {"another run": []}}, True),
        ({"checks": {"this run": [WARNING]}}, True),
    ],
    ids=["clean", "another version", "no result", "other runs", "a warning"],
)
def test_runs_are_checked_again_unless_this_check_found_them_clean(
    provenance, is_asked, clean_model, small
):
    run = small[1]
    if "this run" in provenance.get("checks", {}):
        provenance = {"checks": {run.data_hash: provenance["checks"]["this run"]}}
    known = {**clean_model.provenance, **provenance}
    assert needs_check(replace(clean_model, provenance=known), run) == is_asked
    assert needs_check(clean_model, run.window(0.0, 5.0))
    assert needs_check(clean_model.with_gravity((0.0, 9.81, 0.0)), run)


@pytest.mark.parametrize(
    "spoil", [still, lambda run: run.rows(np.arange(len(run.t)) < 150)]
)
def test_a_run_without_rows_is_named_once(spoil, tmp_path, two_link, capsys):
    path = tmp_path / "lame.csv"
    save(spoil(experiment(two_link).training_run(0)), path)
    assert run_cli("check", "two_link", "--data", path) == 1
    assert capsys.readouterr().out.count("lame.csv") == 1
    assert (
        run_cli(
            "identify", "two_link", "--data", path, "--out", tmp_path / "model.json"
        )
        == 2
    )
    said = capsys.readouterr().err
    assert len(said.splitlines()) == 1
    assert said.count("lame.csv") == 1
    assert said.count(": record") == 1


#: What a problem says wrongly : (field, value, effort limits known, kind of the
#: finding, its words)
WRONG_PROBLEMS = {
    "no gravity": ("gravity", (0.0, 0.0, 0.0), True, "gravity of the problem", ""),
    "gravity in mm/s^2": (
        "gravity",
        (0, 0, -9810.0),
        True,
        "gravity of the problem",
        "",
    ),
    "too light": (
        "total_mass",
        (0.5, 1.0),
        True,
        "masses of the problem",
        "masses are wrong",
    ),
    "too heavy": (
        "total_mass",
        (900.0, 1000.0),
        True,
        "masses of the problem",
        "masses are wrong",
    ),
    "too light, no limits": (
        "total_mass",
        (0.5, 1.0),
        False,
        "torque unit",
        "0.5 to 1 kg",
    ),
    "too heavy, no limits": (
        "total_mass",
        (900.0, 1e3),
        False,
        "torque channel kind",
        "900 to 1000 kg",
    ),
}


MARKS = dict.fromkeys(
    ("no gravity", "too heavy", "too light, no limits"), pytest.mark.long
) | {"gravity in mm/s^2": pytest.mark.slow}


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=MARKS.get(name, ())) for name in WRONG_PROBLEMS]
)
def test_a_wrong_problem_is_named_rather_than_the_data(name, simulated):
    """Where effort limits witness the torques' size, masses are doubted; torques are
    never rescaled."""
    problem, run = simulated
    field, value, limits, kind, words = WRONG_PROBLEMS[name]
    joints = problem.robot.joints
    if not limits:
        joints = tuple(replace(joint, effort=np.inf) for joint in joints)
    wrong = replace(problem, robot=replace(problem.robot, joints=joints))
    wrong = (
        wrong.with_gravity(value)
        if field == "gravity"
        else replace(wrong, total_mass=value)
    )
    report = report_of_run(wrong, run)
    (finding,) = report.errors_and_warnings
    assert finding.kind == kind
    assert words in finding.what
    if (
        field == "gravity"
    ):  # the direction is stated as measured, at the length of gravity
        stated = re.search(r"points along \((.+), (.+), (.+)\) m/s\^2", finding.what)
        assert np.allclose(
            [float(x) for x in stated.groups()], (0.0, 0.0, -9.81), atol=0.03
        )
    assert (
        "masses" in finding.remedy
        or field == "gravity"
        or "total_mass" in finding.remedy
    )
    assert report.repaired_all.tau is run.tau


@pytest.mark.long
def test_a_slow_log_keeps_its_seconds(simulated):
    """Few samples a second are a finding of their own, a quasi-static motion is none."""
    problem, run = simulated
    slow = replace(run, t=run.t[0] + 50.0 * (run.t - run.t[0]))
    for changed in (sparse(run), slow):
        kinds = {f.kind for f in report_of_run(problem, changed).issues}
        assert "time unit" not in kinds


@pytest.mark.parametrize(
    ("gains", "said"),
    [
        (
            (9.51, 11.6, 9.51),
            "9.5 N m per A, one for all joints but joint 2 (12, by the torques' ratio)",
        ),
        ((9.51,), "9.5 N m per A"),
        ((9.5, 9.52), "9.5 N m per A, one for all joints"),
        ((9.5, 11.0, 7.0), "9.5, 11 and 7 N m per A, each by the torques' ratios"),
    ],
)
def test_gains_by_size_are_said_as_surely_as_they_are(gains, said):
    assert _gains_in_words(gains, "N m per A") == said
