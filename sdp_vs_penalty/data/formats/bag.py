"""ROS 2 bags and MCAP files (and ROS 1 bags) with sensor_msgs/JointState (extra
[formats]): a column for each topic, joint and field, with the stamps of its messages."""

import json
import warnings
from collections.abc import Iterator, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from sdp_vs_penalty import formatting
from sdp_vs_penalty.data.formats.limits import understood
from sdp_vs_penalty.data.log import Column, Log, Values
from sdp_vs_penalty.data.store import PART, AppendableArray
from sdp_vs_penalty.errors import InputError, Remark, missing_extra
from sdp_vs_penalty.robot.arrays import Array

SUFFIXES: tuple[str, ...] = (".mcap", ".db3", ".bag")
FOLDER = "metadata.yaml"
HAS_TOPICS = True

_TYPE = "sensor_msgs/msg/JointState"
#: What a message of this type is made of.
_PARTS = (_TYPE, "std_msgs/msg/Header", "builtin_interfaces/msg/Time")
#: Its fields, and the quantities that they hold.
_FIELDS = {"position": "q", "velocity": "dq", "effort": "tau"}
#: Nanoseconds of a day.
_DAY = 86_400 * 10**9


def read(path: Path) -> Log:
    """Read the JointState messages of a .bag, .mcap or .db3 file, or of a ROS 2 bag's
    folder.

    The header's stamps are the clock where some are set, else the recording time.
    Messages whose fields are empty, where others of the same joints have them, are
    counted in a remark.
    """
    from sdp_vs_penalty.robot.isolated import parse_isolated

    missing = missing_extra("ROS bags and MCAP files need", "formats")
    try:
        import rosbags  # noqa: F401
    except ImportError as error:
        raise missing from error
    tables = dict[str, AppendableArray]()
    with understood(path, "ROS bag or MCAP file", "name a bag's folder or .mcap file"):
        options: Any = {"library": "rosbags.highlevel", "seconds": 60.0}
        try:
            for part in parse_isolated(streams_in_parts, path, **options):
                for key, rows in part.items():
                    tables.setdefault(key, AppendableArray()).append(rows)
        except ImportError as error:
            raise missing from error
    first = tables.pop("first").array()[0] if tables else np.zeros(4)
    streams = [(json.loads(key), rows.array()) for key, rows in tables.items()]
    is_stamped = bool(first[0]) or any(rows[:, 0].any() for _, rows in streams)
    second_of_day = first[2 if is_stamped else 3]
    columns, clocks = dict[str, Column](), dict[str, Array]()
    values = dict[str, Array]()
    n_empty = 0
    for number, ((topic, names, fields), rows) in enumerate(streams):
        clock = str(number)
        clocks[clock] = rows[:, 0 if is_stamped else 1] + second_of_day
        n_empty += len(rows) * any(
            topic == x and sorted(names) == sorted(y) and {*fields} < {*z}
            for (x, y, z), _ in streams
        )
        channels = [(field, name) for field in fields for name in names]
        for place, (field, name) in enumerate(channels, start=2):
            column = f"{topic}/{name}/{field}"
            column = f"{column} {number}" if column in columns else column
            values[column] = rows[:, place]
            columns[column] = Column(
                quantity=_FIELDS[field], joints=(name,), clock=clock, source=topic
            )
    if n_empty:
        said = f"{formatting.count(n_empty, 'message')} with empty fields left out"
        warnings.warn(f"{path}: {said}", Remark, stacklevel=2)

    def read_columns(names: Sequence[str]) -> Values:
        return Values({name: values[name] for name in names})

    return Log(path, columns, read_columns, clocks=clocks, is_of_messages=True)


@cache
def message_types() -> Any:
    """Load the message definitions of ROS 2, with the decoder of JointState messages.

    Cached: reading the definitions takes a tenth of a second, making the decoder a
    hundredth.
    """
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    store.get_msgdef(_TYPE)
    return store


def streams_in_parts(path: str) -> Iterator[dict[str, Array]]:
    """Read the messages of a bag in parts; to be called in a process of its own.

    Messages of one topic with the same joints and the same fields filled are a stream.
    By its key (topic, joints, fields as JSON) comes a table (K, 2 + ...): two clocks [s],
    the header's stamp and the recording time, since the first message, then each filled
    field of each joint. "first" holds both clocks of the first message [s], and their
    seconds of the day.
    """
    from rosbags.highlevel import AnyReader

    place = Path(path)
    _stay_inside(place)
    rows_of = dict[str, list[list[float]]]()
    # A publisher may name the same joints in another order in every message.
    first_order = dict[tuple[str, ...], list[str]]()
    first = None
    with AnyReader([place], default_typestore=message_types()) as reader:
        defined, prepared = reader.typestore.fielddefs, message_types()
        if all(defined.get(x) == prepared.fielddefs[x] for x in _PARTS):
            reader.typestore = prepared
        connections = [c for c in reader.connections if c.msgtype == _TYPE]
        messages = reader.messages(connections=connections) if connections else ()
        for connection, recorded, raw in messages:
            message: Any = reader.deserialize(raw, connection.msgtype)
            named = [str(name) for name in message.name]
            names = first_order.setdefault(tuple(sorted(named)), named)
            stamp = message.header.stamp
            # Floating-point seconds since 1970 would lose the last digits.
            clocks = [int(stamp.sec) * 10**9 + int(stamp.nanosec), int(recorded)]
            if first is None:
                first = clocks
                days = [x % _DAY / 1e9 for x in clocks]
                yield {"first": np.array([[*(x / 1e9 for x in clocks), *days]])}
            fields = [x for x in _FIELDS if len(getattr(message, x)) == len(names) > 0]
            places = [named.index(name) for name in names]
            row = [(x - y) / 1e9 for x, y in zip(clocks, first, strict=True)]
            for field in fields:
                values = getattr(message, field)
                row += [float(values[k]) for k in places]
            key = json.dumps([connection.topic, names, fields])
            rows = rows_of.setdefault(key, [])
            rows.append(row)
            if len(rows) == PART:
                yield {key: np.array(rows)}
                rows.clear()
    yield from ({key: np.array(rows)} for key, rows in rows_of.items() if rows)


def _stay_inside(path: Path) -> None:
    """Raise InputError where a bag's metadata names a file outside of the bag's
    folder."""
    if not path.is_dir():
        return
    from ruamel.yaml import YAML

    data = YAML(typ="safe").load((path / "metadata.yaml").read_text("utf-8"))
    for name in data["rosbag2_bagfile_information"]["relative_file_paths"]:
        if Path(name).name != name:
            what = f"{name!r} is not a file of this folder"
            where = path / "metadata.yaml"
            raise InputError(what, "keep a bag's files in one folder", where)
