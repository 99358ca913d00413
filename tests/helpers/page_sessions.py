"""Sessions of the page without a browser, their jobs done in this process, and their
screens."""

import asyncio
import base64
import json
import re

import numpy as np
import pytest

from sdp_vs_penalty import InputError
from sdp_vs_penalty.cli.verbs import page as verb
from sdp_vs_penalty.data import save
from sdp_vs_penalty.page import jobs, worker
from sdp_vs_penalty.records import to_json


def numbers(packed):
    """An array of a chart, as plotly's script reads it."""
    if isinstance(packed, list):
        return np.array(packed)
    return np.frombuffer(base64.b64decode(packed["bdata"]), f"<{packed['dtype']}")


class Here:
    """Does jobs as a worker does, in this process: requests and answers are JSON all
    the same. Remedies are tried before a click only where a test asks for it."""

    tries_remedies = False

    async def run(self, request, progress, is_aside=False):
        if is_aside and request["job"] == "change" and not self.tries_remedies:
            raise asyncio.CancelledError  # as the next job cancels it
        asked = jobs.JobRequest(json.loads(json.dumps(to_json(request))), progress)
        answer = worker.do(getattr(jobs, request["job"]), asked)
        if "error" in answer:
            raise InputError(answer["error"])
        return dict(json.loads(json.dumps(answer["result"], default=worker.as_json)))

    def close(self):
        pass


async def finish(session, act):
    """Do something and wait until its job is done; a sentence about an error fails the
    test."""
    session.start(act)
    await asyncio.wait([session.task])
    if session.notice is not None and session.notice.error:
        raise InputError(" ".join(session.notice.texts))


def do(session, *deeds):
    for deed in deeds:
        asyncio.run(finish(session, deed))


def opened(sessions, robot, **files):
    """A session in which a robot was chosen and runs were read, by the names that they
    come with."""
    s = sessions.new()
    do(s, lambda: s.choose_robot(robot))
    if files:
        s.arrived.update(files)
        do(s, s.read_files)
    return s


def saved(folder, runs, *names):
    for run, name in zip(runs, names, strict=False):
        save(run, folder / name)
    return {name: folder / name for name in names}


def forms():
    """What the verb gives the page."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            "sdp_vs_penalty.page.server.serve", lambda *given: held.append(given)
        )
        held = []
        verb.verb()
    return dict(held[0][-1])


class Screen:
    """The page of a session, drawn without a browser; its controls are found by their
    keys."""

    def __init__(self, session, folder=None, is_broken=False):
        from nicegui import Client, core
        from nicegui.page import page

        from sdp_vs_penalty.page import View, Workbench

        self.session, self.scripts, self.is_broken = session, [], is_broken
        self.loop = asyncio.new_event_loop()
        core.loop = self.loop
        self.client = Client(page("/"))
        self.client.run_javascript = lambda code, **_: self.scripts.append(code)
        with self.client:
            self.view = View(session, folder, self.client, forms())
            self.do(Workbench, self.view)

    def do(self, act, *given):
        """Call something, and wait until the job that it starts is done."""

        async def doing():
            with self.client:
                act(*given)
            while (task := self.session.task) is not None:
                await asyncio.wait([task])
                await asyncio.sleep(0.0)

        self.loop.run_until_complete(doing())
        assert ("other-projects" in self.keys) is self.is_broken, self.text("next")

    @property
    def keys(self):
        """Of the controls that can be seen, in their order."""
        return [str(e.props["data-key"]) for e in self.under() if "data-key" in e.props]

    def at(self, key):
        found, *others = (e for e in self.under() if e.props.get("data-key") == key)
        assert not others, key
        return found

    def under(self, top=None):
        """All that is visible below an element, in its order on the page."""
        top = self.client.layout if top is None else top
        children = [
            child
            for slot in top.slots.values()
            for child in slot.children
            if child.visible
        ]
        return [top, *(e for child in children for e in self.under(child))]

    def part(self, name):
        """All of a part, or of a stage."""
        names = ("data-stage", "data-part")
        return self.under(
            next(e for e in self.under() if name in map(e.props.get, names))
        )

    def text(self, name):
        """What a part says, or a stage, on a line."""
        told = [
            getattr(e, kind, "")
            for e in self.part(name)
            for kind in ("text", "content")
        ]
        return " ".join(
            re.sub(
                r"<[^>]+>", " ", " ".join(x for x in told if isinstance(x, str))
            ).split()
        )

    def charts(self, name):
        """The figures of a part."""
        return [e.figure for e in self.part(name) if hasattr(e, "figure")]

    def hear(self, element, kind, args=None):
        """An event of an element."""
        from nicegui.events import GenericEventArguments

        for listener in list(element._event_listeners.values()):
            if listener.type == kind:
                event = GenericEventArguments(
                    sender=element, client=self.client, args=args
                )
                self.do(listener.handler, event)

    def click(self, *keys):
        for key in keys:
            self.hear(self.at(key), "click")

    def set(self, key, value):
        """Write into a field, choose, or tick."""
        self.hear(self.at(key), "change", value)
