"""Text files as other programs save them: UTF-8, UTF-16 or Windows' letters, packed or
not."""

import bz2
import codecs
import gzip
import io
import lzma
import re
import zipfile
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO, Any

from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.files import memory_for

FORMATS = "give measurements as CSV text or .npz"
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
    """Open a text file, unpacked and decoded.

    Parameters
    ----------
    path : Path
        Path of a text in UTF-8, UTF-16, UTF-32 with a byte-order mark, or in an encoding
        of Windows or of East Asia; it may be packed by gzip, bzip2 or xz. Of an Excel
        workbook its longest sheet, with tabs between the cells.

    Yields
    ------
    IO of str
        Its characters; line ends are one newline character.

    Raises
    ------
    InputError
        The file's first bytes show that it is no text (a workbook, HDF5, a pickle ...).
    """
    if is_workbook(path):
        from sdp_vs_penalty.data.formats.workbook import text_of_workbook

        stat = path.stat()
        yield io.StringIO(text_of_workbook(path, stat.st_mtime_ns, stat.st_size))
        return
    unpack = _unpacker_of(path)
    with (unpack or open)(path, "rb") as file:
        head = file.read(_HEAD)
    for start, (what, remedy) in _NO_TEXTS.items():
        if head.startswith(start):
            raise InputError(what, remedy, path)
    with (unpack or open)(path, "rt", encoding=_encoding_of(head)) as file:
        yield file


def is_workbook(path: Path) -> bool:
    """Return whether a file is an Excel workbook (.xlsx).

    Returns
    -------
    bool
        Decided by the file's content, not by its name.
    """
    with path.open("rb") as file:
        if file.read(4) != b"PK\x03\x04":
            return False
    # NotImplementedError: the archive asks for a newer version of the format.
    not_readable = suppress(zipfile.BadZipFile, NotImplementedError)
    with not_readable, zipfile.ZipFile(path) as archive:
        return "xl/workbook.xml" in archive.namelist()
    return False


def is_packed(path: Path) -> bool:
    """Return whether a file is packed by gzip, bzip2 or xz, or is a workbook.

    Returns
    -------
    bool
        Decided by the file's first bytes, not by its name.
    """
    return _unpacker_of(path) is not None or is_workbook(path)


def is_plain_utf_8(path: Path) -> bool:
    """Return whether other libraries can read a file directly: UTF-8, and not packed.

    Returns
    -------
    bool
        Decided by the first million bytes.
    """
    with path.open("rb") as file:
        head = file.read(_HEAD)
    return not is_packed(path) and _encoding_of(head) == "utf-8-sig"


def largest_text(path: Path) -> int:
    """Return the largest number of characters that a file may have when it is unpacked.

    A small packed file could otherwise fill the memory.

    Returns
    -------
    int
        Characters; for a file that is not packed, one more than its bytes.
    """
    size = path.stat().st_size
    return memory_for(size) if is_packed(path) else size + 1


def _unpacker_of(path: Path) -> Callable[..., IO[Any]] | None:
    """Return the function that opens a packed file (of gzip, bz2 or lzma), by the
    file's first bytes; None for one that is not packed."""
    with path.open("rb") as file:
        start = file.read(8)
    for mark, unpack in _UNPACKERS.items():
        if start.startswith(mark):
            return unpack
    return None


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
    from sdp_vs_penalty.data.formats.column_names import WORDS, split_tokens

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
