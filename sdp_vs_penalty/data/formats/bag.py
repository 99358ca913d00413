"""ROS 2 bags and MCAP files (and ROS 1 bags) with sensor_msgs/JointState (extra
[formats])."""

from collections.abc import Iterator, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from sdp_vs_penalty import formatting
from sdp_vs_penalty.data.formats.columns import Choice, understood
from sdp_vs_penalty.data.measurements import Measurements, gathered
from sdp_vs_penalty.data.store import (
    PART,
    AppendableArray,
    concatenate_chunks,
    iter_chunks,
)
from sdp_vs_penalty.errors import InputError, missing_extra
from sdp_vs_penalty.robot.arrays import Array

SUFFIXES, FOLDER = (".mcap", ".db3", ".bag"), "metadata.yaml"
_TYPE = "sensor_msgs/msg/JointState"


def read(path: Path, choice: Choice) -> Measurements:
    """Joints by name: those of the robot, else those of the first message, in its
    order.

    Messages that lack one of the joints (a gripper's, on the same topic) are left out.
    Time is the header's stamp, in seconds of its day, or the recorder's where stamps
    are zero.
    """
    from sdp_vs_penalty.robot.isolated import parse_isolated

    names = None if choice.joints is None else list(choice.joints)
    with understood(path, "ROS bag or MCAP file", "name a bag's folder or .mcap file"):
        iter_chunks = parse_isolated(
            run_in_parts, path, names, choice.topic, prepare=message_types, seconds=60.0
        )
        try:
            return gathered(
                Measurements.of(part["t"], part, (path.name,)) for part in iter_chunks
            )
        except ImportError as error:
            raise missing_extra("ROS bags and MCAP files need", "formats") from error


@cache
def message_types() -> Any:
    """The messages of ROS 2, whose definitions take a tenth of a second to read."""
    import rosbags.highlevel  # noqa: F401
    from rosbags.typesys import Stores, get_typestore

    return get_typestore(Stores.ROS2_HUMBLE)


def run_in_parts(
    path: str, joints: list[str] | None, topic: str | None
) -> Iterator[dict[str, Array]]:
    """The run of a bag in consecutive parts, by the names of its channels."""
    from rosbags.highlevel import AnyReader

    place = Path(path)
    _stay_inside(place)
    with AnyReader([place], default_typestore=message_types()) as reader:
        run = _read(place, reader, Choice(joints, topic))
    for part in run.parts():
        yield {"t": part.t, **part.groups}


def _stay_inside(path: Path) -> None:
    """A bag's metadata names its files; they have to lie in its folder."""
    if not path.is_dir():
        return
    from ruamel.yaml import YAML

    data = YAML(typ="safe").load((path / "metadata.yaml").read_text())
    for name in data["rosbag2_bagfile_information"]["relative_file_paths"]:
        if Path(name).name != name:
            what = f"{name!r} is not a file of this folder"
            raise InputError(
                what, "keep a bag's files in one folder", path / "metadata.yaml"
            )


def _read(path: Path, reader: Any, choice: Choice) -> Measurements:
    connections = [c for c in reader.connections if c.msgtype == _TYPE]
    topics = sorted({c.topic for c in connections})
    if choice.topic is not None:
        connections = [c for c in connections if c.topic == choice.topic]
    if not connections or (choice.topic is None and len(topics) > 1):
        found = ", ".join(topics) or "none"
        wanted = f"topic {choice.topic!r}" if choice.topic else "one topic"
        what = f"{wanted} with {_TYPE} is needed"
        raise InputError(what, f"choose it with --topic (there are: {found})", path)
    names, others = list(choice.joints or ()), set[str]()
    table, rows, first = AppendableArray(), list[list[float]](), np.zeros(0)
    for connection, recorded, raw in reader.messages(connections=connections):
        message = reader.deserialize(raw, connection.msgtype)
        own = [str(name) for name in message.name]
        names = _with_prefix(names, own) if names else own
        if not set(names) <= set(own):
            others |= set(own)
            continue
        stamp = message.header.stamp
        # Whole nanoseconds are taken apart before they become floating-point numbers of
        # seconds.
        clocks = np.array([int(stamp.sec) * 10**9 + int(stamp.nanosec), int(recorded)])
        first = first if len(first) else clocks
        rows.append(
            [
                *(clocks - first) / 1e9,
                *_values(path, message, [own.index(n) for n in names]),
            ]
        )
        if len(rows) == PART:
            table.append(np.array(rows))
            rows.clear()
    table.append(np.array(rows, float).reshape(len(rows), 2 + 3 * len(names)))
    whole = table.array()
    if not len(whole):
        there = ", ".join(sorted(others)) or "none"
        what = (
            f"no message has all joints {', '.join(names) or '(none)'} (there are:"
            f" {there})"
        )
        raise InputError(what, "name the joints as the bag does", path)
    q, dq, tau = np.split(whole[:, 2:], 3, axis=1)
    clock = (
        0 if first[0] or any(part.any() for _, part in iter_chunks(whole[:, 0])) else 1
    )
    t = concatenate_chunks(
        part + float(first[clock] % (86_400 * 10**9)) / 1e9
        for _, part in iter_chunks(whole[:, clock])
    )
    finite = all(np.all(np.isfinite(part)) for _, part in iter_chunks(dq))
    return Measurements(t, q, tau, dq if finite else None, None, (path.name,))


def _with_prefix(names: Sequence[str], own: Sequence[str]) -> list[str]:
    """The bag's names where they are the robot's behind one prefix: panda_joint1 for
    joint1."""
    prefixes = {o.removesuffix(names[0]) for o in own if o.endswith(names[0])}
    fit = sorted(
        prefix for prefix in prefixes if {prefix + name for name in names} <= set(own)
    )
    return [fit[0] + name for name in names] if len(fit) == 1 or "" in fit else [*names]


def _values(path: Path, message: Any, at: Sequence[int]) -> list[float]:
    """Positions, velocities (NaN where there are none) and efforts of the wanted
    joints."""
    out, n = list[float](), len(message.name)
    for field in ("position", "velocity", "effort"):
        values = getattr(message, field)
        if len(values) != n and field != "velocity":
            has = formatting.count(len(values), "value")
            what = f"a message has {has} of {field} for {formatting.count(n, 'joint')}"
            raise InputError(what, "record position and effort of every joint", path)
        out += [float(values[k]) if len(values) == n else np.nan for k in at]
    return out
