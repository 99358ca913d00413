"""The page of one tab: header, steps, and the dock that says what is going on."""

from __future__ import annotations

import itertools
import json
import time
from typing import Any

from nicegui import ui

from sdp_vs_penalty.page.controls import button, note, tag
from sdp_vs_penalty.page.part import Part, Verdict
from sdp_vs_penalty.page.parts import PARTS, STAGES
from sdp_vs_penalty.page.view import View

_COLOURS = frozenset({"good", "usable", "bad"})
_THEMES = {None: "Colours: auto", False: "Colours: light", True: "Colours: dark"}


class Workbench:
    """The page of one tab, drawn from its view and kept up to date."""

    def __init__(self, view: View) -> None:
        self.view, self.session, self.client = view, view.session, view.client
        self._drawn: dict[str, str] = {}
        self._bodies: dict[str, Any] = {}
        self._sections: dict[str, Any] = {}
        self._links: dict[str, Any] = {}
        self._levels: dict[str, Any] = {}
        self._ends: dict[str, Any] = {}
        self._seen = self._marks()
        self._met = False
        view.client.on_connect(self._meet)

    def build(self) -> None:
        """Everything once; afterwards :meth:`redraw` keeps it up to date."""
        self._header()
        with tag("div", style="frame"):
            self._rail()
            # NiceGUI's own layout is the main landmark.
            with tag("div", style="page", tabindex="-1") as self._main:
                with tag("div", style="intro"):
                    tag("h1", "Identify your robot, see what the model is missing, add it")
                    tag("p", "Everything is computed on this computer, and no data leave it.", "lead")
                for k, step in enumerate(PARTS, start=1):
                    self._stage(k, step)
        self._skip.props["href"] = f"#{self._main.html_id}"
        self._dock()
        self.session.watchers.append(self)
        self.session.shown = True
        self.redraw()

    @property
    def present(self) -> bool:
        """Loading, or connected; a tab that was just closed is neither."""
        return not self.client.is_deleted and (not self._met or self.client.has_socket_connection)

    def _meet(self) -> None:
        self._met = True

    def close(self) -> None:
        """The tab is gone."""
        if self in self.session.watchers:
            self.session.watchers.remove(self)

    def redraw(self) -> None:
        """Draw anew what has changed, and nothing else."""
        if self.client.is_deleted:
            self.close()
            return
        with self.client:
            for step in PARTS:
                self._redraw_step(step)
            self._redraw_dock()
            self._lead_on()

    def _header(self) -> None:
        self._skip = tag("a", "Skip to content", "skip")
        with tag("header", style="top"), tag("div", style="inner"):
            tag("span", "sdp-vs-penalty", "brand")
            tag("span", "workbench", "soft")
            tag("span", style="gap")
            dark = ui.dark_mode(None)

            def turn() -> None:
                dark.value = {None: True, True: False, False: None}[dark.value]
                theme.text = _THEMES[dark.value]

            theme = button(_THEMES[None], turn, "theme", "quiet")
            tag("a", "Start over", "action quiet", href="/new", data_key="start-over")

    def _rail(self) -> None:
        with tag("nav", style="steps", aria_label="Steps"):
            k = 0
            for stage, steps in STAGES.items():
                tag("span", stage, "stage", aria_hidden="true")
                for step in steps:
                    k += 1
                    with tag("a", href="#", data_key=f"nav-{k}", data_to=step.anchor) as link:
                        tag("span", str(k), "number", aria_hidden="true")
                        tag("span", step.title)
                        self._levels[step.anchor] = tag("span", style="unseen")
                    self._links[step.anchor] = link

    def _stage(self, k: int, step: Part) -> None:
        with tag("section", style="step", data_part=step.anchor) as section:
            self._sections[step.anchor] = section
            with tag("div", style="title"):
                tag("span", str(k), "number", aria_hidden="true")
                heading = tag("h2", step.title, tabindex="-1")
                section.props["aria-labelledby"] = heading.html_id
            self._bodies[step.anchor] = tag("div", style="body")
            self._ends[step.anchor] = tag("div", style="end")

    def _dock(self) -> None:
        with tag("div", style="dock", aria_label="Status", role="region"):
            self._said = tag("p", "", "unseen", role="status", aria_live="polite")
            self._alert = tag("div", style="notice", role="alert")
            self._news = tag("div", style="notice", role="status")
            with tag("div", style="working") as self._working:
                tag("div", style="runner", aria_hidden="true")
                self._status = tag("span", "", "status", aria_hidden="true")
                self._clock = tag("span", "", "clock", aria_hidden="true")
                button("Cancel", self.session.cancel, "cancel")
            ui.timer(0.25, self._tick)

    def _tick(self) -> None:
        if (working := self.session.working) is not None:
            self._clock.text = f"{time.monotonic() - working.since:.0f} s"

    def _redraw_step(self, step: Part) -> None:
        session, body = self.session, self._bodies[step.anchor]
        # What the steps after the first offer comes when the first worker has loaded everything.
        ready = step.ready(session) and (step is PARTS[0] or "effects" in self.view.catalogue)
        self._redraw_end(step, step.verdict(session) if ready else None, ready)
        state = json.dumps(step.depends(session) if ready else None, default=str)
        if self._drawn.get(step.anchor) == state:
            return
        self._drawn[step.anchor] = state
        for place in (self._links[step.anchor], self._sections[step.anchor]):
            place.classes(add="" if ready else "later", remove="later" if ready else "")
        self.view.forget(step.anchor)
        body.clear()
        with body:
            if ready:
                step.draw(self.view)
            else:
                note(step.before)

    def _redraw_end(self, step: Part, verdict: Verdict | None, ready: bool) -> None:
        """The sentence that a step ends in, and the way to the next one."""
        following = dict(itertools.pairwise(PARTS)).get(step)
        on = ready and following is not None and following.ready(self.session)
        state = json.dumps(
            [None if verdict is None else (verdict.level, verdict.word, verdict.text), on]
        )
        if self._drawn.get(f"end-{step.anchor}") == state:
            return
        self._drawn[f"end-{step.anchor}"] = state
        level = "" if verdict is None else verdict.level
        self._links[step.anchor].classes(add=level, remove=" ".join(_COLOURS - {level}))
        self._levels[step.anchor].text = "" if verdict is None else verdict.word
        end = self._ends[step.anchor]
        end.clear()
        with end:
            if verdict is not None:
                with tag("p", style=f"verdict {level}"):
                    if verdict.word:
                        tag("strong", f"{verdict.word}. ")
                    tag("span", verdict.text)
            if on and following is not None:
                style = "action primary" if verdict is not None and level != "bad" else "action"
                at = {"data_to": following.anchor, "data_key": f"next-{step.anchor}"}
                tag("a", f"Next: {following.title}", style, href="#", **at)

    def _redraw_dock(self) -> None:
        session, working = self.session, self.session.working
        self._working.set_visibility(working is not None)
        self._main.classes(
            add="" if working is None else "busy", remove="busy" if working is None else ""
        )
        self._main.props["aria-busy"] = "false" if working is None else "true"
        if working is not None:
            self._status.text = working.title + (f": {working.status}" if working.status else "")
            self._said.text = f"{working.title}."
        elif self._status.text:
            self._status.text, self._clock.text = "", ""
            self._said.text = f"{self._said.text} Done." if session.notice is None else ""
        notice = session.notice
        for place, mine in (
            (self._alert, notice is not None and notice.error),
            (self._news, notice is not None and not notice.error),
        ):
            state = json.dumps(notice.texts if mine and notice is not None else None)
            if self._drawn.get(f"notice-{place.id}") == state:
                continue
            self._drawn[f"notice-{place.id}"] = state
            place.clear()
            if mine and notice is not None:
                with place:
                    with tag("div", style="texts"):
                        for text in notice.texts:
                            tag("p", text)
                    if notice.undo:
                        button("Undo", session.bring_back, "bring-back")
                    button("Close", lambda: session.say(), "close-notice", "quiet")

    def _marks(self) -> tuple[int, bool, bool]:
        session = self.session
        return len(session.history), session.findings is not None, session.answer("methods") is not None

    def _lead_on(self) -> None:
        """Bring what is new into sight."""
        (models, found, compared), (had, had_found, had_compared) = self._marks(), self._seen
        self._seen = self._marks()
        to = None
        if models == 1 and had == 0:
            to = "fit"
        elif found and not had_found:
            to = "findings"
        elif models > had > 0:
            to = "history"
        elif compared and not had_compared:
            to = "methods"
        if to is not None:
            ui.run_javascript(f"workbench.show({json.dumps(to)})")
