"""What a worker can be asked to do: one function a job, from a request to an answer,
both plain JSON.

Every job loads what it needs from files of the session's folder and leaves its runs and
models there, so that a job that is killed has changed nothing.
"""

import json
import time
import warnings
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from sdp_vs_penalty import formatting
from sdp_vs_penalty.api.diagnosis import diagnose_and_add
from sdp_vs_penalty.api.exporting import judge_as_exported
from sdp_vs_penalty.api.identification import identify_and_judge
from sdp_vs_penalty.checks import Report, check
from sdp_vs_penalty.checks.fixing import fix_runs
from sdp_vs_penalty.data.files import check_usable, load_measurements, save, windowed
from sdp_vs_penalty.data.formats.column_report import describe_columns
from sdp_vs_penalty.data.formats.columns import columns_of
from sdp_vs_penalty.data.measurements import Measurements, Runs, concatenate
from sdp_vs_penalty.data.parsing import numbers, pairs, time_windows
from sdp_vs_penalty.diagnosis.adding import add
from sdp_vs_penalty.diagnosis.comparison import Comparison, compare, predicted
from sdp_vs_penalty.diagnosis.findings import Diagnosis
from sdp_vs_penalty.diagnosis.open_findings import has_open_finding, still_missing
from sdp_vs_penalty.diagnosis.where_it_fails import sentences, where_it_fails
from sdp_vs_penalty.errors import InputError, Remark, other_robot
from sdp_vs_penalty.estimation.build_problem import PoseOptions, read_and_filter
from sdp_vs_penalty.estimation.constants import NORMAL_95
from sdp_vs_penalty.estimation.drive_torque import driven
from sdp_vs_penalty.estimation.estimate import Estimate, load_estimate
from sdp_vs_penalty.estimation.identify import estimate_parameters
from sdp_vs_penalty.estimation.resampling import cross_validate
from sdp_vs_penalty.estimation.shapes import effects_to_estimate_again
from sdp_vs_penalty.estimation.verdict import Verdict
from sdp_vs_penalty.estimators import with_solver
from sdp_vs_penalty.estimators.estimator import Progress, no_progress
from sdp_vs_penalty.exporters.export import write_model
from sdp_vs_penalty.exporters.friction_table import friction_curves
from sdp_vs_penalty.files import write_bytes, write_text, writing
from sdp_vs_penalty.page.splits import confirmed, other_splits, split_run
from sdp_vs_penalty.parallel import Workers
from sdp_vs_penalty.problem.load import convert, load_problem, with_bounds, with_filters
from sdp_vs_penalty.problem.problem import Problem
from sdp_vs_penalty.render import tables, words
from sdp_vs_penalty.render.arms import drawn_arm
from sdp_vs_penalty.render.charts import POINTS, spread_rows
from sdp_vs_penalty.reports import report as write_report
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.robot import Robot
from sdp_vs_penalty.signals.filtered import FilteredRun
from sdp_vs_penalty.simulation.follow import follow
from sdp_vs_penalty.simulation.hidden_runs import hidden_runs

Answer = dict[str, Any]
#: Rows of which the pictures of a diagnosis are drawn.
CARD_ROWS = 20_000


