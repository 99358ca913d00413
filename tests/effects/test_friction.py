"""Laws of friction by their properties: what they become in a limit, and the energy that they take."""

from dataclasses import replace

import numpy as np
import pytest
from effect_contract import robots, steady_motion, wide_columns

from sdp_vs_penalty import InputError, load_problem
from sdp_vs_penalty.effects import Effect, Motion, parse_effects

ARM = robots()["arm"]


def columns(text: str, motion: Motion) -> np.ndarray:
    """(N, k) of the one joint on which an effect acts."""
    (effect,) = parse_effects(text, ARM)
    return wide_columns(effect, motion)[effect.joints[0]]


def to_and_fro(period: float = 4.0) -> Motion:
    """Two periods of a motion of milliradians, of centiradians and of a third of a radian."""
    t = np.arange(0.0, 2.0 * period, 1e-3)
    w = 2.0 * np.pi / period
    amplitude = np.array([0.004, 0.02, 0.3])
    wave = np.column_stack([np.sin(w * t) + 0.3 * np.sin(3 * w * t)] * 3)
    rate = np.column_stack([w * np.cos(w * t) + 0.9 * w * np.cos(3 * w * t)] * 3)
    return Motion(t, amplitude * wave, amplitude * rate, np.zeros_like(wave), sign_width=1e-4)


@pytest.mark.parametrize("joint", [1, 2, 3])
@pytest.mark.parametrize("name", ["presliding_hysteresis", "maxwell_slip"])
def test_friction_that_remembers_takes_energy_in_every_cycle(name, joint):
    motion = to_and_fro()
    z = columns(f"{name}:{joint}@d=0.002", motion)
    if name == "presliding_hysteresis":  # Coulomb's part is a parameter of its own
        z = z + columns(f"coulomb_friction:{joint}@v_s=0.0001", motion)
    last = motion.t >= 4.0
    power = z[last] * motion.dq[last, joint - 1][:, None]
    assert np.all(np.abs(z) <= 1.0)
    assert np.all(power.sum(axis=0) >= -1e-3 * np.abs(power).sum(axis=0))
    assert power.sum() > 0.05 * np.abs(power).sum()


def test_a_slider_of_no_travel_is_coulombs_and_a_long_one_a_spring():
    motion = to_and_fro()
    sliders = columns("maxwell_slip:3@d=0.000001", motion)
    moving = np.abs(motion.dq[:, 2]) > 0.05
    np.testing.assert_allclose(
        sliders[moving], np.sign(motion.dq[moving, 2])[:, None] * np.ones(3), atol=1e-9
    )
    spring = columns("maxwell_slip:1@d=1", motion)[2000:, 2]  # from the first reversals on
    travel = motion.q[2000:, 0] - motion.q[2000, 0]
    np.testing.assert_allclose(spring - spring[0], travel / 16.0, atol=1e-12)


def test_hysteresis_under_load_is_load_dependent_friction_once_it_slides():
    motion = steady_motion(ARM)
    np.testing.assert_allclose(
        columns("load_dependent_hysteresis:2@d=0.0001", motion),
        columns("load_dependent_friction:2", motion),
        rtol=1e-6,
    )


@pytest.mark.parametrize("waves", [1, 2])
def test_friction_that_varies_with_position_is_nowhere_negative(waves):
    """Of random parameters exactly those pass whose friction is nowhere below zero."""
    problem = load_problem("two_link")
    own = f"position_dependent_friction:2@k=3@waves={waves}"
    model = problem.model(f"rigid_body,coulomb_friction,{own}")
    demands = [c for c in problem.constraints(model).convex if own.split(":")[0] in c.name]
    demands = [c for c in demands if c.family == "sign"]
    effect: Effect = model.effects[2]
    q = np.linspace(-np.pi, np.pi, 2000)
    still = np.column_stack([q, q])
    moving = Motion(q, still, np.ones_like(still), still)
    shape = wide_columns(effect, moving)[1]
    rng = np.random.default_rng(waves)
    verdicts = []
    for _ in range(200):
        theta = np.zeros(len(model.parameters))
        theta[model.indices[1]], theta[model.indices[2]] = 1.0, rng.normal(size=2 * waves, scale=0.4)
        lowest = float(np.min(1.0 + shape @ theta[model.indices[2]]))
        if abs(lowest) > 0.02:
            verdicts.append((all(c.margin(theta) >= 0.0 for c in demands), lowest > 0.0))
    assert all(kept == positive for kept, positive in verdicts)
    assert {kept for kept, _ in verdicts} == {True, False}


def test_warming_by_the_clock_is_settling_drift_and_by_temperature_needs_one():
    motion = steady_motion(ARM)
    for law, form in (("coulomb", 2), ("viscous", 4)):
        by_clock = columns(f"warming_friction:2@law={law}@by=clock@T=40@t0=3", motion)
        drift = columns(f"drift_friction:2@form={form}@T=40@t0=3", motion)
        np.testing.assert_array_equal(by_clock, drift)
    hot = replace(motion, temperature=motion.joint_temperature + 20.0 * np.log(2.0))
    text = "warming_friction:2@by=temperature@warm=20"
    np.testing.assert_allclose(columns(text, hot), 0.5 * columns(text, motion))
    with pytest.raises(InputError, match=r"hold no temperatures: add columns temp1\.\.tempn"):
        columns(text, replace(motion, temperature=None))
