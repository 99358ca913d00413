"""Commands killed at random times over their whole run: no partial file, no process
after 5 s, the same bytes by a rerun, which keeps what is finished; writers that meet.

SDP_VS_PENALTY_KILLS=NUMBER:SEED kills each story so often, at other times.
"""

import asyncio
import csv
import json
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from challenge.cases import Case, run_challenge
from commands import HOME
from small_runs import small_run, write_run

from sdp_vs_penalty import InputError, identify, load_problem
from sdp_vs_penalty.cli.main import main
from sdp_vs_penalty.files import folder_lock

pytest.importorskip("psutil", reason="it counts processes: install the extra [test]")
import killing

pytestmark = pytest.mark.skipif(
    sys.platform != "linux", reason="orphans are adopted as on Linux"
)
N_KILLS, SEED = map(int, os.environ.get("SDP_VS_PENALTY_KILLS", "2:1").split(":"))
Results = Mapping[str, object]


def command(words):
    """A command line, to be run where the process is."""
    return partial(main, words.split())


def written_bytes(folder):
    """Every file of the folder ``out``, whole."""
    return {path.name: path.read_bytes() for path in (folder / "out").glob("*")}


def nothing(folder):
    return {}


def shootout_classes(folder):
    """What a shootout has found; its files hold times, too."""
    return {
        (row["problem"], row["solver"], row["settings"]): row["outcome"]
        for row in shootout_rows(folder).values()
    }


def shootout_rows(folder):
    """Finished runs, with the time that each took."""
    path = folder / "out" / "runs.csv"
    if not path.exists():
        return {}
    with path.open(newline="") as file:
        rows = list(csv.DictReader(file))
    return {"|".join(row[name] for name in KEY): row for row in rows}


KEY = ("problem", "solver", "settings")


def challenge_cases(folder):
    """Finished cases, with the time that each took."""
    path = folder / "out" / "challenge.json"
    return dict(json.loads(path.read_text())["cases"]) if path.exists() else {}


def challenge_findings(folder):
    """What the challenge has found, without times."""
    timed = {"seconds", "identify_seconds"}
    return {
        key: {name: value for name, value in record.items() if name not in timed}
        for key, record in challenge_cases(folder).items()
    }


def challenge():
    cases = [Case("clean", "encoder", 1000, k) for k in range(2)]
    run_challenge(cases, 1000, Path("out"), jobs=2)


def page_job():
    """A page's server: a worker identifies, the answer is kept; then it ends."""
    from page_sessions import finish

    from sdp_vs_penalty.page import Sessions, WorkerPool

    async def identify_in_a_tab():
        session = sessions.new()
        await finish(session, lambda: session.choose_robot("two_link"))
        session.arrived.update({"a.csv": Path("a.csv").resolve()})
        await finish(session, session.read_files)
        await finish(session, session.identify)
        Path("out").mkdir(exist_ok=True)
        os.replace(session.model.file, "out/model.json")

    sessions = Sessions(WorkerPool(1))
    try:
        asyncio.run(identify_in_a_tab())
    finally:
        sessions.close()


@dataclass(frozen=True)
class KilledWork:
    """What is killed; what it must end with, however often; what a rerun must keep."""

    act: Callable[[], object]
    results: Callable[[Path], Results] = written_bytes
    finished: Callable[[Path], Results] = nothing


SHOOTOUT = (
    "shootout --problems two_link~simulated~one-step~gyration"
    " --solvers clarabel,scs --accuracy 1e-4,1e-6 --jobs 2 --out out"
)
STORIES = {
    "identify": KilledWork(
        command(
            "identify two_link --data a.csv b.csv --out out/model.json"
            " --proof out/proof.json"
        )
    ),
    "identify by 2 processes": KilledWork(
        command("identify two_link --data a.csv b.csv --jobs 2 --out out/model.json")
    ),
    "diagnose": KilledWork(
        command("diagnose model.json --data a.csv --json out/findings.json")
    ),
    "tables by 2 processes": KilledWork(
        command("tables III --problem two_link --jobs 2 --out out")
    ),
    "simulate": KilledWork(command("simulate two_link --seed 3 --out out")),
    "shootout by 2 processes": KilledWork(
        partial(main, [word.replace("~", " ") for word in SHOOTOUT.split()]),
        shootout_classes,
        shootout_rows,
    ),
    "challenge by 2 processes": KilledWork(
        challenge, challenge_findings, challenge_cases
    ),
    "page": KilledWork(page_job),
}


