"""Make this folder again: python results/check_worlds/make.py

Worlds that are in the table are not judged again, so a run that was stopped goes on."""

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
