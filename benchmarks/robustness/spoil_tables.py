"""Spoiled copies of measured tables: `import` mends them and says so, or ends with one sentence.

    python benchmarks/robustness/spoil_tables.py FILE [OPTION ...] [-- FILE [OPTION ...]] ...

Options are those of `gyrotrack import --body`. Each file is spoiled in up to fifty-six ways (seeded) and read in this
process; a way that makes another file as sound as the first (another unit that nothing states) is left out.
The table gives the number of copies mended with the same motion (rms difference of the angle below 2 % of its range,
or of the period of a pendulum below 1 %), read with another one and told so, read with another one silently, refused
with a sentence, or ended in any other way (a fault of the program, exit code 1).
"""

from __future__ import annotations

import math
import random
import re
import sys
import tempfile
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gyrotrack._errors import GyrotrackError
from gyrotrack.apps._motion import motion_of_passages
from gyrotrack.io.readers._import_case import import_body
from gyrotrack.io.readers._motion_table import ReadOptions, read_names
from gyrotrack.io.readers._registry import read_passages

Spoiler = Callable[[str, random.Random], bytes | None]


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


def _scaled_times(text: str, factor: float, unit: str) -> bytes:
    """Multiply the first column, and write the unit into the header, if there is one."""
    head, rows = _body(text)
    if head:
        names = re.split(r"([,;\t])", head[0].rstrip("\r\n"))
        names[0] = re.sub(r"\s*[\[(].*[\])]", "", names[0].strip('"')) + f" [{unit}]"
        head = ["".join(names) + "\n", *head[1:]]
    out = []
    for row in rows:
        first, rest = re.match(r'"?([-+\d.eE]*)"?(.*)', row, re.DOTALL).groups()
        out.append((f"{float(first) * factor:.10g}" if first else "") + rest)
    return "".join([*head, *out]).encode()


def _headless(text: str, _: random.Random) -> bytes:
    return "".join(_body(text)[1]).encode()


def _two_headers(text: str, _: random.Random) -> bytes:
    head, rows = _body(text)
    return "".join([*head, *head, *rows]).encode()


