"""No built-in robot is dead: each is identified by default."""

import pytest
from small_runs import small_run

from sdp_vs_penalty import identify, load_problem
from sdp_vs_penalty.problem.load import problem_names


@pytest.mark.filterwarnings("ignore:warning. run. joints")
@pytest.mark.parametrize("name", problem_names())
def test_every_built_in_problem_is_identified(name):
    problem = load_problem(name)
    model = identify(problem, small_run(problem))
    assert model.certificate.worst == 0.0
    assert model.certificate.gap < 1e-8
    assert model.provenance["verdict"]
