"""Columns of which the file itself says quantity and joint, as messages of ROS do.

Each joint's positions, velocities and efforts may stand in messages of their own, with
stamps of their own, on several topics.
"""

import warnings
from collections.abc import Mapping, Sequence

from sdp_vs_penalty import formatting
from sdp_vs_penalty.data.hypotheses.channels import Recognition
from sdp_vs_penalty.data.log import Column, Log
from sdp_vs_penalty.data.words.joints import match_joints
from sdp_vs_penalty.errors import InputError, Remark

_FIELDS = {"q": "position", "dq": "velocity", "tau": "effort"}


def by_facts(log: Log, joints: Sequence[str] | None, topic: str | None) -> Recognition:
    """Choose the columns of the robot's joints.

    The joints are looked for in the file, perhaps with other words around their names
    ("panda_joint1"). More than half have to be there, or two by their very names; the
    others are left to be held. Without a robot, all joints of the largest message are
    taken in its order. The topic with most positions and efforts of the joints leads;
    what it lacks comes from the others.

    Raises InputError for joints or fields that are missing, and where two topics each
    have all channels.
    """
    topics = sorted({x.source for x in log.columns.values()})
    if not topics or topic not in (None, *topics):
        raise _which_topic(log, topic, topics)
    placed = _of("q", log.columns, topic)
    if not placed:
        raise _lacking(log, topics, "q")
    sizes = dict[str, list[str]]()
    for name in placed:
        column = log.columns[name]
        sizes.setdefault(column.clock, []).extend(column.joints)
    robot = list(joints or max(sizes.values(), key=len))
    in_file = list(dict.fromkeys(x for named in sizes.values() for x in named))
    if not joints:
        left = [x for x in in_file if x not in robot]
        more = f"; not taken: {', '.join(left)}" if left else ""
        taken = f"joints {', '.join(robot)}, in the messages' order{more}"
        remedy = "name the robot by --problem to take its own"
        warnings.warn(f"{log.path}: {taken}: {remedy}", Remark, stacklevel=2)
    found = match_joints(robot, in_file)
    if len({*robot} & {*in_file}) < 2 and 2 * len(found) <= len(robot):
        there, expected = ", ".join(sorted(in_file)), ", ".join(robot)
        what = f"no message has all joints {expected} (there are: {there})"
        raise InputError(what, "name the joints as the bag does", log.path)
    chosen = {*found.values()}

    def channels(of: str, key: str, *quantities: str) -> set[tuple[str, str]]:
        """Return the (joint, quantity) pairs whose columns have this source or clock."""
        return {
            (x.joints[0], x.quantity)
            for x in log.columns.values()
            if getattr(x, key) == of
            and x.joints[0] in chosen
            and x.quantity in quantities
        }

    n_of_topic = {x: len(channels(x, "source", "q", "tau")) for x in topics}
    largest = max(n_of_topic.values())
    best = [topic] if topic else [x for x in topics if n_of_topic[x] == largest]
    if len(best) > 1 and largest == 2 * len(chosen):
        raise _which_topic(log, None, topics)

    def preference(name: str) -> tuple[bool, int, bool, int]:
        """Return the sort key of a column; the largest wins."""
        clock = log.columns[name].clock
        return (
            log.columns[name].source in best,
            len(channels(clock, "clock", "q")),
            bool(channels(clock, "clock", "tau")),
            len(log.clocks[clock]),
        )

    rename = dict[str, str]()
    for quantity in _FIELDS:
        names = sorted(_of(quantity, log.columns)[::-1], key=preference)
        of_joint = {log.columns[x].joints[0]: x for x in names}
        columns = [of_joint.get(joint, "") for joint in found.values()]
        if all(columns):
            rename |= {f"{quantity}{k}": x for k, x in enumerate(columns, 1)}
        elif quantity != "dq":
            raise _lacking(log, topics, quantity)
    return Recognition(rename, logger="", joints=tuple(found) if joints else ())


def _of(
    quantity: str, columns: Mapping[str, Column], topic: str | None = None
) -> list[str]:
    """List the columns of a quantity, of one topic or of all."""
    return [
        name
        for name, x in columns.items()
        if x.quantity == quantity and topic in (None, x.source)
    ]


def _which_topic(log: Log, topic: str | None, topics: Sequence[str]) -> InputError:
    """Return the error of a topic that is missing, or of several topics that each hold
    all joints."""
    subject = f"topic {topic!r}" if topic else "one topic"
    what = f"{subject} with sensor_msgs/msg/JointState is needed"
    if not topics:
        return InputError(
            what, "record the joints' states; this bag has none", log.path
        )
    command = formatting.convert_command(log.path, "--topic", topics[0])
    remedy = f"choose one of {', '.join(topics)}"
    return InputError(what, remedy, log.path, f"`{command}`")


def _lacking(log: Log, topics: Sequence[str], quantity: str) -> InputError:
    """Return the error of a file in which no message has a quantity of every joint."""
    what = f"no message of {', '.join(topics)} has {_FIELDS[quantity]} of every joint"
    return InputError(what, "record position and effort of every joint", log.path)
