"""The verb simulate: runs with a hidden effect."""

from __future__ import annotations

import json
import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from sdp_vs_penalty.cli.options import Debug, Seed
from sdp_vs_penalty.errors import InputError

if TYPE_CHECKING:
    pass


def verb(
    problem: Annotated[str, typer.Argument(help="A built-in name, a folder, or a URDF file.")],
    hide: Annotated[
        list[str],
        typer.Option("--hide", metavar="EFFECT[:joints]", help="The effect to hide; repeatable."),
    ],
    out: Annotated[
        Path, typer.Option(metavar="DIR", help="Folder for run1..3.csv, test.csv, truth.json.")
    ],
    level: Annotated[
        str, typer.Option(help="strong, medium, weak, or the RMS over the raw noise.")
    ] = "strong",
    seed: Seed = 0,
    debug: Debug = False,
) -> None:
    """Simulate runs in which an effect is hidden; truth.json says which.

    Example: sdp-vs-penalty simulate panda --hide stribeck_friction:3 --seed 7 --out DIR
    """
    from sdp_vs_penalty.cli import console
    from sdp_vs_penalty.data.files import save
    from sdp_vs_penalty.effects import parse_effects
    from sdp_vs_penalty.files import write_text
    from sdp_vs_penalty.problem.load import load_problem
    from sdp_vs_penalty.simulation.hidden_effects import LEVELS
    from sdp_vs_penalty.simulation.hidden_runs import hidden_runs

    robot = load_problem(problem)
    size: str | float = level
    if level not in LEVELS:
        try:
            size = float(level)
        except ValueError:
            size = -1.0
        if not 0.0 < float(size) < 1e6:
            raise InputError(f"--level {level!r}: strong, medium, weak or a positive number is needed.")
    names = ("run1.csv", "run2.csv", "run3.csv", "test.csv")
    if not (out / "truth.json").exists():  # else the folder is one that this verb wrote
        for name in names:
            if (out / name).exists():
                raise InputError(f"--out {out}: {name} is there already: name another folder.")
    effects = []
    for effect in parse_effects(hide, robot.robot):
        effects.append((effect.name, list(effect.asked_joints or ())))
    made = hidden_runs(robot, effects, size, seed, must_show=True)
    for name, run in zip(names, made.runs, strict=True):
        save(run, out / name)
    write_text(out / "truth.json", json.dumps(made.truth, indent=1) + "\n")
    console.out.print(f"written: {out}/run1.csv run2.csv run3.csv test.csv truth.json", markup=False)
    words = ["sdp-vs-penalty", "identify", problem, "--data", *(str(out / name) for name in names[:3])]
    words += ["--effects", ",".join(made.truth["model_effects"]), "--out", "model.json"]
    console.out.print(f"next: {shlex.join(words)}", markup=False, soft_wrap=True)
