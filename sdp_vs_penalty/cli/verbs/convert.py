"""The verb convert: measurements of another program."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from sdp_vs_penalty.data.texts import pairs


def verb(
    source: Annotated[
        Path,
        typer.Argument(
            metavar="IN", help="File (.csv .npz .parquet .mat .mcap .bag), or a ROS 2 bag's folder."
        ),
    ],
    out: Annotated[
        Path,
        typer.Option(
            metavar="out.csv|.npz|.parquet|.mat", help="File to write; the suffix chooses the format."
        ),
    ],
    problem: Annotated[
        str | None, typer.Option(help="Robot whose joint names choose the joints of a ROS bag.")
    ] = None,
    joints: Annotated[
        str | None, typer.Option(metavar="a,b,c", help="Joint names of a ROS bag, in the order wanted.")
    ] = None,
    topic: Annotated[
        str | None, typer.Option(help="JointState topic, where a ROS bag has several.")
    ] = None,
    rename: Annotated[
        str | None,
        typer.Option(
            metavar="t=time,q=qm", help="Columns or variables that are t, q, dq, tau (or q1, q2 ...)."
        ),
    ] = None,
    motors: Annotated[
        str | None,
        typer.Option(
            metavar="'50 q1,32 q2+32 q1'",
            help="Motor positions by joint positions, for a log of motor positions and torques.",
        ),
    ] = None,
    motor_side: Annotated[
        bool, typer.Option("--motor-side", help="The problem's transmission, for a log of motors.")
    ] = False,
    rate: Annotated[
        float | None,
        typer.Option(help="Rate [Hz] of a table without header: q1..qn, dq1..dqn, tau1..taun."),
    ] = None,
) -> None:
    """Convert measurements of another program: MATLAB, Parquet, ROS 2 bags and MCAP (JointState).

    Logs of motors become those of joints by their transmission (--motors, --motor-side).

    Example: sdp-vs-penalty convert rosbag2_folder --problem robot.urdf --out run.csv
    """
    from sdp_vs_penalty import show
    from sdp_vs_penalty.cli import console
    from sdp_vs_penalty.problem.convert import convert

    names = joints.split(",") if joints else None
    run = convert(
        source,
        out,
        problem=problem,
        joints=names,
        topic=topic,
        rename=pairs("--rename", rename),
        motors=motor_side if motors is None else motors,
        rate=rate,
    )
    velocity = "" if run.dq is None else ", velocities"
    console.written(out, f"{len(run.t)} samples of {show.count(run.n, 'joint')}{velocity}")
