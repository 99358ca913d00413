"""Answers that were made elsewhere, from a file: judged as every contestant is.

The file is JSON, {"answers": [...]}, each answer an object with "problem" (an instance's
name), "solver" (whose answer it is), "claimed" ("optimal", "infeasible", "unbounded",
"inaccurate" or "failed") and "x", the variables of the instance's problem.cbf or
problem.dat-s, or "theta", the parameters in the instance's units. It may have "seconds",
"accuracy" (asked for), "status", "version", and "hash", which must be the instance's.
"""

import os
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from sdp_vs_penalty.errors import InputError, require_known
from sdp_vs_penalty.estimators.estimator import Progress
from sdp_vs_penalty.files import folder_lock, read_json
from sdp_vs_penalty.parallel import spread
from sdp_vs_penalty.records import JsonRecord, from_json
from sdp_vs_penalty.shootout import runner
from sdp_vs_penalty.shootout.catalogue import everything, instance, selected
from sdp_vs_penalty.shootout.contestants import contestants
from sdp_vs_penalty.shootout.instances import Instance
from sdp_vs_penalty.shootout.judge import Answer, judge

CLAIMS = ("optimal", "infeasible", "unbounded", "inaccurate", "failed")


@dataclass(frozen=True)
class Given(JsonRecord):
    """An answer as a file states it."""

    #: Name of the instance.
    problem: str
    #: Solver that found the answer.
    solver: str
    #: Claim of the solver, one of :data:`CLAIMS`.
    claimed: str
    #: Variables of the instance's problem.cbf or problem.dat-s; None where theta is.
    x: tuple[float, ...] | None = None
    #: (p,) parameters in the instance's units; None where x is.
    theta: tuple[float, ...] | None = None
    #: Processor time that the solver took [s]; NaN where it is not known.
    seconds: float = np.nan
    #: Relative accuracy that was asked for.
    accuracy: float = 1e-8
    #: The solver's status, in its words.
    status: str = ""
    #: Version of the solver.
    version: str = ""
    #: Hash of the instance that was solved; "": it is not checked.
    hash: str = ""

    def __post_init__(self) -> None:
        """Raise InputError for an unknown problem or claim, or a contestant's name."""
        require_known("problem", self.problem, [e.name for e in everything()])
        require_known("claim", self.claimed, CLAIMS)
        if self.solver in contestants():
            what = f"{self.solver} is a contestant of the shootout"
            raise InputError(what, "give the solver another name")

    def answer(self, instance: Instance) -> Answer:
        """Return the answer to an instance, its parameters in the instance's units.

        Raises InputError for another number of parameters than the instance has.
        """
        p = len(instance.task.bound)
        theta = np.full(p, np.nan)  # of an answer without numbers
        numbers = self.x if self.theta is None else self.theta
        if numbers is not None:
            # Behind the p scaled parameters x may hold further variables of the file.
            is_complete = len(numbers) == p or (self.theta is None and len(numbers) > p)
            if not is_complete:
                what = f"{self.problem} has {p} parameters, its answer {len(numbers)} numbers"
                raise InputError(what, "write theta, or the variables of problem.cbf")
            theta = np.array(numbers)[:p]
            if self.theta is None:
                theta = instance.sdp.centre + instance.sdp.theta_scale * theta
        return Answer(theta, self.claimed, self.status)


def judge_answers(paths: list[Path], out: Path, say: Progress) -> runner.Results:
    """Judge the answers of files, and add them to the runs of a folder.

    Parameters
    ----------
    out : Path
        Folder of a shootout, or a new one; answers of the same solver to the same
        problem are replaced.
    say : callable
        Called with the progress, a short text each time.

    Returns
    -------
    Results
        All runs of the folder.

    Raises
    ------
    InputError
        For a file that holds no such answers, an unknown problem, or the name of a
        contestant of the shootout.
    """
    given = [(path.name, item) for path in paths for item in _read(path)]
    entries, _ = selected(sorted({item.problem for _, item in given}))
    setup = runner.Shootout(out)
    work = partial(spread, runner.perform, scheduler=None, jobs=os.cpu_count() or 1)
    with folder_lock(out):
        results = runner.Results(out)
        proofs = runner.proved_intervals(setup, entries, say, work)
        facts = runner.Facts(
            {entry.name: entry for entry in entries},
            {item.solver: item.version for _, item in given},
        )
        rows = []
        for file, item in given:
            proved = proofs[item.problem]
            if item.hash not in ("", proved.hash):
                what = (
                    f"{item.problem} is {proved.hash} here, {item.hash} in the answers"
                )
                raise InputError(what, "export the instances anew, and solve these")
            made = instance(item.problem)
            answer = item.answer(made)
            verdict = judge(made, proved.reference, answer)
            task = runner.Assignment(
                problem=item.problem,
                hash=proved.hash,
                time_limit=setup.time_limit,
                memory=0.0,
                solver=item.solver,
                reference=proved.reference,
            )
            cells = {"settings": file, "accuracy": item.accuracy}
            figures = runner.figures(verdict, answer, [item.seconds])
            rows.append(cells | figures | facts.find_row(task))
        new = {(row["problem"], row["solver"]) for row in rows}
        results.drop_outdated(lambda row: (row["problem"], row["solver"]) not in new)
        results.add(rows)
    return results


def _read(path: Path) -> list[Given]:
    """Read the answers of a file. Raises InputError for anything else."""
    return read_json(
        path,
        "file of answers",
        "answers",
        lambda data: from_json(list[Given], data["answers"]),
    )
