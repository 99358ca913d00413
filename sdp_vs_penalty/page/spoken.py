"""What the page says for sentences of the command line, and for names."""

import re
from collections.abc import Container, Iterable, Sequence
from itertools import chain, count
from pathlib import PurePath, PureWindowsPath
from typing import Any

from sdp_vs_penalty import formatting
from sdp_vs_penalty.results.remedy import SURE

#: Words of the command line, and what the page has for them.
_STAGES = {
    "run `compare` on": "test it on",
    "`check`": "Check",
    "`diagnose`": "Diagnose",
    "`identify`": "Identify",
    "`ranges` says": 'under "Between which values?" stands',
    "N*m": "N m",
    " -> ": " → ",
    "q in deg": "positions in degrees",
    "on training motion": "on motion that it was identified from",
}
#: A clause that names a command with options, or an option of one.
_CLAUSE = re.compile(
    r"\s*\(--[^)]*\)|^[^;:,(.`]*\s--[a-z]\S*( \S+)?, or |"
    r"(?:; if so)?(?:[;:,(]| or| and)?[^;:,(`]*`[^`]*(?:--|sdp-vs-penalty|convert |"
    r"check-urdf)[^`]*`[^;:,.`]*"
    r"|(?:[;:,(]| or| and)[^;:,(.]*\s--[a-z](?:\.\.\.|[^;:,.])*"
)


def spoken(text: str) -> str:
    """Rephrase a sentence of the command line for the page, which has stages, fields and
    buttons for commands; a clause that only names a command goes.

    >>> spoken("Torque beyond the noise; `diagnose` names causes.")
    'Torque beyond the noise; Diagnose names causes.'
    >>> spoken("run.csv: no column t: name the clock with `convert --rename t=NAME`.")
    'run.csv: no column t.'
    >>> spoken("tau: taken as SI; if so, convert it by `convert run.csv --scale tau=10`")
    'tau: taken as SI.'
    >>> spoken("A test run (--test) judges both; run `compare` on it.")
    'A test run judges both; test it on it.'
    >>> spoken("identify with --motors q1,q1+q2, or replace q2 by q2 - q1")
    'replace q2 by q2 - q1.'
    >>> spoken("tau is a current in A: --scale tau=... makes torques of it.")
    'tau is a current in A.'
    """
    text = _CLAUSE.sub("", text)
    for word, stage in _STAGES.items():
        text = text.replace(word, stage)
    text = text.replace("`", "").strip()
    return f"{text}." if text and text[-1] not in ".!?)" else text


def graded(text: str, grade: str) -> str:
    """Return what check or diagnosis says as a sentence, with how sure that is unless it
    is certain or confident."""
    text = spoken(text)
    return formatting.sentence(text if grade in SURE else f"{grade}: {text}")


def label_of(words: str) -> str:
    """Return the words of a change as the label of its button."""
    columns = r"rename the columns of (\w+(?: and \w+)?)"
    words = re.sub(columns, r"put \1 into the joints' order", spoken(words))
    several = r"\b(q|tau)\d+(?:, \1\d+)+(?: and \1\d+)?"
    words = re.sub(several, _on_joints, words)
    words = re.sub(r"\btau\b", "the torque", words)
    words = re.sub(r"\bq\b", "the positions", words)
    words = re.sub(r"\btau(\d+)\b", r"joint \1's torque", words)
    words = re.sub(r"\bq(\d+)\b", r"joint \1's position", words)
    words = re.sub(r"\(and dq\)", "and velocities", words)
    words = re.sub(r"\bdq\d+\b", "velocity", words)
    return formatting.sentence(words).rstrip(".")


def repairs_in_words(repairs: Iterable[Sequence[Any]]) -> str:
    """Return which changes of runs and robot were made, each with its words first, without
    what is advised beside them."""
    words = [re.sub(r" \(and [^)]*\)", "", words) for words, *_ in repairs]
    labels = map(label_of, words)
    return "; ".join(f"{label[:1].lower()}{label[1:]}" for label in labels)


def _on_joints(columns: re.Match[str]) -> str:
    """Name several columns by the joints of one channel: "q of joints 1 to 7"."""
    numbers = [int(number) for number in re.findall(r"\d+", columns[0])]
    return f"{columns[1]} of {formatting.joints(numbers)}"


#: What jobs say of their steps, and what the page has for it.
_STEPS = (
    (r"^\d+: .*", "looking at what is left"),  # what leads may not stay
    (r"^trying effects: (\d+) of (\d+)", r"\1 of \2 effects tried"),
    (r"^(\d+) of (\d+) done$", r"\1 of \2 parts done"),
    (r"^estimating by .*", "estimating the parameters"),
    (r"^compressing the measurements", "reading the motion"),
    (r"shape constants", "how friction turns round"),
    (r"^held-out errors", "testing what was found on data left out"),
    (r"^the current model, pass (\d+)", r"fitting again, pass \1"),
)


def progress_in_words(text: str) -> str:
    """Return where a job stands, without the words of its method.

    >>> progress_in_words("2: sigmoid friction on joint 3 (v0 0.013, law algebraic)")
    'looking at what is left'
    """
    for said, words in _STEPS:
        text = re.sub(said, words, text)
    return text


def with_whole_amounts(text: str) -> str:
    """Return a text in which no line ends within a number and its unit, or before an
    arrow."""
    text = re.sub(
        r"(?<=\d) (?=%|N m|N\b|kg|rad|s\b)|(?<=N) (?=m\b)| (?=→)", "\xa0", text
    )
    return text.replace("→ ", "→\xa0")


def shown_name(name_given: str) -> str:
    r"""Return the name to show for an uploaded file; it never contains a path.

    This is the last component of the browser's name, without unprintable characters and
    at most 80 characters long.

    >>> shown_name("../../etc/run 1.csv"), shown_name("C:\\temp\\run.csv"), shown_name("..")
    ('run 1.csv', 'run.csv', 'file')
    """
    # A Windows path takes /, \ and drives for separators, whatever the system.
    last = PureWindowsPath(name_given.replace("\0", "")).name
    name = "".join(c for c in last if c.isprintable()).strip()
    if name in ("", ".", ".."):
        return "file"
    return name if len(name) <= 80 else f"{name[:40]}...{name[-36:]}"


def name_beside(name: str, taken: Container[str]) -> str:
    """Return the name of a file where others are taken: the second of a name has a number.

    >>> name_beside("run.csv", ()), name_beside("run.csv", ("run.csv", "run (2).csv"))
    ('run.csv', 'run (3).csv')
    """
    suffix = PurePath(name).suffix
    stem = re.sub(r" \(\d+\)$", "", name.removesuffix(suffix))
    numbered = (f"{stem} ({k}){suffix}" for k in count(2))
    return next(x for x in chain([name], numbered) if x not in taken)


def name_in_title(title: str) -> str:
    """Return the name that a robot's title begins with.

    >>> name_in_title("Universal Robots UR10e, 6 joints, torque from motor currents")
    'Universal Robots UR10e'
    """
    return re.split(r", | \(", title)[0]
