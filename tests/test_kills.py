"""Commands killed at random times: no partial file, no process after 5 s, the same bytes by a rerun.

`pytest -m slow tests/test_kills.py` kills 50 times; SDP_VS_PENALTY_KILLS=NUMBER:SEED kills otherwise.
"""

from __future__ import annotations

import csv
import os
import shlex
import signal
import subprocess
import sys
import time
import uuid
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from small_runs import small_run

from sdp_vs_penalty import identify, load_problem
from sdp_vs_penalty.data import save

psutil = pytest.importorskip("psutil", reason="it counts the processes: install the extra [test]")
pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="processes are killed as on Unix")

COMMANDS = {
    "identify": "identify two_link --data a.csv b.csv --out out/model.json --proof out/proof.json",
    "identify --jobs": "identify two_link --data a.csv b.csv --jobs 2 --out out/model.json",
    "diagnose": "diagnose model.json --data a.csv --json out/findings.json",
    "tables --jobs": "tables III --problem two_link --jobs 2 --out out",
    "shootout": "shootout --problems 'two_link one-step gyration,two_link one-step plain'"
    " --solvers clarabel,scs --accuracy 1e-4,1e-6 --jobs 2 --out out",
}
#: Of each row of a shootout, what differs from run to run: times.
TIMES = {"seconds", "setup_seconds", "solve_seconds"}
#: Seconds after which no process of a killed command may live.
GONE = 5.0


@dataclass
class Case:
    """A command, the files that it makes and the seconds that it takes."""

    words: list[str]
    files: dict[str, Any]
    seconds: float


def content(path: Path) -> Any:
    """What must be the same each time: the bytes; of a shootout the bounds, and rows without times."""
    if path.name == "runs.csv":
        with path.open(newline="") as file:
            rows = list(csv.DictReader(file))
        return {tuple(sorted((k, v) for k, v in row.items() if k not in TIMES)) for row in rows}
    timed = (path.parent / "runs.csv").exists() and path.name != "references.json"
    return None if timed else path.read_bytes()


def made(folder: Path) -> dict[str, Any]:
    return {p.name: content(p) for p in (folder / "out").glob("*") if not p.name.startswith(".")}


def started(words: list[str], folder: Path, mark: str) -> subprocess.Popen[bytes]:
    """The command in the folder; every process that comes of it carries the mark."""
    environment = {**os.environ, "MARK_OF_THIS_TEST": mark, "OPENBLAS_NUM_THREADS": "1"}
    environment["PYTHONPATH"] = os.pathsep.join([str(Path(__file__).parents[1]), *sys.path])
    return subprocess.Popen(
        [sys.executable, "-m", "sdp_vs_penalty", *words],
        cwd=folder, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
    )  # fmt: skip


def alive(mark: str) -> list[Any]:
    """Processes that carry the mark and are more than an entry that waits to be read."""
    found = []
    for process in psutil.process_iter():
        try:
            if process.environ().get("MARK_OF_THIS_TEST") == mark:
                found.append(process)
        except psutil.Error:
            continue
    return [p for p in found if p.is_running() and p.status() != psutil.STATUS_ZOMBIE]


def inputs(folder: Path) -> Path:
    problem = load_problem("two_link")
    for seed, name in enumerate(("a.csv", "b.csv")):
        save(small_run(problem, seed=seed), folder / name)
    identify(problem, small_run(problem)).save(folder / "model.json")
    return folder


@pytest.fixture(scope="module")
def cases(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Case]:
    """Each command undisturbed, when it is first asked for."""

    class Made(dict[str, Case]):
        def __missing__(self, name: str) -> Case:
            folder = inputs(tmp_path_factory.mktemp("whole"))
            begin, words = time.monotonic(), shlex.split(COMMANDS[name])
            assert started(words, folder, "").wait(300) == 0
            self[name] = Case(words, made(folder), time.monotonic() - begin)
            assert self[name].files
            return self[name]

    return Made()


def kill(case: Case, folder: Path, rng: np.random.Generator) -> str:
    """Run the case, kill it at a random time and run it again; how it went."""
    mark, how = uuid.uuid4().hex, (signal.SIGKILL, signal.SIGTERM)[int(rng.integers(2))]
    process = started(case.words, folder, mark)
    try:
        process.wait(rng.uniform(0.2, 1.1) * case.seconds)
        told = "ended before"
    except subprocess.TimeoutExpired:
        process.send_signal(how)
        process.wait(GONE)
        told = how.name
    end = time.monotonic() + GONE
    while (left := alive(mark)) and time.monotonic() < end:
        time.sleep(0.1)
    assert not left, f"{told}: {[p.cmdline() for p in left]} live after {GONE:g} s"
    whole = (folder / "out" / "runs.csv").read_text() if (folder / "out" / "runs.csv").exists() else ""
    for name, found in made(folder).items():
        assert (
            name == "references.json"
            or found in (None, case.files[name])
            or (name == "runs.csv" and found < case.files[name])
        ), name
    assert started(case.words, folder, mark).wait(300) == 0, told
    assert made(folder) == case.files, told
    assert not [*(folder / "out").glob(".*")], told
    if whole:  # with their times: what was done was not done again
        assert set(whole.splitlines()) <= set((folder / "out" / "runs.csv").read_text().splitlines())
    return told


def kills(name: str, number: int, seed: int, cases: dict[str, Case], tmp_path: Path) -> list[str]:
    told = []
    for k in range(number):
        folder = tmp_path / str(k)
        folder.mkdir()
        told.append(kill(cases[name], inputs(folder), np.random.default_rng([seed, k])))
    return told


def test_a_command_that_is_killed_leaves_nothing_and_runs_again(
    cases: dict[str, Case], tmp_path: Path
) -> None:
    kills("identify --jobs", 2, 0, cases, tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("name", COMMANDS)
def test_fifty_kills(name: str, cases: dict[str, Case], tmp_path: Path) -> None:
    number, _, seed = os.environ.get("SDP_VS_PENALTY_KILLS", "10:1").partition(":")
    told = kills(name, int(number), int(seed or 1), cases, tmp_path)
    assert len(told) - told.count("ended before") >= len(told) // 2
