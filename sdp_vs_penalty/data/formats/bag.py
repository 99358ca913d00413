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
from sdp_vs_penalty.data.formats.joint_names import match_joints
from sdp_vs_penalty.data.measurements import Measurements, gathered
from sdp_vs_penalty.data.merging import Interpolation, half_period, interpolation_remark
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
            run_in_parts, path, names, choice.topic, prepare=message_types, seconds=60.0
        )
        try:
            places = next(pieces)["places"].astype(int).tolist()
            run = gathered(
                Measurements.of(part["t"], part, (path.name,)) for part in pieces
            )
            return replace(run, joint_names=tuple((names or [])[k] for k in places))
        except ImportError as error:
            raise missing_extra("ROS bags and MCAP files need", "formats") from error


@cache
def message_types() -> Any:
    """Load the message definitions of ROS 2, with the decoder of JointState messages.

    Cached: reading the definitions takes a tenth of a second, making the decoder a
    hundredth.
    """
    import rosbags.highlevel  # noqa: F401
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    store.get_msgdef(_TYPE)
    return store


def run_in_parts(
    path: str, joints: list[str] | None, topic: str | None
) -> Iterator[dict[str, Array]]:
    """Read the run of a bag in consecutive parts; to be called in a process of its own.

    The first part holds "places": the place, from 0, of each joint of the bag among the
    robot's joints. The others hold the channels, t (N,) and q, dq, tau (N, n).
    """
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
    """Use the cached decoder of :func:`message_types` where the bag defines its
    messages as ROS 2 does."""
    prepared = message_types()
    defined = reader.typestore.fielddefs
    if all(defined.get(part) == prepared.fielddefs[part] for part in _PARTS):
        reader.typestore = prepared


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
            raise InputError(
                what, "keep a bag's files in one folder", path / "metadata.yaml"
            )


@dataclass
class _Stream:
    """Messages of one topic that have the same joints and the same fields filled."""

    #: Name of the topic.
    topic: str
    #: Names of the joints, in the order of the first message that has them.
    names: tuple[str, ...]
    #: Those of "position", "velocity" and "effort" that have a value for each joint.
    fields: tuple[str, ...]
    #: Appendable table on the disk, to which full parts of rows go.
    table: AppendableArray = field(default_factory=AppendableArray)
    #: Rows that are not in the table yet.
    rows: list[list[float]] = field(default_factory=list)
    #: (N, 2 + 3 n) all rows: two clocks [s], then position, velocity and effort of each
    #: joint; NaN where there is none.
    values: Array = field(default_factory=lambda: np.zeros((0, 2)))

    def add(self, row: list[float]) -> None:
        """Append the row of one message: two clocks [s] and 3 n values."""
        self.rows.append(row)
        if len(self.rows) == PART:
            self.finish_part()

    def finish_part(self) -> None:
        """Move the collected rows to the table."""
        self.table.append(np.array(self.rows, float).reshape(len(self.rows), -1))
        self.rows.clear()

    def column(self, field_name: str, joint: str) -> Array:
        """Return (N,) values of one field ("position", "velocity" or "effort") of one
        joint."""
        n_clocks = 2
        first_of_field = n_clocks + _FIELDS.index(field_name) * len(self.names)
        place = first_of_field + self.names.index(joint)
        return np.asarray(self.values[:, place])


def _read(path: Path, reader: Any, choice: Choice) -> Measurements:
    """Read the run of an open bag: collect its messages, choose the joints, and merge
    the streams."""
    connections = [c for c in reader.connections if c.msgtype == _TYPE]
    topics = sorted({connection.topic for connection in connections})
    is_missing = choice.topic is not None and choice.topic not in topics
    if not connections or is_missing:
        raise _which_topic(path, choice.topic, topics)
    streams, first = _streams(path, reader, connections)
    robot_names, leading = _choose_joints(path, streams, choice)
    run = _merged(path, streams, leading, list(robot_names), first)
    joint_names = tuple(robot_names.values()) if choice.joints is not None else ()
    return replace(run, joint_names=joint_names)


def _which_topic(path: Path, topic: str | None, topics: Sequence[str]) -> InputError:
    """Return the error of a topic that is missing, or of several topics that each hold
    all joints."""
    subject = f"topic {topic!r}" if topic else "one topic"
    what = f"{subject} with {_TYPE} is needed"
    if not topics:
        return InputError(what, "record the joints' states; this bag has none", path)
    command = formatting.convert_command(path, "--topic", topics[0])
    remedy = f"choose one with `{command}` (there are: {', '.join(topics)})"
    return InputError(what, remedy, path)


