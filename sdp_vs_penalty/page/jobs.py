"""What a worker can be asked to do: one function a job, from a request to an answer,
both plain JSON.

Every job loads what it needs from files of the session's folder and leaves its runs and
models there, so that a job that is killed has changed nothing.
"""

import json
import time
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from sdp_vs_penalty import formatting
from sdp_vs_penalty.api.diagnosis import diagnose_and_add
from sdp_vs_penalty.api.exporting import (
    AsExported,
    judge_as_exported,
    laws_in_place,
    refit_as_exported,
)
from sdp_vs_penalty.api.identification import identify_and_judge
from sdp_vs_penalty.api.remedies import (
    State,
    apply_change,
    effect_on_error,
    what_to_add,
)
from sdp_vs_penalty.checks import Report
from sdp_vs_penalty.checks.certainty import likely
from sdp_vs_penalty.checks.check import check_runs
from sdp_vs_penalty.checks.facts.magnitude import make_computed_torque
from sdp_vs_penalty.checks.gate import Gate
from sdp_vs_penalty.checks.issue import Issue
from sdp_vs_penalty.checks.long_runs import is_long
from sdp_vs_penalty.checks.report import list_remedies
from sdp_vs_penalty.data.catalogue import DATASETS, dataset
from sdp_vs_penalty.data.datasets import fetch as fetch_dataset
from sdp_vs_penalty.data.files import (
    as_measurements,
    check_usable,
    load_measurements,
    read_run,
    save,
    windowed,
)
from sdp_vs_penalty.data.formats import FILE_SEPARATOR, open_log
from sdp_vs_penalty.data.formats import format_of as log_format_of
from sdp_vs_penalty.data.hypotheses.recognition import recognise
from sdp_vs_penalty.data.hypotheses.report import ColumnReport, describe_columns
from sdp_vs_penalty.data.joined import files_of_run, joined_log
from sdp_vs_penalty.data.measurements import Measurements, Runs, columns_of, concatenate
from sdp_vs_penalty.data.parsing import numbers, pairs, time_windows
from sdp_vs_penalty.data.plausibility import check_torque, find_idle_joints
from sdp_vs_penalty.data.recorder import Recorder
from sdp_vs_penalty.data.together import read_by_recorder
from sdp_vs_penalty.data.words.names import quantity_of
from sdp_vs_penalty.data.words.tokens import split_tokens
from sdp_vs_penalty.diagnosis.adding import add
from sdp_vs_penalty.diagnosis.comparison import (
    Comparison,
    compare,
    compare_filtered,
    predicted,
)
from sdp_vs_penalty.diagnosis.findings import Diagnosis
from sdp_vs_penalty.diagnosis.open_findings import (
    describe_loss,
    verdict_beside,
    verdict_on_file,
    with_findings,
)
from sdp_vs_penalty.diagnosis.where_it_fails import sentences, where_it_fails
from sdp_vs_penalty.effects import effects_in_words
from sdp_vs_penalty.errors import (
    ColumnsRemark,
    InputError,
    MissingJoints,
    Remark,
    other_robot,
)
from sdp_vs_penalty.estimation.build_problem import PoseOptions, read_and_filter
from sdp_vs_penalty.estimation.constants import CHANGES, NORMAL_95
from sdp_vs_penalty.estimation.drive_torque import driven
from sdp_vs_penalty.estimation.estimate import Estimate, load_estimate
from sdp_vs_penalty.estimation.excitation import Limits, excite, save_trajectory
from sdp_vs_penalty.estimation.identify import estimate_parameters
from sdp_vs_penalty.estimation.nominal import nominal_model
from sdp_vs_penalty.estimation.separation import separate
from sdp_vs_penalty.estimation.shapes import effects_to_estimate_again
from sdp_vs_penalty.estimation.verdict import Verdict
from sdp_vs_penalty.estimators import with_solver
from sdp_vs_penalty.estimators.estimator import Progress, no_progress
from sdp_vs_penalty.exporters import EXPORTS
from sdp_vs_penalty.exporters.export import write_model
from sdp_vs_penalty.exporters.friction_table import friction_curves
from sdp_vs_penalty.files import read_bytes, write_bytes, write_text, writing
from sdp_vs_penalty.page.splits import split_run
from sdp_vs_penalty.page.spoken import name_beside
from sdp_vs_penalty.parallel import Workers
from sdp_vs_penalty.problem.load import convert, load_problem, with_bounds, with_filters
from sdp_vs_penalty.problem.problem import Problem
from sdp_vs_penalty.ranges.table import find_ranges
from sdp_vs_penalty.records import from_json, to_json
from sdp_vs_penalty.render import tables, words
from sdp_vs_penalty.render.arms import binary_stl, drawn_arm, simplified
from sdp_vs_penalty.render.charts import POINTS, spread_rows
from sdp_vs_penalty.reports import report as write_report
from sdp_vs_penalty.results.remedy import Change
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.geometry import link_surfaces
from sdp_vs_penalty.robot.joint import parse_held
from sdp_vs_penalty.robot.model_files import format_of
from sdp_vs_penalty.robot.robot import Robot
from sdp_vs_penalty.robot.robot_file import as_urdf
from sdp_vs_penalty.robot.trajectory import FourierTrajectory, PointTrajectory
from sdp_vs_penalty.signals.filtered import FilteredRun, FilteredRuns, Rows
from sdp_vs_penalty.signals.runs import sample_rate
from sdp_vs_penalty.simulation.follow import follow
from sdp_vs_penalty.simulation.hidden_runs import hidden_runs

Answer = dict[str, Any]
#: Rows of which the pictures of a diagnosis are drawn.
CARD_ROWS = 20_000
#: Rows of the judged runs in which it is looked where a model fails: a minute at 1 kHz.
MOST_LOOKED_AT = 60_000
#: Samples of all runs up to which the error of each run is told apart.
MOST_JUDGED_APART = 200_000
#: Share of a test run in motion that the training runs reach, from which on its error
#: there says whether the arm has changed. In 2 772 parts of runs of a UR10e and two Pandas
#: a joint errs by up to 2.7 times what it errs in the whole run; in parts smaller than this
#: by up to 3.8 times, near to CHANGED.
LEAST_REACHED = 0.1
#: Poses of the arm over a run, between which the page's 3D view interpolates.
POSES_OF_A_RUN = 160


class JobRequest(dict[str, Any]):
    """A request to a worker: its fields by name, with accessors for what they stand
    for.

    progress : called with a short text whenever the work reaches a new step.
    """

    def __init__(
        self, fields: Mapping[str, Any], progress: Progress = no_progress
    ) -> None:
        """Hold the request's fields and note when the work begins.

        Parameters
        ----------
        fields : mapping
            The request as JSON: "folder", "robot", "runs", "model", "options", ...
        progress : callable
            Called with a short text whenever the work reaches a new step.
        """
        super().__init__(fields)
        self.progress = progress
        self.begin = time.perf_counter()

    @property
    def folder(self) -> Path:
        """The session's private folder, which holds its runs and models."""
        return Path(self["folder"])

    @property
    def problem(self) -> Problem:
        """The identification problem of the chosen robot, loaded anew.

        A robot is named or is a URDF file; "gravity" replaces its direction of gravity,
        "hold" names joints that stand still, and where.
        """
        robot = self["robot"]
        held = parse_held(robot["hold"]) if robot.get("hold") else None
        return load_problem(robot["source"], robot.get("gravity"), held)

    @property
    def stored_runs(self) -> list[Measurements]:
        """The session's runs, each under the name that the person knows."""
        return self.stored(self["runs"])

    @property
    def used(self) -> list[Answer]:
        """The records of the runs but of those that wait for an answer."""
        return [run for run in self["runs"] if run["use"] != "wait"]

    def stored(self, runs: Sequence[Mapping[str, Any]]) -> list[Measurements]:
        """Read runs by their records, each under the name that the person knows."""
        return [
            replace(
                as_measurements(self.folder / run["file"], usable=False),
                names=(run["name"],),
                # Older projects have neither.
                torque_unit=run.get("torque_unit", ""),
                gains_by_size=str(run.get("gains_by_size") or ""),
            )
            for run in runs
        ]

    @property
    def model(self) -> Estimate:
        """The session's current model, loaded from its model.json."""
        return load_estimate(self["model"])

    def number(self, name: str, default: float) -> float:
        """Return a numeric option by its name, or the default where its field is empty.

        Options arrive as text. Raises InputError for a text that is no number.
        """
        text = self["options"].get(name)
        return default if text is None else numbers(name.replace("_", " "), text, 1)[0]

    def windowed(self, run: Measurements) -> Measurements:
        """Cut a run to the time windows of the option "window"; without it, keep all
        of it.
        """
        return windowed(run, time_windows(self["options"].get("window")))

    @cached_property
    def loaded(self) -> Measurements:
        """All recordings of the session that are used, uncut, read once.

        Raises InputError if no run is used for training, or one cannot be used.
        """
        if not any(run["use"] in ("train", "split") for run in self["runs"]):
            raise InputError("No run to identify from", "use at least one for it")
        runs = self.stored(self.used)
        for run in runs:
            check_usable(run.names[0], run)
        return concatenate(runs)

    @cached_property
    def runs(self) -> Runs:
        """The session's runs, sorted by their use: training data and test data.

        A run of use "split" gives some of its time windows to each side. The models are
        judged on the test data; without any they are judged on the training data.
        """
        sides: dict[str, list[Measurements]] = {"train": [], "test": []}
        for run, part in zip(self.used, self.loaded.runs(), strict=True):
            for side, stretch in _by_use(run, part):
                sides[side].append(stretch)
        test = concatenate(sides["test"]) if sides["test"] else None
        judged = self.recordings("train" if test is None else "test")
        return Runs(concatenate(sides["train"]), test, self.loaded, judged)

    def recordings(self, side: str) -> Measurements:
        """Return the full recordings that contribute to one side, "train" or "test".

        A split run contributes to both sides and is not cut.
        """
        records_and_samples = zip(self.used, self.loaded.runs(), strict=True)
        uses = side, "split"
        return concatenate([x for run, x in records_and_samples if run["use"] in uses])


