"""Fixtures that several test files share."""

from __future__ import annotations

import os
from pathlib import Path

# Before NumPy is loaded: several workers, each with threads for small matrices, only hinder each other.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import pytest

from sdp_vs_penalty.measurements import Measurements, load_measurements
from sdp_vs_penalty.problem import Problem, load_problem


def real_data_folder() -> Path | None:
    """Where the real measurements are: SDP_VS_PENALTY_DATA, or the shared folder beside a checkout."""
    named = os.environ.get("SDP_VS_PENALTY_DATA")
    folder = Path(named) if named else Path(__file__).parents[2] / "shared" / "data"
    return folder if folder.is_dir() else None


# An installed package cannot know where this checkout is.
if (found := real_data_folder()) is not None:
    os.environ.setdefault("SDP_VS_PENALTY_DATA", str(found))


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    if real_data_folder() is None:
        skip = pytest.mark.skip(reason="the real measurements are absent: set SDP_VS_PENALTY_DATA")
        for item in items:
            if "real_data" in item.keywords:
                item.add_marker(skip)


@pytest.fixture(scope="session")
def data_folder() -> Path:
    folder = real_data_folder()
    if folder is None:
        pytest.skip("the real measurements are absent: set SDP_VS_PENALTY_DATA")
    return folder


@pytest.fixture(scope="session")
def panda_run(data_folder: Path) -> Measurements:
    """The 20 544 samples of the paper's identification run."""
    return load_measurements(data_folder / "panda", joints=7)


@pytest.fixture(scope="session")
def panda() -> Problem:
    return load_problem("panda")


@pytest.fixture(scope="session")
def two_link() -> Problem:
    return load_problem("two_link")
