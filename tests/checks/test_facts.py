"""Facts about clock and channels that hold whatever the arm: each kind in variants."""

from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from arms import SCARA, write_urdf
from judged import likely_issue, report_of_run
from small_runs import small_run

from sdp_vs_penalty import InputError, Measurements, check, load_problem
from sdp_vs_penalty.checks import Issue, fixing, mended
from sdp_vs_penalty.checks.certainty import likely, stated
from sdp_vs_penalty.checks.clock import find_coarse_stamps
from sdp_vs_penalty.checks.facts.lockstep import LockstepMotion, lockstep_groups
from sdp_vs_penalty.checks.fixing import fix_runs
from sdp_vs_penalty.checks.glance import RunSummary
from sdp_vs_penalty.checks.issue import make_explanation, mended_unasked
from sdp_vs_penalty.checks.position_units import units_as_facts
from sdp_vs_penalty.checks.velocity import find_wrong_velocities
from sdp_vs_penalty.data import concatenate
from sdp_vs_penalty.data.hypotheses.by_arm import likeliest_scale
from sdp_vs_penalty.effects import Motion
from sdp_vs_penalty.robot import LinkSizes, odd_units

PROBLEM = load_problem("two_link")
RUN = small_run(PROBLEM, seconds=8.0)


def summary(run):
    return RunSummary(run, PROBLEM)


def kinds(run):
    return [x.kind for x in mended(run, PROBLEM)[0]]


def coarse(run, step):
    return replace(run, t=np.round(run.t / step) * step)


@pytest.mark.parametrize("times", [1.7, 2.0, 5.0])
@pytest.mark.parametrize("begin", [0.0, 1.7e9])
def test_coarse_stamps_are_spaced_evenly_and_no_row_is_lost(times, begin):
    step = times * float(np.median(np.diff(RUN.t)))
    log = replace(coarse(RUN, step), dq=None)
    log = replace(log, t=log.t + begin)
    issues, _ = mended(log, PROBLEM)
    fixed = mended_unasked(log, issues)
    assert [x.kind for x in issues] == ["coarse time stamps"]
    assert len(fixed.t) == len(RUN.t)
    even = np.diff(RUN.t)
    np.testing.assert_allclose(np.diff(fixed.t), even.mean(), rtol=2e-3)


@pytest.mark.parametrize("first", [0.0, 0.3, 1.7e9 + 0.9])
def test_whole_seconds_give_the_rate_that_is_said_and_written(first):
    """The last second is cut short."""
    t = first + 0.002 * np.arange(2300)
    q = np.sin(np.outer(t - first, [1.0, 2.0]))
    written = Measurements.from_channels(
        np.floor(t), {"q": q, "tau": 10.0 * q}, ("log",)
    )
    (issue,) = find_coarse_stamps(summary(written))
    assert "samples come every 0.002 s" in issue.what
    assert issue.figures["step"] == pytest.approx(0.002, rel=1e-4)
    np.testing.assert_allclose(np.diff(issue.repair(written).t), 0.002, atol=1e-6)


@pytest.mark.parametrize(("travel", "moves"), [(0.08, True), (0.01, False)])
def test_a_slide_moves_along_its_range_beside_wide_turns(travel, moves):
    """A finger of 45 mm that moved by 32 was held, for certain: radians beside metres."""
    problem = load_problem(Path(__file__).parents[1] / "helpers/slide_arm.urdf")
    t = 0.01 * np.arange(800)
    wide = 1.9 * np.sin(np.outer(t, [1.0, 1.3, 1.7]))
    q = np.column_stack([wide[:, 0], 0.2 + 0.5 * travel * np.sin(2.0 * t), wide[:, 2]])
    run = Measurements.from_channels(t, {"q": q, "tau": wide}, ("log",))
    assert RunSummary(run, problem).moving.tolist() == [True, moves, True]


def late(samples):
    return replace(RUN, dq=np.roll(RUN.dq, samples, axis=0))


#: A log whose velocity is not the derivative of its position, or not quite, and what is
#: said of it: kind, severity, and a figure.
VELOCITIES = {
    "as it is": (RUN, None),
    **{
        f"a clock times {x}": (
            replace(RUN, t=x * RUN.t),
            ("clock against velocity", "warning", "factor", 1.0 / x),
        )
        for x in (0.1, 0.5, 0.95, 1.05, 2.0, 10.0)
    },
    **{
        f"filtered to {x}": (
            replace(RUN, dq=x * RUN.dq),
            ("velocity scale", "note", "factor", x),
        )
        for x in (0.9, 0.95)
    },
    **{f"{k} samples late": (late(k), None) for k in (-4, 12)},
    **{
        f"in {unit}": (
            replace(RUN, dq=x * RUN.dq),
            ("velocity unit", "note", "factor", x),
        )
        for unit, x in (
            ("degrees", 180.0 / np.pi),
            ("turns a minute", 30.0 / np.pi),
            ("turns a minute, positions in degrees", 1.0 / 6.0),
            ("turns a minute, positions in turns", 60.0),
        )
    },
}


