"""What a job is asked, plain JSON, as problem, runs and model; jobs about runs: read, made, repaired."""

import io
import warnings
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from sdp_vs_penalty.checks import check
from sdp_vs_penalty.data.cli_parsing import pairs, time_windows
from sdp_vs_penalty.data.files import check_usable, load_measurements, save, windowed
from sdp_vs_penalty.data.measurements import Measurements, Runs, concatenate
from sdp_vs_penalty.errors import InputError, Remark, other_robot
from sdp_vs_penalty.estimation.estimate import Estimate, load_estimate
from sdp_vs_penalty.estimators.estimator import Progress, no_progress
from sdp_vs_penalty.files import write_bytes, write_text
from sdp_vs_penalty.problem.load import convert, load_problem
from sdp_vs_penalty.problem.problem import Problem
from sdp_vs_penalty.reports.plots import POINTS
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.robot import Robot
from sdp_vs_penalty.signals.phases import filter_reach, motion_clocks, phase_windows, tracks_of
from sdp_vs_penalty.simulation.hidden_runs import RUN_FILES, hidden_runs

Answer = dict[str, Any]


class Asked(dict[str, Any]):
    """A request, by its words; progress : hears what is being done."""

    def __init__(self, words: Mapping[str, Any], progress: Progress = no_progress) -> None:
        super().__init__(words)
        self.progress = progress

    @property
    def folder(self) -> Path:
        """The session's own."""
        return Path(self["folder"])

    @property
    def seed(self) -> int:
        return int(self["seed"])

    @property
    def problem(self) -> Problem:
        return load_problem(self["robot"]["source"], self["robot"].get("gravity"))

    @property
    def model(self) -> Estimate:
        return load_estimate(self["model"])

    def number(self, name: str, default: float) -> float:
        """A number that was written among the options. Raises InputError for another text."""
        try:
            return float(self["options"].get(name, default))
        except ValueError:
            text = self["options"][name]
            raise InputError(f"{name.replace('_', ' ')} {text!r}", "write a number") from None

    def windowed(self, run: Measurements) -> Measurements:
        """What the option ``window`` leaves of a run."""
        return windowed(run, time_windows(self["options"].get("window")))

    @property
    def runs(self) -> Runs:
        """The runs for what each is used for, under their shown names.

        A run of use "split" gives part of its motion to the first, the rest to the others.
        """
        chosen = self["runs"]
        if not chosen:
            raise InputError("No run to identify from", "add measurements first")
        loaded = load_measurements(*(self.folder / run["file"] for run in chosen))
        train, test = list[Measurements](), list[Measurements]()
        for run, part in zip(chosen, loaded.runs(), strict=True):
            named = replace(part, names=(run["name"],))
            if run["use"] == "split":
                if run["split"] is None:
                    raise InputError(
                        "the motion repeats too fast to be split into a part to identify from and one "
                        "to test on",
                        "use the run for identification only, or record another one",
                        run["name"],
                    )
                for side, name in ((train, "train"), (test, "test")):
                    side.append(windowed(named, [(a, b) for a, b in run["split"][name]]))
            elif run["use"] != "load":
                (test if run["use"] == "test" else train).append(named)
        if not train:
            raise InputError("No run to identify from", "use at least one for it")
        return Runs(concatenate(train), concatenate(test) if test else None, loaded)


#: Share of a run that is identified from where the rest of it is kept for testing.
SPLIT = 0.7


def read(asked: Asked) -> Answer:
    """files : {path, name} of each; those that can be used become runs, the others a sentence each."""
    problem = asked.problem
    runs, refused, remarks = list[Answer](), list[str](), list[str]()
    for file in asked["files"]:
        asked.progress(f"reading {file['name']}")
        path = Path(file["path"])
        try:
            with warnings.catch_warnings(record=True) as heard:
                warnings.simplefilter("always", Remark)
                part = _loaded(asked, problem, path)
            remarks += [str(w.message) for w in heard if w.category is Remark]
            for twin in (run for run in (*asked["runs"], *runs) if run["hash"] == part.data_hash):
                raise InputError(f"holds the same samples as {twin['name']}", "name each run once", path)
            runs.append(keep(asked, problem, part, file["name"]))
        except InputError as error:
            refused.append(str(error))
    return {"runs": runs, "refused": refused, "remarks": remarks}


def _loaded(asked: Asked, problem: Problem, path: Path) -> Measurements:
    """A run; by the options of `convert` where any is given."""
    options, names = asked["options"], problem.robot.joint_names
    if not options:
        return load_measurements(path, joints=problem.robot.n, names=names)
    part = convert(
        path,
        problem=problem,
        joints=options["joints"].split(",") if "joints" in options else names,
        topic=options.get("topic"),
        rename=pairs("--rename", options.get("rename")),
        motors=options.get("motors", "motor_side" in options),
        rate=asked.number("rate", 0.0) or None,
    )
    if part.n != problem.robot.n:
        raise other_robot(part.n, problem.robot.n, path)
    check_usable(path, part)
    return part


def look_again(asked: Asked) -> Answer:
    """The runs, checked for the robot as it is now."""
    problem = asked.problem
    parts = ((load_measurements(asked.folder / run["file"]), run) for run in asked["runs"])
    return {"runs": [keep(asked, problem, part, run["name"], run["use"]) for part, run in parts]}


