"""The fast part of the data check, before a model is fitted."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from sdp_vs_penalty.data.measurements import Measurements
    from sdp_vs_penalty.estimation.estimate import Estimate
    from sdp_vs_penalty.problem.problem import Problem


def consented(estimate: Estimate, measurements: Measurements) -> bool:
    """Whether a model was identified from the same runs with --no-check."""
    same = estimate.provenance["data_hash"] == measurements.data_hash
    return same and estimate.provenance.get("checked") is False


def refuse_meaningless(
    problem: Problem, measurements: Measurements, verb: str = "identify", gains: bool = False
) -> None:
    """The fast part of the check, before the work of a verb: warnings go to stderr, a line each.

    gains : whether that work determines the torque channels' gains, so that the check need not.
    Raises InputError where that work would be meaningless.
    """
    from sdp_vs_penalty import show
    from sdp_vs_penalty.check import check
    from sdp_vs_penalty.cli import console
    from sdp_vs_penalty.errors import InputError

    reports = check(problem, measurements, thorough=False)
    found = [(r.run, f) for r in reports for f in r.problems if not (gains and f.kind == "torque gain")]
    errors = [(run, f) for run, f in found if f.severity == "error"]
    if errors:
        run, f = errors[0]
        more = f"; {show.count(len(errors) - 1, 'more error')}" if len(errors) > 1 else ""
        raise InputError(
            f"{f.what.rstrip('.')}: {f.remedy}{more} (details: `check`)",
            f"fix the data (`check --fix`), or pass --no-check to {verb} anyway",
            run,
        )
    for run, f in found:
        console.warn(f"{f.severity}: {run}: {f.what} (details: `check`)")
