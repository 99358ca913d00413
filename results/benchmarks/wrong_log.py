"""What this program and other tools say of a log with one mistake.

    python results/benchmarks/wrong_log.py --rivals PYTHON [--data DATA] [--out FOLDER]

The Panda's run, once with the sign of joint 4's torque changed, once with the torques of
joints 2 and 4 exchanged. The program gets the log; the other tools get its filtered,
decimated rows, as in other_tools.py. PYTHON has FIGAROH and mujoco[sysid]. Writes
wrong_log.md: what each says, and its relative error on these rows.
"""

import argparse
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

os.environ |= dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
sys.path.insert(0, str(Path(__file__).parents[1]))

import numpy as np
from numpy.typing import NDArray

from benchmarks.other_tools import SCRIPTS, Judge, _write_arm
from benchmarks.parts import Inputs
from benchmarks.rivals import cvxpy_script
from sdp_vs_penalty import check
from sdp_vs_penalty.files import write_text
from sdp_vs_penalty.results.table import markdown_lines
from sdp_vs_penalty.robot import inertia

Array = NDArray[np.float64]
HERE = Path(__file__).parent


def flipped(tau: Array) -> Array:
    """Torques (M, n) with the sign of joint 4's changed."""
    return tau * np.where(np.arange(tau.shape[1]) == 3, -1.0, 1.0)


def exchanged(tau: Array) -> Array:
    """Torques (M, n) with those of joints 2 and 4 exchanged."""
    return tau[:, [0, 3, 2, 1, *range(4, tau.shape[1])]]


MISTAKES: dict[str, Callable[[Array], Array]] = {
    "sign of joint 4's torque": flipped,
    "torques of joints 2 and 4 exchanged": exchanged,
}


def by_toolbox(python: str, tool: str, judge: Judge, tau: Array, folder: Path) -> str:
    """What a toolbox ends with on rows of a wrong log: its last line, or its error."""
    rows = judge.training
    arrays = {"train_tau": tau}
    for name, values in zip(("q", "dq", "ddq"), rows.states, strict=True):
        arrays[f"train_{name}"] = arrays[f"judged_{name}"] = values
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
        return fitted(answer["predicted"], tau)


def by_cvxpy(judge: Judge, tau: Array) -> str:
    """What the ordinary script ends with."""
    columns = cvxpy_script.columns(judge.arm, *judge.training.states)
    theta = cvxpy_script.solve(columns, tau, inertia.PSEUDO_INERTIA_BASIS)
    return fitted(columns @ theta, tau)


def fitted(predicted: Array, tau: Array) -> str:
    """The relative error of a fit that ended without a word."""
    error = 100.0 * np.linalg.norm(predicted - tau) / np.linalg.norm(tau)
    return f"a fit with {error:.3g} % error"


def main() -> None:
    """Ask all tools, and write the table."""
    parser = argparse.ArgumentParser(usage=__doc__)
    data = os.environ.get("SDP_VS_PENALTY_DATA")
    parser.add_argument("--data", type=Path, default=data, required=data is None)
    parser.add_argument("--rivals", required=True)
    parser.add_argument("--out", type=Path, default=HERE)
    options = parser.parse_args()
    inputs = Inputs(Path(options.data).resolve(), [1], 1, options.rivals)
    judge = Judge(inputs)
    table = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        _write_arm(inputs, folder)
        for mistake, change in {"none": np.asarray, **MISTAKES}.items():
            run = replace(inputs.run, tau=change(inputs.run.tau))
            said = [
                f"{issue.kind}, {issue.where}; {issue.remedy}"
                for report in check(inputs.problem, run)
                for issue in report.issues
                if issue.severity != "note"
            ]
            ours = "; ".join(said) or "no problem"
            tau = change(judge.training.tau)
            row = [
                by_toolbox(options.rivals, tool, judge, tau, folder)
                for tool in ("figaroh", "mujoco")
            ]
            table.append([mistake, ours, *row, by_cvxpy(judge, tau)])
    heads = ["mistake", "check", "FIGAROH", "mujoco.sysid", "CVXPY script"]
    text = [
        "# What is said of a log with one mistake",
        "",
        "The Panda's run. The other tools get its rows; a fit is one that ends without a"
        " word, with its error on the rows that it was fitted to."
        " By `python results/benchmarks/wrong_log.py --rivals PYTHON`.",
        "",
        *markdown_lines(heads, table),
        "",
    ]
    write_text(options.out / "wrong_log.md", "\n".join(text))
    print("\n".join(text))


if __name__ == "__main__":
    main()
