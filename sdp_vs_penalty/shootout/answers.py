"""Answers that were made elsewhere, from a file: judged as every contestant is.

The file is JSON, {"answers": [...]}, each answer an object with "problem" (an instance's
name), "solver" (whose answer it is), "claimed" ("optimal", "infeasible", "unbounded",
"inaccurate" or "failed") and "x", the variables of the instance's problem.cbf or
problem.dat-s, or "theta", the parameters in the instance's units. It may have "seconds",
"accuracy" (asked for), "status", "version", and "hash", which must be the instance's.
"""

import os
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from sdp_vs_penalty.errors import InputError, require_known
from sdp_vs_penalty.estimators.estimator import Progress
from sdp_vs_penalty.files import folder_lock, read_json
from sdp_vs_penalty.parallel import spread
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.shootout import runner
from sdp_vs_penalty.shootout.catalogue import instance, selected
from sdp_vs_penalty.shootout.contestants import contestants
from sdp_vs_penalty.shootout.instances import Instance
from sdp_vs_penalty.shootout.judge import Answer, Reference, judge

CLAIMS = ("optimal", "infeasible", "unbounded", "inaccurate", "failed")


def judge_answers(paths: list[Path], out: Path, say: Progress) -> runner.Results:
    """Judge the answers of files, and add them to the runs of a folder.

    Parameters
    ----------
    paths : list of Path
        JSON files, as above.
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
    given = [item for path in paths for item in _answers(path)]
    entries, _ = selected(sorted({item["problem"] for item in given}))
    setup = runner.Shootout(out)
    work = partial(spread, runner.perform, scheduler=None, jobs=os.cpu_count() or 1)
    with folder_lock(out):
        results = runner.Results(out)
        proofs = runner.proved_intervals(setup, entries, say, work)
        facts = runner.Facts(
            {entry.name: entry for entry in entries},
            {item["solver"]: item["version"] for item in given},
        )
        rows = []
        for item in given:
            name, proof = item["problem"], proofs[item["problem"]]
            if item["hash"] not in ("", proof["hash"]):
                what = (
                    f"{name} is {proof['hash']} here and {item['hash']} in the answers"
                )
                raise InputError(what, "export the instances anew, and solve these")
            reference = Reference(**proof["reference"])
            answer = _answer(item, instance(name))
            task = runner.Assignment(
                name,
                proof["hash"],
                setup.time_limit,
                0.0,
                item["solver"],
                (),
                reference,
            )
            verdict = judge(instance(name), reference, answer)
            cells = {"settings": item["file"], "accuracy": item["accuracy"]}
            times = [item["seconds"]]
            rows.append(cells | runner.figures(verdict, answer, times) | facts.of(task))
        new = {(row["problem"], row["solver"]) for row in rows}
        results.drop_outdated(lambda row: (row["problem"], row["solver"]) not in new)
        results.add(rows)
    return results


def _answers(path: Path) -> list[dict[str, Any]]:
    """Read the answers of a file, with every field. Raises InputError where one is odd."""
    items = read_json(path, "file of answers", "answers", lambda data: data["answers"])
    if not isinstance(items, list):
        raise InputError('"answers" is no list', "write a list of objects", path)
    return [_checked(item, k, path) for k, item in enumerate(items, start=1)]


def _checked(item: Any, number: int, path: Path) -> dict[str, Any]:
    """Return an answer with every field. Raises InputError for a field that is odd."""

    def odd(what: str, remedy: str) -> InputError:
        return InputError(f"answer {number}: {what}", remedy, path)

    if not isinstance(item, Mapping):
        raise odd("it is no object", "write objects with problem, solver, claimed, x")
    defaults = {"seconds": np.nan, "accuracy": 1e-8}
    texts = ("problem", "solver", "claimed", "status", "version", "hash")
    full = dict.fromkeys(texts, "") | defaults | dict(item) | {"file": path.name}
    for field in texts:
        if not isinstance(full[field], str):
            raise odd(f"{field} is no text", "write it in quotation marks")
    for field in defaults:
        if isinstance(full[field], bool) or not isinstance(full[field], int | float):
            raise odd(f"{field} is no number", "leave it out, or write a number")
    if not full["problem"] or not full["solver"]:
        raise odd("it names no problem or no solver", "name both")
    require_known("claim", full["claimed"], CLAIMS)
    if full["solver"] in contestants():
        what = f"{full['solver']} is a contestant of the shootout"
        raise odd(what, "give the solver another name")
    return full


def _answer(item: Mapping[str, Any], made: Instance) -> Answer:
    """Return the answer to an instance. Raises InputError for numbers of another one."""
    theta: Array = np.full(len(made.task.bound), np.nan)
    where = f"answer to {item['problem']} by {item['solver']}"
    try:
        if "theta" in item:
            theta = np.array(item["theta"], float)
        elif "x" in item:
            scaled = np.array(item["x"], float)[: len(theta)]
            theta = made.sdp.centre + made.sdp.theta_scale * scaled
    except (TypeError, ValueError):
        theta = np.zeros(0)
    if theta.shape != made.task.bound.shape:
        what = f"x or theta is no list of at least {len(made.task.bound)} numbers"
        raise InputError(what, "write the variables of problem.cbf", where)
    return Answer(theta, item["claimed"], item["status"])
