"""Spoiled copies of measured tables: `import` mends them and says so, or ends with one sentence.

    python benchmarks/robustness/spoil_tables.py FILE [OPTION ...] [-- FILE [OPTION ...]] ...

Options are those of `gyrotrack import --body`. Each file is spoiled in twenty ways (seeded) and read in this process.
The table gives the number of copies mended with the same motion (rms difference of the speed below 2 % of its range),
read with another one, refused with a sentence, or ended in any other way (a fault of the program, exit code 1).
"""

from __future__ import annotations

import random
import re
import sys
import tempfile
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import numpy as np

from gyrotrack._errors import GyrotrackError
from gyrotrack.io.readers._import_case import import_body
from gyrotrack.io.readers._motion_table import ReadOptions, read_names

Spoiler = Callable[[str, random.Random], bytes]


def _lines(text: str) -> list[str]:
    return text.splitlines(keepends=True)


def _body(text: str) -> tuple[list[str], list[str]]:
    """Split a text into lines above the samples and samples."""
    lines = _lines(text)
    first = next((i for i, line in enumerate(lines) if re.match(r'\s*"?[-+]?\d', line)), len(lines))
    return lines[:first], lines[first:]


def _on_rows(change: Callable[[list[str], random.Random], list[str]]) -> Spoiler:
    def spoil(text: str, rng: random.Random) -> bytes:
        head, rows = _body(text)
        return "".join([*head, *change(rows, rng)]).encode()

    return spoil


def _some(rows: list[str], rng: random.Random, count: int) -> list[int]:
    return sorted(rng.sample(range(1, len(rows) - 1), min(count, len(rows) - 2))) if len(rows) > 3 else []


def _cell(row: str, rng: random.Random, new: str) -> str:
    parts = re.split(r"([,;\t])", row.rstrip("\r\n"))
    places = list(range(0, len(parts), 2))
    parts[rng.choice(places)] = new
    return "".join(parts) + "\n"


def _swap_columns(text: str, rng: random.Random) -> bytes:
    out = []
    for line in _lines(text):
        parts = re.split(r"([,;\t])", line.rstrip("\r\n"))
        if len(parts) > 2:
            parts[0], parts[2] = parts[2], parts[0]
        out.append("".join(parts) + "\n")
    return "".join(out).encode()


def _duplicated(rows: list[str], rng: random.Random) -> list[str]:
    twice = set(_some(rows, rng, 20))
    return [r for i, row in enumerate(rows) for r in ([row, row] if i in twice else [row])]


def _replaced(new: str, count: int) -> Callable[[list[str], random.Random], list[str]]:
    def change(rows: list[str], rng: random.Random) -> list[str]:
        rows = rows[:]
        for i in _some(rows, rng, count):
            rows[i] = _cell(rows[i], rng, new)
        return rows

    return change


def _exchanged(rows: list[str], rng: random.Random) -> list[str]:
    rows = rows[:]
    for i in _some(rows, rng, 5):
        rows[i - 1], rows[i] = rows[i], rows[i - 1]
    return rows


def _shuffled(rows: list[str], rng: random.Random) -> list[str]:
    rows = [r if r.endswith("\n") else r + "\n" for r in rows]
    rng.shuffle(rows)
    return rows