def _repeated_header(text: str, _: random.Random) -> bytes:
    head, rows = _body(text)
    return "".join([*head, *rows[: len(rows) // 2], *head, *rows[len(rows) // 2 :]]).encode()


def _columns(choose: Callable[[list[str]], list[str]]) -> Spoiler:
    def spoil(text: str, _: random.Random) -> bytes:
        out = []
        for line in _lines(text):
            mark = next((d for d in ";\t," if d in line), ",")
            out.append(mark.join(choose(line.rstrip("\r\n").split(mark))) + "\n")
        return "".join(out).encode()

    return spoil


def _outlier(rows: list[str], rng: random.Random) -> list[str]:
    rows = rows[:]
    for i in _some(rows, rng, 1):
        parts = re.split(r"([,;\t])", rows[i].rstrip("\r\n"))
        parts[-1] = "1e9"
        rows[i] = "".join(parts) + "\n"
    return rows


def _constant(cells: list[str]) -> list[str]:
    return [*cells[:-1], "1.5" if re.match(r'\s*"?[-+]?\d', cells[0]) else cells[-1]]


def _repeated_times(rows: list[str], rng: random.Random) -> list[str]:
    rows = rows[:]
    for i in _some(rows, rng, 5):
        rows[i] = re.sub(r"^[^,;\t]*", re.match(r"[^,;\t]*", rows[i - 1])[0], rows[i])
    return rows


def _reset(rows: list[str], _: random.Random) -> list[str]:
    """Let the clock begin at zero again, twice in the record."""

    def time(row: str) -> float:
        found = re.match(r'"?([-+\d.eE]+)', row)
        return float(found[1]) if found else 0.0

    out, start = [], 0.0
    for i, row in enumerate(rows):
        if i in (len(rows) // 3, 2 * len(rows) // 3):
            start = time(row)
        out.append(re.sub(r'^"?[-+\d.eE]+"?', f"{time(row) - start:.9g}", row))
    return out


def _garbage(text: str, rng: random.Random) -> bytes:
    content = bytearray(text.encode())
    at = len(content) // 2
    content[at : at + 400] = rng.randbytes(400)
    return bytes(content)


_NUMBER = re.compile(r'"?\s*([-+]?\d[\d.]*(?:[eE][-+]?\d+)?)\s*"?')


def _numbers(change: Callable[[list[float]], list[float]], place: int) -> Callable[..., list[str]]:
    """Return a change of all numbers of the first (0) or the last (-1) column."""

    def changed(rows: list[str], _: random.Random) -> list[str]:
        split = [re.split(r"([,;\t])", row.rstrip("\r\n")) for row in rows]
        found = [_NUMBER.fullmatch(parts[place]) for parts in split]
        new = iter(change([float(m[1]) for m in found if m]))
        for parts, match in zip(split, found, strict=True):
            if match:
                parts[place] = f"{next(new):.9g}"
        return ["".join(parts) + "\n" for parts in split]

    return changed


def _quantity(text: str) -> str:
    """Return what the last column of a table is, by its header: "speed", "angle", "count", or "" if it says nothing."""
    head, _ = _body(text)
    last = re.split(r"[;\t,]", head[0].rstrip("\r\n"))[-1].casefold() if head else ""
    words = {
        "speed": ("omega", "speed", "gyro", "rad/s"),
        "angle": ("angle", "theta"),
        "count": ("count", "rev"),
    }
    return next((kind for kind, known in words.items() if any(w in last for w in known)), "")


def _last(factor: float, unit: str, *kinds: str) -> Spoiler:
    """Scale a last column of these kinds; the header states the unit, or none if that is empty."""

    def spoil(text: str, rng: random.Random) -> bytes | None:
        head, rows = _body(text)
        if _quantity(text) not in kinds:
            return None
        mark = next((d for d in ";\t," if d in head[0]), ",")
        *before, last = head[0].rstrip("\r\n").split(mark)
        if re.search("deg|°|rpm", last):
            return None
        name = re.sub(r"\s*[\[(].*?[\])]", "", last.strip('"'))
        head[0] = mark.join([*before, f"{name} [{unit}]" if unit else name]) + "\n"
        scaled = _numbers(lambda v: [factor * x for x in v], -1)(rows, rng)
        return "".join([*head, *scaled]).encode()

    return spoil


def _unstated_times(factor: float) -> Spoiler:
    """Scale the times of a table that states no unit of them."""

    def spoil(text: str, rng: random.Random) -> bytes | None:
        head, _ = _body(text)
        first = re.split(r"[;\t,]", head[0])[0] if head else ""
        if re.search(r"[\[(]|frame", first) or len(head) > 1:
            return None
        return _on_rows(_numbers(lambda v: [factor * x for x in v], 0))(text, rng)

    return spoil


def _of_kinds(spoiler: Spoiler, *kinds: str) -> Spoiler:
    return lambda text, rng: spoiler(text, rng) if _quantity(text) in kinds else None


def _begins_again(values: list[float]) -> list[float]:
    third = max(len(values) // 3, 1)
    return [x - values[(i // third) * third] for i, x in enumerate(values)]


def _with_overflow(values: list[float]) -> list[float]:
    size = 0.4 * max(max(values) - min(values), 1e-9)
    return [(x - values[0]) % size for x in values]


def _kept(share: float) -> Callable[[list[str], random.Random], list[str]]:
    return lambda rows, rng: [row for row in rows if rng.random() < share]


def _moved_block(rows: list[str], _: random.Random) -> list[str]:
    rows = [r if r.endswith("\n") else r + "\n" for r in rows]
    a, b = len(rows) // 5, 2 * len(rows) // 5
    return [*rows[:a], *rows[b:], *rows[a:b]]


def _short_rows(rows: list[str], rng: random.Random) -> list[str]:
    rows = rows[:]
    for i in _some(rows, rng, 5):
        rows[i] = re.sub(r"^[^,;\t]*[,;\t]", "", rows[i])
    return rows


def _without_units(text: str, _: random.Random) -> bytes:
    head, rows = _body(text)
    bare = [re.sub(r"\s*[\[(][^\])]*[\])]", "", line) for line in head[:1]]
    return "".join([*bare, *rows]).encode()


SPOILERS: dict[str, Spoiler] = {
    "last column in degrees, stated": _last(180 / math.pi, "deg", "angle"),
    "last column in degrees, no unit": _last(180 / math.pi, "", "angle"),
    "last column in degrees per second, stated": _last(180 / math.pi, "deg/s", "speed"),
    "last column in turns per minute, stated": _last(30 / math.pi, "rpm", "speed"),
    "header without units": _without_units,
    "last column begins again at zero, twice": _of_kinds(
        _on_rows(_numbers(_begins_again, -1)), "angle", "count"
    ),
    "last column overflows": _of_kinds(_on_rows(_numbers(_with_overflow, -1)), "angle", "count"),
    "times in us, no unit": _unstated_times(1e6),
    "times in ms, no unit": _unstated_times(1e3),
    "times of two digits": _on_rows(_numbers(lambda v: [round(x, 2) for x in v], 0)),
    "clock set ahead": _on_rows(
        _numbers(lambda v: [x + (0.1 * (v[-1] - v[0]) if i > len(v) / 2 else 0) for i, x in enumerate(v)], 0)
    ),
    "backwards": _on_rows(lambda rows, _: [r if r.endswith("\n") else r + "\n" for r in reversed(rows)]),
    "a block of rows moved to the end": _on_rows(_moved_block),
    "every second row lost": _on_rows(lambda rows, _: rows[::2]),
    "a third of the rows lost": _on_rows(_kept(0.67)),
    "nine of ten rows lost": _on_rows(_kept(0.1)),
    "rows without their first cell": _on_rows(_short_rows),
    "swapped columns, no header": lambda t, r: _headless(_swap_columns(t, r).decode(), r),
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
    "empty": lambda *_: b"",
    "binary": lambda _, r: r.randbytes(3000),
    "binary in the middle": _garbage,
    "two rows": _on_rows(lambda rows, _: rows[:2]),
    "no header": _headless,
    "two headers": _two_headers,
    "a header in the middle": _repeated_header,
    "header in Latin-1": lambda t, _: re.sub(
        r"(?<=[A-Za-z])(?=[,;\t\r\n])", "\u00b0\u00e9", t, count=1
    ).encode("latin-1", "replace"),
    "without the last column": _columns(lambda cells: cells[:-1]),
    "last column twice": _columns(lambda cells: [*cells, cells[-1]]),
    "constant last column": _columns(_constant),
    "an outlier of 1e9": _on_rows(_outlier),
    "repeated times": _on_rows(_repeated_times),
    "clock set to zero twice": _on_rows(_reset),
    "times in ms": lambda t, _: None if t.startswith("frame") else _scaled_times(t, 1e3, "ms"),
    "unknown unit": lambda t, _: None if t.startswith("frame") else _scaled_times(t, 1.0, "furlong"),
    "words at the end": lambda t, _: (t.rstrip("\n") + "\nEnd of record\nmean: 3.2\n").encode(),
    "blanks as separators": lambda t, _: re.sub(r"[,;\t]", " ", t).encode(),
    "quoted cells": _columns(lambda cells: [c if c.startswith('"') else f'"{c}"' for c in cells]),
    "classic Mac line ends": lambda t, _: t.replace("\r\n", "\n").replace("\n", "\r").encode(),
}


@dataclass(frozen=True)
class Motion:
    """What was read: angles at times, or the period of a pendulum, and the warnings; or the sentence of an error."""

    time: np.ndarray
    angle: np.ndarray
    warnings: tuple[str, ...]
    refused: str = ""


def read(path: Path, options: ReadOptions) -> Motion:
    """Read a file, as `import` or, for light gates, `spindown` does."""
    try:
        gates = read_passages(path, options)
        if gates is not None:
            period = motion_of_passages(gates).period.value
            return Motion(np.array([0.0]), np.array([period]), gates.notes)
        case = import_body(path, 1e-3, options=options)
    except GyrotrackError as error:
        return Motion(np.zeros(0), np.zeros(0), (), error.message)
    order = np.argsort(case.casing.time)
    return Motion(case.casing.time[order], case.casing.angle[order], case.warnings)


def judge(whole: Motion, spoiled: bytes, options: ReadOptions, target: Path) -> tuple[str, str]:
    """Return the class of the outcome of one spoiled copy, which is written to `target`, and what was said."""
    target.write_bytes(spoiled)
    try:
        copy = read(target, options)
    except Exception as error:
        return "fault", f"{type(error).__name__}: {error}"
    if copy.refused:
        clear = "\n" not in copy.refused and len(copy.refused) < 400
        return "refused" if clear else "fault", copy.refused
    told = [w for w in copy.warnings if _bare(w) not in {_bare(v) for v in whole.warnings}]
    change = _change(whole, copy)
    outcome = "mended" if change < 0.02 else "told" if told else "silent"
    return outcome, f"{change:.3f} " + "; ".join(told)


def _bare(warning: str) -> str:
    """Return a warning without its numbers and the name of the file."""
    return re.sub(r"[-\d.e]+", "#", warning.partition(": ")[2] or warning)


def _change(whole: Motion, copy: Motion) -> float:
    """Return the rms difference of two angles over their range, apart from a constant, or that of two periods."""
    if whole.refused or not len(copy.time):
        return np.inf
    if len(whole.time) == 1 or len(copy.time) == 1:
        same = len(whole.time) == len(copy.time)
        return 2 * abs(copy.angle[0] / whole.angle[0] - 1) if same else np.inf
    inside = (copy.time >= whole.time[0]) & (copy.time <= whole.time[-1])
    common = np.ptp(copy.time[inside]) if inside.sum() > 1 else 0.0
    if common < 0.3 * max(np.ptp(whole.time), np.ptp(copy.time)):
        return np.inf
    difference = copy.angle[inside] - np.interp(copy.time[inside], whole.time, whole.angle)
    return float(np.std(difference) / np.ptp(whole.angle))


def read_options(words: list[str]) -> ReadOptions:
    """Return the options of `import` that concern reading."""
    given = dict(zip(words[::2], words[1::2], strict=True))
    return ReadOptions(
        names=read_names(given["--column"].split("|")) if "--column" in given else None,
        marker=given.get("--marker"),
        centre=given.get("--centre"),
        fps=float(given["--casing-fps"]) if "--casing-fps" in given else None,
        pulses_per_turn=float(given["--pulses-per-turn"]) if "--pulses-per-turn" in given else None,
    )


def main(words: list[str]) -> int:
    """Spoil each file, print the table, and return 1 if anything ended in a fault."""
    groups: list[list[str]] = [[]]
    for word in (w for w in words if w != "-v"):
        if word == "--":
            groups.append([])
        else:
            groups[-1].append(word)
    faults = 0
    for path, *rest in groups:
        options = read_options(rest)
        content = Path(path).read_bytes().decode("utf-8-sig", "replace")
        whole = read(Path(path), options)
        if whole.refused:
            print(f"  {Path(path).name} as it is: {whole.refused}")
        found: Counter[str] = Counter()
        with tempfile.TemporaryDirectory() as name:
            for seed, (how, spoil) in enumerate(SPOILERS.items()):
                spoiled = spoil(content, random.Random(seed))  # noqa: S311
                if spoiled is None or spoiled == content.encode():
                    continue
                outcome, said = judge(whole, spoiled, options, Path(name) / "copy")
                found[outcome] += 1
                if outcome in {"fault", "silent", "told"} or "-v" in words:
                    print(f"  {outcome}: {Path(path).name}, {how}: {said[:250]}")
        faults += found["fault"]
        print(f"{Path(path).name:45}", dict(found), flush=True)
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
