"""The race: one evidence, numbers at their best size, a second witness, and what is as
likely."""

import gc
import weakref
from dataclasses import fields, replace
from functools import partial

import numpy as np
import pytest
from arms import Axis, run_of, write_urdf
from numpy.testing import assert_allclose
from small_runs import small_run

from sdp_vs_penalty import check, load_problem
from sdp_vs_penalty.race import Hypothesis, Likelihood, Number, Part, Race
from sdp_vs_penalty.race.chain import ENTRIES, LogEvent, LogTransform
from sdp_vs_penalty.race.evidence import Evidence
from sdp_vs_penalty.race.kinds import KINDS, list_faults, mounting, several_joints
from sdp_vs_penalty.race.race import HeldRaces
from sdp_vs_penalty.race.records import ExtraTorque, LogView
from sdp_vs_penalty.race.rows import ROTOR, RegressionData
from sdp_vs_penalty.signals import Preprocessing

PROBLEM = load_problem("two_link")
RUN = replace(small_run(PROBLEM, seconds=8.0), dq=None)
NONE = LogTransform.unchanged(2, (0.0, 0.0, -9.81))


def rows_of(run, problem=PROBLEM):
    settings = problem.preprocessing.resolve(run)
    return Likelihood(problem, RegressionData.from_run(problem, run, settings))


def judged(*runs):
    return Race([rows_of(run) for run in runs]).run()


def scaled(run, gains):
    return replace(run, tau=run.tau * np.array(gains))


def pushed_for_a_second(run):
    """Return a run in which the last link is pushed from 3 to 4 s."""
    torque = np.column_stack(
        [4.0 * np.sin(run.q[:, 1]) + 6.0, np.full(len(run.t), 5.0)]
    )
    is_pushed = (run.t > 3.0) & (run.t < 4.0)
    return replace(run, tau=run.tau + torque * is_pushed[:, None])


@pytest.fixture(scope="module")
def evidence():
    return Evidence(rows_of(RUN).with_all_laws)


def test_rows_are_given_back_without_the_garbage_collector():
    """A hundred checks in one process held 2.7 GB: caches kept their own objects."""
    gc.disable()
    try:
        log = rows_of(RUN)
        race = Race([log])
        race.run()
        kept = [
            weakref.ref(x)
            for x in (log, log.with_all_laws, race.all_rows, race.few_rows)
        ]
        del log, race
        assert [x() for x in kept] == 4 * [None]
    finally:
        gc.enable()


def test_the_same_rows_of_one_robot_race_once():
    """A repaired copy is judged by the race that was held for the log."""
    races = HeldRaces()
    said = races.hold([rows_of(RUN)], KINDS, False)
    assert races.hold([rows_of(replace(RUN))], KINDS, False) is said
    twin = replace(PROBLEM)  # of other bodies, for all that is known
    assert races.hold([Likelihood(twin, rows_of(RUN).data)], KINDS, False) is not said
    assert races.hold([rows_of(RUN)], KINDS[:1], False) is not said
    flipped = scaled(RUN, (1.0, -1.0))
    (claim,) = races.hold([rows_of(flipped)], KINDS, False).claims
    assert claim.hypothesis.kind == "torque sign"


@pytest.mark.parametrize(
    ("field", "entries", "is_order"),
    [
        ("order", (1, 0), True),
        ("tau_order", (1, 0), True),
        ("scale", (-1.0, 1.0), False),
        ("zero", (0.3, 0.0), False),
        ("ratio", (1.0, 1.5), False),
        ("carried", (0.0, 1.0), False),
        ("gain", (1.0, 2.0), False),
        ("rate", 1.1, False),
    ],
)
def test_a_fault_says_what_its_repair_changes(field, entries, is_order):
    """What it says of positions is what the repair of a run does to them."""
    log = rows_of(RUN)
    changed = replace(log.as_logged, **{field: entries})
    (fault,) = list_faults(log, changed)
    is_moved = not np.array_equal(changed.apply(RUN).q, RUN.q)
    assert fault.changes_positions == is_moved
    assert fault.changes_order == is_order


def test_a_clean_log_has_nothing_wrong():
    assert judged(RUN).claims == ()


@pytest.mark.parametrize(
    ("spoil", "kind", "joints"),
    [
        (partial(scaled, gains=(1.0, -1.0)), "torque sign", (1,)),
        (partial(scaled, gains=(-1.0, -1.0)), "torque sign", (0, 1)),
        (lambda run: replace(run, tau=run.tau[:, ::-1].copy()), "torque order", (0, 1)),
        (
            lambda run: replace(run, q=run.q[::-1].copy(), tau=run.tau[::-1].copy()),
            "time reversed",
            (),
        ),
        (lambda run: replace(run, q=run.q * [1.0, -1.0]), "position sign", (1,)),
        (pushed_for_a_second, "passing force", ()),
    ],
    ids=["a sign", "all signs", "an order", "time", "a position's sign", "a push"],
)
def test_what_was_done_is_claimed(spoil, kind, joints):
    claim, *others = judged(spoil(RUN)).claims
    assert not others
    assert (claim.hypothesis.kind, claim.hypothesis.joints) == (kind, joints)


