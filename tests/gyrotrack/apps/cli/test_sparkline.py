import io
import sys

import numpy as np
import pytest

from gyrotrack.apps.cli._output import marks, sparkline


def test_the_line_rises_and_falls_with_the_curve():
    line = sparkline(np.sin(np.linspace(0, 2 * np.pi, 1000)), width=40)
    assert len(line) == 40
    assert line.index("█") < 15 < line.index("▁")


def test_a_single_peak_is_kept():
    value = np.zeros(10_000)
    value[6200] = 1.0
    line = sparkline(value, width=50)
    assert line.count("█") == 1
    assert line.index("█") == 31


def test_gaps_and_constants():
    assert sparkline(np.full(5, np.nan)) == "     "
    assert sparkline(np.array([1.0, np.nan, 1.0])) == "▁ ▁"


def test_a_pipe_that_knows_only_ascii_gets_ascii(monkeypatch):
    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(io.BytesIO(), encoding="ascii"))
    assert sparkline(np.array([0.0, 1.0])).isascii()


@pytest.mark.parametrize(
    ("a", "b", "line"), [(0, 10, "^^^^^"), (5, 5, "  ^  "), (9, 20, "    ^"), (-5, 1, "^    ")]
)
def test_marks_lie_below_their_stretch(a, b, line):
    assert marks([(a, b)], 0.0, 10.0, width=5) == line
