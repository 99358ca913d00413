"""Which columns of another program's log are t, q, dq, tau ...: one table of words
(words.toml).

A name is read as words and at most one number: ``actual_q_0``,
``joint_states.position[3]``, ``qd5``, ``/joint_states/elbow_joint/effort``. What says
nothing about a quantity (actual, joint, field) is left out; what remains has to be one
of a quantity's words. Where several kinds of column could be one quantity, the word
that comes first is taken: a torque before a current.
"""

import fnmatch
import re
import tomllib
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeAlias

import numpy as np

from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.errors import InputError, Remark

_TABLE = tomllib.loads(Path(__file__).with_name("words.toml").read_text())
#: The words of each quantity, the best first.
WORDS: dict[str, tuple[str, ...]] = {
    name: tuple(words) for name, words in _TABLE["quantities"].items()
}
#: Words that say nothing about a quantity; those of columns that are something else
#: than was measured.
_FILLERS, _OTHERS = set(_TABLE["fillers"]), set(_TABLE["others"])
#: Units that a name ends with, or that are asked for, by what a value has to be
#: multiplied by.
UNITS: dict[str, float] = {
    "ns": 1e-9,
    "us": 1e-6,
    "ms": 1e-3,
    "s": 1.0,
    "deg": np.pi / 180.0,
    "degrees": np.pi / 180.0,
    "degree": np.pi / 180.0,
    "rad": 1.0,
    "rpm": np.pi / 30.0,
    "nm": 1.0,
    "mnm": 1e-3,
    "ncm": 1e-2,
    "kgfm": 9.80665,
    "lbfft": 1.3558179,
    "lbfin": 0.1129848,
    "a": 1.0,
    "ma": 1e-3,
    "mm": 1e-3,
}


#: Our names (t, q1 ..., or q for a block) to the file's; factors by our names, where
#: they are not 1.
Recognised: TypeAlias = tuple[dict[str, str], dict[str, float]]


def taken(
    path: Path, names: Sequence[str], joints: Sequence[str] | None
) -> Recognised | None:
    """The columns that a file of foreign names is read by, said in one line with the
    command that reads it alike; None where our own names are there, or nothing is
    recognised."""
    if (
        "t" in names
        and {"q", "q1"} & set(names)
        and {"tau", "tau1", "qcmd", "qcmd1"} & set(names)
    ):
        return None
    found = recognised(names, joints)
    if found is not None:
        pairs = ",".join(f"{a}={b}" for a, b in found[0].items())
        factors = ",".join(f"{a}={x:.6g}" for a, x in found[1].items())
        scale = f" --scale '{factors}'" if factors else ""
        said = (
            f"{path}: columns recognised; the same by `convert {path} --rename"
            f" '{pairs}'{scale}`"
        )
        warnings.warn(said, Remark, stacklevel=2)
    return found


@dataclass(frozen=True)
class _Read:
    """One name as read: its quantity, how good its word is, its number, other words,
    its unit."""

    quantity: str
    rank: int
    number: int | None
    rest: tuple[str, ...]
    factor: float


def _read(name: str) -> _Read | None:
    text = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", name.strip()).lower().replace("%", "")
    words = re.findall(r"[a-z]+|[0-9]+", text)
    numbers = [int(w) for w in words if w.isdigit()]
    letters = [w for w in words if not w.isdigit()]
    if len(numbers) > 1 or _OTHERS & set(letters):
        return None
    factor = 1.0
    if len(letters) > 1 and letters[-1] in UNITS and letters[-1] != "a":
        factor = UNITS[letters.pop()]
    for quantity, known in WORDS.items():
        found = [w for w in letters if w in known]
        if len(found) == 1:
            rest = tuple(w for w in letters if w != found[0] and w not in _FILLERS)
            number = numbers[0] if numbers else None
            return _Read(quantity, known.index(found[0]), number, rest, factor)
    return None


def recognised(
    names: Sequence[str], joints: Sequence[str] | None = None
) -> Recognised | None:
    """What the columns of these names are; None where t, positions or torques are not
    among them.

    joints : names of the robot's joints in order, for columns that are called by
    joints.
    """
    read = {name: r for name in names if (r := _read(name)) is not None}
    stamps = [
        (r.rank, len(r.rest), n)
        for n, r in read.items()
        if (r.quantity, r.number) == ("t", None)
    ]
    if not stamps:
        return None
    rename = {"t": min(stamps)[2]}
    count = len(_columns("q", read, joints))
    for quantity in [q for q in WORDS if q != "t"]:
        columns = _columns(quantity, read, joints)
        if len(columns) == count:
            block = count == 1 and read[columns[0]].number is None
            rename |= {
                f"{quantity}{'' if block else k}": n
                for k, n in enumerate(columns, start=1)
            }
    scale = {
        ours: read[n].factor for ours, n in rename.items() if read[n].factor != 1.0
    }
    torque = any(re.fullmatch("(tau|qcmd)[0-9]*", ours) for ours in rename)
    return (rename, scale) if count and torque else None


