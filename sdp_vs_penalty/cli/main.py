"""The command line. A verb is imported when it is used: --help of the program loads
none of them.

Before a verb runs, the files that it is given are protected, and the files that it is
to write are known to be writable.
"""

import atexit
import errno
import gc
import io
import os
import stat
import sys
import textwrap
import traceback
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from importlib import import_module
from pathlib import Path
from typing import Any, TextIO

from sdp_vs_penalty import formatting
from sdp_vs_penalty.cli.options import Parser
from sdp_vs_penalty.errors import (
    InputError,
    Remark,
    RepairableError,
    Terminated,
    printable,
    require_known,
)
from sdp_vs_penalty.files import opened, protecting, require_writable
from sdp_vs_penalty.version import __version__

#: Every file of verbs/, by what it is for, with the first sentence of its docstring.
VERBS = {
    "Start here": {
        "demo": (
            "Show the main job on a simulated 7-joint arm in which one effect is "
            "hidden."
        )
    },
    "Measurements": {
        "fetch": (
            "Download public measurements and write them as RUN.csv files; prints "
            "their paths."
        ),
        "convert": (
            "Convert measurements of another program: MATLAB, Parquet, ROS 2 bags and "
            "MCAP (JointState)."
        ),
        "check": (
            "Check measurements before identification: units, signs, order, gravity, "
            "clock, noise, excitation."
        ),
        "excite": (
            "Design an exciting trajectory within the robot's limits, the run that "
            "tells two effects apart, the one that weighs a load, or the one that "
            "shortens a parameter's range."
        ),
        "simulate": (
            "Simulate runs in which an effect is hidden, or run a model forward along "
            "measured runs."
        ),
    },
    "Models": {
        "identify": "Identify a robot's dynamic parameters from measured runs.",
        "compare": (
            "Compare models with runs: each joint's error beside the noise, and where "
            "the last model fails."
        ),
        "cross-validate": (
            "Judge a method on unseen motion: each fold leaves out a stretch and all "
            "its repetitions."
        ),
        "diagnose": "Name the physical effects that a model is missing.",
        "add": "Add effects to a model and identify it again, under all constraints.",
        "ranges": (
            "Show between which values masses and other parameters can lie at all, "
            "whatever the prior."
        ),
        "report": (
            "Write one self-contained HTML file: torques, errors, simulation, "
            "parameters, certificate, check."
        ),
        "verify": (
            "Check proofs of optimality in exact arithmetic, independently of every "
            "solver."
        ),
        "export": (
            "Export a model to a simulator or a controller; an impossible or "
            "implausible inertial is refused."
        ),
        "check-urdf": (
            "Check the inertials of a robot's file: which are impossible, which typing"
            " mistake explains each."
        ),
        "page": (
            "Open the workbench: a local page to identify, diagnose, add effects and "
            "export the model."
        ),
        "list": (
            "List the names that the other verbs take, or say all about one of them."
        ),
        "completion": (
            "Print the script that completes commands, options and file names in your "
            "shell."
        ),
    },
    "Research": {
        "tables": "Regenerate the paper's comparison tables.",
        "figures": (
            "Regenerate the paper's figures as PNG and PDF, from simulated and, if "
            "available, measured data."
        ),
        "shootout": (
            "Run SDP solvers on identification problems and judge each answer by a "
            "proved interval."
        ),
        "export-sdp": (
            "Write the SDP that `identify` solves as a file for another solver, and "
            "FILE.json beside it."
        ),
    },
}


_ABOUT = """Identify a robot's dynamics: the LMI-SDP and penalty-based retrieval, each with
a certificate."""

#: Bytes of address space that the libraries take before any data: with 800 MiB each
#: verb ends on a run of 8 s of a two-link arm, or says that memory is short; with less,
#: Arrow and OpenBLAS wait for it without an end.
LEAST_MEMORY = 800 * 2**20
#: Parameters that name what a verb writes.
OUTPUTS = frozenset({"out", "json_", "fix", "proof", "project"})


