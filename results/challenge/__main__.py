"""How often is the diagnosis right, on robots that are simulated independently of the
library?

python results/challenge --classes clean --nuisance sign dahl --cases 4 --seed 1000 --out hidden
"""

import argparse
import os
import sys
from pathlib import Path

os.environ |= dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
sys.path[0] = str(Path(__file__).parents[1])  # for this process and its workers

from challenge.cases import CLASSES, run_challenge, wanted
from challenge.limit import run_limits
from challenge.worlds.conditions import NUISANCES


def main() -> None:
    parser = argparse.ArgumentParser(prog="results/challenge", description=__doc__)
    parser.add_argument(
        "--cases", type=int, default=20, help="of each class; clean: of each nuisance"
    )
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument(
        "--out",
        type=Path,
        default=Path("results", "challenge"),
        help="folder for challenge.*",
    )
    parser.add_argument("--jobs", type=int, default=2)
    for word, known in (("--classes", [*CLASSES]), ("--nuisance", [*NUISANCES])):
        parser.add_argument(word, nargs="+", choices=known, default=known)
    parser.add_argument(
        "--limits",
        action="store_true",
        help="in place of all this: whether the true model of what the cases in OUT"
        " missed scores better",
    )
    options = parser.parse_args()
    if options.limits:
        print(*run_limits(options.out, options.jobs), sep="\n")
        return
    cases = wanted(options.cases, options.seed, options.classes, options.nuisance)
    print(*run_challenge(cases, options.seed, options.out, options.jobs), sep="\n")


if __name__ == "__main__":
    main()
