"""The process that does one job: told by JSON over a pipe, answers by JSON, ends.

It is started before it is needed, with everything loaded (see worker_pool.py), and ends with the server
whatever happens to that.
"""

from __future__ import annotations

import contextlib
import json
import multiprocessing
import os
import threading
import warnings
from multiprocessing.connection import Connection
from typing import Any

from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.page.forked import end_with_parent
from sdp_vs_penalty.page.jobs import JOBS

#: Of the computer's memory, how much all jobs together may use, and what each has at least [bytes].
_SHARE, _LEAST = 0.75, 2**31


def main(connection: Connection) -> None:
    """Do the one job that comes over the pipe."""
    with contextlib.suppress(OSError, AttributeError):  # where there are sessions: none of ours yet
        os.setsid()  # Ctrl-C in the terminal is the server's; a kill reaches what a job starts
    end_with_parent()
    try:
        request = json.loads(connection.recv_bytes())
    except (EOFError, OSError):  # not needed any more
        return
    limit_memory(int(request.get("jobs", 1)))
    multiprocessing.current_process().daemon = False  # so that a job may have processes of its own
    threading.Thread(target=_end_with, args=(connection,), daemon=True).start()
    answer = do(request, lambda text: _send(connection, {"progress": text}))
    _send(connection, answer)


def do(request: dict[str, Any], progress: Any) -> dict[str, Any]:
    """{"result": ...} of a request, or {"error": sentence}."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return {"result": JOBS[request["job"]](request, progress)}
    except InputError as error:
        return {"error": str(error)}
    except MemoryError:
        return {"error": "Not enough memory: use fewer or shorter runs."}
    except Exception as error:
        what = (str(error).splitlines() or [""])[0]
        return {
            "error": f"Internal error ({type(error).__name__}: {what[:200]}): nothing was changed; "
            "try other data or settings, and report it."
        }


def limit_memory(jobs: int) -> None:
    """Let a job, one of so many at once, fail with a sentence before it makes the computer swap."""
    try:
        import resource

        total = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
        limit = max(int(_SHARE * total / jobs), min(_LEAST, int(_SHARE * total)))
        resource.setrlimit(resource.RLIMIT_AS, (limit, resource.RLIM_INFINITY))
    except (ImportError, AttributeError, ValueError, OSError):
        return  # a system without such limits


def _send(connection: Connection, message: dict[str, Any]) -> None:
    connection.send_bytes(json.dumps(message).encode())


def _end_with(connection: Connection) -> None:
    """The server says nothing more: the pipe's end is the server's."""
    with contextlib.suppress(EOFError, OSError):
        connection.recv_bytes()
    os._exit(1)
