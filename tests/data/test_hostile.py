"""Input that would fill the memory, wait for ever or overflow: each ends in a sentence."""

import bz2
import json
import struct
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from commands import run_cli
from peak_memory import peak_memory
from scipy.io import savemat
from small_runs import small_run, write_bag

from sdp_vs_penalty import InputError, Measurements, check, files, identify
from sdp_vs_penalty.data import read_run, save
from sdp_vs_penalty.data.files import as_measurements, load_measurements
from sdp_vs_penalty.signals.runs import sample_rate


def test_pauses_do_not_coarsen_the_grid(two_link):
    run = small_run(two_link, seconds=6.0)
    later = replace(run, t=run.t + 3600.0 * (run.t > 3.0))
    assert sample_rate(later) == pytest.approx(sample_rate(run))


@pytest.mark.parametrize(("name", "value"), [("q", 1e160), ("tau", 1e300), ("dq", 1e300), ("t", 1e200)])
def test_absurd_numbers_end_in_a_sentence(name, value, two_link, tmp_path):
    run = small_run(two_link)
    values = getattr(run, name).copy()
    values[-1] = value
    path = tmp_path / "run.csv"
    save(replace(run, **{name: values}), path)
    with pytest.raises(InputError, match="no robot measures"):
        load_measurements(path)
    (report,) = check(two_link, path)
    assert "missing numbers" in [f.kind for f in report.problems]
    assert len(report.mended.t) == len(run.t) - 1


def test_numbers_that_no_sensor_resolves_are_zeros(two_link, tmp_path):
    run = small_run(two_link)
    tau = run.tau.copy()
    tau[3:9] = 5e-324
    save(replace(run, tau=tau), tmp_path / "run.csv")
    zeros = np.where(np.abs(tau) < 1e-30, 0.0, tau)
    for source in (tmp_path / "run.csv", replace(run, tau=tau)):
        assert np.array_equal(as_measurements(source).tau, zeros)
    assert as_measurements(run) is run


def ros1_chunk(compression: bytes, packed: bytes, claimed: int) -> bytes:
    fields = [b"op=\x05", b"compression=" + compression, b"size=" + struct.pack("<I", claimed)]
    header = b"".join(struct.pack("<I", len(f)) + f for f in fields)
    return struct.pack("<I", len(header)) + header + struct.pack("<I", len(packed)) + packed


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="no limit of memory on this system")
@pytest.mark.parametrize("kind", ["npz", "mat", "parquet", "bz2", "lz4"])
def test_no_bomb_takes_more_than_its_size_allows(kind, tmp_path, monkeypatch):
    """128 MB of zeros, where reading may take 32: whatever sizes its headers claim."""
    monkeypatch.setattr(files, "_ROOM", 32 * 2**20)
    path = tmp_path / f"bomb.{kind}"
    zeros = np.zeros(2**24)
    if kind == "npz":
        np.savez_compressed(path, t=zeros)
    elif kind == "mat":
        savemat(path, {"t": zeros}, do_compression=True)
    elif kind == "parquet":
        import pyarrow
        from pyarrow import parquet

        parquet.write_table(pyarrow.table({"t": zeros, "q1": zeros, "tau1": zeros}), path)
    else:
        lz4 = pytest.importorskip("lz4.frame")
        packed = bz2.compress(zeros.tobytes()) if kind == "bz2" else lz4.compress(zeros.tobytes())
        path = tmp_path / "bomb.bag"
        chunk = ros1_chunk(kind.encode(), packed, zeros.nbytes)
        path.write_bytes(b"#ROSBAG V2.0\n" + chunk)
    del zeros
    with peak_memory() as peak, pytest.raises(InputError):
        read_run(path)
    assert peak[0] < 68 * 2**20


def test_joints_behind_one_prefix_are_the_robots(two_link, tmp_path):
    run = replace(small_run(two_link, seconds=1.0), dq=None)
    write_bag(tmp_path / "bag", run, names=["panda_joint2", "panda_joint1"])
    read = read_run(tmp_path / "bag", 2, ["joint1", "joint2"])
    assert np.allclose(read.q, run.q)
    with pytest.raises(InputError, match=r"there are: .*panda_joint1"):
        read_run(tmp_path / "bag", 2, ["axis1", "axis2"])


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
