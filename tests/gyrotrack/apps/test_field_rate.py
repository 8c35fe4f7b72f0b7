"""The given capture rate is that of frames; an interlaced film is measured by its fields."""

from types import SimpleNamespace

import pytest

from gyrotrack.apps import _spindown


@pytest.mark.parametrize(("interlaced", "rate"), [(True, 60.0), (False, 30.0)])
def test_a_frame_of_an_interlaced_film_holds_two_pictures(interlaced, rate):
    fps, origin, warnings = _spindown._rate(SimpleNamespace(interlaced=interlaced), 30.0)
    assert (fps, origin) == (rate, "--capture-fps")
    assert any("60 fields" in w for w in warnings) == interlaced
