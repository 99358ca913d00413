"""The page of one tab: header, the rail of stages, their screens, and the dock of what is going on."""

import itertools
import json
import time
from dataclasses import asdict
from functools import partial
from typing import Any

from nicegui import ui

from sdp_vs_penalty.page.controls import button, note, tag
from sdp_vs_penalty.page.stages import STAGES
from sdp_vs_penalty.page.view import Part, Stage, View

_LEVELS = frozenset({"good", "usable", "bad"})
_NEXT = dict(itertools.pairwise(STAGES))


class Workbench:
    """The page of one tab, drawn from its view and kept up to date."""

    def __init__(self, view: View) -> None:
        self.view, self.session, self.client = view, view.session, view.client
        #: By anchor, the element and what it was last drawn from.
        self._drawn: dict[str, str] = {}
        self._at: dict[str, Any] = {}
        self._seen = view.session.new
        self._met = False
        view.client.on_connect(partial(setattr, self, "_met", True))

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
                for stage in STAGES:
                    self._screen(stage)
        self._skip.props["href"] = f"#{self._main.html_id}"
        self._dock()
        self.session.watchers.append(self)
        self.session.shown = True
        self.redraw()

    @property
    def present(self) -> bool:
        """Loading, or connected; a tab that was just closed is neither."""
        return not self.client.is_deleted and (not self._met or self.client.has_socket_connection)

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
            for stage in STAGES:
                for part in stage.parts:
                    self._redraw_part(part)
                self._redraw_stage(stage)
            self._redraw_dock()
            self._lead_on()

    def _header(self) -> None:
        self._skip = tag("a", "Skip to content", "skip")
        with tag("header", style="top"), tag("div", style="inner"):
            tag("span", "sdp-vs-penalty", "brand")
            tag("span", "workbench", "soft")
            tag("span", style="gap")
            tag("a", "Start over", "action quiet", href="/new", data_key="start-over")

    def _rail(self) -> None:
        with tag("nav", style="stages", aria_label="Stages"):
            for k, stage in enumerate(STAGES, start=1):
                with tag("a", href="#", data_key=f"nav-{k}", data_to=stage.anchor) as link:
                    tag("span", str(k), "step", aria_hidden="true")
                    tag("span", stage.title)
                    self._at[f"level-{stage.anchor}"] = tag("span", style="unseen")
                self._at[f"link-{stage.anchor}"] = link

    def _screen(self, stage: Stage) -> None:
        with tag("section", style="stage", data_stage=stage.anchor) as section:
            heading = tag("h2", stage.title, tabindex="-1")
            section.props["aria-labelledby"] = heading.html_id
            self._at[stage.anchor] = section
            self._at[f"said-{stage.anchor}"] = tag("div", style="said")
            for part in stage.parts:
                with tag("div", style="part", data_part=part.anchor) as self._at[f"part-{part.anchor}"]:
                    if part.title:
                        tag("h3", part.title)
                    self._at[f"body-{part.anchor}"] = tag("div", style="body")
            self._at[f"end-{stage.anchor}"] = tag("div", style="end")

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

    def _changed(self, what: str, state: Any) -> bool:
        """Whether something is to be drawn from another state than last time."""
        text = json.dumps(state, default=str)
        before = self._drawn.get(what)
        self._drawn[what] = text
        return before != text

    def _redraw_part(self, part: Part) -> None:
        ready = part.ready(self.session)
        if not self._changed(part.anchor, part.depends(self.session) if ready else None):
            return
        self._at[f"part-{part.anchor}"].set_visibility(ready)
        self.view.followers.pop(part.anchor, None)
        body = self._at[f"body-{part.anchor}"]
        body.clear()
        if ready:
            with body:
                part.draw(self.view)

    def _redraw_stage(self, stage: Stage) -> None:
        """Its mark on the rail, the sentence that it ends in, and the way to the next one."""
        session, following = self.session, _NEXT.get(stage)
        ready = any(part.ready(session) for part in stage.parts)
        verdict = stage.verdict(session) if ready else None
        on = ready and following is not None and any(p.ready(session) for p in following.parts)
        if not self._changed(f"stage-{stage.anchor}", [ready, verdict and asdict(verdict), on]):
            return
        level = "" if verdict is None else verdict.level
        for place in (self._at[f"link-{stage.anchor}"], self._at[stage.anchor]):
            place.classes(**{"remove" if ready else "add": "later"})
        self._at[f"link-{stage.anchor}"].classes(add=level, remove=" ".join(_LEVELS - {level}))
        self._at[f"level-{stage.anchor}"].text = "" if verdict is None else verdict.word
        above, end = self._at[f"said-{stage.anchor}"], self._at[f"end-{stage.anchor}"]
        above.clear()
        end.clear()
        with above:
            if not ready:
                note(stage.before)
            if verdict is not None:
                with tag("p", style=f"verdict {level}"):
                    if verdict.word:
                        tag("strong", f"{verdict.word}. ")
                    tag("span", verdict.text)
        with end:
            if on and following is not None:
                style = "action primary" if verdict is not None and level != "bad" else "action"
                at = {"data_to": following.anchor, "data_key": f"next-{stage.anchor}"}
                tag("a", f"Next: {following.title}", style, href="#", **at)

    def _redraw_dock(self) -> None:
        session, working = self.session, self.session.working
        self._working.set_visibility(working is not None)
        self._main.classes(**{"remove" if working is None else "add": "busy"})
        self._main.props["aria-busy"] = "false" if working is None else "true"
        if working is not None:
            self._status.text = working.title + (f": {working.status}" if working.status else "")
            self._said.text = f"{working.title}."
        elif self._status.text:
            self._status.text, self._clock.text = "", ""
            self._said.text = f"{self._said.text} Done." if session.notice is None else ""
        for place, error in ((self._alert, True), (self._news, False)):
            mine = session.notice if session.notice and session.notice.error == error else None
            if not self._changed(f"notice-{place.id}", mine and mine.texts):
                continue
            place.clear()
            if mine is None:
                continue
            with place:
                with tag("div", style="texts"):
                    for text in mine.texts:
                        tag("p", text)
                button("Close", lambda: session.say(), "close-notice", "quiet")

    def _lead_on(self) -> None:
        """Bring what is new into sight."""
        if (new := self.session.new) is not self._seen and new is not None:
            ui.run_javascript(f"workbench.show({json.dumps(new[0])}, {json.dumps(new[1])})")
        self._seen = new
