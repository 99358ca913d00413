"""Fetching public data: pinned, checked, converted; real files through a local address."""

import hashlib
import http.server
import threading
import warnings
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from commands import run_cli
from recorded import refusal

from sdp_vs_penalty import compare, identify, load_measurements, load_problem
from sdp_vs_penalty.data import DATASETS, datasets, fetch
from sdp_vs_penalty.errors import Remark


@pytest.fixture(scope="module")
def address(data_folder, tmp_path_factory):
    """A local server with GitHub's layout of raw files over the shared measurements."""
    root = tmp_path_factory.mktemp("github")
    for d in DATASETS.values():
        for f in d.files:
            link = root / d.source / d.commit / f.path
            link.parent.mkdir(parents=True, exist_ok=True)
            link.symlink_to(data_folder / d.name / f.name)
    handler = partial(http.server.SimpleHTTPRequestHandler, directory=root)
    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    yield f"http://127.0.0.1:{server.server_address[1]}"
    server.shutdown()


@pytest.fixture(autouse=True)
def _nothing_at_hand(monkeypatch):
    monkeypatch.delenv(datasets.DATA_VARIABLE, raising=False)


@pytest.fixture(scope="module")
def fetched(address, tmp_path_factory):
    """Every data set's folder of runs."""
    root = tmp_path_factory.mktemp("cache")
    out = {}
    for name in DATASETS:
        with pytest.MonkeyPatch.context() as patch, warnings.catch_warnings():
            warnings.simplefilter("ignore", Remark)
            patch.delenv(datasets.DATA_VARIABLE, raising=False)
            paths = fetch(name, root, address)
        assert paths
        assert all(path.parent == root / name / "runs" for path in paths)
        out[name] = root / name / "runs"
    return out


@pytest.mark.real_data
def test_ur10e_is_in_newton_metres_without_rows_that_are_none(fetched, data_folder):
    raw = np.loadtxt(
        data_folder / "ur10e" / "ur-20_02_19_14harm50sec.csv", delimiter=","
    )
    run = load_measurements(fetched["ur10e"] / "ur-20_02_19_14harm50sec.csv", joints=6)
    assert np.array_equal(run.q, raw[:, 1:7])
    assert np.allclose(run.tau, raw[:, 13:19] * [10.0, 10.70, 8.46, 9.00, 9.48, 10.12])
    bad = load_measurements(fetched["ur10e"] / "ur-20_02_19_15harm50secLoad.csv")
    assert len(bad.t) == 6096  # of 6107 rows: ten before the clock runs, one cut short
    assert np.abs(bad.q).max() < 4.0


@pytest.mark.real_data
def test_the_tx40_is_logged_five_thousand_times_a_second(fetched):
    run = load_measurements(fetched["tx40"] / "exciting.csv")
    np.testing.assert_allclose(np.diff(run.t), 2e-4, rtol=1e-9)


@pytest.mark.real_data
def test_emps_identification_gives_the_authors_values(fetched):
    """M, Fv, Fc and offset of Janot, Gautier, Brunot within 2 %, from the default
    settings."""
    problem = load_problem("emps")
    estimate = identify(problem, load_measurements(fetched["emps"] / "tracking.csv"))
    value = dict(
        zip((p.name for p in estimate.model.parameters), estimate.theta, strict=True)
    )
    authors = {"m1": 95.1089, "f_v1": 203.5034, "f_c1": 20.3935, "f_o1": -3.1648}
    for name, expected in authors.items():
        assert value[name] == pytest.approx(expected, rel=0.02)
    test = compare(estimate, load_measurements(fetched["emps"] / "pulses.csv"))[0]
    assert test.relative_error_percent < 5.0


@pytest.mark.long
@pytest.mark.real_data
def test_the_verb_prints_paths_and_says_what_it_could_not_use(
    address, tmp_path, monkeypatch, capsys
):
    monkeypatch.setenv(datasets.MIRROR_VARIABLE, address)
    code = run_cli("fetch", "ur10e", "emps", "--folder", tmp_path)
    out, err = capsys.readouterr()
    assert code == 0
    paths = [Path(line) for line in out.splitlines()]
    assert len(paths) == 10
    assert all(path.is_file() for path in paths)
    assert err.count("only rows ") == 1
    assert "only rows 11 to 6106" in err
    assert f"SDP_VS_PENALTY_DATA={tmp_path}" in err


@pytest.mark.real_data
def test_files_at_hand_are_not_downloaded(data_folder, tmp_path, monkeypatch):
    monkeypatch.setenv(datasets.DATA_VARIABLE, str(data_folder))
    assert (
        len(fetch("emps", tmp_path, "http://127.0.0.1:9")) == 2
    )  # where nobody answers


def test_offline_is_one_sentence(tmp_path):
    put = f"put DATA_EMPS.mat, DATA_EMPS_PULSES.mat into {tmp_path / 'emps'}"
    refusal(
        lambda: fetch("emps", tmp_path, "http://127.0.0.1:9"), put, "check the network"
    )
    assert not list(tmp_path.rglob("*.csv"))


@pytest.mark.real_data
def test_a_changed_file_is_refused(address, tmp_path, monkeypatch):
    real = DATASETS["emps"]
    wrong = replace(real.files[0], sha256=hashlib.sha256(b"another").hexdigest())
    monkeypatch.setitem(datasets.DATASETS, "emps", replace(real, files=(wrong,)))
    refusal(lambda: fetch("emps", tmp_path, address), "SHA-256 differs")
    assert not list(tmp_path.rglob("*.mat"))
