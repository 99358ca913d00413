"""How a folder of results was made: its commands, and a note of the machine, the versions
and the processor time."""

import os
import platform
import resource
import subprocess
import sys
from collections.abc import Sequence
from datetime import UTC, datetime
from importlib import metadata
from pathlib import Path

from sdp_vs_penalty.files import write_text
from sdp_vs_penalty.version import __version__

#: Packages whose versions decide digits.
_PACKAGES = ("numpy", "scipy", "pin", "clarabel", "cvxpy")
#: The note's name in a folder.
NOTE = "machine.txt"


def make_folder(folder: Path, *commands: Sequence[str]) -> None:
    """Run the commands that make a folder of results, and write its note.

    Parameters
    ----------
    folder : Path
        ``results/NAME`` of a checkout.
    *commands : sequence of str
        Arguments of Python each, run in the checkout's root; one that fails ends it
        with its exit code.
    """
    root = folder.parents[1]
    before = _processor_time()
    for arguments in commands:
        done = subprocess.run(
            [sys.executable, *arguments],
            cwd=root,
            check=False,
        )
        if done.returncode != 0:
            raise SystemExit(done.returncode)
    write_note(folder, commands, _processor_time() - before)


def program(*arguments: str) -> list[str]:
    """Arguments of Python that run this program."""
    return ["-m", "sdp_vs_penalty", *arguments]


def write_note(
    folder: Path,
    commands: Sequence[Sequence[str]],
    processor_seconds: float,
) -> None:
    """Write by what a folder was made, and on what.

    Parameters
    ----------
    folder : Path
        Of results.
    commands : sequence of sequence of str
        Arguments of Python each.
    processor_seconds : float
        What they took [s].

    Returns
    -------
    None
        The note is on the disk then.
    """
    lines = [
        *(" ".join(["python", *arguments]) for arguments in commands),
        f"{machine()}; {versions()}",
        f"{datetime.now(UTC):%Y-%m-%d %H:%M} UTC,"
        f" {processor_seconds:.0f} s of processor time",
    ]
    write_text(folder / NOTE, "\n".join(lines) + "\n")


def machine() -> str:
    """The kind of machine; its name is nobody's business."""
    load = os.getloadavg()[0] if hasattr(os, "getloadavg") else 0.0
    return (
        f"{platform.system()} {platform.machine()}, {os.cpu_count()} cores,"
        f" load {load:.1f}"
    )


def versions() -> str:
    """Python, this program and the packages that decide digits."""
    words = [f"Python {platform.python_version()}", f"sdp-vs-penalty {__version__}"]
    for name in _PACKAGES:
        try:
            words.append(f"{name} {metadata.version(name)}")
        except metadata.PackageNotFoundError:
            continue
    return ", ".join(words)


def _processor_time() -> float:
    """Processor time of programs that have ended [s]."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime
