"""The parser of text files.

Text may be UTF-8, UTF-16 or Latin-1. Cells may be separated by comma, semicolon, tab or blanks; a comma that is not the
separator is a decimal comma. Comment lines with ``#``, lines above the header and units below the header are accepted.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from gyrotrack._errors import DatasetError
from gyrotrack.io._records import Floats, Integers
from gyrotrack.io.readers._raw_table import (
    CELL_ERRORS,
    MAX_CELLS,
    RawTable,
    header_of,
    is_unit,
    number_of,
    refuse_long_names,
    refuse_size,
    role_of,
)

_QUOTED = re.compile(r'"[^"]*"')
_NO_CELL_ERROR = f"#(?!{'|'.join(re.escape(e[1:]) for e in CELL_ERRORS)})"
# patterns of a comment after the last number of a line, and of a comment that fills the line
_COMMENT = re.compile(rf"(?<=[\d.])[\s,;]+{_NO_CELL_ERROR}.*$", re.IGNORECASE)
_COMMENT_LINE = re.compile(rf"\s*{_NO_CELL_ERROR}", re.IGNORECASE)

# characters at which `str.splitlines` splits
_LINE_ENDS = "\n\r\v\f\x1c\x1d\x1e\x85\u2028\u2029"

Lines = Sequence[tuple[int, str]]
_LONGEST_LINE = 2**24  # largest length of a line [characters]
_SAMPLE = 50  # number of lines that determine the separator
_MOST_SETTINGS = 10  # largest number of lines of settings between header and samples
# largest number of rows of a transposed table; a table is transposed if it has no names, at most this number of rows,
# and more columns than the square of this number
_FEW_ROWS = 5


def content_lines(path: Path, content: bytes) -> tuple[list[tuple[int, str]], tuple[str, ...]]:
    """Return the numbered lines of a text, and notes.

    Blank lines, comments, repeated headers and a few lines of text below the samples are excluded.
    """
    if content.startswith((b"\xff\xfe", b"\xfe\xff")):
        text = content.decode("utf-16", errors="replace")
    elif b"\0" in content:
        halves = content[1:4000:2], content[0:4000:2]
        zeros = [half.count(0) > 0.9 * max(len(half), 1) and len(half) > 8 for half in halves]
        if not any(zeros):
            what = f"{path} is not a table of text."
            raise DatasetError(what, "Give a CSV file; use `gyrotrack extract` for films.")
        text = content.decode("utf-16-le" if zeros[0] else "utf-16-be", errors="replace").lstrip("\ufeff")
    else:
        try:
            text = content.decode("utf-8-sig")
        except UnicodeDecodeError:
            text = content.decode("latin-1")
    refuse_size(path, sum(map(text.count, _LINE_ENDS)) - text.count("\r\n"), 0)
    rows = text.splitlines()
    if (longest := max(map(len, rows), default=0)) > _LONGEST_LINE:
        what = f"{path}: a line has {longest:,} characters; at most {_LONGEST_LINE:,} are read."
        raise DatasetError(what, "Export a part of the record.")
    lines = [(number, line) for number, line in enumerate(rows, start=1) if line.strip(' \t,;"')]
    if "#" in text:
        lines = [
            (number, _COMMENT.sub("", line) if "#" in line else line)
            for number, line in lines
            if not ("#" in line and _COMMENT_LINE.match(line))
        ]
    del text, rows  # frees the memory of the text, which is as large as the file; the lines are copies
    notes = []
    first = next((i for i, (_, line) in enumerate(lines) if _holds_samples(line)), len(lines))
    for _, line in lines[:first]:
        refuse_long_names(path, split(line, delimiter_of(line)))
    heads = {line for _, line in lines[:first]}
    again = {number for number, line in lines[first:] if line in heads}
    if again:
        notes.append(f"{path.name}: the header is repeated in line {min(again)}; the line was excluded")
        lines = [pair for pair in lines if pair[0] not in again]
    last = next((i for i in range(len(lines), first, -1) if _holds_samples(lines[i - 1][1])), len(lines))
    if last < len(lines) <= last + _MOST_SETTINGS:
        notes.append(f"{path.name}: the text from line {lines[last][0]} on was excluded")
        lines = lines[:last]
    return lines, tuple(notes)


def _holds_samples(line: str) -> bool:
    return _is_data(split(line, delimiter_of(line)), comma=True)


def split(line: str, delimiter: str | None) -> list[str]:
    """Return the cells of a line, without surrounding blanks and quotes; a quoted cell may contain the separator."""
    quoted = delimiter is not None and any(delimiter in cell for cell in _QUOTED.findall(line))
    cells = next(csv.reader([line], delimiter=delimiter or " ")) if quoted else line.split(delimiter)
    return [cell.strip().strip('"').strip() for cell in cells]


def delimiter_of(line: str) -> str | None:
    """Return the separator of the cells of a line: semicolon, tab, comma, or None for blanks."""
    plain = _QUOTED.sub("", line)
    return next((d for d in (";", "\t", ",") if d in plain), None)


def _is_data(cells: Sequence[str], *, comma: bool) -> bool:
    """Return whether a line contains samples: the first non-empty cell, or most cells, are numbers or clock times."""
    filled = [c for c in cells if c]
    known = [number_of(c, decimal_comma=comma, times=True) is not None for c in filled]
    return bool(filled) and (known[0] or sum(known) > len(known) / 2)


def _delimiter_of_body(lines: Lines) -> str | None:
    """Return the separator of most lines of the second half, which contains no title or header."""
    body = [_QUOTED.sub("", text) for _, text in lines[len(lines) // 2 :][:_SAMPLE]]
    found = next((d for d in (";", "\t", ",") if sum(d in text for text in body) > len(body) / 2), None)
    mixed = found in {"\t", ","} and all(any(map(_is_list, split(text, found))) for text in body)
    # `mixed`: blanks occur between numbers, together with tabs or commas; then blanks are the separators, and commas
    # are decimal
    return None if mixed else found


def _header(above: Lines, delimiter: str | None, width: int) -> tuple[list[str], list[str], int]:
    """Return the names of the columns, their units if in a separate line, and the number of the line with the names."""
    cells = [split(text, delimiter) for _, text in above]
    cells = [c[:-1] if len(c) == width + 1 and not c[-1] else c for c in cells]
    if not cells:
        return [], [], 0
    names, units, row = _names_among(cells)
    return names, units, above[row][0]


def _names_among(cells: Sequence[list[str]]) -> tuple[list[str], list[str], int]:
    """Return the names of the columns, their units if in a separate row, and the row with the names.

    Among several rows with a cell for each column (names, symbols, units), the header is the row with the most known
    names.
    """
    last = len(cells) - 1
    units: list[str] = []
    if last and len(cells[last - 1]) == len(cells[last]) and _are_units(cells[last]):
        units, last = [c.strip("[]()") for c in cells[last]], last - 1
    first = next((i for i in range(last, -1, -1) if len(cells[i]) != len(cells[last])), -1) + 1
    known = [
        sum(role_of(header_of(name)[0]) is not None for name in cells[i]) for i in range(first, last + 1)
    ]
    row = max(range(first, last + 1), key=lambda i: (known[i - first], i))
    return cells[row], units, row


def header_among(cells: Sequence[list[str]], width: int) -> tuple[tuple[str, ...], tuple[str, ...], int]:
    """Return names and units of the columns of a sheet, and the row with the names.

    `cells` are the rows above the samples, with a cell for each column. A column without a name below a merged cell has
    the nearest name above it. A row with a single cell is a title of the sheet, not a header of several columns.
    """
    blank = ("",) * width
    heads = [row for row in cells if width == 1 or sum(map(bool, row)) > 1]
    if not heads:
        return (tuple(cells[-1]), blank, len(cells) - 1) if cells else (blank, blank, 0)
    names, units, row = _names_among(heads)
    for above in reversed(heads[:row]):
        names = [name or upper for name, upper in zip(names, above, strict=True)]
    return tuple(names), tuple(units) or blank, cells.index(heads[row])


def _plain_numbers(lines: Lines, delimiter: str | None) -> Floats | None:
    """Return the samples of a table in which every cell is a number; None for any other table."""
    texts: Iterator[str] = (text for _, text in lines)
    if delimiter != "," and any("," in text for _, text in lines[:_SAMPLE]):
        texts = (text.replace(",", ".") for text in texts)
    try:
        return np.loadtxt(texts, delimiter=delimiter, comments=None, ndmin=2)
    except ValueError:
        return None


def read_text(path: Path, lines: Lines, notes: tuple[str, ...] = ()) -> RawTable:
    """Return the table in the lines of a text file; all lines and the header must have the same number of cells."""
    delimiter = _delimiter_of_body(lines)
    comma = delimiter != ","
    first = next(
        (i for i, (_, text) in enumerate(lines) if _is_data(split(text, delimiter), comma=comma)), None
    )
    if first is None:
        raise DatasetError(f"{path} has a header but no rows.", "Write the samples below the header.")
    wide = len(split(lines[(first + len(lines)) // 2][1], delimiter))
    names, units, header_line = _header(lines[:first], delimiter, wide)
    header_line = header_line or lines[first][0]
    # a title above an empty line may have as many words as the table has columns
    apart = bool(names) and delimiter is None and lines[first][0] > lines[first - 1][0] + 1
    titled = apart and not any(map(role_of, names))
    if titled:
        names, header_line = [], lines[first][0]
    numbers = _plain_numbers(lines[first:], delimiter) if len(names) in {0, wide} else None
    if numbers is not None and len(numbers) > _FEW_ROWS and numbers.shape[1] == wide:
        line = np.array([n for n, _ in lines[first:]], dtype=np.int64)
        blank = ("",) * wide
        head = tuple(names) or blank, tuple(units) or blank
        return RawTable(path, *head, tuple(numbers.T), line, header_line, comma, notes)
    if (len(lines) - first) * wide > MAX_CELLS:
        what = f"{path} has more than {MAX_CELLS:,} cells, not all of which are numbers."
        raise DatasetError(what, "Export the columns of time and angle alone.")
    rows = [split(text, delimiter) for _, text in lines[first:]]
    usual = max({len(r) for r in rows}, key=[len(r) for r in rows].count)
    above_table = next((i for i, r in enumerate(rows) if len(r) == usual), 0)
    preamble: list[str] = []
    regular = all(len(r) == usual for r in rows[above_table:-1])
    if 0 < above_table <= _MOST_SETTINGS and len(names) != usual and regular:
        # settings of the instrument in a separate table above the samples
        preamble = [
            f"{path.name}: ignored the lines before line {lines[first + above_table][0]} (another table)"
        ]
        rows, first, names, units = rows[above_table:], first + above_table, [], []
    elif len(rows) <= _FEW_ROWS < usual / _FEW_ROWS and not names:
        preamble = [f"{path.name}: the table is transposed; its {len(rows)} rows were read as columns"]
        rows = [list(cells) for cells in zip(*rows, strict=False)]
        usual = len(rows[0])
        lines, first = [(lines[first][0], "")] * len(rows), 0
    if first and delimiter is None and not titled and len(names) != usual:
        names = _names_between_blanks(lines[first - 1][1], usual) or names
    width = len(names) or usual
    rows, kept, repairs = _checked_rows(
        path, rows, np.array([n for n, _ in lines[first:]], dtype=np.int64), width, delimiter
    )
    return RawTable(
        path,
        tuple(names) if names else ("",) * width,
        tuple(units) if units else ("",) * width,
        tuple([row[i] for row in rows] for i in range(width)),
        kept,
        header_line,
        comma,
        (*notes, *preamble, *repairs),
    )


def _is_list(cell: str) -> bool:
    """Return whether a cell contains several numbers, separated by blanks."""
    words = cell.split()
    return len(words) > 1 and all(number_of(word, decimal_comma=True) is not None for word in words)


def _names_between_blanks(line: str, width: int) -> list[str]:
    """Return the names in a header whose separator is a blank, for example two names in ``t [s] angle [rad]``.

    A unit in brackets belongs to the name before it. The list is empty unless it has `width` names.
    """
    names = (
        [line.strip().strip('"')]
        if width == 1
        else re.findall(r"[^\s\[({]+(?:\s*[\[({][^\])}]*[\])}])?", line)
    )
    return names if len(names) == width else []


def _are_units(cells: Sequence[str]) -> bool:
    filled = [c.strip("[]()") for c in cells if c]
    return bool(filled) and sum(is_unit(c) for c in filled) >= len(filled) / 2


def _checked_rows(
    path: Path, rows: list[list[str]], line: Integers, width: int, delimiter: str | None
) -> tuple[list[list[str]], Integers, list[str]]:
    """Check that all rows have the same number of cells; a truncated last row is excluded."""
    notes: list[str] = []
    if delimiter == "," and all(
        len(r) == 2 * width and all(c.lstrip("+-").isdigit() for c in r[::2]) for r in rows
    ):
        rows = [[f"{r[2 * i]}.{r[2 * i + 1]}" for i in range(width)] for r in rows]
        notes.append(f"{path.name}: the comma is both decimal sign and separator; pairs of cells were joined")
    keep = np.ones(len(rows), dtype=bool)
    for i, row in enumerate(rows):
        if delimiter is not None and len(row) == width + 1 and not row[-1]:
            row.pop()  # each line may end with a delimiter
        if len(row) == width:
            continue
        if i == len(rows) - 1 and len(row) < width and i:
            keep[i] = False
            notes.append(f"{path.name}, line {line[i]}: the last row is truncated and was excluded")
            continue
        raise DatasetError(
            f"{path}, line {line[i]}: {len(row)} cells where the header has {width}.",
            "Use ';' as separator if the comma is the decimal sign." if len(row) > width else "",
        )
    return [r for r, k in zip(rows, keep, strict=True) if k], line[keep], notes