@pytest.mark.parametrize(
    "joints", [(1, 2), pytest.param((3, 5), marks=pytest.mark.long)]
)
def test_joints_that_count_the_other_way_are_one_convention(joints):
    """Neither of them shows by itself; the mirror image of the arm does so as well."""
    panda = load_problem("panda")
    signs = np.where(np.isin(np.arange(panda.robot.n), joints), -1.0, 1.0)
    run = replace(small_run(panda, seconds=8.0), dq=None)
    log = rows_of(replace(run, q=run.q * signs, tau=run.tau * signs), panda)
    (claim,) = Race([log]).run().claims
    alike = [x.hypothesis.name for x in (claim, *claim.rivals)]
    assert ("joint sign", joints) in alike
    assert claim.probabilities[alike.index(("joint sign", joints))] > 0.2


@pytest.mark.parametrize("has_velocity", [False, True])
def test_friction_alone_does_not_make_rows_in_reverse_likely(has_velocity):
    """A controller that subtracts more friction than there is turns its sign, too."""
    dq = small_run(PROBLEM, seconds=8.0).dq if has_velocity else None
    back = replace(RUN, dq=dq).rows(np.arange(len(RUN.t))[::-1])
    verdict = judged(replace(back, t=RUN.t))
    (claim,) = verdict.claims
    assert claim.hypothesis.kind == "time reversed"
    assert verdict.is_sure_of(claim) == has_velocity


def test_a_velocity_that_is_the_positions_derivative_forbids_rows_in_reverse():
    dq = small_run(PROBLEM, seconds=8.0).dq
    back = replace(RUN, dq=-dq).rows(np.arange(len(RUN.t))[::-1])
    kinds = [claim.hypothesis.kind for claim in judged(replace(back, t=RUN.t)).claims]
    assert kinds
    assert "time reversed" not in kinds


@pytest.mark.parametrize("share", [1.0, pytest.param(0.8, marks=pytest.mark.long)])
def test_an_arm_on_a_wall_whose_upright_weight_is_subtracted(share):
    """The controller believes in its own links' masses."""
    panda = load_problem("panda")
    upright = np.array(panda.robot.gravity)
    left = np.array([-9.81, 0.0, 0.0]) - share * upright
    run = small_run(panda.with_gravity(tuple(left)), seconds=8.0)
    log = rows_of(run, panda)
    outcome = Race([log]).run()
    assert [claim.hypothesis.kind for claim in outcome.claims] == ["gravity direction"]
    assert_allclose(outcome.view.transform.gravity, left, atol=1e-9)
    (fault,) = mounting.list_faults(log, outcome.view.transform)
    assert "under gravity along (-9.81, 0, 0)" in fault.what


def test_a_link_that_hangs_on_the_other_side_of_its_axis_is_no_mounting(tmp_path):
    """The link's centre is 17 mm beside the axis, and its place known to centimetres."""

    def arm(name, beside):
        """The arm with the second link's centre so far beside its axis [m]."""
        axes = [
            Axis("revolute", (0, 0, 1), (0, 0, 0), 10.0, (-0.14, 0.03, 0.02)),
            Axis("revolute", (0, 1, 0), (-0.345, 0, 0), 7.0, (beside, -0.16, -0.006)),
        ]
        return load_problem(write_urdf(tmp_path / f"{name}.urdf", name, axes))

    friction = (np.array([3.0, 2.0]), np.array([2.0, 1.5]), np.zeros(2))
    run = run_of(arm("true", -0.02), friction, np.array([0.05, 0.05]), seconds=16.0)
    as_believed = arm("believed", 0.016)
    verdict = Race([rows_of(replace(run, dq=None), as_believed)]).run()
    assert verdict.claims == ()


@pytest.mark.parametrize("late", [0.03, -0.03])
def test_a_delay_of_either_sign_is_in_its_interval(late):
    tau = np.stack([np.interp(RUN.t - late, RUN.t, x) for x in RUN.tau.T], axis=1)
    (claim,) = judged(replace(RUN, tau=tau)).claims
    assert claim.hypothesis.kind == "delay"
    assert claim.size == pytest.approx(late, abs=max(4.0 * claim.std, 5e-4))


