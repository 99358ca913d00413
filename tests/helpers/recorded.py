"""What is refused, and where two JSON files differ.

tests/data/refusals.json holds of each kind of refusal the input, the file that the
sentence is about, and words that it says of what is wrong and of the remedy.
"""

import json
from pathlib import Path

import pytest

from sdp_vs_penalty import InputError

REFUSALS = Path(__file__).parents[1] / "data" / "refusals.json"


def refusals(kind):
    """What is refused, of a kind: by name, or command, the input and what is said."""
    return dict(json.loads(REFUSALS.read_text())[kind])


def refusal(call, *words):
    """The one sentence with which a call is refused; it holds the words."""
    with pytest.raises(InputError) as caught:
        call()
    return a_sentence(str(caught.value), *words)


def a_sentence(text, *words):
    assert text.endswith(".")
    assert "\n" not in text
    assert all(word in text for word in words), text
    return text


def same_refusal(kind, name, sentence):
    """Whether a sentence says of the case what refusals.json asks: the file it is
    about, what is wrong, and words of the remedy. It is one sentence."""
    a_sentence(sentence)
    asked = refusals(kind)[name][-1]
    words = [asked.get("file", ""), *asked["words"], *asked["remedy"]]
    missing = [word for word in words if word not in sentence]
    assert not missing, f"{missing} not in: {sentence}"
    return True


def differences(kept, found, where="", least=1e-7):
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