@pytest.mark.parametrize("name", VELOCITIES)
def test_a_velocity_that_is_not_the_derivative_is_told(name):
    """By the clock where all joints are off by one factor; never by dynamics."""
    run, told = VELOCITIES[name]
    found = [*find_wrong_velocities(summary(run))]
    assert len(found) == (told is not None)
    for issue in found:
        kind, severity, figure, value = told
        assert (issue.kind, issue.severity) == (kind, severity)
        assert issue.figures[figure] == pytest.approx(value, rel=0.02)


@pytest.mark.parametrize(
    ("clock", "ratio", "grade", "mends"),
    [
        (1.05, 1.0, "likely", True),  # 95.2 rows a second; without the factor 100
        (2.0, 1.0, "possible", False),  # 50 and 100: both are usual
        (1.0, 0.5, "possible", False),
        (1.037, 1.15, "possible", False),  # neither is
    ],
)
def test_a_clock_is_mended_where_its_rate_says_so_too(clock, ratio, grade, mends):
    """A velocity of 0.9 and 0.95 of the derivative, behind a filter, was a wrong clock for
    certain, and `--fix` stretched it."""
    run = replace(RUN, t=clock * RUN.t, dq=ratio * RUN.dq)
    (issue,) = find_wrong_velocities(summary(run))
    assert issue.certainty.grade == grade
    assert (issue.repair is not None) == bool(issue.apply) == mends
    assert not issue.can_fix


@pytest.mark.parametrize(
    ("ratio", "grade"),
    [
        (180.0 / np.pi, "certain"),
        (30.0 / np.pi, "likely"),  # a clock ten times too slow, 5 % off
        (1.02 * 180.0 / np.pi, "likely"),
        (1.1, None),
        (0.9, None),
    ],
)
def test_a_unit_of_velocity_is_as_sure_as_its_odds(ratio, grade):
    """A ratio of 1.1 was an encoder's counts for certain, where no name said a unit: a clock
    at another rate and a filter make it far more often."""
    for unit_command in ("", "convert --units q=UNIT"):
        run = replace(RUN, dq=ratio * RUN.dq, unit_command=unit_command)
        (issue,) = find_wrong_velocities(summary(run))
        assert (issue.kind == "velocity unit") == (grade is not None)
        if grade is not None and not unit_command:
            assert issue.certainty.grade == grade


def test_a_velocity_of_the_other_sign_is_not_late():
    """Rows of two UR10e's logs in reverse were said to have velocities .4 s late."""
    found = [*find_wrong_velocities(summary(replace(RUN, dq=-RUN.dq)))]
    assert found
    assert "velocity lag" not in {issue.kind for issue in found}


@pytest.mark.parametrize("name", ["q", "tau"])
def test_a_channel_without_numbers_is_named_and_no_row_is_deleted(name):
    values = getattr(RUN, name).copy()
    values[:, 1] = np.nan
    log = replace(RUN, **{name: values})
    issues, _ = mended(log, PROBLEM)
    fixed = mended_unasked(log, issues)
    assert [(x.kind, x.where) for x in issues] == [
        ("channel without numbers", f"{name}2")
    ]
    assert len(fixed.t) == len(RUN.t)


@pytest.mark.parametrize("low", [0.0, -180.0])
def test_degrees_that_wrap_are_one_fact(low):
    """In 0..360 or in +-180: unwrapped, in radians, and within the range."""
    t = np.arange(0.0, 8.0, 0.004)
    q = np.column_stack([1.2 * np.sin(1.7 * t), 1.4 * np.cos(2.3 * t)])
    turned = np.degrees(q + (np.pi if low else 0.0))
    log = Measurements(t, (turned - low) % 360.0 + low, np.cos(q))
    issues, _ = mended(log, PROBLEM)
    fixed = mended_unasked(log, issues)
    (issue,) = [x for x in issues if x.kind == "positions in degrees"]
    assert "wrapped" in issue.what
    np.testing.assert_allclose(np.diff(fixed.q, axis=0), np.diff(q, axis=0), atol=1e-9)