def _streams(
    path: Path, reader: Any, connections: Sequence[Any]
) -> tuple[list[_Stream], Array]:
    """Collect the JointState messages into streams: by topic, joints and filled fields.

    Returns the streams, and (2,) the clocks [ns] of the first message (header stamp,
    recording time), from which all others are counted.
    """
    streams = dict[tuple[Any, ...], _Stream]()
    # A publisher may name the same joints in another order in every message.
    first_order = dict[tuple[str, ...], tuple[str, ...]]()
    first = np.zeros(0)
    for connection, recorded, raw in reader.messages(connections=connections):
        message = reader.deserialize(raw, connection.msgtype)
        in_message = tuple(str(name) for name in message.name)
        names = first_order.setdefault(tuple(sorted(in_message)), in_message)
        places = [in_message.index(name) for name in names]
        fields = _filled_fields(message, len(names))
        key = (connection.topic, names, fields)
        stream = streams.setdefault(key, _Stream(*key))
        clocks = _clocks_of(message, recorded)
        first = first if len(first) else clocks
        row: list[float] = ((clocks - first) / 1e9).tolist()
        for name in _FIELDS:
            values = getattr(message, name) if name in fields else [np.nan] * len(names)
            row += [float(values[place]) for place in places]
        stream.add(row)
    for stream in streams.values():
        stream.finish_part()
        stream.values = stream.table.array()
    return list(streams.values()), first


def _filled_fields(message: Any, n_joints: int) -> tuple[str, ...]:
    """List the fields of a message (position, velocity, effort) that have one value for
    each joint."""
    lengths = {name: len(getattr(message, name)) for name in _FIELDS}
    return tuple(name for name, n in lengths.items() if n == n_joints > 0)


def _clocks_of(message: Any, recorded: int) -> Array:
    """Return (2,) the header's stamp and the recording time of a message, in whole
    nanoseconds.

    Floating-point seconds since 1970 would lose the last digits, so differences are
    taken first.
    """
    stamp = message.header.stamp
    return np.array([int(stamp.sec) * 10**9 + int(stamp.nanosec), int(recorded)])


def _choose_joints(
    path: Path, streams: Sequence[_Stream], choice: Choice
) -> tuple[dict[str, str], _Stream]:
    """Choose the joints to read, and the stream whose messages become the run's rows.

    The robot's joints are looked for in the bag, perhaps with other words around their
    names ("panda_joint1"). More than half have to be there, or two by their very names;
    the others are left to be held.
    Without a robot, all joints of the largest stream are taken in its order.

    Returns
    -------
    names : dict of str to str
        The robot's joint names by the bag's.
    leading : _Stream
        The stream that gives the rows.
    """
    usable = [s for s in streams if choice.topic in (None, s.topic)]
    placed = [s for s in usable if "position" in s.fields]
    if not placed:
        raise _weightless(path, streams, "position")
    largest = max(placed, key=lambda s: len(s.names))
    robot_joints = list(choice.joints or largest.names)
    in_bag = list(dict.fromkeys(name for s in placed for name in s.names))
    bag_names = match_joints(robot_joints, in_bag)
    robot_name = {name: joint for joint, name in bag_names.items()}
    n_by_name = len(set(robot_joints) & set(in_bag))
    if n_by_name < 2 and 2 * len(robot_name) <= len(robot_joints):
        there = ", ".join(sorted(in_bag)) or "none"
        expected = ", ".join(robot_joints) or "(none)"
        what = f"no message has all joints {expected} (there are: {there})"
        raise InputError(what, "name the joints as the bag does", path)
    return robot_name, _leading_stream(path, placed, set(robot_name), choice.topic)


