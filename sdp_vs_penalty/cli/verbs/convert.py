"""The verb convert: measurements of another program."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from sdp_vs_penalty.cli import console
from sdp_vs_penalty.data.cli_parsing import pairs

if TYPE_CHECKING:
    from sdp_vs_penalty.data.measurements import Measurements


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
            metavar="t=time,q*=pos_*",
            help="Columns that are t, q, dq, tau (or q1 ...); common loggers' are recognised.",
        ),
    ] = None,
    scale: Annotated[
        str | None,
        typer.Option(
            "--scale",
            "--units",
            metavar="q=deg,tau=10:10.7:8.5",
            help="Units (deg, ms, mNm), factors, or one a joint (drive gains).",
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
        scale=pairs("--scale", scale),
    )
    velocity = "" if run.dq is None else ", velocities"
    _first_rows(run)
    console.written(out, f"{len(run.t)} samples of {show.count(run.n, 'joint')}{velocity}")


def _first_rows(run: Measurements) -> None:
    """The first five rows as they are written, so that a wrong column or unit is seen."""
    from sdp_vs_penalty.data.formats.columns import columns_of

    for name, column in columns_of(run.rows(slice(0, 5))).items():
        console.say(f"  {name:<6} " + " ".join(f"{x:>11.5g}" for x in column))
