"""The command line. A verb is imported when it is used: --help of the program loads none of them.

The files that a verb is given are protected before it runs.
"""

from __future__ import annotations

import errno
import gc
import inspect
import os
import sys
import traceback
import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from importlib import import_module
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperCommand, TyperGroup

from sdp_vs_penalty.cli.options import declared, lightened
from sdp_vs_penalty.errors import InputError, Remark
from sdp_vs_penalty.files import protecting
from sdp_vs_penalty.files.inputs import opened
from sdp_vs_penalty.version import __version__

#: Every file of verbs/ with the line that the program's --help shows, by what it is for.
VERBS = {
    "First": {"demo": "The main job in small: a simulated arm, from its log to a better model."},
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
        "shootout": "Run SDP solvers and judge their answers by proved bounds.",
        "export-sdp": "Write the identification SDP for another solver.",
    },
}


#: Bytes of address space that the libraries take before any data: a check of 1 s of a two-link arm ends
#: with 420 MiB, not with 400.
LEAST_MEMORY = 512 * 2**20
#: Parameters that name what a verb writes.
OUTPUTS = frozenset({"out", "json_", "fix", "proof"})


class VerbCommand(TyperCommand):
    """Every path among the parsed parameters that is not an output is an input."""

    def get_params(self, ctx: Any) -> Any:
        """The parameters, plain values of which need no pydantic."""
        return list(map(lightened, super().get_params(ctx)))

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
        _require_memory()
        if sys.flags.optimize > 1:
            raise InputError("python -OO drops the docstrings that options come from", "use -O")
        verb = import_module(f"sdp_vs_penalty.cli.verbs.{name.replace('-', '_')}").verb
        text, _, rest = inspect.cleandoc(verb.__doc__).partition("Example: ")
        example = rest.partition("\n")[0]
        app = typer.Typer(add_completion=False, pretty_exceptions_enable=False, rich_markup_mode=None)
        # \b keeps the line as it is: an example is there to be copied.
        app.command(name, cls=VerbCommand, help=text, epilog=f"\b\nExample:\n  {example}")(
            declared(verb)
        )
        return typer.main.get_command(app)

    def __iter__(self) -> Iterator[str]:
        return (name for verbs in VERBS.values() for name in verbs)

    def __len__(self) -> int:
        return sum(map(len, VERBS.values()))


def _require_memory() -> None:
    """InputError where a limit (``ulimit -v``) leaves less than the libraries need: OpenBLAS ends the
    process in words of its own where it finds no room."""
    try:
        import resource
    except ImportError:  # a system without such limits
        return
    limit = resource.getrlimit(resource.RLIMIT_AS)[0]
    if 0 <= limit < LEAST_MEMORY:  # no limit is negative
        raise InputError(
            f"this process may take {limit // 2**20} MiB of memory, and needs {LEAST_MEMORY // 2**20}",
            "raise the limit (ulimit -v)",
        )


class VerbGroup(TyperGroup):
    """The program as a group of verbs that are imported one by one."""

    def __init__(self, **settings: Any) -> None:
        super().__init__(**settings)
        self.commands: Any = _Lazy()

    def get_params(self, ctx: Any) -> Any:
        """Its own options, likewise."""
        return list(map(lightened, super().get_params(ctx)))

    def list_commands(self, ctx: Any) -> list[str]:
        """The names, in the order of the help."""
        return list(self.commands)

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """The table above, without importing a verb."""
        for purpose, verbs in VERBS.items():
            with formatter.section(f"Commands: {purpose.lower()}"):
                formatter.write_dl(list(verbs.items()))


app = typer.Typer(
    name="sdp-vs-penalty",
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,  # plain text: formatting it takes longer than everything else
    cls=VerbGroup,
)


def _show_version(asked: bool) -> None:
    if asked:
        print(f"sdp-vs-penalty {__version__}")
        raise typer.Exit


