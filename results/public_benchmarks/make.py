"""Make this folder again: python results/public_benchmarks/make.py"""

from pathlib import Path

from sdp_vs_penalty.paper.provenance import make_folder

HERE = Path(__file__).parent
COMMAND = ["results/public_benchmarks/public_benchmarks.py"]

if __name__ == "__main__":
    make_folder(HERE, COMMAND)
