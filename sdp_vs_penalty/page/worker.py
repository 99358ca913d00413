"""The process that does jobs: told by lines of JSON, answers by lines of JSON, ends with the server."""

from __future__ import annotations

import contextlib
import json
import os
import queue
import sys
import threading
import warnings
from typing import Any

from sdp_vs_penalty.errors import InputError

#: Of the computer's memory, how much all jobs together may use, and what each has at least [bytes].
_SHARE, _LEAST = 0.75, 2**31


def main() -> None:
    """Do the jobs that come on stdin, one after another. The server's end of it is the server's end."""
    answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)  # what a library prints is no answer
    requests: queue.SimpleQueue[str] = queue.SimpleQueue()
    threading.Thread(target=_listen, args=(requests,), daemon=True).start()

    def send(message: dict[str, Any]) -> None:
        print(json.dumps(message), file=answers, flush=True)

    import sdp_vs_penalty.page.jobs  # noqa: F401  (takes seconds; a request may come meanwhile)

    while True:
        request = json.loads(requests.get())
        limit_memory(int(request.get("at_once", 1)))
        send(do(request, lambda text: send({"progress": text})))


def _listen(requests: queue.SimpleQueue[str]) -> None:
    for line in sys.stdin:
        requests.put(line)
    os._exit(1)


def do(request: dict[str, Any], progress: Any) -> dict[str, Any]:
    """{"result": ...} of a request, or {"error": sentence}."""
    from sdp_vs_penalty.page.jobs import JOBS

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


def limit_memory(at_once: int) -> None:
    """Let a job, one of so many at once, fail with a sentence before it makes the computer swap."""
    with contextlib.suppress(ImportError, AttributeError, ValueError, OSError):  # no such limits here
        import resource

        total = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
        limit = max(int(_SHARE * total / at_once), min(_LEAST, int(_SHARE * total)))
        resource.setrlimit(resource.RLIMIT_AS, (limit, resource.RLIM_INFINITY))
