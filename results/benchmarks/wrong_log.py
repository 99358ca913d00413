"""What this program and other tools say of a log with one mistake.

    python results/benchmarks/wrong_log.py --rivals PYTHON [--data DATA] [--out FOLDER]

The Panda's run, with one mistake at a time, of which a plot of the residual shows the first
two and hides the others. The program gets the log; the other tools get its filtered,
decimated rows, as in other_tools.py. PYTHON has FIGAROH and mujoco[sysid]. Writes
wrong_log.md: what each says, and its relative error on these rows and on the right ones.
"""

import argparse
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

os.environ |= dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
sys.path.insert(0, str(Path(__file__).parents[1]))

import numpy as np
from numpy.typing import NDArray

from benchmarks.other_tools import SCRIPTS, _write_arm
from benchmarks.parts import Inputs
from benchmarks.rivals import cvxpy_script
from sdp_vs_penalty import Measurements, Problem, check
from sdp_vs_penalty.files import write_text
from sdp_vs_penalty.results.table import markdown_lines
from sdp_vs_penalty.robot import inertia

Array = NDArray[np.float64]
HERE = Path(__file__).parent


def flipped(run: Measurements) -> Measurements:
    """The sign of joint 4's torque is changed."""
    return scaled(run, 3, -1.0)


def scaled(run: Measurements, joint: int, gain: float) -> Measurements:
    """The torque of a joint (from 0) is multiplied by a gain."""
    gains = np.ones(run.tau.shape[1])
    gains[joint] = gain
    return replace(run, tau=run.tau * gains)


def exchanged(run: Measurements) -> Measurements:
    """The torques of joints 2 and 4 are exchanged."""
    return replace(run, tau=run.tau[:, [0, 3, 2, 1, *range(4, run.tau.shape[1])]])


def late(run: Measurements) -> Measurements:
    """All torques are logged 20 ms late."""
    tau = [np.interp(run.t - 0.02, run.t, channel) for channel in run.tau.T]
    return replace(run, tau=np.column_stack(tau))


def fast(run: Measurements) -> Measurements:
    """The clock counts 5 % too many seconds."""
    return replace(run, t=1.05 * run.t)


def turned(run: Measurements) -> Measurements:
    """The zero of joint 2's encoder is 5 degrees off."""
    return replace(run, q=run.q + np.deg2rad(5.0) * (np.arange(run.q.shape[1]) == 1))


MISTAKES: dict[str, Callable[[Measurements], Measurements]] = {
    "none": lambda run: run,
    "sign of joint 4's torque": flipped,
    "torques of joints 2 and 4 exchanged": exchanged,
    "torque of joint 2 15 % too large": lambda run: scaled(run, 1, 1.15),
    "all torques 20 ms late": late,
    "clock 5 % fast": fast,
    "zero of joint 2 off by 5 degrees": turned,
}


def script_rows(run: Measurements) -> cvxpy_script.Rows:
    """The rows of the script."""
    return cvxpy_script.filtered_rows(run.t, run.q, run.tau)


@dataclass(frozen=True)
class Wrong:
    """Rows of a log with a mistake, and those of the same log without it."""

    wrong: cvxpy_script.Rows
    right: cvxpy_script.Rows

    def fitted(self, predicted_wrong: Array, predicted_right: Array) -> str:
        """The relative errors of a fit that ended without a word."""
        pairs = ((predicted_wrong, self.wrong.tau), (predicted_right, self.right.tau))
        errors = [
            100.0 * np.linalg.norm(predicted - tau) / np.linalg.norm(tau)
            for predicted, tau in pairs
        ]
        return f"{errors[0]:.3g} %; {errors[1]:.3g} %"

    def by_toolbox(self, python: str, tool: str, folder: Path) -> str:
        """What a toolbox ends with: its errors, or its last line."""
        arrays = {"train_tau": self.wrong.tau}
        for k, name in enumerate(("q", "dq", "ddq")):
            arrays[f"train_{name}"] = self.wrong.states[k]
            both = (self.wrong.states[k], self.right.states[k])
            arrays[f"judged_{name}"] = np.concatenate(both)
        np.savez(folder / "rows.npz", **arrays)
        arm = folder / ("arm.xml" if tool == "mujoco" else "arm.urdf")
        out = folder / f"{tool}.npz"
        out.unlink(missing_ok=True)
        script = str(SCRIPTS / f"{tool}_script.py")
        words = [python, script, str(folder / "rows.npz"), str(arm), str(out)]
        done = subprocess.run(words, capture_output=True, text=True)
        if done.returncode:
            return done.stderr.strip().splitlines()[-1]
        with np.load(out) as answer:
            n_wrong = len(self.wrong.t)
            predicted = answer["predicted"]
            return self.fitted(predicted[:n_wrong], predicted[n_wrong:])

    def by_cvxpy(self, arm: Any) -> str:
        """What the ordinary script ends with."""
        columns = cvxpy_script.columns(arm, *self.wrong.states)
        theta = cvxpy_script.solve(
            columns, self.wrong.tau, inertia.PSEUDO_INERTIA_BASIS
        )
        of_right = cvxpy_script.columns(arm, *self.right.states)
        return self.fitted(columns @ theta, of_right @ theta)


def by_check(problem: Problem, run: Measurements) -> str:
    """What `check` says, and what it says is as likely, without its notes."""
    said = [
        f"{issue.kind}, {issue.where} ({issue.certainty.grade})"
        + "".join(f"; as likely: {text}" for text in issue.equivalents)
        for report in check(problem, run)
        for issue in report.issues
        if issue.severity != "note"
    ]
    return "; ".join(said) or "no problem"


def write_page(
    path: Path, title: str, about: str, heads: list[str], table: list[list[str]]
) -> None:
    """Write a page of Markdown with one table."""
    text = [f"# {title}", "", about, "", *markdown_lines(heads, table), ""]
    write_text(path, "\n".join(text))


def main() -> None:
    """Ask all tools, and write the table."""
    parser = argparse.ArgumentParser(usage=__doc__)
    data = os.environ.get("SDP_VS_PENALTY_DATA")
    parser.add_argument("--data", type=Path, default=data, required=data is None)
    parser.add_argument("--rivals", required=True)
    parser.add_argument("--out", type=Path, default=HERE)
    options = parser.parse_args()
    inputs = Inputs(Path(options.data).resolve(), [1], 1, options.rivals)
    table = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        _write_arm(inputs, folder)
        for mistake, change in MISTAKES.items():
            run = change(inputs.run)
            rows = Wrong(script_rows(run), script_rows(inputs.run))
            by_tools = [
                rows.by_toolbox(options.rivals, tool, folder)
                for tool in ("figaroh", "mujoco")
            ]
            by_script = rows.by_cvxpy(inputs.problem.robot._model)
            ours = by_check(inputs.problem, run)
            table.append([mistake, ours, *by_tools, by_script])
            print(table[-1], flush=True)
    heads = ["mistake", "`check`", "FIGAROH", "mujoco.sysid", "script with CVXPY"]
    about = (
        "The Panda's run. The other tools get its rows, fit them without a word or end with"
        " an error. Of a fit: its relative error on the rows of the wrong log, which a user"
        " sees, and on those of the right one."
        " By `python results/benchmarks/wrong_log.py --rivals PYTHON`."
    )
    title = "What is said of a log with one mistake"
    write_page(options.out / "wrong_log.md", title, about, heads, table)


if __name__ == "__main__":
    main()
