"""No figure of small logs changes unnoticed: a change that is meant is written anew,
and told."""

import pytest
from figures import CASES
from recorded import changed

#: Snapshots: the golden cases ask the same of the default run.
pytestmark = pytest.mark.nightly


@pytest.mark.parametrize("name", CASES)
def test_figures_are_what_they_were(name, tmp_path):
    assert not changed(name, CASES[name](tmp_path))
