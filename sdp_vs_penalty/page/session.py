"""One tab: what it has chosen, read and identified, what is said of it, and all that can be
done to it."""

import asyncio
import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from filecmp import cmp
from typing import Any

from sdp_vs_penalty import formatting
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.estimators.estimator import no_progress
from sdp_vs_penalty.page.repairs import Repairs
from sdp_vs_penalty.page.runs import kind_of
from sdp_vs_penalty.records import to_json
from sdp_vs_penalty.reports.demo import ARM, HIDDEN, LEVEL, RUNS, SEED


@dataclass
class Session(Repairs):
    """What one tab has chosen, read and identified, what is said of it, and all that
    can be done to it.

    One job at a time: :meth:`start` begins one of the coroutines below. Kept while the
    server runs, also of a closed tab.
    """

    #: By file that was made, what it was made of.
    made: dict[str, str] = field(default_factory=dict)
    #: What makes a file beside another job.
    making: set[asyncio.Task[None]] = field(default_factory=set)

    def idle(self) -> None:
        """Read the files that were dropped meanwhile, or else try the remedies."""
        self.read_arrived()
        if self.task is None:
            self.aside = asyncio.get_running_loop().create_task(self._foresee())

    def read_arrived(self) -> None:
        """Start to open the files that were dropped, unless a job is running.

        In that case the end of that job calls this method again. Runs wait for a robot.
        """
        if self.arrived and (self.robot or "robot" in map(kind_of, self.arrived)):
            self.start(self.open_arrived)
        elif self.arrived and self.notice is None:
            names = formatting.words([*self.arrived])
            self.say(f"{names}: read once the robot is chosen.", error=False)

    async def open_arrived(self) -> None:
        """Open the files that were dropped, by what their endings say: first robots, then
        runs, then models."""
        for name, path in self._take_arrived("robot").items():
            is_here = self.robot and self.robot["file"] is not None
            if not is_here or not cmp(self.robot["source"], path, shallow=False):
                await self.choose_robot(str(path), name)
        if "runs" in map(kind_of, self.arrived):
            await self.read_files()
        for name, path in self._take_arrived("model").items():
            await self.open_model(str(path), name)

    async def show_me(self) -> None:
        """Demonstrate the full workflow on simulated runs with a hidden effect.

        The steps and runs are those of `sdp-vs-penalty demo`.
        """
        await self.choose_robot(ARM)
        joint = self.robot["n"]
        await self.simulate(HIDDEN, [joint], LEVEL, SEED, RUNS)
        await self.identify()
        await self.diagnose()
        assert self.findings is not None
        found = [f.text for f in self.findings.helpful]
        if found:
            await self.apply(self.findings.remedies[0].change.to_dict())

    def download(
        self,
        name: str,
        ready: Callable[[str], None],
        options: Mapping[str, str] | None = None,
    ) -> None:
        """Give out a file, at once where it was made of the same; ``ready`` is called with
        its name once it exists. It is made beside a job that runs.

        options : further fields of the request, such as the flange of a payload.
        """
        request = self._content(name, options)
        if self.made.get(name) == json.dumps(to_json(request)):
            ready(name)
        elif self.task is None:
            self.start(self._take_file, request, ready)
        else:
            self.say(
                f"{name} is made beside the job, and then downloaded.", error=False
            )
            making = self._take_file(request, ready, is_aside=True)
            task = asyncio.get_running_loop().create_task(making)
            self.making.add(task)
            task.add_done_callback(self.making.discard)

    async def _take_file(
        self,
        request: Mapping[str, Any],
        ready: Callable[[str], None],
        is_aside: bool = False,
    ) -> None:
        """Make a file to download, as :meth:`download` asks for it."""
        name = request["name"]
        try:
            if is_aside:
                await self.pool.run(request, no_progress, is_aside=True)
            else:
                self._doing(title=f"Making {name}", status="")
                await self._run(request)
        except InputError as error:
            self.say(f"{name}: {error}")
            return
        self.made[name] = json.dumps(to_json(request))
        self.taken = {*self.taken, name}
        self.say()
        ready(name)

    def _content(self, name: str, options: Mapping[str, str] | None) -> dict[str, Any]:
        """Return the request that makes a file to download."""
        steps = enumerate(self.history, start=1)
        made_of = {
            "models": [{"label": f"{k}: {m.label}", "file": m.file} for k, m in steps],
            "commands": self.commands(),
            "findings": self.findings and self.findings.to_dict(),
            "urdf": self.robot["source"] if self.robot["file"] else None,
            "forward": self.answer("forward") is not None,
            "verdict": self.current.verdict_on(name).to_dict(),
            "model": self.current.model_of(name),
            "identified_without": self.current.identified_without(name),
        }
        return self._request("take", name=name, **made_of, **(options or {}))
