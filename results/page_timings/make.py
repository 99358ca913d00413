"""Make this folder again: python results/page_timings/make.py"""

from pathlib import Path

from sdp_vs_penalty.paper.provenance import make_folder

HERE = Path(__file__).parent
OUT = f"results/{HERE.name}"
COMMAND = ["results/page_timings/page_timings.py", "--repeats", "5", "--out", OUT]

if __name__ == "__main__":
    make_folder(HERE, COMMAND)
