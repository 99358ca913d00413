"""How a folder of results was made: its commands, and a note of the machine, the versions,
the commit and the processor time."""

import os
import platform
import resource
import subprocess
import sys
from collections.abc import Sequence
from contextlib import suppress
from datetime import UTC, datetime
from importlib import metadata
from pathlib import Path

from sdp_vs_penalty.files import write_text
from sdp_vs_penalty.version import __version__

#: Packages whose versions decide digits.
_PACKAGES = ("numpy", "scipy", "pin", "clarabel", "cvxpy", "scs")
#: What is timed is timed on one thread.
ONE_THREAD = dict.fromkeys(
    ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1"
)
#: The note's name in a folder.
NOTE = "machine.txt"


def make_folder(
    folder: Path, *commands: Sequence[str], only: Sequence[str] = (), result: str = ""
) -> None:
    """Run the commands that make a folder of results; after each the folder's note says how
    it was made.

    Parameters
    ----------
    *commands : sequence of str
        Arguments of Python for each command, which runs in the checkout's root. If one
        fails, this program exits with its code.
    only : sequence of str
        Words: commands without any of these are not run. None: all run.
    result : str
        File of the folder that a command adds to: each time that it does has a note, and
        what leaves it as it was has none. "": every command makes all of its files.
    """
    file = folder / result
    for arguments in commands:
        if only and not set(only) & set(arguments):
            continue
        begin = _processor_time()
        before = file.read_bytes() if file.is_file() else None
        done = subprocess.run(
            [sys.executable, *arguments],
            cwd=folder.parents[1],
            env=os.environ | ONE_THREAD,
            check=False,
        )
        if done.returncode != 0:
            raise SystemExit(done.returncode)
        if before is None or file.read_bytes() != before:
            # Where a file was added to, what it held keeps its notes: of this command too.
            others = [x for x in commands if x != arguments or before]
            write_note(folder, [arguments], _processor_time() - begin, others)


def program(*arguments: str) -> list[str]:
    """Return the arguments of Python that run this program with these arguments."""
    return ["-m", "sdp_vs_penalty", *arguments]


def write_note(
    folder: Path,
    commands: Sequence[Sequence[str]],
    processor_seconds: float,
    others: Sequence[Sequence[str]] = (),
) -> None:
    """Write a note on how a folder was made: commands, machine, versions, commit, time.

    Parameters
    ----------
    commands : sequence of sequence of str
        Arguments of Python for each command.
    processor_seconds : float
        Processor time that they took [s].
    others : sequence of sequence of str
        Commands that make other files of the folder: what the note says of these is kept.
    """
    path = folder / NOTE
    done = [_as_typed(command) for command in commands]
    still = {_as_typed(command) for command in others}
    held = path.read_text("utf-8").split("\n\n") if path.is_file() else []
    lines = [
        *done,
        f"{machine()}; {versions()}",
        f"{datetime.now(UTC):%Y-%m-%d %H:%M} UTC, {commit(folder)},"
        f" {processor_seconds:.0f} s of processor time",
    ]
    blocks = [block.strip() for block in held if still & set(block.splitlines())]
    write_text(path, "\n\n".join([*blocks, "\n".join(lines)]) + "\n")


def _as_typed(command: Sequence[str]) -> str:
    """Return a command as a line, paths of the checkout without its place."""
    root = f"{Path(__file__).parents[2]}{os.sep}"
    return " ".join(["python", *(word.removeprefix(root) for word in command)])


def commit(folder: Path) -> str:
    """Name the commit of the checkout that holds a folder, and say if files of it have
    changed since."""
    words = ("git", "describe", "--always", "--dirty= with changes", "--exclude=*")
    done = subprocess.run(
        words, cwd=folder, capture_output=True, text=True, check=False
    )
    return f"commit {done.stdout.strip() or 'unknown'}"


def machine() -> str:
    """Describe the machine without naming it: system, processor, cores and load."""
    load = os.getloadavg()[0] if hasattr(os, "getloadavg") else 0.0
    return (
        f"{platform.system()} {platform.machine()}{_processor_model()},"
        f" {os.cpu_count()} cores, load {load:.1f}"
    )


def _processor_model() -> str:
    """Return the processor's model in brackets, "" where the system does not tell it."""
    with suppress(OSError):
        for line in Path("/proc/cpuinfo").read_text("utf-8").splitlines():
            name, _, value = line.partition(":")
            if name.strip() == "model name":
                return f" ({' '.join(value.split())})"
    return ""


def versions() -> str:
    """Return the versions of Python, this program, and the packages that decide
    digits.
    """
    words = [f"Python {platform.python_version()}", f"sdp-vs-penalty {__version__}"]
    for name in _PACKAGES:
        try:
            words.append(f"{name} {metadata.version(name)}")
        except metadata.PackageNotFoundError:
            continue
    return ", ".join(words)


def _processor_time() -> float:
    """Return the processor time of child processes that have ended [s]."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime
