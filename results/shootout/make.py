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

from sdp_vs_penalty.files import write_text
from sdp_vs_penalty.paper.provenance import make_folder, program
from sdp_vs_penalty.shootout import runner, summary

HERE = Path(__file__).parent
OUTSIDER = "results/shootout/outsider.py"
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
    ratio = both["seconds_x"] / both["seconds_y"]
    return (
        f"Times are processor time. {len(ratio)} runs again, on the same machine while it was"
        f" busy, took {ratio.min():.2f} to {ratio.max():.2f} times as long"
        f" ({np.exp(np.log(ratio).mean()):.2f} in the geometric mean)."
    )


def with_sentences(readme: str) -> str:
    """README.md with the sentences that follow from runs.csv between its marks."""
    runs = runner.Results(HERE).runs
    head, _, rest = readme.partition(BEGIN)
    sentences = [*summary.sentences(runs), under_load(runs)]
    said = "".join(f"- {sentence}\n" for sentence in sentences)
    return head + BEGIN + said + END + rest.partition(END)[2]


if __name__ == "__main__":
    if sys.argv[1:] == ["library"]:
        with TemporaryDirectory() as library:
            for words in (["shootout", "--export", library], ["verify", library]):
                subprocess.run([sys.executable, *program(*words)], check=True)
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
            words = ("shootout", "--problems", AGAIN, *only, "--out", folder)
            subprocess.run([sys.executable, *program(*words)], check=True)
            shutil.copy(Path(folder) / "runs.csv", HERE / "under_load.csv")
    else:
        if not (HERE / "runs.csv").exists():  # the folder is no stranger's
            write_text(HERE / "runs.csv", ",".join(runner.COLUMNS) + "\n")
        only = [OUTSIDER] if sys.argv[1:] == ["outsider"] else []
        runs = program("shootout", "--jobs", "1", "--out", "results/shootout")
        make_folder(HERE, runs, [OUTSIDER], only=only)
        readme = HERE / "README.md"
        write_text(readme, with_sentences(readme.read_text("utf-8")))
