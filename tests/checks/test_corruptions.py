"""The bench of corruptions on one arm that is simulated by Pinocchio alone: named, or without harm."""

import numpy as np
import pytest
from corruptions.arms import FIVE, Arm, simulated
from corruptions.bench import HARMFUL, run_case

from sdp_vs_penalty import check

pytestmark = pytest.mark.long


@pytest.fixture(scope="module")
def arm() -> Arm:
    return simulated("sim5", FIVE, 3)


#: One of each way in which a log can be wrong; the bench runs all of them. Mended, the first of them
#: leave what the clean log leaves.
MENDED = (
    "torque scale mN m",
    "torque sign joint 2",
    "all torque signs",
    "torques swapped joint 2+3",
    "all torques late 60 ms",
    "clock set +1.5 s",
    "clock set -1.5 s",
    "encoder offset joint 2 90 deg",
    "joints swapped joint 2+5 q and tau",
    "doubled rows, clock re-made every tenth",
    "run repeated",
    "time reversed",
)
WRONG = (
    *MENDED,
    "positions in degrees",
    "torque scale current",
    "saturation joint 2 at 0.7 of the peak",
    "soft saturation joint 2 at 0.4 of the peak",
    "torque gain joint 2 x 1.1",
    "torque unit of one column joint 3 N cm",
    "causal filter of one torque joint 3 0.7 Hz",
    "one torque channel late joint 3 50 ms",
    "torque drift joint 2 1 std",
    "torque step joint 3 1 std",
    "joint sign joint 2 q and tau",
    "encoder offset joint 2 30 deg",
    "wrapped angle joint 2",
    "frozen position joint 3 whole run",
    "stale position joint 2 1 s",
    "spikes joint 3 tau 500",
    "zeros joint 2 q",
    "zeros joint 5 tau 0.05 s",
    "lost rows, clock re-made 8 x 10 rows",
    "rows interpolated 1.5 s",
    "burst stamps 10 rows in 9 us",
    "clock rate x 1.25",
    "gravity removed joint 2 90 %",
    "gravity removed 100 %",
    "gravity removed 90 %",
    "load picked up 2 kg",
    "two arms in one file",
    "gravity assumed wall",
    "gravity assumed ceiling",
    "link too long 0.3 m",
    "torque gain in one of two runs joint 2 x 1.15",
)


def test_clean_runs_are_silent(arm):
    for run in (arm.train, *arm.others):
        assert not check(arm.problem, run)[0].problems


@pytest.mark.parametrize("name", WRONG)
def test_what_was_done_is_named(name, arm):
    known = {c.name: c for c in arm.corruptions()}
    assert name in known, f"a name of benchmarks/corruptions/kinds.py: {[*known]}"
    corruption = known[name]
    case = run_case(arm, corruption)
    assert case.outcome == "named" or (case.outcome == "silent" and (case.harm or 9.0) < HARMFUL), case
    assert not case.contradicts, case
    if name in MENDED:
        (clean,), (spoiled,) = (check(arm.problem, x) for x in (arm.train, corruption.spoil(arm.train)))
        (again,) = check(arm.problem, spoiled.mended, thorough=False)
        assert not again.problems, [f.what for f in again.problems]
        assert again.unexplained < 1.2 * clean.unexplained


@pytest.mark.parametrize("degrees", [0.0, 3.0])
def test_a_small_tilt_of_the_base_is_named_with_its_direction(degrees, arm):
    x = 9.81 * np.sin(np.radians(degrees))
    given = arm.problem.with_gravity((x, 0.0, -9.81 * np.cos(np.radians(degrees))))
    found = [f for f in check(given, arm.train)[0].problems if f.kind == "gravity direction"]
    assert [f.severity for f in found] == ["warning"] * bool(degrees)
    for f in found:
        np.testing.assert_allclose(f.gravity, (0.0, 0.0, -9.81), atol=0.1)
