"""Options of the verbs, a line each: of one verb at the end of its docstring, of several in SHARED."""

from __future__ import annotations

import inspect
import json
import re
from collections.abc import Callable
from enum import StrEnum
from functools import wraps
from typing import Annotated, Any, get_type_hints

import typer

#: Flags, or an argument's name; limits; an example of a value; then what it is, for --help and the page.
SHARED = """
problem: Built-in name, folder with a problem.toml, or URDF file.
model model.json: Model written by `identify` or `add`.
models model.json ...: Models written by `identify` or `add`.
--data RUN.csv ...: Measured runs: .csv, .npz, .mat, .parquet, .mcap, .bag; a folder or pattern of these.
--test TEST.csv: Run for the held-out error only.
--frozen: Fixed model parameters: the only way to identify a payload.
--window START:STOP: Part of each run to use, in seconds from its start; or A:B,C:D.
--test-window START:STOP: Part of the test run to use, in seconds from its start.
--seed >=0: Random seed.
--gain-uncertainty >=0.0 <=0.999 0.01: Relative standard deviation of the torque channels' gains; widens
    the intervals.
--gravity x,y,z: Gravity in the base frame, in m/s^2.
--json out.json: JSON file for the figures.
--verbose, -v: All tables.
--method: Method, of `sdp-vs-penalty list methods`.
--effects a,b,c: Effects, of `sdp-vs-penalty list effects`; default: the problem's.
--known kp2=600: Known parameters, which set the scale of a log without torque (names: model.json).
--jobs >=1: Number of processes.
--scheduler tcp://HOST:PORT: Dask scheduler; default: this computer.
--no-check: No data check before the work.
--filters 5,8: Filters of states and torque [Hz]; default: chosen.
--bounds m2=1:5,c2x=-0.1:0.1: Bounds of links [kg, m, kg m^2], in place of the problem's; total=:20: of
    all.
--known-load LOAD.csv:KG: Run with a load of this mass on the last link; determines the torque channels'
    gains.
--instruments command|none: Instruments against noise of positions: the command's simulated motion, or
    none. Default: command where no torque was logged.
--out: Folder to write into.
"""


class Budget(StrEnum):
    """How much effort tables and figures may take."""

    quick = "quick"
    paper = "paper"


def declared(verb: Callable[..., None]) -> Callable[..., None]:
    """The verb as typer takes it: parameters typed by its signature, told by its docstring."""
    example = (verb.__doc__ or "").partition("Example: ")[2]
    told = _told(SHARED) | _told(inspect.cleandoc(example.partition("\n")[2]))
    kinds, given = get_type_hints(verb), inspect.signature(verb)

    @wraps(verb)
    def called(**values: Any) -> None:
        verb(**values)

    parameters = [
        p.replace(annotation=Annotated[kinds[name], told[name.rstrip("_")]])
        for name, p in given.parameters.items()
    ]
    called.__signature__ = given.replace(parameters=parameters)  # type: ignore[attr-defined]
    return called


def _told(lines: str) -> dict[str, Any]:
    """By parameter, without the underscore that keeps it apart from a word of Python's."""
    out = {}
    for line in re.sub(r"\n +", " ", lines).strip().splitlines():
        head, _, text = line.partition(": ")
        first, *rest = head.split()
        flags = [w.rstrip(",") for w in (first, *rest) if w.startswith("-") and first.startswith("-")]
        limits = {w[:2]: json.loads(w[2:]) for w in rest if w[:2] in (">=", "<=")}
        words = [w for w in rest if w not in flags and w[:2] not in limits]
        settings: Any = {"metavar": " ".join(words) or None, "help": text}
        settings |= {"min": limits.get(">="), "max": limits.get("<=")}
        name = first.rstrip(",").removeprefix("--").partition("/")[0].replace("-", "_")
        out[name] = typer.Option(*flags, **settings) if flags else typer.Argument(**settings)
    return out
