"""Commands killed at any time: no partial file, no process after 5 s, the same bytes by
a rerun; writers that meet. SDP_VS_PENALTY_KILLS=NUMBER:SEED kills each command so
often, at other times.
"""

import csv
import os
import shlex
import shutil
import signal
import subprocess
import sys
import time
import uuid
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import HOME
from small_runs import small_run, write_run

from sdp_vs_penalty import InputError, identify, load_problem
from sdp_vs_penalty.files import folder_lock

psutil = pytest.importorskip(
    "psutil", reason="it counts the processes: install the extra [test]"
)
pytestmark = pytest.mark.skipif(
    not hasattr(os, "fork"), reason="processes are killed as on Unix"
)
NUMBER, SEED = map(int, os.environ.get("SDP_VS_PENALTY_KILLS", "4:1").split(":"))
COMMANDS = {
    "identify": (
        "identify two_link --data a.csv b.csv --out out/model.json --proof"
        " out/proof.json"
    ),
    "identify --jobs": (
        "identify two_link --data a.csv b.csv --jobs 2 --out out/model.json"
    ),
    "diagnose": "diagnose model.json --data a.csv --json out/findings.json",
    "tables --jobs": "tables III --problem two_link --jobs 2 --out out",
    "shootout": (
        "shootout --problems"
        " 'two_link simulated one-step gyration,two_link simulated one-step plain'"
        " --solvers clarabel,scs --accuracy 1e-4,1e-6 --jobs 2 --out out"
    ),
}
#: A kill, a polite one, and Ctrl-C.
SIGNALS = signal.SIGKILL, signal.SIGTERM, signal.SIGINT
#: Seconds after which no process of a killed command may live.
GONE = 5.0


def made(folder: Path) -> dict[str, Any]:
    """What must be the same each time: the bytes; of a shootout, whose summary has
    times, its rows."""
    if (runs := folder / "out" / "runs.csv").exists():
        with runs.open(newline="") as file:
            return {
                (r["problem"], r["solver"], r["settings"]): r["class"]
                for r in csv.DictReader(file)
            }
    return {p.name: p.read_bytes() for p in (folder / "out").glob("[!.]*")}


def started(words: list[str], folder: Path, mark: str) -> subprocess.Popen[bytes]:
    """The command in the folder; every process that comes of it carries the mark."""
    environment = {**os.environ, "MARK_OF_THIS_TEST": mark, "PYTHONPATH": HOME}
    command = [sys.executable, "-m", "sdp_vs_penalty", *words]
    quiet = subprocess.DEVNULL
    return subprocess.Popen(
        command, cwd=folder, env=environment, stdout=quiet, stderr=quiet
    )


def alive(mark: str) -> list[Any]:
    """Processes that carry the mark and are more than an entry that waits to be read."""
    found = []
    for process in psutil.process_iter():
        with suppress(psutil.Error):
            marked = process.environ().get("MARK_OF_THIS_TEST") == mark
            if marked and process.status() != psutil.STATUS_ZOMBIE:
                found.append(process)
    return found


@pytest.mark.slow
@pytest.mark.parametrize("name", COMMANDS)
def test_a_command_that_is_killed_leaves_nothing_and_runs_again(name, tmp_path):
    problem = load_problem("two_link")
    words = shlex.split(COMMANDS[name])
    (
        write_run(tmp_path / "a.csv", problem),
        write_run(tmp_path / "b.csv", problem, seed=1),
    )
    identify(problem, small_run(problem)).save(tmp_path / "model.json")
    for _ in range(2):  # the first one also reads its modules from the disk
        shutil.rmtree(tmp_path / "out", ignore_errors=True)
        begin = time.monotonic()
        assert started(words, tmp_path, "").wait(300) == 0
    seconds = time.monotonic() - begin
    right = made(tmp_path)
    rng = np.random.default_rng(SEED)
    assert right
    for _ in range(NUMBER):
        shutil.rmtree(tmp_path / "out")
        process = started(words, tmp_path, mark := uuid.uuid4().hex)
        time.sleep(rng.uniform(0.0, 1.0) * seconds)
        process.send_signal(SIGNALS[int(rng.integers(len(SIGNALS)))])
        process.wait(GONE)
        end = time.monotonic() + GONE
        while (left := alive(mark)) and time.monotonic() < end:
            time.sleep(0.1)
        assert not left, [p.cmdline() for p in left]
        assert made(tmp_path).items() <= right.items()
        assert started(words, tmp_path, "").wait(300) == 0
        assert made(tmp_path) == right
        assert not [*(tmp_path / "out").glob(".*")]


def test_of_two_writers_the_second_is_told(tmp_path):
    with (
        folder_lock(tmp_path),
        pytest.raises(InputError, match="another command is writing"),
        folder_lock(tmp_path),
    ):
        pass
    code = f"""if True:
        import time
        from pathlib import Path
        from sdp_vs_penalty.files import folder_lock
        with folder_lock(Path({str(tmp_path)!r})):
            print("mine", flush=True)
            time.sleep(60)"""
    with subprocess.Popen(
        [sys.executable, "-c", code], stdout=subprocess.PIPE, text=True
    ) as other:
        assert other.stdout.readline() == "mine\n"
        with pytest.raises(InputError, match="another command"), folder_lock(tmp_path):
            pass
        other.send_signal(signal.SIGKILL)
        other.wait()
    with folder_lock(tmp_path):  # a killed command holds no lock
        pass