@pytest.mark.parametrize(
    ("rival", "kinds_left", "grade"),
    [
        (None, ["positions in degrees"], "certain"),
        ("gear ratio", ["position unit not said"], "possible"),
        ("position scale", ["position unit not said"], "possible"),
    ],
)
def test_degrees_beside_a_factor_of_gears_are_not_certain(rival, kinds_left, grade):
    """The ranges allow either, and motors' angles; the torques' factor decides."""
    told = make_explanation(
        "positions in degrees",
        "q is in degrees.",
        remedy="",
        certainty=likely("fits"),
        joints=range(7),
        log_odds=100.0,
        position_unit="degrees",
    )
    rivals = (
        [replace(told, kind=rival, position_unit=None, of_positions="factor")]
        if rival
        else []
    )
    judged = units_as_facts([told, *rivals], True, None)
    assert [x.kind for x in judged] == kinds_left
    assert judged[0].certainty.grade == grade


@pytest.mark.parametrize("every", [8, 50])
def test_a_logger_that_changed_its_rate_is_named(every):
    fast = small_run(PROBLEM, seconds=8.0, rate=500.0)
    log = fast.rows(np.r_[0:1500, 1500:2500:every, 2500 : len(fast.t)])
    found = kinds(log)
    assert "change of rate" in found
    assert "clock step" not in found


def test_joints_in_proportion_are_named_with_the_rank_of_the_motion():
    t = np.arange(0.0, 8.0, 0.004)
    move = np.sin(1.7 * t) + 0.3 * np.cos(4.0 * t)
    run = Measurements(t, np.column_stack([move, 0.4 * move]), np.ones((len(t), 2)))
    lockstep = LockstepMotion.find_in(summary(run))
    issue = lockstep.issue()
    assert issue.figures["rank"] == 1
    assert issue.figures["groups"] == [[1, 2]]
    assert lockstep.is_poor
    assert LockstepMotion.find_in(summary(RUN)) is None


def test_a_joint_is_in_one_group_of_joints_in_proportion():
    """Each is like its neighbours, and the first not quite like the third."""
    t = np.arange(0.0, 10.0, 0.01)
    q = np.column_stack([np.sin(t + phase) for phase in (0.0, 0.09, 0.18)])
    assert lockstep_groups(q) == [[0, 1]]


def test_a_log_without_rows_has_no_rows():
    (report,) = check(PROBLEM, RUN.rows(np.arange(0)))
    assert [x.kind for x in report.issues] == ["no rows"]


LINKS = [LinkSizes(f"l{k}", 4.0, 0.12, 0.03) for k in range(3)]


@pytest.mark.parametrize(
    ("change", "longest", "quantity", "unit"),
    [
        ({"inertia": 0.03 * 1e4}, 0.4, "inertias", "kg cm^2"),
        ({"inertia": 0.03 * 1e6}, 0.4, "inertias", "kg mm^2"),
        ({"mass": 4e3, "inertia": 0.03 * 1e7}, 0.4, "inertias", "g cm^2"),
        ({"mass": 4e3, "inertia": 0.03 * 1e9}, 0.4, "inertias", "g mm^2"),
        ({"com": 20.0}, 0.4, "centres of mass", "cm"),
        ({"com": 120.0}, 0.4, "centres of mass", "mm"),
        ({"mass": 4e3}, 0.4, "masses", "g"),
        ({}, 40.0, "lengths", "cm"),
        ({}, 400.0, "lengths", "mm"),
    ],
)
def test_units_of_links_are_named(change, longest, quantity, unit):
    """A unit that fits is named; the first is that of the file's masses."""
    links = [replace(x, **change) for x in LINKS]
    (odd,) = [x for x in odd_units(links, longest) if x.quantity == quantity]
    named = odd.what.split(" look like ")[1].split(",")[0].split(" or ")
    assert named[0] == unit


def test_where_two_units_fit_no_single_factor_is_told():
    """116 may be 0.116 m in mm and 1.16 m in cm."""
    (odd, *_) = odd_units(LINKS, 116.0)
    assert "mm or cm" in odd.what
    assert odd.remedy.startswith("look up the unit")


def test_a_unit_that_nobody_knows_has_no_factor():
    """JSON knows no NaN: a number that is not known is null there."""
    links = [replace(x, inertia=1e14) for x in LINKS]
    (odd,) = [x for x in odd_units(links, 0.4) if x.quantity == "inertias"]
    assert odd.factor is None
    assert "not known" in odd.what


