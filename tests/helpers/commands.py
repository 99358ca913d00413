"""Commands, run in this process or in one of their own."""

import os
import re
import subprocess
import sys
from contextlib import contextmanager, suppress
from pathlib import Path

import pytest

import sdp_vs_penalty
from sdp_vs_penalty.cli.main import main

PROGRAM = ("-m", "sdp_vs_penalty")
#: Whatever copy these tests have imported, also from another folder.
HOME = str(Path(sdp_vs_penalty.__file__).parents[1])


def run_cli(*words):
    """The exit code of a command."""
    with pytest.raises(SystemExit) as code:
        main([str(word) for word in words])
    return int(code.value.code or 0)


def python(*words, path=HOME, **options):
    """Another Python, with the package that lies on this path."""
    environment = {**os.environ, "PYTHONPATH": path}
    command = [sys.executable, *map(str, words)]
    return subprocess.run(
        command, env=environment, capture_output=True, text=True, timeout=300, **options
    )


@contextmanager
def peak_memory():
    """A list that holds the peak in bytes, beyond what was taken before, once the block
    has ended."""
    out = []
    with suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5")  # forgets the peak so far
    before = _status("VmRSS")
    yield out
    out.append(_status("VmHWM") - before)


def _status(field):
    try:
        found = re.search(
            rf"{field}:\s+(\d+) kB", Path("/proc/self/status").read_text()
        )
    except OSError:
        return 0.0
    return 1024.0 * int(found[1]) if found else 0.0