@pytest.fixture(scope="module")
def inputs(tmp_path_factory):
    """A folder with two runs and a model."""
    folder, problem = tmp_path_factory.mktemp("inputs"), load_problem("two_link")
    write_run(folder / "a.csv", problem)
    write_run(folder / "b.csv", problem, seed=1)
    identify(problem, small_run(problem)).save(folder / "model.json")
    return folder


@pytest.mark.slow
@pytest.mark.parametrize("name", STORIES)
def test_a_killed_command_leaves_nothing_and_runs_again(name, inputs, tmp_path):
    story = STORIES[name]
    rng = np.random.default_rng(SEED)
    shutil.copytree(inputs, tmp_path, dirs_exist_ok=True)
    with killing.adopting_orphans():
        known = killing.descendants()
        right, seconds = undisturbed(story, tmp_path)
        for _ in range(N_KILLS):
            shutil.rmtree(tmp_path / "out", ignore_errors=True)
            number = killing.SIGNALS[int(rng.integers(len(killing.SIGNALS)))]
            after = float(rng.uniform(0.0, seconds))
            killing.kill_after(story.act, tmp_path, after, number)
            assert not killing.survivors(known)
            if number != signal.SIGKILL:
                assert not [*(tmp_path / "tmp").iterdir()]
            assert story.results(tmp_path).items() <= right.items()
            finished = story.finished(tmp_path)
            end_well(story, tmp_path)
            assert story.results(tmp_path) == right
            assert finished.items() <= story.finished(tmp_path).items()


def undisturbed(story, folder):
    """What a story ends with, and its seconds once its libraries are loaded."""
    end_well(story, folder)
    shutil.rmtree(folder / "out", ignore_errors=True)
    seconds = end_well(story, folder)
    right = story.results(folder)
    assert right
    return right, seconds


def end_well(story, folder):
    """The seconds of a story that nobody kills; it leaves no temporary file."""
    code, seconds = killing.run_to_end(story.act, folder)
    assert code == 0, (folder / "printed").read_text()
    assert not [*(folder / "tmp").iterdir()]
    return seconds


CLUSTER = """if True:
    import sys
    from distributed import LocalCluster

    if __name__ == "__main__":
        cluster = LocalCluster(
            n_workers=2, threads_per_worker=1, silence_logs=50, dashboard_address=None
        )
        numbers = [worker.pid for worker in cluster.workers.values()]
        print(cluster.scheduler_address, *numbers, flush=True)
        sys.stdin.read()
"""


@contextmanager
def local_cluster(folder):
    """The address of a Dask cluster, and the processes of its scheduler and workers."""
    script = folder / "cluster.py"
    script.write_text(CLUSTER)
    process = subprocess.Popen(
        [sys.executable, script],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
        env={**os.environ, "PYTHONPATH": HOME},
    )
    try:
        address, *numbers = process.stdout.readline().split()
        yield address, process.pid, [int(number) for number in numbers]
    finally:
        process.kill()
        process.communicate()


