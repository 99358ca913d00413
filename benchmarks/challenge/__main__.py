"""How often is the diagnosis right, on robots that are simulated independently of the library?

python benchmarks/challenge --classes clean --nuisance sign,dahl --cases 4 --seed 1000 --out hidden
"""

import argparse
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

sys.path[0] = str(Path(__file__).parents[1])  # for this process and its workers

from challenge.cases import CLASSES, run_challenge, wanted  # noqa: E402
from challenge.worlds.conditions import NUISANCES  # noqa: E402
from sdp_vs_penalty.parallel import Workers  # noqa: E402


def some_of(known: Sequence[str]) -> Callable[[str], list[str]]:
    """Reads a,b: the parser tells the ValueError of a name that is none."""
    return lambda text: [known[known.index(name)] for name in text.split(",")]


def main() -> None:
    parser = argparse.ArgumentParser(prog="benchmarks/challenge", description=__doc__)
    parser.add_argument("--cases", type=int, default=20, help="of each class; clean: of each nuisance")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=Path("results"), help="folder for challenge.*")
    parser.add_argument("--jobs", type=int, default=2)
    for word, known in (("--classes", [*CLASSES]), ("--nuisance", [*NUISANCES])):
        parser.add_argument(word, type=some_of(known), default=known, help="a,b; default: all")
    told = parser.parse_args()
    every = wanted(told.cases, told.seed, told.classes, told.nuisance)
    show = lambda text: print(text, end="\r")  # noqa: E731
    print(*run_challenge(every, told.seed, told.out, Workers(told.jobs), show), sep="\n")


if __name__ == "__main__":
    main()
