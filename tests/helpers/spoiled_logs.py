"""Logs of one arm, each spoiled in one way that loggers know, as files that a person
drops on the page."""

from dataclasses import replace

import numpy as np
from arms import THREE, write_urdf
from small_runs import small_run

from sdp_vs_penalty import load_problem
from sdp_vs_penalty.data import save

NAMES = ("run1.csv", "run2.csv", "test.csv")
#: Length of each run [s], and its samples a second [Hz].
SECONDS = 20.0
RATE = 200.0
#: Newton metres an ampere of each joint.
DRIVE = np.array([9.0, 9.0, 7.0])
#: Wrong zeros [rad].
ZERO = np.array([0.0, 0.5, 0.0])

#: What is done to each run, by the name of the fault.
SPOILED = {
    "sign": lambda run: replace(run, tau=run.tau * [1.0, 1.0, -1.0]),
    "order": lambda run: replace(run, tau=run.tau[:, [0, 2, 1]]),
    "degrees": lambda run: replace(run, q=np.degrees(run.q), dq=None),
    "milliseconds": lambda run: replace(run, t=1e3 * run.t),
    "amperes": lambda run: replace(run, tau=run.tau / DRIVE),
    "gain": lambda run: replace(run, tau=run.tau * [1.0, 1.3, 1.0]),
    "zero": lambda run: replace(run, q=run.q + ZERO),
    "percent": lambda run: replace(run, q=run.q / 0.025, dq=None),
}
#: Those that are made otherwise.
OTHERS = ("mounting", "two rates", "two files", "headerless", "hold")
KINDS = (*SPOILED, *OTHERS)

_FINGER = """
<link name="finger"><inertial><mass value="0.05"/>
<inertia ixx="1e-5" iyy="1e-5" izz="1e-5" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="finger_joint" type="prismatic"><parent link="{link}"/><child link="finger"/>
<axis xyz="1 0 0"/><limit lower="0" upper="0.04" effort="20" velocity="1"/></joint>
"""


def write_logs(kind, folder):
    """Write the arm's URDF and three spoiled runs; return their paths."""
    urdf = write_urdf(folder / "arm.urdf", "arm", THREE)
    problem = load_problem(urdf)
    gravity = (0.0, -9.81, 0.0) if kind == "mounting" else (0.0, 0.0, -9.81)
    arm = problem.with_gravity(gravity)
    rates = (RATE, 2.5 * RATE if kind == "two rates" else RATE, RATE)
    runs = [small_run(arm, SECONDS, seed, rate) for seed, rate in enumerate(rates, 1)]
    paths = [folder / name for name in NAMES]
    if kind == "headerless":
        for run, path in zip(runs, paths, strict=True):
            _write_table(run, path, "")
    elif kind == "two files":  # positions in one, torques in another at half their rate
        halves = [path.with_stem(f"{path.stem}_encoder") for path in paths]
        others = [path.with_stem(f"{path.stem}_drive") for path in paths]
        for run, of_q, of_tau in zip(runs, halves, others, strict=True):
            for file, name, values in ((of_q, "q", run.q), (of_tau, "tau", run.tau)):
                header = ",".join(["t", *(f"{name}{j}" for j in range(1, 4))])
                step = 1 + (name == "tau")
                table = np.column_stack([run.t, values])[::step]
                np.savetxt(
                    file, table, delimiter=",", fmt="%.9g", header=header, comments=""
                )
        paths = [*halves, *others]
    elif kind == "hold":
        text = urdf.read_text("utf-8").replace("</robot>", "")
        link = text.split('<link name="')[-1].partition('"')[0]
        urdf.write_text(f"{text}{_FINGER.format(link=link)}</robot>", "utf-8")
        names = problem.robot.joint_names
        heads = ["t", *(f"{n}_pos" for n in names), *(f"{n}_eff" for n in names)]
        for run, path in zip(runs, paths, strict=True):
            _write_table(run, path, ",".join(heads))
    else:
        spoil = SPOILED.get(kind, lambda run: run)
        for run, path in zip(runs, paths, strict=True):
            save(spoil(run), path)
    return urdf, paths


def _write_table(run, path, header):
    """Write clock, positions and torques as CSV."""
    columns = [run.t, run.q, run.tau]
    table = np.column_stack(columns)
    np.savetxt(path, table, delimiter=",", fmt="%.9g", header=header, comments="")