def _paths(value: Any) -> Iterable[Path]:
    """Return the paths in a parameter's value, and texts that may be one.

    A problem, for example, is a built-in name or a file.
    """
    if isinstance(value, Path):
        return [value]
    if isinstance(value, str):
        can_be_path = 0 < len(value) < 4096 and "\0" not in value
        return [Path(value)] if can_be_path else []
    if isinstance(value, list | tuple):
        return [path for item in value for path in _paths(item)]
    return []


def _require_memory() -> None:
    """Raise InputError if a limit (``ulimit -v``) leaves less memory than libraries
    need.

    Without this, OpenBLAS ends the process with a message of its own.
    """
    try:
        import resource
    except ImportError:  # a system without such limits
        return
    limit = resource.getrlimit(resource.RLIMIT_AS)[0]
    if limit < 0:  # no limit
        return
    if limit >= LEAST_MEMORY:
        _take_memory_of_libraries()
        return
    what = f"this process may take {limit // 2**20} MiB of memory"
    raise InputError(
        f"{what}, and needs {LEAST_MEMORY // 2**20}", "raise the limit (ulimit -v)"
    )


def _take_memory_of_libraries() -> None:
    """Make OpenBLAS, of NumPy and of SciPy, take its buffers while there is room within
    a limit: at its first product it asks for them without an end where it does not get
    them.
    """
    import numpy as np
    import scipy.linalg

    one = np.eye(8)
    np.linalg.solve(one @ one, one)
    scipy.linalg.lstsq(one, one)


def _help() -> str:
    """Return the program's help text, without importing any verb."""
    lines = ["Usage: sdp-vs-penalty [--version] [--debug] COMMAND ...", "", _ABOUT, ""]
    lines += ["--debug shows the traceback of an error, of any verb.", ""]
    for purpose, verbs in VERBS.items():
        lines.append(f"{purpose}:")
        for name, summary in verbs.items():
            line = f"{name:15} {summary}"
            lines.append(
                textwrap.fill(line, 80, initial_indent="  ", subsequent_indent=18 * " ")
            )
    return "\n".join(lines)


def import_verb(name: str) -> Callable[..., None]:
    """Import and return the verb of this name. Raises InputError if there is none."""
    known_names = [known for verbs in VERBS.values() for known in verbs]
    require_known("command", name, known_names)
    home = import_module(f"sdp_vs_penalty.cli.verbs.{name.replace('-', '_')}")
    return home.verb  # type: ignore[no-any-return]


def _run(words: Sequence[str]) -> None:
    """Run the command that these words are.

    Every path among its parameters that is no output is registered as an input, so that
    it cannot be overwritten.
    """
    first = words[0] if words else "--help"
    if first in ("--help", "--version"):
        print(_help() if first == "--help" else f"sdp-vs-penalty {__version__}")
        return
    _require_memory()
    if sys.flags.optimize > 1:
        raise InputError(
            "python -OO drops the docstrings that options come from", "use -O"
        )
    try:
        os.getcwd()
    except OSError as error:  # the folder was removed
        what = f"the current folder cannot be used ({error.strerror})"
        raise InputError(what, "change to another folder") from error
    verb = import_verb(first)
    parser = Parser(first, verb)
    arguments = parser.parse_words(words[1:])
    _require_different({name: x for name, x in arguments.items() if name in OUTPUTS})
    for name, value in arguments.items():
        if name not in OUTPUTS:
            for path in _paths(value):
                opened(path)
    _require_writable(parser, arguments)
    is_quiet = arguments.pop("quiet")
    plugins = arguments.pop("plugin")
    if plugins:
        from sdp_vs_penalty.api.registration import register_file

        for file in plugins:
            register_file(file)
    has_own_json = "json_" in parser.options
    json_file = None if has_own_json else arguments.pop("json_")
    try:
        with (
            formatting.naming_plugins(plugins),
            _ending_politely(),
            _transcribed(words, is_quiet, json_file),
        ):
            verb(**arguments)
    except RepairableError as error:
        raise _naming_the_repair(error, arguments) from error


