"""A load that is carried for a time, a contact and a torque for a time are named, with
their spans; a knock and a bump are not.

The logs are of an arm that shares no code with the library (point_mass_arm). Its motion
repeats every 10 s.
"""

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from point_mass_arm import MASSES, Kinematics, PointMassArm

from sdp_vs_penalty import add, compare, diagnose, identify
from sdp_vs_penalty.api.diagnosis import _spans_named
from sdp_vs_penalty.checks.certainty import likely
from sdp_vs_penalty.checks.issue import make_explanation
from sdp_vs_penalty.data.measurements import concatenate
from sdp_vs_penalty.diagnosis import Candidate, Diagnosis, conclude
from sdp_vs_penalty.diagnosis.passing.cause import (
    PassingCause,
    PassingLaw,
    Span,
    beside_spans,
)
from sdp_vs_penalty.diagnosis.passing.laws import PassingCandidate, point_of_force
from sdp_vs_penalty.diagnosis.passing.spans import CellProducts, Cells, find_spans
from sdp_vs_penalty.diagnosis.passing.trial import chance_of_groups, standing
from sdp_vs_penalty.effects.links import Payload
from sdp_vs_penalty.results import Certainty

Array = np.ndarray
#: Of the third link [m], and a force [N].
POINT = (0.25, 0.02, 0.05)
FORCE = np.array([6.0, -8.0, 5.0])
#: Width of the cells of time in which spans are searched, for a log of 30 s [s].
CELL = 0.6


def diagnosed(problem, run):
    model = identify(problem, run, check=False)
    return diagnose(model, run, check=False)


def loaded(mass, *spans):
    """A log in which a mass is carried at POINT in some spans [s]."""
    bare = PointMassArm().run(1)
    heavy = PointMassArm(masses=(*MASSES, (2, POINT, mass))).run(1)
    carried = np.any([(bare.t >= a) & (bare.t < b) for a, b in spans], axis=0)
    return replace(bare, tau=np.where(carried[:, None], heavy.tau, bare.tau))


def pushed(push, begin, end):
    """A log with a torque of positions and velocities between two instants [s]."""

    def extra(t, q, dq):
        acts = (t >= begin) & (t < end)
        return push(q, dq) * acts[:, None]

    return PointMassArm(extra=extra).run(2)


def contact(q, dq):
    """The torque (N, 3) that holds the arm against FORCE at POINT of link 3."""
    now = Kinematics.of(q)
    columns = [
        -np.cross(now.axis[j], now.place(2, POINT) - now.origin[j]) @ FORCE
        for j in range(3)
    ]
    return np.column_stack(columns)


def assert_spans(cause, *spans):
    """Spans within half a cell of the truth."""
    found = [(s.t_start, s.t_end) for s in cause.spans]
    np.testing.assert_allclose(found, spans, atol=CELL / 2)


@pytest.mark.parametrize(
    "spans",
    [
        pytest.param([(12.0, 16.5)], id="a while"),
        pytest.param([(8.0, 23.0)], id="half of the run", marks=pytest.mark.slow),
        pytest.param([(17.0, 29.5)], id="to the end", marks=pytest.mark.slow),
        pytest.param([(6.0, 10.0), (19.0, 24.0)], id="twice", marks=pytest.mark.long),
    ],
)
def test_a_load_that_is_carried_for_a_time_is_weighed(problem, spans):
    result = diagnosed(problem, loaded(1.5, *spans))
    (cause,) = result.passing
    assert (cause.kind, cause.place) == ("load", 3)
    assert cause.size == pytest.approx(1.5, rel=0.1)
    # Along y, the axis of its joint, yaw alone shows where it is.
    x, _, z = np.array(cause.parameters[1:]) / cause.size
    np.testing.assert_allclose((x, z), (POINT[0], POINT[2]), atol=0.03)
    assert_spans(cause, *spans)
    assert cause.share > 0.8
    # All else is judged without these spans, so that no other effect stands for it.
    assert not [f for f in result.effects if f.torque_is_certain]
    assert any("without the spans" in remark for remark in result.remarks)
    assert result.acting_for_a_time == (cause.sentence,)
    assert "a load of" in result.headline.split(". ")[0]


@pytest.mark.long
def test_below_what_a_sensor_resolves_nothing_passes(problem, monkeypatch):
    """A log without noise errs by rounding: friction was said to change for seconds."""
    monkeypatch.setattr(
        conclude, "resolution", lambda tau, _: 10.0 * np.ptp(tau, axis=0)
    )
    assert diagnosed(problem, loaded(1.5, (9.0, 21.0))).passing == ()


def test_what_passes_is_left_out_where_a_diagnosis_is_added(problem):
    run = loaded(1.0, (8.0, 16.0))
    spoilt = identify(problem, run, check=False)
    diagnosis = diagnose(spoilt, run, check=False)
    mended = add(spoilt, diagnosis, run)
    (clean,) = compare(mended, PointMassArm().run(1))
    (before,) = compare(spoilt, PointMassArm().run(1))
    assert np.all(clean.rmse < 0.2 * before.rmse)


