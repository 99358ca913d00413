"""Identify: what makes torque to begin with, how well it fits and where it fails, what
was found; the same by other methods."""

from collections.abc import Sequence
from functools import partial
from typing import Any

from nicegui import ui

from sdp_vs_penalty import formatting
from sdp_vs_penalty.diagnosis.finding import Finding
from sdp_vs_penalty.diagnosis.findings import Diagnosis
from sdp_vs_penalty.diagnosis.where_it_fails import CAUSES, SHARES, Failures
from sdp_vs_penalty.effects import DEFAULT_EFFECTS, effect_types, standard_effect
from sdp_vs_penalty.effects.written import read_effect
from sdp_vs_penalty.estimation.verdict import LOG, Line
from sdp_vs_penalty.estimators import estimator_types
from sdp_vs_penalty.page import controls as draw
from sdp_vs_penalty.page.arm_scene import chart_and_arm
from sdp_vs_penalty.page.charts import (
    asked_span,
    cause_chart,
    clock_in_words,
    error_scale,
    failing_stretches,
    ready,
    rows_of_span,
    torque_chart,
    torque_errors,
)
from sdp_vs_penalty.page.model_step import ModelStep
from sdp_vs_penalty.page.session import Session
from sdp_vs_penalty.page.spoken import spoken
from sdp_vs_penalty.page.view import PagePart, Stage, View, identified, requires_model
from sdp_vs_penalty.render import pieces
from sdp_vs_penalty.render.charts import Curves, friction_figure
from sdp_vs_penalty.render.tables import joint_table
from sdp_vs_penalty.render.words import CERTIFICATE, PROOF, plain_name, shown_finding
from sdp_vs_penalty.results.table import Table

_USUAL = (*DEFAULT_EFFECTS, standard_effect("armature").name)


def _model_now(session: Session) -> Any:
    """Return what the form depends on: the page redraws it when any of this changes."""
    chosen = (
        session.robot["source"],
        session.method,
        session.effects,
        session.impossible,
    )
    return *chosen, session.meaningless, session.model is None


@partial(
    PagePart,
    "model",
    "",
    lambda s: any(run["use"] != "test" for run in s.runs),
    _model_now,
)
def model(view: View) -> None:
    """Draw the form to identify a model; it is folded once there is one."""
    again = "Effects, method, options: identify again"
    if view.session.model is None:
        _form(view)
        return
    with draw.details(again, "model-form"):
        _form(view)


def _methods() -> dict[str, str]:
    """Return name and description of the methods that work on measurements.

    Methods that query a black-box simulator are left out.
    """
    return {
        name: k.description
        for name, k in estimator_types().items()
        if not k.needs_black_box
    }


def _form(view: View) -> None:
    """Draw the form to identify a model: effects, method, options and its button.

    Effects that need a fixed model, such as a payload, are not offered here.
    """
    session = view.session
    effects = {
        name: kind for name, kind in effect_types().items() if not kind.frozen_only
    }

    def tick(name: str, on: bool) -> None:
        chosen = [text for text in session.effects if read_effect(text).name != name]
        if on:
            chosen.append(name)
        # In the library's order; unknown names stay behind.
        order = [*effects, *(read_effect(text).name for text in chosen)]
        session.effects = sorted(
            chosen, key=lambda text: order.index(read_effect(text).name)
        )
        session.changed()

    names_in_model = {read_effect(text).name for text in session.effects}

    def boxes(names: Sequence[str]) -> None:
        with draw.tag("div", style="checks"):
            for name in names:
                on = name in names_in_model
                label = effects[name].explanation
                draw.check(
                    plain_name(name), on, partial(tick, name), f"effect-{name}", label
                )

    with draw.tag("fieldset"):
        draw.tag("legend", "Effects of the first model")
        boxes(_USUAL)
        unusual = [name for name in effects if name not in _USUAL]
        chosen = [name for name in unusual if name in names_in_model]
        with draw.details(
            f"More effects ({len(chosen)} of {len(unusual)} chosen)",
            "more-effects",
            bool(chosen),
        ):
            draw.note("The stage Diagnose tells which are needed.")
            boxes(unusual)

    with draw.tag("div", style="fields method"):
        options = [
            (name, f"{name}: {description}") for name, description in _methods().items()
        ]
        draw.choice(
            "Method",
            options,
            session.method,
            partial(setattr, session, "method"),
            "method",
        )
    _options(view)
    label, do = "Identify", session.identify
    if session.meaningless:
        draw.tag("p", session.impossible or session.meaningless[0], "finding error")
        label, do = "Identify anyway", session.identify_anyway
    if not session.impossible:
        draw.button(label, partial(session.start, do), "identify")
    with draw.details("Or continue from a model.json", "open-model"):
        draw.note(
            "A model identified earlier, possibly from other runs: kept fixed, it shows"
            " what has changed since, such as a payload."
        )
        draw.drop("Your model.json", "model")


