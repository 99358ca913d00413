"""Long commands that are killed: what they had done stays, nothing wrong does, nor any process."""

import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from sdp_vs_penalty import InputError
from sdp_vs_penalty.files import alone
from sdp_vs_penalty.research.shootout.runner import COLUMNS, Results

pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="processes are forked and killed")
STEPS = ("open", "write", "fsync", "close", "replace")


def killed(work: Callable[[], object], step: str, at: int, how: str) -> bool:
    """Do the work in a child that is killed at the at-th call of os.<step>; False where it lived on."""
    child = os.fork()
    if child:
        return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 9
    whole, calls = getattr(os, step), iter(range(10_000))

    def dies(*arguments: Any, **named: Any) -> Any:
        if next(calls) < at:
            return whole(*arguments, **named)
        if how == "after":
            whole(*arguments, **named)
        elif how == "half" and step == "write":
            whole(arguments[0], arguments[1][: len(arguments[1]) // 2])
        os._exit(9)

    setattr(os, step, dies)
    try:
        work()
    finally:
        os._exit(1)


def kills(tmp_path: Path, work: Callable[[Path], object]) -> Iterator[tuple[Path, tuple[object, ...]]]:
    """A folder a kill: at each of the first calls of each step, before it, in it and after it."""
    died = 0
    for step in STEPS:
        for at in range(3):
            for how in ("before", "half", "after") if step == "write" else ("before", "after"):
                out = tmp_path / f"{step}-{at}-{how}"
                if killed(partial(work, out), step, at, how):
                    died += 1
                    yield out, (step, at, how)
    assert died > 20


def row(k: int) -> dict[str, Any]:
    words = {c: "a, b" for c in ("group", "claimed", "status", "class", "version", "machine", "remark")}
    found = {**dict.fromkeys(COLUMNS, k), **words, "accuracy": 1e-6}
    return {**found, "problem": f"p{k}", "hash": "h", "solver": "s", "settings": "d"}


def rows(results: Results) -> list[Any]:
    return list(results.runs.itertuples(index=False, name=None))


def test_a_shootout_killed_at_any_step_resumes_without_a_wrong_row(tmp_path):
    def work(out: Path) -> list[Any]:
        results = Results(out)
        for k in range(len(results.runs), 4):
            results.add(row(k))
        return rows(Results(out))

    whole = work(tmp_path / "whole")
    for out, case in kills(tmp_path, work):
        there = rows(Results(out))
        assert there == whole[: len(there)], case
        assert work(out) == whole, case
        assert [p.name for p in out.iterdir()] == ["runs.csv"]


def test_of_two_writers_the_second_is_told(tmp_path):
    with alone(tmp_path), pytest.raises(InputError, match="another command is writing"), alone(tmp_path):
        pass
    code = f"""if True:
        import time
        from pathlib import Path
        from sdp_vs_penalty.files import alone
        with alone(Path({str(tmp_path)!r})):
            print("mine", flush=True)
            time.sleep(60)"""
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True) as other:
        assert other.stdout.readline() == "mine\n"
        with pytest.raises(InputError, match="another command"), alone(tmp_path):
            pass
        other.send_signal(signal.SIGKILL)
        other.wait()
    with alone(tmp_path):  # a killed command holds no lock
        pass
