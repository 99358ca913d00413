"""Make this folder again: python results/ranges/make.py [SECTION ...]

With names of sections, or "results/ranges/figure.py", only these are made. Needs
SDP_VS_PENALTY_DATA for what is measured; `coverage` takes hours.
"""

import sys
from pathlib import Path

from sdp_vs_penalty.paper.provenance import make_folder

HERE = Path(__file__).parent
RANGES = "results/ranges/ranges.py"
SECTIONS = ("ends", "cost", "coverage", "band", "samples", "excite")
COMMANDS = [*([RANGES, name] for name in SECTIONS), ["results/ranges/figure.py"]]

if __name__ == "__main__":
    make_folder(HERE, *COMMANDS, only=sys.argv[1:])
