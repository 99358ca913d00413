"""The wheel works from any directory; without any extra a verb names the one that it
needs."""

import json
import subprocess
import sys
import textwrap
import zipfile
from pathlib import Path

import pytest
from commands import PROGRAM, python
from small_runs import write_run

ROOT = Path(__file__).parents[1]


@pytest.mark.long
def test_the_wheel_alone_works_from_another_folder(tmp_path, two_link):
    """The packages that it needs are from this environment."""
    pytest.importorskip(
        "hatchling", reason="hatchling builds the wheel: install the extra [test]"
    )
    folder = tmp_path / "dist"
    installed = tmp_path / "site"
    command = [
        sys.executable,
        "-m",
        "hatchling",
        "build",
        "-t",
        "wheel",
        "-d",
        str(folder),
    ]
    subprocess.run(command, cwd=ROOT, check=True, capture_output=True)
    (built,) = folder.glob("*.whl")
    with zipfile.ZipFile(built) as archive:
        archive.extractall(installed)
    assert {path.name.split("-")[0] for path in installed.iterdir()} == {
        "sdp_vs_penalty"
    }
    assert all(
        (installed / "sdp_vs_penalty" / x).is_file()
        for x in ("py.typed", "data/datasets.toml")
    )
    write_run(tmp_path / "run.csv", two_link)
    where = "import sdp_vs_penalty; print(sdp_vs_penalty.__file__)"

    def call(*words):
        return python(*words, path=str(installed), cwd=tmp_path, check=True).stdout

    problems = call(*PROGRAM, "list", "problems")
    assert all(folder.name in problems for folder in (ROOT / "problems").iterdir())
    # What else it does it does in one process.
    model = "--data run.csv --out model.json"
    lines = [f"identify two_link {model}", "compare model.json --data run.csv"]
    place, *said = call("-c", f"{where}\n{ALL_OF.format(lines=lines)}").splitlines()
    assert Path(place).is_relative_to(installed)
    assert any("Error (RMS)" in line for line in said)


#: Every package that only an extra brings, as it is imported.
EXTRAS = (
    "matplotlib",
    "rosbags",
    "h5py",
    "openpyxl",
    "xacro",
    "plotly",
    "nicegui",
    "scs",
    "cvxopt",
    "sdpap",
    "qics",
    "distributed",
    "mujoco",
    "dartpy",
    "pybullet",
)

WITHOUT = """
import sys
from importlib.machinery import PathFinder
class Without:
    def find_spec(self, name, path=None, target=None):
        absent = name.split(".")[0] in {extras!r}
        return None if absent else PathFinder.find_spec(name, path, target)
    find_distributions = staticmethod(PathFinder.find_distributions)
sys.meta_path = [Without() if finder is PathFinder else finder for finder in sys.meta_path]
from sdp_vs_penalty.cli import main as cli
for words in {lines!r}:
    try:
        cli.main(words)
    except SystemExit as end:
        print("CODE", end.code or 0, file=sys.stderr, flush=True)
"""

#: A program that runs commands one after the other, each with exit code 0.
ALL_OF = """
from sdp_vs_penalty.cli.main import main
for line in {lines!r}:
    try:
        main(line.split())
    except SystemExit as end:
        assert not end.code, line
"""


@pytest.mark.long
def test_each_verb_works_or_names_its_extra(two_link, tmp_path):
    write_run(tmp_path / "run.csv", two_link)
    (tmp_path / "run.mcap").write_bytes(b"\\x89MCAP0\\r\\n")
    asked = json.loads((ROOT / "tests/data/commands_and_extras.json").read_text())
    program = textwrap.dedent(WITHOUT).format(
        extras=EXTRAS, lines=[words.split() for words in asked]
    )
    done = python("-c", program, cwd=tmp_path)
    *said, _ = done.stderr.split("CODE")
    codes = [int(part.split()[0]) for part in done.stderr.split("CODE")[1:]]
    assert len(codes) == len(asked), done.stderr[-2000:]
    for (words, extra), code, text in zip(asked.items(), codes, said, strict=True):
        assert code == (2 if extra else 0), (words, text)
        assert f"[{extra}]" in text or not extra, (words, text)
        assert "Traceback" not in text, (words, text)
    assert not (
        tmp_path / "demo"
    ).exists()  # nothing is worked out for a report that cannot be written
