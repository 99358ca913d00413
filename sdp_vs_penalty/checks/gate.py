"""The check that comes before identification and diagnosis: errors of the log refuse,
everything else is a remark."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from typing import Any

from sdp_vs_penalty import formatting
from sdp_vs_penalty.checks.check import check_runs
from sdp_vs_penalty.checks.issue import EXPLANATION, FACT, Issue
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.estimation.estimate import Estimate
from sdp_vs_penalty.problem.problem import Problem


def raise_on_errors(
    problem: Problem,
    measurements: Measurements,
    verb: str = "identify",
    otherwise: str = "pass check=False to",
    gains: bool = False,
    warn: Callable[[str], Any] = warnings.warn,
) -> dict[str, list[dict[str, Any]]]:
    """All that the fast part of the check says of each run, by the run's hash, as a
    model keeps it for a report.

    otherwise : how to do ``verb`` all the same, in words; gains : whether its work
    determines the torque channels' gains, so that the check need not; warn : hears its
    warnings, a sentence each. Raises InputError where that work would be meaningless.
    """
    reports = check_runs(
        problem, measurements.runs(), problem.preprocessing, thorough=False
    )
    issues_found = [
        (r.run, f)
        for r in reports
        for f in r.errors_and_warnings
        if not (gains and f.kind == "torque gain")
    ]
    errors = [(run, f) for run, f in issues_found if f.severity == "error"]
    if errors:
        run, f = errors[0]
        more = (
            f"; {formatting.count(len(errors) - 1, 'more error')}"
            if len(errors) > 1
            else ""
        )
        raise InputError(
            f"{f.what.rstrip('.')}: {f.remedy}{more} (details: `check`)",
            f"fix the data (`check --fix`), or {otherwise} {verb} anyway",
            run,
        )
    for run, f in issues_found:
        if f.nature == FACT:
            warn(f"{f.severity}: {run}: {f.what} (details: `check`)")
    said = explanations_in_a_line(problem.name, issues_found)
    if said:
        warn(f"warning: {said}")
    hashes = [run.data_hash for run in measurements.runs()]
    reports_of_all = reports if len(hashes) == len(reports) else []
    return {
        h: [f.to_dict() for f in r.issues]
        for h, r in zip(hashes, reports_of_all, strict=False)
    }


def explanations_in_a_line(problem: str, found: Sequence[tuple[str, Issue]]) -> str:
    """What a model makes of the log, in one line: what it looks like, that it is taken
    as it is, and the command that tries the repair; empty where nothing is said."""
    told = [(run, f) for run, f in found if f.nature == EXPLANATION]
    if not told:
        return ""
    run = told[0][0]
    kinds = list(dict.fromkeys(f.what.rstrip(".") for _, f in told))
    more = f" (and {formatting.count(len(kinds) - 1, 'more such thing')})"
    words = " ".join(dict.fromkeys(f.apply for _, f in told if f.apply))
    tries = f" --fix fixed.csv --apply {words}" * bool(words)
    how = "tries the repair, and shows both errors" if words else "says more"
    return (
        f"{run}: it looks as if {kinds[0]}{more * (len(kinds) > 1)}. The log is taken as"
        f" it is; `check {run} --problem {problem}{tries}` {how}"
    )


def consented(estimate: Estimate, measurements: Measurements) -> bool:
    """Whether a model was identified from the same runs without the check."""
    provenance = estimate.provenance
    return (
        provenance["data_hash"] == measurements.data_hash
        and provenance.get("checked") is False
    )
