"""What these data do not tell apart stands in one set, and is not confident.

The logs are of an arm that shares no code with the library (point_mass_arm).
"""

from dataclasses import replace

import numpy as np
import pytest
import scipy
from point_mass_arm import COULOMB, MASSES, PointMassArm, causal_filter, delayed

from sdp_vs_penalty import diagnose, identify, simulate
from sdp_vs_penalty.diagnosis.diagnose import DiagnosisRuns
from sdp_vs_penalty.diagnosis.linear_fit import ScoredEffect
from sdp_vs_penalty.diagnosis.refit import least_squares_refit
from sdp_vs_penalty.diagnosis.search import search
from sdp_vs_penalty.effects import JointResonance, JointSpring, TorqueFilter
from sdp_vs_penalty.robot.inertia import link_sizes
from sdp_vs_penalty.signals import SPECTRUM

EFFECTS = ["rigid_body", "viscous_friction", "coulomb_friction", "torque_offset"]


def diagnosed(problem, arm):
    train = arm.run(1)
    model = identify(problem, train, "ols", effects=EFFECTS, check=False)
    return diagnose(model, train, arm.run(51, periods=2), check=False)


def set_of(finding):
    """The names of a finding and of what is not told from it."""
    return {finding.effect, *(rival.name for rival in finding.rivals)}


def confident(found):
    return {f.text for f in found.effects if f.confidence == "confident"}


def belt(q):
    """A belt between joints 1 and 2, whose pulleys have a ratio of 0.8."""
    pull = 4.0 * (q[:, 1] - 0.8 * q[:, 0])
    return np.column_stack([-0.8 * pull, pull, 0.0 * pull])


def pulled(torque):
    """The arm with a torque (N, 3) of its positions (N, 3)."""
    return PointMassArm(extra=lambda t, q, dq: torque(q))


#: An arm, what is in the set of the first finding ("": there is none), and what may be
#: confident.
SETS = {
    # Rows in which the joints slide do not show it.
    "a tilt of a twelfth of a degree": (
        lambda: PointMassArm(tilt=np.radians(0.08)),
        "",
        set(),
    ),
    # A tilt of two degrees explains nearly as much.
    "a spring, no tilt": (
        lambda: PointMassArm(spring=np.array([0.15, 0.0, 0.0])),
        "joint_spring",
        {"joint_spring:1"},
    ),
    "a spring that does not stiffen": (
        lambda: PointMassArm(spring=np.array([2.0, 0.0, 0.0])),
        "joint_spring",
        {"joint_spring:1"},
    ),
    "a belt over two joints": (
        lambda: pulled(belt),
        "elastic_coupling",
        {"elastic_coupling:1+2"},
    ),
}


@pytest.mark.parametrize(
    "case",
    [
        c if k == 0 else pytest.param(c, marks=pytest.mark.long)
        for k, c in enumerate(SETS)
    ],
)
def test_what_is_not_told_apart_is_not_confident(problem, case):
    arm, member, may_be_confident = SETS[case]
    found = diagnosed(problem, arm())
    first = set_of(found.effects[0]) if found.effects else {""}
    assert member in first
    assert confident(found) <= may_be_confident
    if case == "a belt over two joints":
        assert abs(found.effects[0].size + 3.2) < 0.3
    if case == "a spring that does not stiffen":
        assert confident(found) == may_be_confident


@pytest.mark.long
def test_a_payload_elsewhere_is_no_confident_gain(problem):
    def loaded(x):
        return PointMassArm(masses=(*MASSES, (2, (x, 0.0, 0.0), 1.0)))

    model = identify(problem, loaded(0.25).run(1), "ols", effects=EFFECTS, check=False)
    moved = loaded(0.31)
    found = diagnose(
        model, moved.run(5), moved.run(6, periods=2), frozen=True, check=False
    )
    assert not any("gain" in text for text in confident(found))
    assert any("payload" in set_of(f) for f in found.effects)


@pytest.mark.long
def test_one_delay_of_all_joints_is_not_those_of_single_ones(problem):
    found = diagnosed(problem, PointMassArm(channel=delayed(0.001)))
    assert {"global_delay", "torque_filter"} == set_of(found.effects[0])
    assert len(found.effects) == 1


