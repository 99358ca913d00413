"""What the check says of real logs that nothing is wrong with: whole, in halves, together.

    python benchmarks/check_real.py --data DATA --out FOLDER

DATA holds the measurements as `sdp-vs-penalty fetch` leaves them. Every error is false,
and so is every claim about the dynamics but those of KNOWN. Facts are read from the file
and count as right. Writes real_claims.csv for reliability.py.
"""

import argparse
from collections.abc import Iterator, Sequence
from pathlib import Path

from reliability import OF_THE_MOTION, Claim, claim, write_claims

from sdp_vs_penalty import load_problem
from sdp_vs_penalty.checks import check_runs
from sdp_vs_penalty.data.datasets import converted
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.problem.problem import Problem

ARMS = "panda", "ur10e", "tx40", "emps"
#: True claims, by a run's name and the kind: at 3062.75 s of this run joint 2's torque
#: falls from 101 to 52 N m while it moves smoothly. That its load is another one than
#: the other loaded run's no paper says; one arm for both leaves the wrists' torques with
#: twenty times the error.
KNOWN = {
    ("ur-20_02_19_15harm50secLoad", "one-off event"),
    ("ur-20_02_19_15harm50secLoad", "another load"),
}


def logs_of(runs: Sequence[Measurements]) -> Iterator[list[Measurements]]:
    """Each run, its halves, and all runs with and without a load together."""
    for run in runs:
        span = float(run.t[-1] - run.t[0])
        yield [run]
        yield [run.window(0.0, 0.5 * span)]
        yield [run.window(0.5 * span, span)]
    loaded = [run for run in runs if "Load" in run.names[0]]
    empty = [run for run in runs if "Load" not in run.names[0]]
    for group in (loaded, empty):
        if len(group) > 1:
            yield group


def claims_of(name: str, problem: Problem, log: list[Measurements]) -> list[Claim]:
    """What is said of some runs of an arm."""
    claims = []
    for report in check_runs(problem, log, problem.preprocessing, thorough=False):
        for issue in report.errors_and_warnings:
            if issue.kind in OF_THE_MOTION:
                continue
            is_fact = issue.nature == "fact" and issue.severity != "error"
            is_right = is_fact or (report.run, issue.kind) in KNOWN
            claims.append(claim("real arms", f"{name}: {report.run}", issue, is_right))
    return claims


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--data", type=Path, default=Path("."))
    parser.add_argument("--out", type=Path, default=Path("results", "reliability"))
    options = parser.parse_args()
    claims = []
    n_logs = 0
    for name in ARMS:
        problem = load_problem(name)
        runs = list(converted(name, options.data / name).values())
        for log in logs_of(runs):
            n_logs += 1
            claims += claims_of(name, problem, log)
    n_errors = sum(not x.is_right for x in claims)
    print(f"{n_logs} logs, {len(claims)} claims, {n_errors} wrong")
    write_claims(claims, options.out / "real_claims.csv")


if __name__ == "__main__":
    main()
