"""Make this folder again: python results/corruptions/make.py"""

import os
from pathlib import Path

from sdp_vs_penalty.paper.provenance import make_folder

HERE = Path(__file__).parent
#: Real arms and drawn ones, each with how many cases make one, and which of these
#: samples.
SAMPLES = (("panda,tx40,emps,ur10e,ur10", "10", "5"), ("drawn702,drawn703", "8", "4"))

if __name__ == "__main__":
    data = ["--data", os.environ["SDP_VS_PENALTY_DATA"]]
    out = ["--out", str(HERE)]
    commands = []
    for arms, every, part in SAMPLES:
        sample = ["--arms", arms, "--every", every, "--part", part]
        commands.append(["results/corruptions", *data, *sample, *out])
    make_folder(HERE, *commands)
