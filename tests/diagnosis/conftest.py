"""The arm whose logs most tests diagnose: it shares no code with the library."""

import pytest
from point_mass_arm import arm_problem


@pytest.fixture(scope="session")
def problem(tmp_path_factory):
    """The arm as its users describe it (point_mass_arm)."""
    return arm_problem(tmp_path_factory.mktemp("arm"))