class JobRequest(dict[str, Any]):
    """A request, by its words; progress : hears what is being done."""

    def __init__(
        self,
        words: Mapping[str, Any],
        progress: Progress = no_progress,
    ) -> None:
        super().__init__(words)
        self.progress = progress
        self.begin = time.perf_counter()

    @property
    def folder(self) -> Path:
        """The session's own."""
        return Path(self["folder"])

    @property
    def problem(self) -> Problem:
        return load_problem(self["robot"]["source"], self["robot"].get("gravity"))

    @property
    def model(self) -> Estimate:
        return load_estimate(self["model"])

    @property
    def common_options(self) -> dict[str, Any]:
        """What several verbs take."""
        options_given = {
            "frozen": self.get("frozen"),
            "seed": self["seed"],
            "progress": self.progress,
        }
        return {name: x for name, x in options_given.items() if x is not None}

    def progress_of(self, name: str, text: str) -> None:
        """Tell where the work on one of several things stands."""
        self.progress(f"{name}: {text}")

    def number(self, name: str, default: float) -> float:
        """A number that was written among the options. Raises InputError for another
        text."""
        text = self["options"].get(name)
        return default if text is None else numbers(name.replace("_", " "), text, 1)[0]

    def windowed(self, run: Measurements) -> Measurements:
        """What the option ``window`` leaves of a run."""
        return windowed(run, time_windows(self["options"].get("window")))

    @property
    def runs(self) -> Runs:
        """The runs for what each is used for, under their shown names.

        A run of use "split" gives part of its motion to the first, the rest to the
        others.
        """
        files = [self.folder / run["file"] for run in self["runs"]]
        if not any(run["use"] in ("train", "split") for run in self["runs"]):
            raise InputError("No run to identify from", "use at least one for it")
        loaded = load_measurements(*files)
        sides: dict[str, list[Measurements]] = {
            "train": [],
            "test": [],
        }
        for run, part in zip(self["runs"], loaded.runs(), strict=True):
            for side, stretch in _by_use(run, part):
                sides[side].append(stretch)
        test = concatenate(sides["test"]) if sides["test"] else None
        judged = self._recordings("train" if test is None else "test")
        return Runs(concatenate(sides["train"]), test, loaded, judged)

    def _recordings(self, side: str) -> Measurements:
        """The runs, as they were recorded, of which all or a part is on a side of the
        split: "train" or "test"."""
        files = [
            self.folder / run["file"]
            for run in self["runs"]
            if run["use"] in (side, "split")
        ]
        return load_measurements(*files)

    @property
    def training_recordings(self) -> Measurements:
        """The runs that are identified from, without windows."""
        return self._recordings("train")


def _by_use(
    run: Mapping[str, Any], part: Measurements
) -> Iterator[tuple[str, Measurements]]:
    """What a run is used for, "train" or "test", with what of it is; of a split run
    both."""
    named = replace(part, names=(run["name"],))
    if run["use"] != "split":
        yield run["use"], named
        return
    for side in ("train", "test"):
        windows = [(a, b) for a, b in run["split"][side]]
        yield side, windowed(named, windows)


def read(job: JobRequest) -> Answer:
    """files : {path, name} of each; those that can be used become runs, the others a
    sentence each."""
    problem = job.problem
    runs = list[Answer]()
    refused = list[str]()
    remarks = list[str]()
    mappings = list[Answer]()
    for file in job["files"]:
        job.progress(f"reading {file['name']}")
        path = Path(file["path"])
        try:
            with warnings.catch_warnings(record=True) as heard:
                warnings.simplefilter("always", Remark)
                part = _loaded(job, problem, path)
            remarks += [str(w.message) for w in heard if issubclass(w.category, Remark)]
            for twin in (
                run for run in (*job["runs"], *runs) if run["file"] == _file(part)
            ):
                raise InputError(
                    f"holds the same samples as {twin['name']}",
                    "name each run once",
                    path,
                )
            alone = len(job["files"]) == 1 and not job["runs"]
            runs.append(
                keep(
                    job,
                    problem,
                    part,
                    file["name"],
                    alone=alone,
                )
            )
        except InputError as error:
            refused.append(str(error))
            columns = _columns_of(path, problem)
            if columns is not None:
                mappings.append({**file, **columns})
    return {
        "runs": runs,
        "refused": refused,
        "remarks": remarks,
        "mappings": mappings,
    }


def _columns_of(path: Path, problem: Problem) -> Answer | None:
    """What the recogniser makes of a refused file's columns, for a person to correct:
    its columns with their first cells, our names, and the column chosen for each; None
    where it lacks no column."""
    joints = problem.robot.joint_names
    with suppress(InputError):
        report = describe_columns(path, joints)
        if report is None or not (report.missing or report.problem):
            return None
        numbers = range(1, len(joints) + 1)
        ours = [
            "t",
            *(f"{group}{j}" for group in ("q", "tau") for j in numbers),
        ]
        if len(report.rows) < len(ours):
            return None  # no choice gives every joint a column
        return {
            "columns": [row.name for row in report.rows],
            "cells": [", ".join(row.first_cells[:3]) for row in report.rows],
            "ours": ours,
            "chosen": [report.rename.get(name, "") for name in ours],
        }
    return None


