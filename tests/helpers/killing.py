"""Commands that are killed, and what becomes of their processes and files.

A command is forked from a process that has loaded its libraries, so that a kill meets
its work. This process adopts what a killed command leaves: no descendant can hide.
"""

import ctypes
import os
import signal
import sys
import time
from contextlib import contextmanager, suppress

import psutil

#: A kill, a polite one, and Ctrl-C.
SIGNALS = (signal.SIGKILL, signal.SIGTERM, signal.SIGINT)
#: Seconds after which no process of a killed command may live.
PATIENCE = 5.0
_SET_CHILD_SUBREAPER = 36


@contextmanager
def adopting_orphans():
    """While this runs, processes whose parent has ended become children of this one."""
    kernel = ctypes.CDLL(None)
    kernel.prctl(_SET_CHILD_SUBREAPER, 1, 0, 0, 0)
    try:
        yield
    finally:
        kernel.prctl(_SET_CHILD_SUBREAPER, 0, 0, 0, 0)


def fork_command(action, folder):
    """Start a silent process that acts in the folder; its number."""
    code = 130
    child = os.fork()
    if child:
        return child
    try:
        code = _exit_code(action, folder)
    finally:
        os._exit(code)


def _exit_code(action, folder):
    """Act in this process, which is to end then."""
    code = 1
    try:
        os.setsid()
        os.chdir(folder)
        temporary = folder / "tmp"
        temporary.mkdir(exist_ok=True)
        os.environ["TMPDIR"] = str(temporary)
        _be_silent(folder / "printed")
        action()
        code = 0
    except SystemExit as end:
        code = int(end.code or 0)
    except Exception as error:
        print(repr(error), file=sys.stderr)
    with suppress(OSError, ValueError):
        sys.stderr.flush()
    return code


def _be_silent(printed):
    """Send what this process prints to a file."""
    handle = os.open(printed, os.O_CREAT | os.O_WRONLY | os.O_TRUNC, 0o600)
    for stream in (1, 2):
        os.dup2(handle, stream)
    sys.stdout = open(1, "w", encoding="utf-8", closefd=False)  # noqa: SIM115
    sys.stderr = open(2, "w", encoding="utf-8", closefd=False)  # noqa: SIM115


def wait_for(process, seconds):
    """The exit code of a child, negative for a signal; TimeoutError after so long."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        number, status = os.waitpid(process, os.WNOHANG)
        if number:
            return os.waitstatus_to_exitcode(status)
        time.sleep(0.002)
    raise TimeoutError(f"process {process} still runs after {seconds:g} s")


def run_to_end(action, folder):
    """Exit code and seconds of an action that nobody kills."""
    begin = time.monotonic()
    code = wait_for(fork_command(action, folder), 300.0)
    return code, time.monotonic() - begin


def kill_after(action, folder, seconds, number):
    """Exit code of an action that gets a signal after some seconds."""
    process = fork_command(action, folder)
    time.sleep(seconds)
    with suppress(ProcessLookupError):
        os.kill(process, number)
    return wait_for(process, PATIENCE)


def survivors(known):
    """Commands of the descendants that still live after the patience, but for those
    known before."""
    end = time.monotonic() + PATIENCE
    while (living := _living(known)) and time.monotonic() < end:
        time.sleep(0.02)
    return living


def descendants():
    """Numbers of all processes that come from this one."""
    return {process.pid for process in psutil.Process().children(recursive=True)}


def _living(known):
    living = []
    for process in psutil.Process().children(recursive=True):
        if process.pid in known:
            continue
        with suppress(psutil.Error):
            if process.status() != psutil.STATUS_ZOMBIE:
                living.append(" ".join(process.cmdline()))
                continue
        with suppress(ChildProcessError):
            os.waitpid(process.pid, os.WNOHANG)
    return living
