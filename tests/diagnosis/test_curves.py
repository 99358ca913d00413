"""What nobody gave a name: measured as a curve, added to the model, flagged outside of
its table."""

import json
import re
from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
import pytest
from challenge.worlds.conditions import Conditions
from challenge.worlds.runs import draw_motion, draw_world, log_run, urdf_of

from sdp_vs_penalty import Estimate, add, compare, diagnose, identify, load_problem
from sdp_vs_penalty.data import Measurements, concatenate
from sdp_vs_penalty.diagnosis import (
    EVIDENCE_TO_DISTINGUISH,
    LAW_TOLERANCE,
    Diagnosis,
    Library,
    Search,
    diagnosis_rows,
    measure_curves,
    whiten_rows,
)
from sdp_vs_penalty.diagnosis.curves.measure import is_an_event, is_curve_preferred
from sdp_vs_penalty.effects import (
    EffectEntry,
    MeasuredCurve,
    Motion,
    make_effect,
    parse_effects,
)
from sdp_vs_penalty.simulation import at_joint

JOINT = 1
SIZE = 0.4


@dataclass(frozen=True)
class Made:
    estimate: Estimate
    data: Measurements
    test: Measurements
    found: Diagnosis


def diagnosed(law, duration=12.0):
    """A two-axis SCARA whose second joint has a torque that no effect of the library
    is."""
    rng = np.random.default_rng(7)
    world = draw_world(Conditions("scara", runs=2, duration=duration), rng)
    hidden = at_joint(JOINT, lambda _, m: SIZE * law(m))
    runs = []
    for k in range(3):
        motion = draw_motion(world, k, rng)
        runs.append(log_run(world, motion, rng, [hidden.torque(world, motion)]).run)
    data = concatenate(runs[:2])
    estimate = identify(load_problem(urdf_of("scara")), data, "ols", check=False)
    return Made(estimate, data, runs[2], diagnose(estimate, data, runs[2]))


@pytest.fixture(scope="module")
def made():
    return diagnosed(lambda m: m.q[:, JOINT] * m.dq[:, JOINT])


def test_the_curve_has_the_variables_the_law_and_the_size_of_the_truth(made):
    assert made.found.verdict == "unknown_effect"
    (curve,) = made.found.curves
    assert (curve.joint, sorted(curve.of)) == (
        JOINT + 1,
        [f"dq{JOINT + 1}", f"q{JOINT + 1}"],
    )
    size, x, y, *_ = curve.formula.split()
    assert {x, y} == set(curve.of)
    assert float(size) == pytest.approx(SIZE, rel=0.05)
    assert curve.held_out_rmse_after < 0.5 * curve.held_out_rmse_before
    assert curve.explained_share > 0.8


@pytest.mark.parametrize(
    ("worth", "size", "beside", "least"),
    [
        (
            100.0,
            None,
            None,
            EVIDENCE_TO_DISTINGUISH + 100.0 * LAW_TOLERANCE,
        ),  # a table has to be better than a cause
        (100.0, 3, None, EVIDENCE_TO_DISTINGUISH + 100.0 * LAW_TOLERANCE),
        (
            100.0,
            2,
            None,
            -EVIDENCE_TO_DISTINGUISH - 100.0 * LAW_TOLERANCE,
        ),  # a simpler law need not be
        (
            100.0,
            None,
            30.0,
            -EVIDENCE_TO_DISTINGUISH - 130.0 * LAW_TOLERANCE,
        ),  # nor a table where one is needed besides
        (-5.0, None, 30.0, -EVIDENCE_TO_DISTINGUISH - 30.0 * LAW_TOLERANCE),
    ],
)
def test_a_curve_stands_instead_of_terms_that_are_worth_less(
    worth, size, beside, least
):
    terms = [SimpleNamespace(form=SimpleNamespace(n_coefficients=1, n_constants=2))]
    law = size and SimpleNamespace(size=size)
    named = max(worth, 0.0) + (beside or 0.0)
    for more in (0.1, -0.1):
        alone = SimpleNamespace(evidence=named + least + more, law=law)
        other = None if beside is None else SimpleNamespace(evidence=beside)
        assert is_curve_preferred(worth, terms, alone, other) is (more > 0.0)


def test_findings_json_carries_curves_there_and_back(made):
    data = json.loads(json.dumps(made.found.to_dict()))
    assert np.shape(data["curves"][0]["x"]) == (len(data["curves"][0]["torque"]), 2)
    assert Diagnosis.from_dict(data).to_dict() == data
    with pytest.raises(ValueError, match="no variable"):
        Diagnosis.from_dict(
            data | {"curves": [data["curves"][0] | {"of": ["q2", "speed2"]}]}
        )


