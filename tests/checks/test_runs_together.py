"""Runs of one logger are judged together: what belongs to one run alone is claimed with
that run named, and nothing is said of the others."""

from dataclasses import replace

import numpy as np
import pytest
from corruptions.arms import drawn, simulated

from sdp_vs_penalty.checks import check
from sdp_vs_penalty.checks.explain import issue_of_difference
from sdp_vs_penalty.checks.fixing import fix_runs
from sdp_vs_penalty.checks.report import list_remedies
from sdp_vs_penalty.data import concatenate
from sdp_vs_penalty.race import Hypothesis, Likelihood, Number, Part
from sdp_vs_penalty.race.evidence import Evidence
from sdp_vs_penalty.race.race import Claim
from sdp_vs_penalty.race.records import LogView
from sdp_vs_penalty.race.rows import RegressionData
from sdp_vs_penalty.simulation import experiment

#: Of a torque, from the first row of a run to its last [N m].
DRIFT = 1.0


def run_of(problem, seed, name):
    """A run of the problem's arm at a quarter of the experiment's samples."""
    run = experiment(problem).training_run(seed)
    return replace(run.rows(slice(None, None, 4)), names=(name,))


@pytest.fixture(scope="module")
def runs(two_link):
    """Two runs of one arm."""
    return run_of(two_link, 0, "first"), run_of(two_link, 1, "second")


@pytest.fixture(scope="module")
def three_runs(two_link, runs):
    return [*runs, run_of(two_link, 2, "third")]


def scaled(run, joint, factor):
    """The run with the torque of one joint (from 1) so many times as large."""
    tau = run.tau.copy()
    tau[:, joint - 1] *= factor
    return replace(run, tau=tau)


def turned(run):
    """The run whose joint 2 counts the other way."""
    return replace(run, q=run.q * [1.0, -1.0])


def swapped(run):
    return replace(run, tau=run.tau[:, ::-1].copy())


def exchanged(run):
    return replace(run, q=run.q[:, ::-1].copy())


def geared(run, joint, ratio):
    """The run whose logger divided one joint (from 1) by another gear ratio."""
    factor = np.ones(run.n)
    factor[joint - 1] = ratio
    return replace(run, q=run.q * factor, tau=run.tau / factor)


def rows_of(run, problem):
    settings = problem.preprocessing.resolve(run)
    return Likelihood(problem, RegressionData.from_run(problem, run, settings))


def judged(problem, *runs):
    return check(problem, concatenate(runs), thorough=False)


def explanations(report):
    return [issue for issue in report.issues if issue.nature == "explanation"]


def test_the_run_is_repaired_where_its_sign_is_wrong(two_link, runs):
    bad, good = judged(two_link, runs[0], scaled(runs[1], 2, -1.0))[::-1]
    np.testing.assert_array_equal(bad.repaired_all.tau, runs[1].tau)
    np.testing.assert_array_equal(good.repaired_all.tau, runs[0].tau)


@pytest.mark.parametrize("count", [pytest.param(1, marks=pytest.mark.long), 2])
def test_a_drift_in_each_run_is_that_of_a_run_and_not_their_sum(count, two_link, runs):
    drifting = []
    for run in runs[:count]:
        ramp = (run.t - run.t[0]) / np.ptp(run.t)
        tau = run.tau + np.outer(ramp, [0.0, DRIFT])
        drifting.append(replace(run, tau=tau))
    for report in judged(two_link, *drifting):
        (issue,) = explanations(report)
        assert issue.kind == "torque drift"
        sizes = issue.figures.get("sizes", [issue.figures["size"]])
        assert len(sizes) == count
        assert sizes == pytest.approx([DRIFT] * count, rel=0.05)
        assert ("of a run to its last" in issue.what) == (count > 1)


def test_a_zero_of_one_run_is_named_with_its_size(two_link, runs):
    q = runs[0].q.copy()
    q[:, 1] += np.radians(4.0)
    moved = replace(runs[0], q=q, dq=None)
    bad, good = judged(two_link, moved, replace(runs[1], dq=None))
    issues = [*explanations(bad), *explanations(good)]
    (issue,) = issues
    assert issue.kind == "encoder offset"
    assert abs(issue.figures["size"]) == pytest.approx(np.radians(4.0), rel=0.1)
    assert "only: the zero of joint 2 is" in issue.what


