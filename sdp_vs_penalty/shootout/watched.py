"""Starts the process that runs solvers (:mod:`process_runner`) and ends it with whoever asks it.

A file of its own, so that the watch begins before NumPy and the solvers are imported.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import select
import signal
import sys
import threading
from typing import Any


def end_with_asker(handle: int) -> None:
    """End this process and its children, whatever they do, when nobody writes to the pipe any more."""
    asker = select.poll()
    asker.register(handle, 0)  # a hang-up alone: requests are read elsewhere
    asker.poll()
    for child in multiprocessing.active_children():
        kill(child)
    os._exit(0)


def kill(child: Any) -> None:
    """End a child with whatever it has started."""
    with contextlib.suppress(ProcessLookupError, PermissionError):
        os.killpg(child.pid, signal.SIGKILL)
    child.kill()


if __name__ == "__main__":
    threading.Thread(target=end_with_asker, args=(sys.stdin.fileno(),), daemon=True).start()
    from sdp_vs_penalty.shootout.process_runner import main

    main()
