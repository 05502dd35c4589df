"""Reader of Excel workbooks (XLSX), by the library openpyxl.

A sheet is read as a delimited text file with the same cells, so that a line of units, several lines of names
and the options of the reader are treated in the same way. Formulas have the values that Excel stored.
"""

from __future__ import annotations

import csv
import io
from datetime import datetime
from itertools import chain
from pathlib import Path
from typing import Any

from swimid.files import isolated
from swimid.imports.formats.delimited import read_text
from swimid.imports.table import ForeignTable, Format, ReaderOptions, choose


def _read(path: Path, options: ReaderOptions, select: str | None) -> ForeignTable:
    import openpyxl

    isolated.check_zip(path)
    book = openpyxl.load_workbook(path, read_only=True, data_only=True)
    sheets = {sheet.title: list(sheet.iter_rows(values_only=True)) for sheet in book.worksheets}
    book.close()
    filled = {name: rows for name, rows in sheets.items() if {*chain.from_iterable(rows)} - {None}}
    rows = filled[choose(select, list(filled), "sheet", path)]
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    for row in rows:
        cells = [_text(cell) for cell in row]
        if any(cells):
            writer.writerow(cells)
        else:
            text.write("\n")
    layout = options.model_copy(update={"delimiter": ",", "decimal": "."})
    return read_text(text.getvalue().encode(), [], layout, path)


def _text(cell: Any) -> str:
    """Return the text of a cell. The text of an empty cell, and of an error such as ``#N/A``, is empty."""
    if cell is None or (isinstance(cell, str) and cell.startswith("#") and cell.endswith(("!", "?", "/A"))):
        return ""
    if isinstance(cell, datetime):
        return cell.isoformat(sep=" ")
    if isinstance(cell, bool):
        return str(int(cell))
    return str(cell).replace("\n", " ").strip()


XLSX = Format("xlsx", "Excel workbook", _read, endings=(".xlsx", ".xlsm"), extra="excel")
