"""What comes next: one sentence and one button, on every stage."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

from sdp_vs_penalty import formatting
from sdp_vs_penalty.api.remedies import next_remedy
from sdp_vs_penalty.diagnosis.findings import Diagnosis
from sdp_vs_penalty.page.session import MOTION, Session, asks_for_unit, is_refused
from sdp_vs_penalty.page.stages.use import worse_in_words
from sdp_vs_penalty.page.view import (
    ACCEPT,
    View,
    checked,
    graded,
    identified,
    label_of,
    label_of_motion,
    look_in_words,
    set_aside_in_words,
    spoken,
)
from sdp_vs_penalty.records import from_json, to_json
from sdp_vs_penalty.render.words import describe_outcome, describe_taken
from sdp_vs_penalty.results.remedy import Change, Remedy
from sdp_vs_penalty.signals.noise import NOISE_UNKNOWN


@dataclass(frozen=True)
class NextStep:
    """The verdict on what is there, the cause first, and the one step that follows."""

    #: The verdict.
    text: str
    #: What the button says.
    label: str
    #: Stage that the button leads to.
    stage: str
    #: What the button does besides; None for nothing.
    do: Callable[[], Any] | None = None
    #: Key of a file chooser that the button opens; "" for none.
    opens: str = ""
    #: Colour: "good", "fair", "usable", "bad", or "" for none.
    level: str = ""
    #: Label of a second choice, and what its button does; None for none.
    other: tuple[str, Callable[[], Any]] | None = None


def next_step(view: View) -> NextStep:
    """Return the verdict on a session, and its next step."""
    session = view.session
    if not session.robot:
        text = "Choose the robot that was measured: its file, or a built-in one."
        return NextStep(text, "Choose the robot's file", "measure", opens="drop-robot")
    if session.refused:
        return _columns(session)
    if not session.runs:
        joints = formatting.count(session.robot["n"], "joint")
        text = f"{session.robot_word} has {joints}. Its measurements come next."
        return NextStep(text, "Choose measurements", "measure", opens="drop-runs")
    waiting = [run for run in session.runs if run["use"] == "wait"]
    for run in waiting:  # its rows first: what is stated of others is of good ones
        if is_refused(run):
            return _of_waiting(session, run)
    if (offer := session.offer) is not None:
        do = partial(session.start, session.accept, offer)
        label = ACCEPT.format(offer.run["name"])
        return NextStep(offer.sentence, label, "check", do, level="usable")
    if waiting:
        return _of_waiting(session, waiting[0])
    return _of_runs(session) if session.model is None else _of_model(view)


def _of_waiting(session: Session, run: Mapping[str, Any]) -> NextStep:
    """Return what is wrong with a run that waits, and what mends it, or to leave it out."""
    found = [x for x in run["findings"] if x["severity"] != "note"]
    remedies = [from_json(Remedy, x) for issue in found for x in issue["remedies"]]
    remedy = next_remedy(remedies)
    refused = [x["change"] for x in session.remedies if "refused" in x]
    if remedy is not None and to_json(remedy.change) not in refused:
        do = partial(session.start, session.apply, to_json(remedy.change))
        label = label_of(remedy.change.words)
        text = graded(remedy.problem, remedy.certainty)
    elif asks_for_unit(run) and not is_refused(run):
        return _unit(session, "usable")
    else:
        do = partial(session.start, session.use, run["file"], "")
        label = f"Leave {run['name']} out"
        text = found[0]["what"] if found else "its torque is in another unit."
    return NextStep(f"{run['name']}: {text}", label, "check", do, level="bad")


def _columns(session: Session) -> NextStep:
    """Return the step that shows how columns of refused files are filled in, and then
    the one that reads them so."""
    first = session.refused[0]
    same = [m["name"] for m in session.refused if m["columns"] == first["columns"]]
    if first.get("tried") == first["chosen"]:  # it is not for want of columns
        do = partial(session.start, session.leave_out, first["columns"])
        text = formatting.sentence(session.in_words(first["reason"]))
        label = f"Leave {formatting.words(same)} out"
        return NextStep(text, label, "measure", do, level="usable")
    text = f"{formatting.words(same)}: say which column is what."
    if not first.get("seen"):
        see = partial(session.see_columns, first["columns"])
        return NextStep(text, "See the columns", "measure", see, level="usable")
    do = partial(session.start, session.read_mapped, first["columns"])
    return NextStep(text, "Read with these columns", "measure", do, level="usable")


def _of_runs(session: Session) -> NextStep:
    """Return what the check says of the runs: the first remedy, or to identify."""
    remedies = [
        from_json(Remedy, {k: v for k, v in x.items() if k != "effect"})
        for x in session.remedies
        if "refused" not in x
    ]
    remedy = next_remedy([_with_published_gains(session, x) for x in remedies])
    if remedy is not None:
        change = remedy.change
        do = partial(session.start, session.apply, change.to_dict())
        label = label_of(change.words)
        level = "bad" if session.meaningless else "usable"
        text = graded(remedy.problem, remedy.certainty)
        if session.repairs_several(change.to_dict()):
            text = graded(f"{session.faults_in_words}.", remedy.certainty)
        effect = session.outcome_of(change.to_dict())
        return NextStep(f"{text} {effect}".strip(), label, "check", do, level=level)
    of_check = checked(session)
    is_open = any(map(asks_for_unit, session.runs))
    if is_open and not session.meaningless:
        return _unit(session, of_check.level)
    for run in session.differing_runs:
        do = partial(session.start, session.use, run["file"], "test")
        label = set_aside_in_words(run)
        return NextStep(of_check.text, label, "check", do, level=of_check.level)
    if not {*session.kinds_of_issue} <= {*session.seen_issues}:
        label, see = "See what Check found", session.see_issues
        return NextStep(of_check.text, label, "check", see, level=of_check.level)
    if text := session.impossible:
        label = "Choose other measurements"
        return NextStep(text, label, "measure", opens="drop-runs", level="bad")
    if session.meaningless:
        text = (
            f"{session.meaningless[0]} What is identified from it may be worth nothing."
        )
        do = partial(session.start, session.identify_anyway)
        return NextStep(text, "Identify anyway", "identify", do, level="bad")
    do = partial(session.start, session.identify)
    label = "Identify the model"
    return NextStep(of_check.text, label, "identify", do, level=of_check.level)


def _unit(session: Session, level: str) -> NextStep:
    """Return the step to the fields in which Check asks for the unit of all torques."""
    text, field = "", ""
    for k, (issue, _) in reversed([*enumerate(session.issues)]):
        for n, remedy in enumerate(issue["remedies"]):
            if remedy["change"]["arguments"].get("scale") == {"tau": None}:
                text = graded(issue["what"], remedy["certainty"])
                field = f"remedy-{k}-{n}-gain-1"
    label = "Say the unit, or the drive gains"
    return NextStep(text, label, "check", opens=field, level=level)


def _with_published_gains(session: Session, remedy: Remedy) -> Remedy:
    """Return a remedy that asks for the unit of all torques with the published drive
    gains of the robot; without these, and any other remedy, as it is."""
    gains = [*session.published_gains.values()]
    if remedy.change.arguments.get("scale") != {"tau": None} or not all(gains):
        return remedy
    words = "read the torque by the published drive gains"
    change = Change("read", words, {"scale": {"tau": ":".join(gains)}})
    return replace(remedy, change=change)


def _of_model(view: View) -> NextStep:
    """Return the verdict on the model, and to diagnose, add, or use it.

    The first model is diagnosed before it is used, whatever its grade, and so is one
    that is still not good with what was added; one of a log without torque cannot be.
    """
    session = view.session
    of_model = identified(session)
    assert of_model is not None  # there is a model
    level, text = of_model.level, f"{of_model.word}. {_taken(session)}{of_model.text}"
    diagnosis = session.findings_of_current
    is_first = len(session.history) == 1
    is_done = session.current.servo or (level == "good" and not is_first)
    file = session.current.made_for
    if file and file not in session.taken:
        do = partial(session.download, file, view.download)
        return NextStep(text, f"Download {file}", "use", do, level=level)
    is_done = is_done or bool(file)
    if changed := session.current.change_in_words(session.robot["units"]):
        if found := session.fault_of_changed_run:
            text = f"{of_model.word}. {found}"
            label, see = "See what Check found", session.see_issues
            return NextStep(text, label, "check", see, level=level)
        do = partial(session.start, session.find_change)
        text = f"{of_model.word}. {changed}"
        return NextStep(text, look_in_words(session), "diagnose", do, level=level)
    if diagnosis is None and not is_done:
        do = partial(session.start, session.diagnose)
        label = "Diagnose: what is missing?" if is_first else "Diagnose again"
        other: tuple[str, Callable[[], Any]] | None = None
        if len(session.past[-1][1]["runs"]) < len(session.runs):  # they came just now
            names = [run["name"] for run in session.runs]
            again = partial(session.start, session.identify_from, names)
            other = "Or identify again from all runs", again
        return NextStep(text, label, "diagnose", do, level=level, other=other)
    if diagnosis is not None:
        cause = spoken(diagnosis.cause)
        remedy = next_remedy(diagnosis.remedies)
        if remedy is not None:
            return _to_add(session, diagnosis, remedy, level)
        if diagnosis.noise_known and not diagnosis.is_open:
            text = f"{of_model.word}."  # the cause names the error
        if NOISE_UNKNOWN in cause:  # the reason says it too
            text = text.replace(f"; {NOISE_UNKNOWN}", "")
        text = f"{text} {cause}"
        if level != "good" and (motion := _motion_to_record(view)) is not None:
            return replace(motion, text=f"{text} {motion.text}", level=level)
        if level == "bad":
            label = "Choose other measurements"
            return NextStep(text, label, "measure", opens="drop-runs", level=level)
    if "report.html" in session.taken:
        text = "The report is made. Test the model on a run that nothing has used yet."
        return NextStep(
            text, "Choose a new run", "measure", opens="drop-runs", level=level
        )
    text = f"{text} {worse_in_words(session.current)}".rstrip()
    do = partial(session.download, "report.html", view.download)
    return NextStep(text, "Download the report", "use", do, level=level)


def _to_add(
    session: Session, diagnosis: Diagnosis, remedy: Remedy, level: str
) -> NextStep:
    """Return the step that adds what helps by the first remedy of a diagnosis: what is
    confident alone, where more helps, and all of it as a second choice."""
    main = diagnosis.main_finding
    change = remedy.change
    other: tuple[str, Callable[[], Any]] | None = None
    alone = diagnosis.confident_remedy
    if alone is not None and change.arguments.get("findings") == "helpful":
        all_of_it = partial(session.start, session.apply, change.to_dict())
        other = f"Or {change.words}", all_of_it
        remedy, change = alone, alone.change
    text = spoken(diagnosis.cause)
    joint = None if main is None else main.main_joint
    share = session.current.facts["error_beyond_noise"]
    if main is not None and diagnosis.is_within_noise(main):
        text = f"{session.current.within_noise} {text}".lstrip()
    elif joint is not None and share.value is not None:
        percent = share.of_joint(joint)
        torque = f"{percent} % of joint {joint}'s torque beyond the noise"
        text = f"{text} The error is {torque}."
    outcome = describe_outcome(remedy, session.robot["units"], joint)
    if outcome:
        text = f"{text} {formatting.sentence(outcome)}"
    do = partial(session.start, session.apply, change.to_dict())
    label = label_of(change.words)
    return NextStep(text, label, "diagnose", do, level=level, other=other)


def _taken(session: Session) -> str:
    """Say what the last addition took of the error; "" for a first model."""
    if len(session.history) == 1:
        return ""
    if file := session.current.made_for:
        n_lost = session.history[-2].exported[file]["n_lost"]
        effects = formatting.count(n_lost, "effect")
        return f"Identified without the {effects} that {file} cannot hold. "
    before, after = (step.comparison["rmse"] for step in session.history[-2:])
    floor = session.current.comparison["noise_floor"]
    return f"{describe_taken(session.current.added, before, after, floor)} "


def _motion_to_record(view: View) -> NextStep | None:
    """Return the step that records a motion which shows more. It is for a model that
    errs where nothing is known to add; None where no motion is advised."""
    session = view.session
    if MOTION in session.taken:
        text, label = "The motion's log comes next.", "Choose the log"
        return NextStep(text, label, "measure", opens="drop-runs")
    diagnosis = session.findings_of_current
    of_diagnosis = () if diagnosis is None else to_json(diagnosis.remedies)
    for remedy in (*session.remedies, *of_diagnosis):
        if (change := remedy["change"])["verb"] == "record":
            do = partial(session.start, session.make_motion, change, view.download)
            return NextStep(
                graded(remedy["problem"], "certain"),
                label_of_motion(change),
                "measure",
                do,
            )
    if len(session.runs) == 1:
        text = "One run alone tells little: record another motion."
        do = partial(session.start, session.make_motion, {}, view.download)
        return NextStep(text, "Make a motion for a second run", "measure", do)
    return None
