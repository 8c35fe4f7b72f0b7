import base64
import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gyrotrack.plotting._charts import (
    Chart,
    Dashboard,
    Interval,
    Trace,
    as_data,
    chart_picture,
    concatenated,
    content_policy,
    dashboard_document,
    scripts,
)


def _unpacked(column):
    if "step" in column:
        return column["start"] + column["step"] * np.arange(column["count"])
    if "floats" in column:
        return column["first"] + np.frombuffer(base64.b64decode(column["floats"]), "<f4").astype(float)
    steps = np.frombuffer(base64.b64decode(column["steps"]), "<i2").astype(float)
    return np.where(steps == -32768, np.nan, column["offset"] + column["scale"] * steps)


def _document(time, value, sigma=None):
    trace = Trace("a", time, value, "#000000", sigma)
    board = Dashboard("b", (Chart("c", "t", "1", (trace,), "f"),), (Interval(1.0, 2.0, "m"),))
    return dashboard_document(board)["charts"][0]["traces"][0]


@given(st.integers(1, 2000), st.integers(0, 2**32 - 1), st.floats(1e-12, 1e12), st.booleans())
def test_numbers_travel_with_less_error_than_a_pixel(count, seed, size, regular):
    random = np.random.default_rng(seed)
    time = np.arange(count) / 260 if regular else np.cumsum(random.uniform(0.001, 0.1, count))
    value = size * random.standard_normal(count)
    value[random.random(count) < 0.1] = np.nan
    found = _document(time, value, np.abs(value))
    back = _unpacked(found["value"])
    assert len(back) == count == found["x"]["count"]
    assert (np.isnan(back) == np.isnan(value)).all()
    span = np.nanmax(value) - np.nanmin(value) if np.isfinite(value).any() else 0.0
    assert np.all(np.abs(back - value)[np.isfinite(value)] <= span / 65000 + 1e-12 * size)
    assert np.abs(_unpacked(found["x"]) - time).max() <= 1e-6 * max(1.0, time[-1])


def test_a_regular_clock_travels_as_start_and_step():
    found = _document(0.5 + np.arange(60000) / 260, np.zeros(60000))
    assert found["x"] == {"start": 0.5, "step": pytest.approx(1 / 260, rel=1e-9), "count": 60000}
    assert len(json.dumps(found)) < 200_000


@settings(max_examples=30)
@given(st.text(max_size=40))
def test_data_never_holds_markup_and_reads_back(text):
    packed = as_data({"name": text + "</script><!--<script>alert(1)</script>\u2028"})
    assert not set("<>&\u2028\u2029") & set(packed)
    assert json.loads(packed)["name"].startswith(text)


def test_policy_names_the_scripts_and_nothing_else():
    policy = content_policy(scripts())
    assert policy.startswith("default-src 'none'; script-src 'sha256-")
    assert "connect-src" not in policy
    assert "script-src 'none'" in content_policy([])


X = np.linspace(0.0, 10.0, 101)


def _limits(*traces):
    return Chart("c", "t", "1", traces, "f").limits


def test_the_scale_is_that_of_the_measurement():
    measured = Trace("measured", X, np.sin(X), "#000000", scale="reference")
    wild = Trace("model", X, 1e13 * X, "#000000")
    low, high = _limits(measured, wild)
    assert (low, high) == (pytest.approx(-1, abs=0.01), pytest.approx(3, abs=0.02))
    aside = Trace("law", X, 1e13 * X, "#000000", scale="none")
    assert _limits(measured, aside) == _limits(measured)


def test_a_band_of_an_undetermined_parameter_is_neither_drawn_nor_scaled():
    curve = np.sin(X)
    sigma = np.where(X < 5, 0.1, 1e13)
    chart = Chart("c", "t", "1", (Trace("model", X, curve, "#000000", sigma),), "f")
    (drawn,) = chart.traces
    assert (np.isfinite(drawn.sigma) == (X < 5)).all()
    assert "band wider than the chart" in drawn.label
    # a known band is two standard uncertainties on either side
    assert chart.limits[1] == pytest.approx(1.2, abs=0.01)
    whole = Chart("c", "t", "1", (Trace("model", X, curve, "#000000", np.full(101, 1e13)),), "f")
    assert whole.traces[0].sigma is None


def test_a_band_of_noise_is_drawn_at_two_sigma_however_wide():
    band = Trace("noise", X, 0 * X, "#888888", np.full(101, 3.0), "band")
    small = Trace("residual", X, 2.0 * np.sign(np.sin(X)), "#000000")
    chart = Chart("c", "t", "1", (band, small), "f")
    assert chart.traces[0].sigma is not None
    assert chart.limits == (-6.0, 6.0)


def test_curves_in_windows_are_interrupted_between_them():
    parts = [(X, X, None), (X + 20, X, None)]
    trace = concatenated("a", parts, "#000000")
    assert (np.diff(trace.x) > 0).all()
    assert np.isnan(trace.value).sum() == 1
    assert trace.x[np.isnan(trace.value)] == 15.0


@pytest.mark.parametrize(("label", "columns"), [("final model", 2), (30 * "m", 1)])
def test_long_labels_of_a_legend_leave_room_for_the_chart(monkeypatch, label, columns):
    asked = []
    monkeypatch.setattr("gyrotrack.plotting._charts.legend", lambda _, ncols: asked.append(ncols))
    x = np.linspace(0.0, 1.0, 5)
    traces = tuple(Trace(f"{label}{i}", x, x, "#000000") for i in range(2))
    chart_picture(Chart("c", "t", "1", traces, "f"), size=(4.6, 5.1))
    assert asked == [columns]


@pytest.mark.parametrize(("length", "lines"), [(45, 1), (52, 2)])
def test_a_label_that_is_wider_than_the_chart_has_two_lines(monkeypatch, length, lines):
    drawn = []
    monkeypatch.setattr(
        "gyrotrack.plotting._charts.legend",
        lambda axes, ncols: drawn.append(axes.get_legend_handles_labels()[1]),
    )
    label = "".join("law of friction "[i % 16] for i in range(length)).strip()
    chart_picture(Chart("c", "t", "1", (Trace(label, X, X, "#000000"),), "f"), size=(4.6, 5.1))
    ((shown,),) = drawn
    assert shown.count("\n") == lines - 1
    assert shown.replace("\n", " ") == label
