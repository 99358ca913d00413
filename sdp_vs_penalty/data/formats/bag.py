"""ROS 2 bags and MCAP files (and ROS 1 bags) with sensor_msgs/JointState (extra [formats])."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty import formatting
from sdp_vs_penalty.data.formats.columns import Choice, understood
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.data.store import PART, Growing, joined, parts
from sdp_vs_penalty.errors import InputError, missing_extra

SUFFIXES = (".mcap", ".db3", ".bag")
_TYPE = "sensor_msgs/msg/JointState"


def reads(path: Path) -> bool:
    """A ROS 2 bag is a folder with its metadata."""
    return (path / "metadata.yaml").is_file()


def read(path: Path, choice: Choice) -> Measurements:
    """Joints by name: those of the robot, else those of the first message, in its order.

    Messages that lack one of the joints (a gripper's, on the same topic) are left out. Time is the
    header's stamp, in seconds of its day, or the recorder's where stamps are zero.
    """
    try:
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore
    except ImportError as error:
        raise missing_extra("ROS bags and MCAP files need", "formats") from error
    with understood(path, "ROS bag or MCAP file", "name a bag's folder or .mcap file"):
        _stay_inside(path)
        with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
            return _read(path, reader, choice)


def _stay_inside(path: Path) -> None:
    """A bag's metadata names its files; they have to lie in its folder."""
    if not path.is_dir():
        return
    from ruamel.yaml import YAML

    data = YAML(typ="safe").load((path / "metadata.yaml").read_text())
    for name in data["rosbag2_bagfile_information"]["relative_file_paths"]:
        if Path(name).name != name:
            raise InputError(
                f"{name!r} is not a file of this folder",
                "keep a bag's files in one folder",
                path / "metadata.yaml",
            )


def _read(path: Path, reader: Any, choice: Choice) -> Measurements:
    connections = [c for c in reader.connections if c.msgtype == _TYPE]
    topics = sorted({c.topic for c in connections})
    if choice.topic is not None:
        connections = [c for c in connections if c.topic == choice.topic]
    if not connections or (choice.topic is None and len(topics) > 1):
        found = ", ".join(topics) or "none"
        wanted = f"topic {choice.topic!r}" if choice.topic else "one topic"
        raise InputError(
            f"{wanted} with {_TYPE} is needed", f"choose it with --topic (there are: {found})", path
        )
    names = list(choice.joints) if choice.joints else None
    table, clocks = Growing(), Growing()
    rows: list[list[list[float]]] = []
    stamps: list[tuple[int, int]] = []
    others: set[str] = set()

    def store() -> None:
        table.append(np.array(rows, float).reshape(len(rows), 3, len(names or [])))
        clocks.append(np.array(stamps, np.int64).reshape(-1, 2))
        rows.clear()
        stamps.clear()

    for connection, recorder_time, raw in reader.messages(connections=connections):
        message = reader.deserialize(raw, connection.msgtype)
        own = [str(name) for name in message.name]
        if names is None:
            names = own
        elif not set(names) <= set(own):
            names = _with_prefix(names, own) or names
        if not set(names) <= set(own):
            others |= set(own)
            continue
        rows.append(_row(path, message, [own.index(name) for name in names]))
        stamp = message.header.stamp
        stamps.append((int(stamp.sec) * 10**9 + int(stamp.nanosec), int(recorder_time)))
        if len(rows) == PART:
            store()
    store()
    t, channels = clocks.array(), table.array()
    if not len(t):
        raise InputError(
            f"no message has all joints {', '.join(names or ['(none)'])} (there are: "
            f"{', '.join(sorted(others)) or 'none'})",
            "name the joints as the bag does",
            path,
        )
    finite = all(np.all(np.isfinite(part[:, 1])) for _, part in parts(channels))
    dq = channels[:, 1] if finite else None
    return Measurements(_seconds(t), channels[:, 0], channels[:, 2], dq, None, (path.name,))


def _seconds(clocks: NDArray[np.int64]) -> NDArray[np.float64]:
    """(N,) s of (N, 2) nanoseconds, of the header's stamp and the recorder's."""
    stamped = any(part[:, 0].any() for _, part in parts(clocks))
    clock, day = clocks[:, 0 if stamped else 1], 86_400 * 10**9
    # Whole nanoseconds are taken apart before they become floating-point numbers of seconds.
    first = int(clock[0])
    return joined((part - first) / 1e9 + float(first % day) / 1e9 for _, part in parts(clock))


def _with_prefix(names: Sequence[str], own: Sequence[str]) -> list[str] | None:
    """The bag's names where they are the robot's behind one prefix: panda_joint1 for joint1."""
    found = [o for o in own if o.endswith(names[0])]
    if len(found) != 1:
        return None
    prefix = found[0].removesuffix(names[0])
    mapped = [prefix + name for name in names]
    return mapped if set(mapped) <= set(own) else None


def _row(path: Path, message: Any, at: Sequence[int]) -> list[list[float]]:
    """Positions, velocities (NaN where there are none) and efforts of the wanted joints."""
    out = []
    for field in ("position", "velocity", "effort"):
        values = getattr(message, field)
        if len(values) == len(message.name):
            out.append([float(values[k]) for k in at])
        elif field == "velocity":
            out.append([float("nan")] * len(at))
        else:
            raise InputError(
                f"a message has {formatting.count(len(values), 'value')} of {field} for "
                f"{formatting.count(len(message.name), 'joint')}",
                "record position and effort of every joint",
                path,
            )
    return out
