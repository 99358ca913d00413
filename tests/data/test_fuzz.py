"""Files with bytes changed, cut and put in: a run or a sentence, never anything else."""

from __future__ import annotations

import tempfile
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from small_runs import small_run, write_bag

from sdp_vs_penalty.data.files import load_measurements, save
from sdp_vs_penalty.data.formats import formats
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.problem.load import load_problem

#: One of each format that we write, and the bags that a test can.
SUFFIXES = [*(home.SUFFIXES[0] for home in formats() if hasattr(home, "write")), ".mcap", ".db3"]
#: A mutation: where (a share of the file), what is put there, how many bytes it replaces.
MUTATION = st.tuples(
    st.floats(0.0, 1.0),
    st.one_of(
        st.binary(max_size=8), st.sampled_from([b"\0", b"\xff" * 8, b",", b"\n", b"nan", b"1e999"])
    ),
    st.integers(0, 16),
)


@cache
def sound(suffix: str) -> bytes:
    """A small run in each format."""
    run = small_run(load_problem("two_link"), seconds=0.5)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"run{suffix}"
        if suffix in (".mcap", ".db3"):
            write_bag(Path(folder) / "bag", run, mcap=suffix == ".mcap", names=["joint2", "joint1"])
            (path,) = (Path(folder) / "bag").glob(f"*{suffix}")
        else:
            save(run, path)
        return path.read_bytes()


@pytest.mark.parametrize("suffix", SUFFIXES)
@settings(
    max_examples=60,
    deadline=None,
    derandomize=True,
    suppress_health_check=list(HealthCheck),
    database=None,
)
@given(st.lists(MUTATION, min_size=1, max_size=4))
def test_a_changed_file_is_a_run_or_a_sentence(
    suffix: str, mutations: list[tuple[float, bytes, int]]
) -> None:
    if suffix == ".parquet":
        pytest.importorskip("pyarrow")
    content = sound(suffix)
    for place, put, replaced in mutations:
        at = int(place * len(content))
        content = content[:at] + put + content[at + replaced :]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"run{suffix}"
        path.write_bytes(content)
        try:
            read = load_measurements(path)
        except InputError:
            return
    assert isinstance(read, Measurements)
    assert np.all(np.isfinite(read.q))
    assert np.all(np.diff(read.t) > 0.0)