@pytest.mark.long
def test_a_causal_filter_shows_beside_friction_that_turns_over_a_travel(problem):
    """And leaves the friction as it is."""
    travel = np.array([0.01, 0.008, 0.01])
    arm = PointMassArm(channel=causal_filter(60.0), bristle_travel=travel)
    found = diagnosed(problem, arm)
    friction = {f.joints[0]: f for f in found.effects if "presliding" in f.effect}
    for joint, (size, d) in enumerate(zip((1.5, 1.2, 0.7), travel, strict=True), 1):
        assert friction[joint].size == pytest.approx(size, rel=0.03)
        assert friction[joint].shape["d"] == pytest.approx(d, rel=0.05)
    late = next(f for f in found.effects if f.joints == ())
    assert {"global_delay", "torque_filter"} <= set_of(late)
    assert np.all(found.ladder[-1] < 1.25 * found.noise_floor)


def test_no_drive_looks_ahead(problem):
    """A filter of zero phase is not told from friction that turns round."""
    late = TorqueFilter(problem.robot)
    assert late.resembles == ()
    assert late.with_shape(phase=2.0).resembles == ("presliding_hysteresis",)


@pytest.mark.long
def test_a_spring_that_stiffens_is_no_linear_one(problem):
    found = diagnosed(problem, pulled(lambda q: q**3 * [3.0, 0.0, 0.0]))
    assert confident(found) == {"stiffening_spring:1"}
    assert abs(found.effects[0].size - 3.0) < 0.3


@pytest.mark.long
@pytest.mark.parametrize(
    ("side", "sign"),
    [("above", 1.0), pytest.param("below", -1.0, marks=pytest.mark.slow)],
)
def test_a_spring_on_one_side_only_is_an_end_stop(problem, side, sign):
    def push(q):
        return 6.0 * sign * np.maximum(sign * q - 0.3, 0.0) * [0.0, 1.0, 0.0]

    (found,) = diagnosed(problem, pulled(push)).effects
    assert (found.effect, found.joints, found.confidence) == (
        "end_stop",
        (2,),
        "confident",
    )
    assert found.text.endswith(f"@side={side}")
    assert abs(found.size - 6.0) < 0.3
    assert abs(found.shape["q0"] - 0.3 * sign) < 0.02


@pytest.mark.parametrize("effects", [EFFECTS, EFFECTS[1:]])
def test_a_refit_leaves_links_where_upright_gravity_does_not_show_them(
    problem, effects
):
    """A model of friction alone has none."""
    run = PointMassArm().run(1)
    model = identify(problem, run, "ols", effects=effects, check=False)
    theta, _ = least_squares_refit(DiagnosisRuns(model, run, None).white_data, [])
    assert np.all(np.isfinite(theta))
    links = model.links.ravel() if effects is EFFECTS else np.zeros(0)
    sizes = link_sizes(model.problem.nominal_links).ravel()[: len(links)]
    assert np.all(np.abs(theta[: len(links)] - links) < 0.5 * sizes)


def test_a_swing_that_is_damped_strongly_may_be_play(problem):
    damped = JointResonance(problem.robot, [0], f=2.0, zeta=0.28)
    sprung = JointResonance(problem.robot, [0], f=2.0, zeta=0.03)
    assert damped.resembles == ("backlash",)
    assert damped.is_stand_in
    assert sprung.resembles == ()
    assert not sprung.is_stand_in


@pytest.mark.parametrize(("size", "verdict"), [(0, "nothing"), (3, "unknown")])
def test_noise_of_any_colour_is_no_unknown_torque(problem, size, verdict):
    """It wanders beyond a floor of fast noise, and follows no motion."""

    def wandering(t, torque):
        fast = np.random.default_rng(len(t)).normal(size=torque.shape)
        return torque + scipy.signal.lfilter([0.075], [1.0, -0.95], fast, axis=0)

    arm = pulled(lambda q: np.outer(np.sin(2.0 * q[:, 1]) * q[:, 2] ** 2, [0, size, 0]))
    arm = replace(arm, channel=wandering)
    runs = [arm.run(seed, periods=0.9) for seed in (1, 11)]
    model = identify(problem, runs, "ols", effects=EFFECTS, check=False)
    found = diagnose(model, runs, arm.run(51, periods=0.9), check=False)
    assert found.noise_source == SPECTRUM
    assert found.verdict.startswith(verdict)


