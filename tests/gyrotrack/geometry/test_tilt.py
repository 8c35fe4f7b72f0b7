import numpy as np
import pytest

from gyrotrack.geometry.tilt import NO_FLATTENING, fit_flattening


def _seen(theta, rho, offset, tilt, azimuth):
    """A circle seen from a slant: short by cos(tilt) along the azimuth, about a centre beside the disc."""
    c, s = np.cos(azimuth), np.sin(azimuth)
    x, y = rho * np.cos(theta), rho * np.sin(theta)
    short, long = (c * x + s * y) * np.cos(tilt), c * y - s * x
    return np.stack([c * short - s * long, s * short + c * long], axis=1) + offset


def test_tilt_and_offsets_are_found_and_taken_off():
    rng = np.random.default_rng(4)
    theta = rng.uniform(0, 2 * np.pi, 800)
    offsets = {"blue": np.array([1.5, -0.7]), "green": np.array([0.2, 0.9])}
    seen = {m: _seen(theta, 90.0, e, 0.2, 0.8) + rng.normal(0, 0.2, (800, 2)) for m, e in offsets.items()}
    found = fit_flattening(seen)
    assert found.tilt == pytest.approx(0.2, abs=0.01)
    for name, e in offsets.items():
        np.testing.assert_allclose(found.offset[name], e, atol=0.05)
        v = found.level(name, _seen(theta, 90.0, e, 0.2, 0.8))
        off = np.angle(np.exp(1j * (np.arctan2(v[:, 1], v[:, 0]) - theta)))
        raw = _seen(theta, 90.0, e, 0.2, 0.8)
        before = np.angle(np.exp(1j * (np.arctan2(raw[:, 1], raw[:, 0]) - theta)))
        assert np.std(off) < 4e-4 < 5e-3 < np.std(before)


def test_half_a_turn_is_not_enough():
    theta = np.linspace(0, 3.0, 500)
    assert fit_flattening({"red": _seen(theta, 90.0, np.zeros(2), 0.2, 0.3)}) == NO_FLATTENING
