"""Loaded first in the process that workers are forked from: it ends with the page's server, however
early that does, and its workers with it (Linux; elsewhere at the end of their pipe)."""

from __future__ import annotations

import contextlib
import ctypes
import os
import signal
import sys
from multiprocessing import parent_process

#: prctl's number for "which signal I get when my parent ends" (linux/prctl.h).
_PR_SET_PDEATHSIG = 1


def end_with_parent() -> None:
    """Killed with the process that has forked this one, however busy this one is.

    Not where a thread of the page has started it: the signal would come when that thread ends.
    """
    server = parent_process()
    if (sys.argv == ["-c"]) if server is None else (os.getppid() != server.pid):
        with contextlib.suppress(OSError, AttributeError):
            ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)


end_with_parent()
