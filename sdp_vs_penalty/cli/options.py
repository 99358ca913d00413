"""Options of the verbs, a line each: of one verb at the end of its docstring, of several in SHARED; and
words of the command line to plain values."""

from __future__ import annotations

import inspect
import json
import re
from collections.abc import Callable
from enum import StrEnum
from functools import wraps
from pathlib import Path
from typing import Annotated, Any, get_args, get_origin, get_type_hints

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
--instruments command|none: Instruments against noise of positions: the command (without torque the
    motion simulated from it), or none. Default: command where no torque was logged.
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


_NUMBERS: dict[type, str] = {int: "a whole number", float: "a number"}
_PLAIN = (str, Path, *_NUMBERS)


class Plain:
    """What converts one parameter that Typer describes, without the validation library that Typer would
    load: its import takes a tenth of a second, even for options that are not given. Texts, numbers and
    paths need none of it; for all else Typer's own way is taken."""

    def __init__(self, described: Any) -> None:
        self.described, kind = described, described.annotation
        self.several = get_origin(kind) is list
        self.kind = get_args(kind)[0] if self.several else kind

    def coerce(self, value: Any, param: Any, ctx: Any) -> Any:
        """The value of a parameter from its words; raises typer.BadParameter."""
        if value is None:
            return () if param.multiple or param.nargs == -1 else None
        if self.kind not in _PLAIN:
            from typer._coercion import build_runtime_param

            return build_runtime_param(self.described).coerce(value, param=param, ctx=ctx)
        try:
            made = [self.kind(x) for x in value] if self.several else self.kind(value)
        except ValueError:
            raise typer.BadParameter(f"{_NUMBERS[self.kind]} is needed", ctx=ctx, param=param) from None
        low, high = self.described.parameter_info.min, self.described.parameter_info.max
        if low is not None and not made >= low:
            raise typer.BadParameter(f"it must be at least {low:g}", ctx=ctx, param=param)
        if high is not None and not made <= high:
            raise typer.BadParameter(f"it must be at most {high:g}", ctx=ctx, param=param)
        return made


def lightened(param: Any) -> Any:
    """The parameter of a command, converted so where this Typer lets it be."""
    described = getattr(param, "type_descriptor", None)
    if described is None or getattr(param, "_runtime_param", described) is not None:
        return param
    if described.parameter_info.parser is None and not described.is_file:
        param._runtime_param = Plain(described)
    return param
