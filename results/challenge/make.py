"""Make this folder again: python results/challenge/make.py"""

from pathlib import Path

from sdp_vs_penalty.paper.provenance import make_folder

HERE = Path(__file__).parent
CHALLENGE = ["results/challenge", "--seed", "1010000", "--out", str(HERE)]
#: Three cases of every class and nuisance; then more of these.
MORE = (
    ["--classes", "clean", "--cases", "10"],
    ["--classes", "clean", "--nuisance", "mixed", "--cases", "60"],
    ["--classes", "strong", "medium", "--cases", "60"],
    ["--classes", "weak", "pairs", "--cases", "50"],
    ["--limits"],  # of what these missed
)

if __name__ == "__main__":
    more = [[*CHALLENGE, *options] for options in MORE]
    make_folder(HERE, [*CHALLENGE, "--cases", "3"], *more)
