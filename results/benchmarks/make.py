"""Make this folder again: python results/benchmarks/make.py"""

from pathlib import Path

from sdp_vs_penalty.paper.provenance import make_folder

HERE = Path(__file__).parent
COMMAND = [
    "results/benchmarks/run.py",
    "--out",
    str(HERE),
]

if __name__ == "__main__":
    make_folder(HERE, COMMAND)
