"""Starts the process that runs solvers (:mod:`process_runner`), watched from before it imports them."""

from __future__ import annotations

import sys
import threading

from sdp_vs_penalty.parallel import end_with_asker

if __name__ == "__main__":
    threading.Thread(target=end_with_asker, args=(sys.stdin.fileno(),), daemon=True).start()
    from sdp_vs_penalty.shootout.process_runner import main

    main()
