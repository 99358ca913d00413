"""The house style of the command line: sentences, tables and numbers on stdout,
progress on stderr.

A verb prints its verdict, then tables, then the files that it has written; its last
line is what to do next. Three significant digits, units in the headings.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sdp_vs_penalty import formatting
from sdp_vs_penalty.cli.time_left import TimeLeft
from sdp_vs_penalty.errors import printable
from sdp_vs_penalty.files import write_text
from sdp_vs_penalty.results.table import Table

if TYPE_CHECKING:
    from rich.console import Console


# All that is printed passes these two and :func:`printable`. A verb's help needs none.
@cache
def out() -> Console:
    """Return the console of stdout."""
    from rich.console import Console

    return Console(highlight=False)


@cache
def err() -> Console:
    """Return the console of stderr."""
    from rich.console import Console

    return Console(stderr=True, highlight=False)


def _shown(text: str) -> str:
    """Return a text that rich prints literally: without markup and control
    characters.
    """
    from rich.markup import escape

    return escape(printable(text))


@dataclass
class Transcript:
    """What a command has said, for --json of the commands without a format of their
    own."""

    sentences: list[str] = field(default_factory=list)
    tables: list[dict[str, Any]] = field(default_factory=list)
    written: list[str] = field(default_factory=list)
    next: list[str] = field(default_factory=list)


#: Of the command that runs.
transcript = Transcript()


@contextmanager
def listening(is_quiet: bool) -> Iterator[Transcript]:
    """Yield a new transcript of what is printed while this runs.

    is_quiet : whether to print remarks and errors only.
    """
    global transcript
    before = transcript
    transcript = Transcript()
    out().quiet = is_quiet
    try:
        yield transcript
    finally:
        transcript = before
        out().quiet = False


@contextmanager
def progress(start: str) -> Iterator[Callable[[str], None]]:
    """Show a line on stderr with the state of a long computation and the elapsed time.

    Yields a function that takes the state as text. If the text counts ("3 of 40"), the
    time left is added. Nothing is shown with --quiet, or if stderr is no terminal;
    variables that force colours, as notebooks set them, do not change that.
    """
    if out().quiet or not (err().is_terminal and err().file.isatty()):
        yield lambda _: None
        return
    from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

    with Progress(
        SpinnerColumn(),
        TextColumn("{task.description}"),
        TimeElapsedColumn(),
        console=err(),
        transient=True,
    ) as display:
        task = display.add_task(_shown(start), total=None)
        clock = TimeLeft()

        def show(text: str) -> None:
            display.update(task, description=_shown(clock.with_time_left(text)))

        yield show


def say(text: str, style: str | None = None) -> None:
    """Print a line on stdout for copying or searching: not wrapped, without markup."""
    transcript.sentences.append(text)
    out().print(printable(text), style=style, markup=False, soft_wrap=True)


def paragraph(text: str) -> None:
    """Print sentences on stdout, wrapped at the terminal's width."""
    transcript.sentences.append(text)
    out().print(printable(text), markup=False)


def warn(text: str) -> None:
    """Print a sentence on stderr, not wrapped."""
    err().print(printable(text), markup=False, soft_wrap=True)


def hint(text: str) -> None:
    """Print a sentence that helps to go on on stderr, not wrapped; --quiet leaves it
    out.
    """
    transcript.sentences.append(text)
    if not out().quiet:
        warn(text)


def written(path: str | Path, note: str = "") -> None:
    """Print the path of a file that was written, perhaps with a note."""
    transcript.written.append(str(path))
    _line(f"written: {path}" + (f" ({note})" if note else ""))


def save_json(path: Path | None, content: object) -> None:
    """Write the JSON that the option --json asks for; without a path, do nothing."""
    if path is not None:
        write_text(path, json.dumps(content, indent=1) + "\n")
        written(path)


def next_step(words: Sequence[object]) -> None:
    """Print the command to run next, ready to be copied."""
    line = formatting.command(*words)
    transcript.next.append(line)
    _line(f"Next: {line}")


def _line(text: str) -> None:
    """Print a line on stdout that is not part of the transcript's sentences."""
    out().print(printable(text), markup=False, soft_wrap=True)


def table(shown: Table) -> None:
    """Print a table under its title; no column is ever cut.

    In a terminal that is too narrow it is split into blocks of columns. If the output
    is no terminal, it gets the width that it needs.
    """
    transcript.tables.append(shown.to_dict())
    if shown.title:
        out().print(
            printable(shown.title), style="italic", markup=False, soft_wrap=True
        )
    if shown.least_width <= out().width:
        out().print(shown)
    elif out().is_terminal:
        for block in shown.blocks(out().width):
            out().print(block)
    else:
        lines = replace(shown, title="").text(shown.least_width).splitlines()
        for line in lines:
            _line(line)


def details(entries: Sequence[tuple[str, str]]) -> None:
    """Print pairs of name and text, one on each line; those with an empty text are
    left out.
    """
    transcript.sentences += [f"{name}: {text}" for name, text in entries if text]
    from rich.table import Table as Grid

    grid = Grid.grid(padding=(0, 2))
    grid.add_column(no_wrap=True)
    for name, text in entries:
        if text:
            grid.add_row(_shown(name), _shown(text))
    out().print(grid)