def test_what_is_as_likely_is_told_with_a_claim():
    """A gain of x of one joint and of 1 / x of the other fit alike."""
    (claim,) = judged(scaled(RUN, (1.0, 1.5))).claims
    gains = {claim.hypothesis.joints} | {x.hypothesis.joints for x in claim.rivals}
    assert gains == {(0,), (1,)}


def test_a_gain_of_one_run_is_found_in_its_rows():
    other = small_run(PROBLEM, seconds=8.0, seed=1)
    verdict = judged(replace(other, dq=None), scaled(RUN, (1.0, 1.3)))
    (claim,) = verdict.differences()
    assert claim.hypothesis.kind == "torque gain"
    assert claim.hypothesis.part == Part(run=1)
    assert np.exp(-claim.size) == pytest.approx(1.3, rel=0.03)
    assert verdict.claims_on_all_rows() == []


def test_a_usual_number_is_taken_and_not_told():
    """A delay of 5 ms: drives and their drivers take as long."""
    tau = np.stack([np.interp(RUN.t - 0.005, RUN.t, x) for x in RUN.tau.T], axis=1)
    log = rows_of(replace(RUN, tau=tau))
    verdict = Race([log]).run()
    assert verdict.without_usual(log) == log.as_logged


@pytest.mark.parametrize("turned", [1.0, -1.0])
def test_the_evidence_knows_no_unit_of_a_channel(turned):
    """The prior of the links follows the common scale, also where another fault hides the
    arm; a channel's gain is no evidence by itself."""
    fits = []
    for gain in (1.0, 1e3):
        run = scaled(replace(RUN, q=RUN.q * [1.0, turned]), (gain, gain))
        log = rows_of(run).with_all_laws
        fits.append(Evidence(log).fit(LogView(log.as_logged), 2.0))
    fit, other = fits
    assert other.scale == pytest.approx(1e3 * fit.scale, rel=0.05)
    assert other.shares_left == pytest.approx(fit.shares_left, rel=0.05)


def test_what_is_changed_alike_is_changed_beside_another_unit():
    """Two units of positions, and the sign and the order that were found beside one."""
    none = LogTransform.unchanged(3, (0.0, 0.0, -9.81))
    units = [none.with_multiplied("scale", range(3), x) for x in (0.5, 0.25)]
    first, second = (
        x.with_multiplied("scale", (1,), -1.0).with_swap(0, 2, "tau_order")
        for x in units
    )
    assert units[1].with_change(units[0], first) == second


@pytest.mark.parametrize(
    "name", [x.name for x in fields(LogTransform) if x.compare and x.name != "gain"]
)
def test_what_is_changed_alike_keeps_what_is_its_own(name):
    """A rival of gravity stays one beside the next claim, about a gain."""
    none = LogTransform.unchanged(2, (0.0, 0.0, -9.81))
    value = getattr(none, name)
    if name == "events":
        other = (LogEvent(0),)
    elif "order" in name:
        other = value[::-1]
    else:
        other = tuple(x + 1.0 for x in value) if isinstance(value, tuple) else value + 1
    rival = replace(none, **{name: other})
    claim = none.with_multiplied("gain", (1,), 2.0)
    kept = rival.with_change(none, claim)
    assert getattr(kept, name) == other
    assert kept.gain == claim.gain


@pytest.mark.parametrize("name", ENTRIES)
def test_a_change_before_an_unchanged_log_stays_but_what_all_rows_have(name):
    """What all rows have, no part has of its own: the unchanged log's counts."""
    none = LogTransform.unchanged(3, (0.0, 0.0, -9.81))
    change = none.with_entries(name, [1], 0.5)
    stays = ENTRIES[name].composed != "later"
    assert change.followed_by(none) == (change if stays else none)
    assert none.followed_by(change) == change


def test_each_number_of_a_joint_says_how_two_of_its_changes_are_one():
    none = LogTransform.unchanged(3, (0.0, 0.0, -9.81))
    of_joints = {
        entry.name
        for entry in fields(none)
        if isinstance(getattr(none, entry.name), tuple)
    } - {"order", "tau_order", "gravity", "assumed", "events"}
    assert of_joints == set(ENTRIES)


def test_a_column_of_zeros_is_worth_less_than_nothing(evidence):
    """It explains nothing, and costs nothing: its size is its prior's."""
    view = LogView(evidence.log.as_logged)
    columns = np.zeros((2, evidence.log.data.count, 1))
    with_zeros = replace(view, extra_torques=(ExtraTorque(columns, np.ones(1)),))
    base, other = evidence.fit(view, 2.0), evidence.fit(with_zeros, 2.0)
    assert other.log_evidence == pytest.approx(base.log_evidence, abs=1e-6)
    assert other.theta[-1] == pytest.approx(0.0, abs=1e-9)