@pytest.mark.long
def test_a_load_that_is_put_down_for_a_time_is_missing(problem):
    (cause,) = diagnosed(problem, loaded(1.5, (0.0, 12.0), (17.0, 30.0))).passing
    assert cause.is_lack
    assert cause.size == pytest.approx(-1.5, rel=0.1)
    assert_spans(cause, (12.0, 17.0))
    assert "is missing on link 3" in cause.sentence


def test_a_contact_of_some_seconds_is_a_force(problem):
    result = diagnosed(problem, pushed(contact, 12.3, 17.4))
    (cause,) = result.passing
    assert (cause.kind, cause.place) == ("force", 3)
    true_size = np.linalg.norm(FORCE)
    assert abs(cause.size - true_size) < 2.0 * cause.std
    along = np.dot(cause.parameters, FORCE) / cause.size / true_size
    assert along > np.cos(np.radians(15.0))
    np.testing.assert_allclose(cause.point, POINT, atol=0.05)
    assert_spans(cause, (12.3, 17.4))
    restored = Diagnosis.from_dict(result.to_dict())
    assert restored.passing == result.passing
    # A span that the check names as well is told once more, with its command.
    named = replace(result, passing=(), named_by_check=cause.spans)
    assert named.left_out == cause.spans
    assert "what `check` names from 12." in named.headline


@pytest.mark.long
def test_a_model_that_is_held_fixed_shows_a_load(problem):
    model = identify(problem, PointMassArm().run(3), check=False)
    result = diagnose(model, loaded(1.5, (12.0, 17.0)), frozen=True, check=False)
    (cause,) = result.passing
    assert (cause.kind, cause.place) == ("load", 3)
    assert cause.size == pytest.approx(1.5, rel=0.1)


def test_a_load_for_a_while_joins_a_fit_with_one_for_all_the_time(problem):
    payload = Payload(problem.robot)
    for_all_the_time = Candidate(("payload", None), payload)
    for_a_while = PassingCandidate(("load:3", None), payload, False, 4, 0)
    assert for_a_while.text != for_all_the_time.text


@pytest.mark.parametrize(
    ("push", "begin", "end"),
    [
        pytest.param(
            lambda q, dq: 0.0 * q, 0.0, 0.0, id="nothing", marks=pytest.mark.long
        ),
        pytest.param(
            lambda q, dq: 0.0 * q + [0.0, 15.0, 0.0],
            12.0,
            12.1,
            id="a knock",
            marks=pytest.mark.long,
        ),
        pytest.param(
            lambda q, dq: 0.0 * q + [0.0, 1.5, 0.0],
            12.0,
            12.6,
            id="a bump that no second cell of time shows",
        ),
    ],
)
def test_what_is_none_of_these_is_not_named(problem, push, begin, end):
    result = diagnosed(problem, pushed(push, begin, end))
    assert not result.passing
    assert "a load of" not in result.headline


@pytest.mark.long
def test_what_one_joint_has_for_a_time_is_on_it(problem):
    run = pushed(lambda q, dq: [0.0, 4.0, 0.0] * np.ones_like(dq), 12.0, 18.0)
    (cause,) = diagnosed(problem, run).passing
    assert (cause.kind, cause.place, cause.unit) == ("torque", 2, "N*m")
    assert cause.size == pytest.approx(4.0, rel=0.1)
    assert "a constant torque of" in cause.sentence
    assert_spans(cause, (12.0, 18.0))


def cause(*spans, **changes):
    """A force on link 3."""
    force = PassingCause(
        kind="force",
        place=3,
        size=21.0,
        std=1.0,
        unit="N",
        parameters=(21.0, 0.0, 0.0),
        point=(0.0, 0.0, 0.0),
        spans=spans or (Span("", 12.3, 17.4),),
        share=0.94,
        evidence=100.0,
    )
    return replace(force, **changes)


def test_a_cause_is_a_sentence():
    assert cause().sentence == (
        "a constant force of 21 ± 2 N (95 %) on link 3 from 12.3 s to 17.4 s"
        " (explains 94 % of the error then)"
    )


def test_rivals_and_runs_are_named():
    spans = Span("a", 1.0, 2.0), Span("b", 3.0, 4.0)
    text = cause(*spans, rivals=(PassingLaw("torque", 2),)).sentence
    assert "from 1.0 s to 2.0 s of a and from 3.0 s to 4.0 s of b" in text
    assert text.endswith("; a constant torque on joint 2 would explain as much")


