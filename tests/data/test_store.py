"""Long recordings: on the disk, in pieces, with the same result as in memory and in
little of it."""

import mmap
import os
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from recorded import refusal
from small_runs import small_run, write_bag, write_run

from sdp_vs_penalty import Measurements, load_problem
from sdp_vs_penalty.data import load_measurements, save, store
from sdp_vs_penalty.signals import interpolated


def mapped(array):
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
    # The store's comes last: a module that is first imported by this loop takes it over.
    for home in ("measurements", "formats.parquet", "formats.bag", "values", "store"):
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


def resident_file_bytes():
    """Bytes of this process's memory that are pages of files."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return 1024 * next(int(x.split()[1]) for x in lines if x.startswith("RssFile"))


def large_mapped_array(n_bytes=1 << 25):
    numbers = np.arange(n_bytes // 8, dtype=float).reshape(-1, 4)
    array = store.concatenate_chunks([numbers])
    assert mapped(array)
    return array


def iterate(array):
    assert sum(chunk.sum() for _, chunk in store.iter_chunks(array)) > 0.0


def extremes(array):
    smallest, largest = store.column_range(array)
    np.testing.assert_array_equal(smallest, array[0])
    np.testing.assert_array_equal(largest, array[-1])


def interpolate(array):
    t = np.arange(len(array)) / 1e3
    np.testing.assert_array_equal(interpolated(t, t, array)[-1], array[-1])


@pytest.mark.skipif(not os.path.exists("/proc/self/status"), reason="Linux alone")
@pytest.mark.parametrize("read", [iterate, extremes, interpolate, store.digest])
def test_rows_of_a_mapped_array_leave_memory_once_they_are_read(read):
    array = large_mapped_array()
    before = resident_file_bytes()
    read([array] if read is store.digest else array)
    assert resident_file_bytes() - before < array.nbytes / 4
    array.sum()  # read at once, all of it stays
    assert resident_file_bytes() - before > array.nbytes / 2


@pytest.mark.parametrize("rows", [slice(0, 0), slice(3, 4), slice(5, 90_001)])
def test_dropped_rows_are_read_again(rows):
    array = large_mapped_array()
    before = array[rows].copy()
    store.drop_pages(array[rows])
    np.testing.assert_array_equal(array[rows], before)
    store.drop_pages(array[rows, 1])
    np.testing.assert_array_equal(array[rows], before)


def test_an_array_in_memory_is_not_dropped():
    array = np.arange(1e6).reshape(-1, 2)
    store.drop_pages(array[100:])
    assert array[-1, 1] == 1e6 - 1


def test_a_long_run_costs_no_more_memory_than_a_short_one(tmp_path):
    """What lies in memory when it is read, written, checked for numbers; the rest is
    mapped."""
    problem = load_problem("two_link")
    peaks = []
    run = small_run(problem, seconds=20.0)
    # The first run imports modules; of the others each column is mapped.
    for times in (10, 400, 1200):
        q, tau = np.tile(run.q, (times, 1)), np.tile(run.tau, (times, 1))
        path = tmp_path / f"{times}.parquet"
        save(Measurements(1e-3 * np.arange(len(q)), q, tau), path)
        del q, tau
        tracemalloc.start()
        save(load_measurements(path), tmp_path / "out.parquet")
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
        os.remove(path)
    assert peaks[2] < 1.1 * peaks[1]
