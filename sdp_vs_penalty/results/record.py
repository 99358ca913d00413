"""The base of results: facts, JSON, a frame, five lines in a terminal, HTML in a
notebook."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from html import escape
from typing import TYPE_CHECKING

from sdp_vs_penalty.errors import printable
from sdp_vs_penalty.records import WritesJson
from sdp_vs_penalty.results.facts import Fact, columns_of, facts_of
from sdp_vs_penalty.results.table import Table

if TYPE_CHECKING:
    import pandas

#: A title, and names with their texts.
Summary = tuple[str, Sequence[tuple[str, str]]]
#: Lines below a title, and characters of a line.
_LINES = 4
_WIDTH = 110


class Shown:
    """Something with a repr of at most five lines, which fit a terminal, the whole text
    when it is printed, and an HTML form; subclasses define ``_summary``."""

    def _summary(self) -> Summary:
        """Return a title, and pairs of a name and a text; subclasses define it."""
        raise NotImplementedError

    def _table(self) -> Table | None:
        """Return the table that notebooks show below the summary, or None."""
        return None

    def __repr__(self) -> str:
        """Return the title and the first four lines of the summary, each cut to a
        terminal's width.
        """
        title, entries = self._summary()
        lines = [f"  {name}: {text}" for name, text in entries[:_LINES]]
        return "\n".join([title, *map(cut_to_width, lines)])

    def __str__(self) -> str:
        """Return the title and the whole summary; what is longer than a line goes on,
        indented, on the next one.
        """
        title, entries = self._summary()
        texts = [_wrapped(f"{name}: {text}") for name, text in entries]
        return "\n".join([title, *texts])

    def _repr_html_(self) -> str:
        """Return the title, the summary and the table as HTML, which notebooks
        display.
        """
        title, entries = self._summary()
        html = f"<p><b>{escape(printable(title))}</b></p>" + Table((), entries).html()
        table = self._table()
        return html if table is None else html + table.html()


def _wrapped(text: str) -> str:
    """Break a text at blanks into lines of _WIDTH (110) characters; the second one and
    those after it are indented further."""
    return textwrap.fill(
        text,
        _WIDTH,
        initial_indent="  ",
        subsequent_indent="    ",
        break_long_words=False,
        break_on_hyphens=False,
    )


def cut_to_width(line: str) -> str:
    """Shorten a line to _WIDTH (110) characters; three dots at its end mark the cut."""
    return line if len(line) <= _WIDTH else f"{line[: _WIDTH - 3]}..."


class Record(Shown, WritesJson):
    """A result. Each has ``to_dict`` (plain JSON), ``to_frame`` (all its numbers) and
    :meth:`facts`."""

    def facts(self) -> dict[str, Fact]:
        """Compute all facts of this result by name.

        A fact is a number that sentences may use, with unit, definition, and the text
        that terminal, page and report print.
        """
        return facts_of(self)

    def to_frame(self) -> pandas.DataFrame:
        """Return the facts that are numbers a joint as a data frame, one row for each
        joint (from 1); NaN where one is not known.

        The name of each column includes its unit.
        """
        import pandas

        columns = {
            f"{one.name} [{one.unit}]" if one.unit else one.name: one.value
            for one in columns_of(self.facts().values(), per_joint=True)
        }
        frame = pandas.DataFrame(columns)
        return frame.set_axis(frame.index + 1).rename_axis("joint").astype(float)

    def fact_table(self) -> Table:
        """Return a table of all facts: name, value, unit and definition."""
        rows = [
            (one.name, ", ".join(one.texts), one.unit, one.definition)
            for one in self.facts().values()
        ]
        return Table(("fact", "value", "unit", "what it is"), rows, words=(0, 2, 3))
