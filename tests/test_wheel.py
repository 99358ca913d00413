"""The wheel works from any directory: the built-in problems travel as package data."""

import subprocess
import sys
import zipfile
from pathlib import Path

import pytest
from commands import PROGRAM, python
from small_runs import write_run

ROOT = Path(__file__).parents[1]


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    pytest.importorskip("hatchling", reason="hatchling builds the wheel: install the extra [test]")
    folder = tmp_path_factory.mktemp("dist")
    command = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(folder)]
    subprocess.run(command, cwd=ROOT, check=True, capture_output=True)
    (built,) = folder.glob("*.whl")
    return built


@pytest.fixture(scope="module")
def installed(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel on its own, the packages that it needs from this environment."""
    folder = tmp_path_factory.mktemp("site")
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(folder)
    return folder


def test_the_wheel_holds_package_and_problems_only(wheel):
    with zipfile.ZipFile(wheel) as archive:
        names = archive.namelist()
    tops = {name.split("/")[0] for name in names}
    assert {top.split("-")[0] for top in tops} == {"sdp_vs_penalty"}
    for folder in (ROOT / "problems").iterdir():
        assert f"sdp_vs_penalty/problems/{folder.name}/problem.toml" in names
    assert "sdp_vs_penalty/data/datasets.toml" in names
    assert "sdp_vs_penalty/py.typed" in names


def test_the_command_works_from_another_folder(installed, tmp_path, two_link):
    write_run(tmp_path / "run.csv", two_link)
    where = "import sdp_vs_penalty; print(sdp_vs_penalty.__file__)"

    def call(*words: str) -> str:
        return python(*words, path=str(installed), cwd=tmp_path, check=True).stdout

    assert Path(call("-c", where).strip()).is_relative_to(installed)
    for name in ("panda", "two_link", "ur10e", "emps", "tx40"):
        assert name in call(*PROGRAM, "list", "problems")
    call(*PROGRAM, "identify", "two_link", "--data", "run.csv", "--out", "model.json")
    assert "RMSE" in call(*PROGRAM, "compare", "model.json", "--data", "run.csv")