def test_a_tone_is_an_unknown_torque(problem):
    """It follows no motion, and goes on through motion that is left out."""

    def humming(t, torque):
        tone = np.outer(0.3 * np.sin(2.0 * np.pi * 2.25 * t), [0.0, 1.0, 0.0])
        fast = np.random.default_rng(len(t)).normal(size=torque.shape)
        return torque + tone + 0.02 * fast

    arm = replace(pulled(lambda q: np.zeros_like(q)), channel=humming)
    runs = [arm.run(seed, periods=0.9) for seed in (1, 11)]
    model = identify(problem, runs, "ols", effects=EFFECTS, check=False)
    found = diagnose(model, runs, arm.run(51, periods=0.9), check=False)
    assert found.verdict == "unknown_effect"
    assert [x.joint for x in found.remains] == [2]


def test_one_cause_has_one_law(problem, monkeypatch):
    """A model with the general law is not offered its special case, and a finer form of
    friction waits until the model's own has its best constant, a second one longer."""
    run = PointMassArm().run(1, periods=2)
    model = identify(problem, run, "ols", effects=[*EFFECTS, "joint_resonance:1"])
    runs = DiagnosisRuns(model, run, None)
    forms = runs.candidates
    offered = {form.key for batch in forms.batches for form in batch.forms}
    assert ("joint_elasticity", 1) in offered
    assert ("joint_elasticity", 0) not in offered
    empty = search(runs.white_data, forms.only(lambda x: False, runs.white_data))
    form = {f.key[0]: f for b in forms.batches for f in b.forms if f.key[1] == 1}
    terms = [
        ScoredEffect(form[name], {}, drop)
        for name, drop in (("sigmoid_friction", 90.0), ("coulomb_friction", 60.0))
    ]
    monkeypatch.setattr(empty, "top_candidates", lambda *_: terms)
    assert empty.best_addition() is terms[1]
    # A second law waits until the columns follow the first and the model's constant.
    terms.pop()
    columns = empty.columns(form["stribeck_friction"])
    empty.terms = [ScoredEffect(form["stribeck_friction"], columns, 50.0)]
    assert empty.best_addition() is None
    assert empty.has_waiting
    empty.is_referred = True
    assert empty.best_addition() is terms[0]


def test_another_form_of_dry_friction_is_named_as_one_law(problem):
    """Its width is near that of the tanh that identify fits to it."""

    def turns(t, q, dq):
        return COULOMB * (dq / np.hypot(dq, 0.05) - np.tanh(dq / 0.01))

    found = diagnosed(problem, PointMassArm(extra=turns))
    assert {f.effect for f in found.effects} == {"sigmoid_friction"}
    first = found.effects[0]
    assert first.rating == "confident"
    assert first.constants.endswith("law = algebraic")
    assert first.shape["v0"] == pytest.approx(0.05, rel=0.02)
    assert first.size == pytest.approx(COULOMB[first.joints[0] - 1], rel=0.1)
    assert [found.offers.offer_of(f).certainty for f in found.effects] == [
        f.rating for f in found.effects
    ]


@pytest.mark.long
def test_an_effect_that_contradicts_itself_is_not_found(problem, monkeypatch):
    """Another one that follows the position takes its place, if there is one."""
    run = PointMassArm(spring=np.array([3.0, 0.0, 0.0])).run(1)
    model = identify(problem, run, "ols", effects=EFFECTS, check=False)
    runs = DiagnosisRuns(model, run, None)
    data = runs.white_data
    springs = runs.candidates.only(lambda x: x.effect.name == "joint_spring", data)
    spring = "joint_spring", 0
    assert {t.key for t in search(data, springs).terms} == {spring}
    monkeypatch.setattr(JointSpring, "contradicts_itself", lambda *_: True)
    without = search(data, springs)
    assert spring in without.barred
    assert not without.terms
    found = {t.key for t in search(data, runs.candidates).terms}
    assert found
    assert spring not in found


@pytest.mark.long
@pytest.mark.parametrize(
    ("hidden", "is_open"), [("stiction:2", True), ("presliding_hysteresis:2", False)]
)
def test_stiction_fits_where_the_travel_of_friction_that_turns_is_open(hidden, is_open):
    """Though no joint stands in these runs; where the travel shows, it does not fit."""
    runs = simulate("panda", hide=hidden, level="medium", seed=11)
    model = identify("panda", runs.train, effects=EFFECTS, check=False)
    (found,) = diagnose(model, runs.train, runs.test, check=False).effects
    assert found.effect == "presliding_hysteresis"
    assert ("stiction" in set_of(found)) == found.size_may_be_zero == is_open
