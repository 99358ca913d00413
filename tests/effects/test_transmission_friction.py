"""Friction on a combination of joints: it returns by the same ratios, and never feeds energy."""

from dataclasses import replace

import numpy as np
import pytest
from effect_contract import robots, wide_columns

from sdp_vs_penalty import InputError
from sdp_vs_penalty.effects import Effect, Motion, parse_effects
from sdp_vs_penalty.effects.transmission_friction import LAWS
from sdp_vs_penalty.robot import Robot, parse_transmission

ARM = robots()["arm"]
EVERY_LAW = pytest.mark.parametrize("law", LAWS)


def effect(text: str, robot: Robot = ARM) -> Effect:
    (made,) = parse_effects(text, robot)
    return made


def periodic() -> Motion:
    """Two periods of a motion to and fro."""
    a, b = np.random.default_rng(3).normal(size=(2, 3, ARM.n))
    t = np.arange(0.0, 20.0, 0.002)
    w = 2.0 * np.pi * np.arange(1, 4) / 10.0
    s, c = np.sin(np.outer(t, w)), np.cos(np.outer(t, w))
    return Motion(t, s @ a + c @ b, (c * w) @ a - (s * w) @ b, -(s * w**2) @ a - (c * w**2) @ b)


@EVERY_LAW
def test_it_returns_to_the_joints_by_the_ratios_of_the_combination(law):
    ratios = np.array([1.0, -0.75, 2.0])
    made = effect(f"transmission_friction:1+2+3@c1=1@c2=-0.75@c3=2@law={law}")
    columns = wide_columns(made, periodic())[:, :, 0]
    force = columns[0] / ratios[0]
    assert np.abs(force).max() > 0.0
    np.testing.assert_allclose(columns, ratios[:, None] * force, atol=1e-12)


@EVERY_LAW
def test_friction_takes_energy_and_a_rotor_keeps_it(law):
    """At every instant where friction is a function of velocity; over a period where it remembers."""
    motion = periodic()
    made = effect(f"transmission_friction:1+3@c1=1@c3=-0.5@law={law}")
    power = np.einsum("jn,nj->n", wide_columns(made, motion)[:, :, 0], motion.dq)
    period = motion.t >= 10.0
    energy, scale = np.trapezoid(power[period], motion.t[period]), np.abs(power).max()
    if law == "inertia":
        assert abs(energy) < 1e-3 * scale
    elif law == "hysteresis":
        assert power.min() < 0.0  # springs back after a reversal
        assert energy > 0.1 * scale
    else:
        assert power.min() >= 0.0
        assert energy > 0.1 * scale
    assert all(p.lower == 0.0 for p in made.parameters)


def test_laws_and_ratios_are_written_as_words_and_numbers():
    made = effect("transmission_friction:1+2@c1=1@c2=-0.5@law=hysteresis@d=0.01")
    assert made.text == "transmission_friction:1+2@c1=1@c2=-0.5@law=hysteresis@d=0.01"
    assert made.parameters[0].name == "f_t_hysteresis(q1-0.5q2)"
    for text, words in (
        ("transmission_friction:1+2@law=sticky", "law=viscous"),
        ("transmission_friction:1+2@c3=1", "no shape constant 'c3'"),
        ("transmission_friction:1+2@law=coulomb@vs=0.1", "no shape constant 'vs'"),
        ("transmission_friction:1+2@c1=0", "c1 is 0"),
    ):
        with pytest.raises(InputError, match=words):
            effect(text)


def test_a_known_transmission_is_among_the_candidates():
    coupled = replace(ARM, transmission=parse_transmission(["50 q1", "30 q2", "20 q1 - 17 q2 - 17 q3"]))
    kind = type(effect("transmission_friction:1+2"))

    def sought(robot: Robot) -> set[tuple[float, ...]]:
        found = kind.candidates(robot, 0)
        return {tuple(e.shape.get(f"c{j}", 0.0) for j in (1, 2, 3)) for e in found}

    assert (1.0, -0.85, -0.85) in sought(coupled)
    assert (1.0, -0.85, -0.85) not in sought(ARM)
    assert (1.0, 1.0, 0.0) in sought(ARM)
