"""A link swings after it is pushed; what swings before as well is no resonance.

The logs are of an arm that shares no code with the library (point_mass_arm).
"""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from point_mass_arm import PointMassArm, arm_problem

from sdp_vs_penalty import identify
from sdp_vs_penalty.diagnosis.confidence import has_no_direction
from sdp_vs_penalty.diagnosis.diagnose import DiagnosisRuns
from sdp_vs_penalty.diagnosis.library import Candidate, Library
from sdp_vs_penalty.diagnosis.search import Search
from sdp_vs_penalty.diagnosis.white_rows import WhiteData
from sdp_vs_penalty.effects import JointResonance, JointSpring
from sdp_vs_penalty.effects.effect import Effect
from sdp_vs_penalty.effects.links import _SwingBothWays as SwingBothWays

EFFECTS = ["rigid_body", "viscous_friction", "coulomb_friction", "torque_offset"]
SWING = {"f": 2.5, "zeta": 0.05}


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> WhiteData:
    """White rows of a run that the model explains up to its noise."""
    run = PointMassArm().run(1)
    problem = arm_problem(Path(tmp_path_factory.mktemp("arm")))
    model = identify(problem, run, "ols", effects=EFFECTS, check=False)
    return DiagnosisRuns(model, run, None).white_data


def search_of(data: WhiteData, true: Effect, found: Effect) -> Search:
    """A search that has found one effect where another one acts."""
    columns = data.columns(true)
    scale = 3.0 / np.std(columns[found.joints[0]])
    torque = np.array(data.y)
    for joint, column in columns.items():
        torque[joint] += scale * column[:, 0]
    out = Search(replace(data, y=torque), Library())
    out.terms = [out.evidence_of(out.bare, Candidate((found.name, 0), found))]
    return out


@pytest.mark.parametrize(
    ("true", "is_directed"), [(JointResonance, True), (SwingBothWays, False)]
)
def test_a_resonance_is_told_by_its_direction_in_time(data, true, is_directed):
    robot = data.estimate.robot
    found = JointResonance(robot, [0], **SWING)
    search = search_of(data, true(robot, [0], **SWING), found)
    assert has_no_direction(search, search.terms[0]) != is_directed


def test_a_spring_needs_no_direction(data):
    spring = JointSpring(data.estimate.robot, [0])
    search = search_of(data, spring, spring)
    assert not has_no_direction(search, search.terms[0])


@pytest.mark.parametrize(
    ("drop_both_ways", "is_doubtful"), [(87.0, False), (89.0, True), (120.0, True)]
)
def test_the_direction_shows_from_odds_of_20_to_1_on(
    two_link, drop_both_ways, is_doubtful
):
    """Two correlated rows count as one: 100 - 2 times 6 is the least that ties."""
    resonance = JointResonance(two_link.robot, [0])
    drops = {JointResonance: 100.0, SwingBothWays: drop_both_ways}

    def evidence_of(fit: None, form: Candidate, columns: None) -> SimpleNamespace:
        return SimpleNamespace(drop=drops[type(form.effect)], rows_worth_one=2.0)

    term = SimpleNamespace(
        form=Candidate(("joint_resonance", 0), resonance), columns=None
    )
    search = SimpleNamespace(
        terms=[term],
        fit=None,
        data=SimpleNamespace(columns=lambda effect: None),
        nuisances=SimpleNamespace(with_law_misfits=list),
        score=SimpleNamespace(fit=lambda *_: None, evidence_of=evidence_of),
    )
    assert has_no_direction(search, term) == is_doubtful


def test_only_a_swing_both_ways_comes_before_its_cause(two_link):
    """A push in the middle of 4 s, on an inertia of 0.3 kg m^2 without weight."""
    t = np.linspace(0.0, 4.0, 2001)
    push = np.exp(-(((t - 2.0) / 0.02) ** 2))
    slopes = 0.0 * t, 0.0 * t, np.full(t.shape, 0.3)
    compliance = 1.0 / ((2.0 * np.pi * SWING["f"]) ** 2 * 0.3)
    lags = [
        kind(two_link.robot, [0], **SWING).lag(push, 0.002, compliance, slopes)
        for kind in (JointResonance, SwingBothWays)
    ]
    after, both_ways = (np.abs(lag) / np.abs(lag).max() for lag in lags)
    assert after[t < 1.9].max() < 1e-3
    assert both_ways[t < 1.9].max() > 0.1
    np.testing.assert_allclose(both_ways, both_ways[::-1], atol=1e-6)
