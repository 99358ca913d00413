"""Laws of friction by their properties: what they become in a limit, and the energy
that they take."""

from dataclasses import replace

import numpy as np
import pytest

from sdp_vs_penalty.effects import Motion, effect_types, parse_effects
from sdp_vs_penalty.effects.transmission import LAWS
from sdp_vs_penalty.robot import parse_transmission
from sdp_vs_penalty.testing.effect_contract import robots, wide_columns

ARM = robots()["arm"]


def to_and_fro(period=4.0):
    """Two periods of a motion of milliradians, of centiradians and of a third of a
    radian."""
    t = np.arange(0.0, 2.0 * period, 1e-3)
    w = 2.0 * np.pi / period * np.array([1.0, 3.0])
    s = np.sin(np.outer(t, w))
    c = np.cos(np.outer(t, w))
    size = np.outer([1.0, 0.3], [0.004, 0.02, 0.3])
    return Motion(t, s @ size, (c * w) @ size, -(s * w**2) @ size, sign_width=1e-4)


MEMORY = [
    f"{name}:{j}@d=0.002"
    for name in ("presliding_hysteresis", "maxwell_slip")
    for j in (1, 2, 3)
]
WRIST = [f"transmission_friction:1+3@c1=1@c3=-0.5@law={law}" for law in LAWS]


@pytest.mark.parametrize("text", [*MEMORY, *WRIST])
def test_friction_takes_energy_and_a_rotor_keeps_it(text):
    """At every instant where friction is a function of velocity; over a period where it
    remembers."""
    motion = to_and_fro()
    (made,) = parse_effects(text, ARM)
    z = wide_columns(made, motion)
    if text in MEMORY:
        if "presliding" in text:  # Coulomb's part is a parameter of its own
            (dry,) = parse_effects(
                f"coulomb_friction:{made.joints[0] + 1}@v_s=0.0001", ARM
            )
            z = z + wide_columns(dry, motion)
        assert np.all(np.abs(z) <= 1.0)
    power = np.einsum("jnk,nj->nk", z, motion.dq)[motion.t >= 4.0]
    energy = power.sum(axis=0)
    moved = np.abs(power).sum(axis=0)
    if text.endswith("inertia"):
        assert np.all(np.abs(energy) < 1e-3 * moved)
        return
    assert np.all(energy >= -1e-3 * moved)
    assert energy.sum() > 0.05 * moved.sum()
    assert (power.min() < 0.0) == (
        text in MEMORY or text.endswith("hysteresis")
    )  # springs back
    assert all(p.lower == 0.0 for p in made.parameters) or text in MEMORY


@pytest.mark.parametrize(
    "text", [*MEMORY, "stiction:2@d=0.001", WRIST[LAWS.index("hysteresis")]]
)
def test_states_that_are_advanced_step_by_step_are_those_along_the_motion(text):
    (made,) = parse_effects(text, ARM)
    motion = to_and_fro(period=1.0)
    q = motion.q
    along = made.bristles.along(motion)
    z = along[:1]
    for k in range(1, len(q)):
        z = made.bristles.advanced(z, q[k : k + 1] - q[k - 1 : k])
        np.testing.assert_allclose(z[0], along[k], atol=1e-9)


@pytest.mark.parametrize("waves", [1, 2])
def test_friction_that_varies_with_position_is_nowhere_negative(two_link, waves):
    """Of random parameters exactly those pass whose friction is nowhere below zero."""
    own = f"position_dependent_friction:2@k=3@waves={waves}"
    model = two_link.model(f"rigid_body,coulomb_friction,{own}")
    demands = [
        c for c in two_link.constraints(model).convex if own.split(":")[0] in c.name
    ]
    demands = [c for c in demands if c.family == "sign"]
    effect = model.effects[2]
    q = np.linspace(-np.pi, np.pi, 2000)
    still = np.column_stack([q, q])
    moving = Motion(q, still, np.ones_like(still), still)
    shape = wide_columns(effect, moving)[1]
    rng = np.random.default_rng(waves)
    verdicts = []
    for _ in range(200):
        theta = np.zeros(len(model.parameters))
        theta[model.indices[1]], theta[model.indices[2]] = (
            1.0,
            rng.normal(size=2 * waves, scale=0.4),
        )
        lowest = float(np.min(1.0 + shape @ theta[model.indices[2]]))
        if abs(lowest) > 0.02:
            verdicts.append(
                (all(c.margin(theta) >= 0.0 for c in demands), lowest > 0.0)
            )
    assert all(kept == positive for kept, positive in verdicts)
    assert {kept for kept, _ in verdicts} == {True, False}


def test_laws_and_ratios_are_written_as_words_and_numbers():
    text = "transmission_friction:1+2@c1=1@c2=-0.5@law=hysteresis@d=0.01"
    (made,) = parse_effects(text, ARM)
    assert made.text == text
    assert made.parameters[0].name == "f_t_hysteresis(q1-0.5q2)"


def test_a_known_transmission_is_among_the_candidates():
    coupled = replace(
        ARM,
        transmission=parse_transmission(["50 q1", "30 q2", "20 q1 - 17 q2 - 17 q3"]),
    )
    kind = effect_types()["transmission_friction"]

    def sought(robot):
        found = kind.candidates(robot, 0)
        return {tuple(e.shape.get(f"c{j}", 0.0) for j in (1, 2, 3)) for e in found}

    assert (1.0, -0.85, -0.85) in sought(coupled)
    assert (1.0, -0.85, -0.85) not in sought(ARM)
    assert (1.0, 1.0, 0.0) in sought(ARM)


def test_ratios_of_joints_have_a_unit_where_their_positions_differ():
    robot = robots()["tree"]
    kinds = [joint.kind for joint in robot.joints]
    turns, slides = kinds.index("revolute"), kinds.index("prismatic")
    effect = effect_types()["transmission_friction"](robot, [turns, slides])
    units = {k: s.unit for k, s in effect.shapes.items() if k != "law"}
    first, other = sorted([turns, slides])
    ratio = f"{robot.position_units[first]}/{robot.position_units[other]}"
    assert units == {f"c{first + 1}": "-", f"c{other + 1}": ratio}