def test_one_mass_in_grams_is_found_among_kilograms():
    links = [LINKS[0], replace(LINKS[1], mass=2500.0), LINKS[2]]
    (odd, *_) = odd_units(links, 0.4)
    assert (odd.quantity, odd.links) == ("masses", ("l1",))


@pytest.mark.parametrize("size", [0.03, 0.3, 3.0])
def test_arms_of_all_sizes_are_in_metres_and_kilograms(size):
    """From a toy to an excavator."""
    links = [LinkSizes("l", 50.0 * size**2, 0.4 * size, 4.0 * size**4)]
    assert not [*odd_units(links, size)]


def flipped(run):
    return replace(run, tau=run.tau * np.array([1.0, -1.0]))


def fixed(log, *words):
    """What `--fix` makes of a log, with repairs that are named."""
    return fix_runs(PROBLEM, [log], check(PROBLEM, log, thorough=False), words)


def test_a_named_explanation_is_applied_where_it_lowers_the_error():
    log = flipped(RUN)
    repaired = fixed(log, "sign:tau2")
    np.testing.assert_array_equal(repaired.runs[0].tau, RUN.tau)
    assert repaired.left_out.before is not None
    assert repaired.left_out.after is not None
    assert repaired.left_out.after < 0.5 * repaired.left_out.before


def test_a_repair_that_raises_the_error_is_not_written():
    report = report_of_run(PROBLEM, RUN)
    sign = "torque sign", "warning", "joint 2", "sign:tau2"
    wrong = likely_issue(*sign, nature="explanation", repair=flipped)
    with pytest.raises(InputError, match="does not lower the error"):
        fix_runs(PROBLEM, [RUN], [replace(report, issues=(wrong,))], ["sign:tau2"])


def test_a_log_that_is_refused_is_repaired_although_its_error_stays():
    """Refused as it is, and refused a repair, it would have no way out."""
    report = report_of_run(PROBLEM, RUN)
    clock = likely_issue("time unit", "error", "column t", "time:ms", repair=flipped)
    reports = [replace(report, issues=(clock,))]
    (run,) = fix_runs(PROBLEM, [RUN], reports, ["time:ms"]).runs
    np.testing.assert_array_equal(run.tau, flipped(RUN).tau)


def test_logged_velocities_are_certain_of_milliseconds():
    log = replace(RUN, t=1e3 * RUN.t)
    issue = next(x for x in mended(log, PROBLEM)[0])
    assert (issue.kind, issue.certainty.grade) == ("time unit", "certain")
    assert "the logged velocities give 0.0100" in str(issue.certainty)


def test_a_repair_after_which_the_check_finds_the_same_is_refused(monkeypatch):
    """A repair that changes nothing would be tried again and again."""
    monkeypatch.setattr(fixing, "_PASSES", 0)
    tau = RUN.tau.copy()
    tau[300, 1] += 1e3
    log = replace(RUN, tau=tau)
    report = report_of_run(PROBLEM, log)
    unchanged = replace(report, repaired_unasked=log)
    with pytest.raises(InputError, match=r"spikes .* could not be mended"):
        fix_runs(PROBLEM, [log], [unchanged])


def test_a_fault_that_hides_smaller_ones_is_repaired_with_them():
    tau = RUN.tau.copy()
    for row, size in ((300, 1e9), (500, 1e5), (700, 1e3)):
        tau[row, 1] += size
    log = replace(RUN, tau=tau)
    repaired = fixed(log)
    again = report_of_run(PROBLEM, repaired.runs[0])
    assert "spikes" not in [f.kind for f in again.errors_and_warnings]


def test_a_short_freeze_is_repaired():
    """Both errors are those behind the same filters: rows that go change no band."""
    tau = RUN.tau.copy()
    is_frozen = (RUN.t > 4.0) & (RUN.t < 4.7)
    tau[is_frozen, 1] = tau[np.argmax(is_frozen), 1]
    log = replace(RUN, tau=tau)
    repaired = fixed(log)
    assert [f.kind for f in repaired.issues[0]] == ["frozen torque"]
    assert len(repaired.runs[0].t) == pytest.approx(len(RUN.t) - is_frozen.sum(), abs=2)


