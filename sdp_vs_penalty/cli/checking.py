"""The cheap part of the data check, before a model is fitted."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from sdp_vs_penalty.data.measurements import Measurements
    from sdp_vs_penalty.problem.problem import Problem


def refuse_meaningless(problem: Problem, measurements: Measurements) -> None:
    """The cheap part of the check, before an identification: warnings go to stderr, a line each.

    Raises InputError where to identify would be meaningless.
    """
    from sdp_vs_penalty.check import check
    from sdp_vs_penalty.cli import console
    from sdp_vs_penalty.errors import InputError

    reports = check(problem, measurements, thorough=False)
    errors = [(r.run, f) for r in reports for f in r.issues if f.severity == "error"]
    if errors:
        run, f = errors[0]
        more = f"; {len(errors) - 1} more error(s)" if len(errors) > 1 else ""
        fixed = ", its --fix mends it" if f.repair is not None else ""
        raise InputError(
            f"{run}: {f.what.rstrip('.')}: {f.remedy}{more} (`sdp-vs-penalty check` says more{fixed}), "
            "or identify all the same with --no-check."
        )
    for report in reports:
        for f in report.problems:
            text = f"{f.severity}: {report.run}: {f.what} (`sdp-vs-penalty check` says more)"
            console.err.print(text, markup=False, soft_wrap=True)
