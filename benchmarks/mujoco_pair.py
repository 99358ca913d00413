"""Identification beside MuJoCo's system identification toolbox, a part of `benchmarks/run.py`.

The same are the run, its filters and rows, the parameters (ten a link; damping, dry friction and
offset of each joint), the folds by phase and the judge. Not the same: MuJoCo is given states that are
filtered already, starts from the paper's parameters and minimises the sum over joints of error over norm
of torque, in log-Cholesky variables in a box about the start; its dry friction is the regularised
constraint of its simulator. Ours starts from nothing, weighs joints by their noise and keeps the
problem's bounds.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from speed import HERE, METHOD, Row, process

from sdp_vs_penalty import cross_validate, identify
from sdp_vs_penalty.data.files import save
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.exporters.content import Content
from sdp_vs_penalty.exporters.mjcf import make_mjcf
from sdp_vs_penalty.problem.problem import Problem
from sdp_vs_penalty.problem.published import published_links
from sdp_vs_penalty.robot import inertia
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.signals.phases import phase_folds
from sdp_vs_penalty.signals.preprocessing import _pieces, filtered_torque

#: Steps of MuJoCo's optimiser, which goes on to its 200 by itself. On our columns, with its variables
#: and its box, 20, 40, 60 and 200 steps reach 1.87, 1.80, 1.77 and 1.72 % of unseen torque.
MOST = 40


def beside_mujoco(problem: Problem, run: Measurements, python: str | None) -> list[Row]:
    """Processor time, memory, errors and consistency; python : an environment with ``mujoco[sysid]``."""
    if python is None:
        return []
    settings = problem.preprocessing.resolve(run)
    split = phase_folds(run, settings, 5)
    with tempfile.TemporaryDirectory() as name:
        theirs = _Toolbox(Path(name), python, problem, run)
        everything = np.ones(len(theirs.t), bool)
        fit, (_, processor, memory) = theirs.fit(everything)
        cells = split.cell(0, theirs.t)
        wrong, squares, spent = 0.0, 0.0, []
        for k in range(split.count):
            fold, (_, seconds, _) = theirs.fit(np.isin(cells, split.training(k)))
            tested = np.isin(cells, split.tested(k))
            wrong += np.sum((fold["predicted"] - theirs.torque)[tested] ** 2)
            squares += np.sum(theirs.torque[tested] ** 2)
            spent.append(seconds)
        save(run, Path(name) / "run.csv")
        command = [sys.executable, "-m", "sdp_vs_penalty", "identify", problem.name, "--no-check"]
        command += ["--out", str(Path(name) / "model.json"), "--data", str(Path(name) / "run.csv")]
        _, own, most = min(process(command) for _ in range(3))
    estimate, judged = identify(problem, run, METHOD), cross_validate(problem, run, METHOD)
    rows = filtered_torque(run, estimate.model, settings)
    model = np.column_stack([c.columns @ estimate.theta[c.indices] for c in rows.columns])
    errors = [100.0 * np.linalg.norm(p - rows.torque) / np.linalg.norm(rows.torque)
              for p in (model, fit["predicted"])]  # fmt: skip
    unseen = judged.relative_error_percent, 100.0 * float(np.sqrt(wrong / squares))
    pseudo = inertia.pseudo_inertia(estimate.links)
    thin = _thinnest(pseudo), _thinnest(fit["pseudo"])
    masses = [", ".join(f"{link[3, 3]:.2g}" for link in links) for links in (pseudo, fit["pseudo"])]
    said = str(fit["said"]).strip().splitlines()
    end = next(line for line in said if line.startswith("Terminated"))
    settings_of = (
        f"mujoco.sysid 4.0.0, its optimiser and default box; start: the paper's p_hat; {end.lower()}; "
        f"{int(fit['at_bounds'])} of 91 variables at their bounds"
    )

    def row(what: str, ours: float, other: float, unit: str, note: str) -> Row:
        return Row(f"{what}, beside MuJoCo", ours, other, unit, note)

    return [
        row("identify as a process, CPU", own, processor, "s",
            f"ours from text without the check, theirs from filtered states; {settings_of}"),
        row("identify as a process, peak memory", most, memory, "MB", ""),
        row("relative error on the rows trained on", *errors, "%", f"{rows.torque.size} torques"),
        row("relative error on unseen motion", *unseen, "%",
            f"five folds by phase, {rows.torque.size} torques; theirs took {sum(spent):.0f} s CPU"),
        row("thinnest link (least standard deviation of its mass)", *thin, "mm",
            f"consistent where above zero; masses [kg] {masses[0]} and {masses[1]}"),
    ]  # fmt: skip


class _Toolbox:
    """`mujoco_identify.py` on chosen rows of a run; t (M,), torque (M, n) of all rows."""

    def __init__(self, folder: Path, python: str, problem: Problem, run: Measurements) -> None:
        pieces = list(_pieces(run, problem.preprocessing.resolve(run), False, False))
        self.t = np.concatenate([piece.rows.t for piece in pieces])
        self.torque = np.concatenate([piece.torque for piece in pieces])
        low_pass = sparse.csr_array(
            sparse.block_diag([p.low_pass @ np.eye(len(p.around.t)) for p in pieces], format="csr")
        )
        states = {x: np.concatenate([getattr(p.around, x) for p in pieces]) for x in ("q", "dq", "ddq")}
        parts = {name: getattr(low_pass, name) for name in ("data", "indices", "indptr", "shape")}
        self.given = states | parts | {"torque": self.torque, "most": MOST}
        robot, nothing = problem.robot, np.zeros(problem.robot.n)
        links = [inertia.transform(joint.link_frame) @ link for joint, link in
                 zip(robot.joints, published_links(problem, "p_hat"), strict=True)]  # fmt: skip
        content = Content(np.stack(links), nothing, nothing, nothing, ())
        (folder / "start.xml").write_bytes(make_mjcf(robot, content))
        script = str(HERE / "mujoco_identify.py")
        self.out, self.rows = folder / "out.npz", folder / "rows.npz"
        self.command = [python, script, str(self.rows), str(folder / "start.xml"), str(self.out)]

    def fit(self, train: NDArray[np.bool_]) -> tuple[dict[str, Array], tuple[float, float, float]]:
        """What it returns, with its wall time [s], processor time [s] and peak memory [MB]."""
        np.savez(self.rows, train=train, **self.given)
        used = process(self.command)
        with np.load(self.out) as found:
            return dict(found), used


def _thinnest(pseudo: Array) -> float:
    """Least standard deviation [mm] of any link's mass, pseudo (links, 4, 4); NaN: inconsistent."""
    mass, first = pseudo[:, 3, 3, None, None], pseudo[:, :3, 3]
    about = pseudo[:, :3, :3] / mass - first[:, :, None] * first[:, None, :] / mass**2
    return float(1e3 * np.sqrt(np.linalg.eigvalsh(about).min()))
