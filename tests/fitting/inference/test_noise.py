"""The level of a small random torque below the angle noise of a single frame."""

from dataclasses import replace

import numpy as np
import pytest
from cases import fitted
from scipy.interpolate import CubicSpline

from fitting import LINEAR, REDUCED, Model, fit
from fitting.dynamics._sensitivities import LinearMotion
from fitting.inference._linear_algebra import cubic_spline
from fitting.inference._noise import (
    WHITE,
    TorqueNoise,
    TorqueResponse,
    Whitener,
    remaining_level,
    unresolved_level,
    variance_factor,
)

TIME = 1.0


def strength(noise):
    """Return rms over the root of the correlation time [N m s^-1/2]: the fast end of the spectrum."""
    return noise.pure / np.sqrt(noise.time)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1])
def test_level_of_a_random_torque_is_recovered(seed):
    """The median of 18 recordings is tested more sharply in test_coverage.py."""
    (noise,) = fitted(seed=seed, ou=1e-7).noise
    assert 1e-7 / 1.5 < strength(noise) < 1.5e-7
    assert 0.5e-7 < noise.pure < 2.5e-7
    assert abs(noise.pure - 1e-7) < 4 * noise.pure_u
    assert 0.5e-7 < noise.level < 2.5e-7
    assert noise.scale == pytest.approx(1.0, abs=0.08)


@pytest.mark.slow
@pytest.mark.parametrize("time", [0.4, 3.0])
def test_another_correlation_time_changes_the_level_little(time):
    (noise,) = fitted(seed=2, ou=2e-7, ou_time=time, few=time > 1).noise
    assert 2e-7 / 1.5 < strength(noise) * np.sqrt(time) < 3e-7
    assert 1e-7 < noise.pure < 5e-7


def test_without_process_noise_its_level_is_that_of_the_resolution():
    """Of 14 more recordings: see the test of the coverage in test_fit.py."""
    (noise,) = fitted(seed=0).noise
    assert 0 < noise.pure < 1e-9
    assert 0.3 < noise.pure_u / noise.pure < 3
    assert noise.level < noise.pure


@pytest.mark.parametrize(
    ("model", "casing", "rotor"),
    [
        (REDUCED, 1.03, 1.0),
        (LINEAR, 0.97, 1.03),
    ],
)
@pytest.mark.slow
def test_neither_model_nor_moments_of_inertia_change_the_process_noise(model, casing, rotor):
    """The one number of a recording, as a ratio of torque to inertia."""
    base = fitted(seed=1, ou=1e-7, hidden="step", few=True)
    record = base.problem.data[0].record
    other = replace(record, I_casing=casing * record.I_casing, I_rotor=rotor * record.I_rotor)
    found = fit(Model.of(model), [other])
    assert found.noise[0].pure == pytest.approx(casing * base.noise[0].pure, rel=1e-9)
    if model is REDUCED:
        assert found.cases[0].chi2_per_row == pytest.approx(base.cases[0].chi2_per_row, rel=0.5)
        assert found.held_out == pytest.approx(base.held_out, rel=0.2)


@pytest.mark.slow
@pytest.mark.parametrize(("hidden", "seed"), [("step", 0), ("drag", 1)])
def test_a_missing_effect_does_not_count_as_process_noise(hidden, seed):
    """The process noise is unchanged; a missing effect raises the level of the fit."""
    result = fitted(seed=seed, hidden=hidden, few=hidden == "drag")
    (noise,) = result.noise
    assert noise.pure < 1e-8
    assert noise.level > 3e-8
    assert result.verdict == "lack_of_fit"


@pytest.mark.slow
@pytest.mark.parametrize("hidden", ["step", "drag"])
def test_process_noise_is_estimated_with_a_missing_effect_present(hidden):
    (noise,) = fitted(seed=1, ou=1e-7, hidden=hidden, few=True).noise
    assert 1e-7 / 1.6 < strength(noise) < 1.6e-7


@pytest.fixture(scope="module")
def response():
    result = fitted(seed=0)
    p = result.predictions[0]
    return TorqueResponse(result.problem.data[0], LinearMotion(p.path, p.sensitivity.propagator))


