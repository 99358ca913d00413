"""The house style of the command line: sentences, tables and numbers on stdout, progress on stderr.

A verb prints its verdict, then tables, then the files that it has written; its last line is what to do
next. Three significant digits, units in the headings.
"""

import json
import math
import os
import shlex
import shutil
import sys
import textwrap
from collections.abc import Callable, Container, Iterable, Iterator, Sequence
from contextlib import contextmanager
from itertools import zip_longest
from pathlib import Path
from typing import TextIO

from sdp_vs_penalty.files import write_text

#: How a terminal is told of a style (ECMA-48).
STYLES = {"bold": "1", "dim": "2", "italic": "3", "red": "31", "yellow": "33"}


def width() -> int:
    """Characters of a line: the terminal's, or 80."""
    return shutil.get_terminal_size().columns


def _watched(stream: TextIO | None) -> bool:
    return stream is not None and stream.isatty() and os.environ.get("TERM") != "dumb"


def styled(text: str, style: str | None) -> str:
    """A text in one of STYLES, where a terminal shows it."""
    plain = style is None or "NO_COLOR" in os.environ or not _watched(sys.stdout)
    return text if plain else f"\x1b[{STYLES[style or 'bold']}m{text}\x1b[0m"


@contextmanager
def progress(start: str) -> Iterator[Callable[[str], None]]:
    """A line on stderr that says where a long computation stands; silent where nobody watches."""

    def tell(text: str) -> None:  # what is written next takes its place
        if _watched(sys.stderr):
            print(f"\x1b[K{text[: width() - 1]}", end="\r", file=sys.stderr, flush=True)

    tell(start)
    try:
        yield tell
    finally:
        tell("")


def say(text: str, style: str | None = None) -> None:
    """A line on stdout, to be copied or searched: not broken."""
    print(styled(text, style))


def explain(text: str) -> None:
    """Sentences on stdout, broken between words at the terminal's width."""
    for line in _broken(text, width()):
        print(line)


def warn(text: str) -> None:
    """A sentence on stderr, as it is."""
    print(text, file=sys.stderr)


def _broken(text: str, most: int, fold: bool = False) -> list[str]:
    """Lines of at most ``most`` characters, broken between words; fold : and inside of longer words."""
    wrap = textwrap.TextWrapper(most, break_long_words=fold, break_on_hyphens=False).wrap
    return [x for line in text.split("\n") for x in (wrap(line) if len(line) > most else [line])]


def written(path: str | Path, note: str = "") -> None:
    """The line about a file that was written."""
    say(f"written: {path}" + (f" ({note})" if note else ""))


def save_json(path: Path | None, content: object) -> None:
    """Write what --json asks for, if it does."""
    if path is not None:
        write_text(path, json.dumps(content, indent=1) + "\n")
        written(path)


def next_step(words: Sequence[object]) -> None:
    """The command to run next, ready to be copied."""
    say(f"Next: {shlex.join(['sdp-vs-penalty', *map(str, words)])}")


def aligned(rows: Sequence[Iterable[float]]) -> list[list[str]]:
    """Figures of one table with the same decimals, so that the smallest shows three digits."""
    sizes = [abs(x) for row in rows for x in row if x != 0.0 and math.isfinite(x)]
    decimals = min(max(2 - math.floor(math.log10(min(sizes))), 0), 6) if sizes else 3
    return [[f"{x:.{decimals}f}" for x in row] for row in rows]


def table(title: str, headings: Sequence[str], rows: Sequence[Sequence[str]], words: int = 1) -> None:
    """A table of figures under its title: the first ``words`` columns hold words, the others numbers."""
    if title:
        say(title, style="italic")
    _print([headings, *rows], range(1, words), range(words, len(headings)))


def listing(headings: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """A table of words, whose first column is never wrapped: it holds the names to type."""
    _print([headings, *rows], range(1, len(headings)))


def details(headings: Sequence[str], row: Sequence[str]) -> None:
    """Names and texts, a line each; empty texts are left out."""
    _print([pair for pair in zip(headings, row, strict=True) if pair[1]], [1], ruled=False)


def _print(
    rows: Sequence[Sequence[str]],
    wrapped: Sequence[int],
    right: Container[int] = (),
    ruled: bool = True,
) -> None:
    """Rows of cells, columns side by side; wrapped : columns that are broken where lines are too long,
    none to less than half of its even share; right : columns of figures; ruled : the first row holds
    headings."""
    widths, most = [max(map(len, column)) for column in zip(*rows, strict=True)], width()
    while (whole := sum(widths) + 2 * len(widths) - 2) > most and (
        loose := [k for k in wrapped if 2 * len(widths) * widths[k] > most]
    ):
        widths[max(loose, key=widths.__getitem__)] -= 1
    utf8 = str(getattr(sys.stdout, "encoding", "utf-8")).lower().startswith("utf")
    for number, row in enumerate(rows):
        cells = [_broken(cell, own, fold=True) for cell, own in zip(row, widths, strict=True)]
        for line in zip_longest(*cells, fillvalue=""):
            placed = zip(line, widths, range(len(widths)), strict=True)
            told = (x.rjust(own) if k in right else x.ljust(own) for x, own, k in placed)
            print("  ".join(told).rstrip())
        if ruled and number == 0:
            print(("─" if utf8 else "-") * whole)