def _by_use(
    run: Mapping[str, Any], part: Measurements
) -> Iterator[tuple[str, Measurements]]:
    """Yield the parts of a run with the side that uses each: "train" or "test".

    A split run yields both sides, each cut to its time windows; any other run is
    yielded whole. ``run`` is the page's record of it, ``part`` its samples.
    """
    if run["use"] != "split":
        yield run["use"], part
        return
    for side in ("train", "test"):
        windows = [(a, b) for a, b in run["split"][side]]
        yield side, windowed(part, windows)


@dataclass
class _Reading:
    """One dropped file, as it was read last."""

    #: Path of the file, or of the files that hold one run together.
    path: Path
    #: Names of its columns.
    columns: list[str] = field(default_factory=list)
    #: Options of `convert` with which it was read.
    options: dict[str, str] = field(default_factory=dict)
    #: What the reader remarked, each once.
    remarks: list[Remark] = field(default_factory=list)

    def load(
        self, job: JobRequest, problem: Problem, recorders: Sequence[Recorder]
    ) -> Measurements:
        """Load the run, by what the arm has told of others."""
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always", Remark)
            self.columns = _names_of_columns(self.path)
            assigned = job["assigned"].get(json.dumps(self.columns), {})
            self.options = {**assigned, **job["options"]}
            part = _load_run(self.options, problem, self.path, recorders)
        each_once = {str(x.message): x.message for x in caught}.values()
        self.remarks = [x for x in each_once if isinstance(x, Remark)]
        return part


def read(job: JobRequest) -> Answer:
    """Read the files that a person dropped; keep each usable one as a run.

    ``job["files"]`` lists {path, name} of each file, ``job["taken"]`` names of files that
    wait: a file whose name is there already gets a second one. ``job["assigned"]`` holds
    options of `convert` by the columns of the files that they are for, as JSON. Joints
    that no file has, or that stand still without torque in all runs, are held, as in a
    terminal.

    Returns
    -------
    dict
        What :func:`_judged` returns of all runs; "refused": a sentence for each other
        file; "remarks": what the readers assumed; "mappings": for each file whose
        columns were guessed, or refused, what a person needs to assign them; "read": of
        each new run its file's name, and the options with which it was read.
    """
    state = State(job.problem, tuple(job.stored_runs))
    kept = [_kept_of(run) for run in job["runs"]]
    read_so = list[Answer]()
    refused = list[str]()
    remarks = list[str]()
    mappings = list[Answer]()
    there = {*job["taken"], *(run["name"] for run in job["runs"])}
    files = _joined(job["files"])
    readings = [_Reading(Path(file["path"])) for file in files]
    for file in files:
        file["name"] = name_beside(file["name"], there)
        there.add(file["name"])

    def load(place: int, recorders: Sequence[Recorder]) -> Measurements:
        job.progress(f"reading {files[place]['name']}, and what its columns are")
        part = readings[place].load(job, state.problem, recorders)
        name = files[place]["name"]
        told = tuple(
            replace(x, run=name) if x.run == part.names[0] else x
            for x in part.recorders
        )
        return replace(part, names=(name,), recorders=told)

    known = [
        from_json(Recorder, x) for run in job["runs"] for x in run.get("recorders", ())
    ]
    with warnings.catch_warnings(record=True) as contradictions:
        warnings.simplefilter("always", Remark)
        outcomes = read_by_recorder(load, len(files), known)
    remarks += [str(x.message) for x in contradictions]
    for file, reading, outcome in zip(files, readings, outcomes, strict=True):
        name, path = file["name"], reading.path
        try:
            if isinstance(outcome, MissingJoints):
                # What an earlier file of these lacks is held already.
                moving = state.problem.robot.joint_names
                still = [joint for joint in outcome.joints if joint in moving]
                if still:
                    state = _holding(state, dict.fromkeys(still, 0.0), remarks)
                part = reading.load(job, state.problem, known)
            elif isinstance(outcome, InputError):
                raise outcome
            else:
                part = outcome
            how, names = reading.options, reading.columns
            remarks += filter(None, map(_news_of, reading.remarks))
            if "scale" in how:
                remarks.append(f"{name}: read in the units of runs like it.")
            by_size = _gains_by_size(job, names) if "scale" in how else ""
            part = replace(part, names=(name,), gains_by_size=by_size)
            check_torque(part)
            _refuse_duplicate(part, state.runs, path)
            state = replace(state, runs=(*state.runs, part))
            rougher = _rougher_block(path, how.get("rename", ""), names)
            others = (
                _other_torques(path, state.problem, how, names) if rougher else None
            )
            if others:
                run = _run_file_name(part)
                mappings.append({**file, **others, "reason": "", "run": run})
            kept.append(
                {
                    "use": "train",
                    "in_commands": f"{Path(name).stem}_read.csv" if how else name,
                    "columns": names,
                    "stated": "scale" in how,
                    "recorders": to_json(part.recorders),
                    "rougher": rougher,
                }
            )
            read_so.append({"file": name, "options": how})
            for taken in reading.remarks:
                columns = isinstance(taken, ColumnsRemark) and _columns_of(
                    path, state.problem, taken
                )
                if columns:
                    run = _run_file_name(part)
                    mappings.append({**file, **columns, "reason": "", "run": run})
        except InputError as error:
            columns = _columns_of(path, state.problem)
            if columns is None:
                refused.append(error.without_command)
                continue
            # The form below says what to do, unless it was filled in and refused.
            reason = formatting.sentence(f"{error.where or name}: {error.what}")
            if tried := _columns_tried(
                reading.options.get("rename", ""), columns["columns"]
            ):
                columns["tried"] = columns["chosen"] = {**columns["chosen"], **tried}
                reason = error.without_command
            mappings.append({**file, **columns, "reason": reason, "run": ""})
    idle = [find_idle_joints(state.problem.robot, run) for run in state.runs]
    shared = {
        name: at
        for name, at in (idle or [{}])[0].items()
        if all(name in x for x in idle)
    }
    if shared:
        state = _holding(state, shared, remarks)
    answer = {"refused": refused, "remarks": remarks, "mappings": mappings}
    judged = _judged(job, state, kept)
    issues = [issue for run in judged["runs"] for issue in run["findings"]]
    if any(issue.position_unit for issue in issues):  # what else they may be
        remarks[:] = [x for x in remarks if ": q may be " not in x]
    return answer | {"read": read_so} | judged


