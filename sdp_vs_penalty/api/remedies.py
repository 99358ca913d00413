"""A change of a remedy, done and written: one function a verb applies it to runs, problem
and model, one writes it as a command.

docs/contracts.md has the table of verbs; `results/remedy.py` the records.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sdp_vs_penalty.checks.check import check_runs
from sdp_vs_penalty.checks.fixing import LeftOut, errors_left_out, fix_runs
from sdp_vs_penalty.data.files import without_spans
from sdp_vs_penalty.data.hypotheses.renaming import scaled
from sdp_vs_penalty.data.measurements import Measurements, concatenate
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.estimation.estimate import Estimate
from sdp_vs_penalty.problem.check_command import CheckCommand
from sdp_vs_penalty.problem.load import load_problem
from sdp_vs_penalty.problem.problem import Problem
from sdp_vs_penalty.race.race import HeldRaces
from sdp_vs_penalty.results.remedy import GUESSES, Change, Remedy, Verb

if TYPE_CHECKING:
    from sdp_vs_penalty.diagnosis.finding import Finding, Retune
    from sdp_vs_penalty.diagnosis.findings import Diagnosis


@dataclass(frozen=True)
class State:
    """What a change is applied to, and comes out as."""

    #: Of the robot that was logged.
    problem: Problem
    #: The runs.
    runs: tuple[Measurements, ...] = ()
    #: The model; None before one is identified.
    model: Estimate | None = None
    #: What the model lacks; None before it is diagnosed.
    diagnosis: Diagnosis | None = None
    #: What the change did to the error on motion left out; None where nothing was.
    effect: LeftOut | None = None


@dataclass(frozen=True)
class Files:
    """The files that a user has, which commands may name."""

    #: The `check` of the runs, with the options that every command needs.
    check: CheckCommand
    #: The model.
    model: str | Path | None = None
    #: The findings of the diagnosis.
    findings: str | Path | None = None
    #: Words of `add` behind what it adds: the runs and its options.
    data: Sequence[str] = ()
    #: Names of new files by their kind ("model", "run", "trajectory").
    new: Mapping[str, str | Path] = field(default_factory=dict)
    #: Word for a unit that only the user knows; "": there is no command then.
    blank: str = ""


def apply_change(change: Change, state: State) -> State:
    """Apply a change to the state that it is about.

    Parameters
    ----------
    change : Change
        Of a remedy of the check or of the diagnosis.
    state : State
        Problem, runs, model and diagnosis.

    Returns
    -------
    State
        With other runs, another problem or another model, as docs/contracts.md says.

    Raises
    ------
    InputError
        Where the change is refused: a repair that does not lower the error on motion
        left out, a unit that nobody named, a run that has to be recorded first.
    """
    return _APPLY[change.verb](change, state)


def effect_on_error(before: State, after: State) -> LeftOut:
    """Return what a change of runs or robot did to the error on motion left out."""
    if after.effect is not None:  # a repair is done only where the error says so
        return after.effect
    sides = [(state.problem, state.runs) for state in (before, after)]
    return errors_left_out(*sides)


def command_of(change: Change, files: Files) -> list[str] | None:
    """Write a change as the words of one command that runs as printed, without the
    program's name.

    Returns
    -------
    list of str or None
        None where the command would lack a word or a file that only the user has.
    """
    words = _WORDS[change.verb](change.arguments, files)
    return None if words is None else [str(word) for word in words]


def next_remedy(remedies: Sequence[Remedy]) -> Remedy | None:
    """Return the first remedy of a result that is a next step; None where none is.

    A run that would have to be recorded is none, nor is a span that could be left out,
    a missing effect or a repair of the log that is only possible, or one where an effect
    of the arm explains as much: these are the user's to choose. What raises a joint's error
    is none either.
    """
    for remedy in remedies:
        verb = remedy.change.verb
        is_guess = verb != "read" and remedy.certainty in GUESSES
        asks_for_unit = not all(
            remedy.change.arguments.get("scale", {"": "1"}).values()
        )
        is_guess = is_guess or remedy.may_be_the_arm or not remedy.is_advisable
        is_choice = verb in ("record", "cut")
        if not (is_choice or is_guess or asks_for_unit):
            return remedy
    return None


def next_command(remedies: Sequence[Remedy], files: Files) -> list[str] | None:
    """Return the command of the next step that remedies advise; None without one."""
    remedy = next_remedy(remedies)
    return None if remedy is None else command_of(remedy.change, files)


def _repaired(change: Change, state: State) -> State:
    """Repair the runs as `check --fix --apply` does: what is certain, and what is
    named."""
    problem = state.problem
    races = HeldRaces()
    reports = check_runs(problem, state.runs, thorough=False, races=races)
    words = change.arguments.get("apply", ())
    repaired = fix_runs(problem, state.runs, reports, words, races)
    return replace(state, runs=repaired.runs, effect=repaired.left_out)


def _cut(change: Change, state: State) -> State:
    """Leave spans (begin, end) [s] of one run's clock out, or all of the run; a model of
    the old runs goes."""
    arguments = change.arguments
    name = arguments["run"]
    if "spans" not in arguments:
        others = tuple(run for run in state.runs if run.names[0] != name)
        return replace(state, runs=others, model=None)
    runs = [
        without_spans(run, arguments["spans"]) if run.names[0] == name else run
        for run in state.runs
    ]
    return replace(state, runs=tuple(runs), model=None)


def _in_other_units(change: Change, state: State) -> State:
    """Scale columns of the runs, or of the one that is named, from other units.

    Raises InputError where the unit is still to be named, or where the file itself has
    to be read anew: other columns, another rate or topic.
    """
    arguments = change.arguments
    unit_by_column = arguments.get("scale", {})
    if set(arguments) - {"scale", "run", "by_size"}:
        raise InputError(
            "the file has to be read anew", "convert it with these columns"
        )
    if not all(unit_by_column.values()):
        column = next(name for name, unit in unit_by_column.items() if not unit)
        remedy = "a unit (mNm, Ncm, kgfm, lbfin), or a factor for each joint"
        raise InputError(f"{column}: no unit is named", f"name {remedy}")
    chosen = arguments.get("run")  # None: all runs
    runs = [
        scaled(run, unit_by_column) if chosen in (None, run.names[0]) else run
        for run in state.runs
    ]
    if "tau" in unit_by_column:
        # Factors of torque channels that are judged by their size, from now on.
        by_size = arguments.get("by_size", "")
        runs = [replace(run, gains_by_size=by_size) for run in runs]
    return replace(state, runs=tuple(runs))


def _with_held_joints(change: Change, state: State) -> State:
    """Hold joints at positions [rad, m], by name: their links belong to their parents,
    and the runs lose their columns."""
    robot = state.problem.robot
    positions = change.arguments["positions"]
    held_before = {joint.name: joint.value for joint in robot.joint_names.held}
    problem = load_problem(
        state.problem.source or state.problem.name,
        robot.gravity,
        held_before | positions,
    )
    places = [robot.joint_names.index(name) for name in positions]
    runs = tuple(run.without_joints(places) for run in state.runs)
    return replace(state, problem=problem, runs=runs, model=None)


def _with_gravity(change: Change, state: State) -> State:
    """Set gravity in the base frame [m/s^2]."""
    problem = state.problem.with_gravity(change.arguments["gravity"])
    return replace(state, problem=problem, model=None)


def what_to_add(
    change: Change, diagnosis: Diagnosis | None
) -> Diagnosis | list[Finding | Retune | str]:
    """Return what :func:`~sdp_vs_penalty.add` takes for a change: findings of the
    diagnosis, which carry their intervals into the model, or effects by their texts.

    Raises InputError where no finding is left to add.
    """
    texts: list[str] = list(change.arguments["effects"])
    if diagnosis is None:
        return [*texts]
    which = change.arguments.get("findings")
    if isinstance(which, str):
        return diagnosis.selected(helpful=which == "helpful")
    found: tuple[Finding | Retune, ...] = (*diagnosis.effects, *diagnosis.retuned)
    by_text = {finding.text: finding for finding in found}
    return [by_text.get(text, text) for text in texts]


def _with_effects(change: Change, state: State) -> State:
    """Add effects to the model, or re-estimate its constants, and identify it again."""
    from sdp_vs_penalty.diagnosis.adding import add

    if state.model is None:
        raise InputError("there is no model to add to", "identify one first")
    effects = what_to_add(change, state.diagnosis)
    return replace(state, model=add(state.model, effects, concatenate(state.runs)))


def _refuse_without_run(change: Change, state: State) -> State:
    """Refuse: nothing changes before the run is recorded."""
    raise InputError("this asks for a new run", "record it, and add it to the runs")


def _transform_words(arguments: Mapping[str, Any], files: Files) -> list[str]:
    """Write the command `check --fix --apply` with the words of the repairs."""
    return files.check.applying(arguments.get("apply", ())).repair_words


def _cut_words(arguments: Mapping[str, Any], files: Files) -> list[str] | None:
    """Write the command `convert` that leaves the spans out of the run, or the `check` of
    the others without it; None where the run's file is not among the user's, or alone."""
    run = _file_of(arguments["run"], files)
    if run is None:
        return None
    if "spans" not in arguments:
        others = [file for file in files.check.runs if file != run]
        return replace(files.check, runs=others).words if others else None
    cut = ",".join(f"{begin:.6g}:{end:.6g}" for begin, end in arguments["spans"])
    return ["convert", str(run), "--cut", cut, "--out", str(cut_copy(run))]


def _file_of(run: str, files: Files) -> str | Path | None:
    """Return the user's file of a run; None without one."""
    named = {Path(file).name: file for file in files.check.runs}
    return named.get(Path(run).name)


