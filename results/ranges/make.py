"""Make this folder again: python results/ranges/make.py"""

from pathlib import Path

from sdp_vs_penalty.paper.provenance import make_folder

HERE = Path(__file__).parent
COMMANDS = (["results/ranges/ranges.py"], ["results/ranges/figure.py"])

if __name__ == "__main__":
    make_folder(HERE, *COMMANDS)
