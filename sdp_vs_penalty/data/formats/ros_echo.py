"""What `ros2 topic echo` and `rostopic echo` print: one YAML document a message, with
"---" between two.

Read are JointState, the state of a trajectory controller, DynamicJointState, and other
messages whose fields hold a list a sample.
"""

import warnings
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import yaml

from sdp_vs_penalty.data.formats.jsonl import leaves, log_of_samples
from sdp_vs_penalty.data.formats.text_file import iter_rows
from sdp_vs_penalty.data.log import Log
from sdp_vs_penalty.errors import InputError, Remark

_REMEDY = "print the topic with `ros2 topic echo --csv`, or record a bag"
#: What stands between two messages.
_BETWEEN = "---"
#: How lines begin that the programs print beside the messages.
_REMARKS = ("WARNING:", "A message was lost", "\ttotal count", "#")
#: Words of YAML for numbers.
_NUMBERS = {".nan": "nan", ".inf": "inf", "-.inf": "-inf"}

#: The parser in C where PyYAML has been built with it.
_LOADER = getattr(yaml, "CBaseLoader", yaml.BaseLoader)
#: Maps and lists within each other, at most.
_DEEPEST = 50


def read_text(path: Path, _refused: InputError) -> Log:
    """Read the fields of printed messages; raise InputError for a text that is no such
    YAML."""
    numbers, samples = list[int](), list[dict[str, Any]]()
    for number, text, is_whole in _documents(path):
        if samples and not is_whole:
            said = f"{path}: the last message ends early and is left out"
            warnings.warn(said, Remark, stacklevel=2)
            continue
        try:
            content = _with_interfaces(_parse(text))
        except (yaml.YAMLError, ValueError, TypeError) as error:
            what = f"line {number} begins no message that `ros2 topic echo` prints"
            raise InputError(what, _REMEDY, path) from error
        samples.append(dict(leaves(content)))
        numbers.append(number)
    log = log_of_samples(path, samples, numbers, "line")
    columns = [name for name, x in log.columns.items() if x.kind != "text"]
    if all(name.startswith("header.") for name in columns):
        raise InputError("YAML text without the joints' states", _REMEDY, path)
    return log


def _documents(path: Path) -> Iterator[tuple[int, str, bool]]:
    """Iterate over the messages: the number of the first line, the text, and whether "---"
    follows.

    Whoever stops the program cuts the last message, maybe within a number: without the
    "---" behind it, nothing says that it is whole.
    """
    lines = list[str]()
    begin = 1
    for first, rows in iter_rows(path):
        for number, row in enumerate(rows, start=first):
            if row.rstrip() == _BETWEEN:
                if lines:
                    yield begin, "\n".join(lines), True
                lines = []
            elif row.strip() and not row.startswith(_REMARKS):
                begin = number if not lines else begin
                lines.append(row)
    if lines:
        yield begin, "\n".join(lines), False


def _parse(text: str) -> Any:
    """Parse a message: maps, lists, numbers and texts; raise ValueError for what no message
    has, anchors and deep nests. The parser's events need no recursion, which a hostile
    text could make endless."""
    nests: list[list[Any]] = [[]]
    for event in yaml.parse(text, _LOADER):
        if isinstance(event, yaml.AliasEvent) or len(nests) > _DEEPEST:
            raise ValueError(text)
        if isinstance(event, yaml.CollectionStartEvent):
            nests.append([])
        elif isinstance(event, yaml.CollectionEndEvent):
            items = nests.pop()
            is_map = isinstance(event, yaml.MappingEndEvent)
            pairs = zip(items[::2], items[1::2], strict=False)
            nests[-1].append(dict(pairs) if is_map else items)
        elif isinstance(event, yaml.ScalarEvent):
            nests[-1].append(_scalar(event.value))
    return nests[0][0]


def _scalar(text: str) -> float | str:
    """Return a number, or the text of another scalar."""
    try:
        return float(_NUMBERS.get(text, text))
    except ValueError:
        return text


def _with_interfaces(message: Any) -> dict[str, Any]:
    """Return a DynamicJointState message with a field for each joint and interface,
    "elbow/position"; other messages as they are.

    Raises ValueError where a joint has no interfaces, or no values of them.
    """
    if not isinstance(message, Mapping):
        raise ValueError(message)
    joints = message.get("joint_names")
    states = message.get("interface_values")
    if not isinstance(joints, list) or not isinstance(states, list):
        return dict(message)
    fields = dict[str, Any]()
    for joint, state in zip(joints, states, strict=True):
        if not isinstance(state, Mapping):
            raise ValueError(state)
        names, values = state.get("interface_names"), state.get("values")
        if not isinstance(names, list) or not isinstance(values, list):
            raise ValueError(state)
        for name, value in zip(names, values, strict=True):
            fields[f"{joint}/{name}"] = value
    return {"header": message.get("header", {}), **fields}
