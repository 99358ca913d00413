"""Numbers that have to stay what they are: a readable file a case, in this folder.

``tests/helpers/golden.py`` says how such a file is written, and how values are recorded
anew where a change is meant.
"""

import pytest
from golden import all_cases, differences, report
from golden_cases import CASES


def parameter(case):
    """A test's parameter with the case's name and its markers."""
    marks = [getattr(pytest.mark, name) for name in case.markers]
    return pytest.param(case, id=case.path.stem, marks=marks)


@pytest.mark.parametrize("case", [parameter(case) for case in all_cases()])
def test_values_are_what_they_were(case):
    found = differences(case, CASES[case.compute](case.inputs))
    if found:
        pytest.fail(report(case, found), pytrace=False)