def _joined(files: Sequence[Mapping[str, str]]) -> list[dict[str, str]]:
    """Return the files to read, {path, name} each: those that hold one run together as one
    ("a_encoder.csv+a_drive.csv"). Their names differ in one word, none is a run by itself,
    one holds positions, another torques, and their stamps, or rows, belong together."""
    alike = dict[tuple[str, ...], list[Mapping[str, str]]]()
    for file in files:
        tokens = split_tokens(Path(file["name"]).stem)
        for k, token in enumerate(tokens):
            if not token.isdigit():  # numbers count runs
                alike.setdefault((*tokens[:k], "", *tokens[k + 1 :]), []).append(file)
    run_of = dict[str, Sequence[Mapping[str, str]]]()
    for group in alike.values():
        is_new = not any(file["path"] in run_of for file in group)
        parts = [(f, _held_in_part(f)) for f in group if is_new and len(group) > 1]
        together = [file for file, held in parts if held]
        quantities = [quantity for _, held in parts for quantity in held]
        is_whole = quantities.count("q") == quantities.count("tau") == 1
        if is_whole and _are_one_run(together):
            run_of |= {file["path"]: together for file in together}
    runs = list[dict[str, str]]()
    for file in files:
        those = run_of.get(file["path"], [file])
        if file is those[0]:
            both = {
                x: FILE_SEPARATOR.join(f[x] for f in those) for x in ("path", "name")
            }
            runs.append({**file, **both})
    return runs


def _held_in_part(file: Mapping[str, str]) -> set[str | None]:
    """Return the quantities that a file holds, as its columns say, or where these say none
    its name; none of a run by itself, or of a file that cannot be read."""
    with suppress(InputError), warnings.catch_warnings():
        warnings.simplefilter("ignore", Remark)  # it is heard when the file is read
        columns = open_log(Path(file["path"])).columns
        if recognise(columns) is None:
            tokens = split_tokens(Path(file["name"]).stem)
            said = {*map(quantity_of, columns)} - {None, "t"}
            return said or {*map(quantity_of, tokens)} - {None, "t"}
    return set()


def _are_one_run(files: Sequence[Mapping[str, str]]) -> bool:
    """Whether files can be joined to one run, by their stamps or row by row."""
    if len(files) < 2:
        return False
    paths = [Path(file["path"]) for file in files]
    with suppress(InputError), warnings.catch_warnings():
        warnings.simplefilter("ignore", Remark)
        joined_log(paths[0], paths)
        return True
    return False


def _news_of(remark: Remark) -> str:
    """Return what a reader says, but that columns with our names are those."""
    text = str(remark)
    if not isinstance(remark, ColumnsRemark):
        return text
    file, _, said = text.partition(": ")
    news = said.partition("; ")[2]
    is_named_by_us = all(ours == theirs for ours, theirs in remark.rename.items())
    return (f"{file}: {news}" if news else "") if is_named_by_us else text


def _columns_tried(rename: str, columns: Sequence[str]) -> dict[str, str]:
    """Return the columns by our names with which the page has read a file: by the places
    that it has written; empty for other options."""
    places = pairs("--rename", rename or None) or {}
    if not all(place[:1] == "#" and place[1:].isdigit() for place in places.values()):
        return {}
    return {ours: columns[int(place[1:]) - 1] for ours, place in places.items()}


def _names_of_columns(path: Path) -> list[str]:
    """Return the names of a file's columns; none of a bag, whose messages have them, nor
    of several files."""
    if files_of_run(path) or hasattr(log_format_of(path), "HAS_TOPICS"):
        return []
    return [*open_log(path).names]


def _kept_of(run: Mapping[str, Any]) -> Answer:
    """Return what stays in the record of a run, whatever is done to its samples: its use,
    what commands call its file, the columns of that, whether a person has stated its
    units, what the arm has told of its recorder, and the columns that are rougher than its
    torque."""
    return {
        "use": run["use"],
        "in_commands": run["in_commands"],
        "columns": run.get("columns", []),  # older projects have none
        "stated": bool(run.get("stated")),
        "recorders": run.get("recorders", []),
        "rougher": run.get("rougher", ""),
    }


def _gains_by_size(job: JobRequest, columns: Sequence[str]) -> str:
    """Return the gains that nobody has stated, in words, by which runs with these columns
    are read; "" without any."""
    same = (run for run in job["runs"] if run.get("columns") == columns)
    return next(filter(None, (run.get("gains_by_size", "") for run in same)), "")


def _holding(state: State, positions: dict[str, float], remarks: list[str]) -> State:
    """Hold joints that do not move, and add the remark that says so."""
    change = Change("hold", "hold joints", {"positions": positions})
    named = formatting.words(list(positions))
    stand = "stands" if len(positions) == 1 else "stand"
    remarks.append(f"{named} {stand} still: held, as part of the link that carries it.")
    return apply_change(change, state)


def _judged(job: JobRequest, state: State, kept: Sequence[Answer]) -> Answer:
    """Store the runs of a state, and check them together; ``kept`` stays in the record of
    each (:func:`_kept_of`).

    Returns
    -------
    dict
        "runs": a record of each run for the page; "remedies": the check's, as
        :func:`list_remedies` orders them; "robot": what the page shows of it, with the
        gravity and the held joints of the state.
    """
    problem = state.problem
    if state.runs:  # none while the columns of all files are asked for
        job.progress(f"checking {formatting.count(len(state.runs), 'run')}")
    reports = check_runs(problem, state.runs, thorough=False)
    facts = robot_facts(job, problem)
    if facts["hold"] != job["robot"].get("hold", ""):  # joints have other numbers
        facts["meshes"] = _kept_meshes(job, problem)
    records = [
        keep(job, problem, run, report) | stays
        for run, report, stays in zip(state.runs, reports, kept, strict=True)
    ]
    for record in records:
        if rougher := record.get("rougher"):
            record["findings"].insert(0, _computed_torque(rougher))
    return {
        "runs": records,
        "remedies": to_json(list_remedies(reports)),
        "robot": facts,
    }


def _computed_torque(rougher: str) -> Issue:
    """Return the issue of a torque beside which ``rougher`` columns of its file are."""
    return make_computed_torque(
        what="the torque was computed by a controller, not measured: it is smooth, and"
        f" {rougher} of this file are rough as measured.",
        certainty=likely("every measurement carries noise"),
        remedy=f"read {rougher} instead, if they are the measured torque or current:"
        " what is identified from a computed one is the controller's model, without"
        " friction",
    )


def change(job: JobRequest) -> Answer:
    """Apply the change of a remedy, ``job["change"]``, to robot and runs.

    ``job["files"]`` are the runs that are changed; ``job["names"]`` what commands call
    all of them afterwards. Returns what :func:`_judged` does, and "effect": what it did to
    the error on motion left out (LeftOut); empty where that is not judged.
    """
    change = Change.from_dict(job["change"])
    before = State(job.problem, tuple(job.stored_runs))
    kept = [_kept_of(run) for run in job["runs"]]
    chosen = [k for k, run in enumerate(job["runs"]) if run["file"] in job["files"]]
    those = tuple(before.runs[k] for k in chosen)
    job.progress("checking the log, and changing it")
    after = apply_change(change, replace(before, runs=those))
    changed = dict(zip(chosen, after.runs, strict=True))
    runs = tuple(changed.get(k, run) for k, run in enumerate(before.runs))
    effect: Answer = {}
    is_whole = all(r.usable_rows.all() and np.all(np.diff(r.t) > 0.0) for r in runs)
    if change.verb != "read" and is_whole:  # a unit repairs nothing
        job.progress("judging it on motion left out")
        effect = effect_on_error(before, replace(after, runs=runs)).to_dict()
    if change.verb == "read":
        for k in chosen:
            kept[k]["stated"] = True
    for stays, name in zip(kept, job["names"], strict=True):
        stays["in_commands"] = name
    return {"effect": effect} | _judged(job, replace(after, runs=runs), kept)


def check_again(job: JobRequest) -> Answer:
    """Check the runs together that are left; returns what :func:`_judged` does."""
    state = State(job.problem, tuple(job.stored_runs))
    return _judged(job, state, [*map(_kept_of, job["runs"])])


