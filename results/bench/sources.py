"""Logs of the other benches, written beside their truth: corrupted ones, worlds of the
challenge, and real arms.
"""

from collections.abc import Sequence
from functools import cache
from pathlib import Path

import numpy as np
from challenge.cases import Case, build_case
from challenge.worlds.conditions import NUISANCES, fair
from challenge.worlds.runs import urdf_of
from corruptions.arms import DRAWN, Arm, arm, drawn, urdf
from corruptions.bench import given
from numpy.typing import NDArray
from real_arms.real_arms import ARMS, Split

from bench.truth import Truth, with_words_alike, write_log
from sdp_vs_penalty.data.measurements import Measurements, concatenate

#: Which one of so many corruptions of each arm is made.
EVERY = 15
#: What every drawn arm has (`corruptions/arms.py`).
OF_THE_ARM = "^diagnose: (re-estimate|stribeck|asymmetric|rotor|.*ripple)"
#: Worlds with nothing hidden, and with one strong effect.
WORLDS = (("clean", 7), ("strong", 7))


def columns(run: Measurements) -> dict[str, NDArray[np.float64]]:
    """Return the columns of a run's file."""
    named = {"t": run.t}
    blocks = (("q", run.q), ("tau", run.tau), ("dq", run.dq), ("temp", run.temperature))
    for name, block in blocks:
        if block is not None:
            named |= {f"{name}{j + 1}": x for j, x in enumerate(block.T)}
    return named


@cache
def _arm(name: str) -> Arm:
    return arm(name, Path())


def corruption_names(arms: Sequence[str]) -> list[str]:
    """Name the corruptions of simulated arms, such as "small1-31"."""
    return [
        f"{name}-{k}"
        for part, name in enumerate(arms)
        for k in range(part, len(_arm(name).corruptions()), EVERY)
        # What changes the problem and not the log has no file.
        if _arm(name).corruptions()[k].problem(_arm(name).problem) == _arm(name).problem
    ]


def make_corruption(name: str, folder: Path) -> None:
    """Write a corrupted log of a simulated arm, and a clean one to judge with."""
    arm_name, number = name.split("-")
    source = _arm(arm_name)
    corruption = source.corruptions()[int(number)]
    _, spoiled = given(source, corruption)
    word = next(x for x in DRAWN if arm_name.startswith(x))
    axes = drawn(int(arm_name.removeprefix(word)), *DRAWN[word])
    truth = Truth(
        with_words_alike(corruption.causes),
        tuple(j + 1 for j in corruption.joints),
        besides=OF_THE_ARM,
    )
    runs = [*map(columns, spoiled.runs()), columns(source.test)]
    write_log(folder, urdf(arm_name, axes), runs, truth, corruption.name)


def world_names(seed: int) -> list[str]:
    """Name the challenge's cases, such as "clean-delay-1020001-3"."""
    rng = np.random.default_rng(seed)
    return [
        f"{kind}-{rng.choice([*NUISANCES])}-{seed}-{k}"
        for kind, count in WORLDS
        for k in range(count)
    ]


def make_world(name: str, folder: Path) -> None:
    """Write the runs of a challenge's case."""
    kind, nuisance, seed, index = name.split("-")
    built = build_case(Case(kind, nuisance, int(seed), int(index)))
    hidden = [h.effect.replace("_", " ") for h in built.hidden]
    fairly = [x.replace("_", " ") for x in fair(built.conditions)[0]]
    truth = Truth(
        with_words_alike(hidden) if hidden else "",
        tuple(sorted({j + 1 for h in built.hidden for j in h.joints})),
        silent=not hidden,
        besides=f"re-estimate|{with_words_alike(fairly)}",
    )
    runs = [columns(logged.run) for logged in built.logged]
    robot = urdf_of(built.conditions.arm).read_text("utf-8")
    write_log(folder, robot, runs, truth, name)


@cache
def _split(name: str) -> Split:
    return next(iter(ARMS[name]()))


def make_real(name: str, folder: Path) -> None:
    """Write the first split of a real arm: its training part, and unseen motion."""
    split = _split(name)
    runs = [columns(run) for run in split.train.runs()]
    unseen = split.unseen.runs()
    truth = Truth("", silent=True, besides="^diagnose: ")
    whole = concatenate(unseen) if len(unseen) > 1 else unseen[0]
    runs.append(columns(whole))
    write_log(folder, split.problem, runs, truth, split.name)
