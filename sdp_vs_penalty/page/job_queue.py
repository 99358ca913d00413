"""The jobs of a tab: one at a time, those that wait, and one aside."""

import asyncio
import inspect
import json
import time
from collections.abc import Callable, Coroutine, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Self

from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.page.project import ProjectState, TriedRemedy, with_issues
from sdp_vs_penalty.page.spoken import progress_in_words
from sdp_vs_penalty.page.worker import sentence
from sdp_vs_penalty.records import from_json, to_json

#: What is said where a job that something waited for was cancelled, or failed.
_NOT_BEGUN = "What waited for it was not begun."


@dataclass(frozen=True)
class Working:
    """A piece of work, of one or more jobs."""

    #: What is done now.
    title: str = ""
    #: Where it stands.
    status: str = ""
    #: When it began, on the monotonic clock [s].
    since: float = field(default_factory=time.monotonic)

    def hears(self, text: str) -> Self:
        """Return the work as a job says where it stands ("trying effects: 843 of 1503").

        No time left is said: the count of one phase does not know what the others take.
        """
        return replace(self, status=progress_in_words(text))


@dataclass
class JobQueue(ProjectState):
    """A project whose jobs run one at a time, in the processes of a pool."""

    #: Work in progress; None while idle.
    working: Working | None = None
    #: What :meth:`start` was called with for that job.
    running: tuple[Any, ...] = ()
    #: The same of what was asked for while it ran, in order.
    waiting: list[tuple[Any, ...]] = field(default_factory=list)
    #: The project before that job.
    before: dict[str, Any] = field(default_factory=dict)
    #: What tries the remedies beside everything else; None while nothing does.
    aside: asyncio.Task[None] | None = None

    def start(
        self, do: Callable[..., Coroutine[Any, Any, None]], *arguments: Any, **how: Any
    ) -> None:
        """Start one of this session's coroutines as its only task.

        do : the coroutine function; arguments, how : what it is called with. While
        another task is running, the call waits.
        """
        call = do, arguments, how
        if self.task is not None:
            if call not in (self.running, *self.waiting):  # pressed twice: done once
                self.waiting.append(call)
                job = f" after: {self.working.title}" if self.working else ""
                self.say(f"Your press waits for its turn{job}.", error=False)
            return
        if self.aside is not None:
            self.aside.cancel()
        self.notice = None
        self.working = Working()
        self.running = call
        self.before = self._copied("past", "future")
        self.unfinished = {
            "do": getattr(do, "__name__", ""),
            "arguments": arguments,
            "how": how,
        }
        try:
            json.dumps(to_json(self.unfinished))
        except TypeError:  # it is of this tab
            self.unfinished = {}
        self.task = asyncio.get_running_loop().create_task(do(*arguments, **how))
        self.task.add_done_callback(self._ended)

    def cancel(self) -> None:
        """Cancel the running job at once; the session stays as it was before."""
        if self.task is not None:
            self.unfinished = {}
            self.task.cancel()

    def start_again(self) -> None:
        """Start the job again that the end of a server has ended."""
        job, self.unfinished = self.unfinished, {}
        if inspect.iscoroutinefunction(do := getattr(self, str(job.get("do")), None)):
            self.start(do, *job["arguments"], **job["how"])

    def _ended(self, task: asyncio.Task[None]) -> None:
        """Clean up after a task: say how it failed, or do what waits for it; redraw, and
        read files dropped meanwhile.
        """
        self.working = self.task = None
        waiting, self.waiting = self.waiting, []
        dropped = [_NOT_BEGUN] if waiting else []
        if not task.cancelled():
            self.unfinished = {}
        if task.cancelled():
            self.say("Cancelled: nothing was changed.", *dropped, error=False)
        elif (error := task.exception()) is not None:
            if not isinstance(error, InputError):  # a defect, amid what it changes
                for name, value in self.before.items():
                    setattr(self, name, value)
            self.say(sentence(error), *dropped)
        else:
            for do, arguments, how in waiting:
                self.start(do, *arguments, **how)
        self.save()
        self.changed()
        self.idle()

    def idle(self) -> None:
        """Begin what waits until no job runs: files that were dropped, and trials of remedies."""

    def _doing(self, **what: str) -> None:
        """Update the running work, given its new ``title`` or ``status``, and redraw
        the tabs."""
        self.working = replace(self.working or Working(), **what)  # type: ignore[arg-type]
        if self.unfinished and "title" in what:
            self.unfinished["title"] = what["title"]
            self.save()
        self.changed()

    async def _job(self, title: str, job: str, **details: Any) -> dict[str, Any]:
        """Run a function of jobs.py, by its name, in a worker, and return its answer.

        The request holds the session's state and the ``details``.
        """
        self._doing(title=title, status="")
        return await self._run(self._request(job, **details))

    async def _run(self, request: Mapping[str, Any]) -> dict[str, Any]:
        """Run a request in a worker, and show where it stands."""

        def hear(text: str) -> None:
            self.working = (self.working or Working()).hears(text)
            self.changed()

        return await self._answer(request, hear)

    async def _answer(
        self,
        request: Mapping[str, Any],
        progress: Callable[[str], None],
        is_aside: bool = False,
    ) -> dict[str, Any]:
        """Return what a worker answers; issues of its runs, and remedies, are records."""
        answer = await self.pool.run(request, progress, is_aside)
        if "remedies" in answer:  # it has checked the runs
            answer["runs"] = with_issues(answer["runs"])
            answer["remedies"] = from_json(list[TriedRemedy], answer["remedies"])
        return answer

    def _request(self, job: str, **details: Any) -> dict[str, Any]:
        """Return the request for a function of jobs.py: the session's state and the
        ``details``."""
        names = ("robot", "runs", "options")
        return {
            **{name: getattr(self, name) for name in names},
            "job": job,
            "folder": str(self.folder),
            "model": self.model and self.model.file,
            **details,
        }