def test_response_to_a_torque_in_all_cells_is_that_of_a_constant_torque(response):
    """The response of the rows to a constant torque on the casing agrees with SciPy's integration."""
    from scipy.integrate import solve_ivp

    result = fitted(seed=0)
    data, path = response.data, result.predictions[0].path
    est = {k.rpartition(".")[2]: e.value for k, e in result.estimates.items() if "@" not in k}
    knots = np.linspace(*data.record.span, 4001)
    from fitting.dynamics._collocation import Sampler

    wr, wc = Sampler(path.mesh, knots).value(path.y)[:, :2].T
    stiff = est["d"] + est["f"] * est["g"] * (wr - wc) ** (est["g"] - 1)

    def rates(t, y):
        s, w = np.interp(t, knots, stiff), np.interp(t, knots, wr)
        rotor = (-s * (y[0] - y[1]) - 2 * est["a2"] * w * y[0]) / data.record.I_rotor
        casing = (1e-7 + s * (y[0] - y[1]) - est["b2"] * y[1]) / data.record.I_casing
        return [rotor, casing, y[0], y[1]]

    times = np.sort(data.node_times)
    exact = solve_ivp(
        rates, (0, times[-1]), np.zeros(4), method="DOP853", rtol=1e-8, atol=1e-12, t_eval=times
    ).y
    where = np.searchsorted(times, data.node_times)
    a = len(data.casing.node_times)
    ends = np.cumsum([len(w.node_times) for w in data.rotor])[:-1]
    expected = data.rows(exact[3][where[:a]], np.split(exact[2][where[a:]], ends))[data.slices["smooth"]]
    found = 1e-7 * response.casing.sum(axis=1)
    np.testing.assert_allclose(found, expected, atol=2e-4 * np.abs(expected).max())


def test_covariance_is_the_sum_over_pairs_of_cells(response):
    """W R W' in full, with the exponential correlation written out."""
    time = TIME
    since = np.abs(response.centres[:, None] - response.centres)
    correlation = np.exp(-since / time)
    full = sum(w @ correlation @ w.T for w in (response.casing, response.casing - response.rotor))
    found = response.covariance(time)
    np.testing.assert_allclose(found, full, atol=1e-10 * np.abs(full).max())
    np.testing.assert_array_equal(found, found.T)


def test_covariance_agrees_with_simulated_random_torques(response):
    """Draw Ornstein-Uhlenbeck torques in the cells and compare the variance of the rows with the formula."""
    rng = np.random.default_rng(3)
    cells, time = len(response.centres), TIME
    decay = np.exp(-(response.edges[1] - response.edges[0]) / time)

    def torques(n):
        w = np.empty((cells, n))
        w[0] = rng.standard_normal(n)
        for i in range(1, cells):
            w[i] = decay * w[i - 1] + np.sqrt(1 - decay**2) * rng.standard_normal(n)
        return w

    on_casing, between = torques(600), torques(600)
    rows = response.casing @ on_casing + (response.casing - response.rotor) @ between
    found, formula = rows.var(axis=1), np.diag(response.covariance(time))
    ratio = found[formula > 1e-3 * formula.max()] / formula[formula > 1e-3 * formula.max()]
    # one variance from 600 draws: 1 +- 0.058; neighbouring rows share their torques
    assert np.median(ratio) == pytest.approx(1.0, abs=0.1)
    assert ratio.max() < 1.35
    assert ratio.min() > 0.7


def test_the_whitener_whitens_rows(response):
    whitener = response.whitener(TorqueNoise(1e-7, TIME))
    smooth, m = len(whitener.vectors), len(whitener.values)
    covariance = np.eye(m) + 1e-14 * np.diag(whitener.values)
    covariance[:smooth, :smooth] = np.eye(smooth) + 1e-14 * response.covariance(TIME)
    root = whitener(np.eye(m))
    # ten orders of magnitude lie between the eigenvalues
    np.testing.assert_allclose(root @ covariance @ root.T, np.eye(m), atol=1e-4)
    assert whitener.log_determinant == pytest.approx(np.linalg.slogdet(covariance)[1], rel=1e-6)
    rows = np.random.default_rng(0).normal(size=m + 30)
    np.testing.assert_array_equal(whitener(rows)[m:], rows[m:])
    np.testing.assert_array_equal(whitener.at(0.0)(rows), rows)
    np.testing.assert_array_equal(WHITE(rows), rows)
    assert WHITE.log_determinant == 0