def _options(view: View) -> None:
    """Draw a field for each option of `identify`."""
    session = view.session
    chosen = len(session.options)
    with (
        draw.details(
            f"More options{f' ({chosen} set)' * bool(chosen)}", "more-options"
        ),
        draw.tag("div", style="fields"),
    ):
        draw.draw_form(view.forms["identify"], session.options)


@requires_model(
    "fit", "Measured against modelled", lambda s: s.findings and s.findings.to_dict()
)
def fit(view: View) -> None:
    """Draw measured and modelled torque, where the model fails, and why."""
    model = view.session.current
    view.look_at_worst_joint()
    if view.run not in model.runs:
        view.run = model.runs[-1]
        view.span = None
    shown = _Fit(view)
    view.followers["fit"] = shown.follow
    shown.follow()
    for k, line in enumerate(model.on_bounds):
        with draw.tag("div", style="row"):
            draw.note(f"{formatting.sentence(spoken(line).rstrip('.'))}.")
            if "bounds, or" in line or "(--bounds)" in line:
                to = {"data_to": "identify", "data_opens": "option-bounds"}
                draw.button("Set bounds", None, f"bounds-{k}", "quiet", **to)


class _Fit:
    """What the part shows of the joint, the run and the span that are chosen: bars,
    torques with the arm, words, causes, and the error against a cause."""

    def __init__(self, view: View) -> None:
        """Draw the elements of the part, still without data: bars, chart, arm and
        table.
        """
        self.view = view
        self.model = view.session.current
        show = partial(_show, view)
        self.bars = ui.html("", sanitize=False).on("click", show, js_handler=_CELL)
        draw.note("Click a joint to see it below.")
        with draw.tag("div", style="pick"):
            choose = lambda name: view.select(run=name)  # noqa: E731
            draw.choice("Run", self.model.runs, view.run, choose, "shown-run")
        label = "Measured and modelled torque, and the error"
        caption = "a link's colour: the torque error of its joint"
        scale = error_scale(self.model)
        self.chart, self.move = chart_and_arm(
            view, label, self.model.about, caption, scale=scale
        )
        self.chart.on("plotly_relayout", self.zoom)
        with self.chart.parent_slot:
            self.legend = ui.html("", sanitize=False)
            self.words = draw.tag("p", "", "words")
        _figures(self.model)
        with draw.details("Every figure of the model", "joints-table"):
            draw.judged([self.model])
            units = view.session.torque_units
            shown = joint_table({"": self.model.facts}, units)
            draw.table(shown, "Facts of each joint")
            self.clock = draw.tag("p", "", "soft")
        if self.model.failures:
            failures = self.model.where_it_fails
            _heat(view, failures, view.session.findings_of_current)
        with draw.tag("div", style="pick"):
            look = lambda name: view.select(cause=name)  # noqa: E731
            label = "Error against"
            self.cause = draw.choice(label, CAUSES, view.cause, look, "cause")
        self.against = draw.chart({}, "Error of the joint against a cause")

    def zoom(self, event: Any) -> None:
        """Select the time span that was dragged in the chart.

        ``asked_span`` returns False for an event that is about no span.
        """
        span = asked_span(event.args)
        if not isinstance(span, bool) and span != self.view.span:
            self.view.select(span=span)

    def follow(self) -> None:
        """Update all elements to the joint, run, span and signal that are selected
        now.
        """
        view = self.view
        model = self.model
        session = view.session
        j = view.joint or 0
        units = session.torque_units
        steps = session.first_and_current
        recordings = [session.recording(step, view.run) for step in steps]
        self._draw_bars(j, units)
        self._draw_torques(j, units, recordings)
        reads = [rows_of_span(read, view.span) for read in recordings]
        drawn = cause_chart(session, model, reads, j, view.cause)
        self.against.update_figure(drawn)
        self.cause.props["value"] = view.cause
        finding = shown_finding(session.findings_of_current, formatting.joint_number(j))
        self.words.text = _words(model, j, units[j], finding)
        last = recordings[-1]
        self.move(view.run, last, torque_errors(model, last))

    def _draw_bars(self, j: int, units: Sequence[str]) -> None:
        """Draw the error of each joint as bars; joint j (from 0) is highlighted."""
        history = self.view.session.history
        comparison = self.model.comparison
        after = comparison["rmse"] if len(history) > 1 else None
        before = history[0].comparison["rmse"]
        floor = comparison["noise_floor"]
        scope = self.model.scope
        colours = "before (grey), after (blue)"
        for name in [*self.model.changed_runs][:1]:
            before, after = self.model.usual_error, self.model.errors_of_runs[name]
            scope = ""
            colours = f"in the model's own runs (grey), in {name} (blue)"
        self.bars.content = pieces.bars(
            before,
            after,
            floor,
            units,
            scope,
            chosen=j,
            torque=self.model.comparison["torque_rms"],
            colours=colours,
        )

    def _draw_torques(
        self, j: int, units: Sequence[str], recordings: Sequence[Any]
    ) -> None:
        """Draw measured and modelled torque of joint j (from 0), shaded where the error
        is large.

        recordings : arrays of the selected run, for the first model and the current
        one.
        """
        view = self.view
        last = recordings[-1]
        steps = view.session.first_and_current
        modelled = {
            step.label: recording["modelled"]
            for step, recording in zip(steps, recordings, strict=True)
        }
        failing = failing_stretches(self.model, view.run, j, last)
        run = Curves(last["t"], last["torque"], modelled)
        drawn = torque_chart(run, j, units, view.span, failing)
        self.chart.update_figure(drawn)
        causes = {cause for *_, cause in failing}
        shown = [cause for cause in pieces.SHADES if cause in causes]
        self.legend.content = pieces.legend(shown)
        self.clock.text = clock_in_words(view.run, last)


