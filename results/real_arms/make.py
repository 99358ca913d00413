"""Make this folder again: python results/real_arms/make.py [PROGRAM ...]

With names of programs ("results/real_arms/ur10e.py") only these are run. Needs
SDP_VS_PENALTY_DATA.
"""

import sys
from pathlib import Path

from sdp_vs_penalty.paper.provenance import make_folder

HERE = Path(__file__).parent
COMMANDS = [["results/real_arms/real_arms.py"], ["results/real_arms/ur10e.py"]]

if __name__ == "__main__":
    make_folder(HERE, *COMMANDS, only=sys.argv[1:])
