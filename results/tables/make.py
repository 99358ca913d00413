"""Make this folder again: python results/tables/make.py

Needs SDP_VS_PENALTY_DATA for what is measured. What was computed is kept
(SDP_VS_PENALTY_CACHE): a run that was stopped goes on where it was. Annealing is run as long
as in the paper for routes, opponent and five draws of monte_carlo (an hour), else for a moment.
"""

from pathlib import Path

from sdp_vs_penalty.paper.provenance import make_folder, program

HERE = Path(__file__).parent
OUT = ("--out", str(HERE))
SLOW = (
    *("methods", "data", "unseen", "emps"),
    *("triangle", "xi", "sensitivity", "arms"),
)
TWO_LINK = ("III", "IV", "VII", "VIII", "IX", "methods")

if __name__ == "__main__":
    make_folder(
        HERE,
        program("tables", "--all", *OUT),
        program("tables", "III", "IV", "VIII", "IX", "--html", *OUT),
        program("tables", *SLOW, *OUT),
        program("tables", "monte_carlo", "opponent", "--budget", "single", *OUT),
        program("tables", "routes", "--budget", "single", "--jobs", "1", *OUT),
        program(
            "tables",
            *TWO_LINK,
            "--problem",
            "two_link",
            "--out",
            str(HERE / "two_link"),
        ),
    )
