"""Make this folder again: python results/corruptions/make.py"""

import os
from pathlib import Path

from sdp_vs_penalty.paper.provenance import make_folder

HERE = Path(__file__).parent
ARMS = "drawn698,drawn699,drawn700,drawn701,panda,ur10e,tx40,ur10,emps"
#: Every fifth case, the third of five parts.
PART = ["--every", "5", "--part", "3"]

if __name__ == "__main__":
    data = ["--data", os.environ["SDP_VS_PENALTY_DATA"]]
    arms = ["--arms", ARMS]
    out = ["--out", str(HERE)]
    make_folder(HERE, ["results/corruptions", *data, *arms, *PART, *out])
