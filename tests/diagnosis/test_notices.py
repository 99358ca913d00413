"""What the model takes in is said: a load beyond its file.

The logs are of an arm that shares no code with the library (point_mass_arm).
"""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from point_mass_arm import MASSES, PointMassArm

from sdp_vs_penalty import identify, load_problem, simulate
from sdp_vs_penalty.diagnosis import Library, Search, find_notices
from sdp_vs_penalty.diagnosis.diagnose import DiagnosisRuns
from sdp_vs_penalty.diagnosis.notices import fit_with_priors

EFFECTS = ["rigid_body", "viscous_friction", "coulomb_friction", "torque_offset"]
Array = np.ndarray


def notices(problem, arm):
    """What a model without findings has taken in."""
    return notices_of_run(problem, arm.run(1), effects=EFFECTS)


def notices_of_run(problem, run, **choices):
    """The same of a run."""
    model = identify(problem, run, "ols", check=False, **choices)
    search = Search(DiagnosisRuns(model, run, None).white_data, Library())
    search.terms = []
    search.fit = search.score.fit([])
    return find_notices(search, model)


def loaded(mass):
    return PointMassArm(masses=(*MASSES, (2, (0.3, 0.05, 0.0), mass)))


def test_a_load_beyond_the_file_is_weighed(problem):
    (notice,) = notices(problem, loaded(4.0))
    assert (notice.kind, notice.joint) == ("load", 3)
    assert abs(notice.size - 4.0) < 1.96 * notice.std


def test_a_mass_below_zero_is_no_explanation(problem):
    """Torques of minus one half of the true ones, say, amperes: "8.5 kg less" of a last
    link of 4 kg."""
    halved = PointMassArm(channel=lambda _, torque: -0.5 * torque)
    assert not notices(problem, halved)


def test_links_within_a_fifth_of_their_file_are_no_load(problem):
    assert not notices(problem, loaded(0.5))


def test_a_moment_that_may_be_zero_is_not_said():
    """The last link's mass and moment differ together: the runs tell neither alone."""
    problem = load_problem("two_link")
    links = problem.nominal_links * [[1.0], [1.0 / 1.5]]
    run = simulate("two_link", seed=3).runs[0]
    (notice,) = notices_of_run(replace(problem, nominal_links=links), run)
    assert notice.size < 1.96 * notice.std
    assert "differs from its file: a payload" in notice.sentence


def rows_of(*columns, y):
    """A search without findings, of rows (100,) of one joint with two columns."""
    data = SimpleNamespace(
        X=np.stack(columns, axis=1)[None],
        y=y[None],
        n=1,
        clusters=[np.arange(100) // 10],
    )
    score = SimpleNamespace(fit=lambda *_: SimpleNamespace(level=np.ones(1)))
    return SimpleNamespace(data=data, score=score, terms=[], fit=None)


def test_a_parameter_without_torque_keeps_the_file_value():
    """A link of grams has a file's tolerance of 1e-8 kg m^2."""
    torque = np.random.default_rng(0).normal(size=100)
    rows = rows_of(torque, np.zeros(100), y=2.0 * torque)
    theta, _ = fit_with_priors(rows, np.array([0.0, 1e-7]), np.array([np.inf, 1e-8]))
    np.testing.assert_allclose(theta, [2.0, 1e-7])


def test_a_parameter_that_is_not_seen_is_not_known():
    """An offset beside friction of one direction was 0.362 ± 0 N m."""
    constant = np.ones(100)
    noise = 0.01 * np.random.default_rng(0).normal(size=100)
    rows = rows_of(constant, constant, y=constant + noise)
    theta, covariance = fit_with_priors(rows, np.zeros(2), np.full(2, np.inf))
    assert theta.sum() == pytest.approx(1.0, rel=0.01)
    assert np.all(np.diagonal(covariance) > (100.0 * theta) ** 2)
