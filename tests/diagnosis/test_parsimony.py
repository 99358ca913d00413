"""Which picks are weighed against each other, and on which rows a search is judged."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from random_arms import scara
from small_runs import small_run

from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.diagnosis import held_out, ladder, parsimony
from sdp_vs_penalty.diagnosis.explanations import weaknesses
from sdp_vs_penalty.diagnosis.rows import diagnosis_rows
from sdp_vs_penalty.diagnosis.stage import prepare
from sdp_vs_penalty.diagnosis.state import SearchState
from sdp_vs_penalty.effects import parse_effects
from sdp_vs_penalty.effects.model import Model
from sdp_vs_penalty.estimation.identify import identify
from sdp_vs_penalty.problem.load import as_problem, load_problem


def state_of(*picks: tuple[int | None, float], left: float = 0.0) -> Any:
    """A search with picks on two joints, each with its gain, which is what it explains; so much is left
    on either beyond the noise."""
    weighting = SimpleNamespace(noise_variance=np.ones(2), level=np.ones(2))
    fit = SimpleNamespace(
        degrees=np.array([100.0, 100.0]), weighting=weighting, joint_chi2=np.full(2, 100.0)
    )
    made = [
        SimpleNamespace(
            candidate=SimpleNamespace(
                key=(f"effect {k}", joint), effect=SimpleNamespace(name=f"effect {k}", refines=())
            ),
            gain=gain,
            rivals=(),
        )
        for k, (joint, gain) in enumerate(picks)
    ]

    def with_picks(picks: Any) -> Any:
        left = fit.joint_chi2.copy()
        for pick in made:
            if not any(pick is p for p in picks):
                joint = pick.candidate.key[1]
                left[slice(None) if joint is None else joint] += pick.gain
        return SimpleNamespace(
            picks=tuple(picks),
            fit=SimpleNamespace(degrees=fit.degrees, weighting=weighting, joint_chi2=left),
            with_picks=with_picks,
            without=lambda k: with_picks([*picks[:k], *picks[k + 1 :]]),
        )

    fit.joint_chi2 += left
    return with_picks(made)


@pytest.fixture
def taken(monkeypatch: pytest.MonkeyPatch) -> set[frozenset[int]]:
    """Pairs of picks that take each other's energy; picks of the whole robot act on both joints."""
    pairs: set[frozenset[int]] = set()
    monkeypatch.setattr(parsimony, "_taken", lambda _, a, b: float(frozenset((a, b)) in pairs))
    monkeypatch.setattr(
        parsimony, "joints_of", lambda _, c: np.array([0, 1] if c.key[1] is None else [c.key[1]])
    )
    return pairs


def test_one_law_is_sought_for_correlated_picks_of_one_joint(taken: set[frozenset[int]]) -> None:
    state = state_of((0, 1.0), (0, 1.0), (1, 1.0), (None, 1.0), (None, 1.0), (0, 1.0))
    taken |= {frozenset(pair) for pair in ((0, 1), (0, 2), (0, 3), (3, 4))}
    assert parsimony._pairs(state) == [(0, 1)]
    taken.add(frozenset((1, 5)))
    assert parsimony._pairs(state) == [(0, 1), (1, 5)]
    # A tilt beside a spring that a wrong geometry explains as well: of the whole robot, like the tilt.
    state.picks[2].rivals = (SimpleNamespace(key=("kinematic_error", None)),)
    assert parsimony._pairs(state) == [(0, 1), (2, 3), (2, 4), (1, 5)]


def test_what_stands_beside_a_pick(taken: set[frozenset[int]]) -> None:
    """What takes its energy, and what explains far more on its joint."""
    state = state_of((0, 100.0), (0, 0.5 * parsimony.LAW * 100.0), (1, 1e6))
    taken.add(frozenset((0, 1)))
    assert parsimony.correlated(state, 1) == (state.picks[0],)
    assert parsimony.correlated(state, 2) == ()
    assert [parsimony.overshadowed(state, k) for k in range(3)] == [None, state.picks[0], None]
    assert not any(parsimony._drowned(state, k) for k in range(3))


