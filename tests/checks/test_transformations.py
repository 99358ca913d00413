"""What every transformation promises: on rows it does what it does to a log, and says
it once."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from judged import report_of_run
from small_runs import hostile_log, small_run

from sdp_vs_penalty import (
    InputError,
    Measurements,
    check,
    compare,
    identify,
    load_problem,
)
from sdp_vs_penalty.checks.explain import keep_only
from sdp_vs_penalty.effects.bristles import dahl
from sdp_vs_penalty.race.chain import LogTransform
from sdp_vs_penalty.race.fault import Fault
from sdp_vs_penalty.race.kinds import gain, list_faults, saturation
from sdp_vs_penalty.race.likelihood import Likelihood
from sdp_vs_penalty.race.rows import RegressionData
from tests.helpers.arms import THREE, TURN, write_urdf

PROBLEM = load_problem("two_link")
RUN = replace(small_run(PROBLEM, seconds=8.0), dq=None)


@pytest.mark.parametrize(
    "seed",
    [
        0,
        pytest.param(1, marks=pytest.mark.long),
        *(pytest.param(k, marks=pytest.mark.slow) for k in (2, 3)),
    ],
)
def test_two_mistakes_are_never_told_against_each_other(seed):
    """Of each kind a joint is named once, and the mended log has nothing left to mend."""
    rng = np.random.default_rng(seed)
    tau = RUN.tau * np.array([1.0, rng.choice([-1.0, 2.5])])
    q = RUN.q + np.array([0.0, rng.choice([0.5 * np.pi, -0.4])])
    report = report_of_run(PROBLEM, replace(RUN, q=q, tau=tau))
    told = [(f.kind, f.where) for f in report.errors_and_warnings]
    assert len(told) == len(set(told))
    again = report_of_run(PROBLEM, report.repaired_all)
    assert not [f for f in again.errors_and_warnings if f.severity == "error"]


def test_a_gain_that_is_taken_away_again_costs_nothing():
    """However a processor rounds x / x."""
    none = LogTransform.unchanged(2, (0.0, 0.0, -9.81))
    for x in np.random.default_rng(0).uniform(-2.0, 2.0, 200):
        (fault,) = gain.list_faults(
            SimpleNamespace(n=2), none.with_entries("gain", (1,), x)
        )
        assert fault.without == none.with_entries("gain", (1,), np.sign(x))


@pytest.mark.parametrize("joint", [0, 1])
def test_of_two_faults_the_named_one_is_kept(joint):
    """Both torques have another gain and another zero."""
    settings = PROBLEM.preprocessing.resolve(RUN)
    log = Likelihood(PROBLEM, RegressionData.from_run(PROBLEM, RUN, settings))
    net = log.as_logged
    for j in range(2):
        net = net.with_entries("gain", (j,), 2.0).with_entries("zero", (j,), 0.3)
    gains = [x for x in list_faults(log, net) if x.kind == "torque gain"]
    kept = keep_only(log, net, [gains[joint]])
    assert kept == log.as_logged.with_entries("gain", (joint,), 2.0)


@pytest.mark.parametrize("factor", [1.0, -1.0, 1e-3])
def test_an_amplifiers_limit_has_the_unit_of_the_torque(factor):
    """The raw channel reaches 30, of a limit of 60 in its own unit."""
    joints = LogTransform.unchanged(2, (0.0, 0.0, -9.81))
    repair = joints.with_entries("bend", (1,), 0.5).with_entries("gain", (1,), factor)
    data = SimpleNamespace(
        largest=np.array([10.0, 30.0]), moving=np.ones(2, bool), count=2
    )
    (fault,) = saturation.list_faults(Likelihood(PROBLEM, data), repair)
    assert f"limit of {60.0 * abs(factor):.3g} N m" in fault.what


@pytest.mark.long
@pytest.mark.parametrize(
    ("second", "fourth"), [(-0.5, 1.0), pytest.param(0.5, -0.5, marks=pytest.mark.slow)]
)
def test_two_joints_some_quarter_turns_off_are_both_named(second, fourth, panda):
    """Also where neither joint's own torque shows it."""
    run = replace(small_run(panda, seconds=8.0), dq=None)
    turned = np.pi * np.array([0.0, second, 0.0, fourth, 0.0, 0.0, 0.0])
    report = report_of_run(panda, replace(run, q=run.q + turned))
    told = {
        f.where: f.figures["shifts"]
        for f in report.errors_and_warnings
        if f.kind == "encoder offset"
    }
    away = {
        f"joint {j}": [np.pi * (abs(x) if x == 1.0 else -x)]
        for j, x in ((2, second), (4, fourth))
    }
    assert told == away