def _loaded(job: JobRequest, problem: Problem, path: Path) -> Measurements:
    """A run; by the options of `convert` where any is given."""
    options = job["options"]
    names = problem.robot.joint_names
    if not options:
        return load_measurements(path, joints=problem.robot.n, names=names)
    part = convert(
        path,
        problem=problem,
        joints=options["joints"].split(",") if "joints" in options else names,
        topic=options.get("topic"),
        rename=pairs("--rename", options.get("rename")),
        motors=options.get("motors", "motor_side" in options),
        rate=job.number("rate", 0.0) or None,
    )
    if part.n != problem.robot.n:
        raise other_robot(part.n, problem.robot.n, path)
    check_usable(path, part)
    return part


def look_again(job: JobRequest) -> Answer:
    """The runs, checked for the robot as it is now."""
    problem = job.problem
    parts = ((load_measurements(job.folder / run["file"]), run) for run in job["runs"])
    return {
        "runs": [
            keep(
                job,
                problem,
                part,
                run["name"],
                run["use"],
            )
            for part, run in parts
        ]
    }


def simulate(job: JobRequest) -> Answer:
    """Runs of these names, the last for testing, with an effect hidden; the truth is not
    shown."""
    problem = job.problem
    names = job["names"]
    job.progress(f"simulating {len(names)} runs of 20 s")
    hidden = [(job["effect"], [j - 1 for j in job["joints"]])] * (
        job["effect"] != "none"
    )
    hidden_result = hidden_runs(
        problem,
        hidden,
        job["level"],
        job["seed"],
        len(names),
    )
    named = zip(names, hidden_result.runs, strict=True)
    runs = [
        keep(
            job,
            problem,
            part,
            name,
        )
        for name, part in named
    ]
    return {"runs": runs, "effects": hidden_result.truth["model_effects"]}


def mend(job: JobRequest) -> Answer:
    """What `check --fix` does to one of the runs: its repaired copy, and what was
    changed."""
    problem = job.problem
    run_given = next(run for run in job["runs"] if run["file"] == job["file"])
    part = replace(
        load_measurements(job.folder / run_given["file"]), names=(run_given["name"],)
    )
    job.progress(f"repairing {run_given['name']}")
    reports = check(problem, part, thorough=False)
    repaired = fix_runs(problem, [part], reports)
    name = f"{Path(run_given['name']).stem}_fixed.csv"
    run_made = keep(
        job,
        problem,
        repaired.runs[0],
        name,
        use=run_given["use"],
    )
    changes = reports[0].changes(run_given["name"], repaired.issues[0])
    return {"run": run_made, "changes": changes.splitlines()}


def keep(
    job: JobRequest,
    problem: Problem,
    part: Measurements,
    name: str,
    use: str = "train",
    alone: bool = False,
) -> dict[str, Any]:
    """Write a run into the session's folder; what the page shows of it.

    split : the windows of the use "split", by phase where the motion repeats, None
    where it does so too fast; alone : there is no other run, so that it will be split,
    and the check looks at its windows as well.
    """
    job.progress(f"checking {name}")
    part = replace(part, names=(name,))
    (report_of_run,) = check(problem, part, thorough=False)
    split = split_run(problem, part)
    findings = [
        {
            **f.to_dict(),
            "gravity": f.gravity,
        }
        for f in report_of_run.errors_and_warnings
    ]
    # Of a long run the check looks at windows all over it anyway.
    if alone and split is not None and not report_of_run.is_long:
        findings += _of_windows(problem, part, split, report_of_run)
    file = _file(part)
    view = f"view-{file}"
    save_arrays(job.folder / file, columns_of(part))
    save_arrays(job.folder / view, _preview(problem, part, report_of_run.repaired_all))
    seconds = float(part.t[-1] - part.t[0])
    return {
        "file": file,
        "view": view,
        "name": name,
        "use": use,
        "samples": part.samples,
        "seconds": seconds,
        "split": split,
        "rate": (part.samples - 1) / seconds if seconds > 0.0 else 0.0,
        "findings": findings,
    }


def _of_windows(
    problem: Problem,
    part: Measurements,
    split: Mapping[str, Any],
    whole: Report,
) -> list[dict[str, Any]]:
    """What the check says of the parts that a run is split into and not of the whole:
    these are what is identified from and judged. They offer no repair."""
    known = {(f.kind, f.where) for f in whole.issues}
    found = []
    for side, word in (("train", "identified from"), ("test", "judged")):
        reports = check(
            problem,
            windowed(part, split[side]),
            thorough=False,
        )
        for issue in (i for report in reports for i in report.errors_and_warnings):
            if (issue.kind, issue.where) in known:
                continue
            known.add((issue.kind, issue.where))
            what = f"In the windows that are {word}: {issue.what}"
            told = replace(issue, what=what, repair=None)
            found.append({**told.to_dict(), "gravity": issue.gravity})
    return found


