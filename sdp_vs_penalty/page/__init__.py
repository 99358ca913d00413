"""The workbench: a local page in a browser.

    browser  <->  server.py (one process)  <->  worker.py (a process a job at a time, killed to cancel)

A :class:`~sdp_vs_penalty.page.session.Session` is what one tab has chosen, read and
identified; its runs and models are files in a private folder.
:mod:`~sdp_vs_penalty.page.jobs` does the work with the same functions as the command
line; :mod:`~sdp_vs_penalty.page.view` shows it.
"""

from sdp_vs_penalty.plugins import lazy_exports

__getattr__ = lazy_exports(
    __name__,
    auth_middleware="guarded",
    charts="data_chart",
    jobs="JobRequest summary",
    session="Session",
    sessions="Sessions",
    view="View",
    workbench="Workbench",
    worker="JobProcess WorkerPool",
)
