"""Channels that were logged at the motors, as those of the joints."""

from __future__ import annotations

import tomllib
from dataclasses import replace

from sdp_vs_penalty import formatting
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.files import problems_folder
from sdp_vs_penalty.robot.joint import Transmission, parse_transmission


def to_joints(measurements: Measurements, transmission: Transmission) -> Measurements:
    """The same runs on the joint side: q = A^-1 (q_m - b), tau = A^T tau_m, channel by channel as the
    transmission says where they were logged.

    Raises InputError where the runs have another number of channels.
    """
    if measurements.n != transmission.n:
        raise InputError(
            f"the file has {formatting.count(measurements.n, 'joint')}, the transmission "
            f"{formatting.count(transmission.n, 'motor')}",
            "name a log with one column a motor",
            measurements.names[0],
        )
    dq = measurements.dq
    told = dict(measurements.commanded)
    for name in told.keys() & {"qcmd", "dqcmd"}:
        told[name] = transmission.joint_positions(told[name], rates=name == "dqcmd")
    if "tauff" in told:
        told["tauff"] = transmission.joint_torques(told["tauff"])
    return replace(
        measurements,
        q=transmission.joint_positions(measurements.q),
        tau=transmission.joint_torques(measurements.tau),
        dq=None if dq is None else transmission.joint_positions(dq, rates=True),
        commanded=told,
    )


def transmission_of(problem: str) -> Transmission | None:
    """What the problem.toml of a built-in problem says of its transmission."""
    text = (problems_folder() / problem / "problem.toml").read_text(encoding="utf-8")
    section = tomllib.loads(text).get("transmission")
    return None if section is None else parse_transmission(**section)
