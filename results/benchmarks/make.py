"""Make this folder again: python results/benchmarks/make.py

The part on other tools is measured apart, as README.md says: it needs a Python that has
them. The one on scripts needs scikit-learn.
"""

from pathlib import Path

from sdp_vs_penalty.paper.provenance import make_folder

HERE = Path(__file__).parent
PARTS = (
    *("scripts", "lengths", "fits", "links", "loop"),
    *("commands", "long_commands", "after", "jobs", "memory"),
)
COMMAND = ["results/benchmarks/run.py", "--only", *PARTS, "--out", str(HERE)]

if __name__ == "__main__":
    make_folder(HERE, COMMAND)
