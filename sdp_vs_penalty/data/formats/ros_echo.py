"""What `ros2 topic echo` and `rostopic echo` print: one YAML document a message, with
"---" between two.

Read are JointState, the state of a trajectory controller, DynamicJointState, and other
messages whose fields hold a list a sample. Of YAML only the part is known that these
programs write: maps and lists by indentation, numbers, texts, and lists in brackets.
"""

import re
import warnings
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from sdp_vs_penalty.data.formats.jsonl import leaves, log_of_samples
from sdp_vs_penalty.data.formats.text_file import iter_rows
from sdp_vs_penalty.data.log import Log
from sdp_vs_penalty.errors import InputError, Remark

_REMEDY = "print the topic with `ros2 topic echo --csv`, or record a bag"
#: What stands between two messages.
_BETWEEN = "---"
#: How lines begin that the programs print beside the messages.
_REMARKS = ("WARNING:", "A message was lost", "\ttotal count", "#")
#: A key, and what stands behind it in its line.
_ENTRY = re.compile(r"(?P<key>[A-Za-z_]\w*):(?: +(?P<value>.*))?")
#: Words of YAML for numbers.
_NUMBERS = {".nan": "nan", ".inf": "inf", "-.inf": "-inf"}

#: A line's indentation, and its text without it.
_Line = tuple[int, str]


def read(path: Path) -> Log:
    """Read the fields of printed messages; raise InputError for a text that is no such
    YAML."""
    numbers, samples = list[int](), list[dict[str, Any]]()
    for number, lines, is_whole in _documents(path):
        if samples and not is_whole:
            said = f"{path}: the last message ends early and is left out"
            warnings.warn(said, Remark, stacklevel=2)
            continue
        try:
            content = _with_interfaces(_map(lines, 0, lines[0][0])[0])
        except (ValueError, IndexError, RecursionError) as error:
            what = f"line {number} begins no message that `ros2 topic echo` prints"
            raise InputError(what, _REMEDY, path) from error
        samples.append(dict(leaves(content)))
        numbers.append(number)
    log = log_of_samples(path, samples, numbers, "line")
    columns = [name for name, x in log.columns.items() if x.kind != "text"]
    if all(name.startswith("header.") for name in columns):
        raise InputError("YAML text without the joints' states", _REMEDY, path)
    return log


def _documents(path: Path) -> Iterator[tuple[int, list[_Line], bool]]:
    """Iterate over the messages: the number of the first line, the lines that are not
    empty, and whether "---" follows.

    Whoever stops the program cuts the last message, maybe within a number: without the
    "---" behind it, nothing says that it is whole.
    """
    lines = list[_Line]()
    begin = 1
    for first, rows in iter_rows(path):
        for number, row in enumerate(rows, start=first):
            if row.rstrip() == _BETWEEN:
                if lines:
                    yield begin, lines, True
                lines = []
            elif row.strip() and not row.startswith(_REMARKS):
                begin = number if not lines else begin
                text = row.strip()
                lines.append((len(row) - len(row.lstrip()), text))
    if lines:
        yield begin, lines, False


def _map(
    lines: Sequence[_Line], k: int, indentation: int
) -> tuple[dict[str, Any], int]:
    """Parse the map that begins in line k; return it, and the line behind it.

    Raises ValueError for a line that is no entry of a map.
    """
    content = dict[str, Any]()
    while k < len(lines) and lines[k][0] == indentation and not _is_item(lines[k][1]):
        match = _ENTRY.fullmatch(lines[k][1])
        if match is None:
            raise ValueError(lines[k][1])
        k += 1
        if match["value"]:
            content[match["key"]] = _scalar(match["value"])
        elif k < len(lines) and lines[k][0] >= indentation and _is_item(lines[k][1]):
            content[match["key"]], k = _list(lines, k, lines[k][0])
        elif k < len(lines) and lines[k][0] > indentation:
            content[match["key"]], k = _map(lines, k, lines[k][0])
    if k < len(lines) and lines[k][0] > indentation:
        raise ValueError(lines[k][1])
    return content, k


def _list(lines: Sequence[_Line], k: int, indentation: int) -> tuple[list[Any], int]:
    """Parse the list that begins in line k; return it, and the line behind it. An item
    can be a map, whose first entry stands behind the dash."""
    items = list[Any]()
    while k < len(lines) and lines[k][0] == indentation and _is_item(lines[k][1]):
        text = lines[k][1][1:].strip()
        if _ENTRY.fullmatch(text) is None:
            items.append(_scalar(text))
            k += 1
            continue
        n_before = len(lines[k][1]) - len(text)
        inner = [(indentation + n_before, text), *lines[k + 1 :]]
        item, n_read = _map(inner, 0, indentation + n_before)
        items.append(item)
        k += n_read
    return items, k


def _is_item(text: str) -> bool:
    """Return whether a line begins an item of a list: "- 0.5", not the number -0.5."""
    return text == "-" or text.startswith("- ")


def _scalar(text: str) -> Any:
    """Parse a number, a text, or a list in brackets."""
    if text.startswith("[") and text.endswith("]"):
        cells = [cell.strip() for cell in text[1:-1].split(",")]
        return [_scalar(cell) for cell in cells if cell]
    try:
        return float(_NUMBERS.get(text, text))
    except ValueError:
        return text.strip("'\"")


def _with_interfaces(message: Mapping[str, Any]) -> dict[str, Any]:
    """Return a DynamicJointState message with a field for each joint and interface,
    "elbow/position"; other messages as they are.

    Raises ValueError where a joint has no interfaces, or no values of them.
    """
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
