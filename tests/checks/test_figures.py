"""What the check says of every kind of corruption that the bench knows, and how it
mends it."""

from typing import Any

import pytest
from corruptions.arms import FIVE, Arm, simulated
from corruptions.bench import contradicts, given
from recorded import changed, said

from sdp_vs_penalty.checks import Report, check

#: Snapshots: the golden cases ask the same of the default run.
pytestmark = pytest.mark.nightly

#: Parts of two seconds each.
PARTS = 7


@pytest.fixture(scope="module")
def arm() -> Arm:
    """Three joints that an independent simulator moves."""
    return simulated("three", FIVE[:3], 3)


def told(report: Report) -> dict[str, Any]:
    issues = {
        f"{i.kind}, {i.where}": said(
            f"{i.severity} | {i.what} | {i.certainty} | {i.remedy}"
        )
        | {"figures": dict(i.figures), "gravity": i.gravity, "can_fix": i.can_fix}
        for i in report.issues
    }
    runs = {"mended": report.repaired_all, "fixed": report.repaired_certain}
    kept = {
        f"{name}.{k}": getattr(r, k)[::50]
        for name, r in runs.items()
        for k in ("t", "q", "tau")
    }
    return {"issues": issues, "unexplained": report.unexplained, **kept}


@pytest.mark.parametrize("part", range(PARTS))
def test_figures_are_what_they_were(part, arm):
    """Of each kind of corruption the first and the last log."""
    every = arm.corruptions()
    ends = {c.kind: c for c in reversed(every)}, {c.kind: c for c in every}
    chosen = {c.name: c for end in ends for c in end.values()}
    reports = {
        name: check(*given(arm, chosen[name])) for name in sorted(chosen)[part::PARTS]
    }
    assert not [name for name, of in reports.items() if any(map(contradicts, of))]
    found = {f"{name}, {r.run}": told(r) for name, of in reports.items() for r in of}
    assert not changed(f"checks_{part}", found)
