"""Input that would fill the memory, wait for ever or overflow: each ends in a sentence."""

from __future__ import annotations

import bz2
import os
import struct
import threading
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from small_runs import small_run, write_bag

from sdp_vs_penalty.check import check
from sdp_vs_penalty.data.files import load_measurements, read_run, save
from sdp_vs_penalty.data.formats import pipes
from sdp_vs_penalty.data.formats.bag_bombs import check_bag
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.page.uploads import too_large
from sdp_vs_penalty.problem.problem import Problem
from sdp_vs_penalty.signals.preprocessing import Preprocessing, RunFilter
from sdp_vs_penalty.signals.runs import sample_rate, stretches


def bursts(run: Measurements) -> Measurements:
    k = np.arange(len(run.t))
    return replace(run, t=(k // 10) * 0.1 + (k % 10) * 1e-6)


def test_burst_stamps_make_no_grid_finer_than_ten_points_a_sample(two_link: Problem) -> None:
    run = bursts(small_run(two_link, seconds=20.0))
    assert sum(part.count for part in stretches(run)) <= 20 * len(run.t)
    (report,) = check(two_link, run)
    assert "burst stamps" in [f.kind for f in report.problems]
    assert np.ptp(np.diff(report.mended.t)) < 0.1 * np.median(np.diff(report.mended.t))


def test_pauses_do_not_coarsen_the_grid(two_link: Problem) -> None:
    run = small_run(two_link, seconds=6.0)
    later = replace(run, t=run.t + 3600.0 * (run.t > 3.0))
    assert sample_rate(later) == pytest.approx(sample_rate(run))


@pytest.mark.parametrize("cutoff", [1e-4, 1e-12, 1e-300])
def test_a_kernel_is_no_longer_than_the_run(cutoff: float, two_link: Problem) -> None:
    run = small_run(two_link)
    with pytest.raises(InputError, match="raise the cut-offs"):
        RunFilter(run, Preprocessing(cutoff).resolve(run))


@pytest.mark.parametrize(("name", "value"), [("q", 1e160), ("tau", 1e300), ("dq", 1e300), ("t", 1e200)])
def test_absurd_numbers_end_in_a_sentence(
    name: str, value: float, two_link: Problem, tmp_path: Path
) -> None:
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


def test_a_pipe_is_read_once(two_link: Problem, tmp_path: Path) -> None:
    run = small_run(two_link)
    save(run, tmp_path / "run.csv")
    pipe = tmp_path / "pipe.csv"
    os.mkfifo(pipe)
    content = (tmp_path / "run.csv").read_bytes()
    writer = threading.Thread(target=lambda: pipe.write_bytes(content))
    writer.start()
    read = read_run(pipe, 2)
    writer.join()
    assert read.names == ("pipe.csv",)
    assert np.array_equal(read.tau, run.tau)


def test_a_pipe_without_a_writer_ends(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pipe = tmp_path / "pipe.csv"
    os.mkfifo(pipe)
    monkeypatch.setattr(pipes, "_PATIENCE", 0.3)
    with pytest.raises(InputError, match="nothing comes through"):
        read_run(pipe)
    with pytest.raises(InputError, match="neither a file nor a folder"):
        read_run("/dev/full")


def ros1_chunk(compression: bytes, packed: bytes, claimed: int) -> bytes:
    fields = [b"op=\x05", b"compression=" + compression, b"size=" + struct.pack("<I", claimed)]
    header = b"".join(struct.pack("<I", len(f)) + f for f in fields)
    return struct.pack("<I", len(header)) + header + struct.pack("<I", len(packed)) + packed


@pytest.mark.parametrize("compression", [b"bz2", b"lz4"])
def test_a_ros1_bomb_is_not_unpacked(compression: bytes, tmp_path: Path) -> None:
    """Whatever size its header claims; an honest chunk passes."""
    pytest.importorskip("lz4.frame")
    import lz4.frame

    pack = bz2.compress if compression == b"bz2" else lz4.frame.compress
    path = tmp_path / "bomb.bag"
    zeros = pack(bytes(30_000_000))
    path.write_bytes(b"#ROSBAG V2.0\n" + ros1_chunk(compression, zeros, 10) * 6)
    with pytest.raises(InputError, match="unpacks"):
        check_bag(path)
    path.write_bytes(b"#ROSBAG V2.0\n" + ros1_chunk(compression, pack(os.urandom(1000)), 1000))
    check_bag(path)


def test_a_compressed_bag_is_counted_before_it_is_unpacked(tmp_path: Path) -> None:
    zstd = pytest.importorskip("backports.zstd")
    file = tmp_path / "run.db3.zstd"
    file.write_bytes(zstd.compress(bytes(200_000_000)))
    with pytest.raises(InputError, match="unpacks"):
        check_bag(tmp_path)


def test_joints_behind_one_prefix_are_the_robots(two_link: Problem, tmp_path: Path) -> None:
    run = replace(small_run(two_link, seconds=1.0), dq=None)
    write_bag(tmp_path / "bag", run, names=["panda_joint2", "panda_joint1"])
    read = read_run(tmp_path / "bag", 2, ["joint1", "joint2"])
    assert np.allclose(read.q, run.q)
    with pytest.raises(InputError, match=r"there are: .*panda_joint1"):
        read_run(tmp_path / "bag", 2, ["axis1", "axis2"])


def test_an_upload_of_any_announced_size_is_answered() -> None:
    assert "MB" in str(too_large("run.csv", 10**400))
