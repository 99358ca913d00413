"""Snapshots of figures and sentences, for the nightly run, and what is refused.

``SDP_VS_PENALTY_FIGURES=write pytest -n 0 -m nightly`` writes tests/data/figures/*.json
anew. tests/data/refusals.json holds of each kind of refusal the input, the file that the
sentence is about, and words that it says of what is wrong and of the remedy.
"""

import json
import os
import re
import zlib
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sdp_vs_penalty import InputError

HOME = Path(__file__).parents[1] / "data" / "figures"
REFUSALS = HOME.with_name("refusals.json")
WRITES = os.environ.get("SDP_VS_PENALTY_FIGURES") == "write"
_NUMBER = r"\d+\.?\d*"


def changed(name: str, found: Mapping[str, Any]) -> list[str]:
    """Where figures are not what they were; none after they were written."""
    made = json.loads(json.dumps(brief(found)))
    path = HOME / f"{name}.json"
    if WRITES:
        path.write_text(_lines(made) + "\n")
    return differences(json.loads(path.read_text()), made)[:20]


def _lines(of: Mapping[str, Any]) -> str:
    """JSON with an entry a line."""
    lines = (
        f"{json.dumps(k)}: {json.dumps(v, ensure_ascii=False)}" for k, v in of.items()
    )
    return "{\n" + ",\n".join(lines) + "\n}"


def refusals(kind: str) -> dict[str, Any]:
    """What is refused, of a kind: by name, or command, the input and what is said."""
    return dict(json.loads(REFUSALS.read_text())[kind])


def refusal(call: Callable[[], object], *words: str) -> str:
    """The one sentence with which a call is refused; it holds the words."""
    with pytest.raises(InputError) as caught:
        call()
    return a_sentence(str(caught.value), *words)


def a_sentence(text: str, *words: str) -> str:
    assert text.endswith(".")
    assert "\n" not in text
    assert all(word in text for word in words), text
    return text


def same_refusal(kind: str, name: str, sentence: str) -> bool:
    """Whether a sentence says of the case what refusals.json asks: the file it is
    about, what is wrong, and words of the remedy. It is one sentence."""
    a_sentence(sentence)
    asked = refusals(kind)[name][-1]
    words = [asked.get("file", ""), *asked["words"], *asked["remedy"]]
    missing = [word for word in words if word not in sentence]
    assert not missing, f"{missing} not in: {sentence}"
    return True


def said(text: str) -> dict[str, Any]:
    """A text as its words, of many their beginning and a sum, and its numbers; but for
    what differs from day to day or is rounding: seconds of work, names of copies, gaps.
    """
    text = re.sub(
        rf"{_NUMBER}e-\d+|file-[0-9a-f]{{16}}|identified in {_NUMBER} s", "~", text
    )
    words = "_".join(re.sub(_NUMBER, "#", text).split())
    words = (
        words if len(words) < 400 else f"{words[:300]}...{zlib.crc32(words.encode())}"
    )
    return {"words": words, "numbers": _numbers(text)}


def brief(value: Any) -> Any:
    """What is kept: names, numbers, of many numbers their count, two root mean squares
    and their mean; of sentences the numbers in them, of tables their columns."""
    if isinstance(value, str):
        return brief(_numbers(value)) if " " in value else value
    if isinstance(value, Mapping):
        return {str(k): brief(x) for k, x in value.items()}
    if value is None or isinstance(value, bool):
        return value
    if not isinstance(value, np.ndarray | list | tuple):
        return float(f"{float(value):.6g}")
    every = list(value)
    if every and all(
        isinstance(x, Mapping) and x.keys() == every[0].keys() for x in every
    ):
        return {k: brief([x[k] for x in every]) for k in every[0]}
    leaves = list(_leaves(every))
    if any(isinstance(x, Mapping) for x in leaves):
        return [brief(x) for x in every]
    words = [x for x in leaves if isinstance(x, str) and " " not in x]
    said = (
        {"words": words if len(words) < 5 else zlib.crc32(" ".join(words).encode())}
        if words
        else {}
    )
    found = [y for x in leaves for y in (_numbers(x) if isinstance(x, str) else [x])]
    x = np.nan_to_num(np.array(found, float), nan=-1.0, posinf=1e9, neginf=-1e9)
    sizes = (
        [np.sqrt(np.mean(y**2)) for y in (x, x * np.linspace(1.0, 2.0, len(x)))]
        if found
        else []
    )
    figures = [*sizes, x.mean()] if len(x) > 3 else x
    return said | {"count": len(x), "figures": [float(f"{y:.6g}") for y in figures]}


def _numbers(text: str) -> list[float]:
    return [float(x) for x in re.findall(_NUMBER, text)]


def _leaves(value: Any) -> Iterator[Any]:
    if not isinstance(value, np.ndarray | list | tuple):
        yield value
        return
    for x in value:
        yield from _leaves(x)


def differences(
    kept: Any, found: Any, where: str = "", least: float = 1e-7
) -> list[str]:
    """Where two of them differ: numbers by more than processors round."""
    if (
        isinstance(kept, dict)
        and isinstance(found, dict)
        and kept.keys() == found.keys()
    ):
        return [d for k in kept for d in differences(kept[k], found[k], f"{where}.{k}")]
    if isinstance(kept, list) and isinstance(found, list) and len(kept) == len(found):
        pairs = enumerate(zip(kept, found, strict=True))
        first = found[0] if found else 0.0
        least = 3e-4 * abs(first) + 1e-7 if isinstance(first, float) else 1e-7
        return [
            d for k, both in pairs for d in differences(*both, f"{where}[{k}]", least)
        ]
    number = isinstance(kept, float | int) and isinstance(found, float | int)
    near = number and abs(kept - found) <= max(least, 3e-4 * abs(found))
    return [] if near or kept == found else [f"{where}: {kept} is now {found}"]