def test_the_remaining_level_is_that_of_simulated_rows():
    rng = np.random.default_rng(4)
    m = 300
    values = np.geomspace(1e8, 1e16, m)
    whitener = Whitener(np.linalg.qr(rng.normal(size=(m, m)))[0], values)
    free = rng.normal(size=(m, 6))
    for level in (0.0, 1e-7, 1e-6):
        found = []
        for _ in range(8):
            rows = whitener.vectors @ (np.sqrt(1 + level**2 * values) * rng.standard_normal(m))
            level_found, gain = remaining_level(whitener, rows, free)
            found.append(level_found)
            assert gain >= 0
        if level:
            assert np.median(found) == pytest.approx(level, rel=0.25)
            assert gain > 10
        else:
            assert max(found) < 3e-8


def test_the_unresolved_level_is_a_posterior_mean():
    """Levels drawn from the prior, rows from each: the mean of the squares is that of the truth (total expectation)."""
    random = np.random.default_rng(4)
    expected, rows, draws = 0.2, 12, 300
    values = np.geomspace(3e3, 1e-3, rows)
    vectors = np.linalg.qr(random.standard_normal((rows, rows)))[0]
    whitener = Whitener(vectors, values)
    free = np.vander(np.linspace(-1, 1, rows), 3)
    true = expected * np.abs(random.standard_normal(draws)) * (random.random(draws) < 0.5)
    found = []
    for s in true:
        torque = vectors @ (s * np.sqrt(values) * random.standard_normal(rows))
        residual = torque + random.standard_normal(rows) + free @ [3.0, -2.0, 1.0]
        found.append(unresolved_level(whitener, residual, free, expected))
    square = np.array(found) ** 2
    error = np.std(square - true**2) / np.sqrt(draws)
    assert square.mean() == pytest.approx(np.mean(true**2), abs=4 * error)
    # far below what would be expected without any data: they exclude most levels where there is no torque
    assert np.sqrt(square[true == 0].mean()) < 0.6 * expected / np.sqrt(2)
    assert error < 0.1 * expected**2


@pytest.mark.parametrize("dof", [5, 40, 400])
def test_the_variance_factor_is_a_posterior_mean(dof):
    """Factors drawn from the prior, chi-square from each: on average the estimate is the truth (total expectation)."""
    random = np.random.default_rng(dof)
    draws = 40_000
    true = np.where(random.random(draws) < 0.5, 1.0, 1 / random.uniform(0.0, 1.0, draws))
    chi2 = true * random.chisquare(dof, draws)
    for low, high in ((0.8, 1.0), (1.0, 1.3), (1.3, 2.0), (2.0, 5.0)):
        near = (chi2 > low * dof) & (chi2 < high * dof)
        found = np.array([variance_factor(x, dof) for x in chi2[near]])
        error = np.std(true[near]) / np.sqrt(near.sum())
        assert found.mean() == pytest.approx(true[near].mean(), abs=4 * error)


def test_noise_alone_hardly_increases_the_variance_and_a_gross_misfit_by_all_of_it():
    chi2 = np.random.default_rng(1).chisquare(250, 2000)
    assert 1 <= np.mean([variance_factor(x, 250) for x in chi2]) < 1.02
    assert variance_factor(250 * 1e4, 250) == pytest.approx(1e4)
    assert variance_factor(20.0, 3000) == variance_factor(0.0, 0) == 1.0


@pytest.mark.parametrize("points", [4, 7, 121])
def test_the_cubic_spline_is_that_of_scipy(points):
    random = np.random.default_rng(points)
    x, y = np.sort(random.uniform(-3, 9, points)), random.standard_normal(points)
    at = np.linspace(x[0], x[-1], 301)
    expected = CubicSpline(x, y)(at)
    assert cubic_spline(x, y, at) == pytest.approx(expected, abs=1e-12 * np.abs(expected).max())
