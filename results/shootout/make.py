"""Make this folder again: SDP_VS_PENALTY_DATA=... python results/shootout/make.py

Runs that it holds are not repeated; delete runs.csv to begin anew. The declared sets take
about 20 minutes on two quiet cores. `make.py library` does what library.md quotes instead;
the instances themselves (400 MB) are not kept.
"""

import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

from sdp_vs_penalty.files import write_text
from sdp_vs_penalty.paper.provenance import make_folder, program
from sdp_vs_penalty.shootout import runner, summary

HERE = Path(__file__).parent
BEGIN, END = "<!-- sentences: begin -->\n", "<!-- sentences: end -->\n"


def with_sentences(readme: str) -> str:
    """README.md with the sentences that follow from runs.csv between its marks."""
    runs = runner.Results(HERE).runs
    head, _, rest = readme.partition(BEGIN)
    said = "".join(f"- {sentence}\n" for sentence in summary.sentences(runs))
    return head + BEGIN + said + END + rest.partition(END)[2]


if __name__ == "__main__":
    if sys.argv[1:] == ["library"]:
        with TemporaryDirectory() as library:
            for words in (["shootout", "--export", library], ["verify", library]):
                subprocess.run([sys.executable, *program(*words)], check=True)
    else:
        if not (HERE / "runs.csv").exists():  # the folder is no stranger's
            write_text(HERE / "runs.csv", ",".join(runner.COLUMNS) + "\n")
        make_folder(HERE, program("shootout", "--out", str(HERE)))
        readme = HERE / "README.md"
        write_text(readme, with_sentences(readme.read_text("utf-8")))
