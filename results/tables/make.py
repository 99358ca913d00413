"""Make this folder again: python results/tables/make.py

Needs SDP_VS_PENALTY_DATA for what is measured. What was computed is kept
(SDP_VS_PENALTY_CACHE): a run that was stopped goes on where it was. Annealing is run once
as long as in the paper for the table of routes (a quarter of an hour), else for a moment.
"""

from pathlib import Path

from sdp_vs_penalty.paper.provenance import make_folder, program

HERE = Path(__file__).parent
OUT = ("--out", str(HERE))
TWO_LINK = ("III", "IV", "VII", "VIII", "IX", "methods")

if __name__ == "__main__":
    make_folder(
        HERE,
        program("tables", "--all", *OUT),
        program("tables", "III", "IV", "VIII", "IX", "--html", *OUT),
        program("tables", "methods", "data", "unseen", "folds", "emps", *OUT),
        program("tables", "routes", "--budget", "single", *OUT),
        program(
            "tables",
            *TWO_LINK,
            "--problem",
            "two_link",
            "--out",
            str(HERE / "two_link"),
        ),
    )
