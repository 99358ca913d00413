"""Every hostile file found so far, and files mutated from them: a run or a sentence, within a budget.

The budget: no input makes a verb use more than ten times its size and 500 MB, or more than ten times
the usual time. Files of past findings lie in corpus/, named after what is wrong with them.
"""

import json
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from commands import run_cli
from peak_memory import peak_memory
from small_runs import small_run

from sdp_vs_penalty import InputError, Measurements, check, identify
from sdp_vs_penalty.data import save
from sdp_vs_penalty.data.files import load_measurements

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
def test_past_findings(path, two_link):
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


@pytest.mark.parametrize("name", ["burst_stamps.csv", "stretched_clock.csv", "zip_bomb.npz", "bomb.bag"])
@pytest.mark.parametrize("verb", ["identify", "convert"])
def test_verbs_keep_the_budget(verb, name, tmp_path):
    path, out = CORPUS / name, tmp_path / ("model.json" if verb == "identify" else "run.csv")
    words = {
        "identify": ["identify", "two_link", "--data", path, "--no-check", "--out", out],
        "convert": ["convert", path, out],
    }[verb]
    with within_budget(path):
        assert run_cli(*words) in (0, 2)


def test_a_models_own_filters_keep_the_budget(two_link, tmp_path):
    run, model = tmp_path / "run.csv", tmp_path / "model.json"
    save(small_run(two_link, seconds=5.0), run)
    identify(two_link, run).save(model)
    content = json.loads(model.read_text())
    assert "state_cutoff" in content["preprocessing"]
    content["preprocessing"]["state_cutoff"] = 1e-4
    model.write_text(json.dumps(content))
    with within_budget(run, model):
        assert run_cli("compare", model, "--data", run) == 2
