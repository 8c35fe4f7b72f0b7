import base64
import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gyrotrack.plotting._interactive import (
    Board,
    Chart,
    Mark,
    Trace,
    as_data,
    board_document,
    content_policy,
    script,
)


def _unpacked(column):
    if "step" in column:
        return column["start"] + column["step"] * np.arange(column["count"])
    if "floats" in column:
        return np.frombuffer(base64.b64decode(column["floats"]), "<f4").astype(float)
    steps = np.frombuffer(base64.b64decode(column["steps"]), "<i2").astype(float)
    return np.where(steps == -32768, np.nan, column["offset"] + column["scale"] * steps)


def _document(time, value, sigma=None):
    trace = Trace("a", time, value, "#000000", sigma)
    board = Board("b", (Chart("c", "t", "1", (trace,), "f"),), (Mark(1.0, 2.0, "m"),))
    return board_document(board)["charts"][0]["traces"][0]


@given(st.integers(1, 2000), st.integers(0, 2**32 - 1), st.floats(1e-12, 1e12), st.booleans())
def test_numbers_travel_with_less_error_than_a_pixel(count, seed, size, regular):
    random = np.random.default_rng(seed)
    time = np.arange(count) / 260 if regular else np.cumsum(random.uniform(0.001, 0.1, count))
    value = size * random.standard_normal(count)
    value[random.random(count) < 0.1] = np.nan
    found = _document(time, value, np.abs(value))
    back = _unpacked(found["value"])
    assert len(back) == count == found["time"]["count"]
    assert (np.isnan(back) == np.isnan(value)).all()
    span = np.nanmax(value) - np.nanmin(value) if np.isfinite(value).any() else 0.0
    assert np.all(np.abs(back - value)[np.isfinite(value)] <= span / 65000 + 1e-12 * size)
    assert np.abs(_unpacked(found["time"]) - time).max() <= 1e-6 * max(1.0, time[-1])


def test_a_regular_clock_travels_as_start_and_step():
    found = _document(0.5 + np.arange(60000) / 260, np.zeros(60000))
    assert found["time"] == {"start": 0.5, "step": pytest.approx(1 / 260, rel=1e-9), "count": 60000}
    assert len(json.dumps(found)) < 200_000


@given(st.text(max_size=40))
def test_data_never_holds_markup_and_reads_back(text):
    packed = as_data({"name": text + "</script><!--<script>alert(1)</script>\u2028"})
    assert not set("<>&\u2028\u2029") & set(packed)
    assert json.loads(packed)["name"].startswith(text)


def test_policy_names_the_scripts_and_nothing_else():
    policy = content_policy([script()])
    assert policy.startswith("default-src 'none'; script-src 'sha256-")
    assert "connect-src" not in policy
    assert "script-src 'none'" in content_policy([])
