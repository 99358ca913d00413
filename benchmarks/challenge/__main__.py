"""How often is the diagnosis right, on robots that are simulated independently of the library?

python benchmarks/challenge --classes clean --nuisance sign,dahl --cases 4 --seed 1000 --out hidden
"""

import argparse
import sys
from pathlib import Path

sys.path[0] = str(Path(__file__).parents[1])  # for this process and its workers

from challenge.cases import run_challenge  # noqa: E402
from sdp_vs_penalty.parallel import Workers  # noqa: E402


def main() -> None:
    parser = argparse.ArgumentParser(prog="benchmarks/challenge", description=__doc__)
    parser.add_argument("--cases", type=int, default=20, help="of each class; clean: of each nuisance")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=Path("results"), help="folder for challenge.*")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--classes", type=lambda text: text.split(","), help="a,b; default: all")
    parser.add_argument("--nuisance", type=lambda text: text.split(","), help="a,b; default: all")
    told = parser.parse_args()
    chosen = Workers(told.jobs), told.classes, told.nuisance, lambda x: print(x, end="\r")
    print(*run_challenge(told.cases, told.seed, told.out, *chosen), sep="\n")


if __name__ == "__main__":
    main()