@pytest.mark.slow
@pytest.mark.parametrize("victim", ["command", "worker", "scheduler"])
def test_a_cluster_of_which_one_process_is_killed(victim, inputs, tmp_path):
    """A worker's part is done again; without a scheduler there is a sentence."""
    pytest.importorskip("distributed")
    rng = np.random.default_rng(SEED)
    shutil.copytree(inputs, tmp_path, dirs_exist_ok=True)
    right, seconds = {}, 1.0
    with killing.adopting_orphans():
        for _ in range(-(-N_KILLS // 3)):
            with local_cluster(tmp_path) as (address, scheduler, workers):
                story = KilledWork(
                    command(
                        "identify two_link --data a.csv b.csv --out out/model.json"
                        f" --scheduler {address}"
                    )
                )
                if not right:
                    right, seconds = undisturbed(story, tmp_path)
                shutil.rmtree(tmp_path / "out", ignore_errors=True)
                process = killing.fork_command(story.act, tmp_path)
                time.sleep(float(rng.uniform(0.0, seconds)))
                target = {
                    "command": process,
                    "worker": workers[0],
                    "scheduler": scheduler,
                }
                os.kill(target[victim], signal.SIGKILL)
                code = killing.wait_for(process, 60.0)
                assert written_bytes(tmp_path).items() <= right.items()
                allowed = {"command": (0, -9), "worker": (0,), "scheduler": (0, 2)}
                printed = (tmp_path / "printed").read_text()
                assert code in allowed[victim], printed
                assert printed.count("sdp-vs-penalty:") <= 1
                if victim != "scheduler":
                    end_well(story, tmp_path)
                    assert written_bytes(tmp_path) == right
            assert not killing.survivors(set())


@pytest.mark.long
def test_two_writers_of_one_file_leave_one_of_both(inputs, tmp_path):
    shutil.copytree(inputs, tmp_path, dirs_exist_ok=True)
    actions = [
        command(f"identify two_link --data {run}.csv --method ols --out out/model.json")
        for run in ("a", "b")
    ]
    expected = []
    for action in actions:
        assert killing.run_to_end(action, tmp_path)[0] == 0
        expected.append(written_bytes(tmp_path))
    for _ in range(2):
        processes = [killing.fork_command(action, tmp_path) for action in actions]
        assert [killing.wait_for(process, 60.0) for process in processes] == [0, 0]
        assert written_bytes(tmp_path) in expected


@pytest.mark.long
def test_two_writers_of_one_folder_leave_the_files_of_one(tmp_path):
    """The one that comes second finds another simulation there, and is refused, also
    where both begin together."""
    actions = [command(f"simulate two_link --seed {seed} --out out") for seed in (1, 2)]
    expected = []
    for number, action in enumerate(actions):
        alone = tmp_path / f"alone{number}"
        alone.mkdir()
        assert killing.run_to_end(action, alone)[0] == 0
        expected.append(written_bytes(alone))
    for number in range(2):
        both = tmp_path / f"both{number}"
        both.mkdir()
        processes = [killing.fork_command(action, both) for action in actions]
        codes = [killing.wait_for(process, 60.0) for process in processes]
        assert sorted(codes) == [0, 2]
        left = [x for code, x in zip(codes, expected, strict=True) if code == 0]
        assert written_bytes(both) in left


def test_a_writer_waits_for_another_one(tmp_path):
    holder = threading.Thread(target=hold_lock, args=(tmp_path, 0.3))
    holder.start()
    time.sleep(0.1)
    with folder_lock(tmp_path, patience=5.0):
        assert not holder.is_alive() or holder.join(1.0) is None


def hold_lock(folder, seconds):
    with folder_lock(folder, patience=5.0):
        time.sleep(seconds)


def test_the_second_of_two_writers_is_refused(tmp_path):
    with (
        folder_lock(tmp_path),
        pytest.raises(InputError, match="another command is writing"),
        folder_lock(tmp_path),
    ):
        pass


def test_a_killed_command_holds_no_lock(tmp_path):
    process = killing.fork_command(partial(hold_lock, tmp_path, 60.0), tmp_path)
    end = time.monotonic() + 10.0
    is_refused = False
    while not is_refused and time.monotonic() < end:
        try:
            with folder_lock(tmp_path):
                pass
            time.sleep(0.05)
        except InputError:
            is_refused = True
    assert is_refused
    os.kill(process, signal.SIGKILL)
    killing.wait_for(process, 5.0)
    with folder_lock(tmp_path):
        pass
