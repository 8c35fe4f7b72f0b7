"""The lines of a text file that some other program wrote, in whatever encoding."""

from __future__ import annotations

from pathlib import Path

from gyrotrack.errors import DatasetError

MOST_BYTES = 2**30


def read_bytes(path: Path) -> bytes:
    """Return a file's bytes.

    Raises
    ------
    DatasetError
        It is missing, not a file, or far too large.
    """
    try:
        if path.stat().st_size > MOST_BYTES:
            raise DatasetError(
                f"{path} is larger than a table of angles can be.", "Check the name of the file."
            )
        return path.read_bytes()
    except FileNotFoundError as error:
        raise DatasetError(f"{path} does not exist.", "Check the name.") from error
    except OSError as error:
        raise DatasetError(
            f"{path} cannot be read: {error.strerror}.", "Give the name of a CSV file."
        ) from error


def content_lines(path: Path, content: bytes) -> list[tuple[int, str]]:
    """Return the lines that are neither blank nor comments, each with its number.

    Raises
    ------
    DatasetError
        It is no text.
    """
    if content.startswith((b"\xff\xfe", b"\xfe\xff")):
        text = content.decode("utf-16", errors="replace")
    elif b"\0" in content:
        raise DatasetError(
            f"{path} is not a table of text.", "Give a CSV file; films go through `gyrotrack extract`."
        )
    else:
        try:
            text = content.decode("utf-8-sig")
        except UnicodeDecodeError:
            text = content.decode("latin-1")
    lines = enumerate(text.splitlines(), start=1)
    return [(number, line) for number, line in lines if line.strip() and not line.lstrip().startswith("#")]


def split(line: str, delimiter: str | None) -> list[str]:
    """Return the cells of a line, without blanks and quotes around them."""
    return [cell.strip().strip('"').strip() for cell in line.split(delimiter)]


def delimiter_of(line: str) -> str | None:
    """Return what parts the cells of a header: semicolon, tab or comma, else blanks (None)."""
    return next((d for d in (";", "\t", ",") if d in line), None)
