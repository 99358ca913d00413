"""Make this folder again: python results/real_arms/make.py"""

from pathlib import Path

from sdp_vs_penalty.paper.provenance import make_folder

HERE = Path(__file__).parent
COMMAND = ["results/real_arms/real_arms.py"]

if __name__ == "__main__":
    make_folder(HERE, COMMAND)