def _figures(model: ModelStep) -> None:
    """Draw on which data the model was judged, and what is in doubt of the log."""
    facts = model.facts
    new = facts["new_motion_percent"].texts[0]
    seconds = facts["judged_seconds"].texts[0]
    draw.note(
        f"Judged {model.scope}: {seconds} s after filtering, of which {new} % are motion"
        f" that the model has not seen, {facts['scope'].text}; checked and identified in"
        f" {model.seconds:.2g} s."
    )
    for line in map(Line.from_dict, model.comparison["verdict"]["lines"][1:]):
        if line.about == LOG:  # bars, table and Diagnose say what the others do
            draw.tag("p", formatting.sentence(spoken(str(line))), "line")


def _words(model: ModelStep, j: int, unit: str, finding: Finding | None) -> str:
    """Return the sentences on the error of joint j (from 0): its size in N m or N
    (``unit``), over the noise if that is known, and its cause: the ``finding`` where
    there is one, else what it depends on.
    """
    facts = model.facts
    plain = formatting.plain_unit(unit)
    number = formatting.joint_number(j)
    error = facts["joint_error"].of_joint(number)
    text = f"Error of joint {number} {model.scope}: {error} {plain}"
    if facts["error_over_noise"].value is not None:
        share = facts["error_beyond_noise"].of_joint(number)
        text += f" ({share} % of its torque beyond the noise)"
        times = facts["error_over_noise"].of_joint(number)
        floor = facts["joint_noise"].of_joint(number)
        text += f", {times} times the noise floor of {floor} {plain}"
    sentences = model.failures[j]["sentences"] if model.failures else ()
    if finding is not None:
        sentences = [f"Diagnose found: {finding.title}."]
    return " ".join([f"{text}.", *map(spoken, sentences)])


def _heat(view: View, failures: Failures, diagnosis: Diagnosis | None) -> None:
    """Draw the share of each joint's error that each cause explains, as a heat map.

    Causes that the diagnosis has found come first. A click on a cell selects its joint.
    """
    draw.tag("h4", "Where it fails, and why")
    draw.note(f"{SHARES} In per cent. Click a cell to see the joint.")
    rows = pieces.heat_rows(failures, pieces.found_shares(diagnosis, len(failures)))
    title = "Share of the error explained by each cause, by joint"
    drawn = pieces.heat_map(title, rows, len(failures), has_buttons=True)
    drawn = pieces.piece("framed.html", inner=drawn, caption=title)
    ui.html(drawn, sanitize=False).on("click", partial(_show, view), js_handler=_CELL)