def with_load(problem, run, mass):
    """The run with a mass [kg] held half a metre along the last link."""
    links = problem.nominal_links.copy()
    links[-1] += mass * np.array([1.0, 0.5, 0, 0, 0, 0, 0.25, 0, 0, 0.25])
    dq = np.gradient(run.q, run.t, axis=0)
    ddq = np.gradient(dq, run.t, axis=0)
    loaded, empty = (
        problem.robot.inverse_dynamics(x.ravel(), run.q, dq, ddq)
        for x in (links, problem.nominal_links)
    )
    return replace(run, tau=run.tau + loaded - empty)


def rubbing(run, of_speed):
    """The run with more friction of joint 2, a function of its speed."""
    speed = np.gradient(run.q[:, 1], run.t)
    more = np.sign(speed) * of_speed(np.abs(speed))
    return replace(run, tau=run.tau + np.outer(more, [0.0, 1.0]))


@pytest.mark.parametrize(
    ("changed", "kind"),
    [
        (lambda run: rubbing(run, lambda v: 1.0 + 0.0 * v), "another friction"),
        (lambda run: rubbing(run, lambda v: 2.0 * v), "another friction"),
        (lambda run: scaled(run, 2, 1.5), "torque gain"),
    ],
)
def test_friction_and_gain_of_one_run_are_told_apart(
    changed, kind, two_link, three_runs
):
    reports = judged(two_link, *three_runs[:2], changed(three_runs[2]))
    assert not [issue for report in reports[:2] for issue in explanations(report)]
    (issue,) = explanations(reports[2])
    assert (issue.kind, issue.figures["joints"]) == (kind, [2])
    assert issue.certainty.grade == "likely"
    assert bool(issue.apply) == (kind == "torque gain")


@pytest.mark.parametrize("noise", [0.0, pytest.param(0.03, marks=pytest.mark.long)])
@pytest.mark.parametrize("factor", [0.6, 1.6])
def test_a_gain_that_friction_explains_as_well_is_not_repaired(factor, noise):
    """Little but friction loads a light link about its own axis."""
    first, second, (_, _, origin, *_) = drawn(14, 3, 3)
    arm = simulated(
        "last", (first, second, ("revolute", "0 0 1", origin, 0.05, "0 0 0")), 14
    )
    rng = np.random.default_rng(1)
    noisy = [
        replace(run, tau=run.tau + rng.normal(0.0, noise, run.tau.shape))
        for run in (arm.train, scaled(arm.test, 3, factor))
    ]
    reports = judged(arm.problem, *noisy)
    (issue,) = [x for report in reports for x in explanations(report)]
    assert issue.figures["joints"] == [3]
    assert issue.certainty.grade == "possible"
    assert "friction" in issue.what
    assert not issue.apply
    assert issue.repair is None


def test_currents_of_runs_with_different_loads_are_no_external_torque(two_link, runs):
    """One arm for all runs leaves much, and one for each run leaves little."""
    problem = replace(two_link, torque_side="link")
    both = with_load(problem, runs[0], 6.0), runs[1]
    both = [replace(run, tau=0.01 * run.tau) for run in both]
    reports = judged(problem, *both)
    for report in reports:
        assert "torque channel kind" in [issue.kind for issue in explanations(report)]
    (load,) = (f for f in explanations(reports[0]) if f.kind == "another load")
    assert "kg, were the torques in N m" in load.what


@pytest.mark.parametrize(
    ("order", "mass", "words"),
    [
        ((0, 1), 1.0, "another load on its last link (size open)"),
        ((0, 1), 6.0, "a heavier load on its last link (+"),
        pytest.param((1, 0), 6.0, " kg), beside", marks=pytest.mark.long),
    ],
)
def test_a_load_is_named_in_the_run_that_carries_it(two_link, runs, order, mass, words):
    """In kilograms, unless its interval holds zero."""
    both = with_load(two_link, runs[0], mass), runs[1]
    reports = judged(two_link, *(both[k] for k in order))
    loaded_report, empty_report = (reports[order.index(k)] for k in (0, 1))
    (issue,) = explanations(loaded_report)
    assert issue.kind == "another load"
    assert issue.figures["size"] == pytest.approx(mass, rel=0.25)
    assert words in issue.what
    assert not explanations(empty_report)


def test_while_columns_are_in_doubt_what_nothing_mends_waits(two_link, runs):
    """Degrees in one run and a turned sign: a load, frictions and masses may follow from
    them. The load that is there is said once the columns are right."""
    both = scaled(with_load(two_link, runs[0], 6.0), 2, -1.0), scaled(runs[1], 2, -1.0)
    kinds = lambda reports: {x.kind for r in reports for x in explanations(r)}  # noqa: E731
    in_degrees = replace(both[1], q=np.degrees(both[1].q))
    for pair in (both, (both[0], in_degrees)):
        reports = judged(two_link, *pair)
        assert "torque sign" in kinds(reports)
        assert all(x.remedies for r in reports for x in explanations(r))
    mended = (scaled(run, 2, -1.0) for run in both)
    assert kinds(judged(two_link, *mended)) == {"another load"}