@app.callback(invoke_without_command=True)
def _root(
    context: typer.Context,
    version: Annotated[
        bool, typer.Option("--version", callback=_show_version, is_eager=True, help="Show the version.")
    ] = False,
    debug: Annotated[bool, typer.Option("--debug", help="Traceback of an error, of any verb.")] = False,
) -> None:
    """Identify a robot's dynamics: the LMI-SDP and penalty-based retrieval, each with a certificate."""
    if context.invoked_subcommand is None:
        print(context.get_help())


#: Options that take all words up to the next option: --data run1.csv run2.csv.
_MANY = frozenset({"--data"})


def expand_many(arguments: Sequence[str]) -> list[str]:
    """Repeat an option of several values before each.

    >>> expand_many(["--data", "a", "b", "--out", "c"])
    ['--data', 'a', '--data', 'b', '--out', 'c']
    """
    out: list[str] = []
    many = ""
    for word in arguments:
        if word.startswith("-") and word != "-":
            many = word if word in _MANY else ""
        elif many and out[-1] != many:
            out.append(many)
        out.append(word)
    return out


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line: exit code 0, 2 for what the user can mend, 130 after Ctrl-C."""
    asked = list(sys.argv[1:] if arguments is None else arguments)
    given = [word for word in asked if word != "--debug"]
    # Matrices here have a hundred columns: threads of the linear algebra cost more than they bring,
    # and where cores are busy they wait for each other (a check of 0.5 s took 20 s).
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    # Typer's pydantic would look through all that is installed for plug-ins.
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")
    gc.set_threshold(20_000)  # imports make many objects, none of them garbage
    shown = warnings.showwarning

    def remark(message: Any, category: Any, *place: Any, **more: Any) -> None:
        if category is Remark:  # to the user, without the place in our code
            print(f"sdp-vs-penalty: {message}", file=sys.stderr)
        else:
            shown(message, category, *place, **more)

    warnings.showwarning = remark
    try:
        with protecting():
            code = app(expand_many(given), prog_name="sdp-vs-penalty", standalone_mode=False)
        if code == 130:  # what typer makes of Ctrl-C
            raise KeyboardInterrupt
    except BrokenPipeError:
        # Whoever read our output has closed it; the interpreter would complain at exit otherwise.
        sys.stdout = None  # type: ignore[assignment]
        code = 1
    except (Exception, KeyboardInterrupt) as error:
        if len(given) < len(asked):
            traceback.print_exc()
        message, code = explain(error)
        print(f"sdp-vs-penalty: {message}", file=sys.stderr)
    sys.exit(code if isinstance(code, int) else 0)


#: What a full disk, a folder that is not ours and a limit of open files say.
_OF_THE_SYSTEM = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EACCES, errno.EROFS, errno.EMFILE)


def explain(error: BaseException) -> tuple[str, int]:
    """One sentence about an error and the exit code that it deserves."""
    if isinstance(error, KeyboardInterrupt | typer.Abort):
        return "interrupted; existing files are unchanged.", 130
    if isinstance(error, InputError):
        return str(error), 2
    if isinstance(error, MemoryError) or "failed to map segment" in str(error):  # of a library
        return "not enough memory: use fewer or shorter runs.", 2
    if isinstance(error, OSError) and error.errno in _OF_THE_SYSTEM:  # a library's temporary file
        return f"{error.filename or 'the system'}: {error.strerror}: free some, or set TMPDIR.", 2
    if hasattr(error, "format_message") and hasattr(error, "exit_code"):  # typer's usage errors
        context = getattr(error, "ctx", None)
        verb = "sdp-vs-penalty" if context is None else context.command_path
        return f"{_plain(error.format_message())}; see `{verb} --help`.", int(error.exit_code)
    what = f"{type(error).__name__}: {error}"
    return f"internal error ({what}): run again with --debug and report it.", 1


def _plain(message: str) -> str:
    """A usage error without the words of the library that converts the values."""
    message = " ".join(message.split()).rstrip(".?").replace("Value error, ", "")
    return message.replace("Input should be", "it must be")
