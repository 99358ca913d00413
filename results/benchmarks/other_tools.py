"""Identification beside what else people use, on the Panda's run.

The other tools get the same rows of the log, filtered and decimated by an ordinary
script; the program gets the log itself. All are judged on motion that they were not
trained on: five folds by phase, torques of the program's filtered rows.
"""

import sys
import tempfile
import warnings
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.parts import Inputs
from benchmarks.recording import write_recording
from benchmarks.rivals import base_script, cvxpy_script
from benchmarks.timing import PROGRAM, Figure, Usage, in_turn, run_process
from sdp_vs_penalty import Estimate, cross_validate, identify, load_measurements
from sdp_vs_penalty.data.files import save
from sdp_vs_penalty.estimation.build_problem import read_and_filter
from sdp_vs_penalty.estimation.identify import estimate_parameters
from sdp_vs_penalty.exporters.content import Content
from sdp_vs_penalty.exporters.mjcf import make_mjcf
from sdp_vs_penalty.exporters.urdf import make_urdf
from sdp_vs_penalty.problem.published import published_links
from sdp_vs_penalty.robot import inertia
from sdp_vs_penalty.signals.filtered import FilteredRun, Rows
from sdp_vs_penalty.signals.phases import phase_folds

Array = NDArray[np.float64]
#: Of rows: which of them.
Mask = NDArray[np.bool_]
FOLDS = 5
SCRIPTS = Path(__file__).parent / "rivals"


@dataclass(frozen=True)
class Judge:
    """The rows that other tools are trained on, and those that all are judged on."""

    inputs: Inputs

    @property
    def folder(self) -> Path:
        """The authors' text files."""
        return self.inputs.data / "panda"

    @property
    def arm(self) -> Any:
        """Pinocchio's model of the arm, for scripts."""
        return self.inputs.problem.robot._model

    @cached_property
    def training(self) -> cvxpy_script.Rows:
        """The rows of the script."""
        return cvxpy_script.read_rows(self.folder, self.arm.nv)

    @cached_property
    def judged(self) -> Rows:
        """The program's filtered rows."""
        problem, run = self.inputs.problem, self.inputs.run
        model = estimate_parameters(problem, read_and_filter(problem, run)).model
        return FilteredRun(run, problem.preprocessing.resolve(run)).all_rows(model)

    def folds(self) -> Iterable[tuple[Mask, Mask]]:
        """Which rows train, and which judged rows test, fold by fold."""
        run = self.inputs.run
        split = phase_folds(run, self.inputs.problem.preprocessing.resolve(run), FOLDS)
        trained_cells = split.cell(0, self.training.t)
        judged_cells = split.cell(0, self.judged.motion.t)
        for k in range(split.count):
            train = np.isin(trained_cells, split.training(k))
            yield train, np.isin(judged_cells, split.tested(k))

    def unseen_error(self, predict: Callable[[Mask], Array]) -> float:
        """Relative error on unseen motion [%].

        predict : of the rows that train, the torque (M, n) of all judged rows.
        """
        left = np.zeros_like(self.judged.torque)
        for train, tested in self.folds():
            left[tested] = (predict(train) - self.judged.torque)[tested]
        torque_norm = np.linalg.norm(self.judged.torque)
        return 100.0 * float(np.linalg.norm(left) / torque_norm)

    @cached_property
    def judged_columns(self) -> Array:
        """The script's columns (M, n, 13 n) at the judged rows."""
        at = self.judged.motion
        return cvxpy_script.columns(self.arm, at.q, at.dq, at.ddq)

    def script_error(self, solve: Callable[[Array, Array], Array]) -> float:
        """Relative error on unseen motion [%] of a script that solves for theta."""
        columns = cvxpy_script.columns(self.arm, *self.training.states)

        def predict(train: Mask) -> Array:
            theta = solve(columns[train], self.training.tau[train])
            return self.judged_columns @ theta

        return self.unseen_error(predict)


def scripts(inputs: Inputs) -> list[Figure]:
    """Text files to an estimate, as users write it, beside ordinary scripts."""
    warnings.simplefilter("ignore")  # the scripts'
    judge = Judge(inputs)
    basis = inertia.PSEUDO_INERTIA_BASIS

    def estimate() -> object:
        run = load_measurements(judge.folder, joints=7)
        return estimate_parameters(inputs.problem, read_and_filter(inputs.problem, run))

    def identified(check: bool) -> Estimate:
        run = load_measurements(judge.folder, joints=7)
        return identify(inputs.problem, run, check=check)

    def script(triangle: bool = True) -> object:
        columns, tau = columns_from_text(judge)
        return cvxpy_script.solve(columns, tau, basis, triangle)

    def base() -> object:
        return base_script.solve(*columns_from_text(judge))

    def read(check: bool) -> object:
        # Intervals, verdict and noise are worked out when they are read.
        return identified(check).to_dict()

    error = cross_validate(inputs.problem, inputs.run).relative_error_percent
    with_check = partial(identified, check=True)
    without_check = partial(identified, check=False)
    by_cvxpy = "other: filter, decimate, Pinocchio, CVXPY on the R factor"
    by_rows = "other: as before, the rows themselves to CVXPY"
    by_base = "other: as before, base parameters by scikit-learn; inconsistent"
    times = [
        ("certified estimate from text", estimate, script, by_cvxpy),
        ("identify(check=False)", without_check, script, by_cvxpy),
        ("identify(check=False), all read", partial(read, False), script, by_cvxpy),
        ("identify(), beside CVXPY", with_check, script, by_cvxpy),
        (
            "identify(), beside CVXPY on rows",
            with_check,
            partial(script, False),
            by_rows,
        ),
        ("identify(), beside scikit-learn", with_check, base, by_base),
    ]
    rows = [
        Figure.of_pairs(what, in_turn(ours, other, inputs.repeats), "s", note)
        for what, ours, other, note in times
    ]
    solvers = {
        "CVXPY": lambda y, tau: cvxpy_script.solve(y, tau, basis),
        "scikit-learn": base_script.solve,
    }
    rows += [
        Figure.single(
            f"error on unseen motion, beside {name}",
            error,
            "%",
            f"{FOLDS} folds by phase",
            judge.script_error(solve),
        )
        for name, solve in solvers.items()
    ]
    return rows