@pytest.mark.long
@pytest.mark.parametrize("level", [0.2, pytest.param(0.25, marks=pytest.mark.slow)])
def test_a_quarter_turn_in_a_noisy_log_is_exactly_one(level):
    """Whose best value lies a tenth of its interval beside 90 degrees."""
    problem = load_problem("panda")
    rng = np.random.default_rng(1)
    run = replace(small_run(problem, seconds=8.0), dq=None)
    noise = level * run.tau.std(axis=0) * rng.normal(size=run.tau.shape)
    turned = run.q - 0.5 * np.pi * np.eye(problem.robot.n)[3]
    report = report_of_run(problem, replace(run, q=turned, tau=run.tau + noise))
    (told,) = (f for f in report.errors_and_warnings if f.kind == "encoder offset")
    assert (told.where, told.figures["shifts"]) == ("joint 4", [0.5 * np.pi])
    assert "-90 degrees away" in told.what
    assert "(95 %: -" in told.what  # in one sense
    low, high = told.figures["interval"]
    assert low < 0.5 * np.pi - 0.1 < 0.5 * np.pi + 0.1 < high


def test_friction_that_is_larger_than_all_inertia_is_no_other_unit(tmp_path):
    """Upright axes bear no weight: of light links friction is ten times all else."""
    light = replace(TURN, mass=0.3, com="0.2 0 0")
    urdf = write_urdf(
        tmp_path / "upright.urdf", "upright", (light, replace(light, origin="0.3 0 0"))
    )
    problem = load_problem(urdf)
    report = report_of_run(problem, replace(small_run(problem, seconds=8.0), dq=None))
    assert not report.errors_and_warnings


def test_upright_axes_say_nothing_about_which_way_is_down(tmp_path):
    """The weight that rounding leaves had a sign, and reversed the rows of a log."""
    tilted = replace(
        TURN, origin="0.3 0 0", axis="0 0.6 0.8", turn="0.6435011087932844 0 0"
    )
    urdf = write_urdf(tmp_path / "upright.urdf", "upright", (TURN, tilted))
    problem = load_problem(urdf)
    report = report_of_run(problem, small_run(problem, seconds=8.0))
    assert "time reversed" not in [issue.kind for issue in report.issues]


#: Torque by position and velocity, of unit size; hysteresis was called a filter of the
#: channel.
STRONG = {
    "a spring": lambda q, dq: q,
    "drag": lambda q, dq: dq * np.abs(dq),
    "hysteresis": lambda q, dq: dahl(q, 0.06),
}


@pytest.mark.parametrize(
    ("law", "joint", "size"),
    [
        ("a spring", 3, 30.0),
        pytest.param("drag", 2, 20.0, marks=pytest.mark.long),
        pytest.param("hysteresis", 4, 8.0, marks=pytest.mark.long),
    ],
)
def test_a_strong_law_that_the_model_lacks_is_no_fault_of_the_log(
    law, joint, size, panda
):
    """A spring larger than its joint's weight was called a gain sixteen times too
    small."""
    run = replace(small_run(panda, seconds=8.0), dq=None)
    q = run.q[:, joint - 1]
    dq = np.gradient(q, run.t)
    more = np.zeros_like(run.tau)
    more[:, joint - 1] = size * STRONG[law](q, dq)
    clean = report_of_run(panda, run)
    spoiled = report_of_run(panda, replace(run, tau=run.tau + more))
    assert [f.kind for f in spoiled.errors_and_warnings] == [
        f.kind for f in clean.errors_and_warnings
    ]


# Hz, s, , N m
RATE = 250
SECONDS = 40.0
MOVES = 12
NOISE = 0.02
COULOMB = np.array([4.0, 5.0, 2.0])
VISCOUS = np.array([1.0, 2.0, 0.5])


