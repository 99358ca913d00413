"""Make this folder again: python results/tables/make.py [TABLE ...]

With names of tables only the commands that make these are run. Needs SDP_VS_PENALTY_DATA
for what is measured. What was computed is kept (SDP_VS_PENALTY_CACHE): a run that was
stopped goes on where it was. Annealing is run as long as in the paper for routes, opponent
and five draws of monte_carlo (an hour), else for a moment.
"""

import sys
from pathlib import Path

from sdp_vs_penalty.paper.provenance import make_folder, program

HERE = Path(__file__).parent
OUT = ("--out", "results/tables")
CHEAP = ("I", "II", "VI", "errata", "p_hat", "wrenches", "emps", "data")
SLOW = ("V", "methods", "unseen", "triangle", "xi", "sensitivity", "arms")
TWO_LINK = ("III", "IV", "VII", "VIII", "IX", "methods")
SINGLE = ("--budget", "single", "--jobs", "1")

if __name__ == "__main__":
    make_folder(
        HERE,
        program("tables", "III", "IV", "VIII", "IX", *OUT),
        program("tables", *CHEAP, *OUT),
        program("tables", *SLOW, *OUT),
        program("tables", "opponent", *SINGLE, *OUT),
        program("tables", "routes", *SINGLE, *OUT),
        program("tables", "monte_carlo", *SINGLE, *OUT),
        program(
            "tables",
            *TWO_LINK,
            "--problem",
            "two_link",
            "--out",
            "results/tables/two_link",
        ),
        only=sys.argv[1:],
    )
