"""ROS 2 bags and MCAP files (and ROS 1 bags) with sensor_msgs/JointState (extra
[formats])."""

import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty import formatting
from sdp_vs_penalty.data.formats.columns import Choice, understood
from sdp_vs_penalty.data.measurements import Measurements, gathered
from sdp_vs_penalty.data.merging import half_period, nearest_rows
from sdp_vs_penalty.data.store import (
    PART,
    AppendableArray,
    concatenate_chunks,
    iter_chunks,
)
from sdp_vs_penalty.errors import InputError, Remark, missing_extra
from sdp_vs_penalty.robot.arrays import Array

SUFFIXES = (".mcap", ".db3", ".bag")
FOLDER = "metadata.yaml"
#: Whether such a file holds several topics, of which ``--topic`` chooses one.
HAS_TOPICS = True
_TYPE = "sensor_msgs/msg/JointState"
#: What a message of this type is made of.
_PARTS = (_TYPE, "std_msgs/msg/Header", "builtin_interfaces/msg/Time")
_FIELDS = ("position", "velocity", "effort")


def read(path: Path, choice: Choice) -> Measurements:
    """Read the run of a bag from its JointState messages.

    Parameters
    ----------
    path : Path
        Of a .bag, .mcap or .db3 file, or a ROS 2 bag's folder.
    choice : Choice
        Joints and topic to take.

    Returns
    -------
    Measurements
        The run in SI units, one row a sample.

    Raises
    ------
    InputError
        No such messages, or joints that are missing.
    """
    from sdp_vs_penalty.robot.isolated import parse_isolated

    try:
        import rosbags  # noqa: F401
    except ImportError as error:
        raise missing_extra("ROS bags and MCAP files need", "formats") from error
    names = None if choice.joints is None else list(choice.joints)
    with understood(path, "ROS bag or MCAP file", "name a bag's folder or .mcap file"):
        pieces = parse_isolated(
            run_in_parts,
            path,
            names,
            choice.topic,
            prepare=message_types,
            seconds=60.0,
        )
        try:
            places = next(pieces)["places"].astype(int).tolist()
            run = gathered(
                Measurements.of(
                    part["t"],
                    part,
                    (path.name,),
                )
                for part in pieces
            )
            return replace(run, joint_names=tuple((names or [])[k] for k in places))
        except ImportError as error:
            raise missing_extra("ROS bags and MCAP files need", "formats") from error


@cache
def message_types() -> Any:
    """The messages of ROS 2, whose definitions take a tenth of a second to read, with
    the decoder of joint states, which takes a hundredth to make."""
    import rosbags.highlevel  # noqa: F401
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    store.get_msgdef(_TYPE)
    return store


def run_in_parts(
    path: str,
    joints: list[str] | None,
    topic: str | None,
) -> Iterator[dict[str, Array]]:
    """The run of a bag in consecutive parts, by the names of its channels."""
    from rosbags.highlevel import AnyReader

    place = Path(path)
    _stay_inside(place)
    with AnyReader([place], default_typestore=message_types()) as reader:
        _use_prepared_decoder(reader)
        run = _read(place, reader, Choice(joints, topic))
    # Which of the robot's joints the bag has.
    yield {
        "places": np.array([(joints or []).index(n) for n in run.joint_names], float)
    }
    for part in run.parts():
        yield {"t": part.t, **part.groups}


def _use_prepared_decoder(reader: Any) -> None:
    """Decode joint states by :func:`message_types` where the bag defines them alike."""
    prepared = message_types()
    defined = reader.typestore.fielddefs
    if all(defined.get(part) == prepared.fielddefs[part] for part in _PARTS):
        reader.typestore = prepared


def _stay_inside(path: Path) -> None:
    """A bag's metadata names its files; they have to lie in its folder."""
    if not path.is_dir():
        return
    from ruamel.yaml import YAML

    data = YAML(typ="safe").load((path / "metadata.yaml").read_text("utf-8"))
    for name in data["rosbag2_bagfile_information"]["relative_file_paths"]:
        if Path(name).name != name:
            what = f"{name!r} is not a file of this folder"
            raise InputError(
                what,
                "keep a bag's files in one folder",
                path / "metadata.yaml",
            )


