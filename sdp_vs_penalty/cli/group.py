"""The verbs by name, each imported when it is used: --help of the program loads none of them.

The files that a verb is given are protected before it runs.
"""

from __future__ import annotations

import inspect
from collections.abc import Iterable, Iterator, Mapping
from importlib import import_module
from pathlib import Path
from typing import Any

import typer
from typer.core import TyperCommand, TyperGroup

from sdp_vs_penalty.files import opened

#: Every file of verbs/ with the line that the program's --help shows, by what it is for.
VERBS = {
    "Measurements": {
        "fetch": "Download public measurements as RUN.csv files.",
        "convert": "Convert MATLAB, Parquet, ROS bags and MCAP files to RUN.csv.",
        "check": "Check runs: units, signs, order, gravity, clock, excitation.",
        "excite": "Design an exciting trajectory within the robot's limits.",
        "simulate": "Simulate runs with a hidden effect, or run a model forward.",
    },
    "Models": {
        "identify": "Identify dynamic parameters from runs, with a certificate.",
        "compare": "Compare models with runs: error and noise of each joint.",
        "cross-validate": "Judge a method on motion that its models have not seen.",
        "diagnose": "Name the physical effects that a model is missing.",
        "add": "Add an effect to a model and identify it again.",
        "report": "Write a self-contained HTML report.",
        "verify": "Check proofs of optimality in exact arithmetic.",
        "export": "Export a model: URDF, MJCF, JSON, NumPy, C header, friction table.",
        "check-urdf": "Check a URDF's inertials for physical consistency.",
        "page": "Open the workbench in a browser.",
        "list": "List problems, effects, methods, solvers, tables and more.",
    },
    "Research": {
        "tables": "Regenerate the paper's tables.",
        "figures": "Regenerate the paper's figures.",
        "challenge": "Score diagnose on simulated runs with hidden effects.",
        "shootout": "Run SDP solvers and judge their answers by proved bounds.",
        "export-sdp": "Write the identification SDP for another solver.",
    },
}


#: Parameters that name what a verb writes.
OUTPUTS = frozenset({"out", "json_file", "fix", "proof"})


class VerbCommand(TyperCommand):
    """Every path among the parsed parameters that is not an output is an input."""

    def invoke(self, ctx: Any) -> Any:
        for name, value in ctx.params.items():
            if name not in OUTPUTS:
                for path in _paths(value):
                    opened(path)
        return super().invoke(ctx)


def _paths(value: Any) -> Iterable[Path]:
    """Paths, and texts that may be one (a problem is a name or a file)."""
    if isinstance(value, Path):
        return [value]
    if isinstance(value, str):
        return [Path(value)] if 0 < len(value) < 4096 and "\0" not in value else []
    return [p for v in value for p in _paths(v)] if isinstance(value, list | tuple) else []


class _Lazy(Mapping[str, Any]):
    """The commands by name; reading one imports its file."""

    def __getitem__(self, name: str) -> Any:
        if name not in list(self):
            raise KeyError(name)
        verb = import_module(f"sdp_vs_penalty.cli.verbs.{name.replace('-', '_')}").verb
        text, _, example = inspect.cleandoc(verb.__doc__).partition("Example: ")
        app = typer.Typer(add_completion=False, pretty_exceptions_enable=False, rich_markup_mode=None)
        # \b keeps the line as it is: an example is there to be copied.
        app.command(name, cls=VerbCommand, help=text, epilog=f"\b\nExample:\n  {example}")(verb)
        return typer.main.get_command(app)

    def __iter__(self) -> Iterator[str]:
        return (name for verbs in VERBS.values() for name in verbs)

    def __len__(self) -> int:
        return sum(map(len, VERBS.values()))


class VerbGroup(TyperGroup):
    """The program as a group of verbs that are imported one by one."""

    def __init__(self, **settings: Any) -> None:
        super().__init__(**settings)
        self.commands: Any = _Lazy()

    def list_commands(self, ctx: Any) -> list[str]:
        """The names, in the order of the help."""
        return list(self.commands)

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """The table above, without importing a verb."""
        for purpose, verbs in VERBS.items():
            with formatter.section(f"Commands: {purpose.lower()}"):
                formatter.write_dl(list(verbs.items()))