def _columns(
    quantity: str, read: Mapping[str, _Read], joints: Sequence[str] | None
) -> list[str]:
    """The columns of one quantity in the order of the joints; none where that is not
    clear."""
    own = {name: r for name, r in read.items() if r.quantity == quantity}
    kinds: dict[tuple[object, ...], list[str]] = {}
    for name, r in own.items():
        by_joint = r.number is None and r.rest
        kinds.setdefault(
            (r.rank, () if by_joint else r.rest, r.number is None), []
        ).append(name)
    if len({r.rank for r in own.values()}) == 1 and any(
        r.number is None for r in own.values()
    ):
        called = {(*r.rest, str(r.number)): name for name, r in own.items()}
        if len(called) == len(own) > 1:  # joints have names, some of them with a number
            return _by_joint(list(own), own, joints)
    for key in sorted(kinds, key=lambda k: (k[0], k[2], len(k[1]), k[1])):  # type: ignore[arg-type]
        found = kinds[key]
        numbers = [own[name].number for name in found]
        if None not in numbers:
            order = sorted(range(len(found)), key=lambda i: numbers[i] or 0)
            first = min(n for n in numbers if n is not None)
            if first <= 1 and sorted(numbers) == list(range(first, first + len(found))):  # type: ignore[type-var]
                return [found[i] for i in order]
        elif len(found) == 1 or len({own[name].rest for name in found}) == len(found):
            return _by_joint(found, own, joints)
    return []


def _by_joint(
    found: list[str], own: Mapping[str, _Read], joints: Sequence[str] | None
) -> list[str]:
    """Columns called by joints in the robot's order, where all its joints are among
    them."""
    if joints is None:
        return found
    tails = []
    for joint in joints:
        words, numbers = (
            re.findall(kind, joint.lower()) for kind in ("[a-z]+", "[0-9]+")
        )
        tails.append(
            (
                *(w for w in words if w not in _FILLERS),
                str(next(map(int, numbers), None)),
            )
        )
    by_tail = {(*own[name].rest, str(own[name].number)): name for name in found}
    return [by_tail[t] for t in tails] if all(t in by_tail for t in tails) else found


def expanded(rename: Mapping[str, str], names: Sequence[str]) -> dict[str, str]:
    """``q*=actual_q_*`` as one pair for each joint; InputError where no column has such
    a name."""
    out: dict[str, str] = {}
    for ours, theirs in rename.items():
        if "*" not in theirs:
            out[ours] = theirs
            continue
        pattern = re.compile(re.escape(theirs).replace(r"\*", "([0-9]+)"))
        found = sorted((int(m[1]), n) for n in names if (m := pattern.fullmatch(n)))
        if not found:
            near = (
                ", ".join(fnmatch.filter(names, theirs)[:4]) or "none that is numbered"
            )
            remedy = "give --rename a pattern of the file's names"
            raise InputError(f"no column {theirs!r} ({near})", remedy)
        out |= {f"{ours.rstrip('*')}{k}": n for k, (_, n) in enumerate(found, start=1)}
    return out


def scaled(run: Measurements, factors: Mapping[str, str]) -> Measurements:
    """The run in other units: ``--scale q=deg,tau=10:10.7:8.5``, by our names q, q1
    ..., t a unit, a number, or one number a joint.

    Raises InputError for words that are none of them, and columns that are not there.
    """
    groups = {"t": run.t[:, None], **run.groups}
    for ours, word in factors.items():
        by = np.array(
            [UNITS.get(w.lower()) or _number(ours, w) for w in word.split(":")]
        )
        name = ours.rstrip("0123456789")
        count = groups[name].shape[1] if name in groups else 0
        joint = int(ours[len(name) :] or 1)
        if not 1 <= joint <= count:
            what = f"--scale {ours}: the run has no such column"
            raise InputError(what, "name t, q, dq or tau")
        if ours != name:
            by = np.where(np.arange(count) == joint - 1, by[0], 1.0)
        elif len(by) not in (1, count):
            what = f"--scale {ours}={word}: {len(by)} factors"
            raise InputError(what, f"give one, or {count}")
        groups[name] = groups[name] * by
    return Measurements.of(groups.pop("t")[:, 0], groups, run.names)


def _number(ours: str, word: str) -> float:
    try:
        value = float(word)
    except ValueError:
        value = 0.0
    if not value or not np.isfinite(value):
        known = ", ".join(sorted(UNITS))
        raise InputError(
            f"--scale {ours}={word}", f"give a number other than 0, or a unit: {known}"
        )
    return value
