"""Make this folder again: python results/reliability/make.py

SDP_VS_PENALTY_DATA names the folder of the measurements. The committed worlds are the first
50 of this list: the run was stopped."""

import os
from pathlib import Path

from sdp_vs_penalty.research.provenance import make_folder

HERE = Path(__file__).parent
DATA = os.environ.get("SDP_VS_PENALTY_DATA", ".")
PARTS = [1, 2, 3]
COMMANDS = [
    ["benchmarks/check_real.py", "--data", DATA, "--out", str(HERE)],
    *(
        [
            "benchmarks/corruptions",
            "--arms",
            f"drawn94{part}",
            "--every",
            "12",
            "--part",
            str(part),
            "--out",
            str(HERE),
        ]
        for part in PARTS
    ),
    [
        "benchmarks/check_worlds.py",
        "--cases",
        "12",
        "--seed",
        "26114",
        "--every",
        "3",
        "--out",
        str(HERE),
    ],
    [
        "benchmarks/reliability.py",
        str(HERE / "real_claims.csv"),
        str(HERE / "corruptions_claims.csv"),
        str(HERE / "worlds_claims.csv"),
        "--out",
        str(HERE),
    ],
]

if __name__ == "__main__":
    make_folder(HERE, *COMMANDS)
