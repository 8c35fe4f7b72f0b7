"""Spoiled copies of a table are mended and reported, or refused with a sentence; nothing else happens."""

import importlib.util
import random
import sys
from pathlib import Path

import numpy as np
import pytest

from gyrotrack.io.readers._motion_table import ReadOptions, read_names

ROOT = Path(__file__).parents[4]


@pytest.fixture(scope="module")
def spoil():
    spec = importlib.util.spec_from_file_location(
        "spoil_tables", ROOT / "benchmarks/robustness/spoil_tables.py"
    )
    module = importlib.util.module_from_spec(spec)
    sys.modules["spoil_tables"] = module
    spec.loader.exec_module(module)
    return module


def coasting(kind):
    time = np.arange(1500) * 0.0125
    angle = 60 * 40 * (1 - np.exp(-time / 40)) + np.random.default_rng(0).normal(0, 1e-3, 1500)
    if kind == "table":
        text = "t [s],angle [deg]\n" + "".join(
            f"{t:.4f},{a:.5f}\n" for t, a in zip(time, np.degrees(angle), strict=True)
        )
        return text, ReadOptions()
    count = np.floor(angle / (2 * np.pi)).astype(int)
    rows = zip((time * 1e6).astype(int) + 4_000_000, count, strict=True)
    return "".join(f"{t},{c + 7},1.5,3\n" for t, c in rows), ReadOptions(names=read_names(["revolutions=2"]))


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["table", "counter"])
def test_spoiled_copies(tmp_path, spoil, kind):
    text, options = coasting(kind)
    (tmp_path / "whole.csv").write_text(text)
    whole = spoil.read(tmp_path / "whole.csv", options)
    spoiled = {
        how: change(text, random.Random(seed))  # noqa: S311
        for seed, (how, change) in enumerate(spoil.SPOILERS.items())
    }
    found = {
        how: spoil.judge(whole, copy, options, tmp_path / "copy")
        for how, copy in spoiled.items()
        if copy is not None
    }
    assert len(found) >= 40
    outcomes = {how: outcome for how, (outcome, _) in found.items()}
    if kind == "counter":  # coarse times: only that nothing ends in a fault
        assert "fault" not in outcomes.values(), found
        return
    assert set(outcomes.values()) == {"mended", "refused"}, found
    refused = {how for how, outcome in outcomes.items() if outcome == "refused"}
    assert {
        "a word in a cell",
        "two recordings in one",
        "constant last column",
        "clock set to zero twice",
    } <= refused
    assert not refused & {
        "UTF-16",
        "shuffled rows",
        "duplicated rows",
        "NaN",
        "decimal comma, semicolons",
        "lost rows",
        "infinite",
        "an outlier of 1e9",
        "a header in the middle",
        "two headers",
        "words at the end",
        "times in ms",
    }