def motion(job: JobRequest) -> Answer:
    """Write the motion that a remedy asks to record, or the one that tells the effects of
    ``job["separate"]`` apart: where the runs have been, and no faster than the fastest
    joint in them.

    Returns {"file": its name, in the session's folder; "words": its length and speed, and
    what to do with it}.
    """
    job.progress("looking for a motion within the robot's limits")
    name = "trajectory.csv"
    trajectory: FourierTrajectory | PointTrajectory
    how: dict[str, Any] = {"progress": job.progress}
    how["limits"] = limits = _limits_of_motion(job)
    of_robot = Limits.from_robot(job.problem.robot)
    is_free = (limits.lower == of_robot.lower) & (limits.upper == of_robot.upper)
    free = [j + 1 for j in np.flatnonzero(is_free).tolist()]
    where = "the limits of the robot's file"
    if not is_free.all():
        theirs = f" ({formatting.joints(free)}: the robot's file)" if free else ""
        where = f"the positions of each joint in the runs{theirs}"
    if job["separate"]:
        trajectory = separate(job.model, ",".join(job["separate"]), **how).trajectory
    else:
        trajectory = excite(job.problem, **how).trajectory
    save_trajectory(trajectory, job.folder / name)
    q, dq, _ = trajectory.states(np.arange(0.0, trajectory.duration, 0.01))
    begin = ", ".join(formatting.number(float(x)) for x in q[0])
    speeds = np.abs(dq).max(axis=0)
    fastest = int(np.argmax(speeds))
    unit = "m/s" if job.problem.robot.torque_units[fastest] == "N" else "rad/s"
    return {
        "file": name,
        "words": (
            f"{name} is in your downloads: {trajectory.duration:.3g} s of t, q, dq and ddq"
            f" within {where}, at most {formatting.number(speeds[fastest])}"
            f" {unit} (joint {fastest + 1}). It begins at q = {begin}. All joints together"
            " may be where no run has been, and nothing here knows"
            " table or cables: keep all of the arm's space free, and begin slowly;"
            " then run it, and bring the log under Measure."
        ),
    }


#: Share of its range that a joint moves over in runs that bound where it may be.
_MOVED = 0.02


def _limits_of_motion(job: JobRequest) -> Limits:
    """Return the positions of each joint in the runs, and the speed of the fastest one of its
    kind there; of joints that hardly move there the robot's limits."""
    robot = job.problem.robot
    limits = Limits.from_robot(robot)
    views = [np.load(job.folder / run["view"]) for run in job["runs"]]
    if not views:
        return limits
    q = np.vstack([view["q"] for view in views])
    low = np.maximum(np.nanmin(q, axis=0), limits.lower)
    high = np.minimum(np.nanmax(q, axis=0), limits.upper)
    has_moved = high - low > _MOVED * (limits.upper - limits.lower)
    limits = replace(
        limits,
        lower=np.where(has_moved, low, limits.lower),
        upper=np.where(has_moved, high, limits.upper),
    )
    logged = np.nanquantile(np.abs(np.vstack([x["dq"] for x in views])), 0.995, axis=0)
    units = np.array(robot.torque_units)
    fastest = np.array([logged[units == unit].max() for unit in units])
    velocity = np.minimum(limits.velocity, np.where(fastest > 0.0, fastest, np.inf))
    slower = velocity / limits.velocity
    return replace(limits, velocity=velocity, acceleration=slower * limits.acceleration)


def fetch(job: JobRequest) -> Answer:
    """Load the public measurements of the robot, as `sdp-vs-penalty fetch` does.

    Returns {"files": path and name of each run}.
    """
    job.progress(f"loading from github.com/{dataset(job['data']).source}")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", Remark)
        paths = fetch_dataset(job["data"])
    return {"files": {path.name: str(path) for path in paths}}


def _refuse_duplicate(
    part: Measurements, known_runs: Sequence[Measurements], path: Path
) -> None:
    """Raise InputError if a run with the same samples is there already."""
    for run in known_runs:
        if run.data_hash == part.data_hash:
            what = f"holds the same samples as {run.names[0]}"
            raise InputError(what, "name each run once", path)


def _columns_of(
    path: Path, problem: Problem, taken: ColumnsRemark | None = None
) -> Answer | None:
    """Return what a person needs to assign a file's columns by hand.

    taken : how the file was read; None where it was refused.

    Returns
    -------
    dict or None
        "columns": the file's column names; "cells": the first cells of each; "chosen":
        by the names that a run needs (t, q1, ..., tau1, ...) the file's column taken or
        guessed for each, "" for none, and "rate" [Hz]; "torques": by its name each
        other set of torques of the same joints, or, of a table without names, each block
        that may be that. None if the file was not refused for
        its columns, or has too few of them.
    """
    joints = problem.channel_names
    with suppress(InputError):
        report = describe_columns(path, joints, taken.rename if taken else None)
        if report is None or not (taken or report.missing or report.problem):
            return None
        joint_numbers = range(1, len(joints) + 1)
        q, dq, tau = ([f"{x}{j}" for j in joint_numbers] for x in ("q", "dq", "tau"))
        if len(report.rows) < len(q) + len(tau):
            return None  # no choice gives every joint a column
        guessed = _guessed(report, ["t", *q, *tau], dq)
        sketches = _sketches(path, report)
        return {
            "columns": [row.name for row in report.rows],
            "cells": [", ".join(row.first_cells[:3]) for row in report.rows],
            "units": [row.unit for row in report.rows],
            "sketches": sketches,
            "chosen": {"rate": "", **{x: guessed[x] for x in ("t", *q, *dq, *tau)}},
            "torques": taken.torques
            if taken
            else _blocks(sketches, report, guessed, problem.robot),
        }
    return None


def _other_torques(
    path: Path, problem: Problem, how: Mapping[str, str], names: Sequence[str]
) -> Answer | None:
    """Return what :func:`_columns_of` does of a file that was read with options: its
    columns as they were taken, and each other block that may be the torques."""
    columns = _columns_of(path, problem)
    if columns is None:
        return None
    chosen = {**columns["chosen"], **_columns_tried(how.get("rename", ""), names)}
    torques = columns["torques"].items()
    others = {name: at for name, at in torques if not at.items() <= chosen.items()}
    return {**columns, "chosen": chosen, "torques": others}


def _blocks(
    sketches: Sequence[Answer],
    report: ColumnReport,
    guessed: Mapping[str, str],
    robot: Robot,
) -> dict[str, dict[str, str]]:
    """Return the blocks of columns without a name that may be the torques, the guessed one
    first, each by its place, its largest number and what it would be, with the columns by
    our names; none where there is one only."""
    tau = [f"tau{j}" for j in range(1, robot.n + 1)]
    names = [row.name for row in report.rows]
    taken = [column for ours, column in guessed.items() if column and ours not in tau]
    free = [x for x in names if x not in taken]
    n = len(tau)
    if len(free) % n or len(free) == n or not all(name[:1] == "#" for name in names):
        return {}
    blocks = {}
    for block in (free[k : k + n] for k in range(0, len(free), n)):
        found = [sketches[names.index(name)] for name in block]
        sizes = [
            max(abs(one["low"]), abs(one["high"])) if one else 0.0 for one in found
        ]
        largest = formatting.number(max(sizes))
        name = f"{_block_in_words(block)}, up to {largest}"
        efforts = [joint.effort for joint in robot.joints]
        shares = [x / limit for x, limit in zip(sizes, efforts, strict=True) if limit]
        if shares and np.isfinite(efforts).all():
            share = formatting.percent(max(shares), 2)
            is_small = max(shares) < _LIKE_CURRENTS
            fits = "rather A; as N m" if is_small else "fits N m;"
            name += f": {fits} {share} of the joints' limits"
        computed = "smooth, computed by a controller"
        name += f", {'rough as measured' if _is_rough(found) else computed}"
        blocks[name] = {**guessed, **dict(zip(tau, block, strict=True))}
    return blocks


def _block_in_words(block: Sequence[str]) -> str:
    """Name the columns of a block."""
    return f"columns {block[0]} to {block[-1]}"


def _is_rough(sketches: Sequence[Answer]) -> bool:
    """Whether most columns of a block are as rough as what was measured."""
    return bool(np.median([one.get("roughness", 0.0) for one in sketches]) > _ROUGH)


def _rougher_block(path: Path, rename: str, names: Sequence[str]) -> str:
    """Name the first block of columns which nothing was taken from and that is rough as
    measured, where the torque of a table without names is smooth; "" without one."""
    taken = _columns_tried(rename, names)
    torques = [column for ours, column in taken.items() if ours.startswith("tau")]
    report = describe_columns(path, None, None) if torques else None
    if report is None:
        return ""
    columns = [row.name for row in report.rows]
    sketches = dict(zip(columns, _sketches(path, report), strict=True))
    if _is_rough([sketches[name] for name in torques]):
        return ""
    free = [name for name in columns if name not in taken.values()]
    n = len(torques)
    for block in (free[k : k + n] for k in range(0, len(free) - n + 1, n)):
        if _is_rough([sketches[name] for name in block]):
            return _block_in_words(block)
    return ""