def test_a_repair_drops_no_more_than_a_tenth():
    q, tau = RUN.q.copy(), RUN.tau.copy()
    some = slice(300, 300 + len(q) // 4)
    q[some], tau[some] = q[300], tau[300]
    log = replace(RUN, q=q, tau=tau, dq=None)
    with pytest.raises(InputError, match="drop"):
        fixed(log)


def test_a_word_that_no_report_has_is_refused_with_those_it_has():
    with pytest.raises(InputError, match="sign:tau2"):
        fixed(flipped(RUN), "gain:tau1")


def test_a_sign_of_the_logger_is_said_of_all_runs():
    second = replace(small_run(PROBLEM, seconds=8.0, seed=4), names=("b",))
    runs = concatenate([flipped(RUN), flipped(second)])
    said = [
        [(f.kind, f.where) for f in r.errors_and_warnings]
        for r in check(PROBLEM, runs, thorough=False)
    ]
    assert said == [[("torque sign", "joint 2")]] * 2


def test_the_weight_alone_is_a_model_and_no_torque():
    robot = PROBLEM.robot
    links = PROBLEM.nominal_links.ravel()
    zero = np.zeros_like(RUN.q)
    log = replace(RUN, tau=robot.inverse_dynamics(links, RUN.q, zero, zero), dq=None)
    report = report_of_run(PROBLEM, log)
    assert "gravity model" in [f.kind for f in report.errors_and_warnings]


def test_an_instant_over_the_effort_limit_is_no_other_unit():
    panda = load_problem("panda")
    run = small_run(panda, seconds=8.0)
    tau = run.tau.copy()
    tau[500:502, 6] += 5.0 * panda.robot.joints[6].effort  # where a move begins
    report = report_of_run(panda, replace(run, tau=tau, dq=None))
    assert "torque unit" not in [f.kind for f in report.issues]


def test_a_motion_that_needs_more_than_a_limit_is_no_other_unit():
    """A limit of a twentieth of the torque, as of a simulator that has none."""
    panda = load_problem("panda")
    run = small_run(panda, seconds=8.0)
    joints = list(panda.robot.joints)
    joints[1] = replace(joints[1], effort=np.abs(run.tau[:, 1]).max() / 20.0)
    limited = replace(panda, robot=replace(panda.robot, joints=tuple(joints)))
    report = report_of_run(limited, replace(run, dq=None))
    assert "torque unit" not in [f.kind for f in report.issues]


@pytest.mark.parametrize("largest", [1000.0, 30_000.0])
def test_torques_in_whole_numbers_are_counts(largest):
    """Permil of the rated torque, or counts of an encoder of current."""
    scale = largest / np.abs(RUN.tau).max(axis=0)
    log = replace(RUN, tau=np.round(RUN.tau * scale), dq=None)
    report = report_of_run(PROBLEM, log)
    (issue,) = [f for f in report.errors_and_warnings if f.kind == "torque in counts"]
    assert ("permil" in issue.what) == (largest <= 4000.0)
    assert "torque unit" not in [f.kind for f in report.issues]


def test_what_a_subtracted_model_leaves_is_external_torque():
    """An observer's error: it follows neither weight nor inertia."""
    rng = np.random.default_rng(1)
    error = np.cumsum(rng.normal(size=RUN.tau.shape), axis=0)
    error = 0.01 * error / np.abs(error).max(axis=0)
    log = replace(RUN, tau=error, dq=None)
    report = report_of_run(PROBLEM, log)
    assert "external torque" in [f.kind for f in report.errors_and_warnings]


@pytest.mark.parametrize("gravity", [(0.0, 0.0, -9.81), (9.81, 0.0, 0.0)])
@pytest.mark.parametrize("share", [0.97, 1.02])
def test_what_is_left_of_a_model_that_fits_nearly_is_external_torque(gravity, share):
    """It resembles the arm's weight; of signs and mounting nothing is said."""
    problem = PROBLEM.with_gravity(gravity)
    run = small_run(problem, seconds=8.0)
    ddq = np.gradient(run.dq, run.t, axis=0)
    links = problem.nominal_links.ravel()
    of_the_arm = problem.robot.inverse_dynamics(links, run.q, run.dq, ddq)
    left = (1.0 - share) * of_the_arm
    drift = np.cumsum(np.random.default_rng(3).normal(size=left.shape), axis=0)
    error = 0.4 * left.std() * drift / drift.std(axis=0)
    log = replace(run, tau=left + error - 0.005 * np.sign(run.dq), dq=None)
    report = report_of_run(problem, log)
    explanations = [f.kind for f in report.issues if f.nature == "explanation"]
    assert explanations == ["external torque"]


def test_positions_out_of_reach_end_the_judging_of_torques():
    """Nothing is said of the torques beside the error about positions, here of turns that
    were counted on."""
    joints = [replace(x, lower=-3.0, upper=3.0) for x in PROBLEM.robot.joints]
    robot = replace(PROBLEM.robot, joints=tuple(joints))
    q = RUN.q.copy()
    q[:, 1] += 12.0 * np.pi
    log = replace(RUN, q=q, dq=None)
    report = report_of_run(replace(PROBLEM, robot=robot), log)
    assert "position range" in [f.kind for f in report.issues]
    assert {f.nature for f in report.issues} == {"fact"}


@pytest.mark.parametrize(
    ("units", "named"),
    [
        ([1e3, 1e3, 180.0 / np.pi], "mm:mm:deg:deg:deg:deg:deg"),
        ([1e3, 1e3, 1.0], "mm:mm:rad:rad:rad:rad:rad"),
        ([1.0, 1.0, 1.0], ""),
        ([1e5, 1.0, 1.0], ""),
    ],
)
def test_the_usual_units_of_positions_that_cannot_be(units, named):
    robot = load_problem("panda").robot
    slide = partial(replace, kind="prismatic", lower=-1.0, upper=1.0)
    joints = (*map(slide, robot.joints[:2]), *robot.joints[2:])
    robot = replace(robot, joints=joints)
    q = np.array([[0.2, 0.9, -2.5, -1.0, 0, 1.5, 0], [0.9, -0.3, 1.8, -2.0, 0, 2.0, 0]])
    run = Measurements(np.arange(2.0), q * [*units[:2], *5 * [units[2]]], 0.0 * q)
    assert likeliest_scale(robot, run, None) == named


def test_an_order_that_makes_positions_possible_is_said_beside_their_range():
    """The second joint's positions are far outside the first joint's range."""
    q = RUN.q + np.array([0.0, 9.0])
    joints = list(PROBLEM.robot.joints)
    joints[0] = replace(joints[0], lower=-1.5, upper=1.5)
    joints[1] = replace(joints[1], lower=8.0, upper=10.0)
    problem = replace(PROBLEM, robot=replace(PROBLEM.robot, joints=tuple(joints)))
    model = problem.model()
    theta = problem.nominal(model)
    theta[len(model.rigid_indices) :] = 0.5
    ddq = np.gradient(RUN.dq, RUN.t, axis=0)
    tau = model.torque(theta, Motion(RUN.t, q, RUN.dq, ddq))
    log = Measurements(RUN.t, q[:, ::-1].copy(), tau)
    report = report_of_run(problem, log)
    kinds_said = [f.kind for f in report.issues]
    assert kinds_said[:2] == ["position range", "position order"]


def test_a_fact_is_mended_unasked_where_its_repair_is_safe_or_certain():
    issue = Issue(
        kind="k",
        severity="warning",
        where="w",
        what="x",
        certainty=stated("read from the file"),
        remedy="r",
        repair=flipped,
    )
    assert issue.can_fix
    assert str(issue.certainty) == "certain: read from the file"
    written = issue.to_dict()["certainty"]
    assert written == {"grade": "certain", "why": "read from the file"}
    of_values = replace(issue, certainty=likely("certain: but for a few"))
    assert of_values.can_fix
    assert not replace(of_values, apply="unit:tau").can_fix


def test_a_rail_in_mm_beside_degrees_is_likely(tmp_path):
    """A rail's own columns explain its torque in any unit of its positions."""
    problem = load_problem(write_urdf(tmp_path / "scara.urdf", "scara", SCARA))
    wide = [replace(x, lower=-0.6, upper=0.6) for x in problem.robot.joints]
    problem = replace(problem, robot=replace(problem.robot, joints=tuple(wide)))
    run = small_run(problem, seconds=8.0)
    log = Measurements(
        run.t, run.q * [*2 * [180.0 / np.pi], 1e3, 180.0 / np.pi], run.tau
    )
    grades = {f.kind: f.certainty.grade for f in report_of_run(problem, log).issues}
    assert grades["positions in mm"] == "likely"
    assert "positions in degrees" in grades


def test_a_unit_of_a_rail_is_never_certain():
    """Degrees of a rail are a factor as millimetres are."""
    said = {"remedy": "", "certainty": likely("fits"), "joints": [2]}
    told = make_explanation(
        "position unit", "q3", **said, position_unit="", log_odds=100.0
    )
    for rails, grade in (({3}, "likely"), ((), "certain")):
        (judged,) = units_as_facts([told], True, None, rails)
        assert judged.certainty.grade == grade