@dataclass
class _Stream:
    """Messages of one topic with the same joints and the same fields filled.

    names : of the joints; fields : which of position, velocity and effort have a value
    for each joint; table : (N, 2 + 3 n) clocks [s] and values, NaN where there are none.
    """

    topic: str
    names: tuple[str, ...]
    fields: tuple[str, ...]
    table: AppendableArray = field(default_factory=AppendableArray)
    rows: list[list[float]] = field(default_factory=list)
    values: Array = field(default_factory=lambda: np.zeros((0, 2)))

    def add(self, row: list[float]) -> None:
        """Add a message's clocks and values."""
        self.rows.append(row)
        if len(self.rows) == PART:
            self.finish_part()

    def finish_part(self) -> None:
        """Hand the rows so far to the table."""
        self.table.append(np.array(self.rows, float).reshape(len(self.rows), -1))
        self.rows.clear()

    def column(self, field_name: str, joint: str) -> Array:
        """(N,) one field of one joint."""
        at = _FIELDS.index(field_name) * len(self.names) + self.names.index(joint)
        return np.asarray(self.values[:, 2 + at])


def _read(path: Path, reader: Any, choice: Choice) -> Measurements:
    connections = [c for c in reader.connections if c.msgtype == _TYPE]
    topics = sorted({c.topic for c in connections})
    if not connections or (choice.topic is not None and choice.topic not in topics):
        raise _which_topic(path, choice.topic, topics)
    streams, first = _streams(path, reader, connections)
    names, leading = _choose_joints(path, streams, choice)
    run = _merged(path, streams, leading, list(names), first)
    called = tuple(names.values()) if choice.joints is not None else ()
    return replace(run, joint_names=called)


def _which_topic(
    path: Path,
    topic: str | None,
    topics: Sequence[str],
) -> InputError:
    """The error of a topic that is not there, or several that hold all joints."""
    subject = f"topic {topic!r}" if topic else "one topic"
    what = f"{subject} with {_TYPE} is needed"
    there = ", ".join(topics) or "none"
    return InputError(what, f"choose it with --topic (there are: {there})", path)


def _streams(
    path: Path,
    reader: Any,
    connections: Sequence[Any],
) -> tuple[list[_Stream], Array]:
    """The messages by topic, joints and fields, and the clocks of the first one [ns]."""
    streams = dict[tuple[Any, ...], _Stream]()
    first = np.zeros(0)
    for connection, recorded, raw in reader.messages(connections=connections):
        message = reader.deserialize(raw, connection.msgtype)
        names = tuple(str(name) for name in message.name)
        fields = _filled_fields(message, len(names))
        key = (connection.topic, names, fields)
        stream = streams.setdefault(key, _Stream(*key))
        clocks = _clocks_of(message, recorded)
        first = first if len(first) else clocks
        row: list[float] = ((clocks - first) / 1e9).tolist()
        for name in _FIELDS:
            values = getattr(message, name) if name in fields else [np.nan] * len(names)
            row += [float(x) for x in values]
        stream.add(row)
    for stream in streams.values():
        stream.finish_part()
        stream.values = stream.table.array()
    return list(streams.values()), first


def _filled_fields(message: Any, n_joints: int) -> tuple[str, ...]:
    """The fields of a message that have a value for each of its joints."""
    lengths = {name: len(getattr(message, name)) for name in _FIELDS}
    return tuple(name for name, n in lengths.items() if n == n_joints > 0)


def _clocks_of(message: Any, recorded: int) -> Array:
    """(2,) the header's stamp and the recorder's, whole [ns]: they are taken apart
    before they become floating-point numbers of seconds."""
    stamp = message.header.stamp
    return np.array(
        [
            int(stamp.sec) * 10**9 + int(stamp.nanosec),
            int(recorded),
        ]
    )


