"""Excel workbooks (.xlsx) as text: the longest sheet, or the sheets of one run side by
side, with tabs between the cells (extra [formats])."""

import datetime
import warnings
import zipfile
from collections.abc import Iterable, Mapping
from functools import lru_cache
from pathlib import Path

from sdp_vs_penalty.data.formats.limits import understood
from sdp_vs_penalty.data.words.names import quantity_of
from sdp_vs_penalty.errors import InputError, Remark, missing_extra
from sdp_vs_penalty.files import memory_for


@lru_cache(maxsize=1)
def text_of_workbook(path: Path, changed: int, size: int) -> str:
    """Return the longest sheet of a workbook as text, one line a row; sheets that hold a
    quantity each side by side.

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
    of_run = {x: y for x, y in texts.items() if quantity_of(x)}
    if text := _side_by_side(of_run):
        said = f"{path}: sheets {', '.join(of_run)} are read side by side"
        warnings.warn(Remark(said), stacklevel=2)
        return text
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


def _side_by_side(texts: Mapping[str, str]) -> str:
    """Return the text of sheets that hold a quantity each, which their titles say, of the
    same instants and joints, each column called by its sheet's title as well:
    "Position/elbow"; "" of other sheets."""
    if not {"q", "tau"} <= {*map(quantity_of, texts)}:
        return ""
    sheets = {
        title: [line.partition("\t") for line in text.splitlines()]
        for title, text in texts.items()
    }
    (_, _, names), *others = (rows[0] for rows in sheets.values())
    first, *further = ([x for x, _, _ in rows] for rows in sheets.values())
    if any(x != first for x in further) or any(x != names for _, _, x in others):
        return ""
    heads = [
        "\t".join(f"{title}/{name}" for name in names.split("\t")) for title in sheets
    ]
    rows = zip(*([x for _, _, x in rows[1:]] for rows in sheets.values()), strict=True)
    lines = zip(first, [heads, *rows], strict=True)
    return "".join("\t".join([x, *cells]) + "\n" for x, cells in lines)


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