def _file(part: Measurements) -> str:
    """Where the session keeps a run: by its samples."""
    return f"run-{part.data_hash[:16]}.npz"


def _preview(
    problem: Problem,
    part: Measurements,
    mended: Measurements,
) -> dict[str, Any]:
    """What the page shows of a run at once: t, q, dq, tau at some instants, the
    positions and torques that the check would put there (NaN where it changes nothing),
    and the arm's poses."""
    raw = np.hstack([part.q, part.tau])
    if mended is part:
        repaired = np.full_like(raw, np.nan)
    else:
        repaired = _where_changed(raw, _repaired_rows(part, mended))
    shown = spread_rows(len(part.t))
    changed = np.flatnonzero(np.isfinite(repaired).any(axis=1))
    thinned = changed[:: 1 + len(changed) // POINTS]
    k = np.unique(np.concatenate([shown, thinned]))
    velocity = part.dq
    if velocity is None:
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


def _repaired_rows(part: Measurements, mended: Measurements) -> Array:
    """(N, 2 n) positions and torques of the repaired run at the run's instants; rows
    that were left out come between their neighbours."""
    rows = np.hstack([mended.q, mended.tau])
    if len(rows) == len(part.t):
        return rows
    if not np.all(np.diff(mended.t) > 0.0):
        return np.hstack([part.q, part.tau])
    columns = [
        np.interp(
            part.t,
            mended.t,
            column,
        )
        for column in rows.T
    ]
    return np.column_stack(columns)


def _where_changed(raw: Array, repaired: Array) -> Array:
    """The repaired values (N, k) where a picture shows the difference, else NaN."""
    size = np.nanmax(np.abs(repaired), axis=0)
    is_changed = np.abs(repaired - raw) > 1e-3 * size
    return np.where(is_changed, repaired, np.nan)


def resplit(job: JobRequest) -> Answer:
    """A run split anew: ``share`` of its motion is for training."""
    run = next(run for run in job["runs"] if run["file"] == job["file"])
    part = load_measurements(job.folder / run["file"])
    split = split_run(job.problem, part, job["share"])
    if split is None:
        raise InputError(
            f"{run['name']} cannot be split so",
            "drag the bar back",
            run["name"],
        )
    return {"split": split}


def placed(
    robot: Robot,
    t: Array,
    q: Array,
) -> tuple[Array, Array]:
    """(F,) some instants of a motion q (N, n) at t (N,), and (F, joints, 4, 4) the
    poses there, between which the page interpolates."""
    keep = np.unique(np.linspace(0, len(t) - 1, 160).astype(int))
    return t[keep], robot.poses(robot.tree_state(q[keep])[0]).astype(np.float32)


def save_arrays(file: Path, arrays: dict[str, Any]) -> None:
    """As .npz, whole or not at all."""
    with writing(file) as out:
        np.savez(out, allow_pickle=False, **arrays)


def robot(job: JobRequest) -> Answer:
    """What the page shows of the robot: a built-in name or a URDF file."""
    problem = job.problem
    summary_words = formatting.count(problem.robot.n, "joint") + ", from URDF"
    known = (
        f"{_limits_in_words(problem)}; {_filters_in_words(problem)}. The stage Identify,"
        " or a folder with a problem.toml, sets others."
    )
    return {
        "title": summary_words if problem.folder is None else problem.title,
        "name": problem.name,
        "n": problem.robot.n,
        "joints": problem.robot.joint_names,
        "units": [formatting.plain_unit(unit) for unit in problem.robot.torque_units],
        "effects": list(problem.default_effects),
        "drawn": drawn_arm(problem.robot, problem.nominal_links),
        "own_gravity": problem.robot.gravity,
        "known": known,
    }


def _limits_in_words(problem: Problem) -> str:
    """For how many of the links' parameters a limit is set."""
    has_limit = np.isfinite(problem.box).any(axis=2)
    if has_limit.all():
        return "Limits are set for all links"
    if not has_limit.any():
        return "No limits are set for links"
    return (
        f"Limits are set for {has_limit.sum()} of {has_limit.size} parameters of links"
    )


def _filters_in_words(problem: Problem) -> str:
    """The cut-offs of the filters."""
    settings = problem.preprocessing
    cutoffs = [settings.state_cutoff, settings.torque_cutoff]
    if cutoffs == [None, None]:
        return "filters are chosen from the data"
    words = ["chosen from the data" if f is None else f"{f:g} Hz" for f in cutoffs]
    return f"filters of states and torque: {', '.join(words)}"


def fit(job: JobRequest) -> Answer:
    """Identify a model as the verb does, check included, and look where it fails."""
    options = job["options"]
    bounded = with_bounds(job.problem, options.get("bounds"))
    problem = with_filters(bounded, options.get("filters"))
    remarks: list[str] = []
    estimate, _ = identify_and_judge(
        problem,
        job.windowed(job.runs.train),
        with_solver(job["method"], options.get("solver")),
        PoseOptions(
            effects=job["effects"],
            gain_uncertainty=job.number("gain_uncertainty", 0.0),
            seed=job["seed"],
        ),
        progress=job.progress,
        workers=Workers(int(job.number("jobs", 1)), progress=job.progress),
        noise_from=job.training_recordings,
        check=not job["anyway"],
        warn=remarks.append,
    )
    return summary(job, estimate)


def open_model(job: JobRequest) -> Answer:
    """A model.json that somebody brings, judged on these runs."""
    train = job.runs.train
    estimate = job.model
    estimate.require_joints(train, job["model"])
    return summary(job, estimate)


def extend(job: JobRequest) -> Answer:
    """Add effects to a model: what `sdp-vs-penalty add` does."""
    effects: str | Diagnosis = job["effect"]
    if job.get("findings"):
        effects = Diagnosis.from_dict(job["findings"]).selected(confident=True)
    bigger = add(
        job.model,
        effects,
        job.runs.train,
        **job.common_options,
    )
    return summary(job, bigger)


def find(job: JobRequest) -> Answer:
    """Which effects a model misses: what `sdp-vs-penalty diagnose` does."""
    runs = job.runs
    model = job.model
    result, better = diagnose_and_add(
        model,
        runs.train,
        runs.test,
        noise_from=runs.all_runs,
        judged_recordings=runs.judged_recordings,
        check=False,  # the stage Check has judged these runs
        **job.common_options,
    )
    save_arrays(job.folder / job["pictures"], _card_arrays(model, better, runs.judge))
    result = _confirmed_on_other_splits(job, result)
    curves = [curve.effect(model.robot).text for curve in result.curves]
    return {
        "diagnosis": result.to_dict(),
        "curves": curves,
        "missing": still_missing(result, model),
        "has_open_finding": has_open_finding(result, model),
    }


def _confirmed_on_other_splits(job: JobRequest, diagnosis: Diagnosis) -> Diagnosis:
    """A diagnosis of one split run, with how many other splits of the run show each of
    its confident findings."""
    split_runs = [run for run in job["runs"] if run["use"] == "split"]
    has_confident = any(f.rating == "confident" for f in diagnosis.effects)
    if len(split_runs) != 1 or len(job["runs"]) != 1 or not has_confident:
        return diagnosis
    recording = load_measurements(job.folder / split_runs[0]["file"])
    recording = replace(recording, names=(split_runs[0]["name"],))
    splits = other_splits(job.problem, recording, split_runs[0]["split"])
    return confirmed(
        diagnosis,
        job.model,
        recording,
        splits,
        **job.common_options,
    )


def _card_arrays(
    model: Estimate,
    better: Estimate | None,
    judged: Measurements,
) -> dict[str, Any]:
    """What the cards of a diagnosis draw: t (M,), q, dq, measured torque, that of the
    model and of the model with all that is sure, each (M, n), of the judged runs."""
    models = {
        "before": model,
        **({} if better is None else {"after": better}),
    }
    compared = compare(models, judged)
    before = compared[0].signals
    after = compared[-1].signals
    keep = spread_rows(len(before.t), CARD_ROWS)
    arrays = {name: getattr(before, name) for name in ("q", "dq", "measured")}
    arrays |= {"before": before.modelled, "after": after.modelled}
    small = {name: np.asarray(x[keep], np.float32) for name, x in arrays.items()}
    return {"t": before.t[keep], **small}


def methods(job: JobRequest) -> Answer:
    """The same effects by other methods, judged alike: headings, and a row a method."""
    runs = job.runs
    current = job.model
    train = job.windowed(runs.train)
    if not job["methods"]:
        raise InputError("No method is chosen", "choose at least one to compare")
    filtered = read_and_filter(current.problem, train)
    rows = []
    for name in job["methods"]:
        effects = current.model.effects
        progress = partial(job.progress_of, name)
        options = PoseOptions(effects=effects, seed=job["seed"])
        try:
            estimates_made = estimate_parameters(
                current.problem,
                filtered,
                name,
                options,
                progress=progress,
            )
            folds = job["folds"] and cross_validate(
                current.problem,
                train,
                name,
                effects=effects,
                seed=job["seed"],
                progress=progress,
            )
        except InputError as error:
            refused = [
                name,
                str(error),
                *[""] * len(tables.JUDGED_HEADS[1:]),
            ]
            rows.append(refused)
            continue
        row = tables.judged_cells(
            compare(
                {name: estimates_made},
                runs.judge,
                noise_from=runs.judged_recordings,
            )[0]
        )
        rows.append(
            [
                *row,
                *([f"{folds.relative_error_percent:.4g}"] if folds else []),
            ]
        )
    unseen = "error on unseen motion [%]" if job["folds"] else ""
    return {"table": tables.judged_table(rows, "method", more=unseen).to_dict()}


def take(job: JobRequest) -> Answer:
    """A file to take away: a run as it was used, the diagnosis, the report, or the
    model in the format of the name's suffix; says which effects have no place in it."""
    name = job["name"]
    out = job.folder / name
    job.progress(f"writing {name}")
    if name.startswith("run-"):
        _write_run(job, out, number=int(name[4:-4]))
    elif name == "findings.json":
        write_text(out, json.dumps(job["findings"], indent=1, allow_nan=False) + "\n")
    elif name == "model.json":
        write_bytes(out, Path(job["model"]).read_bytes())
    elif name == "report.html":
        _write_report(job, out)
    else:
        return {"notice": _write_export(job, out)}
    return {"notice": []}


def _write_run(job: JobRequest, out: Path, number: int) -> None:
    """A run by its number on the page."""
    run = job["runs"][number - 1]
    save(load_measurements(job.folder / run["file"]), out)


def _write_report(job: JobRequest, out: Path) -> None:
    """The report on all models of the history."""
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


def _write_export(job: JobRequest, out: Path) -> list[str]:
    """The model in the format of the suffix; what the file cannot hold, and what that
    does to the error, a sentence each."""
    urdf = job.get("urdf") if out.name == "robot.urdf" else None
    x, y, z = numbers(
        "flange",
        job.get("flange") or "0,0,0",
        3,
    )
    model = job.model
    judged: tuple[Verdict, str] | None = None
    if job.get("runs"):
        runs = job.runs
        judged = judge_as_exported(model, out, runs.judge, runs.judged_recordings)
    verdict = None if judged is None else judged[0]
    lost = write_model(
        model,
        out,
        urdf,
        flange=(x, y, z),
        judged=verdict,
    )
    if not lost:
        return []
    sentences = [f"{out.suffix} files cannot hold {', '.join(lost)}; model.json can."]
    if judged is not None:
        sentences += [f"As exported: {judged[0].headline}", judged[1]]
    return [text for text in sentences if text]


def forward(job: JobRequest) -> Answer:
    """A model run along the judged runs: what `sdp-vs-penalty simulate --follow` does.

    Its arrays, an .npz a free run: t, measured, simulated; and of some instants tf
    (F,), poses (F, 2 joints, 4, 4), the measured arm before the simulated one.
    """
    estimate = job.model
    drive = job["drive"]
    following = follow(
        estimate,
        job.runs.judge,
        drive=drive,
        **job.common_options,
    )
    files = [f"forward-{following.drive}-{k}.npz" for k in range(len(following.free))]
    for file, free in zip(files, following.free, strict=True):
        t = free.simulated.t
        tf, one = placed(estimate.robot, t, free.measured)
        _, other = placed(estimate.robot, t, free.simulated.q)
        arrays = {
            "t": t,
            "measured": free.measured,
            "simulated": free.simulated.q,
            "tf": tf,
        }
        save_arrays(
            job.folder / file,
            {**arrays, "poses": np.concatenate([one, other], axis=1)},
        )
    return {
        "arrays": files,
        "runs": [
            f"{f.simulated.names[0]}, from {f.simulated.t[0]:.4g} s"
            for f in following.free
        ],
        **{
            name: getattr(following, name)
            for name in ("verdict", "explained", "units", "left_out")
        },
        "table": following.table().to_dict(),
    }


def about(estimate: Estimate) -> dict[str, Any]:
    """The parameters as the page shows them: rows, links, words and friction as in the
    report, and the arm in 3D (:func:`drawn_arm`)."""
    links = tables.link_table(estimate)
    return {
        "rows": tables.standard_parameters(estimate),
        "links": None if links is None else links.to_dict(),
        "words": words.caveats(estimate),
        "friction": [
            {
                "velocity": c.velocity,
                "torque": c.torque,
                "half": NORMAL_95 * c.std,
            }
            for c in friction_curves(estimate)
        ],
        "certificate": tables.certificate_table({"model": estimate}).to_dict(),
        **drawn_arm(
            estimate.robot, estimate.links if len(estimate.model.rigid_indices) else []
        ),
    }


def _verdict_of(
    job: JobRequest,
    estimate: Estimate,
    comparison: Comparison,
) -> Answer:
    """The verdict on a model, with what the last diagnosis found that it lacks."""
    found = job.get("diagnosed")
    if not found:
        return comparison.verdict.to_dict()
    diagnosis = Diagnosis.from_dict(found)
    return comparison.verdict_with(
        still_missing(diagnosis, estimate),
        has_open_finding=has_open_finding(diagnosis, estimate),
    ).to_dict()


def summary(job: JobRequest, estimate: Estimate) -> Answer:
    """Save a model at ``out`` and its curves beside it; judge it on the runs: what
    makes a session's ModelStep.

    Curves, an .npz a run, training runs first: t, torque, modelled, its motion q, dq,
    ddq, and tf (F,), poses (F, joints, 4, 4) of some instants for the 3D view.
    """
    seconds = time.perf_counter() - job.begin
    checked = job.runs
    out = Path(job["out"])
    job.progress("comparing measured with modelled")
    comparison = compare(
        {"model": estimate},
        checked.judge,
        noise_from=checked.judged_recordings,
    )[0]
    (arm, judge) = driven(estimate, checked.judge)
    (_, train) = driven(estimate, checked.train)
    settings = estimate.preprocessing.resolve(judge)
    verdict_of_model = _verdict_of(job, estimate, comparison)
    estimate.provenance["verdict"] = verdict_of_model
    runs = [
        *train.runs(),
        *(judge.runs() if checked.test is not None else ()),
    ]
    for k, run in enumerate(runs):
        rows = FilteredRun(run, settings).all_rows(arm.model)
        motion = rows.motion
        curves_found = {
            "torque": rows.torque,
            "modelled": predicted(rows, arm.theta),
        }
        curves_found |= {name: getattr(motion, name) for name in ("q", "dq", "ddq")}
        arrays = {
            "t": motion.t,
            **{name: x.astype(np.float32) for name, x in curves_found.items()},
        }
        arrays["tf"], arrays["poses"] = placed(
            estimate.robot,
            motion.t,
            motion.q,
        )
        save_arrays(out.with_name(f"{out.stem}-{k}.npz"), arrays)
    job.progress("looking where it fails")
    try:
        failing = where_it_fails(estimate, judge, noise=comparison.noise)
        units = estimate.robot.torque_units
        failures = [
            {
                **f.to_dict(),
                "sentences": sentences(f, units[f.joint - 1]),
            }
            for f in failing
        ]
    except InputError:  # too short to say: the errors stand on their own
        failures = []
    estimate.save(out)
    names = [run.names[0] for run in runs]
    parts = (
        f", {run.t[0]:.4g} to {run.t[-1]:.4g} s" for run in runs
    )  # where one name has several
    return {
        "file": str(out),
        "runs": [
            n + part * (names.count(n) > 1)
            for n, part in zip(names, parts, strict=True)
        ],
        "judged_on": list(judge.names),
        "method": estimate.method,
        "effects": effects_to_estimate_again(
            estimate.model.effects, estimate.details.get("shapes", ())
        ),
        "comparison": {**comparison.to_dict(), "verdict": verdict_of_model},
        "failures": failures,
        "judged": tables.judged_cells(comparison, verdict_of_model["grade"]),
        "about": about(estimate),
        "on_bounds": estimate.details.get("on_bounds") or [],
        "seconds": seconds,
        "servo": arm is not estimate,
    }
