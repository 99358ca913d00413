"""The house style of the command line: sentences, tables and numbers on stdout,
progress on stderr.

A verb prints its verdict, then tables, then the files that it has written; its last
line is what to do next. Three significant digits, units in the headings.
"""

import json
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from rich.console import Console
from rich.markup import escape
from rich.table import Table as Grid

from sdp_vs_penalty.errors import command_line, printable
from sdp_vs_penalty.files import write_text
from sdp_vs_penalty.results.table import Table

#: All that is printed passes these two and :func:`printable`.
out = Console(highlight=False)
err = Console(stderr=True, highlight=False)


def _shown(text: str) -> str:
    """A text within what rich lays out: no markup, no control character."""
    return escape(printable(text))


@contextmanager
def progress(start: str) -> Iterator[Callable[[str], None]]:
    """A line on stderr that says where a long computation stands.

    It is silent where nobody watches. Variables that force colours (as notebooks set
    them) make no terminal of a pipe.
    """
    if not (err.is_terminal and err.file.isatty()):
        yield lambda _: None
        return
    with err.status(_shown(start)) as status:
        yield lambda text: status.update(_shown(text))


def say(text: str, style: str | None = None) -> None:
    """A line on stdout, to be copied or searched: not broken, no markup."""
    out.print(printable(text), style=style, markup=False, soft_wrap=True)


def paragraph(text: str) -> None:
    """Sentences on stdout, broken between words at the terminal's width."""
    out.print(printable(text), markup=False)


def warn(text: str) -> None:
    """A sentence on stderr, as it is."""
    err.print(printable(text), markup=False, soft_wrap=True)


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
    say(f"Next: {command_line(['sdp-vs-penalty', *words])}")


def table(table: Table) -> None:
    """A table under its title."""
    if table.title:
        say(table.title, style="italic")
    out.print(table)


def details(entries: Sequence[tuple[str, str]]) -> None:
    """Names and texts, a line each; empty texts are left out."""
    grid = Grid.grid(padding=(0, 2))
    grid.add_column(no_wrap=True)
    for name, text in entries:
        if text:
            grid.add_row(_shown(name), _shown(text))
    out.print(grid)