def simulate(asked: Asked) -> Answer:
    """Three runs and one for testing, with an effect hidden in them; the truth is not shown."""
    problem = asked.problem
    asked.progress("simulating four runs of 20 s")
    hidden = [(asked["effect"], [j - 1 for j in asked["joints"]])] * (asked["effect"] != "none")
    made = hidden_runs(problem, hidden, asked["level"], asked.seed)
    named = zip(RUN_FILES, made.runs, strict=True)
    runs = [keep(asked, problem, part, name) for name, part in named]
    return {"runs": runs, "refused": [], "effects": made.truth["model_effects"]}


def mend(asked: Asked) -> Answer:
    """What `check --fix` does to one of the runs: its repaired copy, and beside it what was changed."""
    problem = asked.problem
    (given,) = (run for run in asked["runs"] if run["file"] == asked["file"])
    part = replace(load_measurements(asked.folder / given["file"]), names=(given["name"],))
    asked.progress(f"repairing {given['name']}")
    (report,) = check(problem, part, thorough=False)
    name = f"{Path(given['name']).stem}_fixed.csv"
    made = keep(asked, problem, report.fixed, name, use=given["use"])
    changes = report.changes(given["name"])
    write_text(asked.folder / Path(made["file"]).with_suffix(".txt"), changes)
    return {"run": made, "changes": changes.splitlines()}


def keep(
    asked: Asked, problem: Problem, part: Measurements, name: str, use: str = "train"
) -> dict[str, Any]:
    """Write a run into the session's folder; what the page shows of it.

    split : the windows of the use "split", by phase where the motion repeats, None where it does so too
    fast.
    """
    asked.progress(f"checking {name}")
    part = replace(concatenate([part]), names=(name,))
    (found,) = check(problem, part, thorough=False)
    file, view = (f"{what}-{part.data_hash[:16]}.npz" for what in ("run", "view"))
    save(part, asked.folder / file)
    save_arrays(asked.folder / view, _preview(problem, part, found.mended))
    seconds = float(part.t[-1] - part.t[0])
    return {
        "file": file,
        "view": view,
        "name": name,
        "use": use,
        "hash": part.data_hash,
        "samples": part.samples,
        "seconds": seconds,
        "split": _split(problem, part),
        "rate": (part.samples - 1) / seconds if seconds > 0.0 else 0.0,
        "findings": [{**f.to_dict(), "gravity": f.gravity} for f in found.problems],
    }


def _preview(problem: Problem, part: Measurements, mended: Measurements) -> dict[str, Any]:
    """What the page shows of a run at once: t, q, dq, tau at some instants, the positions and torques
    that the check would put there (NaN where it changes nothing), and the arm's poses."""
    raw, there = (np.hstack([run.q, run.tau]) for run in (part, mended))
    if len(there) != len(raw):  # rows that were left out come between their neighbours
        ordered = np.all(np.diff(mended.t) > 0.0)
        there = np.column_stack([np.interp(part.t, mended.t, x) for x in there.T]) if ordered else raw
    # What a picture shows of it.
    changed = np.abs(there - raw) > 1e-3 * np.nanmax(np.abs(there), axis=0)
    repaired = np.where(changed, there, np.nan)
    few = np.linspace(0, len(part.t) - 1, POINTS).astype(int)
    rare = np.flatnonzero(np.isfinite(repaired).any(axis=1))
    k, n = np.unique(np.concatenate([few, rare[:: 1 + len(rare) // POINTS]])), part.n
    dq = np.gradient(part.q, part.t, axis=0) if part.dq is None else part.dq
    arrays = {"t": part.t[k], "q": part.q[k], "dq": dq[k], "torque": part.tau[k]}
    arrays |= {"repaired_q": repaired[k, :n], "repaired_torque": repaired[k, n:]}
    arrays["tf"], arrays["poses"] = placed(problem.robot, part.t, part.q)
    return arrays


def _split(problem: Problem, part: Measurements) -> dict[str, list[tuple[float, float]]] | None:
    """Windows to identify from and to test on, rounded so that a command can name them."""
    try:
        settings = problem.preprocessing.resolve(part)
        reach = filter_reach(part, settings)  # half of it lies between: no filter sees both
    except InputError:  # no motion: the check says so
        return None
    (clock,) = motion_clocks(tracks_of(part))
    windows = phase_windows(clock, float(part.t[-1] - part.t[0]), SPLIT, 0.5 * reach, 1.5 * reach)
    if windows is None:
        return None
    rounded = ([(round(a, 3), round(b, 3)) for a, b in side] for side in windows)
    return dict(zip(("train", "test"), rounded, strict=True))


def placed(robot: Robot, t: Array, q: Array) -> tuple[Array, Array]:
    """(F,) some instants of a motion q (N, n) at t (N,), and (F, joints, 4, 4) the poses there, between
    which the page interpolates."""
    keep = np.unique(np.linspace(0, len(t) - 1, 160).astype(int))
    return t[keep], robot.poses(robot.tree_state(q[keep])[0]).astype(np.float32)


def save_arrays(file: Path, arrays: dict[str, Any]) -> None:
    """As .npz, whole or not at all."""
    buffer = io.BytesIO()
    np.savez(buffer, allow_pickle=False, **arrays)
    write_bytes(file, buffer.getvalue())
