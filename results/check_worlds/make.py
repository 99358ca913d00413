"""Make this folder again: python results/check_worlds/make.py"""

from pathlib import Path

from sdp_vs_penalty.paper.provenance import make_folder

HERE = Path(__file__).parent
COMMAND = [
    "results/check_worlds/check_worlds.py",
    "--cases",
    "4",
    "--seed",
    "9001",
    "--every",
    "2",
    "--out",
    str(HERE),
]

if __name__ == "__main__":
    make_folder(HERE, COMMAND)
