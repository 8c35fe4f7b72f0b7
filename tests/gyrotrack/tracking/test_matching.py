import numpy as np
import pytest

from gyrotrack.tracking._marker_tracker import flat_top, match, mean_profile, shifted

M = 61


def _trapezoid(x, width, smear):
    """A paper of a width, smeared evenly over a smear: the convolution of two boxes."""
    top, foot = abs(width - smear) / 2, (width + smear) / 2
    return np.clip((foot - np.abs(x)) / max(foot - top, 1e-9), 0, 1) * min(width, smear) / max(width, smear)


def _profiles(displacement, width=16.0, smear=9.0, gain=1.0, offset=0.0):
    x = np.arange(M) - (M - 1) / 2
    return np.stack([gain * _trapezoid(x - d, width, smear) + offset for d in displacement])


def test_the_middle_of_a_smeared_paper_is_found_whatever_gain_and_offset():
    rng = np.random.default_rng(1)
    d = rng.uniform(-2, 2, 200)
    gain, offset = rng.uniform(0.6, 1.4, 200), rng.uniform(-0.2, 0.2, 200)
    profiles = np.stack([g * p + o for p, g, o in zip(_profiles(d), gain, offset, strict=True)])
    profiles += rng.normal(0, 0.01, profiles.shape)
    everything = np.ones(profiles.shape, dtype=bool)
    found = match(profiles, flat_top(8, M), np.zeros(200), everything)
    for _ in range(3):
        template = mean_profile(profiles, found, np.ones(200, dtype=bool), everything, symmetric=True)
        found = match(profiles, template, found.shift, everything)
    assert np.std(found.shift - d) < 0.05
    assert abs(np.mean(found.shift - d)) < 0.01


def test_what_is_hidden_does_not_pull():
    d = np.linspace(-1, 1, 21)
    profiles = _profiles(d)
    template = _profiles([0.0])[0]
    seen = np.ones(profiles.shape, dtype=bool)
    profiles[:, 38:] = 0.0  # a bar over the right edge
    seen[:, 37:] = False
    found = match(profiles, template, np.zeros(21), seen)
    naive = match(profiles, template, np.zeros(21), np.ones_like(seen))
    assert np.abs(found.shift - d).max() < 0.05
    assert np.abs(naive.shift - d).max() > 0.5
    assert (found.weakness > 1.2).all()


def test_the_weakness_is_the_growth_of_the_true_error():
    rng = np.random.default_rng(3)
    template = _profiles([0.0])[0]
    scatter = []
    for hidden in (False, True):
        seen = np.ones((4000, M), dtype=bool)
        seen[:, 36:] = ~np.array(hidden)
        noisy = template + rng.normal(0, 0.02, (4000, M))
        found = match(noisy, template, np.zeros(4000), seen)
        scatter.append((np.std(found.shift), np.median(found.weakness)))
    (whole, one), (half, weak) = scatter
    assert one == pytest.approx(1.0, abs=0.05)
    assert half / whole == pytest.approx(weak, rel=0.15)


def test_nothing_left_is_infinitely_weak():
    found = match(np.zeros((1, M)), _profiles([0.0])[0], np.zeros(1), np.zeros((1, M), dtype=bool))
    assert found.weakness[0] > 1e3


def test_shifting_is_exact_for_cubics():
    x = np.arange(40.0)
    curve = 1e-3 * (x - 20) ** 3
    moved = shifted(np.stack([curve, curve]), np.array([0.3, -1.6]))
    np.testing.assert_allclose(moved[0, 5:-5], 1e-3 * (x[5:-5] + 0.3 - 20) ** 3, atol=0.02)
    np.testing.assert_allclose(moved[1, 5:-5], 1e-3 * (x[5:-5] - 1.6 - 20) ** 3, atol=0.02)
