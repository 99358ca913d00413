"""Text files as other programs save them: UTF-8, UTF-16 or Windows' letters, packed or
not."""

import bz2
import codecs
import gzip
import html
import io
import lzma
import re
import zipfile
import zlib
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO, Any

from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.files import memory_for

#: Characters that are worked on at a time; a file with a longer line is no table.
PIECE = 1 << 20
#: A quoted cell has at most so many lines.
_LONGEST_CELL = 40
_REMEDY = "give measurements as CSV text or .npz"
#: How files of one packed text begin, and what opens them.
_UNPACKERS: dict[bytes, Callable[..., IO[Any]]] = {
    b"\x1f\x8b": gzip.open,
    b"BZh": bz2.open,
    b"\xfd7zXZ\x00": lzma.open,
}
#: What unpacking raises where a file is broken.
BROKEN = (EOFError, zlib.error, lzma.LZMAError, gzip.BadGzipFile)
#: How files begin that are no text, what they are, and what to do.
_NO_TEXTS: dict[bytes, tuple[str, str]] = {
    b"PK\x03\x04": ("a zip archive, and no Excel workbook", "unpack it"),
    b"\xd0\xcf\x11\xe0": ("an old Excel workbook", "save its sheet as CSV"),
    b"\x89HDF": (
        "an HDF5 file",
        "give it the suffix .h5, or save its arrays with numpy.savez(path, t=..., q=..., tau=...)",
    ),
    b"\x80": (
        "a pickle, which can run a program when it is read",
        "save its arrays with numpy.savez(path, t=..., q=..., tau=...)",
    ),
    b"ARROW1": ("a Feather file", "give it the suffix .feather"),
    b"TDSm": ("a LabVIEW file (TDMS)", "export it as CSV"),
    b"ULog": ("a ULog file", "export it as CSV with `ulog2csv`"),
}
#: How a web page with a table begins, as programs save it with the suffix .xls.
_HTML_TABLE = re.compile(rb"(?is)\A\s*<(?:!doctype html|html|table)\b.*?<tr\b")
#: Bytes of a file that its letters are judged by.
_HEAD = 1 << 20
_CONTROL = re.compile(rb"[\x00-\x08\x0b\x0e-\x1f\x7f]")
#: Byte-order marks and the letters that they stand for; UTF-32's begins like UTF-16's.
_MARKS = {
    codecs.BOM_UTF32_LE: "utf-32",
    codecs.BOM_UTF32_BE: "utf-32",
    codecs.BOM_UTF16_LE: "utf-16",
    codecs.BOM_UTF16_BE: "utf-16",
}
#: Letters of other scripts, in the order in which they are tried: Chinese, Korean,
#: Japanese, Cyrillic. A table is in them where its header has a word that is known.
_OTHER_LETTERS = ("gb18030", "cp949", "cp932", "cp1251")


@contextmanager
def open_text(path: Path) -> Iterator[IO[str]]:
    """Open a text file, unpacked and decoded: UTF-8, UTF-16, UTF-32 with a byte-order
    mark, or an encoding of Windows or of East Asia; packed by gzip, bzip2 or xz. Of an
    Excel workbook its longest sheet, of a web page its table, with tabs between the cells.

    Raises InputError where the file's first bytes show that it is no text (HDF5, a pickle
    ...).
    """
    if is_workbook(path):
        from sdp_vs_penalty.data.formats.workbook import text_of_workbook

        stat = path.stat()
        yield io.StringIO(text_of_workbook(path, stat.st_mtime_ns, stat.st_size))
        return
    unpack = _unpacker_of(path)
    with (unpack or open)(path, "rb") as file:
        head = file.read(_HEAD)
    if _HTML_TABLE.search(head):
        with (unpack or open)(path, "rt", encoding=_encoding_of(head)) as file:
            yield io.StringIO(_text_of_html(file.read()))
        return
    for start, (what, remedy) in _NO_TEXTS.items():
        if head.startswith(start):
            raise InputError(what, remedy, path)
    with (unpack or open)(path, "rt", encoding=_encoding_of(head)) as file:
        yield file


def _text_of_html(content: str) -> str:
    """Return the table of a web page as text, a line a row, with tabs between the cells."""
    rows = re.findall(r"(?is)<tr\b.*?</tr>", content)
    cells = (re.findall(r"(?is)<t[hd]\b[^>]*>(.*?)</t[hd]>", row) for row in rows)
    tags = re.compile(r"<[^>]*>")
    texts = ([html.unescape(tags.sub("", x)).strip() for x in row] for row in cells)
    return "".join("\t".join(row) + "\n" for row in texts)


def is_workbook(path: Path) -> bool:
    """Return whether a file is an Excel workbook (.xlsx), by its content."""
    with path.open("rb") as file:
        if file.read(4) != b"PK\x03\x04":
            return False
    # NotImplementedError: the archive asks for a newer version of the format.
    not_readable = suppress(zipfile.BadZipFile, NotImplementedError)
    with not_readable, zipfile.ZipFile(path) as archive:
        return "xl/workbook.xml" in archive.namelist()
    return False


def is_packed(path: Path) -> bool:
    """Return whether a file is packed by gzip, bzip2 or xz, or is a workbook, by its
    content."""
    return _unpacker_of(path) is not None or is_workbook(path)