def _choose_joints(
    path: Path,
    streams: Sequence[_Stream],
    choice: Choice,
) -> tuple[dict[str, str], _Stream]:
    """The joints to take, as the bag calls them and as the robot does, and the stream
    whose rows are kept.

    Those of the robot behind one prefix; without a robot those of the first message
    with a position, in its order. A robot's joints of which the bag says nothing are
    left to be held.
    """
    usable = [s for s in streams if choice.topic in (None, s.topic)]
    placed = [s for s in usable if "position" in s.fields]
    if not placed:
        raise _weightless(path, streams, "position")
    called = list(choice.joints or max(placed, key=lambda s: len(s.names)).names)
    in_bag = list(dict.fromkeys(name for s in placed for name in s.names))
    names = _with_prefix(called, in_bag)
    pairs = zip(names, called, strict=True)
    robot_name = {name: robots for name, robots in pairs if name in in_bag}
    if 2 * len(robot_name) <= len(names):
        there = ", ".join(sorted(in_bag)) or "none"
        asked_for = ", ".join(names) or "(none)"
        what = f"no message has all joints {asked_for} (there are: {there})"
        raise InputError(what, "name the joints as the bag does", path)
    return robot_name, _leading_stream(path, placed, set(robot_name), choice.topic)


def _leading_stream(
    path: Path,
    placed: Sequence[_Stream],
    joints: set[str],
    topic: str | None,
) -> _Stream:
    """The stream whose rows are kept: of the topic that says most of the joints,
    position and effort, the one with most joints; InputError where two topics say all.

    placed : streams with positions.
    """
    n_channels = {
        candidate: len(_channels_of(placed, candidate, joints))
        for candidate in {s.topic for s in placed}
    }
    largest = max(n_channels.values())
    best = sorted(name for name, n in n_channels.items() if n == largest)
    if len(best) > 1 and topic is None and largest == 2 * len(joints):
        raise _which_topic(path, None, sorted(n_channels))
    candidates = [s for s in placed if s.topic in best and joints & set(s.names)]
    return max(
        candidates,
        key=lambda s: (
            len(joints & set(s.names)),
            "effort" in s.fields,
            len(s.values),
        ),
    )


def _channels_of(
    streams: Sequence[_Stream],
    topic: str,
    joints: set[str],
) -> set[tuple[str, str]]:
    """The positions and efforts of these joints that a topic says, as (joint, field)."""
    channels = set[tuple[str, str]]()
    for stream in streams:
        if stream.topic != topic:
            continue
        fields = [name for name in stream.fields if name != "velocity"]
        for joint in joints & set(stream.names):
            channels |= {(joint, field_name) for field_name in fields}
    return channels


@dataclass
class _Merge:
    """One row for each message of the leading stream, with what others say at the
    nearest stamp.

    sources : the stream that says a field of a joint, None without; rows : of each
    stream the row that belongs to each of the leading one's; is_kept : rows of which
    all is known.
    """

    sources: dict[tuple[str, str], _Stream | None]
    rows: dict[int, NDArray[np.intp]]
    is_kept: NDArray[np.bool_]

    def block(self, joints: Sequence[str], field_name: str) -> Array:
        """(N, n) one field of all joints in the kept rows, part by part: a long bag's
        lies on the disk."""
        rows = np.flatnonzero(self.is_kept)
        return concatenate_chunks(
            np.column_stack(
                [
                    self._column(
                        joint,
                        field_name,
                        part,
                    )
                    for joint in joints
                ]
            )
            for _, part in iter_chunks(rows)
        )

    def _column(
        self,
        joint: str,
        field_name: str,
        part: NDArray[np.intp],
    ) -> Array:
        """One field of one joint in some of the leading stream's rows."""
        source = self.sources[joint, field_name]
        if source is None:
            return np.full(len(part), np.nan)
        return source.column(field_name, joint)[self.rows[id(source)][part]]