def columns_from_text(judge: Judge) -> tuple[Array, Array]:
    """Columns (M, n, 13 n) and torque (M, n) of the script, from text."""
    rows = cvxpy_script.read_rows(judge.folder, judge.arm.nv)
    return cvxpy_script.columns(judge.arm, *rows.states), rows.tau


def toolboxes(inputs: Inputs) -> list[Figure]:
    """Processes that identify, beside FIGAROH and MuJoCo's toolbox on the same rows."""
    if inputs.rivals is None:
        raise SystemExit("toolboxes: name the Python that has them by --rivals.")
    judge = Judge(inputs)
    error = cross_validate(inputs.problem, inputs.run).relative_error_percent
    rows = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        _write_arm(inputs, folder)
        save(inputs.run, folder / "run.csv")
        identify_words = [
            *PROGRAM, "identify", "panda", "--no-check",
            "--data", str(folder / "run.csv"), "--out", str(folder / "model.json"),
        ]  # fmt: skip
        ours = run_process(identify_words)
        notes = {
            "figaroh": "FIGAROH: solve_direct_effort_fit, prior: the paper's values",
            "mujoco": "mujoco.sysid, 40 steps of its optimiser from the paper's values",
        }
        for tool, note in notes.items():
            toolbox = _Toolbox(inputs.rivals, tool, folder, judge)
            everything = np.ones(len(judge.training.t), bool)
            used, _ = toolbox.fit(everything)
            pair = np.array([[ours.processor, used.processor]])
            memory = f"peak {ours.memory:.0f} and {used.memory:.0f} MB"
            rows += [
                Figure.of_pairs(
                    f"identify --no-check, beside {tool}",
                    pair,
                    "s",
                    f"other: {note}; {memory}",
                ),
                Figure.single(
                    f"error on unseen motion, beside {tool}",
                    error,
                    "%",
                    f"{FOLDS} folds by phase",
                    judge.unseen_error(toolbox.predict),
                ),
            ]
    return rows


def lengths(inputs: Inputs) -> list[Figure]:
    """Recordings at 1 kHz to an estimate, as processes, beside CVXPY with Clarabel."""
    rows = []
    with tempfile.TemporaryDirectory(dir="/var/tmp") as name:
        folder = Path(name)
        _write_arm(inputs, folder)
        log = folder / "run.csv"
        estimate = identify(inputs.problem, inputs.run, check=False)
        ours = [
            *PROGRAM, "identify", "panda", "--no-check",
            "--data", str(log), "--out", str(folder / "model.json"),
        ]  # fmt: skip
        script = SCRIPTS / "cvxpy_script.py"
        other = [sys.executable, str(script), str(log), str(folder / "arm.urdf")]
        for count in (10_000, *inputs.counts):
            write_recording(log, count, estimate)
            used = [run_process(command) for command in (ours, other)]
            memory = " and ".join(f"{x.memory:.0f}" for x in used)
            pairs = np.array([[x.processor for x in used]])
            note = f"other: every 28th row, Pinocchio, CVXPY; peak {memory} MB"
            what = f"identify --no-check, {count} rows"
            rows.append(Figure.of_pairs(what, pairs, "s", note))
    return rows


def _write_arm(inputs: Inputs, folder: Path) -> None:
    """Write the arm with the paper's parameters for tools that start from a file."""
    robot = inputs.problem.robot
    published = published_links(inputs.problem, "p_hat")
    links = [
        inertia.transform(joint.link_frame) @ link
        for joint, link in zip(robot.joints, published, strict=True)
    ]
    content = Content.of_links(robot, np.stack(links))
    (folder / "arm.urdf").write_bytes(make_urdf(robot, content))
    (folder / "arm.xml").write_bytes(make_mjcf(robot, content))


@dataclass(frozen=True)
class _Toolbox:
    """A toolbox in an environment of its own, on chosen rows."""

    python: str
    name: str
    folder: Path
    judge: Judge

    def predict(self, train: Mask) -> Array:
        """Torque (M, n) at all judged rows after a fit of these rows."""
        return self.fit(train)[1]

    def fit(self, train: Mask) -> tuple[Usage, Array]:
        """What it used for these rows, and its torque (M, n) at all judged ones."""
        training, judged = self.judge.training, self.judge.judged.motion
        arrays = {"train_tau": training.tau[train]}
        for name, values in zip(("q", "dq", "ddq"), training.states, strict=True):
            arrays[f"train_{name}"] = values[train]
            arrays[f"judged_{name}"] = getattr(judged, name)
        rows, out = self.folder / "rows.npz", self.folder / "out.npz"
        np.savez(rows, **arrays)
        arm = self.folder / ("arm.xml" if self.name == "mujoco" else "arm.urdf")
        script = SCRIPTS / f"{self.name}_script.py"
        used = run_process([self.python, str(script), str(rows), str(arm), str(out)])
        with np.load(out) as answer:
            return used, answer["predicted"]


PARTS = {"scripts": scripts, "toolboxes": toolboxes, "lengths": lengths}
