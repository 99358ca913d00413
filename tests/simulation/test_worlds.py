"""The challenge's own worlds: independent of the library, right by physics, drawn by their seed."""

import ast
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from challenge import worlds as challenged
from challenge.worlds.conditions import (
    NUISANCES,
    Conditions,
    draw_conditions,
    fair,
)
from challenge.worlds.motion import driven, plan
from challenge.worlds.runs import draw_motion, draw_world, log_run

from sdp_vs_penalty.simulation import worlds
from sdp_vs_penalty.simulation.worlds.world import DryFriction, TrueMotion, bristles

FOLDERS = [Path(home.__file__).parent for home in (worlds, challenged)]
#: Of the package, what a world may know: how measurements look, where Pinocchio is, how errors are said.
ALLOWED = {
    "sdp_vs_penalty.data.measurements",
    "sdp_vs_penalty.errors",
    "sdp_vs_penalty.robot._pinocchio",
}


def test_the_worlds_share_nothing_with_the_library_that_they_judge():
    for path in (path for folder in FOLDERS for path in folder.glob("*.py")):
        for node in ast.walk(ast.parse(path.read_text())):
            names = [a.name for a in node.names] if isinstance(node, ast.Import) else []
            names += [str(node.module)] if isinstance(node, ast.ImportFrom) else []
            ours = {x for x in names if x.startswith("sdp_vs_penalty")}
            own = {x for x in ours if x.startswith("sdp_vs_penalty.simulation.worlds")}
            assert ours - own <= ALLOWED, path


@pytest.mark.parametrize("travel", [1e-6, 0.005])
def test_bristles_follow_dahls_curve_over_travel_however_stiff(travel):
    """After a reversal z = 1 - 2 exp(-x / d) in closed form (Dahl 1976, for sigma = 1)."""
    t = np.arange(0.0, 2.0, 1e-3)
    dq = 0.3 * np.sin(np.pi * t)[:, None]
    z = bristles(t, dq, np.array([travel]), lambda v: np.ones_like(v))[:, 0]
    after = t > 1.0
    travelled = 0.3 / np.pi * (1.0 + np.cos(np.pi * t[after]))
    exact = -1.0 + (1.0 + z[~after][-1]) * np.exp(-travelled / travel)
    assert np.abs(z[after] - exact).max() < 2e-3


def test_lugre_slides_at_the_stribeck_level():
    t = np.arange(0.0, 3.0, 1e-3)
    one = np.ones(1)
    law = DryFriction("lugre", 0.01 * one, 0.002 * one, 0.3 * one, 0.05 * one)
    for speed in (0.01, 0.05, -0.4):
        level = np.sign(speed) * (1.0 + 0.3 * np.exp(-((speed / 0.05) ** 2)))
        assert law.share(t, np.full((len(t), 1), speed))[-1, 0] == pytest.approx(level, rel=1e-4)


def test_a_driven_joint_sticks_and_friction_holds_it_below_the_coulomb_torque():
    """Between two moves; what moves follows the plan, and its rates are the derivatives."""
    world = draw_world(Conditions("scara", law="sign", servo=True), np.random.default_rng(2))
    t = np.arange(0.0, 6.0, 1e-3)
    planned = TrueMotion(t, *plan(world.arm, "points", 8.0, np.random.default_rng(5))(t))
    m = driven(world, planned)
    assert m.share is not None
    stuck = np.abs(m.dq) < 2e-6
    assert (stuck.mean(axis=0) > 0.02).all()
    assert np.abs(m.share[stuck]).max() <= 1.0
    assert (np.abs(m.share[stuck]) < 0.9).mean() > 0.1
    assert (m.share == world.share(m)).all()
    assert np.abs(m.q - planned.q).max() < 0.02
    assert np.abs(np.gradient(m.q, t, axis=0) - m.dq)[1:-1].max() < 0.01
    assert np.abs(np.diff(world.torque(m), axis=0)).max() < 0.1 * np.ptp(world.torque(m))


@pytest.mark.parametrize("name", NUISANCES)
def test_every_nuisance_makes_runs_that_its_seed_repeats(name):
    runs = []
    for _ in range(2):
        rng = np.random.default_rng(17)
        conditions = replace(draw_conditions(name, rng), duration=8.0)
        world = draw_world(conditions, rng)
        runs.append(log_run(world, draw_motion(world, 1, rng), rng))
    (first, second), run = runs, runs[0].run
    assert run.data_hash == second.run.data_hash
    rate = conditions.channel.rate
    assert run.samples == round(8.0 * rate)
    assert np.diff(run.t) == pytest.approx(1.0 / rate)
    assert np.isfinite(run.tau).all()
    assert (run.dq is not None) == (conditions.channel.speed_noise is not None)
    noise = (run.tau - first.ideal.tau).std(axis=0)
    assert noise == pytest.approx(conditions.noise.level * world.arm.noise, rel=0.25)
    effects, abstains = fair(conditions)
    assert effects >= set(NUISANCES[name].fair)
    assert name == "mixed" or abstains == NUISANCES[name].abstains
