"""What comes next: one sentence and one button, on every stage."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

from sdp_vs_penalty import formatting
from sdp_vs_penalty.api.remedies import next_remedy
from sdp_vs_penalty.diagnosis.constants import MINOR
from sdp_vs_penalty.diagnosis.finding import (
    Finding,
    Retune,
    constants_in_words,
    named_on_joints,
)
from sdp_vs_penalty.diagnosis.findings import Diagnosis
from sdp_vs_penalty.diagnosis.offers import Group
from sdp_vs_penalty.effects.plain_words import ON_THE_ARM, written_in_words
from sdp_vs_penalty.estimation.verdict import LOG
from sdp_vs_penalty.exporters.export import FILES_TO_TAKE
from sdp_vs_penalty.page.model_step import joints_of
from sdp_vs_penalty.page.models import MOTION
from sdp_vs_penalty.page.run_issues import asks_for_unit, is_of_all_torques, is_refused
from sdp_vs_penalty.page.session import Session
from sdp_vs_penalty.page.spoken import label_of, repairs_in_words, spoken
from sdp_vs_penalty.page.unit_form import NAME_UNIT
from sdp_vs_penalty.page.view import (
    StageVerdict,
    View,
    arm_in_words,
    changes_in_words,
    checked,
    graded,
    identified,
    in_brief,
    label_of_change,
    label_of_motion,
    look_in_words,
    measured_on,
    read_measured_torque,
    set_aside_in_words,
)
from sdp_vs_penalty.render.diagnosis_words import SOME_ERROR_IS_LEFT, main_cause
from sdp_vs_penalty.render.words import describe_harm, describe_unexplained
from sdp_vs_penalty.results.remedy import GUESSES, SURE, Change, Remedy


@dataclass(frozen=True)
class NextStep:
    """The verdict on what is there, the cause first, and the one step that follows."""

    #: The verdict, in one line.
    text: str
    #: What the button says; "" for none, while it is not known what helps.
    label: str
    #: Stage that the button leads to.
    stage: str
    #: What the button does besides; None for nothing.
    do: Callable[[], Any] | None = None
    #: Key of a file chooser that the button opens; "" for none.
    opens: str = ""
    #: Colour: "good", "usable", "bad", or "" for none.
    level: str = ""
    #: A second choice, of which the button counts, and its own second one as a third;
    #: None for none.
    other: NextStep | None = None
    #: What the step does to an error, or how large one is, and what that is measured on;
    #: "" where nothing is measured.
    number: str = ""
    #: What it does to the errors, in brief, of a step that adds something.
    outcome: str = ""
    #: What else is known.
    more: str = ""
    #: Stage and part in which that number is drawn.
    figure: tuple[str, str] = ("diagnose", "history")

    @property
    def choices(self) -> tuple[NextStep, ...]:
        """The step and its other choices."""
        return (self, *(self.other.choices if self.other else ()))


def next_step(view: View) -> NextStep:
    """Return the verdict on a session, and its next step."""
    step = _find_step(view)
    if view.session.model is not None:
        step = _with_doubt_of_log(view.session, step)
        if changed := repairs_in_words(view.session.repairs):
            number = step.number and f"{step.number.rstrip('.')}. "
            figure = step.figure if number else ("check", "check")
            number = f"{number}Judged with the data changed."
            more = _sentences(step.more, f"Changed: {changed}")
            step = replace(step, number=number, more=more, figure=figure)
        is_computed = any(run.get("rougher") for run in view.session.runs)
        said = "The torque was computed by a controller, not measured. "
        return (
            replace(step, text=said + step.text, level="bad") if is_computed else step
        )
    if len(step.text) <= _MOST_IN_LINE:
        return step
    first, *others = re.split(r"(?<=[.?!]) ", step.text, maxsplit=1)
    return replace(step, text=first, more=_sentences(step.more, *others))


def _sentences(*texts: str) -> str:
    """Return several texts as one, each with a stop at its end."""
    return " ".join(f"{text.rstrip('.')}." for text in texts if text)


def _with_doubt_of_log(session: Session, step: NextStep) -> NextStep:
    """Return a step with what the check leaves in doubt of the runs, until that is settled,
    and the way there as the second choice where there is none."""
    lines = session.current.verdict.lines
    if session.is_unit_open:
        is_said = any(spoken(x.text) in step.text for x in lines if x.about == LOG)
        said = (
            "" if is_said else " The torques' unit is open, and so are the kilograms."
        )
        other = step.other or _name_unit(session)
        return replace(step, text=f"{step.text}{said}", other=other)
    if session.has_gains_by_size:
        (doubt,) = [spoken(line.text) for line in lines if line.about == LOG] or [""]
        is_said = doubt in f"{step.text} {step.number}"
        text = f"{step.text} {doubt * (not is_said)}".rstrip()
        return replace(step, text=text, other=step.other or _name_unit(session))
    if step.other is None and any(line.about == LOG for line in lines):
        label = "Or see what Check says"
        other = NextStep("", label, "check", session.see_issues)
        return replace(step, other=other)
    return step


#: Characters of a verdict that stands in view as it is; the rest of a longer one is
#: folded.
_MOST_IN_LINE = 120


def _find_step(view: View) -> NextStep:
    """Return the next step, with all of the verdict in its text before there is a
    model."""
    session = view.session
    if not session.robot:
        text = "Choose the robot that was measured (its URDF), and its logs."
        label = "Choose the URDF and the logs"
        return NextStep(text, label, "measure", opens="drop-robot")
    if session.refused:
        return _columns(session)
    if not session.runs:
        joints = formatting.count(session.robot["n"], "joint")
        text = f"{session.robot_word} has {joints}. Its measurements come next."
        return NextStep(text, "Choose measurements", "measure", opens="drop-runs")
    waiting = [run for run in session.runs if run["use"] == "wait"]
    if waiting:  # what is refused first
        return _of_waiting(session, max(waiting, key=is_refused))
    return _of_runs(session) if session.model is None else _of_model(view)


def _of_waiting(session: Session, run: Mapping[str, Any]) -> NextStep:
    """Return what is wrong with a run that waits, and what mends it, or to leave it out."""
    found = [x for x in run["findings"] if x.severity != "note"]
    remedies = [x for issue in found for x in issue.remedies]
    remedy = next_remedy(remedies)
    refused = [x.change for x in session.remedies if x.refused]
    if remedy is not None and remedy.change not in refused:
        do = partial(session.start, session.apply, remedy.change.to_dict())
        label = label_of(remedy.change.words)
        text = graded(remedy.problem, remedy.certainty)
    elif asks_for_unit(run) and not is_refused(run):
        return _unit(session, "usable")
    else:
        do = partial(session.start, session.use, run["file"], "")
        label = f"Leave {run['name']} out"
        text = found[0].what if found else "its torque is in another unit."
    return NextStep(f"{run['name']}: {text}", label, "check", do, level="bad")


def _columns(session: Session) -> NextStep:
    """Return the step that reads refused files with their columns as filled in."""
    first = session.refused[0]
    same = [m["name"] for m in session.refused if m["columns"] == first["columns"]]
    if first.get("tried") == first["chosen"]:  # it is not for want of columns
        do = partial(session.start, session.leave_out, first["columns"])
        text = formatting.sentence(session.in_words(first["reason"]))
        label = f"Leave {formatting.words(same)} out"
        return NextStep(text, label, "measure", do, level="usable")
    text = f"{formatting.words(same)}: say which column is what."
    label = "Read with these columns"
    chosen = first["chosen"].items()
    if any(at.items() <= chosen for at in first["torques"].values()):
        n, block = len(first["torques"]), next(iter(first["torques"]))
        text = f"{formatting.words(same)}: which of {n} blocks is the torque?"
        field = f"block-{session.mappings.index(first)}-{block}"
        label = "Choose the block of torques"
        return NextStep(text, label, "measure", opens=field, level="usable")
    do = partial(session.start, session.read_mapped, first["columns"])
    return NextStep(text, label, "measure", do, level="usable")


def _of_runs(session: Session) -> NextStep:
    """Return what the check says of the runs: the first remedy, or to identify. First
    comes what makes all else meaningless, a torque that was not measured; one that does not
    lower the error on motion left out is not offered, and none before it was tried."""
    if computed := _of_computed_torque(session):
        return computed
    allowed = [x for x in session.remedies if not x.refused]
    remedies = [_with_published_gains(session, x) for x in allowed]
    remedies.sort(key=lambda x: not _may_help(session, x.change))
    remedy = _of_refused_run(session) or next_remedy(remedies)
    if remedy is None:
        return _as_logged(session)
    if remedy.change.verb != "read" and remedy.change.to_dict() in session.untried:
        text = graded(remedy.problem, remedy.certainty)
        number = "What would repair it is being tried."
        level, figure = "usable", ("check", "check")
        return NextStep(text, "", "check", level=level, number=number, figure=figure)
    change = remedy.change
    do = partial(session.start, session.apply, change.to_dict())
    label = label_of_change(session, change.to_dict())
    level = "bad" if session.meaningless else "usable"
    text = graded(remedy.problem, remedy.certainty)
    if faults := session.faults_in_words(change.to_dict()):
        text = graded(f"{faults}.", remedy.certainty)
    why = formatting.sentence(spoken(remedy.why))  # until it was tried
    outcome = session.outcome_of(change)
    number = why if outcome is None else outcome.sentence
    said: dict[str, Any] = {"number": number, "figure": ("check", "check")}
    if not (_may_help(session, change) or session.meaningless):
        return replace(_as_logged(session, text), **said)
    if change.arguments.get("by_size"):  # a guess: what a person knows comes first
        guess = NextStep("", label, "check", do)
        typed = replace(_settle_doubt(session), text=text, level=level)
        return replace(typed, number=number, figure=("check", "check"), other=guess)
    is_unit = change.verb == "read" and any(map(asks_for_unit, session.runs))
    said["other"] = _name_unit(session) if is_unit else None
    return NextStep(text, label, "check", do, level=level, **said)


def _of_computed_torque(session: Session) -> NextStep | None:
    """Return the step that reads the measured torque in place of one that a controller
    computed; None where there is none."""
    if (read := read_measured_torque(session)) is None:
        return None
    label, do = read
    issue = next(run for run in session.runs if run.get("rougher"))["findings"][0]
    text = graded(issue.what, issue.certainty.grade)
    identify = partial(session.start, session.identify)
    words = "Or identify what the controller computes"
    other = NextStep("", words, "identify", identify)
    return NextStep(text, label, "measure", do, level="bad", other=other)


def _of_refused_run(session: Session) -> Remedy | None:
    """Return what may mend an error of a run in use where no remedy is likely: before it
    nothing is identified, and no other repair can be tried; None without one."""
    for issue, runs in session.issues:
        if issue.severity != "error" or all(run["use"] == "wait" for run in runs):
            continue
        repairs = [x for x in issue.remedies if x.change.verb == "transform"]
        if repairs and all(x.certainty in GUESSES for x in issue.remedies):
            return repairs[0]
    return None


def _may_help(session: Session, change: Change) -> bool:
    """Return whether a repair lowers the error on motion left out, or was not tried."""
    outcome = session.outcome_of(change)
    return outcome is None or outcome.falls


def _as_logged(session: Session, said: str = "") -> NextStep:
    """Return the step where the runs stay as they are, to identify in the end; ``said``:
    of an issue, which need not be looked at where it is the only one."""
    of_check = checked(session)
    of_check = replace(of_check, text=said or of_check.text)
    is_open = any(map(asks_for_unit, session.runs))
    if is_open and not session.meaningless:
        return _unit(session, of_check.level)
    if apart := session.differing_runs:
        do = partial(session.start, session.set_aside)
        label = set_aside_in_words(apart)
        return NextStep(of_check.text, label, "check", do, level=of_check.level)
    if len(session.kinds_of_issue) > bool(said) and session.kinds_to_see:
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
    text, _ = _question_of_unit(session)
    step = replace(_name_unit(session), text=text, level=level)
    label = step.label.removeprefix("Or ")
    do = partial(session.start, session.identify_without_units)
    other = NextStep("", "Or identify without units", "identify", do)
    is_new = session.model is None
    return replace(
        step, label=formatting.sentence(label), other=other if is_new else None
    )


def _settle_doubt(session: Session) -> NextStep:
    """Return the step that settles what is in doubt of the log."""
    if session.is_unit_open or session.has_gains_by_size:
        return replace(_name_unit(session), label=NAME_UNIT)
    return NextStep("", "See what Check says", "check", session.see_issues)


def _name_unit(session: Session) -> NextStep:
    """Return the second choice to name the unit of all torques in the fields of Check."""
    label = f"Or {NAME_UNIT[0].lower()}{NAME_UNIT[1:]}"
    return NextStep("", label, "check", opens=_question_of_unit(session)[1])


def _question_of_unit(session: Session) -> tuple[str, str]:
    """Return how Check asks for the unit of all torques, and its field."""
    text, field = "", ""
    for k, (issue, _) in reversed([*enumerate(session.issues)]):
        for n, remedy in enumerate(issue.remedies):
            if is_of_all_torques(remedy.change):
                text = graded(issue.what, remedy.certainty)
                field = f"remedy-{k}-{n}-gains"
    return text, field


def _with_published_gains(session: Session, remedy: Remedy) -> Remedy:
    """Return a remedy that asks for the unit of all torques with the published drive
    gains of the robot; without these, and any other remedy, as it is."""
    gains = session.published_gains
    if not (gains and is_of_all_torques(remedy.change)):
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
    level = of_model.level
    headline, more = of_model.text, session.current.noise_in_words
    text = f"{of_model.word}. {headline}"
    number = formatting.sentence(f"measured {measured_on(session)}")
    if len(session.history) > 1:
        below, current = session.history[-2:]
        errors = [x.comparison["rmse"] for x in (below, current)]
        number = changes_in_words(session, below.worst_joint, *errors)
        number = formatting.sentence(number)
        more = _sentences(_added(session), arm_in_words(session), more)
    diagnosis = session.findings_of_current
    known: dict[str, Any] = {"level": level, "number": number, "more": more}
    if len(session.history) == 1 and diagnosis is None:
        known["figure"] = "identify", "fit"
    is_first = len(session.history) == 1
    in_doubt = session.current.verdict.is_lowered_by_log_alone
    if not (is_first or level == "good" or in_doubt) and session.current.failures:
        failures = session.current.where_it_fails
        text += describe_unexplained(failures, session.current.worst_joint, None)
    is_done = session.current.servo or (level == "good" and not is_first)
    remedy = None if diagnosis is None else next_remedy(diagnosis.remedies)
    if remedy is None and (differs := _of_differing_test(session, of_model)):
        return differs
    if diagnosis is None and not is_done:
        do = partial(session.start, session.diagnose)
        label = "Diagnose: what is missing?" if is_first else "Diagnose again"
        other = _rest_to_add(session)
        if len(session.past[-1][1]["runs"]) < len(session.runs):  # they came just now
            names = [run["name"] for run in session.runs]
            again = partial(session.start, session.identify_from, names)
            other = NextStep("", "Or identify again from all runs", "diagnose", again)
        return NextStep(text, label, "diagnose", do, other=other, **known)
    if diagnosis is not None:
        if remedy is not None:
            change = remedy.change
            if change.verb != "transform":
                return _to_add(view, diagnosis, remedy, level)
            text = f"{of_model.word}. {graded(remedy.problem, remedy.certainty)}"
            do = partial(session.start, session.apply, change.to_dict())
            return NextStep(text, label_of(change.words), "check", do, **known)
        said, why = _without_remedy(session, diagnosis)
        harm, _, what_may_help = describe_harm(diagnosis).partition(". ")
        text = _sentences(of_model.word, said, harm)
        known["more"] = _sentences(what_may_help, why, more)
        known["number"] = f"{headline} Measured {measured_on(session)}."
        lines = session.current.verdict.lines
        may_be_the_log = any(x.about == LOG for x in lines)
        may_be_the_log &= not session.is_unit_left_open  # that question was answered
        if in_doubt or (harm and may_be_the_log):  # a repair comes first
            step, other = _settle_doubt(session), _report(view)
            if session.is_unit_left_open:  # that question was answered
                step, other = _use_as_it_is(view), _name_unit(session)
            return replace(step, text=text, other=other, **known)
        if level != "good":
            return _of_unexplained(view, diagnosis, text, known)
    test = NextStep(text, "Test it on a new run", "measure", opens="drop-runs")
    if "report.html" in session.taken:
        return replace(test, **known)
    return replace(_report(view), text=text, other=test, **known)


def _of_differing_test(session: Session, of_model: StageVerdict) -> NextStep | None:
    """Return the step that looks into a test run in which the model errs far more than in
    those that it is from: at a fault of its log, or for what has changed on the arm; None
    where neither is to be seen."""
    fault = session.fault_of_differing_test
    changed = session.current.change_in_words(session.torque_units)
    look = None
    if changed:
        words, do = look_in_words(session), partial(session.start, session.find_change)
        text = f"{of_model.word}. {changed}"
        look = NextStep(text, words, "diagnose", do, level=of_model.level)
    if not fault:
        return look
    if look is not None:
        words = f"Or {look.label[0].lower()}{look.label[1:]}"
        look = replace(look, text="", label=words)
    text, label = f"{of_model.word}. {fault}", "See what Check found"
    level, see = of_model.level, session.see_issues
    return NextStep(text, label, "check", see, level=level, other=look)


def _report(view: View) -> NextStep:
    """Return the step that downloads the report."""
    do = partial(view.session.download, "report.html", view.download)
    return NextStep("", "Download the report", "use", do)


def _use_as_it_is(view: View) -> NextStep:
    """Return the step for a model to which nothing is to be added: its report, then a test
    on a run that nothing was chosen by."""
    if "report.html" not in view.session.taken:
        return _report(view)
    return NextStep("", "Test it on a new run", "measure", opens="drop-runs")


def _without_remedy(session: Session, diagnosis: Diagnosis) -> tuple[str, str]:
    """Return what a diagnosis that adds nothing has found, and why; of an error beyond the
    noise what it follows."""
    model = session.current
    is_within_noise = (
        model.verdict.grade == "good" or model.verdict.is_lowered_by_log_alone
    )
    cause = spoken(main_cause(diagnosis))
    if is_within_noise or not model.failures:
        return in_brief(cause), ""
    found = bool(diagnosis.effects)
    return describe_unexplained(model.where_it_fails, model.worst_joint, found), cause


def _of_unexplained(
    view: View, diagnosis: Diagnosis, text: str, known: Mapping[str, Any]
) -> NextStep:
    """Return the step of a model whose error nothing sure explains: its measured curve
    where that helps, or the motion that decides what is open of the joint that errs most;
    else a model that can be used is used as it is."""
    more = known["more"]
    report = replace(_report(view), label="Or use it as it is: download the report")
    motion, is_asked = _motion_to_record(view)
    if curve := _curve_to_add(view.session, diagnosis):
        number = curve.number or known["number"]
        how = {"text": text, "number": number, "more": _sentences(more, curve.text)}
        return replace(curve, **{**known, **how, "other": report})
    more = _sentences(more, motion.text)
    if known["level"] == "bad":
        other = NextStep("", "Choose other measurements", "measure", opens="drop-runs")
        return replace(motion, **{**known, "text": text, "more": more, "other": other})
    if is_asked:
        return replace(motion, **{**known, "text": text, "more": more, "other": report})
    more = _sentences(known["more"], _AS_FAR_AS_IT_GOES)
    words = f"Or {motion.label[:1].lower()}{motion.label[1:]}"
    other = replace(motion, text="", label=words)
    how = {"text": text, "more": more, "other": other}
    return replace(_use_as_it_is(view), **{**known, **how})


#: What is said of what was found beside an error that it does not lower.
_LOWERS_IT_NOT = "What was found does not lower that."
#: What is said of a model that can be used, and for which nothing is left to do.
_AS_FAR_AS_IT_GOES = (
    "This is as far as these runs lead: the model can be used as it is, with this error."
    " Another motion may show what it is"
)


def _curve_to_add(session: Session, diagnosis: Diagnosis) -> NextStep | None:
    """Return the step that adds the measured curve which explains most of an error on
    data left out; None where none lowers one."""
    added = session.current.effects
    curves = [
        (curve.explained_share, curve.joint, text)
        for curve, text in zip(
            diagnosis.curves, session.diagnosed.curve_texts, strict=True
        )
        if text not in added
        if curve.held_out_rmse_after < (1.0 - MINOR) * curve.held_out_rmse_before
    ]
    if not curves:
        return None
    _, joint, text = max(curves)
    words = f"add the measured curve of joint {joint}"
    change = Change("add", words, {"effects": [text]}).to_dict()
    do = partial(session.start, session.apply, change)
    curve = next(curve for curve in diagnosis.curves if curve.joint == joint)
    errors = curve.held_out_rmse_before, curve.held_out_rmse_after
    amounts = formatting.amounts(errors, diagnosis.torque_unit(joint))
    number = (
        f"With it, joint {joint}'s error: {amounts} ({formatting.change_of(*errors)}),"
        f" {measured_on(session)}."
    )
    text = "It has no name; as it was measured it can be added"
    return NextStep(text, label_of(words), "diagnose", do, number=number)


def _to_add(
    view: View, diagnosis: Diagnosis, all_of_it: Remedy, level: str
) -> NextStep:
    """Return the step that adds what is advised, and the other choices beside it, each with
    what it does. The report comes before it where it does not lower the largest error of a
    model that can be used, or no file can hold it beside one that is good."""
    session = view.session
    remedy, *others = diagnosis.offers.choices or (all_of_it,)
    change = remedy.change
    texts = change.arguments.get("effects", [])
    main = diagnosis.offers.main_finding
    if main is not None and {*texts} == {main.text}:
        others += filter(None, [diagnosis.offers.offer_of_held_law(main)])
    other = None
    for second in others[::-1]:
        add = partial(session.start, session.apply, second.change.to_dict())
        done = _outcome_in_brief(session, second)
        words = f"Or {second.change.words}"
        other = NextStep("", words, "diagnose", add, outcome=done, other=other)
    text, beside = _in_one_line(diagnosis, texts)
    text = text or in_brief(spoken(main_cause(diagnosis)))
    if level == "good":
        text = f"Good already. {SOME_ERROR_IS_LEFT}. {formatting.sentence(text)}"
    text = formatting.sentence(text)
    if texts and all(map(session.is_of_held_model, texts)):
        text = f"Since then changed, beside what the model has: {text}"
        return _identify_again(session, text, level, beside)
    number = ""
    lacking = diagnosis.offers.files_lacking(texts)
    is_idle = level == "good" and {*FILES_TO_TAKE} <= {*lacking}
    if outcome := diagnosis.offers.outcome_of(remedy):
        is_idle |= level != "bad" and not outcome.falls(session.current.worst_joint)
        n_added = {1: "it", 2: "both"}.get(len(texts), f"all {len(texts)}")
        does = outcome.in_words(session.current.worst_joint)
        number = f"On data left out, with {n_added}: {does}."
    do = partial(session.start, session.apply, change.to_dict())
    said: dict[str, Any] = {
        "text": text,
        "level": level,
        "number": number,
        "more": _sentences(beside),
        "outcome": _outcome_in_brief(session, remedy),
    }
    if is_idle:
        done = said.pop("outcome")
        words = f"Or {change.words}"
        other = NextStep("", words, "diagnose", do, outcome=done)
        if level != "good":
            of_model = identified(session)
            assert of_model is not None  # there is a model
            found = f"Found: {text[:1].lower()}{text[1:]}"
            said["more"] = _sentences(found, beside)
            said["text"] = f"{of_model.word}. {of_model.text} {_LOWERS_IT_NOT}"
        return replace(_use_as_it_is(view), other=other, **said)
    label = label_of(change.words)
    return NextStep(label=label, stage="diagnose", do=do, other=other, **said)


def _outcome_in_brief(session: Session, offer: Remedy) -> str:
    """Say what an offer of the current model's diagnosis does to the errors; "" where that
    was not computed."""
    diagnosis = session.findings_of_current
    outcome = diagnosis and diagnosis.offers.outcome_of(offer)
    return f"{outcome.in_brief(session.current.worst_joint)}" if outcome else ""


def _identify_again(session: Session, text: str, level: str, more: str) -> NextStep:
    """Return the step that identifies the effects of a model, which was fixed, again."""
    names = [run["name"] for run in session.runs]
    label = f"Identify again from {formatting.words(names)}"
    do = partial(session.start, session.identify)
    return NextStep(text, label, "identify", do, level=level, more=more)


def _rest_to_add(session: Session) -> NextStep | None:
    """Return the step that adds what else helps of what the last diagnosis found; None
    where all of it is in the model."""
    found = () if session.findings is None else session.findings.offers.helping
    texts = [finding.text for finding in found if finding.text not in session.added]
    if not texts:
        return None
    words = f"add the {formatting.count(len(texts), 'other')} that help"
    change = Change("add", words, {"effects": texts}).to_dict()
    add = partial(session.start, session.apply, change)
    return NextStep("", f"Or {words}", "diagnose", add)


def _in_one_line(diagnosis: Diagnosis, texts: Collection[str]) -> tuple[str, str]:
    """Return a sentence on what counts most of what is added by its ``texts``, on the arm,
    with what is open of it, and one on what is added beside it: the cards say how sure each
    of that is. Both are "" for what the diagnosis did not find."""
    main, others = "", list[Finding | Retune]()
    for group in diagnosis.offers.groups_in_order_of_reading:
        first = group.first
        if first.text not in texts:
            continue
        is_open = first.size_may_be_zero and not first.says_open_law
        if main or others or (is_open and not group.is_sum):
            others += group.findings
        else:
            on_the_arm = in_brief(group.on_the_arm.removeprefix(ON_THE_ARM))
            main = f"{on_the_arm.rstrip('.')}{_what_is_open(group)}."
    constants = [f for f in diagnosis.retuned if f.text in texts]
    names = [named_on_joints(others)] if others else []
    if constants:
        names.append(constants_in_words(constants))
    listed = "; ".join(names)
    if not main:
        return f"{listed}." * bool(listed), ""
    return main, f"Beside it: {listed}" * bool(listed)


def _what_is_open(group: Group) -> str:
    """Say what is open of something that was found, as the end of a sentence; "" of what is
    confident, and of a sum, of which the sentence says it."""
    first = group.first
    if group.is_sum or first.rating in SURE or first.says_open_law:
        return ""
    if first.rivals:
        rival, *more = map(written_in_words, first.short_rivals)
        others = f" and {formatting.count(len(more), 'other')}" if more else ""
        return f"; {rival}{others} would explain it as well"
    return _OPEN[group.badge]


#: What is open of a finding by its badge, as the end of a sentence.
_OPEN = {
    "size uncertain": "; how much is open",
    "cause uncertain": "; something else may make a part of it",
    "near-tie": "; something else would explain it as well",
    "weak": "; it may be nothing",
}


def _added(session: Session) -> str:
    """Say what the last step added, on the arm; "" for what no diagnosis found."""
    diagnosis = session.findings
    added = session.current.added
    texts = filter(None, _in_one_line(diagnosis, added) if diagnosis else ())
    sentences = _sentences(*map(formatting.sentence, texts))
    return f"Added. {sentences}" if sentences else ""


def _decided_joints(remedy: Remedy) -> set[int]:
    """Return the joints (from 1) on which a motion to record tells effects apart; none of
    one that is of the whole arm."""
    effects = remedy.change.arguments.get("separate", ())
    return {joint for text in effects for joint in joints_of(text)}


def _motion_to_record(view: View) -> tuple[NextStep, bool]:
    """Return the step that records a motion which shows more of the joint that errs most,
    for a model to which nothing is known to add, and whether that decides something."""
    session = view.session
    diagnosis = session.findings_of_current
    of_diagnosis = [] if diagnosis is None else diagnosis.remedies
    asked = [
        remedy
        for remedy in (*session.remedies, *of_diagnosis)
        if remedy.change.verb == "record"
    ]
    worst = session.current.worst_joint
    of_worst = [remedy for remedy in asked if worst in _decided_joints(remedy)]
    of_arm = [remedy for remedy in asked if not _decided_joints(remedy)]
    first = next(iter(of_worst + of_arm), None)
    if MOTION in session.taken:
        text, label = "The motion's log comes next", "Choose the log"
        step = NextStep(text, label, "measure", opens="drop-runs")
        return step, first is not None
    motion: Mapping[str, Any] = first.change.to_dict() if first else {}
    text = graded(first.problem, "certain") if first else ""
    label = label_of_motion(motion) if first else "Make a motion to record"
    do = partial(session.start, session.make_motion, motion, view.download)
    return NextStep(text, label, "measure", do), first is not None
