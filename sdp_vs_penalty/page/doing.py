"""How a session does its jobs: one at a time, in a worker, said and cancelled."""

from __future__ import annotations

import asyncio
from collections.abc import Coroutine, Mapping
from dataclasses import dataclass
from typing import Any

from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.page.state import Notice, TabState, Working
from sdp_vs_penalty.page.summary import Rung
from sdp_vs_penalty.page.workshop import Cancelled


@dataclass
class Doing(TabState):
    """A state with one job at a time."""

    _count: int = 0

    def cancel(self) -> None:
        """End the job that is being done, at once; nothing that was there before changes."""
        if self.working is not None:
            self.working.work.cancel()

    @property
    def busy(self) -> bool:
        """Whether a job is being done."""
        return self.task is not None and not self.task.done()

    def _start(
        self, title: str, doing: Coroutine[Any, Any, None], names: Mapping[str, str] | None = None
    ) -> None:
        """Begin a job unless one is being done; names : what to call the paths that it reads."""
        if self.busy:
            doing.close()
            return
        self.names |= names or {}
        self.notice = None
        self.working = Working(title, self.workshop.worker())
        self.task = asyncio.get_running_loop().create_task(self._watch(doing))
        self.changed()

    async def _watch(self, doing: Coroutine[Any, Any, None]) -> None:
        try:
            await doing
        except Cancelled:
            self.notice = Notice(("Cancelled: nothing was changed.",), error=False)
        except InputError as error:
            self.notice = Notice((self.without_paths(str(error)),))
        except Exception as error:
            self.notice = Notice(
                (
                    f"Internal error ({type(error).__name__}): nothing was changed; try again, and "
                    "report it.",
                )
            )
        finally:
            if self.working is not None:
                self.working.work.kill()
            self.working, self.task = None, None
            self.changed()
            self.read_arrived()

    async def _job(self, job: str, **details: Any) -> dict[str, Any]:
        assert self.working is not None
        if self.working.work.killed and not self.working.work.cancelled:  # it has done a job
            self.working.work = self.workshop.worker()
        request = {
            "job": job,
            "folder": str(self.folder),
            "robot": self.robot,
            "runs": self.runs,
            "seed": self.seed,
            **details,
        }
        return await self.workshop.run(self.working.work, request, self._progress)

    def _progress(self, text: str) -> None:
        if self.working is not None:
            self.working.status = text
            self.changed()

    def read_arrived(self) -> None:
        """What is to be done when a job has ended."""

    def _take_ladder(self, ladder: list[Rung]) -> None:
        """Another ladder; the session remembers every model that was on one."""
        self.ladder = ladder
        self.models += [rung for rung in ladder if rung.file not in {m.file for m in self.models}]

    def _refuse_meaningless(self) -> None:
        if self.meaningless and not self.anyway:
            raise InputError(
                self.meaningless[0],
                'repair it with `sdp-vs-penalty check RUN --fix`, or tick "Identify anyway"',
            )

    def _current(self) -> str:
        if self.model is None:
            raise InputError("No model yet", "identify one first")
        return self.model.file

    def _next_file(self) -> str:
        self._count += 1
        return str(self.folder / f"model-{self._count}.json")