@contextmanager
def _transcribed(
    words: Sequence[str], is_quiet: bool, json_file: Path | None
) -> Iterator[None]:
    """Record what the command prints while this runs.

    At the end it is written as JSON, with the exit code, if ``json_file`` is given.
    With ``is_quiet`` nothing is printed but remarks and errors.
    """
    from sdp_vs_penalty.cli import console

    with console.listening(is_quiet) as transcript:
        code: Any = 0
        try:
            yield
        except SystemExit as ending:
            code = ending.code
            raise
        finally:
            ended = sys.exc_info()[0]
            if ended is None or ended is SystemExit:
                command = ["sdp-vs-penalty", *words]
                content = {"command": command, "exit_code": code, **vars(transcript)}
                console.save_json(json_file, content)


def _naming_the_repair(
    error: RepairableError, arguments: Mapping[str, Any]
) -> InputError:
    """Add the `check --fix` command to an error of runs that it can repair.

    arguments : the verb's parameters. Without a problem and data among them the error
    stays as it is.
    """
    problem = arguments.get("problem")
    data = arguments.get("data")
    if not problem or not data:
        return error
    from sdp_vs_penalty.problem.check_command import CheckCommand

    command = CheckCommand(
        problem=problem,
        runs=data,
        hold=arguments.get("hold"),
        gravity=arguments.get("gravity"),
        apply=error.apply,
    )
    words = command.repair_words if error.is_known else command.words
    effect = "writes a repaired copy" if error.is_known else "says which it is"
    printed = formatting.command(*words)
    remedy = f"{error.remedy}; `{printed}` {effect}"
    return InputError(error.what, remedy, error.where)


def _require_different(outputs: Mapping[str, Any]) -> None:
    """Raise InputError if two outputs of a command are the same file.

    Links are followed, since the second output would replace the first.
    """
    option_by_file: dict[object, str] = {}
    for name, value in outputs.items():
        for path in _paths(value):
            option = f"--{name.strip('_')}"
            keys = [str(path)]
            # A file that does not exist yet, or a name that no file can have.
            with suppress(OSError, ValueError):
                keys.append(os.path.realpath(path))
                state = path.stat()
                if stat.S_ISREG(state.st_mode):
                    keys.append(f"inode {state.st_dev} {state.st_ino}")
            for key in keys:
                if option_by_file.setdefault(key, option) != option:
                    raise InputError(
                        f"{option_by_file[key]} and {option} name the same file",
                        "name another one; nothing was written",
                        path,
                    )


def _require_writable(parser: Parser, arguments: Mapping[str, Any]) -> None:
    """Raise InputError if an output of a command cannot be written, before the work.

    An output may be an existing folder where the help of its option says "folder".
    """
    for name in OUTPUTS & set(arguments):
        option = parser.options.get(name)  # None for the --json of every verb
        may_be_folder = option is not None and "folder" in str(option.help).lower()
        for path in _paths(arguments[name]):
            require_writable(path, may_be_folder)


def _complain(message: object) -> None:
    """Print a message on stderr after the program's name."""
    print(f"sdp-vs-penalty: {printable(message)}", file=sys.stderr)


class _Pipe(io.FileIO):
    """A standard stream: once its reader has closed it, what is printed goes nowhere.

    The command goes on, and writes its files: `diagnose ... --json f.json | head -1`.
    """

    def write(self, text: Any, /) -> int:
        """Write bytes; return how many."""
        try:
            return super().write(text)
        except BrokenPipeError:
            return memoryview(text).nbytes


