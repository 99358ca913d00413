"""Excel workbooks (.xlsx) as text: the longest sheet, with tabs between the cells (extra
[formats])."""

import datetime
import warnings
import zipfile
from collections.abc import Iterable
from functools import lru_cache
from pathlib import Path

from sdp_vs_penalty.data.formats.limits import understood
from sdp_vs_penalty.errors import InputError, Remark, missing_extra
from sdp_vs_penalty.files import memory_for


@lru_cache(maxsize=1)
def text_of_workbook(path: Path, changed: int, size: int) -> str:
    """Return the longest sheet of a workbook as text, one line a row.

    Where there are several sheets, a remark says which is taken; of equally long ones
    it is the first. The last text is kept: a table is read several times, and the
    workbook is parsed once.

    Parameters
    ----------
    changed, size : int
        When the file was changed [ns] and its size [bytes]: a changed file is parsed
        anew.

    Returns
    -------
    str
        Tabs between the cells; dates as ISO 8601, formulas by their last values.

    Raises
    ------
    InputError
        openpyxl is not installed, a file that cannot be read, or one that unpacks to
        far more than its size allows.
    """
    try:
        import openpyxl
    except ImportError as error:
        raise missing_extra("Excel workbooks need", "formats") from error
    remedy = "save its sheet as CSV"
    with understood(path, "Excel workbook", remedy):
        with zipfile.ZipFile(path) as archive:
            unpacked = sum(member.file_size for member in archive.infolist())
        if unpacked > memory_for(size):
            what = "unpacks to more than a file of its size does"
            raise InputError(what, remedy, path)
        book = openpyxl.load_workbook(path, read_only=True, data_only=True)
        try:
            texts = {
                sheet.title: _text_of(sheet.iter_rows(values_only=True))
                for sheet in book.worksheets
            }
        finally:
            book.close()
    if not texts:
        raise InputError("a workbook without a sheet of cells", remedy, path)
    n_rows = {name: text.count("\n") for name, text in texts.items()}
    title = max(n_rows, key=n_rows.__getitem__)
    if len(texts) > 1:
        n_longest = list(n_rows.values()).count(n_rows[title])
        why = (
            f"the first of {n_longest} equally long" if n_longest > 1 else "the longest"
        )
        said = f"{path}: sheet {title!r} of {len(texts)} is read, {why}"
        warnings.warn(Remark(said), stacklevel=2)
    return texts[title]


def _text_of(rows: Iterable[tuple[object, ...]]) -> str:
    """Return rows of cells as text."""
    return "".join("\t".join(map(_cell, row)) + "\n" for row in rows)


def _cell(value: object) -> str:
    """Return a cell's value as text, without tabs and line ends."""
    if value is None:
        return ""
    if isinstance(value, datetime.datetime | datetime.date | datetime.time):
        return value.isoformat()
    return " ".join(str(value).split())
