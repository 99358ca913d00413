"""Make this folder again: python results/attacks/make.py"""

from pathlib import Path

from sdp_vs_penalty.paper.provenance import make_folder

HERE = Path(__file__).parent
COMMAND = ["results/attacks", "--number", "400", "--seed", "20261127"]

if __name__ == "__main__":
    make_folder(HERE, [*COMMAND, "--out", "results/attacks"])
