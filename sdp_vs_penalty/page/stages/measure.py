"""Measure: which robot, and which measurements. Check: what they look like, and what
the check says."""

import tomllib
from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from itertools import groupby
from pathlib import Path
from typing import Any

from sdp_vs_penalty import formatting
from sdp_vs_penalty.data.words.tokens import group_of
from sdp_vs_penalty.effects import effect_types
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.estimation.verdict import grades_in_words
from sdp_vs_penalty.files import problems_folder
from sdp_vs_penalty.page import controls as draw
from sdp_vs_penalty.page.arm_scene import ArmScene, chart_and_arm
from sdp_vs_penalty.page.charts import clock_in_words, data_chart
from sdp_vs_penalty.page.repairs import ANGLES, UNITS
from sdp_vs_penalty.page.run_issues import (
    asks_for_unit,
    is_of_all_torques,
    is_unit_asked,
)
from sdp_vs_penalty.page.runs import ENDINGS
from sdp_vs_penalty.page.session import Session
from sdp_vs_penalty.page.spoken import label_of, name_in_title, spoken
from sdp_vs_penalty.page.unit_form import NAME_UNIT, UnitForm
from sdp_vs_penalty.page.view import (
    PagePart,
    Project,
    Stage,
    StageVerdict,
    View,
    checked,
    graded,
    label_of_change,
    label_of_motion,
    look_in_words,
    read_measured_torque,
    samples_in_words,
    set_aside_in_words,
)
from sdp_vs_penalty.render.words import BADGES, plain_name
from sdp_vs_penalty.reports.demo import HIDDEN, SEED
from sdp_vs_penalty.results.issue import StoredIssue
from sdp_vs_penalty.results.remedy import Change
from sdp_vs_penalty.simulation.worlds.hidden import LEVELS, MAKERS


def _robot_now(session: Session) -> Any:
    """Return what the robot's part depends on: the page redraws it when this
    changes.
    """
    names = ("source", "title", "gravity", "hold")
    return [session.robot.get(name) for name in names], bool(session.runs)


@partial(PagePart, "robot", "Robot", lambda session: True, _robot_now)
def robot(view: View) -> None:
    """Draw the chosen robot and its gravity, or the robots to choose from."""
    session = view.session
    robot = view.session.robot
    if not robot:
        _choose(view)
        return
    with draw.tag("div", style="pair"):
        with draw.tag("div", style="body"):
            _chosen(view)
        if robot["drawn"]["bodies"]:
            caption = "nominal links; the joint that moves lights up, in their order"
            arm = ArmScene(view, robot["drawn"], caption, None, height=230)
            read = session.arrays(robot["sweep"])
            arm.load(robot["sweep"], read, read["moves"])


def _chosen(view: View) -> None:
    """Draw what is known of the chosen robot, its gravity and joints that are held."""
    session = view.session
    robot = view.session.robot
    file = f"{robot['file']}: {robot['name']}, " if robot["file"] else ""
    draw.tag("p", f"{file}{robot['title']}", "chosen")
    units = ", ".join(dict.fromkeys(robot["units"]))
    draw.note(
        f"Joints in order: {', '.join(robot['joints'])}. The model's torques are in {units}."
    )
    gravity, hold = view.forms["robot"]
    now = ",".join(f"{g:g}" for g in robot["gravity"])
    fields = ((gravity, now, session.mount), (hold, robot["hold"], session.hold))
    is_changed = bool(robot["hold"]) or robot["gravity"] != robot["own_gravity"]
    title = "Mounting, joints that stand still"
    with draw.details(title, "known", is_changed), draw.tag("div", style="fields"):
        for option, value, do in fields:
            text = draw.option_help(option)
            example = str(option.metavar)
            put = partial(session.start, do)
            draw.text_field(text, value, put, option.dest, example)
    if session.runs:  # they are this robot's: another one has a page of its own
        new = {"href": "/new", "target": "_blank", "data_key": "another-robot"}
        draw.tag("a", "Another robot, on a new page", **new)
        return
    with draw.details("Another robot", "another-robot"):
        _choose(view)


#: What the demonstration comes to.
EXAMPLE = "joint 7: 0.0654 -> 0.00418 N m"