def is_plain_utf_8(path: Path) -> bool:
    """Return whether other libraries can read a file directly: UTF-8, and not packed, by
    its first million bytes."""
    with path.open("rb") as file:
        head = file.read(_HEAD)
    is_text = not (is_packed(path) or _HTML_TABLE.search(head))
    return is_text and _encoding_of(head) == "utf-8-sig"


def _unpacker_of(path: Path) -> Callable[..., IO[Any]] | None:
    """Return the function that opens a packed file (of gzip, bz2 or lzma), by the
    file's first bytes; None for one that is not packed."""
    with path.open("rb") as file:
        start = file.read(8)
    return next((x for mark, x in _UNPACKERS.items() if start.startswith(mark)), None)


def _encoding_of(head: bytes) -> str:
    """Return the encoding of a text by its first bytes.

    UTF-16 without a mark has a zero byte beside each letter of ASCII. A text that is no
    UTF-8 has few letters beyond ASCII and no control characters: it is in the letters of
    another script where its header has a known word in them, else in cp1252 (Windows). A
    binary file stays UTF-8, whose decoder refuses it.
    """
    for mark, encoding in _MARKS.items():
        if head.startswith(mark):
            return encoding
    for encoding, zeros, letters in (
        ("utf-16-le", head[1:400:2], head[0:400:2]),
        ("utf-16-be", head[0:400:2], head[1:400:2]),
    ):
        if len(zeros) > 1 and not any(zeros) and all(letters):
            return encoding
    try:
        codecs.getincrementaldecoder("utf-8")().decode(head)
    except UnicodeDecodeError:
        n_letters = sum(byte >= 0x80 for byte in head)
        is_text = 20 * n_letters < len(head) and not _CONTROL.search(head)
        return _letters_of(head) if is_text else "utf-8-sig"
    return "utf-8-sig"


def _letters_of(head: bytes) -> str:
    """Return the first encoding of another script in which a word of the first line is
    known; cp1252 where none is."""
    from sdp_vs_penalty.data.words.names import WORDS
    from sdp_vs_penalty.data.words.tokens import split_tokens

    first_line = head.split(b"\n", 1)[0]
    known = {word for words in WORDS.values() for word in words if not word.isascii()}
    for encoding in _OTHER_LETTERS:
        try:
            words = split_tokens(first_line.decode(encoding))
        except UnicodeDecodeError:
            continue
        if known & set(words):
            return encoding
    return "cp1252"


def iter_rows(path: Path, size: int = PIECE) -> Iterator[tuple[int, list[str]]]:
    """Iterate over the rows of a text file, in pieces of about ``size`` characters: the
    number of the piece's first row, from 1, and its rows without line ends.

    Raises InputError where the file is no text, has a row too long for a table, or
    unpacks to far more than its size allows.
    """
    row = 1
    # A small packed file could otherwise fill the memory.
    n_bytes = path.stat().st_size
    n_characters_left = memory_for(n_bytes) if is_packed(path) else n_bytes + 1
    try:
        with open_text(path) as file:
            while text := file.read(size):
                text += file.readline(PIECE)
                # With an odd number of quotes the piece may end within a quoted cell:
                # its next lines belong to it.
                for _ in range(_LONGEST_CELL if text.count('"') % 2 else 0):
                    text += file.readline(PIECE)
                n_characters_left -= len(text)
                if n_characters_left < 0:
                    what = "unpacks to more than a file of its size does"
                    raise InputError(what, "unpack it yourself, or split it", path)
                rows = _rows_of(path, text, row)
                yield row, rows
                row += len(rows)
    except UnicodeDecodeError as error:
        raise InputError(f"not UTF-8 text (near row {row})", _REMEDY, path) from error
    except BROKEN as error:
        what = f"a packed file that is broken or ends early ({str(error)[:80]})"
        raise InputError(what, "copy it again, or unpack it", path) from error


def _rows_of(path: Path, text: str, first: int) -> list[str]:
    """Split a piece of text into rows; ``first`` is the number of its first row, for
    messages.

    Raises InputError for binary content, and for a row too long for a table.
    """
    lines = text.removesuffix("\n").split("\n")
    rows = join_wrapped(lines) if '"' in text else lines
    if "\0" in text:
        raise InputError("a binary file", _REMEDY, path)
    for k, line in enumerate(rows, start=first):
        if len(line) >= PIECE:
            raise InputError(f"row {k} is too long for a table", _REMEDY, path)
    return rows


def join_wrapped(lines: Sequence[str]) -> list[str]:
    """Join lines to rows where a quoted cell contains line ends.

    A quote that is not closed within 40 lines is a stray mark: then the line is a row
    by itself.
    """
    rows = list[str]()
    k = 0
    while k < len(lines):
        row = lines[k]
        n_lines = 1
        while (
            row.count('"') % 2 and n_lines < _LONGEST_CELL and k + n_lines < len(lines)
        ):
            row += "\n" + lines[k + n_lines]
            n_lines += 1
        is_closed = row.count('"') % 2 == 0
        rows.append(row if is_closed else lines[k])
        k += n_lines if is_closed else 1
    return rows