def test_spans_are_found_where_a_column_acts():
    """One column without a model; it acts in cells 3 to 5 and 8."""
    rng = np.random.default_rng(0)
    acts = np.isin(np.arange(10), [3, 4, 5, 8]).astype(float)
    Z = rng.normal(size=(10, 50))
    r = 2.0 * acts[:, None] * Z + 0.1 * rng.normal(size=Z.shape)
    products = CellProducts(
        grams=np.sum(Z**2, axis=1)[:, None, None],
        along_fit=np.zeros((10, 1, 1)),
        with_residual=np.sum(Z * r, axis=1)[:, None],
    )
    cells = Cells(np.repeat(np.arange(10), 50), np.zeros(10, int))
    np.testing.assert_array_equal(
        find_spans(products, cells, np.zeros(10), price=10.0), acts
    )


@pytest.mark.parametrize(("n_flags", "n_groups"), [(2, 1), (3, 1), (4, 2), (5, 3)])
def test_the_chance_of_groups_is_that_of_all_arrangements(n_flags, n_groups):
    def flagged(chosen):
        flags = np.zeros(9, bool)
        flags[list(chosen)] = True
        return flags

    def groups(flags):
        return int(flags[0]) + int(np.sum(flags[1:] & ~flags[:-1]))

    all_ways = [flagged(chosen) for chosen in combinations(range(9), n_flags)]
    as_few = [flags for flags in all_ways if groups(flags) <= n_groups]
    (example, *_) = [flags for flags in all_ways if groups(flags) == n_groups]
    chance = chance_of_groups(example)
    assert chance == pytest.approx(len(as_few) / len(all_ways), rel=1e-12)


def test_one_cell_that_errs_most_is_chance():
    assert chance_of_groups(np.arange(50) == 7) == 1.0
    assert chance_of_groups(np.zeros(50, bool)) == 1.0
    assert chance_of_groups(np.arange(50) < 2) > 0.01
    assert chance_of_groups(np.arange(50) < 3) < 0.01


@pytest.mark.parametrize(
    ("joints", "left", "chance"),
    [([0], [], 1.0), ([0, 2, 3], [], 0.02**2), ([0, 2, 3], [2, 3], 1.0)],
)
def test_one_cell_in_which_several_joints_err_most_is_no_chance(joints, left, chance):
    """One of 50 cells: each further joint that the cause explains has it by chance with
    a share of .02."""
    rng = np.random.default_rng(0)
    after = rng.normal(size=(4, 500))
    before = after.copy()
    before[joints, 70:80] += 20.0
    after[left, 70:80] += 20.0
    cells = Cells(np.repeat(np.arange(50), 10), np.zeros(50, int))
    found = standing(before, after, cells, 1.0 * (np.arange(50) == 7))
    assert found.over_elsewhere > 1.0
    assert found.chance == pytest.approx(chance)


def test_the_end_of_a_run_is_no_edge():
    cells = Cells(np.arange(4), np.array([0, 0, 1, 1]))
    assert cells.count_edges(np.array([0.0, 0.0, 1.0, 1.0])) == 0
    assert cells.count_edges(np.array([0.0, 1.0, 1.0, 0.0])) == 2
    added = cells.edges_added(
        np.array([0.0, 1.0, 1.0, 0.0]), np.array([[1, 3], [0, 1]])
    )
    np.testing.assert_array_equal(added, [-2, -1])


def test_the_point_of_a_force_is_found():
    rng = np.random.default_rng(1)
    Z = rng.normal(size=(400, 12))
    theta = np.kron(FORCE, [1.0, *POINT])
    point, covariance = point_of_force(Z.T @ Z, Z.T @ (Z @ theta), reach=1.0)
    np.testing.assert_allclose(point, POINT, atol=1e-3)
    assert np.all(np.diag(covariance) < 1.0)


def test_spans_are_left_out_of_the_run_that_they_name():
    one = PointMassArm().run(1)
    two = concatenate([replace(one, names=("a",)), replace(one, names=("b",))])
    rest = beside_spans(two, [Span("b", 10.0, 20.0)])
    a, b = rest.runs()
    assert a.samples == one.samples
    assert not np.any((b.t > 10.0) & (b.t < 20.0))
    assert beside_spans(two, [Span("another", 10.0, 20.0)]) is two
    assert beside_spans(two, [Span("", 10.0, 20.0)]) is two
    assert beside_spans(one, [Span("", 1.0, 29.0)]) is one
    assert beside_spans(one, []) is one


@pytest.mark.parametrize(("grade", "n_left_out"), [("likely", 1), ("possible", 0)])
def test_spans_that_the_check_calls_likely_are_left_out(grade, n_left_out):
    run = PointMassArm().run(1)
    issue = make_explanation(
        "event",
        "a push",
        remedy="",
        where="t = 4 s",
        certainty=Certainty(grade, ""),
        span=(3.0, 5.0),
    )
    elsewhere = make_explanation(
        "torque step",
        "a step",
        remedy="",
        where="t = 9 s",
        certainty=likely(""),
        at=9.0,
    )
    spans = _spans_named({run.data_hash: [issue, elsewhere]}, run)
    assert spans == (Span("", 3.0, 5.0),) * n_left_out