#: Change of slope from sample to sample, as a share of a column's spread, above which it
#: was measured.
_ROUGH = 0.005
#: Largest share of the joints' limits below which numbers are rather motor currents.
_LIKE_CURRENTS = 0.1


#: Points of a column's sketch, and its height.
_SKETCH = (40, 14)


def _sketches(path: Path, report: ColumnReport) -> list[Answer]:
    """Return of each column its "low" and "high", its "roughness", and "points" (x, y) to
    draw it from left to right, y down; nothing of columns that hold no numbers.

    What lies outside of 98 % of the values is drawn at the edge.
    """
    numeric = [row.name for row in report.rows if row.kind == "number"]
    values = open_log(path).read(numeric).columns
    n_points, height = _SKETCH
    sketches = list[Answer]()
    for row in report.rows:
        x = np.ravel(values.get(row.name, np.zeros(0)))
        x = x[np.isfinite(x)]
        if not len(x):
            sketches.append({})
            continue
        low, high = np.quantile(x, [0.01, 0.99])
        roughness = np.median(np.abs(np.diff(x, n=2))) if len(x) > 2 else 0.0
        few = x[np.linspace(0, len(x) - 1, n_points).astype(int)]
        share = np.clip((few - low) / ((high - low) or 1.0), 0.0, 1.0)
        points = [(k, round(height * (1.0 - y), 1)) for k, y in enumerate(share)]
        found = {"low": float(low), "high": float(high), "points": points}
        spread = np.std(np.clip(x, low, high))  # a broken row has none
        found["roughness"] = float(roughness / (spread or 1.0))
        sketches.append(found)
    return sketches


def _guessed(
    report: ColumnReport, ours: Sequence[str], more: Sequence[str]
) -> dict[str, str]:
    """Return the file's column for each of our names: what the reader takes or proposes, and
    beside some that are recognised the columns of numbers that are left by their order;
    for ``more`` names there need not be any."""
    known = {name: report.rename.get(name, "") for name in (*ours, *more)}
    free = [r.name for r in report.rows if not r.meaning and r.kind == "number"]
    layout = [name for name in ours if not known[name]]
    layout = layout if len(layout) == len(free) else [x for x in layout if x != "t"]
    is_partly_known = any(known[name] for name in ours[1:])  # more than the clock
    if is_partly_known and len(layout) == len(free):
        known |= dict(zip(layout, free, strict=True))
    return known


def _load_run(
    options: Mapping[str, str],
    problem: Problem,
    path: Path,
    recorders: Sequence[Recorder] = (),
) -> Measurements:
    """Load a run from a file by what the arm has told of others, converting it if the person
    set any option of `convert`.

    Its rows need not be usable: the check says what is wrong with them, and repairs it.

    Raises InputError if the file has another number of joints than the robot.
    """
    names = problem.channel_names
    if not options:
        part = read_run(path, problem.robot.n, names, recorders=recorders)
    else:
        part = convert(
            path,
            problem=problem,
            joints=options["joints"].split(",") if "joints" in options else names,
            topic=options.get("topic"),
            rename=pairs("--rename", options.get("rename")),
            motors=options.get("motors", "motor_side" in options),
            rate=numbers("rate", options.get("rate", "0"), 1)[0] or None,
            scale=pairs("--scale", options.get("scale")),
        )
    if part.n != problem.robot.n:
        raise other_robot(part.n, problem.robot.n, path)
    if not part.usable_rows.any():
        what = "no row holds a number of every channel"
        raise InputError(what, "log all channels at each instant", path)
    return part


def simulate(job: JobRequest) -> Answer:
    """Simulate runs of the chosen robot with one effect hidden in them.

    The job names the runs ("names", the last one is for testing), the "effect" and its
    "joints" (from 1), the "level" of its strength and the "seed". "effects" of the
    answer are those that the first model should have; the hidden one is not among them.
    """
    problem = job.problem
    names = job["names"]
    job.progress(f"simulating {len(names)} runs of 20 s")
    hidden = []
    if job["effect"] != "none":
        joint_indices = [number - 1 for number in job["joints"]]
        hidden.append((job["effect"], joint_indices))
    hidden_result = hidden_runs(problem, hidden, job["level"], job["seed"], len(names))
    named = zip(names, hidden_result.runs, strict=True)
    runs = tuple(replace(part, names=(name,)) for name, part in named)
    judged = _judged(
        job,
        State(problem, runs),
        [_kept_of({"use": "train", "in_commands": name}) for name in names],
    )
    return judged | {"effects": hidden_result.truth["model_effects"]}


def keep(
    job: JobRequest, problem: Problem, part: Measurements, report: Report
) -> dict[str, Any]:
    """Store a run in the session's folder, and return the page's record of it.

    Parameters
    ----------
    job : JobRequest
        The request; it names the folder.
    problem : Problem
        The robot that the run was checked for.
    part : Measurements
        The samples of the run.
    report : Report
        What the check says of it.

    Returns
    -------
    dict
        File names, name, number of samples, duration [s], sample rate [Hz], the
        check's issues, and "split": the time windows for training and testing, or None
        if the run cannot be split.
    """
    file = _run_file_name(part)
    mended = report.repaired_all
    shown = _shown_rows(part)
    if shown is not part or part.samples < 2:  # the check repairs it, or refuses it
        shown = mended = _shown_rows(mended)
        split = None
    else:
        split = split_run(problem, part)
    findings = [*report.by_cause]
    view = f"view-{file}"
    if not (job.folder / file).exists():
        save_arrays(job.folder / file, columns_of(part))
    save_arrays(job.folder / view, _preview_arrays(problem, shown, mended))
    seconds = float(shown.t[-1] - shown.t[0])
    return {
        "file": file,
        "view": view,
        "name": part.names[0],
        "samples": part.samples,
        "seconds": seconds,
        "split": split,
        "rate": sample_rate(shown) if seconds > 0.0 else 0.0,
        "findings": findings,
        "torque_unit": part.torque_unit,
        "gains_by_size": part.gains_by_size,
    }


def _run_file_name(part: Measurements) -> str:
    """Return the file name of a run: equal samples get equal names."""
    return f"run-{part.data_hash[:16]}.npz"


def _shown_rows(part: Measurements) -> Measurements:
    """Return the rows of a run that a picture can show: numbers that a robot measures,
    each later than those before; the run itself where all are such."""
    stamps = np.where(part.usable_rows, part.t, -np.inf)
    latest = np.maximum.accumulate(np.append(-np.inf, stamps[:-1]))
    is_shown = stamps > latest
    return part if is_shown.all() else part.rows(is_shown)


#: Share of a column's largest value above which a repair of it is seen.
_VISIBLE = 1e-3