def _merge(
    streams: Sequence[_Stream],
    leading: _Stream,
    joints: Sequence[str],
    clock: int,
) -> _Merge:
    """What belongs to each message of the leading stream: within half a period, but for
    a joint that never moves, which says it at any time; clock : the stamp's column."""
    t = leading.values[:, clock]
    within = half_period(t)
    sources = {
        (joint, field_name): _source_of(streams, leading, joint, field_name)
        for joint in joints
        for field_name in _FIELDS
    }
    merge = _Merge(
        sources,
        {id(leading): np.arange(len(t))},
        np.ones(len(t), bool),
    )
    for (joint, field_name), source in sources.items():
        if source is None or source is leading:
            continue
        order = np.argsort(source.values[:, clock], kind="stable")
        nearest, is_near = nearest_rows(t, source.values[order, clock], within)
        merge.rows[id(source)] = order[nearest]
        is_still = np.ptp(source.column(field_name, joint)) == 0.0
        merge.is_kept &= is_near | is_still | (field_name == "velocity")
    return merge


def _merged(
    path: Path,
    streams: Sequence[_Stream],
    leading: _Stream,
    names: Sequence[str],
    first: Array,
) -> Measurements:
    """The run of all streams, a row for each message of the leading one; first : its
    clocks [ns]."""
    is_stamped = bool(first[0]) or any(s.values[:, 0].any() for s in streams)
    clock = 0 if is_stamped else 1
    merge = _merge(streams, leading, names, clock)
    for field_name in ("position", "effort"):
        if all(merge.sources[name, field_name] is None for name in names):
            raise _weightless(path, streams, field_name)
    n_unmatched = int(np.sum(~merge.is_kept))
    _say_what_is_skipped(path, streams, leading, names, n_unmatched)
    dq = merge.block(names, "velocity")
    has_velocities = all(np.all(np.isfinite(part)) for _, part in iter_chunks(dq))
    second_of_day = float(first[clock] % (86_400 * 10**9)) / 1e9
    stamps = leading.values[:, clock]
    rows = np.flatnonzero(merge.is_kept)
    return Measurements(
        t=concatenate_chunks(
            stamps[part] + second_of_day for _, part in iter_chunks(rows)
        ),
        q=merge.block(names, "position"),
        tau=merge.block(names, "effort"),
        dq=dq if has_velocities else None,
        names=(path.name,),
    )


def _source_of(
    streams: Sequence[_Stream],
    leading: _Stream,
    joint: str,
    what: str,
) -> _Stream | None:
    """The stream that says this of the joint: the leading one, one of its topic, another
    one; None where none does."""
    having = [s for s in streams if what in s.fields and joint in s.names]
    if not having:
        return None
    return max(
        having, key=lambda s: (s is leading, s.topic == leading.topic, len(s.values))
    )


def _say_what_is_skipped(
    path: Path,
    streams: Sequence[_Stream],
    leading: _Stream,
    names: Sequence[str],
    unmatched: int,
) -> None:
    """How many messages are left out, and why."""
    empty = sum(
        len(s.values)
        for s in streams
        if s is not leading
        and s.topic == leading.topic
        and set(s.names) == set(leading.names)
        and len(s.fields) < len(leading.fields)
    )
    reasons = []
    if empty:
        reasons.append(f"{formatting.count(empty, 'message')} with empty fields")
    if unmatched:
        more = formatting.count(unmatched, "message")
        reasons.append(f"{more} without the other joints within half a period")
    if reasons:
        warnings.warn(f"{path}: {' and '.join(reasons)} left out", Remark, stacklevel=2)


def _weightless(
    path: Path,
    streams: Sequence[_Stream],
    what: str,
) -> InputError:
    """The error of a bag in which nobody says positions, or efforts."""
    topics = ", ".join(sorted({s.topic for s in streams}))
    problem = f"no message of {topics} has {what} of every joint"
    return InputError(problem, "record position and effort of every joint", path)


def _with_prefix(names: Sequence[str], names_in_bag: Sequence[str]) -> list[str]:
    """The bag's names where they are the robot's behind one prefix: panda_joint1 for
    joint1. The prefix that fits most joints; the names themselves where two fit."""
    prefixes = {""} | {
        o.removesuffix(n) for n in names for o in names_in_bag if o.endswith(n)
    }
    fits = {p: sum(p + name in names_in_bag for name in names) for p in prefixes}
    largest = max(fits.values())
    best = sorted(p for p, count in fits.items() if count == largest)
    prefix = best[0] if len(best) == 1 or "" in best else ""
    return [prefix + name for name in names]