def _leading_stream(
    path: Path, placed: Sequence[_Stream], joints: set[str], topic: str | None
) -> _Stream:
    """Choose the stream whose messages become the run's rows.

    The topic with most positions and efforts of the joints wins, and in it the stream
    with most joints, with efforts, and with most messages. ``placed`` are the streams
    with positions. Raises InputError where two topics each have all channels.
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
        key=lambda s: (len(joints & set(s.names)), "effort" in s.fields, len(s.values)),
    )


def _channels_of(
    streams: Sequence[_Stream], topic: str, joints: set[str]
) -> set[tuple[str, str]]:
    """Collect the positions and efforts of some joints that a topic has, as (joint,
    field) pairs."""
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
    """All streams at the N stamps of the stream with the efforts."""

    #: Stream of each (joint, field); None where no stream has it.
    sources: dict[tuple[str, str], _Stream | None]
    #: (N,) stamps of the rows [s].
    t: Array
    #: How each stream's channels come to these stamps, by id(stream); no entry for the
    #: stream that has them.
    interpolations: dict[int, Interpolation]
    #: (N,) whether all channels of the row are known.
    is_kept: NDArray[np.bool_]

    @property
    def remark(self) -> str:
        """What was interpolated and how far; "" where nothing was."""
        distances = [x.distances[self.is_kept] for x in self.interpolations.values()]
        return interpolation_remark(distances)

    def block(self, joints: Sequence[str], field_name: str) -> Array:
        """Return (N, n) values of one field of all joints in the kept rows.

        It is built in pieces: that of a long bag lies on the disk.
        """
        rows = np.flatnonzero(self.is_kept)
        pieces = (
            np.column_stack([self._column(x, field_name, part) for x in joints])
            for _, part in iter_chunks(rows)
        )
        return concatenate_chunks(pieces)

    def _column(self, joint: str, field_name: str, part: NDArray[np.intp]) -> Array:
        """Return one field of one joint in the rows ``part``, (K,) values; NaN where no
        stream has it."""
        source = self.sources[joint, field_name]
        if source is None:
            return np.full(len(part), np.nan)
        samples = source.column(field_name, joint)
        found = self.interpolations.get(id(source))
        if found is None:
            return samples[part]
        return found.values(samples, part)


def _merge(
    streams: Sequence[_Stream], leading: _Stream, joints: Sequence[str], clock: int
) -> _Merge:
    """Bring the messages of all streams to the stamps of the stream with the efforts.

    A row is kept where every channel has samples around its stamp. Two exceptions keep
    it: a joint that never moves has its value at any time, and velocities may be
    missing. ``clock`` is 0 for the header's stamps, 1 for the recording time.
    """
    sources = {
        (joint, field_name): _source_of(streams, leading, joint, field_name)
        for joint in joints
        for field_name in _FIELDS
    }
    with_effort = [sources[joint, "effort"] for joint in joints]
    base = max(filter(None, with_effort), key=lambda s: s is leading, default=leading)
    t = base.values[:, clock]
    within = half_period(t)
    merge = _Merge(sources, t, interpolations={}, is_kept=np.ones(len(t), bool))
    for (joint, field_name), source in sources.items():
        if source is None or source is base:
            continue
        found = merge.interpolations.setdefault(
            id(source), Interpolation(t, source.values[:, clock], within)
        )
        is_still = np.ptp(source.column(field_name, joint)) == 0.0
        merge.is_kept &= found.is_known | is_still | (field_name == "velocity")
    return merge


def _merged(
    path: Path,
    streams: Sequence[_Stream],
    leading: _Stream,
    names: Sequence[str],
    first: Array,
) -> Measurements:
    """Build the run: one row for each message with efforts that has all channels.

    The header's stamps are the clock where some are set, else the recording time.
    ``first`` holds both clocks of the bag's first message [ns].
    """
    is_stamped = bool(first[0]) or any(s.values[:, 0].any() for s in streams)
    clock = 0 if is_stamped else 1
    merge = _merge(streams, leading, names, clock)
    for field_name in ("position", "effort"):
        if all(merge.sources[name, field_name] is None for name in names):
            raise _weightless(path, streams, field_name)
    n_unmatched = int(np.sum(~merge.is_kept))
    _say_what_is_skipped(path, streams, leading, names, n_unmatched)
    if merge.remark:
        warnings.warn(f"{path}: {merge.remark}", Remark, stacklevel=2)
    dq = merge.block(names, "velocity")
    has_velocities = all(np.all(np.isfinite(part)) for _, part in iter_chunks(dq))
    second_of_day = float(first[clock] % (86_400 * 10**9)) / 1e9
    rows = np.flatnonzero(merge.is_kept)
    return Measurements(
        t=concatenate_chunks(
            merge.t[part] + second_of_day for _, part in iter_chunks(rows)
        ),
        q=merge.block(names, "position"),
        tau=merge.block(names, "effort"),
        dq=dq if has_velocities else None,
        names=(path.name,),
    )


def _source_of(
    streams: Sequence[_Stream], leading: _Stream, joint: str, what: str
) -> _Stream | None:
    """Choose the stream from which a joint's field is taken: the leading one, else one
    of its topic, else the longest; None where no stream has it."""
    candidates = [s for s in streams if what in s.fields and joint in s.names]
    if not candidates:
        return None

    def preference(stream: _Stream) -> tuple[bool, bool, int]:
        """Sort key; the largest wins."""
        has_same_topic = stream.topic == leading.topic
        return stream is leading, has_same_topic, len(stream.values)

    return max(candidates, key=preference)


def _say_what_is_skipped(
    path: Path,
    streams: Sequence[_Stream],
    leading: _Stream,
    names: Sequence[str],
    unmatched: int,
) -> None:
    """Warn of messages that were left out: those of the leading topic with empty
    fields, and the ``unmatched`` rows of the leading stream without a partner in the
    others."""
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


def _weightless(path: Path, streams: Sequence[_Stream], what: str) -> InputError:
    """Return the error of a bag in which no message has positions, or efforts, of every
    joint."""
    topics = ", ".join(sorted({s.topic for s in streams}))
    problem = f"no message of {topics} has {what} of every joint"
    return InputError(problem, "record position and effort of every joint", path)
