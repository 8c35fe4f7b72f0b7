import numpy as np
import pytest

from gyrotrack.tracking._corners import paper_angle, paper_sigma

CENTRE = np.tile([100.0, 80.0], (3, 1))
ALL = np.ones(3, dtype=bool)


def _corners(rho, delta, psi, turn=0.0):
    """Corners of a base of length delta with its middle at (rho, psi), `turn` off a right angle."""
    z = rho * np.exp(1j * psi) + np.array([-0.5, 0.5]) * delta * 1j * np.exp(1j * (psi + turn))
    return np.stack([100 + z.real, 80 - z.imag], axis=-1)


def test_an_ideal_marker_has_no_uncertainty():
    found = paper_angle(np.stack([_corners(50, 12, psi) for psi in (0.3, 2.0, -2.5)]), CENTRE, ALL)
    np.testing.assert_allclose(found.angle, [0.3, 2.0, -2.5])
    np.testing.assert_allclose(found.delta, 12)
    np.testing.assert_allclose(found.rho, 50)
    np.testing.assert_allclose(found.beta, np.pi / 2)
    np.testing.assert_allclose(found.sigma, 0, atol=1e-9)


def test_a_longer_base_shows_in_both_bases_only():
    found = paper_angle(np.stack([_corners(50, d, 0.3) for d in (12, 12, 15)]), CENTRE, ALL)
    expected = np.arctan(7.5 / 50) - np.arctan(6.5 / 50)  # the average base is 13
    assert found.u_1[2] == pytest.approx(expected)
    assert found.u_2[2] == pytest.approx(expected)
    assert found.u_r[2] == pytest.approx(0, abs=1e-12)


def test_a_slanted_base_shows_in_the_right_angle_only():
    found = paper_angle(np.stack([_corners(50, 12, 0.3, t) for t in (0, 0, 0.2)]), CENTRE, ALL)
    z = 50 + 6 * 1j * np.exp(0.2j) * np.array([-1, 1])
    right = 50 + 6j * np.array([-1, 1])
    assert found.u_1[2] == pytest.approx(0, abs=1e-12)
    assert found.u_2[2] == pytest.approx(np.sqrt(np.mean((np.angle(right) - np.angle(z)) ** 2)))
    assert found.beta[2] == pytest.approx(np.pi / 2 + 0.2)


def test_a_radius_shows_as_its_relative_departure():
    found = paper_angle(np.stack([_corners(r, 12, 0.3) for r in (50, 50, 56)]), CENTRE, ALL)
    np.testing.assert_allclose(found.u_r, [2 / 52, 2 / 52, 4 / 52])


def test_the_papers_formula_and_constants():
    assert paper_sigma(0.01, 0.0, 0.0) == pytest.approx(0.3)
    assert paper_sigma(0.0, 0.002, 0.0) == pytest.approx(0.3)
    assert paper_sigma(0.01, 0.002, 0.004) == pytest.approx(np.sqrt(0.3**2 + 0.3**2 + 0.6**2))


def test_averages_come_from_the_frames_in_use_and_gaps_stay_gaps():
    corner = np.stack([_corners(50, 12, 0.3), _corners(80, 30, 0.3), np.full((2, 2), np.nan)])
    found = paper_angle(corner, CENTRE, np.array([True, False, True]))
    assert found.sigma[0] == pytest.approx(0)
    assert found.u_r[1] == pytest.approx(30 / 50)
    assert np.isnan([found.sigma[2], found.angle[2], found.beta[2]]).all()
