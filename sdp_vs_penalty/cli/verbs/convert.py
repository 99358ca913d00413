"""The verb convert: measurements of another program."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from sdp_vs_penalty.cli.arguments import pairs
from sdp_vs_penalty.cli.options import Debug

if TYPE_CHECKING:
    pass


def verb(
    source: Annotated[
        Path,
        typer.Argument(
            metavar="IN", help=".csv .npz .parquet .mat .mcap .bag, or a ROS 2 bag's folder."
        ),
    ],
    out: Annotated[
        Path,
        typer.Option(
            metavar="out.csv|.npz|.parquet|.mat", help="File to write; its suffix is the format."
        ),
    ],
    problem: Annotated[
        str | None, typer.Option(help="The robot whose joint names choose the joints of a ROS bag.")
    ] = None,
    joints: Annotated[
        str | None, typer.Option(metavar="a,b,c", help="Joint names of a ROS bag, in the order wanted.")
    ] = None,
    topic: Annotated[
        str | None, typer.Option(help="Of a ROS bag with several JointState topics.")
    ] = None,
    rename: Annotated[
        str | None,
        typer.Option(
            metavar="t=time,q=qm", help="Which column or variable is t, q, dq, tau (or q1, q2 ...)."
        ),
    ] = None,
    debug: Debug = False,
) -> None:
    """Convert measurements of another program: MATLAB, Parquet, ROS 2 bags and MCAP (JointState).

    Example: sdp-vs-penalty convert rosbag2_folder --problem robot.urdf --out run.csv
    """
    from sdp_vs_penalty.cli import console
    from sdp_vs_penalty.data.files import read_run, save
    from sdp_vs_penalty.problem.load import load_problem

    names = joints.split(",") if joints else None
    if problem is not None and names is None:
        names = [joint.name for joint in load_problem(problem).robot.joints]
    run = read_run(source, None, names, topic, pairs("--rename", rename))
    save(run, out)
    velocity = "" if run.dq is None else ", velocities"
    text = f"written: {out} ({len(run.t)} samples of {run.n} joint(s){velocity})"
    console.out.print(text, markup=False, soft_wrap=True)
