"""Golden cases: a file each in tests/golden, with inputs and the values that they give.

    [values]
    "loss" = { value = 6.74608857, unit = "1", relative = 1e-6 }
    "gap" = { unit = "1", at_most = 1e-8 }
    "found" = { value = ["joint_spring:2"] }

A value is a number, a list of numbers, or words. A number carries a unit, and is allowed
to differ by ``relative`` times the largest number of its list, or by ``absolute``;
``at_most`` bounds it instead. Sentences are never recorded.

Record values again, where a change is meant (each value is printed, old and new):

    .venv/bin/python tests/helpers/golden.py [NAME ...]
"""

import re
import sys
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

FOLDER = Path(__file__).parents[1] / "golden"
#: Digits of a recorded number: what a reader compares, far finer than any tolerance.
DIGITS = 9


@dataclass(frozen=True)
class GoldenCase:
    """One file: what it is about, the function that computes it, its inputs and values,
    and pytest's markers."""

    path: Path
    about: str
    compute: str
    inputs: Mapping[str, Any]
    values: Mapping[str, Mapping[str, Any]]
    markers: Sequence[str] = ()

    @classmethod
    def read(cls, path):
        return cls(path, **tomllib.loads(path.read_text()))


@dataclass(frozen=True)
class Difference:
    """A value that is not what it was."""

    name: str
    unit: str
    expected: Any
    got: Any
    tolerance: str

    def __str__(self):
        return (
            f"{self.name} [{self.unit}]: expected {text(self.expected)}, got"
            f" {text(self.got)} (tolerance {self.tolerance})"
        )


def all_cases():
    """Every file of tests/golden."""
    return [GoldenCase.read(path) for path in sorted(FOLDER.glob("*.toml"))]


def text(value):
    """A value as it is written in a file."""
    if isinstance(value, str):
        return f'"{value}"'
    if isinstance(value, bool | int | np.integer):
        return str(value)
    if isinstance(value, float | np.floating):
        return f"{value:.{DIGITS}g}" if value % 1.0 else f"{value:.1f}"
    return f"[{', '.join(text(x) for x in value)}]"


def differences(case, quantities):
    """Where computed quantities are not what the case says."""
    found = []
    for name, expected in case.values.items():
        value, unit = quantities.get(name, ("missing", ""))
        if unit != expected.get("unit", ""):
            reason = f"the unit is {expected.get('unit', '')!r}"
            found.append(Difference(name, unit, expected.get("value"), value, reason))
        elif not agrees(expected, value):
            limit = expected.get("value", expected.get("at_most"))
            found.append(Difference(name, unit, limit, value, tolerance(expected)))
    return found


def agrees(expected, value):
    """Whether a value is within what is allowed of it; words have to be the same."""
    if "at_most" in expected:
        return bool(np.all(np.asarray(value, float) <= expected["at_most"]))
    recorded = np.asarray(expected["value"])
    computed = np.asarray(value)
    if recorded.shape != computed.shape:
        return False
    if "unit" not in expected:
        return bool(np.all(recorded == computed))
    largest = np.max(np.abs(recorded), initial=0.0)
    allowed = expected.get("absolute", 0.0) + expected.get("relative", 0.0) * largest
    return bool(np.all(np.abs(computed - recorded) <= allowed))


def tolerance(expected):
    """The tolerance in words."""
    if "at_most" in expected:
        return "at most"
    if "relative" in expected:
        return f"relative {expected['relative']:g}"
    return f"{expected.get('absolute', 0.0):g}"


def report(case, found):
    """What a failing test shows, a line a value."""
    lines = [f"{case.path.name}: {case.about}"]
    lines += [f"  {difference}" for difference in found]
    return "\n".join(lines)


def record(case, quantities):
    """Write a case's values anew; returns what changed, a line a value."""
    lines = case.path.read_text().splitlines()
    changed = []
    for number, line in enumerate(lines):
        entry = re.match(r'"(.*?)" = \{ value = (.*?)(, unit = .*|) \}$', line)
        if entry is None:
            continue
        name, old, rest = entry.groups()
        new = text(quantities[name][0])
        if new != old:
            changed.append(f"{name}: {old} -> {new}")
            lines[number] = f'"{name}" = {{ value = {new}{rest} }}'
    case.path.write_text("\n".join(lines) + "\n")
    return changed


def main(names):
    """Record the cases of these names, or all."""
    sys.path.append(str(FOLDER.parents[1] / "results"))
    from golden_cases import CASES

    for case in all_cases():
        if names and case.path.stem not in names:
            continue
        print(case.path.name)
        for line in record(case, CASES[case.compute](case.inputs)):
            print(f"  {line}")


if __name__ == "__main__":
    main(sys.argv[1:])
