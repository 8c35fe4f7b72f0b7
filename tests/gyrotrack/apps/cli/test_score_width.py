"""Scores in the table of candidates."""

import pytest

from gyrotrack.apps.cli import _output


@pytest.mark.parametrize(
    ("score", "text"),
    [(18.44, "18.4"), (-99_999.0, "-99999.0"), (-100_000.0, "-1.0e+05"), (6_674_831.0, "6.7e+06")],
)
def test_a_score_has_at_most_eight_characters(score, text):
    assert _output._fitting(score) == text
    assert len(text) <= 8