def test_the_added_curve_takes_the_error_to_the_noise(made):
    bigger = add(made.estimate, made.found, made.data)
    effect = bigger.model.effects[-1]
    assert isinstance(effect, MeasuredCurve)
    assert bigger.theta[-1] == pytest.approx(1.0, abs=0.05)
    judged = compare(bigger, made.test)[0]
    s = judged.signals
    inside = ~effect.outside(Motion(s.t, s.q, s.dq, s.dq))
    assert 0.5 < inside.mean() < 1.0
    floor = made.found.noise_floor[JOINT]
    after = np.sqrt(np.mean(s.residual[inside, JOINT] ** 2))
    assert (
        after
        < 1.4 * floor
        < 5.0 * floor
        < compare(made.estimate, made.test)[0].rmse[JOINT]
    )
    # What lies outside is flagged.
    ((name, share),) = judged.outside.items()
    assert name == effect.parameters[0].name
    assert share == pytest.approx(1.0 - inside.mean(), abs=1e-3)
    assert any(
        "outside of a measured curve" in line.text for line in judged.verdict.lines
    )
    # Nobody has been there: flagged, though its law says what to expect.
    curve = made.found.curves[0]
    state = np.zeros((2, len(curve.filled_x), made.estimate.robot.n))
    state[:, :, JOINT] = curve.filled_x.T
    there = Motion(np.arange(state.shape[1]) / 100.0, *state, state[0])
    assert np.all(effect.outside(there))
    np.testing.assert_allclose(
        effect.column(there, JOINT), curve.filled_torque, atol=1e-4
    )
    np.testing.assert_allclose(
        curve.filled_torque, SIZE * np.prod(curve.filled_x, axis=1), atol=0.02
    )
    (written,) = parse_effects(effect.text, made.estimate.robot)
    restored = make_effect(
        EffectEntry.from_dict(json.loads(json.dumps(effect.entry.to_dict()))),
        made.estimate.robot,
    )
    assert written.entry == restored.entry == effect.entry


def test_what_one_stretch_of_time_shows_is_no_curve():
    rows = SimpleNamespace(run=np.zeros(800), keep=np.ones((800, 1), bool))
    assert is_an_event(np.arange(800) < 100, rows)
    assert not is_an_event(np.arange(800) % 100 < 10, rows)


@pytest.mark.long
@pytest.mark.parametrize(
    ("law", "of", "constants"),
    [
        (lambda m: np.tanh((m.q[:, 0] - m.q[:, 1]) / 0.3), {"q1-q2"}, {}),
        # Beside the noise that each leaves it explains more than a wave of their sum,
        # which comes near.
        (
            lambda m: np.sin(3.9 * m.q[:, 1] + 3.0 * m.q[:, 0]),
            {"q1", "q2"},
            {"q1": 3.0, "q2": 3.9},
        ),
    ],
)
def test_a_law_is_found_as_one_and_added(law, of, constants):
    made = diagnosed(law)
    (curve,) = made.found.curves[:1]
    assert (curve.joint, {*curve.of}) == (JOINT + 1, of)
    for variable, constant in constants.items():
        (number,) = re.findall(rf"(\d+\.?\d*) {variable}", curve.formula)
        assert float(number) == pytest.approx(constant, rel=0.05)
    assert constants or "tanh((q1-q2) / 0." in curve.formula
    assert len(of) == 2 or not made.found.beside_curves
    bigger = add(made.estimate, made.found, made.data)
    before = compare(made.estimate, made.test)[0].rmse[JOINT]
    after = compare(bigger, made.test)[0].rmse[JOINT]
    assert after < 0.3 * before


@pytest.mark.long
def test_a_fold_beside_which_a_joint_turned_one_way_knows_nothing_of_what_differs_by_direction():
    """Its table had a single point on one axis: a division by zero."""
    made = diagnosed(
        lambda m: np.sign(np.sin(5.0 * m.q[:, JOINT])) * np.sign(m.dq[:, JOINT]),
        duration=16.0,
    )
    rows = diagnosis_rows(
        made.data, made.estimate, made.estimate.preprocessing.resolve(made.data)
    )
    dq = rows.dq[:, JOINT]
    fold = (dq > -0.02 * dq.max()).astype(int)
    (curve,) = measure_curves(
        Search(whiten_rows(rows, made.estimate), Library()), [JOINT], fold
    )
    motion = rows.segments[0].motion
    assert curve.fitted.basis.variable_names[1] == f"sign(dq{JOINT + 1})"
    assert not any(
        b.columns.any() for table in curve.by_fold for b in table.blocks(motion)
    )
    assert any(b.columns.any() for b in curve.table.blocks(motion))
