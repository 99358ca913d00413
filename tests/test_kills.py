"""Commands killed at random times: no partial file, no process after 5 s, the same bytes by a rerun.

`pytest -m slow tests/test_kills.py` kills 50 times; SDP_VS_PENALTY_KILLS=NUMBER:SEED kills otherwise.
"""

import csv
import http.client
import os
import re
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
from sdp_vs_penalty.files import problems_folder

psutil = pytest.importorskip("psutil", reason="it counts the processes: install the extra [test]")
pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="processes are killed as on Unix")

COMMANDS = {
    "identify": "identify two_link --data a.csv b.csv --out out/model.json --proof out/proof.json",
    "identify --jobs": "identify two_link --data a.csv b.csv --jobs 2 --out out/model.json",
    "diagnose": "diagnose model.json --data a.csv --json out/findings.json",
    "tables --jobs": "tables III --problem two_link --jobs 2 --out out",
    "shootout": "shootout --problems"
    " 'two_link simulated one-step gyration,two_link simulated one-step plain'"
    " --solvers clarabel,scs --accuracy 1e-4,1e-6 --jobs 2 --out out",
}
#: Of each row of a shootout, what differs from run to run: times.
TIMES = {"seconds"}
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
    environment |= {"PYTHONPATH": os.pathsep.join([str(Path(__file__).parents[1]), *sys.path])}
    environment |= {"TMPDIR": str(folder)} if words[0] == "page" else {}
    return subprocess.Popen(
        [sys.executable, "-m", "sdp_vs_penalty", *words],
        cwd=folder, env=environment, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL,
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


def all_gone(mark: str, told: str) -> None:
    end = time.monotonic() + GONE
    while (left := alive(mark)) and time.monotonic() < end:
        time.sleep(0.1)
    assert not left, f"{told}: {[p.cmdline() for p in left]} live after {GONE:g} s"


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
            words = shlex.split(COMMANDS[name])
            for _ in range(2):  # the first one also reads its modules from the disk
                folder = inputs(tmp_path_factory.mktemp("whole"))
                begin = time.monotonic()
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
        process.wait(rng.uniform(0.1, 1.0) * case.seconds)
        told = "ended before"
    except subprocess.TimeoutExpired:
        process.send_signal(how)
        process.wait(GONE)
        told = how.name
    all_gone(mark, told)
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


@pytest.mark.long
def test_a_command_that_is_killed_leaves_nothing_and_runs_again(cases, tmp_path):
    kills("identify --jobs", 2, 0, cases, tmp_path)


#: How many kills of each command, and the seed of their times.
NUMBER, SEED = map(int, os.environ.get("SDP_VS_PENALTY_KILLS", "10:1").split(":"))


@pytest.mark.slow
@pytest.mark.parametrize("name", COMMANDS)
def test_fifty_kills(name, cases, tmp_path):
    told = kills(name, NUMBER, SEED, cases, tmp_path)
    assert len(told) - told.count("ended before") >= len(told) // 2


@pytest.mark.slow
def test_a_page_killed_in_its_jobs_leaves_nothing(tmp_path):
    """Jobs of three tabs read a robot and then a run; the next server takes their files away."""
    rng, robot = np.random.default_rng(SEED), (problems_folder() / "emps/emps.urdf").read_bytes()
    save(small_run(load_problem("emps"), seconds=100.0), tmp_path / "run.csv")
    run, home = (tmp_path / "run.csv").read_bytes(), tmp_path / "home"
    home.mkdir()
    for _ in range(NUMBER):
        mark, how = uuid.uuid4().hex, (signal.SIGKILL, signal.SIGTERM)[int(rng.integers(2))]
        server = started(["page", "--no-browser"], home, mark)
        found = re.search(rb"127\.0\.0\.1:(\d+)/\?key=(\S+)", server.stdout.readline())
        assert found
        cookie = f"sdp-vs-penalty-key-{int(found[1])}={found[2].decode()}"

        def ask(
            method: str, path: str, body: bytes = b"", port: int = int(found[1]), cookie: str = cookie
        ) -> str:
            asked = http.client.HTTPConnection("127.0.0.1", port, timeout=60)
            asked.request(method, path, body, {"Cookie": cookie})
            answer = asked.getresponse()
            assert answer.status < 400
            return str(answer.headers.get("location"))

        for tab in [ask("GET", "/new") for _ in range(3)]:
            ask("PUT", f"{tab}/files?name=arm.urdf&kind=robot", robot)
            ask("PUT", f"{tab}/files?name=run.csv&kind=runs", run)
            ask("POST", f"{tab}/sent")
        assert len([*home.glob("sdp-vs-penalty-page-*")]) == 1
        time.sleep(rng.uniform(0.0, 6.0))
        server.send_signal(how)
        server.wait(GONE)
        all_gone(mark, how.name)
        assert how == signal.SIGKILL or not [*home.iterdir()]
