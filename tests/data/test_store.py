"""Long recordings: on the disk, in pieces, with the same result as in memory and in
little of it."""

import mmap
import os
import tracemalloc

import numpy as np
import pytest
from recorded import refusal
from small_runs import small_run, write_bag, write_run

from sdp_vs_penalty import Measurements, load_problem
from sdp_vs_penalty.data import load_measurements, save, store


def mapped(array: np.ndarray | None) -> bool:
    base = array
    while isinstance(base, np.ndarray):
        base = base.base
    return isinstance(base.obj if isinstance(base, memoryview) else base, mmap.mmap)


@pytest.mark.parametrize("suffix", [".csv", ".npz", ".parquet", ".mcap"])
def test_read_in_pieces_to_the_last_bit(suffix, tmp_path, monkeypatch):
    run = small_run(load_problem("two_link"), seconds=8.0)
    path = tmp_path / f"run{suffix}"
    if suffix == ".mcap":
        path = tmp_path / "bag"
        write_bag(path, run, mcap=True, names=["a", "b"])
    else:
        save(run, path)
    whole = load_measurements(path)
    monkeypatch.setattr(store, "LARGEST_IN_MEMORY", 1 << 12)
    monkeypatch.setattr("sdp_vs_penalty.data.formats.npz.LARGEST_IN_MEMORY", 1 << 12)
    for home in (
        "store",
        "measurements",
        "formats.npz",
        "formats.parquet",
        "formats.bag",
    ):
        monkeypatch.setattr(f"sdp_vs_penalty.data.{home}.PART", 77)
    pieces = load_measurements(path)
    assert mapped(pieces.q)
    assert not mapped(whole.q)
    assert pieces.data_hash == whole.data_hash
    out = tmp_path / f"again{suffix}"
    if suffix != ".mcap":
        save(pieces, out)
        assert load_measurements(out).data_hash == whole.data_hash


def test_the_same_estimate_from_disk_and_from_memory(two_link, tmp_path, monkeypatch):
    monkeypatch.setattr(store, "LARGEST_IN_MEMORY", 1 << 12)  # everything is long
    for seed in (0, 1):
        write_run(tmp_path / f"run{seed}.parquet", two_link, seconds=8.0, seed=seed)
    on_disk = load_measurements(tmp_path)
    assert mapped(on_disk.q)
    assert mapped(on_disk.runs()[1].tau)
    assert on_disk.names == ("run0.parquet", "run1.parquet")
    pattern = load_measurements(str(tmp_path / "run?.parquet"))
    assert pattern.data_hash == on_disk.data_hash
    refusal(lambda: load_measurements(tmp_path / "no*.csv"), "no file matches")


def test_no_room_for_a_temporary_file(monkeypatch):
    monkeypatch.setenv("TMPDIR", "/nowhere")
    monkeypatch.setattr(store, "LARGEST_IN_MEMORY", 10)
    refusal(
        lambda: store.concatenate_chunks([np.zeros(100)]),
        "set TMPDIR to a folder with room",
    )


def test_a_long_run_costs_no_more_memory_than_a_short_one(tmp_path):
    """What lies in memory when it is read, written, checked for numbers; the rest is
    mapped."""
    problem = load_problem("two_link")
    peaks = []
    run = small_run(problem, seconds=20.0)
    for times in (4, 16):
        q, tau = np.tile(run.q, (100 * times, 1)), np.tile(run.tau, (100 * times, 1))
        path = tmp_path / f"{times}.parquet"
        save(Measurements(1e-3 * np.arange(len(q)), q, tau), path)
        del q, tau
        tracemalloc.start()
        save(load_measurements(path), tmp_path / "out.parquet")
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
        os.remove(path)
    assert peaks[1] < 1.3 * peaks[0]