def cut_copy(run: str | Path) -> Path:
    """Return the path of a run's copy without spans, beside it."""
    path = Path(run)
    return path.with_name(f"{path.stem}_cut.csv")


def _read_words(arguments: Mapping[str, Any], files: Files) -> list[str] | None:
    """Write the command `convert` of a single run; None for several runs of which none is
    named, and where the user has yet to name a unit."""
    if "run" in arguments:
        run = _file_of(arguments["run"], files)
        files = replace(
            files, check=replace(files.check, runs=[] if run is None else [run])
        )
    options = []
    for name in ("scale", "rename"):
        pairs = {k: v or files.blank for k, v in arguments.get(name, {}).items()}
        if not all(pairs.values()):
            return None
        if pairs:
            options += [f"--{name}", ",".join(f"{k}={v}" for k, v in pairs.items())]
    for name in ("rate", "topic"):
        if name in arguments:
            options += [f"--{name}", str(arguments[name])]
    if len(files.check.runs) != 1:
        return None
    if files.check.joints:
        options += ["--joints", ",".join(files.check.joints)]
    copy = str(files.check.copy)
    return ["convert", str(files.check.runs[0]), *options, "--out", copy]


def _hold_words(arguments: Mapping[str, Any], files: Files) -> list[str]:
    """Write the command `check` with these joints held as well: --hold name=position."""
    held = ",".join(f"{k}={v:.6g}" for k, v in arguments["positions"].items())
    held_before = files.check.hold
    both = f"{held_before},{held}" if held_before else held
    return replace(files.check, hold=both).words


