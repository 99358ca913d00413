"""Make this folder again: python results/shootout/make.py

Runs that it holds are not repeated; delete runs.csv to begin anew. library.md quotes what
the second and third command print; the instances themselves (400 MB) are not kept.
"""

from pathlib import Path
from tempfile import TemporaryDirectory

from sdp_vs_penalty.paper.provenance import make_folder, program

HERE = Path(__file__).parent

if __name__ == "__main__":
    with TemporaryDirectory() as library:
        make_folder(
            HERE,
            program("shootout", "--time-limit", "20", "--out", str(HERE)),
            program("shootout", "--export", library),
            program("verify", library),
        )