def test_what_others_or_nothing_may_leave_is_not_offered(
    taken: set[frozenset[int]], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(parsimony, "_plain_again", lambda state, k: False)
    picks = (0, 100.0), (0, 0.9 * parsimony.PART * 100.0), (1, 1e6)
    for share, same, kept in ((0.0, "effect 0", [0, 2]), (0.0, "", [0, 1, 2]), (1.1, "", [2])):
        state = state_of(*picks, left=share * parsimony.UNNAMED * 100.0)
        state.picks[1].candidate.effect.refines = (same,)
        assert parsimony.believable(state).picks == tuple(state.picks[k] for k in kept)


def test_a_finer_form_of_which_the_models_own_law_makes_nearly_all_is_none() -> None:
    dq = np.linspace(-1.0, 1.0, 101)[:, None]
    Q = dq / np.linalg.norm(dq)
    base = SimpleNamespace(scaled=lambda x: x, partialled=lambda x: x - Q @ (Q.T @ x))

    def plain_again(alpha: float, *refines: str) -> bool:
        candidate = SimpleNamespace(
            columns=np.sign(dq) * abs(dq) ** alpha, effect=SimpleNamespace(refines=refines)
        )
        state: Any = SimpleNamespace(base=base, picks=[SimpleNamespace(candidate=candidate)])
        return parsimony._plain_again(state, 0)

    assert plain_again(0.99, "viscous_friction")
    assert not plain_again(1.5, "viscous_friction")
    assert not plain_again(0.99)  # what refines no law may show however much of it the model takes


def test_a_finer_law_is_held_to_more_beside_the_law_that_it_refines() -> None:
    def pick(name: str, *refines: str) -> Any:
        effect = SimpleNamespace(name=name, refines=refines)
        return SimpleNamespace(candidate=SimpleNamespace(effect=effect))

    law = pick("presliding_hysteresis", "coulomb_friction")
    finer = pick("load_dependent_hysteresis", "presliding_hysteresis", "coulomb_friction")
    assert parsimony._own_error(finer, law) > parsimony._own_error(law, finer)
    assert parsimony._own_error(pick("stribeck_friction", "coulomb_friction"), law) == parsimony.LAW


def test_what_bends_the_model_s_own_friction_by_little_may_be_its_error() -> None:
    robot = load_problem("panda").robot
    effects = parse_effects("coulomb_friction:1+2,torque_offset:2", robot)
    estimate: Any = SimpleNamespace(model=Model(robot, effects), theta=np.array([0.5, 2.0, 9.0]))
    law = parse_effects("presliding_hysteresis:2", robot)[0]
    assert parsimony.bent(estimate, law, 0.09) == "coulomb_friction"
    assert parsimony.bent(estimate, law, 0.11) == ""
    assert parsimony.bent(estimate, parse_effects("presliding_hysteresis:1", robot)[0], 0.03) == ""
    assert parsimony.bent(estimate, parse_effects("joint_spring:2", robot)[0], 0.01) == ""
    # A size in another unit is none of that friction's.
    assert parsimony.bent(estimate, parse_effects("load_dependent_friction:2", robot)[0], 0.01) == ""


def test_what_is_wrong_on_one_joint_and_shows_on_others_is_judged_by_all() -> None:
    robot = load_problem("panda").robot
    acts = {
        name: held_out._acts(SimpleNamespace(candidate=SimpleNamespace(effect=effect)))  # type: ignore[arg-type]
        for name in ("joint_zero_error:2", "presliding_hysteresis:2", "base_tilt")
        for effect in parse_effects(name, robot)
    }
    assert acts == {
        "joint_zero_error:2": slice(None),
        "presliding_hysteresis:2": [1],
        "base_tilt": slice(None),
    }


def test_every_row_is_left_out_once(monkeypatch: pytest.MonkeyPatch) -> None:
    stage = SimpleNamespace(labels=SimpleNamespace(fold=np.arange(40) // 4))
    monkeypatch.setattr(held_out, "_stage_on", lambda _, train, keys: train)
    monkeypatch.setattr(held_out, "_looked_for", lambda picks: picks)
    start = SimpleNamespace(start=lambda train: train)
    monkeypatch.setattr(held_out, "SearchState", start)
    monkeypatch.setattr(held_out, "climbed", lambda train, thorough: SimpleNamespace(picks=(train,)))
    monkeypatch.setattr(held_out, "reshaped", lambda train: SimpleNamespace(effects=[]))
    state = SimpleNamespace(stage=stage, picks=(), on=lambda train: train)
    found: Any = SimpleNamespace(state=state)
    searched = [fold[:2] for fold in held_out.OnFolds(found)._searched]
    assert len(searched) > 2
    np.testing.assert_array_equal(sum(~train for train, _ in searched), 1)
    assert all(own == (train,) for train, own in searched)


def test_a_folds_pick_stands_for_that_of_the_nearest_constants() -> None:
    robot = load_problem("panda").robot

    def pick(text: str) -> Any:
        (effect,) = parse_effects(text, robot)
        return SimpleNamespace(
            candidate=SimpleNamespace(effect=effect, key=(effect.name, effect.joints[0]))
        )

    gears = "transmission_friction:5+6@c5=1@c6="
    picks = [
        pick(text)
        for text in (
            f"{gears}1@law=viscous",
            "torque_ripple:2@k=5",
            f"{gears}2@law=coulomb",
            "torque_ripple:2@k=9",
        )
    ]
    stands = {
        f"{gears}2@law=coulomb": 2,
        f"{gears}1@law=coulomb": 0,  # one constant differs from either: the first
        f"{gears}1@law=viscous": 0,
        "torque_ripple:2@k=8": 3,
        "torque_ripple:2@k=4": 1,
        "torque_ripple:3@k=5": 4,
    }
    assert {text: held_out._stands_for(pick(text), picks) for text in stands} == stands


def test_what_else_looks_like_a_finding_makes_it_weak() -> None:
    assert weaknesses(False, False, False, False, "", "") == ()
    assert weaknesses(False, False, False, False, "", "it may stick") == ("it may stick",)


def test_what_joints_share_comes_before_small_effects_on_one_of_them() -> None:
    def pick(
        name: str, joint: int, gain: float, refines: tuple[str, ...] = (), joins: bool = False
    ) -> Any:
        effect = SimpleNamespace(
            joins=joins, refines=refines, joints=[joint, joint + 1], whole_robot=False
        )
        return SimpleNamespace(candidate=SimpleNamespace(key=(name, joint), effect=effect), gain=gain)

    picks = (
        pick("sigmoid", 5, 41.0),
        pick("gears", 4, 3910.0, joins=True),
        pick("curved", 5, 50.0, refines=("sigmoid",)),
    )
    state = SimpleNamespace(picks=picks, with_picks=lambda chosen: [p.candidate.key[0] for p in chosen])
    assert ladder.by_gain(state) == ["gears", "sigmoid", "curved"]  # type: ignore[arg-type,comparison-overlap]


def test_a_rotor_on_a_parallel_axis_is_no_motor_that_drives_through_two(tmp_path: Path) -> None:
    """I (ddq1 - ddq2) (1, -1) is a rotor of 2 I on joint 2 beside what the links have themselves."""
    arm = as_problem(scara(tmp_path))
    run = small_run(arm, 12.0)
    ddq, both = np.gradient(run.dq, run.t, axis=0), np.array([1.0, 1.0, 0.0, 0.0])
    belt = np.tanh(run.dq @ both / 0.01)[:, None] * both  # which drives joint 1 with joint 2
    torque = run.tau + np.array([0.0, 0.3, 0.0, 0.0]) * ddq + 0.3 * belt
    run = Measurements(run.t, run.q, torque, run.dq)
    known = identify(arm, run, "ols")
    rows = diagnosis_rows(run, known, known.preprocessing.resolve(run))
    state = SearchState.start(prepare(rows, known, frozen=False, seed=0))
    found = {}
    for text in (
        "rotor_inertia:2",
        "transmission_friction:1+2@c2=-1@law=inertia",
        "transmission_friction:1+2",
    ):
        (effect,) = parse_effects([text], arm.robot)
        columns = state.stage.candidates.white_columns(effect)
        key = (effect.name, 0 if effect.joins else 1)
        pick = ladder.accepted(state, state.stage.candidates.judged(state.fit, key, effect, columns))
        assert pick is not None
        found[text] = pick
        if effect.joins:
            state = state.with_picks((*state.picks, pick))
    rotor, motor, _ = (pick.candidate for pick in found.values())
    assert rotor.beta[0] == pytest.approx(2.0 * motor.beta[0])
    assert rotor.chi2 == pytest.approx(motor.chi2)
    merged = {p.candidate.effect.text for p in parsimony.merged(state).picks}
    assert merged == {"rotor_inertia:2", "transmission_friction:1+2@c1=1@c2=1@law=coulomb"}