def _choose(view: View) -> None:
    """Draw the robots to choose from: built-in ones, those of the folder, a dropped
    URDF.
    """
    session = view.session
    robot = view.session.robot
    with draw.tag("div", style="begin"):
        with draw.tag("div", style="body"):
            text = "Drop your robot's URDF here, and its measurements"
            draw.drop(text, "robot", "runs")
            with draw.tag("div", style="row"):
                show = partial(session.start, session.show_me)
                draw.button("Show me", show, "show-me")
                draw.note(
                    "The whole job on a simulated arm with something hidden, in less than"
                    " a minute. An answer looks like this:"
                )
            with draw.tag("div", style="card finding-card done"):
                draw.tag("strong", f"{plain_name(HIDDEN)}, joint 7 ")
                title = f"{BADGES['confident']}."
                draw.tag("span", "confident", "badge", title=title)
                draw.tag("p", spoken(f"Added to the model, {EXAMPLE}"), "soft")
        if not robot and view.projects:
            with draw.tag("section", style="way"):
                draw.tag("h4", "Your projects")
                _projects(view)
    with draw.details("What Good, Usable and near-tie mean", "meanings"):
        draw.note(grades_in_words())
        draw.note("Noise: what differs in the torque where a motion is repeated.")
        draw.note("Of what is missing in a model:")
        with draw.tag("ul"):
            for badge, meaning in BADGES.items():
                draw.tag("li", f"{formatting.sentence(badge)}: {meaning}.")
    draw.tag("h4", "Or a built-in robot")
    # By name or path: what to call it, what it is, and the shown name of a URDF.
    there: dict[str, tuple[str, str, str | None]] = {}
    for file in sorted(problems_folder().glob("*/problem.toml")):
        title = tomllib.loads(file.read_text("utf-8"))["title"]
        name = name_in_title(title)
        description = title.removeprefix(name).lstrip(", ")
        there[file.parent.name] = name, description, None
    for folder in view.folder_problems():
        there[str(folder)] = (
            folder.name,
            "with the bounds and filters of its problem.toml",
            None,
        )
    for file in view.folder_files(ENDINGS["robot"]):
        there[str(file)] = file.name, "from your folder", file.name
    with draw.tiles("Built-in robots"):
        for source, (name, description, urdf) in there.items():
            on = robot.get("source") == source
            choose = partial(session.start, session.choose_robot, source, urdf)
            pressed = "true" if on else "false"
            draw.tile(
                name,
                description,
                choose,
                f"robot-{Path(source).name if urdf is None else name}",
                "on" if on else "",
                aria_pressed=pressed,
            )


def _projects(view: View) -> None:
    """Draw the projects that can be opened again, the last one first."""

    def delete(project: Project, row: Any) -> None:
        try:
            view.delete(project)
        except InputError as error:
            view.session.say(error.without_command)
        else:
            row.delete()

    with draw.tag("ul", style="projects"):
        for project in view.projects:
            with draw.tag("li") as row:
                open_it = f"open-{project.token}"
                draw.tag(
                    "a", project.name, href=f"/s/{project.token}", data_key=open_it
                )
                draw.tag("span", project.about, "soft")
                key = f"delete-{project.token}"
                ask = f"Delete {project.name} and its files?"
                forget = partial(delete, project, row)
                draw.button("Delete", forget, key, "quiet", data_confirm=ask)


_USES = (
    ("train", "identify from it"),
    ("test", "test on it"),
    ("split", "split: identify and test"),
    ("wait", "not used before Check's question is answered"),
    ("", "remove"),
)