def _preview_arrays(
    problem: Problem, part: Measurements, mended: Measurements
) -> dict[str, Any]:
    """Return the arrays that the page draws of a run, thinned to what a screen can
    show.

    Parameters
    ----------
    problem : Problem
        The robot, which places the arm in 3D.
    part : Measurements
        The run as recorded, N samples of n joints.
    mended : Measurements
        The run as the check would repair it; ``part`` itself if nothing is repaired.

    Returns
    -------
    dict
        t (k,) [s]; q, dq, torque (k, n); repaired_q, repaired_torque (k, n) in the log's
        units, NaN where the repair changes nothing; tf (F,) [s] and poses (F, joints, 4,
        4) of the arm.
    """
    raw = np.hstack([part.q, part.tau])
    repaired = np.hstack([mended.q, mended.tau])
    if len(repaired) != len(raw):  # a repair may remove rows
        columns = [np.interp(part.t, mended.t, column) for column in repaired.T]
        repaired = np.column_stack(columns)
    for side in (slice(part.n), slice(part.n, None)):
        repaired[:, side] /= _scale_of_unit(raw[:, side], repaired[:, side])
    is_changed = np.abs(repaired - raw) > _VISIBLE * np.nanmax(np.abs(repaired), axis=0)
    repaired = np.where(is_changed, repaired, np.nan)
    # Rows evenly spread over the run, and at most POINTS of the repaired ones.
    changed = np.flatnonzero(is_changed.any(axis=1))
    few = changed[:: 1 + len(changed) // POINTS]
    k = np.unique(np.concatenate([spread_rows(len(part.t)), few]))
    velocity = part.dq
    if velocity is None:
        velocity = np.zeros_like(part.q)
        if part.samples > 1:
            velocity = np.gradient(part.q, part.t, axis=0)
    tf, poses = placed(problem.robot, part.t, part.q)
    return {
        "t": part.t[k],
        "q": part.q[k],
        "dq": velocity[k],
        "torque": part.tau[k],
        "repaired_q": repaired[k, : part.n],
        "repaired_torque": repaired[k, part.n :],
        "tf": tf,
        "poses": poses,
    }


def _scale_of_unit(raw: Array, repaired: Array) -> float:
    """Return the factor by which a repair scales all columns (N, n), as another unit
    does; 1 where it scales them differently."""
    spreads = np.nanstd(raw, axis=0), np.nanstd(repaired, axis=0)
    moves = (spreads[0] > 0.0) & (spreads[1] > 0.0)
    factors = (spreads[1][moves] / spreads[0][moves]).tolist() or [1.0]
    return min(factors) if max(factors) < 1.01 * min(factors) else 1.0


def placed(robot: Robot, t: Array, q: Array) -> tuple[Array, Array]:
    """Place the arm at up to 160 instants of a motion t (N,) [s], q (N, n) [rad, m],
    for the 3D view.

    Returns
    -------
    (F,) array and (F, joints, 4, 4) array
        Evenly spaced instants [s] and the pose of each joint there. The page
        interpolates between them.
    """
    rows = np.unique(np.linspace(0, len(t) - 1, POSES_OF_A_RUN).astype(int))
    positions_in_tree = robot.tree_state(q[rows])[0]
    return t[rows], robot.poses(positions_in_tree).astype(np.float32)


def save_arrays(file: Path, arrays: dict[str, Any]) -> None:
    """Save arrays by name as an .npz file, atomically: completely or not at all."""
    with writing(file) as out:
        np.savez(out, allow_pickle=False, **arrays)


def robot(job: JobRequest) -> Answer:
    """Return what the page shows of the chosen robot, a built-in one or a URDF file, and
    its meshes, stored for the 3D view.
    """
    problem = job.problem
    return robot_facts(job, problem) | {"meshes": _kept_meshes(job, problem)}


def robot_facts(job: JobRequest, problem: Problem) -> Answer:
    """Return what the page shows of a robot; store the motion of one joint after the
    other, which shows their order.

    Returns
    -------
    dict
        Title, name, number of joints n, joint names, torque units, effects of a first
        model, the arm's ellipsoids for the 3D view ("drawn") and the file of its motion
        ("sweep"), gravity [m/s^2] ("gravity"), the held joints as text ("hold"), and the
        public data set of a built-in
        robot ("data"), if there is one.
    """
    joints = problem.channel_names
    source = job["robot"]["source"]
    measured = (x for x in DATASETS.values() if x.problem == problem.name == source)
    summary_words = formatting.count(problem.robot.n, "joint") + ", from URDF"
    return {
        "title": summary_words if problem.folder is None else problem.title,
        "name": problem.name,
        "n": problem.robot.n,
        "joints": joints,
        "units": [formatting.plain_unit(unit) for unit in problem.robot.torque_units],
        "effects": list(problem.default_effects),
        "drawn": drawn_arm(problem.robot, problem.nominal_links),
        "sweep": _kept_sweep(job, problem.robot),
        "gravity": problem.robot.gravity,
        "hold": ",".join(f"{j.name}={j.value:.6g}" for j in joints.held),
        "data": next((to_json(d) for d in measured), None),
    }


#: Swing of each joint in turn [rad, m], and instants of a swing, a tenth of a second each.
_SWING = {"N*m": 0.5, "N": 0.1}
_INSTANTS = 20


def _kept_sweep(job: JobRequest, robot: Robot) -> str:
    """Store a motion of one joint after the other, and return its file: instants (F,)
    [s], poses (F, joints, 4, 4), and which joint moves, (F, n)."""
    wave = np.sin(np.linspace(0.0, 2.0 * np.pi, _INSTANTS))
    moves = np.kron(np.eye(robot.n), np.ones((_INSTANTS, 1)))
    swing = np.array([_SWING.get(unit, 0.5) for unit in robot.torque_units])
    q = moves * np.tile(wave, robot.n)[:, None] * swing
    t = 0.1 * np.arange(len(q))
    poses = robot.poses(robot.tree_state(q)[0]).astype(np.float32)
    held = "-".join(str(joint.place) for joint in robot.joint_names.held)
    file = f"sweep-{held}.npz"
    save_arrays(job.folder / file, {"t": t, "tf": t, "poses": poses, "moves": moves})
    return file


def _kept_meshes(job: JobRequest, problem: Problem) -> list[Answer]:
    """Store the links' meshes as STL files for the 3D view; return joint, file and
    placement.

    There are none unless the robot is a URDF, xacro or SDF whose meshes lie next to it
    or in a package of ROS. A mesh that cannot be read is left out.
    """
    source = Path(job["robot"]["source"])
    if not source.is_file() or format_of(read_bytes(source)) == "mjcf":
        return []
    job.progress("reading meshes")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", Remark)  # the picture goes without
        with as_urdf(source) as file:
            surfaces = link_surfaces(file)
    robot = problem.robot
    if len(surfaces) != len(robot.link_joints):
        return []
    kept = []
    for joint, surface in zip(robot.link_joints, surfaces, strict=True):
        if surface is None:
            continue
        name = f"mesh-{joint}.stl"
        write_bytes(job.folder / name, binary_stl(simplified(surface)))
        place = robot.tree[joint].link_frame
        kept.append({"joint": joint, "file": name, "place": np.asarray(place)})
    return kept


def fit(job: JobRequest) -> Answer:
    """Identify a model as `sdp-vs-penalty identify` does, and judge it.

    The data check comes first, unless ``job["anyway"]`` skips it. Returns the model's
    record for the page (:func:`summary`).
    """
    options = job["options"]
    bounded = with_bounds(job.problem, options.get("bounds"))
    problem = with_filters(bounded, options.get("filters"))
    recordings = job.recordings("train")
    # Windows all over a long recording stand for it; its parts would be judged in full.
    judged = recordings if any(map(is_long, recordings.runs())) else None
    estimate, _ = identify_and_judge(
        problem,
        job.windowed(job.runs.train),
        with_solver(job["method"], options.get("solver")),
        PoseOptions.from_texts(
            **{
                **{f.name: options.get(f.name) for f in fields(PoseOptions)},
                "effects": job["effects"],
                "workers": Workers(int(job.number("jobs", 1)), progress=job.progress),
                "progress": job.progress,
            }
        ),
        noise_from=recordings,
        # Unheard: the page shows each run's issues beside the run.
        check=not job["anyway"] and Gate(no_progress, runs=judged),
    )
    return summary(job, estimate)


def open_model(job: JobRequest) -> Answer:
    """Judge a model.json that a person brought on the session's runs.

    Raises InputError if the model is of a robot with other joints.
    """
    train = job.runs.train
    estimate = job.model
    estimate.require_joints(train, job["model"])
    job["frozen"] = True
    return summary(job, estimate)


def judge(job: JobRequest) -> Answer:
    """Judge the models of a history again, on the runs as they are used now.

    ``job["steps"]`` holds of each its file ("model"), the new file ("out"), and whether
    its parameters are kept ("frozen"). Returns
    {"steps": the record of each, as :func:`summary` makes it}.
    """
    records = []
    for step in job["steps"]:
        job.update(step)
        records.append(summary(job, job.model))
    return {"steps": records}


def extend(job: JobRequest) -> Answer:
    """Add effects to the current model as `sdp-vs-penalty add` does, and judge the
    result.

    ``job["change"]`` is a remedy's: the effects, and which findings of the diagnosis
    ``job["diagnosed"]`` these are. Findings carry their intervals into the model.
    """
    found = job.get("diagnosed")
    diagnosis = None if not found else Diagnosis.from_dict(found)
    effects = what_to_add(Change.from_dict(job["change"]), diagnosis)
    how: dict[str, Any] = {"frozen": job["frozen"], "progress": job.progress}
    bigger = add(job.model, effects, job.runs.train, **how)
    return summary(job, bigger)


def find(job: JobRequest) -> Answer:
    """Diagnose which effects the current model misses, as `sdp-vs-penalty diagnose`
    does.

    Returns
    -------
    dict
        "diagnosis"; "curves": what `add` calls each measured curve; "verdict": that of
        the model, ``job["verdict"]``, with what is missing; "verdicts": the same of each
        file of ``job["exported"]``. The curves that the page draws are saved as
        ``job["pictures"]``.
    """
    runs = job.runs
    model = job.model
    how: dict[str, Any] = {"frozen": job["frozen"], "progress": job.progress}
    result, better = diagnose_and_add(
        model,
        runs.train,
        runs.test,
        noise_from=runs.all_runs,
        check=Gate(no_progress),
        judged_recordings=runs.judged_recordings,
        **how,
    )
    save_arrays(job.folder / job["pictures"], _card_arrays(model, better, runs.judge))
    curves = [curve.effect(model.robot).text for curve in result.curves]
    return {
        "diagnosis": result.to_dict(),
        "curves": curves,
        "verdict": with_findings(
            Verdict.from_dict(job["verdict"]), result, model
        ).to_dict(),
        "verdicts": {
            name: verdict_on_file(
                Verdict.from_dict(record["verdict"]), record["loss"], result, model
            ).to_dict()
            for name, record in job["exported"].items()
        },
    }


def _card_arrays(
    model: Estimate, better: Estimate | None, judged: Measurements
) -> dict[str, Any]:
    """Return the arrays from which the page draws the findings, thinned to M rows.

    Parameters
    ----------
    better : Estimate or None
        The model with every confident finding added, if there is one.

    Returns
    -------
    dict
        t (M,) [s]; q, dq, measured (M, n): motion and measured torque; before (M, n):
        torque of ``model``; after: of ``better``, if there is one.
    """
    models = {"before": model}
    if better is not None:
        models["after"] = better
    signals = {judged.name: judged.signals for judged in compare(models, judged)}
    before = signals["before"]
    rows = spread_rows(len(before.t), CARD_ROWS)
    arrays = {name: getattr(before, name) for name in ("q", "dq", "measured")}
    arrays |= {name: x.modelled for name, x in signals.items()}
    thinned = {
        name: np.asarray(values[rows], np.float32) for name, values in arrays.items()
    }
    return {"t": before.t[rows], **thinned}


def methods(job: JobRequest) -> Answer:
    """Identify the current model's effects by other methods and judge each on the same
    runs.

    ``job["methods"]`` names them; the reason stands beside one that fails. Returns
    {"table": ..., "reasons": ...}.
    """
    runs = job.runs
    current = job.model
    train = job.windowed(runs.train)
    if not job["methods"]:
        raise InputError("No method is chosen", "choose at least one to compare")
    filtered = read_and_filter(current.problem, train)
    rows = list[tuple[str, str, tables.Facts]]()
    reasons = dict[str, str]()
    for name in job["methods"]:
        effects = current.model.effects
        options = PoseOptions(effects=effects, progress=job.progress)
        job.progress(f"by {name}")
        try:
            estimates_made = estimate_parameters(
                current.problem, filtered, name, options
            )
        except InputError as error:
            rows.append((name, "failed", {}))
            reasons[name] = error.without_command
            continue
        (judged,) = compare(
            {name: estimates_made}, runs.judge, noise_from=runs.judged_recordings
        )
        rows.append((name, judged.verdict.grade, judged.facts()))
        reasons[name] = judged.verdict.lines[0].text
    return {"table": tables.model_table(rows, "method").to_dict(), "reasons": reasons}


def take(job: JobRequest) -> Answer:
    """Write the file that a person wants to download; its name decides the content.

    "run-<number>.csv" is a run as it was used, "findings.json" the diagnosis,
    "report.html" the report; any other name is the model in the format of its suffix.
    """
    name = job["name"]
    out = job.folder / name
    job.progress(f"writing {name}")
    if name.startswith("run-"):
        run = job["runs"][int(name[4:-4]) - 1]
        save(load_measurements(job.folder / run["file"]), out)
    elif name == "findings.json":
        write_text(out, json.dumps(job["findings"], indent=1, allow_nan=False) + "\n")
    elif name == "model.json":
        write_bytes(out, Path(job["model"]).read_bytes())
    elif name == "report.html":
        _write_report(job, out)
    else:
        _write_export(job, out)
    return {}


def _write_report(job: JobRequest, out: Path) -> None:
    """Write the HTML report on all models of the session's history."""
    models = {m["label"]: load_estimate(m["file"]) for m in job["models"]}
    findings = job.get("findings")
    runs = job.runs
    write_report(
        models,
        runs.judge,
        out,
        noise_from=runs.judged_recordings,
        findings=None if findings is None else Diagnosis.from_dict(findings),
        commands=job["commands"],
        forward=job["forward"],
        progress=job.progress,
    )


def _write_export(job: JobRequest, out: Path) -> None:
    """Export the current model in the format of the file's suffix.

    Its head has the verdict ``job["verdict"]``, which the page shows beside it; what the
    model was identified again without, ``job["identified_without"]``, is left out too.
    """
    urdf = job.get("urdf") if out.name == "robot.urdf" else None
    x, y, z = numbers("flange", job.get("flange") or "0,0,0", 3)
    model = job.model
    model.provenance["verdict"] = job["verdict"]
    judged = Verdict.from_dict(job["verdict"])
    write_model(
        model,
        out,
        urdf,
        flange=(x, y, z),
        judged=judged,
        identified_without=job.get("identified_without", ()),
    )


def forward(job: JobRequest) -> Answer:
    """Simulate the current model along the judged runs, as `simulate --follow` does.

    A free run starts from a measured state and is driven by the logged torque (or by
    what ``job["drive"]`` names).

    Returns
    -------
    dict
        "verdict", "explained": sentences; "left_out": effects that a simulation cannot
        use; "table": the errors.
    """
    following = follow(
        job.model, job.runs.judge, drive=job["drive"], progress=job.progress
    )
    said = {x: getattr(following, x) for x in ("verdict", "explained", "left_out")}
    return {**said, "table": following.table().to_dict()}


def ranges(job: JobRequest) -> Answer:
    """Find between which values the masses of the current model can lie, by the training
    runs. Returns {"table": ..., "notes": sentences}."""
    train = job.windowed(job.runs.train)
    found = find_ranges(job.model, train, progress=job.progress)
    return {"table": found.table().to_dict(), "notes": found.notes()}


def about(estimate: Estimate) -> dict[str, Any]:
    """Return a model's parameters as the page shows them.

    Returns
    -------
    dict
        "parameters", "links", "certificate": tables; "words": caveats; "friction":
        torque over velocity with half its 95 % interval ("half"), for each joint;
        "bodies", "joints": the arm in 3D (:func:`drawn_arm`).
    """
    links = tables.link_table(estimate)
    links_drawn: Any = estimate.links if len(estimate.model.rigid_indices) else []
    if estimate.torque_units != estimate.robot.torque_units:  # they are not in kg
        links_drawn = estimate.problem.nominal_links
    return {
        "parameters": tables.parameter_table(estimate.entries).to_dict(),
        "links": None if links is None else links.to_dict(),
        "words": words.caveats(estimate),
        "friction": [
            {"velocity": c.velocity, "torque": c.torque, "half": NORMAL_95 * c.std}
            for c in friction_curves(estimate)
        ],
        "certificate": tables.certificate_table({"model": estimate}).to_dict(),
        **drawn_arm(estimate.robot, links_drawn),
    }


def _distinct_names(runs: Sequence[Measurements]) -> list[str]:
    """Name each run; parts of one recording are told apart by their seconds."""
    names = [run.names[0] for run in runs]
    distinct = []
    for name, run in zip(names, runs, strict=True):
        if names.count(name) > 1:
            begin, end = (f"{round(float(t), 3):.4g}" for t in run.t[[0, -1]])
            name += f", {begin} to {end} s"
        distinct.append(name)
    return distinct


def _files_judged(
    job: JobRequest,
    estimate: Estimate,
    filtered: FilteredRuns,
    comparison: Comparison,
    diagnosis: Diagnosis | None,
    is_refitted: bool,
) -> Answer:
    """Judge what each file of `export` holds of a model, where that is not all: the field
    ``exported`` of ModelStep. ``comparison`` is that of the model on the same runs.

    A file that errs more than the model is made of a model that is identified again for
    it (``is_refitted``: unless parameters are kept), which is saved beside ``job["out"]``.
    """
    judged = {}
    limit = (1.0 + CHANGES) * comparison.errors.size
    training: FilteredRuns | None = None
    refits = dict[tuple[str, ...], tuple[AsExported, str]]()
    for home in EXPORTS.all().values():
        held = judge_as_exported(estimate, home.FILE, filtered, comparison, diagnosis)
        if held is None:
            continue
        of_file, model = held, ""
        if is_refitted and held.comparison.errors.size > limit:
            if training is None:
                job.progress("fitting what the files can hold")
                train = job.windowed(job.runs.train)
                training = FilteredRuns.filtering(train, estimate.preprocessing)
            laws = laws_in_place(estimate, held, home.FILE, diagnosis)
            texts = tuple(x.text for x in (*held.model.model.effects, *laws))
            if texts not in refits:
                on = training, filtered, comparison, diagnosis
                again = refit_as_exported(held, laws, *on)
                out = Path(job["out"])
                out = out.with_name(f"held-{len(refits) + 1}-{out.name}")
                again.model.save(out)
                refits[texts] = again, out.name * again.is_refitted
            of_file, model = refits[texts]
        judged[home.FILE] = {
            **_error_of(of_file.comparison),
            "lost": effects_in_words(of_file.lost),
            "left_out": [*of_file.lost],
            "loss": describe_loss(of_file.outcome),
            "losses": ", ".join(map(of_file.outcome.share_of, of_file.outcome.rising)),
            "n_lost": len(of_file.lost),
            "effects": effects_to_estimate_again(
                of_file.model.model.effects, of_file.model.report.shapes
            ),
            "verdict": of_file.verdict.to_dict(),
            "model": model,
            "in_place": effects_in_words([x.text for x in of_file.laws_in_place]),
        }
    return judged


def _error_of(compared: Comparison) -> Answer:
    """Return the largest error of a joint, by which models are compared ("size"), that of
    the joint that errs most beside a grade ("error"), and in a sentence ("worst")."""
    errors = compared.errors
    worst = words.describe_worst(compared, "")
    if errors.kind:  # a model and its files are judged on the same
        worst = worst.replace(f", {errors.kind}", "")
    return {"size": errors.size, "error": errors.size_in_words, "worst": worst}


def _curves_of_run(estimate: Estimate, arm: Estimate, rows: Rows) -> dict[str, Any]:
    """Return the arrays that the page draws of one run of M filtered rows.

    Returns
    -------
    dict
        t (M,) [s]; torque, modelled, q, dq, ddq (M, n), in single precision; tf (F,)
        [s] and poses (F, joints, 4, 4) of the arm for the 3D view.
    """
    motion = rows.motion
    curves = {
        "torque": rows.torque,
        "modelled": predicted(rows, arm.theta),
        "q": motion.q,
        "dq": motion.dq,
        "ddq": motion.ddq,
    }
    single = {name: curve.astype(np.float32) for name, curve in curves.items()}
    tf, poses = placed(estimate.robot, motion.t, motion.q)
    return {"t": motion.t, **single, "tf": tf, "poses": poses}


def _failures_of(
    estimate: Estimate, judge: Measurements, comparison: Comparison
) -> list[Answer]:
    """Return for each joint where and why the model fails, with sentences for the page.

    The list is empty if the judged runs are too short to tell. Of long ones the first
    MOST_LOOKED_AT rows are looked at.
    """
    remark = []
    if judge.samples > MOST_LOOKED_AT:
        share = MOST_LOOKED_AT / judge.samples
        remark = [f"Looked at in the first {share:.0%} of what is judged."]
        left = MOST_LOOKED_AT
        begin = list[Measurements]()
        for run in judge.runs():
            if left > 0:
                begin.append(run.rows(slice(0, left)))
                left -= run.samples
        judge = concatenate(begin)
    try:
        failures = where_it_fails(estimate, judge, noise=comparison.noise)
    except InputError:
        return []
    units = estimate.torque_units
    return [
        {
            **failure.to_dict(),
            "sentences": [*sentences(failure, units[failure.joint - 1]), *remark],
        }
        for failure in failures
    ]


def _errors_in_reach(
    test: Mapping[str, Any], training: Sequence[Mapping[str, Any]]
) -> Array | None:
    """Return the error of each joint (n,) [N m, N] in those rows of a test run in which
    every joint's position and velocity lies between those of the training runs; None
    where they are less than LEAST_REACHED of it. The runs are as :func:`_curves_of_run`
    returns them."""
    within = np.ones(len(test["t"]), bool)
    for name in ("q", "dq"):
        known = np.concatenate([run[name] for run in training])
        is_known = (test[name] >= known.min(axis=0)) & (test[name] <= known.max(axis=0))
        within &= is_known.all(axis=1)
    if np.count_nonzero(within) <= LEAST_REACHED * len(within):
        return None
    errors = (test["torque"] - test["modelled"])[within]
    return np.sqrt(np.mean(np.square(errors, dtype=float), axis=0))


def summary(job: JobRequest, estimate: Estimate) -> Answer:
    """Judge a model, save it at ``job["out"]``, and return its record for the history.

    The curves of each run, training runs first, are saved next to the model as .npz: t
    (M,) [s]; torque, modelled, q, dq, ddq (M, n); tf (F,) [s] and poses (F, joints, 4,
    4) for the 3D view. The record has the fields of ModelStep.
    """
    seconds = time.perf_counter() - job.begin
    checked = job.runs
    out = Path(job["out"])
    job.progress("comparing measured with modelled")
    settings = estimate.preprocessing.resolve(checked.judge)
    judged = FilteredRuns.filtering(checked.judge, settings)
    (comparison,) = compare(
        {"model": estimate}, judged, noise_from=checked.judged_recordings
    )
    # A model of servos turns commands into torques; ``arm`` is the arm within it.
    arm, judge = driven(estimate, checked.judge)
    _, train = driven(estimate, checked.train)
    settings = estimate.preprocessing.resolve(judge)
    found = job.get("diagnosed")
    diagnosis = Diagnosis.from_dict(found) if found else None
    verdict_of_model = verdict_beside(diagnosis, comparison).to_dict()
    estimate.provenance["verdict"] = verdict_of_model
    runs = [*train.runs(), *(judge.runs() if checked.test is not None else ())]
    is_short = checked.all_runs.samples <= MOST_JUDGED_APART
    curves = []
    for number, run in enumerate(runs):
        rows = FilteredRun(run, settings).all_rows(arm.model)
        arrays = _curves_of_run(estimate, arm, rows)
        save_arrays(out.with_name(f"{out.stem}-{number}.npz"), arrays)
        if is_short:
            curves.append(arrays)
    errors_of_runs = {}
    errors_in_reach = {}
    uses = {run["use"] for run in job.used}
    if uses == {"train", "test"} and is_short:
        for run in runs:
            filtered = FilteredRuns.filtering(run, settings)
            (alone,) = compare_filtered(
                {"model": arm}, filtered, noise=comparison.noise
            )
            errors_of_runs[run.names[0]] = alone.rmse
        trained, tested = curves[: len(train.runs())], curves[len(train.runs()) :]
        errors_in_reach = {
            run.names[0]: errors
            for run, arrays in zip(judge.runs(), tested, strict=True)
            if (errors := _errors_in_reach(arrays, trained)) is not None
        }
    factory = {}
    if arm is estimate:
        as_it_came = {"factory": nominal_model(estimate.problem)}
        (stated,) = compare_filtered(as_it_came, judged, noise=comparison.noise)
        factory = _error_of(stated)
    job.progress("judging the files to export")
    frozen = any(effect.frozen_only for effect in estimate.model.effects)
    exported = _files_judged(
        *(job, estimate, judged, comparison, diagnosis),
        is_refitted=not (frozen or job.get("frozen")),
    )
    job.progress("looking where it fails")
    failures = _failures_of(estimate, judge, comparison)
    estimate.save(out)
    return {
        "file": str(out),
        "runs": _distinct_names(runs),
        "judged_on": list(judge.names),
        "errors_of_runs": errors_of_runs,
        "errors_in_reach": errors_in_reach,
        "method": estimate.method,
        "effects": effects_to_estimate_again(
            estimate.model.effects, estimate.report.shapes
        ),
        "errors": _error_of(comparison),
        "factory": factory,
        "exported": exported,
        "comparison": {**comparison.to_dict(), "verdict": verdict_of_model},
        "failures": failures,
        "about": about(estimate),
        "on_bounds": [f"{what}: {why}" for what, why in estimate.held_by_bounds],
        "seconds": seconds,
        "servo": arm is not estimate,
    }