@pytest.fixture(scope="module")
def stopping(tmp_path_factory):
    """From point to point with pauses, one joint after the other started and stopped at
    its own time; at each stop the controller's integrator leaves another torque within
    Coulomb's limits."""
    problem = load_problem(
        write_urdf(tmp_path_factory.mktemp("arm") / "arm.urdf", "stops", THREE)
    )
    rng = np.random.default_rng(3)
    t = np.arange(0.0, SECONDS, 1.0 / RATE)
    q, held = np.zeros((2, len(t), 3))
    for j in range(3):
        place = 0.0
        for k in range(MOVES):
            start = SECONDS * (k + 0.2 + 0.1 * rng.uniform()) / MOVES
            length = SECONDS / MOVES * rng.uniform(0.35, 0.6)
            u = np.clip((t - start) / length, 0.0, 1.0)
            aim = rng.uniform(-1.5, 1.5)
            q[:, j] += (aim - place) * u**3 * (10.0 - 15.0 * u + 6.0 * u**2)
            held[t > start + length, j] = rng.uniform(-1.0, 1.0)
            place = aim
    dq, ddq = (
        np.gradient(np.gradient(q, t, axis=0) if k else q, t, axis=0) for k in (0, 1)
    )
    rests = np.abs(dq) < 1e-9
    dry = np.where(rests, held, np.sign(dq))
    rigid = problem.robot.inverse_dynamics(problem.nominal_links.ravel(), q, dq, ddq)
    tau = rigid + VISCOUS * dq + COULOMB * dry + NOISE * rng.normal(size=q.shape)
    return problem, Measurements(t, q + 1e-6 * rng.normal(size=q.shape), tau)


@pytest.mark.parametrize(
    ("gain", "drift"),
    [
        (1.3, 0.0),
        (1.0, 1.0),
        pytest.param(1.0, 0.0, marks=pytest.mark.long),
        pytest.param(0.75, 0.0, marks=pytest.mark.slow),
    ],
)
def test_beside_joints_that_stick_what_was_done_is_named_and_nothing_else(
    stopping, gain, drift
):
    """No cause of a clean log; a gain of joint 2, a drift of joint 3."""
    problem, run = stopping
    tau = (
        run.tau * [1.0, gain, 1.0]
        + np.array([0.0, 0.0, drift]) * (run.t / run.t[-1])[:, None]
    )
    report = report_of_run(problem, replace(run, tau=tau))
    told = {(f.kind, f.where): f.figures for f in report.errors_and_warnings}
    expected = [("torque gain", "joint 2")] * (gain != 1.0) + [
        ("torque drift", "joint 3")
    ] * (drift > 0)
    assert [*told] == expected
    if gain != 1.0:
        assert told[expected[0]]["factor"] == pytest.approx(1.0 / gain, rel=0.05)


@pytest.mark.parametrize("seed", [*range(30), 76, 105, 140, 258])
def test_what_identify_refuses_check_calls_an_error(seed):
    """The last ones are what the check fell over once: no row to ask, squares of 1e300."""
    run = hostile_log(seed)
    try:
        identify(PROBLEM, run, check=False)
    except InputError:
        try:
            (report,) = check(PROBLEM, run)
        except InputError:
            return
        assert report.meaningless


def test_check_and_identify_quote_the_same_share():
    for problem, noise in ((PROBLEM, 0.0), (load_problem("ur10e"), 0.02)):
        run = small_run(problem, seconds=8.0)
        rng = np.random.default_rng(1)
        run = replace(
            run,
            tau=run.tau + noise * run.tau.std(axis=0) * rng.normal(size=run.tau.shape),
        )
        (report,) = check(problem, run)
        (found,) = compare(identify(problem, run, check=False), run)
        assert 100.0 * report.unexplained**0.5 == pytest.approx(
            found.relative_error_percent, rel=0.15
        )


def test_an_interval_begins_with_its_smaller_number():
    fault = Fault(
        kind="torque gain",
        joints=(0,),
        what="",
        remedy="",
        without=LogTransform.unchanged(2, (0.0, 0.0, -9.81)),
        in_words=lambda value: f"{-value:g} too large",
        sort_key=abs,
    )
    assert fault.interval_in_words([-0.2, -0.1]) == "0.1 too large to 0.2 too large"


def test_joints_that_are_counted_from_the_wrist_are_one_mistake():
    """No single exchange of the six explains it."""
    arm = load_problem("panda")
    run = small_run(arm, seconds=12.0)
    fields = {x: getattr(run, x) for x in ("q", "tau", "dq")}
    turned = {x: v[:, ::-1] for x, v in fields.items()}
    report = report_of_run(arm, replace(run, **turned))
    orders = [x for x in report.errors_and_warnings if "order" in x.kind]
    (order,) = orders
    assert order.kind == "joint order"
    assert report.repaired_all.tau == pytest.approx(run.tau)
    assert report.repaired_all.q == pytest.approx(run.q)
