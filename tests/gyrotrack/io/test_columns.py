"""Long columns that lie in a file are arrays like any other."""

import os
import sys
from pathlib import Path

import numpy as np
import pytest

from gyrotrack import _column_store as columns
from gyrotrack._column_store import in_file, new_columns, release_pages, row_blocks

linux = pytest.mark.skipif(sys.platform != "linux", reason="mapped files are used on Linux")


def resident():
    """Return the memory of this process that is mapped from files, in bytes."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return 1024 * next(int(line.split()[1]) for line in lines if line.startswith("RssFile"))


def test_values_survive_the_release_of_pages():
    rng = np.random.default_rng(0)
    values = {"a": rng.random(200_000), "b": rng.random((200_000, 2, 2)), "c": rng.random(200_000) < 0.5}
    kept = in_file(values)
    for name, column in kept.items():
        assert column.dtype == values[name].dtype
        assert np.array_equal(column, values[name])
    kept["a"][:10] = 7.0
    release_pages()
    assert (kept["a"][:10] == 7.0).all()
    assert np.array_equal(kept["a"][10:], values["a"][10:])


@linux
def test_released_pages_take_no_memory():
    kept = new_columns(2_000_000, {"a": ((), "f8")})
    kept["a"][:] = 1.0
    held = resident()
    release_pages()
    assert held - resident() > 15e6
    assert kept["a"].sum() == 2_000_000


@linux
def test_a_file_goes_with_its_last_column():
    before = len(columns._files)
    kept = new_columns(100_000, {"a": ((), "f8"), "b": ((), "f8")})
    part = kept["a"][5:10]
    assert len(columns._files) == before + 1
    del kept
    part[:] = 1.0
    assert len(columns._files) == before + 1
    del part
    assert len(columns._files) == before


@pytest.mark.parametrize("error", [OSError(28, "no room"), PermissionError("no folder")])
def test_without_room_for_a_file_columns_lie_in_memory(monkeypatch, error):
    def refuse(*_):
        raise error

    monkeypatch.setattr(os, "posix_fallocate", refuse, raising=False)
    before = len(columns._files)
    kept = in_file({"a": np.arange(100_000.0)})
    assert len(columns._files) == before
    assert kept["a"].sum() == 99_999 * 50_000


def test_there_are_never_too_many_files(monkeypatch):
    monkeypatch.setattr(columns, "MOST_FILES", len(columns._files) + 1)
    first, second = (in_file({"a": np.arange(100_000.0)}) for _ in range(2))
    assert len(columns._files) == columns.MOST_FILES or sys.platform != "linux"
    assert np.array_equal(first["a"], second["a"])


def test_blocks_cover_every_row_once():
    seen = np.zeros(10_000, dtype=int)
    for part in row_blocks(len(seen)):
        seen[part] += 1
    assert (seen == 1).all()
    assert list(row_blocks(0)) == []
    assert in_file({}) == {}