def test_nothing_is_known_of_a_number_without_torque(evidence):
    """A position in millimetres led to one: the check ended in an internal error."""
    fit = evidence.fit(LogView(evidence.log.as_logged), 2.0)
    slope = np.zeros((2, evidence.log.data.count))
    assert evidence.jackknifed_std(fit, slope) == np.inf


def test_a_score_is_the_evidence_to_first_order(evidence):
    """Of a delay of a tenth of a millisecond, which is little."""
    view = LogView(evidence.log.as_logged)
    fit = evidence.fit(view, 2.0)
    number = Number("lead", (0, 1), sd=1e-3, step=1e-4)
    late = Hypothesis("delay", (0, 1), 0.0, fit.transform, number)
    slopes = evidence.slopes(fit, [late], [0.0])
    sizes, information = evidence.score_test(fit, slopes, np.array([1e-3]))
    values = {
        x: evidence.fit(LogView(number.at(fit.transform, x)), 2.0).log_evidence
        for x in (-1e-4, 0.0, 1e-4)
    }
    slope = (values[1e-4] - values[-1e-4]) / 2e-4
    assert slope == pytest.approx(
        sizes[0] * (information[0] + 1e6), rel=0.2, abs=0.05 * information[0] * 1e-4
    )


@pytest.mark.parametrize(
    ("number", "size"),
    [
        (Number("zero", (1,), 1.0), 0.3),
        (Number("gain", (0,), 1.0, is_factor=True), -0.5),
        (Number("rate", (), 1.0, is_factor=True), 0.2),
    ],
)
def test_a_number_is_what_it_was_set_to(number, size):
    assert number.size_in(NONE) == 0.0
    assert number.size_in(number.at(NONE, size)) == pytest.approx(size)
    assert number.at(number.at(NONE, size), 0.0) == NONE


def test_a_negative_gain_keeps_its_sign():
    turned = NONE.with_entries("gain", (0,), -2.0)
    number = Number("gain", (0,), 1.0, is_factor=True)
    assert number.at(turned, np.log(3.0)).gain == pytest.approx((-3.0, 1.0))


def test_a_hypothesis_of_a_part_leaves_other_rows():
    transform = NONE.with_multiplied("gain", (0,), -1.0)
    part = Part(run=1)
    view = Hypothesis("torque sign", (0,), -6.0, transform, part=part).applied_to(
        LogView(NONE)
    )
    assert view == LogView(NONE, parts=((part, transform),))
    assert view.motion == LogView(NONE.motion_part)


def test_the_zero_of_the_first_joint_is_the_mounting_about_its_axis():
    wall = PROBLEM.with_gravity((9.81, 0.0, 0.0))
    run = small_run(wall, seconds=8.0)
    moved = replace(run, q=run.q + np.array([0.3, 0.0]), dq=None)
    (report,) = check(wall, moved, thorough=False)
    (issue,) = report.errors_and_warnings
    assert (issue.kind, issue.figures["joints"]) == ("encoder offset", [1])
    assert "or its base is turned as much about that axis" in issue.what


def test_a_coupling_is_of_the_channels_of_another_order(evidence):
    """TX40's coupled joints were swapped: the columns stayed those of the old order."""
    swapped = NONE.with_swap(0, 1, "order", "tau_order")
    before, after = (
        next(
            h
            for h in several_joints.propose(
                evidence, evidence.fit(LogView(transform), 1.0)
            )
            if h.kind == "coupling"
        )
        for transform in (NONE, swapped)
    )
    swap = Hypothesis("joint order", (0, 1), -1.0, swapped)
    seen = swap.applied_to(before.applied_to(LogView(NONE)))
    assert np.array_equal(seen.extra_torques[0].columns, after.extra_torque.columns)
    assert not np.array_equal(before.extra_torque.columns, after.extra_torque.columns)


def test_the_links_motion_passes_the_low_pass_of_the_torque():
    """A run of an arm of six joints seemed to have its time stamps 1.41 times too close:
    10 % of its torque was acceleration between the two low-passes."""
    noise = 3e-4 * np.random.default_rng(0).normal(size=RUN.q.shape)
    noisy = replace(RUN, q=RUN.q + noise)
    filters = Preprocessing(state_cutoff=20.0, torque_cutoff=5.0)
    data, as_moved = (
        RegressionData.from_run(PROBLEM, run, filters) for run in (noisy, RUN)
    )
    assert_allclose(data.motion.ddq.T, data.own_columns[:, :, ROTOR])
    difference = data.motion.ddq - as_moved.motion.ddq
    assert difference.std() < 0.05 * data.motion.ddq.std()
    log = Likelihood(PROBLEM, data)
    assert log.fit(log.as_logged).unexplained ** 0.5 < 0.01