@pytest.mark.long
def test_a_sign_that_is_wrong_in_two_of_three_runs_is_right_in_the_third(
    two_link, three_runs
):
    *others, third = three_runs
    flipped = [scaled(run, 2, -1.0) for run in others]
    bad, also_bad, good = judged(two_link, *flipped, third)
    assert [issue.apply for issue in explanations(bad)] == ["sign:tau2"]
    assert [issue.apply for issue in explanations(also_bad)] == ["sign:tau2"]
    assert not explanations(good)


def late(run, seconds):
    """The run whose torques come so much later than its positions."""
    tau = np.stack([np.interp(run.t - seconds, run.t, x) for x in run.tau.T], axis=1)
    return replace(run, tau=tau)


GAIN, JOINT = "torque gain", "joint sign"
#: What one run of several is spoiled by: number of runs, which of them, how; the kind
#: and the joints that are claimed of it alone, and the size.
OF_ONE_RUN = {
    "a sign": (2, 0, lambda run: scaled(run, 1, -1.0), "torque sign", [1], None),
    "another sign": (2, 0, lambda run: scaled(run, 2, -1.0), "torque sign", [2], None),
    "a position's sign": (2, 1, turned, "position sign", [2], None),
    "a joint's": (3, 1, lambda run: scaled(turned(run), 2, -1.0), JOINT, [2], None),
    "an order": (2, 1, swapped, "torque order", [1, 2], None),
    "a small gain": (2, 0, lambda run: scaled(run, 2, 1.15), GAIN, [2], 0.15),
    "a delay": (3, 1, lambda run: late(run, 0.04), "delay", [1, 2], 0.04),
    # Joints contradict each other: no arm of its own explains the run either.
    "half": (3, 0, lambda run: scaled(run, 1, 0.5), GAIN, [1], -0.5),
    "twice": (3, 2, lambda run: scaled(run, 2, 2.0), GAIN, [2], 1.0),
    "positions": (2, 1, exchanged, "position order", [1, 2], None),
    "a gear": (3, 1, lambda run: geared(run, 2, 1.25), "gear ratio", [2], None),
    "a clock": (3, 0, lambda run: replace(run, t=0.9 * run.t), "clock rate", [], None),
    "a unit": (2, 1, lambda run: replace(run, tau=1e3 * run.tau), GAIN, [1, 2], 999.0),
}
FIRST = ("a sign", "an order", "a delay", "half", "positions", "a gear", "a clock")
LATER = {
    "another sign": pytest.mark.long,
    "a joint's": pytest.mark.long,
    "twice": pytest.mark.long,
    "a small gain": pytest.mark.long,
    "a position's sign": pytest.mark.long,
    "a unit": pytest.mark.long,
}


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(x, marks=() if x in FIRST else LATER.get(x, pytest.mark.slow))
        for x in OF_ONE_RUN
    ],
)
def test_what_one_run_has_is_claimed_of_it_alone(name, two_link, three_runs):
    count, place, spoil, kind, joints, size = OF_ONE_RUN[name]
    log = [replace(run, dq=None) for run in three_runs[:count]]
    log[place] = spoil(log[place])
    reports = judged(two_link, *log)
    (issue,) = explanations(reports[place])
    assert (issue.kind, issue.figures["joints"]) == (kind, joints)
    assert f"in {log[place].names[0]} only" in issue.what
    if size is not None:
        assert issue.figures["size"] == pytest.approx(size, rel=0.14)
    assert not [x for k, r in enumerate(reports) if k != place for x in explanations(r)]


#: Kinds of fault that have joints.
OF_JOINTS = ("torque sign", "encoder offset", "gear ratio", "delay", "position unit")


