"""Change attributes of an XML file and leave every other byte as it is.

lxml parses and answers questions; expat, on the same bytes, says where each element's tags begin;
the changes are spliced into the original bytes. Writing the tree out again would not do: quotes,
spaces inside tags, line ends and the declaration would change.
"""

import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Self
from xml.parsers import expat
from xml.sax.saxutils import escape

from lxml import etree

from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.files import read_bytes

#: A whole tag; a > inside quotes does not end it.
_TAG = re.compile(rb"""<(?:[^"'>]|"[^"]*"|'[^']*')*>""")
_ATTRIBUTE = re.compile(rb"""\s([^\s=<>"']+)\s*=\s*("[^"]*"|'[^']*')""")


@dataclass
class Document:
    """An XML file, its parsed tree, and where each of its elements sits in the bytes."""

    path: Path
    source: bytes
    root: Any
    #: element -> (start of the start tag, its end, start of the end tag or None for <a/>).
    spans: dict[Any, tuple[int, int, int | None]]
    _changes: list[tuple[int, int, bytes]] = field(default_factory=list)

    @classmethod
    def read(cls, path: str | Path) -> Self:
        """Raises InputError for a file that is no XML, has a document type, or is not ASCII-like."""
        path = Path(path)
        source = read_bytes(path)
        if b"<!DOCTYPE" in source:
            raise InputError("files with a <!DOCTYPE> are not edited", "remove it", path)
        parser = etree.XMLParser(resolve_entities=False, no_network=True, huge_tree=False)
        try:
            root = etree.fromstring(source, parser)
        except (etree.XMLSyntaxError, ValueError) as error:
            raise InputError(
                f"not an XML file ({error})", "repair it, or name another file", path
            ) from error
        encoding = (root.getroottree().docinfo.encoding or "UTF-8").upper()
        if encoding not in ("UTF-8", "ASCII", "US-ASCII", "ISO-8859-1", "LATIN-1"):
            raise InputError(f"the encoding {encoding} is not edited", "save the file as UTF-8", path)
        elements = [e for e in root.iter() if isinstance(e.tag, str)]
        return cls(path, source, root, dict(zip(elements, _spans(source), strict=True)))

    def set(self, element: Any, attributes: dict[str, str]) -> None:
        """Set attributes of an element; values that read as the same numbers stay as written."""
        start, end, _ = self.spans[element]
        tag = self.source[start:end]
        there = {found[1]: found.span(2) for found in _ATTRIBUTE.finditer(tag)}
        for name, value in attributes.items():
            old = element.get(name)
            if old is not None and _same_numbers(old, value):
                continue
            quoted = f'"{escape(value)}"'.encode()
            if name.encode() in there:
                first, last = there[name.encode()]
                self._changes.append((start + first, start + last, quoted))
            else:
                place = end - (2 if tag.endswith(b"/>") else 1)
                while self.source[place - 1 : place].isspace():
                    place -= 1
                self._changes.append((place, place, f" {name}=".encode() + quoted))

    def append(self, element: Any, text: str) -> None:
        """Add a child, given as text, at the end of an element, on a line of its own."""
        start, end, closing = self.spans[element]
        indent = self._indent(start)
        line = self._newline() + indent + b"  " + text.encode()
        if closing is None:
            name = element.tag.encode()
            self._changes.append(
                (end - 2, end, b">" + line + self._newline() + indent + b"</" + name + b">")
            )
            return
        before = self.source[:closing].rstrip(b" \t\r\n")
        place = max(len(before), end)
        tail = b"" if place < closing else self._newline() + indent
        self._changes.append((place, place, line + tail))

    def edited(self) -> bytes:
        """The file with all changes."""
        out: list[bytes] = []
        last = 0
        # Insertions at one place stay in the order in which they were asked for.
        for start, end, text in sorted(self._changes, key=lambda change: change[:2]):
            out += [self.source[last:start], text]
            last = end
        return b"".join([*out, self.source[last:]])

    def _newline(self) -> bytes:
        return b"\r\n" if b"\r\n" in self.source else b"\n"

    def _indent(self, start: int) -> bytes:
        line = self.source[self.source.rfind(b"\n", 0, start) + 1 : start]
        return line if not line.strip() else b""


def _spans(source: bytes) -> list[tuple[int, int, int | None]]:
    """Of every element in document order."""
    starts: list[int] = []
    closings: dict[int, int] = {}
    stack: list[int] = []
    parser = expat.ParserCreate()

    def opened(_name: str, _attributes: Any) -> None:
        stack.append(len(starts))
        starts.append(parser.CurrentByteIndex)

    def closed(_name: str) -> None:
        closings[stack.pop()] = parser.CurrentByteIndex

    parser.StartElementHandler = opened
    parser.EndElementHandler = closed
    parser.Parse(source, True)
    out: list[tuple[int, int, int | None]] = []
    for k, start in enumerate(starts):
        found = _TAG.match(source, start)
        assert found is not None  # the parser has accepted the file
        end = found.end()
        out.append((start, end, None if source[end - 2 : end] == b"/>" else closings[k]))
    return out


def _same_numbers(old: str, new: str) -> bool:
    try:
        return [float(x) for x in old.split()] == [float(x) for x in new.split()]
    except ValueError:
        return False
