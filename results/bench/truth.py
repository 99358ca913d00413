"""What is true of a log, and how a generator writes it beside the log."""

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

#: Words that name the same torque, by whatever program and in whatever world.
SAME = (
    "delay|filter|late|early",
    "gain|unit|current",
    "gravity|tilt|mount",
    "zero|offset",
    "load|force|wrench|change within the run|disturbance|event",
    "friction",
    "drift|step|warm|constant torque",
    "order|swap|coupl|motor",
    "limit|clip|satur|magnitude",
)


def with_words_alike(names: Sequence[str]) -> str:
    """Return a pattern of some names, and of all words for the same torque."""
    alike = [x for x in SAME if any(re.search(x, name) for name in names)]
    return "|".join([*names, *alike]) or "^$"


@dataclass(frozen=True)
class Truth:
    """What is right to say of a log."""

    #: A pattern (regular expression) of what names the cause; empty: there is none.
    right: str
    #: Joints (from 1) that a right claim names, if it names any.
    joints: tuple[int, ...] = ()
    #: Whether silence is right too.
    silent: bool = False
    #: Whether a refusal is right.
    refuses: bool = False
    #: A pattern of what is true besides, such as "^diagnose: .*". A constant of the
    #: model that is estimated again is no claim about the log.
    besides: str = "^diagnose: re-estimate"


def write_log(
    folder: Path,
    robot: str,
    runs: Sequence[Mapping[str, NDArray[np.float64]]],
    truth: Truth,
    story: str,
) -> None:
    """Write robot.urdf (or the name of a problem), run1.csv ..., fresh.csv (the last
    run) and truth.json, which is written last.
    """
    folder.mkdir(parents=True, exist_ok=True)
    if robot.lstrip().startswith("<"):
        (folder / "robot.urdf").write_text(robot, encoding="utf-8")
        robot = "robot.urdf"
    names = [f"run{k}.csv" for k in range(1, len(runs))] + ["fresh.csv"]
    for name, columns in zip(names, runs, strict=True):
        head = ",".join(columns)
        rows = np.column_stack(list(columns.values()))
        np.savetxt(folder / name, rows, "%.10g", ",", header=head, comments="")
    about = {"story": story, "robot": robot, **asdict(truth)}
    (folder / "truth.json").write_text(json.dumps(about, indent=1), encoding="utf-8")
