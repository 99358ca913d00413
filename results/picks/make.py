"""Make this folder again: python results/picks/make.py"""

from pathlib import Path

from sdp_vs_penalty.paper.provenance import make_folder

HERE = Path(__file__).parent
COMMAND = ["results/picks/pick_runs.py", "--out", str(HERE)]

if __name__ == "__main__":
    make_folder(HERE, COMMAND)