@partial(
    PagePart,
    "runs",
    "Measurements",
    lambda s: bool(s.robot),
    lambda s: (
        s.robot["source"],
        [[run[name] for name in ("name", "use", "split")] for run in s.runs],
        (s.model is None, s.hidden),
        [(m["path"], m["run"], m["reason"]) for m in s.mappings],
    ),
)
def runs(view: View) -> None:
    """Draw the ways to get measurements, and the runs that are loaded."""
    ways = {"Your runs": _your_runs, "Simulated, with a hidden effect": _simulated}
    if view.session.runs and not view.session.hidden:  # they would take a log's place
        ways.popitem()
    if view.session.robot["data"]:
        ways["Measured, by others"] = _measured_by_others
    for mapping in _of_each_kind(view.session.refused):
        draw.tag("h4", _title_of_columns(view.session, mapping))
        _mapping(view.session, mapping)
    if view.session.runs:
        _list(view)
    with draw.tag("div", style="ways"):
        for title, fill in ways.items():
            with draw.tag("section", style="way"):
                draw.tag("h4", title)
                fill(view)
    for mapping in _of_each_kind(view.session.guessed):
        _guessed(view.session, mapping)


def _of_each_kind(mappings: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return the first of all files with the same columns, for each kind of file."""
    return list({str(m["columns"]): m for m in mappings[::-1]}.values())[::-1]


def _title_of_columns(session: Session, mapping: dict[str, Any]) -> str:
    """Name all files with the same columns in a question."""
    same = [m["name"] for m in session.mappings if m["columns"] == mapping["columns"]]
    return f"Which column of {formatting.words(same)} is what?"


def _guessed(session: Session, mapping: dict[str, Any]) -> None:
    """Draw what was guessed of files that were read: a button for each other set of
    torques, and the form, folded."""
    for k, name in enumerate(mapping["torques"]):
        take = partial(session.start, session.read_mapped, mapping["columns"], name)
        draw.button(f"Take {name} as the torque", take, f"torque-{k}")
    k = session.mappings.index(mapping)
    with draw.details(_title_of_columns(session, mapping), f"columns-{k}"):
        _mapping(session, mapping)


def _mapping(session: Session, mapping: dict[str, Any]) -> None:
    """Draw the form that assigns the columns of files, prefilled with what is
    recognised or guessed; one form for all files with these columns.

    mapping : a file's path, name, columns with first cells, and the column chosen for
    each name that a run needs.
    """
    columns = mapping["columns"]
    k = session.mappings.index(mapping)
    if not mapping["run"] and mapping["torques"]:
        draw.tag("p", "Which of these blocks is the torque? Read with it:")
        draw.note(
            "Take the measured one, also where it is in A. A computed one gives back the"
            " controller's model, without friction."
        )
        with draw.tag("div", style="row"):
            for name in mapping["torques"]:
                take = partial(session.start, session.read_mapped, columns, name)
                draw.button(formatting.sentence(name), take, f"block-{k}-{name}")
    begin = "Nothing was recognised."
    if any(mapping["chosen"].values()):
        begin = "Filled in with what is recognised, or by their order: look at it."
    draw.note(f"{begin} Choose a column for each, or drag it there.")
    options = [("", "not there")]
    options += [(name, _column(mapping, at)) for at, name in enumerate(columns)]
    with (
        draw.details(f"All {len(columns)} columns", f"all-columns-{k}"),
        draw.tag("div", style="row"),
    ):
        for place, (name, text) in enumerate(options[1:]):
            cells = mapping["cells"][place]
            chip = {"draggable": "true", "data_column": name, "title": cells}
            with draw.tag("span", style="of-file", **chip):
                draw.tag("span", text)
                draw.sketch(mapping.get("sketches", {place: {}})[place])
    heading = lambda ours: _GROUPS[group_of(ours)]  # noqa: E731
    for group, of_group in groupby(mapping["chosen"], key=heading):
        with draw.tag("div", style="fields columns"):
            draw.tag("p", group, "soft")
            for ours in of_group:
                choose = partial(session.choose_column, columns, ours)
                key = f"map-{k}-{ours}"
                chosen = mapping["chosen"][ours]
                if ours == "rate":
                    label = "samples a second, without t"
                    draw.text_field(label, chosen, choose, key, "1000")
                else:
                    draw.choice(ours, options, chosen, choose, key)
    read = partial(session.start, session.read_mapped, columns)
    with draw.tag("div", style="row"):
        draw.button("Read with these columns", read, f"read-mapped-{k}")
        if not mapping["run"]:
            names = [m["name"] for m in session.refused if m["columns"] == columns]
            out = partial(session.start, session.leave_out, columns)
            label = f"Leave {formatting.words(names)} out"
            draw.button(label, out, f"leave-out-{k}", "quiet")
        if mapping["reason"]:
            draw.tag("p", session.in_words(mapping["reason"]), "soft why")


#: What the columns of our names hold.
_GROUPS = {
    "rate": "Clock [s]",
    "t": "Clock [s]",
    "q": "Positions [rad, m]",
    "dq": "Velocities, if logged",
    "tau": "Torques [N m, N or A]",
}


def _column(mapping: dict[str, Any], place: int) -> str:
    """Return a column in words: its name, its unit, and between which values it lies."""
    name = mapping["columns"][place]
    found = mapping.get("sketches", {place: {}})[place]
    unit = mapping.get("units", {place: ""})[place]
    if not found:
        return f"{name}: {mapping['cells'][place]}"
    low, high = (formatting.number(found[x]) for x in ("low", "high"))
    return f"{name}: {low} to {high} {unit}".strip()


def _your_runs(view: View) -> None:
    """Draw a zone to drop logs on, and the logs of the page's folder to tick and read."""
    session = view.session
    draw.drop("Drop measurements here", "runs")
    with draw.details("Other column names, motors, ROS topics", "reading"):
        draw.draw_form(view.forms["read"], session.reading)
        draw.note("Applies to the files that are read next.")
    with draw.details("A motion to record", "motion"):
        draw.note(
            "No joint is faster than the fastest one in the runs, or than the robot's file"
            " allows."
        )
        make = partial(session.start, session.make_motion, {}, view.download)
        draw.button("Make the motion", make, "make-motion")
    ticked: dict[str, bool] = {}
    files = {file.name: file for file in view.folder_files(ENDINGS["runs"])}
    if not files:
        return

    def read() -> None:
        session.arrived |= {
            name: file for name, file in files.items() if ticked.get(name)
        }
        session.read_arrived()

    with draw.tag("fieldset"):
        draw.tag("legend", "In your folder")
        for k, name in enumerate(files):
            draw.check(name, False, partial(ticked.__setitem__, name), f"folder-{k}")
        draw.button("Read the selected files", read, "read-folder")


def _measured_by_others(view: View) -> None:
    """Draw the button that loads the public measurements of a built-in robot."""
    data = view.session.robot["data"]
    fetch = partial(view.session.start, view.session.fetch_measured)
    draw.note(f"{data['title']}. Licence: {data['licence']}.")
    draw.button("Load the measurements", fetch, "fetch")
    draw.note(
        f"Once from github.com/{data['source']}, which needs the network; later from this"
        " computer."
    )


def _simulated(view: View) -> None:
    """Draw the form to simulate runs with a hidden effect."""
    session = view.session
    hiding = view.hiding
    kinds = effect_types()
    robot = session.robot
    if not 0 < int(hiding["joint"]) <= robot["n"]:
        hiding["joint"] = str(robot["n"])
    effects = [(n, plain_name(n)) for n in MAKERS if not kinds[n].frozen_only]
    fields = {
        "effect": ("Effect", [("none", "Nothing hidden"), *effects]),
        "joint": (
            "On joint",
            [(str(k), f"{k} {name}") for k, name in enumerate(robot["joints"], 1)],
        ),
        "level": ("Level", [(level, level) for level in LEVELS]),
    }
    with draw.tag("div", style="fields"):
        for word, (label, options) in fields.items():
            draw.choice(
                label,
                options,
                hiding[word],
                partial(hiding.__setitem__, word),
                f"hide-{word}",
            )

    def simulate() -> None:
        kind = kinds.get(hiding["effect"])
        at = [] if kind and kind.whole_robot else [int(hiding["joint"])]
        session.start(session.simulate, hiding["effect"], at, hiding["level"], SEED)

    draw.button("Simulate four runs", simulate, "simulate")


def _list(view: View) -> None:
    """Draw the table of runs with a choice of what each is used for."""
    session = view.session
    with draw.tag("div", style="wide"), draw.tag("table", style="runs"):
        draw.tag("caption", "Runs", "unseen")
        with draw.tag("thead"), draw.tag("tr"):
            for heading in ("run", "length", "samples", "use"):
                draw.tag("th", heading, scope="col")
        with draw.tag("tbody"):
            for k, run in enumerate(session.runs):
                with draw.tag("tr"):
                    draw.tag("th", run["name"], "name", scope="row")
                    draw.tag("td", f"{formatting.number(run['seconds'])} s")
                    draw.tag("td", samples_in_words(run))
                    with draw.tag("td"):
                        label = f"Use of {run['name']}"
                        use = partial(session.start, session.use, run["file"])
                        uses = [
                            (name, text)
                            for name, text in _USES
                            if (name != "split" or run["split"])
                            and (name != "wait" or run["use"] == "wait")
                        ]
                        draw.choice(
                            label, uses, run["use"], use, f"use-{k}", hidden_label=True
                        )
    for run in session.runs:
        if run["use"] == "split":
            _split_bar(run)
    if session.model and any(run["use"] != "train" for run in session.runs):
        names = [run["name"] for run in session.runs]
        again = partial(session.start, session.identify_from, names)
        what = "all of the run" if len(session.runs) == 1 else "all runs"
        draw.button(f"Identify again from {what}", again, "identify-all")
    if session.runs and all(run["use"] == "train" for run in session.runs):
        draw.note(
            "No run is kept for testing: the errors below are training errors, and a"
            " diagnosis holds out parts of the runs, which takes longer."
        )


def _split_bar(run: dict[str, Any]) -> None:
    """Draw which seconds of a run are for training and for testing.

    run : the page's record of the run; its "split" holds the windows and what to draw.
    """
    split = run["split"]
    with draw.tag("div", style="split"):
        with draw.tag("p", style="soft row"):
            train, test, between = (
                formatting.number(split[f"{side}_seconds"])
                for side in ("train", "test", "other")
            )
            whole = formatting.number(run["seconds"])
            text = f"{train} s of {whole} s to identify from"
            draw.tag("span", text, "train-words")
            text = f"{test} s to test on; the {between} s between belong to neither"
            draw.tag("span", text, "test-words")
        with draw.tag("div", style="split-bar", aria_hidden="true"):
            for part in split["bar"]:
                place = f"left:{part['left']:.2f}%;width:{part['width']:.2f}%"
                draw.tag("i", style=part["side"]).style(place)


def _measured(session: Session) -> StageVerdict | None:
    """Return the stage's mark: files that wait for their columns, or runs that are
    there."""
    if session.refused:
        return StageVerdict("usable", "", "Columns are open")
    return StageVerdict("good", "", "Done") if session.runs else None


MEASURE = Stage("measure", "Measure", "", (robot, runs), _measured)


@partial(
    PagePart,
    "check",
    "",
    lambda s: bool(s.runs),
    lambda s: (s.robot["source"], s.robot["gravity"], s.runs, s.remedies, s.repairs),
)
def check(view: View) -> None:
    """Draw the check's issues and the signals of a run, with the arm in 3D."""
    session = view.session
    units = view.session.robot["units"]
    _findings(view)
    names = [run["name"] for run in session.runs]
    first = next((run["name"] for run in session.runs if run["findings"]), names[0])

    offered = [x.change.verb for x in session.remedies if not x.refused]
    mended = "transform" in offered

    def look(run: str) -> None:
        read = session.preview(run)
        logged = session.units_as_logged(run)
        drawn.update_figure(data_chart(read, units, mended, *logged))
        move(run, read)
        clock.text = clock_in_words(run, read)

    if len(names) > 1:
        with draw.tag("div", style="pick"):
            draw.choice("Run", names, first, look, "checked-run")
    caption = "Positions, velocities and torques of all joints over time"
    drawn, move = chart_and_arm(view, caption, session.robot["drawn"], "nominal links")
    thick = "Thick: corrected values. "
    with drawn.parent_slot:
        draw.note(f"{thick if mended else ''}Drag to look closer; Play moves the arm.")
        clock = draw.tag("p", "", "soft")
    look(first)


def _findings(view: View) -> None:
    """Draw the check's issues, each once with the runs that have it, and the buttons of
    its remedies. A run without any gets a tick.
    """
    session = view.session
    for k, (words, effect, _) in enumerate(session.repairs):
        with draw.tag("div", style="row"):
            mark = "✓" if effect.get("falls", True) else "No better:"
            said = f"{mark} {label_of(words)}. {effect.get('sentence', '')}"
            draw.tag("p", said, "chosen" if mark == "✓" else "finding")
            if session.before_repair(k) is not None:
                back = partial(session.start, session.take_back, k)
                label = f"Take back: {label_of(words)}"
                key = f"take-back-{k}"
                draw.button("Take it back", back, key, "quiet", aria_label=label)
    with draw.tag("p", style="row"):
        for run in session.runs:
            if all(issue.severity == "note" for issue in run["findings"]):
                draw.tag("span", f"✓ {run['name']}", "tick")
    for k, (issue, runs) in enumerate(session.issues):
        names = formatting.words([run["name"] for run in runs])
        with draw.tag("div", style=f"finding {issue.severity}"):
            draw.tag("strong", f"{names}: {issue.title}. ")
            draw.tag("span", graded(issue.what, issue.certainty.grade))
            draw.note(session.place_in_pictures(issue, runs[0]["name"]))
            changes = [remedy.change for remedy in issue.remedies]
            is_tried = any(map(session.outcome_of, changes))
            if not is_tried:  # a trial says more
                draw.note(formatting.sentence(spoken(issue.certainty.why)))
            is_mended = any(change.verb != "cut" for change in changes)
            is_tested = all(run["use"] == "test" for run in runs)
            is_difference = issue.is_another_arm
            if is_difference and is_tested:
                draw.tag("p", "It is tested on; no model is identified from it.")
            elif not is_mended or is_unit_asked(issue):
                draw.tag("p", formatting.sentence(spoken(issue.remedy)))
            with draw.tag("div", style="row"):
                for n, change in enumerate(changes):
                    _change(view, change, f"remedy-{k}-{n}")
                is_apart = is_difference and _apart(session, runs, k)
                is_done = changes or not issue.needs_action
                measured = issue is runs[0]["findings"][0] and runs[0].get("rougher")
                if measured and (read := read_measured_torque(session)):
                    draw.button(*read, f"measured-{k}")
                elif issue.severity != "note" and not (is_apart or is_done):
                    _last_resort(session, issue, runs, k)


def _apart(session: Session, runs: list[dict[str, Any]], k: int) -> bool:
    """Draw the buttons for runs of another load or arm: to keep each out of the model,
    or, where that is so already, to look for what has changed in it; return whether
    there is one."""
    apart = [run for run in runs if run in session.differing_runs]
    if apart:
        aside = partial(session.start, session.set_aside)
        draw.button(set_aside_in_words(session.differing_runs), aside, f"aside-{k}")
    for run in apart:
        alone = partial(session.start, session.identify_from, [run["name"]])
        draw.button(f"Identify from {run['name']} alone", alone, f"alone-{k}")
    is_tested = all(run["use"] == "test" for run in runs)
    if session.model is not None and is_tested:
        find = partial(session.start, session.find_change)
        draw.button(look_in_words(session), find, f"find-{k}")
        return True
    return bool(apart)


def _last_resort(
    session: Session, issue: StoredIssue, runs: list[dict[str, Any]], k: int
) -> None:
    """Draw what can be done where nothing mends an issue of these runs: go on without
    them, or with others."""
    if len(runs) < len(session.runs):
        for run in runs:
            out = partial(session.start, session.use, run["file"], "")
            label = f"Leave {run['name']} out"
            draw.button(label, out, f"out-{k}-{run['file']}")
    else:
        if issue.severity == "warning":
            draw.note("The log is taken as it is.")
        more = {"data_to": "measure", "data_opens": "drop-runs"}
        draw.button("Choose other measurements", None, f"more-{k}", **more)


def _change(view: View, made: Change, key: str) -> None:
    """Draw the button of a remedy's change; with a field where only the person knows the
    unit. One that was tried and does not help has its outcome alone."""
    session, change = view.session, made.to_dict()
    outcome = session.outcome_of(made)
    if not (outcome is None or outcome.falls or session.meaningless):
        draw.note(outcome.sentence)
        return
    label = label_of_change(session, change)
    do: draw.Handler = partial(session.start, session.apply, change)
    asked = [k for k, v in change["arguments"].get("scale", {}).items() if not v]
    if change["verb"] == "record":
        label = label_of_motion(change)
        do = partial(session.start, session.make_motion, change, view.download)
    elif asked:
        if is_of_all_torques(made):
            label = NAME_UNIT
        do = _unit_fields(session, change, asked[0], key)
    draw.button(label, do, key)
    waiting = [x for x in session.runs if x["use"] == "wait" and asks_for_unit(x)]
    if asked and waiting:
        leave = partial(session.start, session.leave_as_read, waiting[0])
        draw.button("Leave it as it is", leave, f"{key}-as-is", "quiet")
    elif asked == ["tau"] and session.model is None and session.is_unit_open:
        identify = partial(session.start, session.identify_without_units)
        draw.button("Identify without units", identify, f"{key}-as-is", "quiet")
    if outcome is not None:
        draw.note(outcome.sentence)


def _unit_fields(
    session: Session, change: Mapping[str, Any], channel: str, key: str
) -> draw.Handler:
    """Draw a choice of units for a torque channel or positions, and a field for the
    joints' drive gains, filled in where they are published, or for their factors. Return
    what reads the channel so; where that cannot be, it says why at the field.

    change : the change that reads it; channel : its name, as `convert --scale` takes it.
    """
    is_torque = group_of(channel) == "tau"
    gains = session.published_gains if is_torque else []
    owner, of_namesake = session.gains_of_namesake if is_torque else ("", [])
    examples = _gains_offered(session) or ["10"] * session.robot["n"]
    if place := channel.removeprefix(group_of(channel)):  # of one joint
        gains, of_namesake, examples = (
            ["", *x][int(place) :][:1] for x in (gains, of_namesake, examples)
        )
    by, unit = ("gain", "N m/A") if is_torque else ("factor", "to rad, m")
    empty = UnitForm(len(examples), by, ", ".join(gains))
    form = session.unit_forms.setdefault((session.robot_word, channel), empty)

    def read() -> None:
        """Read the channel as the form says, or say what is wrong with that."""
        problem.text = form.problem
        problem.set_visibility(bool(form.problem))
        if not form.problem:
            scale = {channel: form.scale}
            filled = {**change, "arguments": {**change["arguments"], "scale": scale}}
            session.start(session.read_in_unit, filled)

    called = f"drive {by}" if is_torque else by
    options = [("", f"{called}s"), *(UNITS if is_torque else ANGLES).items()]
    with draw.tag("div", style="fields"):
        put = partial(partial, setattr, form)
        draw.choice("Read it by", options, form.unit, put("unit"), f"{key}-unit")
        label = f"{formatting.count(len(examples), called)} [{unit}], in order"
        example = f"e.g. {', '.join(examples)}"
        typed = f"{key}-gains"
        draw.text_field(label, form.gains, put("gains"), typed, example, enter=read)
    problem = draw.tag("p", "", "finding", role="alert")
    problem.set_visibility(False)
    if of_namesake:
        listed = ", ".join(of_namesake)
        draw.note(f"Published, of another arm of this name: {listed} N m/A ({owner}).")

        def take_published() -> None:
            """Read the torque by the gains that are published."""
            form.unit, form.gains = "", listed
            read()

        words, published = "Use the published gains", f"{key}-published"
        draw.button(words, take_published, published, "quiet")
    return read


def _gains_offered(session: Session) -> list[str]:
    """Return the drive gains of all joints that fit the robot's masses, which Check
    offers, or which were chosen; none where there are none."""
    changes = [x.change.arguments for x in session.remedies]
    changes += [change["arguments"] for *_, change in session.repairs]
    by_size = [x["scale"]["tau"].split(":") for x in changes if x.get("by_size")]
    return by_size[0] if by_size else []


def _checked(session: Session) -> StageVerdict:
    """Return the stage's verdict; what the check found is not said twice."""
    verdict = checked(session)
    return replace(verdict, text="") if session.warnings else verdict


CHECK = Stage("check", "Check", "Add measurements first.", (check,), _checked)