def _show(view: View, event: Any) -> None:
    """Select the joint that was clicked, and the clicked cause; by a bar the cause that
    shows the joint's error.
    """
    joint, cause = event.args
    if cause not in CAUSES:
        cause = view.session.cause_of(int(joint))
    view.select_joint(joint, cause)


#: What a click on a button of a joint sends.
_CELL = """(e) => { const cell = e.target.closest("[data-joint]");
  if (cell) emit([cell.dataset.joint, cell.dataset.cause]); }"""


@requires_model("parameters", "Parameters", lambda s: s.answer("ranges"))
def parameters(view: View) -> None:
    """Draw between which values the masses can lie, once asked for; links, friction,
    certificate and all parameters, folded at first."""
    session = view.session
    for words in session.current.about["words"]:
        draw.tag("p", words, "words")
    if session.current.about["links"]:
        find = partial(session.start, session.ask, "Finding the ranges", "ranges")
        draw.button("Between which values?", find, "ranges")
    if (answer := session.answer("ranges")) is not None:
        draw.table(Table.from_dict(answer["table"]), "Ranges of the masses")
        for note in answer["notes"]:
            draw.note(note)
    box = draw.details(
        "Links, friction, every parameter, and how the result was proved", "parameters"
    )

    def fill() -> None:
        # Only once it is opened: a hidden chart slows every click like a visible one.
        is_empty = len(box.default_slot.children) == 1  # the summary alone
        if is_empty:
            with box:
                _tables(view)

    box.on("toggle", lambda _: fill(), args=[])


def _tables(view: View) -> None:
    """Draw the tables of links, certificate and parameters, and the friction curve.

    The curve follows the joint that is selected elsewhere on the page.
    """
    about = view.session.current.about
    if about["links"]:
        draw.table(Table.from_dict(about["links"]))
    if about["friction"]:
        draw.tag("h4", "Friction by velocity")

        def options() -> dict[str, Any]:
            j = view.joint or 0
            plot = friction_figure(
                **about["friction"][j], joint=j, unit=view.session.torque_units[j]
            )
            return ready(plot, 300)

        drawn = draw.chart(
            options(), "Friction torque over velocity with its 95 % band"
        )
        draw.note("Of the joint that is chosen above; shaded: 95 %.")
        view.followers["parameters"] = lambda: drawn.update_figure(options())
    draw.tag("h4", PROOF, title="the certificate")
    draw.note(CERTIFICATE)
    draw.table(Table.from_dict(about["certificate"]), PROOF)
    draw.tag("h4", "Every parameter")
    draw.note(
        "Values with 95 % intervals beside the nominal ones. Only those"
        " from data are measured: the data leave the others open."
    )
    with draw.tag("div", style="tall"):
        draw.table(Table.from_dict(about["parameters"]), "Parameters with intervals")
    draw.button("Copy the table", None, "copy", data_copy="table.parameters")


@requires_model("methods", "Compare methods", lambda s: s.answer("methods"))
def methods(view: View) -> None:
    """Draw a form to identify the same effects by other methods, and the last
    result.
    """
    session = view.session
    chosen = view.methods
    names = _methods()

    ticked = formatting.words([name for name in names if chosen.get(name)] or ["none"])
    with draw.details(f"Which ones: {ticked}", "which-methods"), draw.tag("fieldset"):
        draw.tag("legend", "With the effects of the current model")
        for name, description in names.items():
            put = partial(chosen.__setitem__, name)
            is_on = chosen.get(name, False)
            draw.check(f"{name}: {description}", is_on, put, f"method-{name}")

    def compare() -> None:
        chosen_names = [name for name in names if chosen.get(name)]
        session.start(session.ask, "Comparing methods", "methods", methods=chosen_names)

    draw.button("Compare methods", compare, "compare")
    if (answer := session.answer("methods")) is None:
        return
    draw.table(Table.from_dict(answer["table"]), "Methods compared")
    with draw.tag("ul"):
        for name, reason in answer["reasons"].items():
            draw.tag("li", f"{name}: {spoken(reason)}")
    draw.note(
        "On the runs that the model is judged on. A link cannot exist that is zero or less"
        " thick, or breaks another limit; optimality gap: how far the squared error can be above"
        " the least possible one, as a share of it."
    )


IDENTIFY = Stage(
    "identify",
    "Identify",
    "Add measurements first.",
    (fit, model, parameters, methods),
    identified,
)
