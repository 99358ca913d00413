"""Make this folder again: python results/rules/make.py"""

from pathlib import Path

from sdp_vs_penalty.diagnosis.rules import Rules
from sdp_vs_penalty.paper.provenance import make_folder

HERE = Path(__file__).parent
#: A case of each class a seed, and of clean robots one with each of two nuisances.
#: Two samples: one of 26 November, one of 27 November.
SEEDS = (*range(690001, 690012), *range(690101, 690111))
#: Worlds made for a rule: how many, and the seed of the first.
TARGETS = ["--targets", "15", "--seed", "695000"]
NUISANCES = [
    "plain",
    "sign",
    "tanh_0.002",
    "widths",
    "asymmetric",
    "warming",
    "dahl",
    "lugre",
    "smoothed",
    "causal",
    "delay",
    "geometry",
    "encoder",
    "rate",
    "noise",
    "points",
    "servo",
    "rotor",
    "aperiodic",
    "one_run",
    "short",
    "mixed",
]
HIDING = [
    "strong",
    "medium",
    "weak",
    "pairs",
    "triples",
    "one_run",
    "payload",
    "unknown",
    "disturbance",
    "unknown_medium",
]


def commands(seed: int) -> list[list[str]]:
    """What is run for a seed."""
    start = ["results/challenge", "--jobs", "1", "--cases", "1", "--seed", str(seed)]
    without = ["--out", "results/rules", "--without", *Rules.names()]
    first = NUISANCES[7 * seed % len(NUISANCES)]
    second = NUISANCES[(7 * seed + 11) % len(NUISANCES)]
    return [
        [*start, "--classes", *HIDING, *without],
        [*start, "--classes", "clean", "--nuisance", first, second, *without],
    ]


if __name__ == "__main__":
    targets = ["results/challenge", *TARGETS, "--out", "results/rules"]
    all_seeds = (command for seed in SEEDS for command in commands(seed))
    make_folder(HERE, *all_seeds, targets)