def _for_any_reader(stream: TextIO) -> TextIO:
    """Return a standard stream that escapes what the locale cannot write, and outlives
    its reader.

    A stream that is no file of the system is returned as it is.
    """
    if not isinstance(stream, io.TextIOWrapper):
        return stream
    stream.reconfigure(errors="backslashreplace")
    is_buffered = isinstance(stream.buffer, io.BufferedWriter)
    if type(stream.buffer.raw if is_buffered else stream.buffer) is not io.FileIO:
        return stream
    stream.flush()
    pipe = _Pipe(stream.fileno(), "w", closefd=False)
    return io.TextIOWrapper(
        io.BufferedWriter(pipe) if is_buffered else pipe,
        stream.encoding,
        stream.errors,
        line_buffering=stream.line_buffering,
        write_through=stream.write_through,
    )


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line, and exit.

    Exit code 0, 1 for an internal error or a negative verdict, 2 for what the user can
    correct, 130 after Ctrl-C, 143 after SIGTERM.

    Parameters
    ----------
    arguments : sequence of str, optional
        The words after the program's name; by default those of this process.
    """
    words = list(sys.argv[1:] if arguments is None else arguments)
    words_without_debug = [word for word in words if word != "--debug"]
    # Matrices here have a hundred columns: threads of the linear algebra cost more than
    # they bring, and where cores are busy they wait for each other (a check of 0.5 s
    # took 20 s).
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    # Imports make many objects, none of them garbage; nor are those that live to the
    # end, where looking through them took a tenth of the time.
    gc.set_threshold(200_000)
    atexit.register(gc.freeze)
    sys.stdout = _for_any_reader(sys.stdout)
    sys.stderr = _for_any_reader(sys.stderr)

    def remark(message: Any, category: Any, *place: Any, **more: Any) -> None:
        if issubclass(category, Remark):  # without the place in our code
            _complain(message)
            if words_without_debug[:1] != ["convert"]:  # it shows what it writes
                for row in getattr(message, "rows", ()):
                    print(printable(row), file=sys.stderr)
        else:
            _complain(f"{category.__name__}: {message}")

    warnings.showwarning = remark
    code = 0
    try:
        with protecting():
            _run(words_without_debug)
    except (Exception, KeyboardInterrupt) as error:
        if len(words_without_debug) < len(words):
            for line in traceback.format_exc().splitlines():
                print(printable(line), file=sys.stderr)
        message, code = explain(error)
        _complain(message)
    sys.exit(code)


@contextmanager
def _ending_politely() -> Iterator[None]:
    """Make SIGTERM end the command as Ctrl-C does, so that no temporary file is
    left.
    """
    import signal

    process = os.getpid()

    def end(number: int, frame: Any) -> None:
        if os.getpid() != process:  # a worker that has just begun
            os._exit(143)
        raise Terminated

    # A second Ctrl-C, once all is done, would end in words of the interpreter.
    atexit.register(signal.signal, signal.SIGINT, signal.SIG_IGN)
    try:
        before = signal.signal(signal.SIGTERM, end)
    except ValueError:  # in a thread
        yield
        return
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


#: What a full disk, a folder that is not ours and a limit of open files say.
_OF_THE_SYSTEM = (
    errno.ENOSPC,
    errno.EDQUOT,
    errno.EFBIG,
    errno.EACCES,
    errno.EROFS,
    errno.EMFILE,
)


def explain(error: BaseException) -> tuple[str, int]:
    """Return one sentence about an error, and the exit code."""
    if isinstance(error, BrokenPipeError):  # of an output such as /dev/stdout
        return "an output was closed by its reader before all was written.", 1
    if isinstance(error, Terminated):
        return "ended by SIGTERM; existing files are unchanged.", 143
    if isinstance(error, KeyboardInterrupt):
        return "interrupted; existing files are unchanged.", 130
    if isinstance(error, InputError):
        return str(error), 2
    # Libraries report a lack of memory in words of their own.
    is_memory = isinstance(error, MemoryError) or "failed to map segment" in str(error)
    if is_memory:
        return "not enough memory: use fewer or shorter runs.", 2
    if isinstance(error, OSError) and error.errno in _OF_THE_SYSTEM:
        # Perhaps a library's temporary file.
        where = error.filename or "the system"
        return f"{where}: {error.strerror}: free some, or set TMPDIR.", 2
    what = f"{type(error).__name__}: {error}"
    return f"internal error ({what}): run again with --debug and report it.", 1
