"""Make this folder again: SDP_VS_PENALTY_DATA=... python results/shootout/make.py

Runs that it holds are not repeated; delete runs.csv to begin anew. The declared sets take
about 40 minutes, one run after the other. `make.py load`, on a busy machine, runs some again
as under_load.csv. `make.py outsider` compares the runs with those of an outsider alone.
`make.py library` does what library.md quotes instead; the instances
themselves (400 MB) are not kept.
"""

import shutil
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pandas

from sdp_vs_penalty import solvers
from sdp_vs_penalty.files import write_text
from sdp_vs_penalty.formatting import words
from sdp_vs_penalty.paper.provenance import NOTE, make_folder, program
from sdp_vs_penalty.shootout import runner, summary

HERE = Path(__file__).parent
OUTSIDER = "results/shootout/outsider.py"
#: What runs.csv does not hold.
KEPT = (
    "SCS's linear solver is not kept: it chose by itself (AUTO), likely MKL, which its wheel"
    " holds.",
    "csdp, dsdp and sdpa-program are Debian's builds, sdpa is the wheel sdpa-python, whose"
    " conversion is in its clock; which BLAS they call is not kept.",
    "Residuals in the solvers' own norms are not kept: that a far answer met its own rule is"
    " judged by DIMACS errors.",
)
HEAD = "## What the kept runs do not have\n\n"
BEGIN, END = "<!-- sentences: begin -->\n", "<!-- sentences: end -->\n"


#: What is run again on a busy machine.
AGAIN = (
    "two_link simulated one-step plain,panda simulated 3 s one-step cones,"
    "tx40 simulated two-step plain,ur10e simulated one-step cones,"
    "chain of 7 links gyration 0"
)


def under_load(runs: pandas.DataFrame) -> str:
    """How much longer the runs of under_load.csv took than the same runs here."""
    key = ["problem", "solver", "accuracy"]
    both = pandas.read_csv(HERE / "under_load.csv").merge(runs, on=key)
    both["ratio"] = both["seconds_x"] / both["seconds_y"]
    said = [
        f"{len(ratio)} of {solver} {ratio.min():.2f} to {ratio.max():.2f} times as long"
        f" ({np.exp(np.log(ratio).mean()):.2f} in the geometric mean)"
        for solver, ratio in both.groupby("solver")["ratio"]
    ]
    asked = words([f"{a:g}" for a in both["accuracy"].unique()])
    return (
        f"Times are processor time. Runs asked for {asked} again, on the same machine while it"
        f" was busy, took: {words(said)}."
    )


def beyond_bounds(runs: pandas.DataFrame) -> str:
    """How many optima of the conic forms lie below the bound that SDPA ships.

    A Gram matrix leaves out rho^T rho, which errors are relative to there.
    """
    text = Path(solvers.__file__).with_name("param.sdpa").read_text("utf-8")
    bound = float(next(x for x in text.splitlines() if "lowerBound" in x).split()[0])
    forms = runs[runs["set"] == "conic form"].drop_duplicates("problem")
    is_gram = forms["problem"].str.contains(" gram ")
    optimum = forms["upper"] - forms["scale"].where(is_gram, 0.0)
    below = forms["problem"][optimum < bound]
    ends = runs[runs["problem"].isin(below) & (runs["status"] == "noINFO")]
    return (
        f"On {len(below)} of {len(forms)} conic form problems the optimum is below the"
        f" lowerBound {bound:g} that SDPA ships, which we leave as it is; on"
        f" {ends['problem'].nunique()} of these SDPA ends without a feasible point (noINFO). Its manual"
        " has the user set lowerBound."
    )


def with_sentences(readme: str) -> str:
    """README.md with the sentences that follow from runs.csv between its marks."""
    runs = runner.Results(HERE).runs
    head, _, rest = readme.partition(BEGIN)
    told = [*summary.sentences(runs), beyond_bounds(runs), under_load(runs)]
    sentences = [*told, *KEPT]
    said = "".join(f"- {sentence}\n" for sentence in sentences)
    return head + BEGIN + said + END + rest.partition(END)[2]


def with_kept(text: str) -> str:
    """summary.md with what the kept runs do not have."""
    lines = "".join(f"- {sentence}\n" for sentence in KEPT)
    return text.partition(f"\n{HEAD}")[0] + f"\n{HEAD}{lines}"


if __name__ == "__main__":
    if sys.argv[1:] == ["library"]:
        with TemporaryDirectory() as library:
            for verb in (["shootout", "--export", library], ["verify", library]):
                subprocess.run([sys.executable, *program(*verb)], check=True)
    elif sys.argv[1:] == ["load"]:
        with TemporaryDirectory() as folder:
            only = (
                "--solvers",
                "clarabel,lmi-sdp",
                "--accuracy",
                "1e-8",
                "--jobs",
                "1",
            )
            again = ("shootout", "--problems", AGAIN, *only, "--out", folder)
            subprocess.run([sys.executable, *program(*again)], check=True)
            shutil.copy(Path(folder) / "runs.csv", HERE / "under_load.csv")
    else:
        if not (HERE / "runs.csv").exists():  # the folder is no stranger's
            write_text(HERE / "runs.csv", ",".join(runner.COLUMNS) + "\n")
            (HERE / NOTE).unlink(missing_ok=True)
        only = [OUTSIDER] if sys.argv[1:] == ["outsider"] else []
        runs = program("shootout", "--jobs", "1", "--out", "results/shootout")
        if not only:
            make_folder(HERE, runs, [OUTSIDER], only=["shootout"], result="runs.csv")
        make_folder(HERE, runs, [OUTSIDER], only=[OUTSIDER])
        write_text(
            HERE / "summary.md", with_kept((HERE / "summary.md").read_text("utf-8"))
        )
        readme = HERE / "README.md"
        write_text(readme, with_sentences(readme.read_text("utf-8")))