@pytest.mark.parametrize(
    ("kind", "joints", "words"),
    [
        *((kind, (1,), f"{kind} of joint 2") for kind in OF_JOINTS),
        *((kind, (), kind) for kind in ("another load", "another arm")),
    ],
)
def test_each_rival_of_what_one_run_has_is_named(kind, joints, words, two_link, runs):
    """A gear ratio had no words: an issue that it rivals was likely."""
    log = rows_of(runs[0], two_link)
    evidence = Evidence(log)
    fit = evidence.fit(LogView(log.as_logged), 1.0)
    part = Part(run=1)
    number = Number("gain", (0,), 0.5, is_factor=True)
    gain, rival = (
        Hypothesis(name, of, -6.0, log.as_logged, number, part)
        for name, of in (("torque gain", (0,)), (kind, joints))
    )
    claim = Claim(gain, 60.0, fit, fit, rivals=(Claim(rival, 59.0, fit, fit),))
    issue = issue_of_difference(log, claim, "second", "")
    assert issue.equivalents == (words,)
    assert issue.certainty.grade == "possible"


def test_three_runs_of_one_arm_have_no_differences(two_link, three_runs):
    assert not [x for r in judged(two_link, *three_runs) for x in explanations(r)]


def test_of_a_clipped_channel_nothing_else_is_said(two_link, runs):
    tau = runs[0].tau.copy()
    limit = 0.4 * np.abs(tau[:, 1]).max()
    tau[:, 1] = np.clip(tau[:, 1], -limit, limit)
    (report,) = judged(two_link, replace(runs[0], tau=tau))
    kinds = {(f.kind, *f.figures["joints"]) for f in report.errors_and_warnings}
    assert kinds == {("saturation", 2)}


def test_rows_that_a_fact_deletes_are_no_event(two_link, runs):
    """Zeros for a twentieth of a second: the torque there is missing, not odd."""
    run = runs[0]
    since = run.t - run.t[0] - 8.0
    tau = run.tau.copy()
    tau[(since > 0.0) & (since < 0.05), 1] = 0.0
    (report,) = judged(two_link, replace(run, tau=tau))
    assert "one-off event" not in [f.kind for f in report.issues]


@pytest.mark.parametrize("joint", [1, pytest.param(2, marks=pytest.mark.long)])
def test_a_gain_of_two_joints_is_that_of_the_likelier_masses(two_link, runs, joint):
    """Gains of x of one joint and of 1/x of the other fit alike."""
    (report,) = judged(two_link, scaled(runs[0], joint, 1.5))
    (issue,) = explanations(report)
    assert (issue.kind, issue.figures["joints"]) == ("torque gain", [joint])


def test_a_gain_names_the_other_joint_that_may_have_it(two_link, runs):
    (report,) = judged(two_link, scaled(runs[0], 2, 1.5))
    (issue,) = explanations(report)
    rivals = {x["kind"]: x["joints"] for x in issue.figures["as_likely"]}
    assert {*rivals["torque gain"], *issue.figures["joints"]} == {1, 2}
    assert f"the torque of joint {rivals['torque gain'][0]} is" in issue.what


def test_each_of_a_set_is_a_remedy_with_its_probability(two_link, runs):
    """Which of two gains is wrong, the user says: either word repairs the log."""
    run = scaled(runs[0], 2, 1.5)
    (report,) = judged(two_link, run)
    remedies = list_remedies([report])
    changes = [x.change for x in remedies]
    for remedy in remedies:
        assert {str(x) for x in (remedy.change, *remedy.rivals)} == {*map(str, changes)}
    assert sum(x.probability for x in remedies) == pytest.approx(1.0)
    words = [x.arguments["apply"] for x in changes]
    assert ["gain:tau1"] in words
    assert ["gain:tau2"] in words
    for j in range(2):
        fixed = fix_runs(two_link, [run], [report], [f"gain:tau{j + 1}"]).runs[0]
        assert np.flatnonzero(~np.isclose(fixed.tau, run.tau).all(axis=0)) == [j]


def stepped(run, t, size):
    """The run with a torque of joint 2 that steps t [s] after its first row."""
    tau = run.tau.copy()
    tau[run.t - run.t[0] > t, 1] += size
    return replace(run, tau=tau)


@pytest.mark.parametrize("number", [0, 1])
def test_a_step_is_told_of_its_run_alone_and_by_its_clock(number, two_link, runs):
    spoiled = list(runs)
    half = 0.5 * float(np.ptp(runs[number].t))
    size = 2.0 * float(np.std(runs[number].tau[:, 1]))
    spoiled[number] = stepped(runs[number], half, size)
    reports = judged(two_link, *spoiled)
    steps = [
        [issue for issue in explanations(report) if issue.kind == "torque step"]
        for report in reports
    ]
    assert steps[1 - number] == []
    (step,) = steps[number]
    at = float(runs[number].t[0]) + half
    assert step.figures["t"] == pytest.approx(at, abs=0.5)
    assert f"t = {step.figures['t']:.4g} s" in step.what
