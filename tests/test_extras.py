"""Without any extra: what needs one names it in a sentence, and the rest works."""

import textwrap
from pathlib import Path

import pytest
from commands import python
from small_runs import write_run

from sdp_vs_penalty import Problem

#: Every package that only an extra brings, as it is imported.
EXTRAS = (
    "matplotlib", "pyarrow", "rosbags", "plotly", "nicegui", "scs", "cvxopt", "sdpap", "qics",
    "distributed", "mujoco", "dartpy", "pybullet",
)  # fmt: skip

PROGRAM = """
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


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory, two_link: Problem) -> Path:
    folder = tmp_path_factory.mktemp("extras")
    write_run(folder / "run.csv", two_link)
    (folder / "run.mcap").write_bytes(b"\\x89MCAP0\\r\\n")
    return folder


def test_each_verb_works_or_names_its_extra(folder):
    asked = {
        "check run.csv --problem two_link": "",
        "identify two_link --data run.csv --out model.json": "",
        "compare model.json --data run.csv": "",
        "export model.json --out model.urdf": "",
        "check-urdf model.urdf": "",
        "list solvers": "",
        "convert run.csv --out run.mat": "",
        "convert run.csv --out run.parquet": "formats",
        "convert run.mcap --out other.csv": "formats",
        "report model.json --data run.csv --out report.html": "report",
        "page": "page",
        "figures 2 --out figures": "plot",
        "shootout --solvers scs --problems two_link --out out": "solvers",
    }
    program = textwrap.dedent(PROGRAM).format(extras=EXTRAS, lines=[words.split() for words in asked])
    done = python("-c", program, cwd=folder)
    *said, _ = done.stderr.split("CODE")
    codes = [int(part.split()[0]) for part in done.stderr.split("CODE")[1:]]
    assert len(codes) == len(asked), done.stderr[-2000:]
    for (words, extra), code, text in zip(asked.items(), codes, said, strict=True):
        assert code == (2 if extra else 0), (words, text)
        assert f"[{extra}]" in text or not extra, (words, text)
        assert "Traceback" not in text, (words, text)
