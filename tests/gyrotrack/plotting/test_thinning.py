import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from gyrotrack.plotting._charts import thin


@settings(max_examples=30)
@given(st.integers(2, 30_000), st.integers(0, 2**32 - 1))
def test_points_are_few_and_real_and_no_peak_is_lost(count, seed):
    time = np.arange(count) / 260
    value = np.random.default_rng(seed).standard_normal(count)
    t, v = thin(time, value, 2000)
    assert len(t) <= 2000
    assert (np.diff(t) > 0).all()
    assert set(zip(t, v, strict=True)) <= set(zip(time, value, strict=True))
    assert v.max() == value.max()
    assert v.min() == value.min()


def test_short_curves_stay_whole():
    time = np.arange(5.0)
    t, v = thin(time, time**2)
    assert (t == time).all()
    assert (v == time**2).all()
