"""Every hostile file found so far, and files mutated from them: a run or a sentence, within a budget.

The budget: no input makes a verb use more than ten times its size and 500 MB, or more than ten times
the usual time. Files of past findings lie in corpus/, named after what is wrong with them.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from peak_memory import peak_memory
from small_runs import small_run

from sdp_vs_penalty import identify
from sdp_vs_penalty.checks import check
from sdp_vs_penalty.cli import main as cli
from sdp_vs_penalty.data.files import load_measurements, save
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.problem.load import load_problem
from sdp_vs_penalty.problem.problem import Problem

CORPUS = Path(__file__).parent / "corpus"
FILES = sorted(CORPUS.iterdir())
#: Ten times what a verb usually takes of a small file [CPU s]; a loaded machine doubles it.
SECONDS = 20.0


@contextmanager
def within_budget(*files: Path) -> Iterator[None]:
    """Fails where more memory is taken, or more time, than the budget gives for these files."""
    size = sum(file.stat().st_size for file in files)
    begin = time.process_time()
    with peak_memory() as peak:
        yield
    assert peak[0] < 10 * size + 500e6
    assert time.process_time() - begin < SECONDS


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.name)
def test_past_findings(path: Path, two_link: Problem) -> None:
    """Reader and check: what the reader takes the check can judge."""
    with within_budget(path):
        try:
            read = load_measurements(path, joints=2)
        except InputError:
            read = None
        try:
            reports = check(two_link, path)
        except InputError:
            reports = None
    assert read is None or isinstance(read, Measurements)
    if reports is None:
        assert read is None or not np.any(np.abs(read.tau) > 1e-12)
    elif read is None:
        assert all(report.meaningless for report in reports)


def run_cli(*words: object) -> int:
    with pytest.raises(SystemExit) as code:
        cli.main([str(word) for word in words])
    assert isinstance(code.value.code, int)
    return code.value.code


@pytest.mark.parametrize("name", ["burst_stamps.csv", "stretched_clock.csv", "zip_bomb.npz", "bomb.bag"])
@pytest.mark.parametrize("verb", ["identify", "convert"])
def test_verbs_keep_the_budget(verb: str, name: str, tmp_path: Path) -> None:
    path, out = CORPUS / name, tmp_path / ("model.json" if verb == "identify" else "run.csv")
    words = {
        "identify": ["identify", "two_link", "--data", path, "--no-check", "--out", out],
        "convert": ["convert", path, out],
    }[verb]
    with within_budget(path):
        assert run_cli(*words) in (0, 2)


def test_a_models_own_filters_keep_the_budget(two_link: Problem, tmp_path: Path) -> None:
    run, model = tmp_path / "run.csv", tmp_path / "model.json"
    save(small_run(two_link, seconds=5.0), run)
    identify(two_link, run).save(model)
    content = json.loads(model.read_text())
    assert "state_cutoff" in content["preprocessing"]
    content["preprocessing"]["state_cutoff"] = 1e-4
    model.write_text(json.dumps(content))
    with within_budget(run, model):
        assert run_cli("compare", model, "--data", run) == 2


def flipped(content: bytes, rng: np.random.Generator) -> bytes:
    at = int(rng.integers(len(content)))
    return content[:at] + bytes([content[at] ^ (1 << int(rng.integers(8)))]) + content[at + 1 :]


def cut(content: bytes, rng: np.random.Generator) -> bytes:
    begin, end = sorted(rng.integers(len(content), size=2).tolist())
    return content[:begin] + content[end:] if rng.random() < 0.5 else content[begin:]


def doubled(content: bytes, rng: np.random.Generator) -> bytes:
    begin = int(rng.integers(len(content)))
    part = content[begin : begin + int(rng.integers(1, 200))]
    return content[:begin] + part * int(rng.integers(2, 20)) + content[begin:]


def put(content: bytes, rng: np.random.Generator) -> bytes:
    odd = [
        b"\0" * 8,
        b"\xff" * 8,
        b"\x7f\xff\xff\xff",
        b"\x80",
        b",",
        b"\n",
        b'"',
        b"nan",
        b"-1e999",
        b"\r",
    ]
    at, part = int(rng.integers(len(content))), odd[int(rng.integers(len(odd)))]
    return content[:at] + part + content[at + (len(part) if rng.random() < 0.7 else 0) :]


DEEDS: tuple[Callable[[bytes, np.random.Generator], bytes], ...] = (flipped, cut, doubled, put)


def mutated(seed: int, folder: Path) -> Path:
    """One of the corpus, or a sound run, changed in one to six places."""
    rng = np.random.default_rng(seed)
    sources = [*FILES, *sorted(folder.glob("sound.*"))]
    source = sources[int(rng.integers(len(sources)))]
    content = source.read_bytes()
    for _ in range(int(rng.integers(1, 7))):
        if content:
            content = DEEDS[int(rng.integers(len(DEEDS)))](content, rng)
    path = folder / f"mutated{source.suffix}"
    path.write_bytes(content)
    return path


@pytest.mark.fuzz
def test_mutated_files_for_twenty_seconds(tmp_path: Path) -> None:
    """Other files each day, none of them chosen; the seed of a failure is in the message."""
    run = small_run(load_problem("two_link"), seconds=0.5)
    for suffix in (".csv", ".npz", ".mat", ".parquet"):
        if suffix != ".parquet" or pytest.importorskip("pyarrow"):
            save(run, tmp_path / f"sound{suffix}")
    seed, end = int(time.time()) // 86400 * 1_000_000, time.monotonic() + 20.0
    while time.monotonic() < end:
        seed += 1
        path, begin = mutated(seed, tmp_path), time.process_time()
        try:
            load_measurements(path)
        except InputError:
            pass
        except Exception as error:
            raise AssertionError(f"seed {seed} ({path.suffix}): {error!r}") from error
        assert time.process_time() - begin < SECONDS, f"seed {seed} ({path.suffix})"