def _mount_words(arguments: Mapping[str, Any], files: Files) -> list[str]:
    """Write the command `check` with this gravity [m/s^2] in the base frame."""
    gravity = ",".join(f"{g:g}" for g in arguments["gravity"])
    return replace(files.check, gravity=gravity).words


def _add_words(arguments: Mapping[str, Any], files: Files) -> list[str] | None:
    """Write the command `add`, which names findings or effects; None without a model.

    ``arguments["findings"]`` says which findings are added: "all", "helpful", or a list
    of their numbers. The command takes them from the file of the diagnosis. Without that
    argument, or without that file, it names the effects by their texts. A measured curve
    has no text, so there is no command then.
    """
    if files.model is None:
        return None
    chosen = arguments.get("findings")
    source: list[Any]
    if chosen is None or files.findings is None:
        source = [",".join(arguments["effects"])]
    elif isinstance(chosen, str):
        source = ["--from", files.findings]
        source += ["--helpful"] if chosen == "helpful" else []
    else:
        source = ["--from", files.findings, "--only", ",".join(map(str, chosen))]
    if not all(source):
        return None
    new_model = files.new["model"]
    return ["add", files.model, *source, *files.data, "--out", new_model]


def _record_words(arguments: Mapping[str, Any], files: Files) -> list[str]:
    """Write the command `excite`: for a motion within the robot's limits, or for one
    that tells two effects apart."""
    separate = arguments.get("separate")
    source = files.model if separate else files.check.problem
    options = ["--separate", ",".join(separate)] if separate else []
    return ["excite", str(source), *options, "--out", str(files.new["trajectory"])]


_APPLY: Mapping[Verb, Callable[[Change, State], State]] = {
    "transform": _repaired,
    "cut": _cut,
    "read": _in_other_units,
    "hold": _with_held_joints,
    "mount": _with_gravity,
    "add": _with_effects,
    "reset": _with_effects,
    "record": _refuse_without_run,
}
_WORDS: Mapping[Verb, Callable[[Mapping[str, Any], Files], list[str] | None]] = {
    "transform": _transform_words,
    "cut": _cut_words,
    "read": _read_words,
    "hold": _hold_words,
    "mount": _mount_words,
    "add": _add_words,
    "reset": _add_words,
    "record": _record_words,
}
