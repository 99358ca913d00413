"""Words a sentence of the documentation: the mean of each page, and its longest sentence.

    python docs/tools/readability.py [PAGE.md ...]

Tables, code, pictures, headings and block quotes of printed text are left out. A colon
or a semicolon ends no sentence.
"""

from __future__ import annotations

import re
import sys
from pathlib import Path

DOCS = Path(__file__).parents[1]
#: Words a sentence: the mean of a page, and the longest of all.
MEAN = 16.0
LONGEST = 30

_FENCED = re.compile(r"^( *)```.*?^\1```$", re.MULTILINE | re.DOTALL)
_LEFT_OUT = re.compile(r"^\s*(\||#|!\[|<|:::| {4,}\S).*$", re.MULTILINE)
_LINK = re.compile(r"\[([^\]]*)\]\([^)]*\)")
_CODE = re.compile(r"`[^`]*`")
_COMMENT = re.compile(r"<!--.*?-->", re.DOTALL)
_ITEM = re.compile(r"^\s*([-*]|\d+\.)\s+", re.MULTILINE)
_END = re.compile(r"(?<=[.!?])[)\"*]*\s+(?=[\"*(\[]*[A-Z`0-9])")
_WORD = re.compile(r"[A-Za-z0-9][\w'./%-]*")


def sentences(markdown: str) -> list[str]:
    """Split a page into its sentences.

    Parameters
    ----------
    markdown : str
        The page.

    Returns
    -------
    list of str
        In their order; an item of a list, and a paragraph before a list or a block of
        code, end a sentence.
    """
    text = _COMMENT.sub("", _FENCED.sub("\n\n", markdown))
    text = _LEFT_OUT.sub("\n", text)
    text = _CODE.sub("Code", _LINK.sub(r"\1", text))
    text = _ITEM.sub("\n\n", text)
    paragraphs = [" ".join(part.split()) for part in re.split(r"\n\s*\n", text)]
    return [
        sentence
        for paragraph in paragraphs
        for sentence in _END.split(paragraph)
        if _WORD.search(sentence)
    ]


def n_words(sentence: str) -> int:
    """Words of a sentence; a piece of code is one, a formula one for each name."""
    return len(_WORD.findall(sentence))


def main(names: list[str]) -> None:
    """Print a line a page, and the longest sentence of all."""
    pages = [Path(name) for name in names] or sorted(DOCS.glob("*.md"))
    longest = ""
    counts: list[int] = []
    for page in pages:
        found = sentences(page.read_text(encoding="utf-8"))
        if not found:
            continue
        lengths = [n_words(sentence) for sentence in found]
        counts += lengths
        mean = sum(lengths) / len(lengths)
        n_long = sum(length > LONGEST for length in lengths)
        print(
            f"{page.name:20} mean {mean:5.1f}  longest {max(lengths):3}  over 30: {n_long}"
        )
        longest = max([longest, *found], key=n_words)
    print(f"all: mean {sum(counts) / len(counts):.1f} of {len(counts)} sentences")
    print(f"longest ({n_words(longest)}): {longest}")


if __name__ == "__main__":
    main(sys.argv[1:])
