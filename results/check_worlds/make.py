"""Make this folder again: python results/check_worlds/make.py

Worlds that are in the table are not judged again. The committed table holds the first
worlds of the challenge in the order in which they are drawn: the run was stopped."""

from pathlib import Path

from sdp_vs_penalty.paper.provenance import make_folder

HERE = Path(__file__).parent
COMMAND = [
    "results/check_worlds/check_worlds.py",
    "--worlds-of",
    "results/challenge/challenge.json",
    "--out",
    str(HERE),
]

if __name__ == "__main__":
    make_folder(HERE, COMMAND)
