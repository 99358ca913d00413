"""The diagnosis on simulated measurements: what is hidden is named, what is clean stays
clean."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from small_runs import small_run, thinned

from sdp_vs_penalty import (
    InputError,
    add,
    compare,
    diagnose,
    identify,
    load_problem,
    simulate,
)
from sdp_vs_penalty.cli import printing
from sdp_vs_penalty.data import Measurements, concatenate, save
from sdp_vs_penalty.diagnosis import (
    Diagnosis,
    diagnosis_rows,
    least_squares_refit,
    whiten_rows,
)
from sdp_vs_penalty.diagnosis.diagnose import diagnose as search
from sdp_vs_penalty.diagnosis.doubts import Doubt
from sdp_vs_penalty.diagnosis.finding import effect_on
from sdp_vs_penalty.diagnosis.sentences import advice, besides
from sdp_vs_penalty.effects import Motion
from sdp_vs_penalty.effects.written import WrittenEffect
from sdp_vs_penalty.simulation.hidden_runs import hidden_runs


def identified(made, data):
    return identify(
        made.problem, data, "ols", effects=made.truth["model_effects"], check=False
    )


def diagnosed(made, runs=3, **options):
    data = concatenate(made.runs[:runs])
    return diagnose(identified(made, data), data, made.runs[3], **options)


@pytest.fixture(scope="module")
def stribeck(panda):
    made = hidden_runs(panda, [("stribeck_friction", [2])], "medium", seed=11)
    return thinned(made, step=4)


@pytest.fixture(scope="module")
def found(stribeck):
    return diagnosed(stribeck, runs=1)


def test_the_hidden_effect_is_named_with_joint_size_and_shape(stribeck, found):
    first = found.effects[0]
    hidden = stribeck.hidden[0]
    assert found.verdict == "effect_missing"
    assert (first.effect, first.joints) == ("stribeck_friction", (3,))
    assert first.size == pytest.approx(hidden.size, rel=0.1)
    assert first.shape["vs"] == pytest.approx(hidden.shape["vs"], rel=0.2)
    assert first.std < 0.2 * first.size
    assert first.unit == "N*m"
    before, after = found.errors_of(first)
    assert after[2] < 0.8 * before[2]
    assert found.ladder[-1][2] < 1.25 * found.noise_floor[2]
    np.testing.assert_allclose(np.delete(after, 2), np.delete(before, 2), rtol=0.1)


def test_findings_json_is_the_interface(found):
    data = json.loads(json.dumps(found.to_dict()))
    assert data["held_out_source"] == "test"
    # identify had no Stribeck friction to blame: its Coulomb turned too early, on that
    # joint only.
    assert {r["joint"] for r in data["retuned"]} <= {3}
    assert [e["number"] for e in data["effects"]] == list(
        range(1, len(data["effects"]) + 1)
    )
    assert Diagnosis.from_dict(data).to_dict() == data
    for finding in data["effects"]:
        assert bool(finding["remarks"]) == (finding["confidence"] == "weak")


def test_what_the_links_absorb_is_reported_as_invisible(found):
    hidden = {(i.effect, i.joints) for i in found.invisible}
    assert {
        ("rotor_inertia", (1,)),
        ("rotor_inertia", (2,)),
        ("joint_zero_error", (1,)),
    } <= hidden
    assert ("rotor_inertia", (5,)) not in hidden
    assert all(0.99 < i.absorbed_share <= 1.0 for i in found.invisible)


@pytest.mark.parametrize(
    ("name", "seed"),
    [pytest.param("panda", 12, marks=pytest.mark.long), ("two_link", 13)],
)
def test_clean_measurements_stay_clean(name, seed):
    result = diagnosed(thinned(hidden_runs(load_problem(name), [], 0.0, seed=seed)))
    assert result.verdict == "nothing_missing"


@pytest.mark.slow
def test_what_has_changed_of_a_held_model_is_judged_and_not_added_twice(panda):
    later = hidden_runs(
        panda, [("payload", []), ("torque_offset", [4])], "strong", seed=18
    )
    empty = hidden_runs(panda, [], 0.0, seed=17, world=later.world)
    estimate = identified(empty, concatenate(empty.runs[:3]))
    data = concatenate(later.runs[:3])
    result = diagnose(estimate, data, later.runs[3], frozen=True)
    named = {(f.effect, f.joints) for f in result.effects}
    assert {("payload", ()), ("torque_offset", (5,))} <= named

    bigger = add(estimate, result, data)
    new = bigger.model.effects[len(estimate.model.effects) :]
    assert "payload" in {e.name for e in new}
    assert "torque_offset" not in {e.name for e in new}
    np.testing.assert_array_equal(bigger.theta[: len(estimate.theta)], estimate.theta)
    own = [f for f in result.effects if f.effect == "torque_offset"]
    with pytest.raises(InputError, match="the held model's own"):
        add(estimate, replace(result, effects=tuple(own), curves=()), data)


@pytest.fixture(scope="module")
def slope(two_link):
    effects = [("asymmetric_viscous_friction", [1])]
    return thinned(hidden_runs(two_link, effects, "medium", seed=21), step=4)


@pytest.mark.long
@pytest.mark.parametrize(
    "what",
    [
        "slower log",
        "one run",
        "no repeats",
        pytest.param("unequal", marks=pytest.mark.slow),
    ],
)
def test_two_joints_whatever_the_record(slope, what):
    runs = list(slope.runs[:3])
    if what == "slower log":
        runs = [
            Measurements(r.t[::3], r.q[::3], r.tau[::3], names=r.names) for r in runs
        ]
    elif what == "one run":
        runs = runs[:1]
    elif what == "unequal":
        runs = [runs[0], runs[1].window(0.0, 11.0), runs[2].window(3.0, 19.0)]
    elif what == "no repeats":
        # Logs of their own, not parts of longer ones in which the motion repeats.
        runs = [
            Measurements(p.t, p.q, p.tau, names=p.names)
            for p in (r.window(0.0, 12.0) for r in runs)
        ]
    data = concatenate(runs)
    result = diagnose(identified(slope, data), data, slope.runs[3])
    first = result.effects[0]
    assert (first.effect, first.joints) == ("asymmetric_viscous_friction", (2,))
    assert result.noise_source == ("spectrum" if what == "no repeats" else "repetition")
    assert ("four times too large" in result.headline) == (what == "no repeats")
    if what == "no repeats":
        said = " ".join((*besides(result), *result.remarks))
        assert said.lower().count("no motion repeats") == 1


def test_a_weak_or_ambiguous_finding_says_which_run_would_tell(found, capsys):
    first = replace(found.effects[0], rivals=(), doubts=())
    assert first.undecided is None
    weak = replace(first, doubts=(Doubt("alone"),))
    assert weak.undecided == (first.text,)
    for effects, said in (
        ((first, weak), "Add what helps"),
        ((weak,), "all are weak"),
        ((), "Use"),
    ):
        missing = {"verdict": "effect_missing", "retuned": ()}
        assert said in advice(replace(found, effects=effects, **missing))
    printing.diagnosis(
        replace(found, effects=(weak,)), ["N*m"] * 7, Path("m.json"), False
    )
    said = " ".join(capsys.readouterr().out.split())
    assert "To test finding 1, record: sdp-vs-penalty excite m.json" in said
    assert said.endswith("--out tell1.csv")
    rivals = (WrittenEffect("sigmoid_friction", (3,)),)
    told_apart = replace(first, rivals=rivals).undecided
    assert told_apart == (first.text, "sigmoid_friction:3")
    on_the_robot = replace(first, rivals=(effect_on("base_tilt", first.joints),))
    assert on_the_robot.undecided == (first.text, "base_tilt")
    assert on_the_robot.telling_run("m.json").endswith(",base_tilt --out tell1.csv")
    assert (
        replace(first, doubts=(Doubt("alone"), Doubt("curve")), rivals=rivals).undecided
        is None
    )
    # No motion tells the clock from the temperature: a cold start does.
    warm = replace(
        first, effect="warming_friction", rivals=(WrittenEffect("drift_friction"),)
    )
    assert warm.undecided is None
    assert "cooled down" in warm.cool_down_instruction


def test_the_search_ends_at_the_error_and_the_shape_of_what_add_returns(hidden):
    made = thinned(hidden, step=2)
    data, test = made.runs[0], made.runs[3]
    estimate = identify(
        made.problem, data, effects=made.truth["model_effects"], check=False
    )
    result = diagnose(estimate, data, test)
    bigger = add(estimate, result, data)
    added = compare(bigger, test)[0]
    new = next(e for e in bigger.model.effects if e.name == "presliding_hysteresis")
    assert new.shape["d"] == pytest.approx(hidden.hidden[0].shape["d"], rel=0.15)
    np.testing.assert_allclose(result.ladder[-1], added.rmse, rtol=5e-3)


@pytest.mark.long
def test_a_gain_is_added_beside_its_own_reference(two_link):
    made = thinned(hidden_runs(two_link, [("torque_gain", [1])], "strong", seed=26))
    data = concatenate(made.runs[:3])
    estimate = identify(
        two_link, data, effects=made.truth["model_effects"], check=False
    )
    bigger = add(estimate, "torque_gain:2", data)
    assert abs(bigger.theta[-1]) == pytest.approx(made.hidden[0].size, rel=0.2)
    held = add(bigger, "stribeck_friction:1,sigmoid_friction:2", data, frozen=True)
    np.testing.assert_array_equal(held.theta[:-2], bigger.theta)
    assert np.isfinite(held.uncertainty.standard[-1].std)


@pytest.fixture(scope="module")
def late(two_link):
    """Bristles on both joints, behind a delay of all that is logged."""
    bristles = [("presliding_hysteresis", [j]) for j in (0, 1)]
    effects = [*bristles, ("global_delay", [])]
    return thinned(hidden_runs(two_link, effects, "medium", seed=1), step=2)


def assert_bristles_are_found(made, result):
    """Each with its travel and its size."""
    bristles = [f for f in result.effects if f.effect == "presliding_hysteresis"]
    found = {f.joints[0]: f for f in bristles}
    for joint, hidden in enumerate(made.hidden[:2], start=1):
        assert found[joint].shape["d"] == pytest.approx(hidden.shape["d"], rel=0.05)
        assert found[joint].size == pytest.approx(hidden.size, rel=0.03)


@pytest.mark.long
def test_what_is_logged_late_is_all_of_the_torque(late):
    data = concatenate(late.runs[:2])
    estimate = identified(late, data)
    result = diagnose(estimate, data, late.runs[3])
    assert_bristles_are_found(late, result)
    both = add(estimate, result, data)
    again = diagnose(both, data, late.runs[3])
    added = compare(both, late.runs[3])[0].rmse
    for promised in (result.ladder[-1], again.ladder[-1]):
        np.testing.assert_allclose(promised, added, rtol=0.01)


@pytest.mark.long
def test_a_model_that_has_the_delay_lacks_the_rest_of_it(late):
    data = concatenate(late.runs[:3])
    delayed = add(identified(late, data), "global_delay", data)
    assert_bristles_are_found(late, diagnose(delayed, data))


def test_a_refit_holds_what_is_known_of_the_models_own_sizes(two_link):
    """Rows hardly tell where joints are mounted: by themselves they say 550 times what
    is plausible."""
    made = hidden_runs(two_link, [("joint_spring", [1])], "medium", seed=1, count=2)
    made = thinned(made)
    data = concatenate(made.runs[:2])
    model = add(identified(made, data), "kinematic_error", data)
    white = whiten_rows(
        diagnosis_rows(data, model, model.preprocessing.resolve(data)), model
    )
    known = np.isfinite(plausible := model.model.plausible)
    assert known.any()
    np.testing.assert_array_less(
        np.abs(least_squares_refit(white, [])[0] / plausible)[known], 1.0
    )


def test_what_would_hide_nothing_is_said(panda):
    """Joint 1 turns about the vertical: where its links stand makes no difference to
    gravity."""
    with pytest.raises(InputError, match="joint_zero_error makes no torque on joint 1"):
        hidden_runs(panda, [("joint_zero_error", [0])], "strong", seed=1, count=1)


@pytest.mark.long
def test_how_friction_was_bent_when_the_log_began_is_no_evidence(two_link):
    """A joint that creeps before it moves, on bristles that are bent the other way than
    it creeps."""
    t = np.arange(0.0, 24.0, 0.01)
    travel = 0.004
    size = 0.6
    w = np.array([1.1, 1.7]) * t[:, None]
    begun = np.clip(t[:, None] - 2.0, 0.0, 1.0)
    q = begun**3 * (10.0 - 15.0 * begun + 6.0 * begun**2)
    q = q * (0.5 * np.sin(w) + 0.2 * np.sin(2.3 * w + 1.0)) - 3e-4 * t[:, None]
    dq = np.gradient(q, t, axis=0)
    z = np.full(2, 0.9)
    theta = two_link.nominal(model := two_link.model())
    theta[len(model.rigid_indices) :] = 0.5
    tau = model.torque(theta, Motion(t, q, dq, np.gradient(dq, t, axis=0)))
    for k, step in enumerate(np.diff(q, axis=0, prepend=q[:1])):
        z = np.sign(step) + (z - np.sign(step)) * np.exp(-np.abs(step) / travel)
        tau[k] += size * z
    tau += 0.01 * np.random.default_rng(3).normal(size=tau.shape)
    run = Measurements(t, q, tau)
    # The search alone: a model after `add` is fitted to the rows of the beginning too.
    # v_s is that of the simulation: bristles widen a v_s that is fitted without them,
    # and the start of the search decides nothing here.
    effects = "rigid_body,viscous_friction,coulomb_friction@v_s=0.01,torque_offset"
    model = identify(two_link, run, "ols", effects=effects, check=False)
    result = search(model, run)
    found = {
        f.joints[0]: f for f in result.effects if f.effect == "presliding_hysteresis"
    }
    for joint in (1, 2):
        assert found[joint].shape["d"] == pytest.approx(travel, rel=0.02)
        assert found[joint].size == pytest.approx(size, rel=0.02)
    assert np.all(result.ladder[-1] < 0.01)


@pytest.mark.long
def test_a_rotor_is_weighed_where_motor_and_link_have_encoders(tmp_path):
    """By what the gear yields beside the links' motion; nothing of the kind is found in
    a log of one side, and it survives being added and a run without it."""
    run = small_run(problem := load_problem("two_link"), 30.0)
    w = 2.0 * np.pi * 1.3
    tau = run.tau.copy()
    yielded = 0.02 * np.sin(w * run.t)
    tau[:, 1] -= 0.4 * w**2 * yielded
    both = replace(
        run, tau=tau, commanded={"qmot": run.q + np.outer(yielded, [0.0, 1.0])}
    )
    save(both, tmp_path / "both.csv")
    estimate = identify(problem, both, "ols", check=False)
    found = diagnose(estimate, tmp_path / "both.csv")
    assert [(f.effect, f.joints) for f in found.effects[:1]] == [
        ("motor_inertia", (2,))
    ]
    assert found.effects[0].size == pytest.approx(0.4, rel=0.05)
    bigger = add(estimate, "motor_inertia:2", both)
    assert compare(bigger, both)[0].rmse[1] < 0.2 * compare(estimate, both)[0].rmse[1]
    one_side = replace(both, commanded={})
    assert all(
        f.effect != "motor_inertia" for f in diagnose(estimate, one_side).effects
    )
    with pytest.raises(InputError, match="qmot1"):
        compare(bigger, one_side)


@pytest.mark.long
def test_a_finding_that_one_recording_of_the_test_run_lacks_is_not_confident(two_link):
    """The spring is on in the first recording of the test run, and off in the second.
    The error of both together falls with it."""
    sprung = thinned(simulate(two_link, hide="joint_spring:1", seed=1))
    slack = thinned(simulate(two_link, seed=1))
    model = identify(two_link, list(sprung.train), check=False)
    found = diagnose(model, list(sprung.train), [sprung.test, slack.test], check=False)
    (spring,) = found.effects
    assert spring.effect == "joint_spring"
    before, after = found.errors_of(spring)
    assert after[0] < before[0]
    assert not spring.torque_is_certain


@pytest.fixture(scope="module")
def plain_run():
    """A run of the two-link arm in which the model lacks nothing, at 250 Hz."""
    return simulate("two_link", seed=3).test.rows(slice(None, None, 4))


@pytest.mark.long
def test_commands_before_their_torque_are_a_delay_below_zero(plain_run):
    t = plain_run.t
    early = [np.interp(t + 0.008, t, x) for x in plain_run.tau.T]
    run = replace(plain_run, tau=np.column_stack(early))
    (found,) = diagnose(
        identify("two_link", run, check=False), run, check=False
    ).effects
    assert found.effect == "global_delay"
    assert found.confidence == "confident"
    assert found.size == pytest.approx(-0.008, abs=1.96 * found.std)


@pytest.mark.long
def test_a_constant_is_chosen_where_the_models_own_friction_may_not_fall_below_zero(
    plain_run,
):
    """Friction that falls by 40 % on a straight line: free of signs, an exponential
    over 200 K less a negative friction fits best, which `add` refuses."""
    t = plain_run.t
    speed = np.gradient(plain_run.q[:, 1], t)
    warm = 20.0 + 20.0 * (t - t[0]) / (t[-1] - t[0])
    tau = plain_run.tau.copy()
    tau[:, 1] += 2.0 * (1.0 - 0.4 * (warm - 20.0) / 20.0) * speed
    run = replace(plain_run, tau=tau, temperature=np.column_stack([warm, warm]))
    model = identify("two_link", run, check=False)
    found = diagnose(model, run, check=False)
    first = found.effects[0]
    assert first.text.startswith("warming_friction:2")
    assert first.shape["warm"] == pytest.approx(40.0, rel=0.25)
    bigger = add(model, found, run)
    before, after = (compare(m, run)[0] for m in (model, bigger))
    assert after.rmse[1] < 1.05 * before.noise_floor[1]


@pytest.mark.long
def test_beside_a_likely_fault_of_the_log_nothing_is_sure(plain_run):
    tau = plain_run.tau * [1.0, -1.0]
    run = replace(plain_run, tau=tau)
    with pytest.warns(UserWarning, match="wrong sign"):
        model = identify("two_link", run)
    with pytest.warns(UserWarning, match="wrong sign"):
        found = diagnose(model, run)
    assert found.remedies[0].change.arguments == {"apply": ["sign:tau2"]}
    assert found.headline.startswith(
        "It looks as if the torque of joint 2 has the wrong"
    )
    assert {found.helpful, found.curves, found.passing} == {()}


@pytest.mark.long
def test_a_delay_that_the_check_names_too_is_sure(plain_run):
    t = plain_run.t
    late = [np.interp(t - 0.05, t, x) for x in plain_run.tau.T]
    run = replace(plain_run, tau=np.column_stack(late))
    with pytest.warns(UserWarning, match="late"):
        model = identify("two_link", run)
    with pytest.warns(UserWarning, match="late"):
        found = diagnose(model, run)
    assert {f.effect for f in found.helpful} & {"global_delay", "torque_filter"}
    assert found.log_faults == ()
