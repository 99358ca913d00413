"""The verb ``challenge``: how often is the diagnosis right?

Every case is simulated by its own seed, diagnosed without sight of the truth, and then compared with
it. Cases are kept one by one, so that an interrupted challenge goes on where it stopped.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.files import alone, write_text
from sdp_vs_penalty.parallel import Workers, spread
from sdp_vs_penalty.simulation.challenge.case import Case, Record, run_case
from sdp_vs_penalty.simulation.challenge.classes import CLASSES
from sdp_vs_penalty.simulation.challenge.report import write_report
from sdp_vs_penalty.simulation.worlds.conditions import NUISANCES

#: Of the record's format: cases of another version are simulated anew.
VERSION = 3


#: Who simulates, unless it is said.
TWO = Workers(2)


def run_challenge(
    cases: int,
    seed: int,
    out: Path,
    workers: Workers = TWO,
    classes: Sequence[str] | None = None,
    nuisances: Sequence[str] | None = None,
    progress: Callable[[str], None] = lambda _: None,
) -> list[Path]:
    """Run what is missing; write challenge.json, and from all of its cases of this seed challenge.csv
    and challenge.md.

    cases : of each class; of clean robots, of each nuisance; workers : who simulates. Raises InputError
    for a class or a nuisance that does not exist.
    """
    kinds = _known("class", classes, CLASSES)
    conditions = _known("nuisance", nuisances, NUISANCES)
    for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        os.environ.setdefault(variable, "1")
    with alone(out):
        records = _completed(
            wanted(cases, seed, kinds, conditions), out / "challenge.json", workers, progress
        )
        mine = {k: records[k] for k in sorted(records, key=_order) if k.split("/")[2] == str(seed)}
        return [out / "challenge.json", *write_report(mine, out, seed)]


def _completed(
    cases: Sequence[Case], store: Path, workers: Workers, progress: Callable[[str], None]
) -> dict[str, Record]:
    """Every record of the store, with those of these cases that were missing; kept after each one."""
    records: dict[str, Record] = {}
    if store.is_file():
        kept = json.loads(store.read_text())
        records = kept["cases"] if kept.get("version") == VERSION else {}
    todo = [c for c in cases if c.key not in records]
    found = spread(run_case, todo, workers.scheduler, workers.jobs)
    for done, (key, record) in enumerate(found, start=1):
        records[key] = record
        progress(f"case {done} of {len(todo)}")
        content = {"version": VERSION, "cases": {k: records[k] for k in sorted(records, key=_order)}}
        write_text(store, json.dumps(content) + "\n")
    return records


def wanted(cases: int, seed: int, kinds: Sequence[str], conditions: Sequence[str]) -> list[Case]:
    """Cases, class by class; what hides an effect meets the nuisances at random."""
    out = []
    for kind in kinds:
        if kind == "clean":
            out += [Case(kind, name, seed, k) for k in range(cases) for name in conditions]
        else:
            order = list(CLASSES).index(kind)
            names = [
                str(np.random.default_rng([seed, order, k]).choice(conditions)) for k in range(cases)
            ]
            out += [Case(kind, name, seed, k) for k, name in enumerate(names)]
    return out


def _known(what: str, names: Sequence[str] | None, known: Mapping[str, Any]) -> list[str]:
    for name in names or ():
        if name not in known:
            raise InputError(f"{what} {name!r} is unknown", f"choose among: {', '.join(known)}")
    return list(names or known)


def _order(key: str) -> tuple[int, int, int, int]:
    kind, nuisance, seed, index = key.split("/")
    return list(CLASSES).index(kind), list(NUISANCES).index(nuisance), int(seed), int(index)
