"""The page of one tab: header, the rail of stages, their screens, and the dock of what
is going on."""

import json
import time
from collections.abc import Callable
from functools import partial
from typing import Any

from nicegui import ui

from sdp_vs_penalty.page.controls import (
    button,
    changing,
    details,
    note,
    tag,
    take_presses,
)
from sdp_vs_penalty.page.job_queue import Working
from sdp_vs_penalty.page.next_step import NextStep, next_step
from sdp_vs_penalty.page.project import UNDO, PageNotice
from sdp_vs_penalty.page.sessions import title_of
from sdp_vs_penalty.page.spoken import label_of, with_whole_amounts
from sdp_vs_penalty.page.stages import STAGES
from sdp_vs_penalty.page.view import PagePart, Stage, StageVerdict, View
from sdp_vs_penalty.page.worker import sentence

#: Characters of a sentence of a notice; what a longer one adds is folded.
_MOST_IN_NOTICE = 160
#: Keys and styles of the buttons of the next step.
_CHOICES = (("next", "primary"), ("next-other", "quiet"), ("next-third", "quiet"))


class Workbench:
    """The page of one tab, drawn from its view; :meth:`redraw` keeps it up to date."""

    def __init__(self, view: View) -> None:
        """Draw the page once: header, rail of stages, a screen for each stage, status
        dock.

        The contents of the screens follow in :meth:`redraw`.
        """
        self.view = view
        self.session = view.session
        self.client = view.client
        #: By an element's id, the JSON of the state that it was last drawn from.
        self._drawn_states: dict[int, str] = {}
        #: By a stage's anchor: link, mark, section and place of its verdict; by "part-"
        #: and a part's anchor: the part, its body.
        self._elements: dict[str, tuple[Any, ...]] = {}
        # The news (stage and part) that the page has scrolled to.
        self._shown_news = view.session.new
        self._has_connected = False
        view.client.on_connect(partial(setattr, self, "_has_connected", True))
        take_presses()
        skip = tag("a", "Skip to content", "skip")
        with tag("header", style="top"), tag("div", style="inner"):
            tag("span", "sdp-vs-penalty", "brand")
            tag("span", "robot dynamics from logs", "soft about")
            self._project = tag(
                "input",
                style="project-name",
                aria_label="Name of the project",
                data_key="project-name",
            )
            changing(self._project, self.session.rename)
            tag("span", style="gap")
            self._steps = tag("div", style="row steps-back")
            new = {"href": "/new", "data_key": "new-project"}
            tag("a", "New project", "action quiet", **new)
        with tag("div", style="frame"):
            with tag("nav", style="stages", aria_label="Stages"):
                links = [
                    self._link(k, stage) for k, stage in enumerate(STAGES, start=1)
                ]
            # NiceGUI's own layout is the main landmark.
            with tag("div", style="page", tabindex="-1") as self._main:
                with tag("div", style="bar"):
                    self._next = tag("div", style="now", data_part="next")
                    self._dock()
                with tag("div", style="intro") as self._intro:
                    tag(
                        "h1",
                        "Identify your robot, see what the model is missing, add it",
                    )
                    tag(
                        "p",
                        "From the robot's URDF and logs with time, positions and torques of"
                        " all joints; two runs of 20 s or more are best. They stay on this"
                        " computer.",
                        "lead",
                    )
                for link, stage in zip(links, STAGES, strict=True):
                    self._elements[stage.anchor] = *link, *self._screen(stage)
        skip.props["href"] = f"#{self._main.html_id}"
        self.session.watchers.append(self)
        self.redraw()

    @property
    def present(self) -> bool:
        """Whether a browser shows this page: it is connected, or has not connected
        yet.
        """
        if self.client.is_deleted:
            return False
        return not self._has_connected or self.client.has_socket_connection

    def redraw(self) -> None:
        """Bring the page up to date; only parts whose state has changed are drawn
        anew.
        """
        if self.client.is_deleted:
            self.session.left(self)
            return
        with self.client:
            # A job has ended, and Undo is there, whatever else cannot be drawn.
            self._redraw_dock()
            self._redraw_top()
            try:
                self._redraw_stages()
            except Exception as error:  # a defect, of any kind: the page has to go on
                self._drawn_states.clear()  # parts may be drawn by half
                self._fill(self._next, str(error), partial(self._failed, error))

    def _redraw_stages(self) -> None:
        """Update the screens of all stages, and the next step."""
        step = next_step(self.view)
        for stage in STAGES:
            for part in stage.parts:
                ready = part.ready(self.session)
                place, body = self._elements[f"part-{part.anchor}"]
                place.set_visibility(ready)
                state = part.depends(self.session) if ready else None
                self._fill(body, state, partial(self._part, part, ready))
            self._redraw_stage(stage, step)
        self._intro.set_visibility(not self.session.robot)
        self._redraw_next(step)
        self._scroll_to_news()

    def _failed(self, error: Exception) -> None:
        """Draw why the project cannot be shown, and the way to the other ones."""
        with tag("div", style="now-words bad"):
            tag("p", f"This project cannot be shown. {sentence(error)}")
            note("Undo takes its last step back; nothing of it is lost.")
        other = {"href": "/new", "data_key": "other-projects"}
        with tag("div", style="choices"):
            tag("a", "Your projects", "action primary", **other)

    def _scroll_to_news(self) -> None:
        """Scroll the browser to the stage and part with a new result, once."""
        news = self.session.new
        if news is not None and news is not self._shown_news:
            stage, part = map(json.dumps, news)
            ui.run_javascript(f"workbench.show({stage}, {part})")
        self._shown_news = news

    def _part(self, part: PagePart, ready: bool) -> None:
        """Draw the content of a part if it is ready.

        Its previous callback for changes of the selection (``followers``) is dropped
        first.
        """
        self.view.followers.pop(part.anchor, None)
        if ready:
            part.draw(self.view)

    def _fill(self, place: Any, state: Any, draw: Callable[[], None]) -> None:
        """Redraw an element with ``draw`` if the state that it depends on has changed.

        States are compared as JSON texts.
        """
        text = json.dumps(state, default=str)
        if self._drawn_states.get(place.id) != text:
            self._drawn_states[place.id] = text
            place.clear()
            with place:
                draw()

    def _link(self, k: int, stage: Stage) -> tuple[Any, Any]:
        """Draw the link to the k-th stage (from 1); return the link and its mark.

        The mark is a hidden text that reads the stage's verdict to screen readers.
        """
        with tag("a", href="#", data_key=f"nav-{k}", data_to=stage.anchor) as link:
            if stage.anchor == "check":  # what it found is seen there
                link.on("click", lambda _: self.session.see_issues(), args=[])
            tag("span", str(k), "step", aria_hidden="true")
            tag("span", stage.title)
            return link, tag("span", style="unseen")

    def _screen(self, stage: Stage) -> tuple[Any, Any]:
        """Draw the empty screen of a stage: heading and a place for each part.

        Returns the section, and the place for the verdict above.
        """
        with tag("section", style="stage", data_stage=stage.anchor) as section:
            heading = tag("h2", stage.title, tabindex="-1")
            section.props["aria-labelledby"] = heading.html_id
            status_line = tag("div", style="said")
            for part in stage.parts:
                with tag("div", style="part", data_part=part.anchor) as place:
                    if part.title:
                        tag("h3", part.title, tabindex="-1")
                    body = tag("div", style="body")
                    self._elements[f"part-{part.anchor}"] = place, body
            return section, status_line

    def _dock(self) -> None:
        """Draw the status dock: notices, what the running job does, and a button to
        cancel it.
        """
        with tag("div", style="dock", aria_label="Status", role="region"):
            self._announcement = tag(
                "p", "", "unseen", role="status", aria_live="polite"
            )
            self._notices = {
                role: tag("div", style="notice", role=role)
                for role in ("alert", "status")
            }
            with tag("div", style="working") as self._working:
                tag("div", style="runner", aria_hidden="true")
                self._status = tag("span", "", "status", aria_hidden="true")
                self._clock = tag("span", "", "clock", aria_hidden="true")
                button("Cancel", self.session.cancel, "cancel")
            ui.timer(0.25, self._tick)

    def _tick(self) -> None:
        """Update the seconds that the running job has taken; a timer calls this."""
        if (working := self.session.working) is not None:
            self._clock.text = f"{time.monotonic() - working.since:.0f} s"

    def _redraw_stage(self, stage: Stage, step: NextStep) -> None:
        """Update a stage: its mark on the rail, and its verdict, unless it stands in
        view with the next step."""
        session = self.session
        ready = any(part.ready(session) for part in stage.parts)
        verdict = (stage.verdict(session) if ready else None) or StageVerdict("", "")
        link, mark, section, above = self._elements[stage.anchor]
        later = "" if ready else " later"  # the style of a stage that is not ready
        link.classes(replace=f"{verdict.level}{later}")
        section.classes(replace=f"stage{later}")
        mark.text = verdict.word

        def draw_verdict() -> None:
            """Draw the verdict, or what has to be done before the stage is ready."""
            if not ready:
                note(stage.before)
            is_in_view = verdict.text in step.text or f"{verdict.word}." in step.text
            if verdict.text and not is_in_view:
                with tag("p", style=f"verdict {verdict.level}"):
                    if verdict.word:
                        tag("strong", f"{verdict.word}. ")
                    tag("span", verdict.text)

        state = [ready, verdict.level, verdict.word, verdict.text, step.text]
        self._fill(above, state, draw_verdict)

    def _redraw_next(self, step: NextStep) -> None:
        """Update what stays in view: the verdict with the one next step."""
        session = self.session

        def draw_next() -> None:
            """Draw the verdict and the button."""
            with tag("div", style=f"now-words {step.level}"):
                tag("p", with_whole_amounts(step.text))
                if step.number:
                    stage, part = step.figure
                    to = {"data_to": stage, "data_part_of": part}
                    number = with_whole_amounts(step.number)
                    tag("a", number, "figure", href=f"#{stage}", **to)
                if step.more:
                    with details("More", "more"):
                        note(step.more)
            with tag("div", style="choices"):
                for (key, style), choice in zip(_CHOICES, step.choices, strict=False):
                    if not choice.label:
                        continue
                    opens = choice.opens or False
                    at: dict[str, Any] = {"data_to": choice.stage, "data_opens": opens}
                    button(choice.label, choice.do, key, style, **at)
                    if choice.outcome:
                        tag("p", with_whole_amounts(choice.outcome), "outcome")

        words = [step.text, step.number, step.more]
        labels = [[choice.label, choice.outcome] for choice in step.choices]
        state = [words, labels, step.stage, step.opens, step.level]
        # What the button does depends on the remedies and on the model.
        depends = [
            session.remedies,
            [m.file for m in session.history],
            session.mappings,
        ]
        self._fill(self._next, [state, depends], draw_next)

    def _redraw_top(self) -> None:
        """Update the project's name and the steps back."""
        session = self.session

        def draw_steps() -> None:
            """Draw the buttons that take a step back, or again."""
            for word, arrow, steps, do in (
                ("Undo", "↶", session.past, session.undo),
                ("Redo", "↷", session.future, session.redo),
            ):
                for label, _ in steps[-1:]:
                    with button("", do, word.lower(), "quiet", title=word):
                        tag("span", arrow, aria_hidden="true")
                        with tag("span", word, "what"):  # on a phone the word alone
                            tag("span", f": {label_of(label)}")

        labels = [[label for label, _ in x] for x in (session.past, session.future)]
        self._fill(self._steps, labels, draw_steps)
        self._project.set_visibility(bool(session.robot))
        if session.robot:
            name = title_of(session.name, session.robot, session.begun)
            self._project.props.update({"value": name, "size": str(len(name) + 2)})

    def _redraw_dock(self) -> None:
        """Update the status dock: what the running job does, and the notices."""
        self._redraw_working(self.session.working)
        notice = self.session.notice or PageNotice(())
        # Screen readers read an alert at once, a status when they are idle.
        for role in ("alert", "status"):
            texts = notice.texts if notice.error == (role == "alert") else ()
            has_left_out = notice.has_left_out
            ended = self.session.task is None and bool(self.session.unfinished)
            draw = partial(self._notice, texts, has_left_out, ended)
            self._fill(self._notices[role], [texts, has_left_out, ended], draw)

    def _redraw_working(self, working: Working | None) -> None:
        """Show what the running job does; None: hide that, and announce the job's end.

        The announcement is a hidden text for screen readers. It does not say "Done"
        where a notice says how the job ended.
        """
        is_busy = working is not None
        self._working.set_visibility(is_busy)
        self._steps.set_visibility(not is_busy)
        self._main.classes(replace="page busy" if is_busy else "page")
        self._main.props["aria-busy"] = "true" if is_busy else "false"
        # The pressed button says it (workbench.js).
        self._main.props["data-doing"] = working.title if working else ""
        if working is not None:
            step = f": {working.status}" if working.status else ""
            self._status.text = f"{working.title}{step}"
            self._announcement.text = f"{working.title}."
        elif self._status.text:  # a job was shown until now
            self._status.text = ""
            self._clock.text = ""
            has_notice = self.session.notice is not None
            last = self._announcement.text
            self._announcement.text = "" if has_notice else f"{last} Done."

    def _notice(
        self, texts: tuple[str, ...], has_left_out: bool, has_ended: bool
    ) -> None:
        """Draw the sentences of a notice with a button to close it, and one to choose
        other files where some were left out, or to start a job again that a server has
        ended; nothing if there are none.
        """
        if texts:
            with tag("div", style="texts"):
                for text in texts:
                    head, _, rest = text.partition("; ")
                    if rest and len(text) > _MOST_IN_NOTICE:
                        with details(head, f"notice-{head}"):
                            tag("p", rest)
                    else:
                        tag("p", text)
            if has_left_out:
                choose = {"data_to": "measure", "data_opens": "drop-runs"}
                other = "Choose other measurements"
                button(other, self.session.say, "other-runs", **choose)
            if has_ended:
                button("Start it again", self.session.start_again, "start-again")
            if any(UNDO in text for text in texts):
                button("Undo", self.session.undo, "undo-notice")
            button("Close", self.session.say, "close-notice", "quiet")
