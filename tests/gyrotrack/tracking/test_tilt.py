import numpy as np
import pytest

from gyrotrack.tracking._orbit import NO_FLATTENING, fit_common_offset, fit_flattening, flattening_of_arc


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


def test_markers_that_each_cover_a_part_of_the_orbit_show_their_common_offset_together():
    rng = np.random.default_rng(6)
    starts, radii, truth = (
        {"blue": 0.3, "green": 2.4, "white": 4.5},
        (60.0, 62.0, 61.0),
        np.array([5.0, -3.5]),
    )
    seen = {
        name: _seen(start + rng.uniform(0, 4.5, 20), rho, truth, 0.1, 0.8) + rng.normal(0, 0.15, (20, 2))
        for (name, start), rho in zip(starts.items(), radii, strict=True)
    }
    assert fit_flattening(seen) == NO_FLATTENING
    found = fit_common_offset(seen)
    for name in seen:
        # 60 radii with errors of 0.15 px and seven unknowns
        np.testing.assert_allclose(found.offset[name], truth, atol=0.15)
    assert found.tilt == pytest.approx(0.1, abs=0.06)
    assert fit_common_offset({"blue": seen["blue"]}) == NO_FLATTENING


@pytest.mark.parametrize("cover", [1.0, 2.5, 4.5])
def test_an_arc_takes_the_tilt_of_another_orbit_and_its_offset_within_what_it_doubts(cover):
    theta, truth = np.linspace(0.4, 0.4 + cover, 300), np.array([0.9, -0.5])
    lender = fit_flattening({"blue": _seen(np.linspace(0, 6.2, 800), 90.0, np.array([0.5, -0.4]), 0.25, 0.8)})
    z = []
    for seed in range(30):
        by_place = np.random.default_rng(seed).normal(0, 0.1, (2, 13))  # px, alike over half a radian
        error = np.stack([np.interp(theta, np.arange(13) * np.pi / 6, row) for row in by_place], axis=1)
        seen = _seen(theta, 120.0, truth, 0.25, 0.8) + error
        found = flattening_of_arc(lender, {"red": seen}, np.array([0.5, -0.4]), 0.64, 0.1)
        off = np.array(found.offset["red"]) - truth
        z.append(off @ np.linalg.solve(found.offset_covariance["red"], off) / 2.0)
        v = found.level("red", _seen(theta, 120.0, truth, 0.25, 0.8))
        angle = np.angle(np.exp(1j * (np.arctan2(v[:, 1], v[:, 0]) - theta)))
        assert np.all(
            np.abs(angle - angle.mean()) < 4.0 * found.tangential_sigma("red", theta) / 120.0 + 5e-4
        )
    assert (found.p, found.q) == (lender.p, lender.q)
    assert np.mean(z) < 2.0
