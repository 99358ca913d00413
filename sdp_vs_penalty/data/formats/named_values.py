"""Lines that say name and value: ``t=0.01 q1=0.2 tau1=3``, ``t: 0.01, q: [0.1, 0.2]``, what
Python's logging prints of them, and InfluxDB's line protocol.

What stands before the first name is a stamp where it reads as one, and so is a number
behind the last value.
"""

import re
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

from sdp_vs_penalty.data.formats.text_file import iter_rows
from sdp_vs_penalty.data.log import Log
from sdp_vs_penalty.data.words.stamps import is_stamp
from sdp_vs_penalty.errors import InputError

_NUMBER = r"[-+]?(?:\d+\.?\d*(?:[eE][-+]?\d+)?|\.\d+|nan|inf)(?![\w.])"
_NUMBERS = re.compile(_NUMBER)
#: A name and its value: a number, perhaps with its unit, a list of numbers, or a word behind
#: an equals sign; and what may stand between two of them.
_PAIR = re.compile(
    r"(?<![^\W_])(?P<name>[^\W\d][\w./\[\]-]*)\"?"
    rf"(?:\s*[=:]\s*(?:array\()?(?P<value>{_NUMBER}|[\[(][^\])]*[\])])\)?"
    r"(?:\s?(?P<unit>[^\W\d_][^\W\d_/·*]*(?:[/·*][^\W\d_]+)?)(?=[\s,;]|$)(?!\s*[=:]))?"
    r"|=(?P<word>[^\W\d][\w./-]*))"
)
_BETWEEN = re.compile(r"[\s,;|&{}\"']*")
#: The stamp with which a line of logging begins.
_STAMP = re.compile(r"\W*([\d:T./+-]+(?:[ T][\d:.,]+)?Z?)")
#: Name of the stamp that stands without one.
_CLOCK = "time"


def are_named_values(lines: Sequence[str]) -> bool:
    """Return whether lines say names and values: the same names in each, or in turn, and at
    least two of numbers."""
    fields = [_fields_of(line) for line in lines]
    return len(lines) > 1 and all(
        len([x for x in a if x != _CLOCK]) > 1 and {*a} == {*b}
        for a, b in pairwise(fields)
    )


def read(path: Path) -> Log:
    """Read the named values of each line; raise InputError for a line with other names."""
    from sdp_vs_penalty.data.formats.jsonl import log_of_samples  # only of such a text

    numbers, samples = list[int](), list[dict[str, Any]]()
    for first, rows in iter_rows(path):
        for number, line in enumerate(rows, start=first):
            fields = _fields_of(line)
            if not fields or (not samples and len(fields) < 2):
                continue
            if samples and {*fields} != {*samples[0]}:
                what = f"line {number} names other values than line {numbers[0]}"
                raise InputError(what, "correct it or delete the line", path)
            samples.append(fields)
            numbers.append(number)
    return log_of_samples(path, samples, numbers, "line")


def _fields_of(line: str) -> dict[str, Any]:
    """Return the values of one line by their names."""
    pairs = [*_PAIR.finditer(line)]
    if not pairs:
        return {}
    begin, end = (
        line[: pairs[0].start()].strip(),
        line[pairs[-1].end() :].strip(" ,;|)}]\r"),
    )
    gaps = (line[a.end() : b.start()] for a, b in pairwise(pairs))
    is_stamped = _NUMBERS.fullmatch(end) is not None
    if not all(map(_BETWEEN.fullmatch, gaps)) or (end and not is_stamped):
        return {}
    fields = dict[str, Any]()
    stamp = _STAMP.match(begin)
    if stamp and is_stamp(stamp[1]):
        fields[_CLOCK] = stamp[1]
    elif is_stamped:
        fields[_CLOCK] = float(end)
    for pair in pairs:
        name = f"{pair['name']} [{pair['unit']}]" if pair["unit"] else pair["name"]
        value = pair["value"] or pair["word"]
        if pair["value"] and value[0] in "[(":
            fields[name] = [float(x) for x in _NUMBERS.findall(value)]
        else:
            fields[name] = float(value) if pair["value"] else value
    return fields
