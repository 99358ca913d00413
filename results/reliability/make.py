"""Make this folder again: python results/reliability/make.py

SDP_VS_PENALTY_DATA names the folder of the measurements. Each command goes on where it
was stopped: arms and worlds that are in its tables are not judged again. The
claims about worlds are those of results/check_worlds, which is made first."""

import os
from pathlib import Path

from sdp_vs_penalty.paper.provenance import make_folder

HERE = Path(__file__).parent
DATA = os.environ.get("SDP_VS_PENALTY_DATA", ".")
#: Arms of two and three joints, by the sample of corruptions that each is given.
SMALL = {3: range(1040, 1098)}
REAL = "panda,tx40,ur10,emps,ur10e"
#: Numbers of the arms of strangers.py: first, and behind the last.
ARMS = "0:28,2000:2024"
WORLDS = HERE.parent / "check_worlds" / "worlds_claims.csv"


def corruptions(folder: str, arms: str, every: int, part: int) -> list[str]:
    """Arguments of the bench of corrupted logs."""
    sample = ["--every", str(every), "--part", str(part)]
    out = ["--out", str(HERE / folder)]
    return ["results/corruptions", "--data", DATA, "--arms", arms, *sample, *out]


def names(numbers: range) -> str:
    """Small arms, as the bench calls them."""
    return ",".join(f"small{number}" for number in numbers)


ODDS = "results/reliability/odds.py"
COMMANDS = [
    [ODDS, "--arms", ARMS, "--out", str(HERE)],
    ["results/reliability/check_real.py", "--data", DATA, "--out", str(HERE)],
    *(corruptions("small", names(arms), 6, part) for part, arms in SMALL.items()),
    corruptions("real", REAL, 10, 3),
    [
        "results/reliability/reliability.py",
        str(HERE / "real_claims.csv"),
        str(HERE / "small" / "corruptions_claims.csv"),
        str(HERE / "real" / "corruptions_claims.csv"),
        str(WORLDS),
        "--out",
        str(HERE),
    ],
]

if __name__ == "__main__":
    make_folder(HERE, *COMMANDS)
