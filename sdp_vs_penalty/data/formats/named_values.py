"""Lines that say name and value: ``t=0.01 q1=0.2 tau1=3``, ``t: 0.01, q: [0.1, 0.2]``, what
Python's logging prints of them, InfluxDB's line protocol, and a list of YAML, whose samples
have several lines.

What stands before the first name is a stamp where it reads as one, and so is a number in
brackets, or one behind the last value. A sample ends where its first name stands again.
"""

import re
from collections.abc import Sequence
from itertools import pairwise, takewhile
from pathlib import Path
from typing import Any

from sdp_vs_penalty.data.formats.text_file import iter_rows
from sdp_vs_penalty.data.log import Log
from sdp_vs_penalty.data.words.stamps import is_stamp
from sdp_vs_penalty.errors import InputError

_NUMBER = r"[-+]?(?:\d+\.?\d*(?:[eE][-+]?\d+)?|\.\d+|nan|inf)(?![\w.])"
_NUMBERS = re.compile(_NUMBER)
_WORD = r"[^\W\d][\w./\[\]-]*"
#: A name and its value: a number, perhaps with its unit, a list of numbers, or a word behind
#: an equals sign; and what may stand between two of them. Behind a colon a name may have
#: blanks where a comma or nothing stands before it, and a list may have no brackets.
_PAIR = re.compile(
    rf"(?<![^\W_])(?P<name>(?:(?:^|(?<=[,;|] )){_WORD}(?: {_WORD})+(?=:)|{_WORD}))[\"']?"
    rf"(?:\s*:\s*(?P<bare>{_NUMBER}(?:[ ,]\s*{_NUMBER})+)(?=\s*(?:$|[;|]|[,\s]\s*{_WORD}\s*:))"
    rf"|\s*[=:]\s*(?:array\()?(?P<value>{_NUMBER}|[\[(][^\])]*[\])])\)?"
    r"(?:\s?(?P<unit>[^\W\d_][^\W\d_/·*]*(?:[/·*][^\W\d_]+)?)(?=[\s,;]|$)(?!\s*[=:]))?"
    r"|=(?P<word>[^\W\d][\w./-]*))"
)
#: What may stand between two pairs, with the joint whose pairs follow: "A1: pos=0.1".
_BETWEEN = re.compile(rf"[\s,;|&{{}}\"']*(?:(?P<joint>{_WORD})[\"']?\s*:[\s{{]*)?")
_JOINT = re.compile(rf"(?P<joint>{_WORD})[\"']?\s*:[\s{{]*$")
#: The stamp with which a line of logging begins, and a number in brackets.
_STAMP = re.compile(r"\W*([\d:T./+-]+(?:[ T][\d:.,]+)?Z?)")
_IN_BRACKETS = re.compile(rf"[\[(]\s*({_NUMBER})\s*s?[\])]")
#: Name of the stamp that stands without one.
_CLOCK = "time"
#: Name of a number in brackets, which is a stamp or counts lines.
_INDEX = "index"


def are_named_values(lines: Sequence[str]) -> bool:
    """Return whether the last lines say names and values: the same names in each, or in
    turn, and at least two of numbers."""
    backwards = filter(None, map(str.strip, reversed(lines)))
    last = [*takewhile(bool, map(_fields_of, backwards))]
    names = [tuple(sorted(fields)) for fields in last]
    # How many lines a sample has; the first one may be cut off by what is read.
    n = next((k for k, x in enumerate(names) if k and x == names[0]), 0)
    is_in_turn = all(x == y for x, y in zip(names, names[n : 2 * n], strict=False))
    said = {x for of_line in names[:n] for x in of_line}
    return n > 0 and is_in_turn and len(said - {_CLOCK, _INDEX}) > 1


def read_text(path: Path, _refused: InputError) -> Log:
    """Read the named values of each sample; raise InputError for one with other names."""
    from sdp_vs_penalty.data.formats.jsonl import log_of_samples  # only of such a text

    numbers, samples = list[int](), list[dict[str, Any]]()
    for first, rows in iter_rows(path):
        for number, line in enumerate(rows, start=first):
            fields = _fields_of(line)
            if not fields:
                continue
            if not samples or next(iter(fields)) in samples[-1]:
                samples.append({})
                numbers.append(number)
            samples[-1] |= fields
    if len(samples) > 1:  # what stands once above the first sample is of none
        samples[0] = {x: y for x, y in samples[0].items() if x in samples[1]}
    for number, fields in zip(numbers, samples, strict=True):
        if {*fields} != {*samples[0]}:
            what = f"line {number} names other values than line {numbers[0]}"
            raise InputError(what, "correct it or delete the line", path)
    return log_of_samples(path, samples, numbers, "line")


def _fields_of(line: str) -> dict[str, Any]:
    """Return the values of one line by their names."""
    line = line.strip()
    pairs = [*_PAIR.finditer(line)]
    if not pairs:
        return {}
    begin, end = (
        line[: pairs[0].start()].strip(),
        line[pairs[-1].end() :].strip(" ,;|)}]\r"),
    )
    gaps = [_BETWEEN.fullmatch(line[a.end() : b.start()]) for a, b in pairwise(pairs)]
    is_stamped = _NUMBERS.fullmatch(end) is not None
    if not all(gaps) or (end and not is_stamped):
        return {}
    fields = dict[str, Any]()
    stamp, in_brackets = _STAMP.match(begin), _IN_BRACKETS.match(begin)
    if stamp and is_stamp(stamp[1]):
        fields[_CLOCK] = stamp[1]
    elif in_brackets:
        fields[_INDEX] = float(in_brackets[1])
    elif is_stamped:
        fields[_CLOCK] = float(end)
    has_joints = any(gap and gap["joint"] for gap in gaps)
    joint = ""
    for pair, before in zip(pairs, [_JOINT.search(begin), *gaps], strict=True):
        if has_joints and before and before["joint"]:
            joint = f"{before['joint']}."
        name = joint + pair["name"]
        name = f"{name} [{pair['unit']}]" if pair["unit"] else name
        value = pair["value"] or pair["word"]
        if pair["bare"] or (pair["value"] and value[0] in "[("):
            numbers = _NUMBERS.findall(pair["bare"] or value)
            fields[name] = [float(x) for x in numbers]
        else:
            fields[name] = float(value) if pair["value"] else value
    return fields