def _without(rows: list[str], rng: random.Random) -> list[str]:
    gone = set(_some(rows, rng, max(3, len(rows) // 100)))
    return [r for i, r in enumerate(rows) if i not in gone]


def _gap(rows: list[str], _: random.Random) -> list[str]:
    return rows[: len(rows) // 3] + rows[len(rows) // 3 + len(rows) // 40 :]


SPOILERS: dict[str, Spoiler] = {
    "cut in the middle of a line": lambda t, r: t[: int(len(t) * r.uniform(0.6, 0.95))].encode(),
    "byte order mark": lambda t, _: b"\xef\xbb\xbf" + t.encode(),
    "UTF-16": lambda t, _: t.encode("utf-16"),
    "UTF-16 without mark": lambda t, _: t.encode("utf-16-le"),
    "CR LF": lambda t, _: t.replace("\r\n", "\n").replace("\n", "\r\n").encode(),
    "decimal comma, semicolons": lambda t, _: t.replace(",", ";").replace(".", ",").encode(),
    "decimal comma, same separator": lambda t, _: t.replace(".", ",").encode(),
    "tabs": lambda t, _: t.replace(";", "\t").replace(",", "\t").encode(),
    "blank lines and comments": _on_rows(lambda rows, _: ["# c\n\n", *rows[:50], "\n# again\n", *rows[50:]]),
    "duplicated rows": _on_rows(_duplicated),
    "NaN": _on_rows(_replaced("NaN", 5)),
    "empty cells": _on_rows(_replaced("", 5)),
    "a word in a cell": _on_rows(_replaced("fault", 1)),
    "infinite": _on_rows(_replaced("inf", 1)),
    "neighbours exchanged": _on_rows(_exchanged),
    "shuffled rows": _on_rows(_shuffled),
    "lost rows": _on_rows(_without),
    "a gap": _on_rows(_gap),
    "swapped columns": _swap_columns,
    "two recordings in one": _on_rows(lambda rows, _: rows[: len(rows) // 2] + rows[: len(rows) // 2]),
}


def judge(path: Path, spoiled: bytes, options: ReadOptions, folder: Path) -> tuple[str, str]:
    """Return the class of the outcome of one spoiled copy, and what was said."""
    target = folder / "copy"
    target.write_bytes(spoiled)
    whole = import_body(path, 1e-3, options=options)
    try:
        case = import_body(target, 1e-3, options=options)
    except GyrotrackError as error:
        return (
            "refused" if "\n" not in error.message and len(error.message) < 400 else "fault"
        ), error.message
    except Exception as error:
        return "fault", f"{type(error).__name__}: {error}"
    one, two = whole.casing, case.casing
    inside = (one.time >= two.time[0]) & (one.time <= two.time[-1]) & np.isfinite(one.omega)
    known = np.isfinite(two.omega)
    if not inside.any() or not known.any():
        return "other", "; ".join(case.warnings[:3])
    order = np.argsort(two.time[known])
    other = np.interp(one.time[inside], two.time[known][order], two.omega[known][order])
    difference = np.sqrt(np.mean((other - one.omega[inside]) ** 2)) / max(np.ptp(one.omega[inside]), 1e-9)
    return ("mended" if difference < 0.02 else "other"), f"{difference:.3f} " + "; ".join(case.warnings[:3])


def read_options(words: list[str]) -> ReadOptions:
    """Return the options of `import` that concern reading."""
    given = dict(zip(words[::2], words[1::2], strict=True))
    return ReadOptions(
        names=read_names([given["--column"]]) if "--column" in given else None,
        marker=given.get("--marker"),
        centre=given.get("--centre"),
        fps=float(given["--casing-fps"]) if "--casing-fps" in given else None,
        pulses_per_turn=float(given["--pulses-per-turn"]) if "--pulses-per-turn" in given else None,
    )


def main(words: list[str]) -> int:
    """Spoil each file, print the table, and return 1 if anything ended in a fault."""
    groups: list[list[str]] = [[]]
    for word in words:
        if word == "--":
            groups.append([])
        else:
            groups[-1].append(word)
    faults = 0
    for path, *rest in groups:
        options = read_options(rest)
        content = Path(path).read_bytes().decode("utf-8-sig", "replace")
        found: Counter[str] = Counter()
        with tempfile.TemporaryDirectory() as name:
            for seed, (how, spoil) in enumerate(SPOILERS.items()):
                outcome, said = judge(Path(path), spoil(content, random.Random(seed)), options, Path(name))  # noqa: S311
                found[outcome] += 1
                if outcome in {"fault", "other"}:
                    print(f"  {outcome}: {Path(path).name}, {how}: {said[:250]}")
        faults += found["fault"]
        print(f"{Path(path).name:45}", dict(found), flush=True)
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
