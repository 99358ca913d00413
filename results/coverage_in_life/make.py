"""Make this folder again: python results/coverage_in_life/make.py"""

from pathlib import Path

from sdp_vs_penalty.paper.provenance import make_folder

HERE = Path(__file__).parent
COMMAND = [
    "results/coverage_in_life/coverage_in_life.py",
    "--draws",
    "160",
    "--seed",
    "31000",
    "--out",
    str(HERE / "coverage_in_life.md"),
]

if __name__ == "__main__":
    make_folder(HERE, COMMAND)
